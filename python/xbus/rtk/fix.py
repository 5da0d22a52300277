"""The position of a device, and the kind of its fix."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from xbus.export.valid import has_fix, has_fix_flags, is_place, is_set
from xbus.log.log import Log
from xbus.protocol.keys import EntryKey
from xbus.protocol.tables import QUANTITIES, STATUS_FLAGS
from xbus.protocol.values import GNSS_CARRIER_BIT

__all__ = ["Fix", "Position"]

#: Names of the fix types of the receiver (Table 25).
FIX_TYPES = ("none", "dead reckoning", "2D", "3D", "GNSS and dead reckoning", "time only")
RTK = ("none", "float", "fixed")
_PVT = {field.name: field for field in QUANTITIES["gnss_pvt_data"].fields}


class Position(NamedTuple):
    """The position of a device.

    Attributes:
        lat: Latitude in degrees.
        lon: Longitude in degrees.
        alt: Height above mean sea level in m; above the ellipsoid if ``sep`` is 0.
        sep: Height of mean sea level above the ellipsoid in m; 0 if the device does not send it.
        satellites: Satellites in use; None if the device does not send it.
        hdop: Horizontal dilution of precision; None if the device does not send it.
    """

    lat: float
    lon: float
    alt: float
    sep: float = 0.0
    satellites: int | None = None
    hdop: float | None = None


class Fix:
    """The fix and position that the latest samples of a device report.

    The source is ``gnss_pvt_data`` and ``status_word``; without the former, ``lat_lon`` and
    ``altitude_ellipsoid``. A position is valid as in the exports: the receiver reports a fix in two or three
    dimensions and marks it as good, or the status word has the flags ``filter_valid`` and ``gnss_fix``.

    Attributes:
        QUANTITIES: The quantities that it uses.
        type: ``"none"``, ``"2D"``, ``"3D"``, ... (Table 25), or ``"yes"`` if only the status word reports a
            fix; None before the first report.
        is_valid: Whether the latest report has a valid position.
        rtk: ``"none"``, ``"float"`` or ``"fixed"``, from bits 27 and 28 of the status word, or else from the
            flags of the receiver; None before the first report.
        position: The last valid position, or None.

    >>> import xbus
    >>> fix = Fix()
    >>> with xbus.connect("sim:MTi-680G") as device:
    ...     while fix.position is None:
    ...         fix.update(device.read_sample())
    >>> fix.type, fix.rtk, round(fix.position.lat, 2)
    ('yes', 'none', 52.24)
    """

    QUANTITIES = ("status_word", "gnss_pvt_data", "lat_lon", "altitude_ellipsoid")

    def __init__(self) -> None:
        self.type: str | None = None
        self.rtk: str | None = None
        self.is_valid = False
        self.position: Position | None = None
        self._has_pvt = self._has_status = False

    def update(self, sample: Mapping[EntryKey, Any]) -> None:
        """Updates the fix from a sample, or from a mapping with the same keys and values."""
        if (word := sample.get("status_word")) is not None:
            self._has_status = True
            self.rtk = _rtk_name(STATUS_FLAGS["rtk_status"].of(int(word)))
            if not self._has_pvt:
                self.type = "yes" if STATUS_FLAGS["gnss_fix"].of(int(word)) else "none"
                self.is_valid = bool(has_fix_flags(int(word)))
        if (pvt := sample.get("gnss_pvt_data")) is not None:
            self._update_from_pvt(pvt)
        elif not self._has_pvt and "lat_lon" in sample:
            self._update_from_filter(
                np.asarray([sample["lat_lon"]]), float(sample.get("altitude_ellipsoid", 0.0))
            )

    def update_from_block(self, block: Log) -> None:
        """Updates the fix from the latest values of a block, such as one of `xbus.Device.blocks`."""
        latest: dict[EntryKey, Any] = {
            name: block[name].values[-1] for name in self.QUANTITIES if name in block
        }
        if (pvt := latest.get("gnss_pvt_data")) is not None:
            latest["gnss_pvt_data"] = dict(zip(pvt.dtype.names, pvt.item(), strict=True))
        self.update(latest)

    def _update_from_filter(self, lat_lon: npt.NDArray[Any], alt: float) -> None:
        if not self._has_status:
            self.is_valid = True
        if self.is_valid and is_set(lat_lon) & is_place("lat_lon", lat_lon) and math.isfinite(alt):
            lat, lon = lat_lon[0].tolist()
            self.position = Position(lat, lon, alt)

    def _update_from_pvt(self, pvt: Mapping[str, int]) -> None:
        self._has_pvt = True
        kind = pvt["fixtype"]
        self.type = FIX_TYPES[kind] if kind < len(FIX_TYPES) else str(kind)
        if not self._has_status:
            self.rtk = _rtk_name(pvt["flags"] >> GNSS_CARRIER_BIT & 0b11)
        self.is_valid = bool(has_fix(pvt))
        if self.is_valid:
            self.position = Position(
                _PVT["lat"].scaled(pvt["lat"]),
                _PVT["lon"].scaled(pvt["lon"]),
                _PVT["hMSL"].scaled(pvt["hMSL"]),
                _PVT["height"].scaled(pvt["height"] - pvt["hMSL"]),
                pvt["numSV"],
                _PVT["hdop"].scaled(pvt["hdop"]),
            )

    def __repr__(self) -> str:
        where = f", {self.position.lat:.5f}, {self.position.lon:.5f}" if self.position else ""
        return f"<Fix {self.type}, RTK {self.rtk}{where}>"


def _rtk_name(status: int) -> str:
    return RTK[status] if status < len(RTK) else str(status)
