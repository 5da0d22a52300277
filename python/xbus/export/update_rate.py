"""The rate at which a device is set to send, from the time stamps of all parts of a log."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

__all__ = ["UpdateRate"]

#: Time stamps per second.
TICKS = 10_000
#: Longest interval that counts, in ticks: 100 s.
LONGEST = 1_000_000
#: An interval counts towards the mean if it is off the most frequent one by at most this factor.
TOLERANCE = 1.2


class UpdateRate:
    """The rate of rows, from the most frequent interval between two, and those like it."""

    def __init__(self) -> None:
        self._counts: dict[int, int] = {}
        self._last = np.nan

    def add(self, time: npt.NDArray[np.float64]) -> None:
        """Adds the times of the next rows on the device clock, in s; NaN without a time stamp."""
        if not len(time):
            return
        steps = np.rint(np.diff(time, prepend=self._last) * TICKS)
        self._last = float(time[-1])
        found = np.unique(steps[(steps > 0) & (steps <= LONGEST)], return_counts=True)
        for step, count in zip(*(column.astype(int).tolist() for column in found), strict=True):
            self._counts[step] = self._counts.get(step, 0) + count

    @property
    def value(self) -> float | None:
        """Rows per second; None if they are not known.

        >>> rate = UpdateRate()
        >>> rate.add(np.array([0.0, 0.0167, 0.0333, 0.05, 0.1]))
        >>> round(rate.value, 6)
        60.0
        """
        if not self._counts:
            return None
        usual = max(self._counts, key=lambda step: (self._counts[step], -step))
        near = [step for step in self._counts if usual / TOLERANCE < step < usual * TOLERANCE]
        rows = sum(self._counts[step] for step in near)
        return TICKS * rows / sum(step * self._counts[step] for step in near)
