"""Positions of the GNSS receiver (``gnss_pvt_data``, Table 25) as `NavSatFix` and as GGA sentences."""

from __future__ import annotations

from functools import reduce
from operator import xor
from typing import Any

import numpy as np
import numpy.typing as npt

from xbus.export.ros.cdr import DOUBLES, Fields, Layout
from xbus.export.valid import has_fix
from xbus.protocol.tables import STATUS_FLAGS, UTC_VALID
from xbus.protocol.values import GNSS_CARRIER_BIT, GNSS_CORRECTED, POSITION_FIXES, GnssFixType

__all__ = ["navsat_fields", "navsat_rows", "sentences"]

NO_FIX, FIX, SBAS_FIX, GBAS_FIX = -1, 0, 1, 2
COVARIANCE_UNKNOWN, DIAGONAL_KNOWN = 0, 2
#: An accuracy that the receiver does not give.
UNKNOWN = 0xFFFFFFFF
#: What GGA calls an RTK solution: floating and fixed.
RTK_QUALITY = {1: 5, 2: 4}
CENTISECONDS_OF_DAY = 24 * 3600 * 100


def navsat_fields() -> Fields:
    """Returns the fields of `NavSatFix` after the header."""
    return [
        ("status", "i1", ()),
        ("service", "<u2", ()),
        *((name, DOUBLES, ()) for name in ("latitude", "longitude", "altitude")),
        ("covariance", DOUBLES, (9,)),
        ("covariance_type", "u1", ()),
    ]


def _carrier(records: npt.NDArray[Any]) -> npt.NDArray[Any]:
    return np.asarray(records["flags"] >> GNSS_CARRIER_BIT)


def navsat_rows(records: npt.NDArray[Any], layout: Layout, *, is_driver: bool) -> npt.NDArray[Any]:
    """Returns the bodies of `NavSatFix` messages.

    The driver ignores corrections and the validity of the fix, and always gives position and covariance.
    """
    bodies = layout.bodies(len(records))
    horizontal, vertical = (records[name] * 1e-3 for name in ("hAcc", "vAcc"))
    variances = np.stack([horizontal**2, horizontal**2, vertical**2], axis=1)
    for name, field, scale in (
        ("latitude", "lat", 1e-7),
        ("longitude", "lon", 1e-7),
        ("altitude", "height", 1e-3),
    ):
        bodies[name] = records[field] * scale
    if is_driver:
        bodies["status"] = np.where(np.isin(records["fixtype"], POSITION_FIXES), FIX, NO_FIX)
        is_known = np.ones(len(records), np.bool_)
    else:
        is_fixed = has_fix(records)
        is_corrected = records["flags"] & GNSS_CORRECTED != 0
        augmented = np.where(is_corrected, SBAS_FIX, FIX)
        kind = np.where(_carrier(records) > 0, GBAS_FIX, augmented)
        bodies["status"] = np.where(is_fixed, kind, NO_FIX)
        for name in ("latitude", "longitude", "altitude"):
            bodies[name][~is_fixed] = np.nan
        is_known = is_fixed & (records["hAcc"] != UNKNOWN) & (records["vAcc"] != UNKNOWN)
    bodies["covariance"][:, ::4] = np.where(is_known[:, np.newaxis], variances, 0)
    bodies["covariance_type"] = np.where(is_known, DIAGONAL_KNOWN, COVARIANCE_UNKNOWN)
    return bodies


def sentences(records: npt.NDArray[Any], status: npt.NDArray[Any] | None) -> list[bytes]:
    """Returns a GGA sentence for each record, with CR, LF and the zero that ends a string of a message.

    Args:
        records: Rows of ``gnss_pvt_data``.
        status: The status word of each, for the sentences of the driver: it takes the quality from there,
            and writes a position without a fix, and seconds as they come. None for those of NMEA 0183.
    """
    if status is None:
        bodies = map(_sentence, records, has_fix(records).tolist())
    else:
        bodies = map(_sentence_of_driver, records, status.tolist())
    return [_framed(body) for body in bodies]


def _framed(body: str) -> bytes:
    checksum = reduce(xor, body.encode())
    return f"${body}*{checksum:02X}\r\n\0".encode()


def _sentence(record: Any, is_fixed: bool) -> str:
    nanoseconds = int(record["nano"]) + 10**9 * (
        (int(record["hour"]) * 60 + int(record["min"])) * 60 + int(record["sec"])
    )
    minutes, centiseconds = divmod(round(nanoseconds / 1e7) % CENTISECONDS_OF_DAY, 6000)
    hour, minute = divmod(minutes, 60)
    time = "GPGGA,"
    if record["valid"] & UTC_VALID == UTC_VALID:
        time += f"{hour:02d}{minute:02d}{centiseconds / 100:05.2f}"
    if not is_fixed:
        return f"{time},,,,,0,{record['numSV']:02d},,,M,,M,,"
    quality = RTK_QUALITY.get(int(record["flags"]) >> GNSS_CARRIER_BIT)
    if quality is None:
        quality = 2 if record["flags"] & GNSS_CORRECTED else 1
    return f"{time},{_place(record)},{quality},{_heights(record)},,"


def _sentence_of_driver(record: Any, status: int) -> str:
    seconds = int(record["sec"]) + int(record["nano"]) * 1e-9
    quality = RTK_QUALITY.get(STATUS_FLAGS["rtk_status"].of(status))
    if quality is None and STATUS_FLAGS["gnss_fix"].of(status):
        kind = int(record["fixtype"])
        quality = 6 if kind == GnssFixType.DEAD_RECKONING else 1 if kind in POSITION_FIXES else 0
    return (
        f"GPGGA,{record['hour']:02d}{record['min']:02d}{seconds:05.2f},{_place(record)},{quality or 0},"
        f"{_heights(record)},0,0"
    )


def _place(record: Any) -> str:
    lat, lon = (int(record[name]) * 1e-7 for name in ("lat", "lon"))
    north, east = "NS"[lat < 0], "EW"[lon < 0]
    return f"{_minutes(lat):010.5f},{north},{_minutes(lon):011.5f},{east}"


def _minutes(angle: float) -> float:
    """Returns an angle as degrees and minutes: 52.5 becomes 5230.0."""
    degrees = int(abs(angle))
    return degrees * 100 + (abs(angle) - degrees) * 60


def _heights(record: Any) -> str:
    sea = int(record["hMSL"]) / 1000
    geoid = (int(record["height"]) - int(record["hMSL"])) / 1000
    return f"{record['numSV']:02d},{int(record['hdop']) / 100:.1f},{sea:.2f},M,{geoid:.2f},M"
