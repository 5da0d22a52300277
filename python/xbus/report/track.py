"""The track of a device, in metres east and north of its start."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from xbus.export.valid import has_fix, has_position
from xbus.geometry.earth import ecef_to_enu, ecef_to_geodetic, geodetic_to_ecef
from xbus.log.column import Column
from xbus.log.log import Log
from xbus.plots.thin import BINS, BoolArray, FloatArray, bin_width, thin
from xbus.protocol.values import LatLonAlt

__all__ = ["SOURCES", "Track"]

#: Quantities with a position, the best first.
SOURCES = ("lat_lon", "position_ecef", "gnss_pvt_data")


class Track:
    """The positions of one quantity; long tracks keep only the extremes of each time bin.

    Attributes:
        time: Times of the kept positions, s.
        piece: Number of the piece of each position; there is no line between pieces.
        rows: Number of valid positions. A position without a fix, exactly zero or NaN is not valid.
    """

    def __init__(self) -> None:
        self.time: FloatArray = np.empty(0)
        self.piece: npt.NDArray[np.int64] = np.empty(0, np.int64)
        self.rows = 0
        self._pieces = 0
        self._values: FloatArray | None = None
        self._width = 0.0

    def add(self, part: Log, column: Column, time: FloatArray, breaks: BoolArray) -> None:
        """Adds the next rows.

        Args:
            part: The log of one device that they are from.
            column: The rows.
            time: Their times, ``(N,)``, s.
            breaks: Whether rows are missing before each row, ``(N,)``.
        """
        if column.name == "gnss_pvt_data":
            valid = has_fix(column.values)
            values = np.stack([column.scaled["lat"], column.scaled["lon"]], axis=1)
        else:
            valid = has_position(part, column)
            values = column.values.astype(np.float64)
        # An invalid position ends a piece as well.
        piece = self._pieces + np.cumsum(breaks | ~valid)
        self._pieces = int(piece[-1]) if len(piece) else self._pieces
        self.rows += int(np.count_nonzero(valid))
        self.piece = np.concatenate((self.piece, piece[valid]))
        self.time = np.concatenate((self.time, time[valid]))
        known = [] if self._values is None else [self._values]
        self._values = np.concatenate([*known, values[valid]])
        self._keep(np.argsort(self.time, kind="stable"))
        if self.rows > 2 * BINS:
            self._width = bin_width(self._width, float(self.time[-1] - self.time[0]))
            rows = [thin(self.time, axis, self._width) for axis in self._values.T]
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
    def degrees(self) -> tuple[FloatArray, FloatArray]:
        """Latitude and longitude, both ``(N,)``."""
        lat, lon, _ = ecef_to_geodetic(self._ecef)
        return lat, lon

    @property
    def origin(self) -> LatLonAlt:
        """The first position: degrees, and metres above the ellipsoid if known."""
        lat, lon, alt = ecef_to_geodetic(self._ecef[0])
        return LatLonAlt(float(lat), float(lon), float(alt))

    def metres(self, origin: LatLonAlt) -> tuple[FloatArray, FloatArray]:
        """Returns metres east and north of ``origin``, both ``(N,)``."""
        east, north, _ = ecef_to_enu(self._ecef, origin).T
        return east, north
