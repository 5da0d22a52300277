"""The pace at which a recording is replayed: by its time stamps."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from xbus.log.log import Log
from xbus.log.runs import steady_time
from xbus.protocol.tables import device_of

__all__ = ["UNSTAMPED_RATE", "ReplayPace"]

#: Samples per second of a recording without time stamps: the default rate of most products (Table 2).
UNSTAMPED_RATE = 100
#: Longest pause in s. The clock of a device that restarted can look as if it had wrapped around.
LONGEST_PAUSE = 10.0


class ReplayPace:
    """Computes when each sample of a recording is due, part by part.

    The time stamps of the first device set the pace. Samples without a stamp, and samples of the GNSS
    receiver and of other devices, whose clocks differ, are due between their neighbours. A step back of the
    clock takes no time. Without stamps, 100 samples are due per second.

    Args:
        longest_pause: Seconds that a longer pause lasts.

    >>> import xbus
    >>> ReplayPace().times(xbus.read_log("tests/captures/walk.mtb"))[:3].round(3).tolist()
    [0.0, 0.01, 0.02]
    """

    def __init__(self, longest_pause: float = LONGEST_PAUSE) -> None:
        self._longest_pause = longest_pause
        self._device: int | None = None
        #: The last time stamp, and when the last stamped sample was due.
        self._stamp = math.nan
        self._time = 0.0
        self._unstamped = 0

    @property
    def is_stamped(self) -> bool:
        """Whether a time stamp was found."""
        return not math.isnan(self._stamp)

    def times(self, part: Log) -> npt.NDArray[np.float64]:
        """Returns when the samples of the next part are due.

        Args:
            part: The recording, or the part of it that follows the previous one.

        Returns:
            Seconds since the first sample of the recording, ``(N,)``; never descending.
        """
        if not len(part):
            return np.empty(0)
        if self._device is None:
            self._device = device_of(int(part.bid[0]))
        index = np.arange(len(part), dtype=np.float64)
        known = np.isfinite(steady_time(part.core)) & (device_of(part.bid) == self._device)
        rows, stamps = index[known], part.time[known]
        if math.isnan(self._stamp):
            if len(stamps) < 2:
                return self._unstamped_times(index, stamps)
        else:
            rows, stamps = np.append(-1.0, rows), np.append(self._stamp, stamps)
        clock = np.interp(index, rows, stamps)
        first = clock[0] if math.isnan(self._stamp) else self._stamp
        steps = np.diff(clock, prepend=first).clip(0.0, self._longest_pause)
        times = self._time + np.cumsum(steps)
        self._stamp, self._time = float(stamps[-1]), float(times[-1])
        return times

    def _unstamped_times(
        self, index: npt.NDArray[np.float64], stamps: npt.NDArray[np.float64]
    ) -> npt.NDArray[np.float64]:
        """Returns the times of samples before the second stamp, which have no pace yet."""
        times = (self._unstamped + index) / UNSTAMPED_RATE
        self._unstamped += len(index)
        self._time = float(times[-1])
        if len(stamps):
            self._stamp = float(stamps[0])
        return times
