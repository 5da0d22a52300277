"""Fewer points: those that are far enough from the previous one, in time and distance."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from xbus.geometry.earth import geodetic_to_ecef

__all__ = ["Thinning"]


class Thinning:
    """Selects points of a track part by part.

    The first point of a segment is kept. Another one is kept if it is at least as far from the last kept
    point as both limits say; a limit in time does not apply to points without a device time.

    Args:
        seconds: Shortest time on the device clock in s, or None.
        metres: Shortest distance in m, or None.
    """

    def __init__(self, seconds: float | None, metres: float | None) -> None:
        self._seconds, self._metres = seconds, metres
        self._last: list[float] = []

    def keep(
        self,
        points: npt.NDArray[Any],
        time: npt.NDArray[np.float64],
        is_start: npt.NDArray[np.bool_],
    ) -> npt.NDArray[np.bool_]:
        """Returns which points to keep.

        Args:
            points: The next points of the track: an array with ``lat`` and ``lon`` in degrees.
            time: Their times on the device clock in s; NaN without a time stamp.
            is_start: Whether they are the first of a segment.
        """
        if self._seconds is None and self._metres is None:
            return np.ones(len(points), np.bool_)
        kept = np.zeros(len(points), np.bool_)
        places = geodetic_to_ecef(points["lat"], points["lon"], 0.0)
        rows = np.column_stack([time, places]).tolist()
        for at, (row, starts) in enumerate(zip(rows, is_start.tolist(), strict=True)):
            if starts or self._is_far(row):
                kept[at] = True
                self._last = row
        return kept

    def _is_far(self, row: list[float]) -> bool:
        time, x, y, z = row
        last, last_x, last_y, last_z = self._last
        # Time stamps have 0.1 ms and are not exact in binary; a NaN is no reason to leave a point out.
        if self._seconds is not None and abs(time - last) < self._seconds - 1e-5:
            return False
        if self._metres is None:
            return True
        square = (x - last_x) ** 2 + (y - last_y) ** 2 + (z - last_z) ** 2
        return square >= self._metres**2
