"""Where a device was, in metres east and north of where it began."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from xbus.geometry.earth import ecef_to_enu, ecef_to_geodetic, geodetic_to_ecef
from xbus.log.column import Column
from xbus.protocol.values import LatLonAlt
from xbus.report.thin import BINS, BoolArray, FloatArray, coarser, thin

__all__ = ["FIXES", "SOURCES", "Track", "has_fix"]

#: Fix types of the receiver with a position (Table 25): 2D, 3D, GNSS and dead reckoning.
FIXES = (2, 3, 4)
#: Quantities that tell where the device is, the best first.
SOURCES = ("lat_lon", "position_ecef", "gnss_pvt_data")
#: Degrees, and metres, beyond which there is no place.
MOST = {"lat_lon": np.array([90.0, 360.0]), "position_ecef": np.full(3, 1e9)}


def has_fix(rows: npt.NDArray[Any]) -> BoolArray:
    """Which rows of ``gnss_pvt_data`` have a position that the receiver calls valid."""
    fixed: BoolArray = np.isin(rows["fixtype"], FIXES) & (rows["flags"] & 1 == 1)
    return fixed


class Track:
    """Positions of one quantity: all while they are few, then the extremes of each bin of time.

    Attributes:
        time: Of each position that is kept, s.
        piece: Grows where nothing is to be drawn between a position and the one before.
        rows: How many there were; those that say nothing (no fix, exactly zero, NaN) are not counted.
    """

    def __init__(self) -> None:
        self.time: FloatArray = np.empty(0)
        self.piece: npt.NDArray[np.int64] = np.empty(0, np.int64)
        self.rows = 0
        self._pieces = 0
        self._values: FloatArray | None = None
        self._width = 0.0

    def add(self, column: Column, time: FloatArray, breaks: BoolArray) -> None:
        """Takes in the next rows, at these times; before some of them others are missing."""
        if column.name == "gnss_pvt_data":
            fine = has_fix(column.values)
            values = np.stack([column.scaled["lat"], column.scaled["lon"]], axis=1)
        else:
            values = column.values.astype(np.float64)
            # Zero says a filter that knows of no place yet.
            fine = (np.abs(values) <= MOST[column.name]).all(axis=1) & (values != 0).any(axis=1)
        # So are those that say nothing.
        piece = self._pieces + np.cumsum(breaks | ~fine)
        self._pieces = int(piece[-1]) if len(piece) else self._pieces
        self.rows += int(np.count_nonzero(fine))
        self.piece = np.concatenate((self.piece, piece[fine]))
        self.time = np.concatenate((self.time, time[fine]))
        known = [] if self._values is None else [self._values]
        self._values = np.concatenate([*known, values[fine]])
        self._keep(np.argsort(self.time, kind="stable"))
        if self.rows > 2 * BINS:
            self._width = coarser(self._width, float(self.time[-1] - self.time[0]))
            rows = [thin(self.time, it, self._width) for it in self._values.T]
            self._keep(np.unique(np.concatenate(rows)))

    def _keep(self, rows: npt.NDArray[np.intp]) -> None:
        assert self._values is not None  # noqa: S101 - see `add`
        self.time, self.piece = self.time[rows], self.piece[rows]
        self._values = self._values[rows]

    @property
    def _ecef(self) -> FloatArray:
        assert self._values is not None  # noqa: S101 - see `add`
        if self._values.shape[1] == 3:
            return self._values
        lat, lon = self._values.T
        return geodetic_to_ecef(lat, lon, 0.0)

    @property
    def origin(self) -> LatLonAlt:
        """Where it begins: degrees, and metres above the ellipsoid where they are known."""
        lat, lon, alt = ecef_to_geodetic(self._ecef[0])
        return LatLonAlt(float(lat), float(lon), float(alt))

    def metres(self, origin: LatLonAlt) -> tuple[FloatArray, FloatArray]:
        """Metres east and north of a place, ``(N,)``."""
        east, north, _ = ecef_to_enu(self._ecef, origin).T
        return east, north
