"""Where tracks come from: the positions of a log as points."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Container
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np
import numpy.typing as npt

from xbus.export.part import Part
from xbus.export.text import formatted, shortest
from xbus.export.valid import STATUS, has_filter_fix, has_fix, rows_of, status_of
from xbus.geometry.earth import ecef_to_geodetic
from xbus.protocol.keys import EntryKey
from xbus.protocol.tables import STATUS_FLAGS, UTC_SOURCES, UTC_VALID
from xbus.protocol.values import GNSS_CARRIER_BIT, GNSS_CORRECTED, GNSS_FIX_OK, GnssFixType

__all__ = [
    "FIXES",
    "POINT",
    "UNKNOWN",
    "Points",
    "Positions",
    "Rows",
    "Source",
    "extra_texts",
    "positions_of",
]

Source = Literal["filter", "gnss"]
#: Points of a track: an array of `POINT`.
Points = npt.NDArray[Any]
#: A point: degrees; metres above sea level and above the ellipsoid; UTC; the place in `FIXES`; satellites;
#: dilutions of precision; accuracies in metres; speed in m/s and course in degrees; quality as in GGA.
#: NaN and NaT stand for what is not known.
POINT = np.dtype(
    [
        ("lat", "f8"),
        ("lon", "f8"),
        ("msl", "f8"),
        ("ellipsoid", "f8"),
        ("time", "M8[ns]"),
        ("fix", "u1"),
        ("satellites", "f8"),
        ("hdop", "f8"),
        ("vdop", "f8"),
        ("pdop", "f8"),
        ("accuracy", "f8"),
        ("altitude_accuracy", "f8"),
        ("speed", "f8"),
        ("course", "f8"),
        ("quality", "u1"),
    ]
)
#: A point of which nothing is known.
UNKNOWN = np.array((*[np.nan] * 4, np.datetime64("NaT", "ns"), 0, *[np.nan] * 8, 0), POINT)
#: Names of the kinds of fix, as in GPX; empty if it is not known.
FIXES = ("", "2d", "3d", "dgps")
#: The place in `FIXES` for the first values of ``fixtype`` (Table 25); 1 is dead reckoning.
FIX_TYPES = np.array([0, 0, 1, 2, 2], np.uint8)
#: Bits of ``flags`` in ``gnss_pvt_data``: corrections or carrier phases are used.
DIFFERENTIAL = GNSS_CORRECTED | 0b11 << GNSS_CARRIER_BIT
#: Qualities in GGA: of a fix, a differential one, and dead reckoning; and by the use of the carrier phase.
GGA_FIX, GGA_DIFFERENTIAL, GGA_ESTIMATED = 1, 2, 6
GGA_RTK = np.array([GGA_FIX, 5, 4, GGA_FIX], np.uint8)


@dataclass(frozen=True)
class Rows:
    """Positions in a part.

    Attributes:
        sample: The sample of each.
        points: The points that they would be.
        is_fixed: Whether they have a fix.
    """

    sample: npt.NDArray[np.int64]
    points: Points
    is_fixed: npt.NDArray[np.bool_]

    @property
    def is_place(self) -> npt.NDArray[np.bool_]:
        """Whether latitude and longitude are those of a place on Earth."""
        lat, lon = np.abs(self.points["lat"]), np.abs(self.points["lon"])
        return np.asarray((lat <= 90) & (lon <= 180))


class Positions(ABC):
    """Where positions come from."""

    name: ClassVar[Source]
    #: The quantities that are positions, the preferred one first.
    positions: ClassVar[tuple[str, ...]]
    #: Others that it reads.
    others: ClassVar[tuple[str, ...]] = ()

    def position(self, names: Container[object]) -> str | None:
        """Returns the name of the positions of a log with these quantities; None if it has none."""
        return next((name for name in self.positions if name in names), None)

    def quantities(self, shape: Part) -> list[EntryKey]:
        """Returns the quantities that it needs of a log."""
        names = (self.position(shape), *self.others)
        return [name for name in names if name is not None and name in shape]

    @abstractmethod
    def has_msl(self, shape: Part) -> bool:
        """Returns whether heights above sea level are known."""

    @abstractmethod
    def extras(self, shape: Part) -> tuple[str, ...]:
        """Returns which of the fields are known that not every log has."""

    @abstractmethod
    def rows(self, part: Part) -> Rows:
        """Returns the positions in a part, one for each sample at most: the last."""


class _Filter(Positions):
    name = "filter"
    positions = ("lat_lon", "position_ecef")
    others = ("altitude_msl", "altitude_ellipsoid", *STATUS, *UTC_SOURCES)

    def has_msl(self, shape: Part) -> bool:
        return "altitude_msl" in shape

    def extras(self, shape: Part) -> tuple[str, ...]:
        return () if status_of(shape) is None else ("fix",)

    def rows(self, part: Part) -> Rows:
        name = self.position(part)
        assert name is not None  # noqa: S101 - all parts have the columns of the log
        row = _last_of_samples(part[name].sample)
        sample, values = part[name].sample[row], part[name].values[row].astype(np.float64)
        points = np.full(len(sample), UNKNOWN)
        if name == "lat_lon":
            points["lat"], points["lon"] = values.T
        else:
            points["lat"], points["lon"], points["ellipsoid"] = ecef_to_geodetic(values)
        for field, other in (("msl", "altitude_msl"), ("ellipsoid", "altitude_ellipsoid")):
            if other in part:
                is_known, row = rows_of(part[other], sample)
                points[field][is_known] = part[other].values[row]
        points["time"] = part.utc[sample - part.first_sample]
        points["quality"] = GGA_FIX
        if (status := status_of(part)) is not None:
            is_known, row = rows_of(status, sample)
            words = status.values[row]
            points["fix"][is_known] = FIXES.index("3d")
            if status.name == "status_word":
                rtk = STATUS_FLAGS["rtk_status"].of(words)
                points["fix"][np.flatnonzero(is_known)[rtk > 0]] = FIXES.index("dgps")
                points["quality"][is_known] = GGA_RTK[rtk]
        return Rows(sample, points, has_filter_fix(part, sample, values))


class _Gnss(Positions):
    name = "gnss"
    positions = ("gnss_pvt_data",)

    def has_msl(self, shape: Part) -> bool:  # noqa: ARG002
        return True

    def extras(self, shape: Part) -> tuple[str, ...]:  # noqa: ARG002
        return "fix", "satellites", "accuracy", "altitude_accuracy"

    def rows(self, part: Part) -> Rows:
        column = part["gnss_pvt_data"]
        row = _last_of_samples(column.sample)
        fields = column.scaled[row]
        points = np.full(len(row), UNKNOWN)
        for field, other in {
            "lat": "lat",
            "lon": "lon",
            "msl": "hMSL",
            "ellipsoid": "height",
            "satellites": "numSV",
            "hdop": "hdop",
            "vdop": "vdop",
            "pdop": "pdop",
            "accuracy": "hAcc",
            "altitude_accuracy": "vAcc",
            "speed": "gSpeed",
            "course": "headMot",
        }.items():
            points[field] = fields[other]
        # The UTC of the receiver, and not that of the sample, which is later.
        is_utc = fields["valid"] & UTC_VALID == UTC_VALID
        points["time"][is_utc] = column.datetime[row][is_utc]
        kind, flags = fields["fixtype"], fields["flags"]
        is_estimated = (kind == GnssFixType.DEAD_RECKONING) & (flags & GNSS_FIX_OK > 0)
        is_fixed = has_fix(fields) | is_estimated
        points["fix"][is_fixed] = FIX_TYPES[kind[is_fixed]]
        points["fix"][is_fixed & (flags & DIFFERENTIAL > 0)] = FIXES.index("dgps")
        carrier = flags >> GNSS_CARRIER_BIT
        points["quality"] = np.where(flags & GNSS_CORRECTED, GGA_DIFFERENTIAL, GGA_FIX)
        points["quality"][carrier > 0] = GGA_RTK[carrier[carrier > 0]]
        points["quality"][is_estimated & (carrier == 0)] = GGA_ESTIMATED
        return Rows(column.sample[row], points, is_fixed)


def extra_texts(name: str, points: Points) -> list[str]:
    """Returns one of the fields that not every log has, as text; empty if it is not known."""
    if name == "fix":
        return [FIXES[fix] for fix in points["fix"].tolist()]
    return formatted("%d", points[name]) if name == "satellites" else shortest(points[name])


def _last_of_samples(sample: npt.NDArray[np.int64]) -> npt.NDArray[np.intp]:
    """Returns the rows that are the last of their sample."""
    return np.flatnonzero(np.diff(sample, append=-1) != 0)


def positions_of(names: Container[object], source: Source | None) -> Positions | None:
    """Returns the positions of a source, or the first that these quantities have; None without any."""
    found = (one for one in (_Filter(), _Gnss()) if source in (None, one.name))
    return next((one for one in found if one.position(names) is not None), None)
