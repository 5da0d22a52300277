"""The hour of each sample: which folder of a partitioned dataset has it."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import numpy.typing as npt

from xbus.log.cutting import TOLERANCE
from xbus.log.log import Log
from xbus.log.pacing import ReplayPace
from xbus.protocol.tables import RECEIVER, UTC_SOURCES, device_of

__all__ = ["HOUR_SOURCES", "Hours", "find_hours"]

#: The quantities that `Hours` needs, if a log has them.
HOUR_SOURCES = (*RECEIVER, *UTC_SOURCES)
HOUR = 3_600_000_000_000
#: Seconds that a recording lasts at most: damaged time stamps must not exceed 64 bits of nanoseconds.
LONGEST = 1e9

Clock = Literal["utc", "host", "recording"]


@dataclass
class Hours:
    """Computes the hour of each sample, part by part.

    Where the clock is not known, the time of the recording continues it: a restart takes no time. So a sample
    is in the hour of the samples around it, whichever device sent it.

    Args:
        clock: UTC, the clock of the recording computer, or the time since the first sample.
        bid: The device whose UTC counts.
        offset: What to add to the time since the first sample before the clock is known first, in ns.
    """

    clock: Clock
    bid: int = 0
    offset: int = 0
    _pace: ReplayPace = field(default_factory=lambda: ReplayPace(math.inf))

    def of_samples(self, part: Log) -> npt.NDArray[np.int64]:
        """Returns the hour of each sample of the next part since 1970 or the first sample, ``(N,)``."""
        times = _nanoseconds(self._pace.times(part))
        offsets = np.full(len(part), self.offset)
        known, clock = _clock(self.clock, part, self.bid)
        rows = np.flatnonzero(known)
        if len(rows):
            last = np.searchsorted(rows, np.arange(len(part)), "right") - 1
            offsets = np.where(last < 0, self.offset, (clock - times)[rows[last]])
            self.offset = int(offsets[-1])
        return np.asarray((times + offsets) // HOUR, np.int64)

    def folder(self, hour: int) -> str:
        """Returns the path of the folder of an hour, relative to that of the dataset.

        >>> Hours("utc").folder(498081), Hours("recording").folder(12)
        ('date=2026-10-27/hour=09', 'hour=0012')
        """
        if self.clock == "recording":
            return f"hour={hour:04}"
        date = np.datetime64(hour // 24, "D")
        return f"date={date}/hour={hour % 24:02}"


def find_hours(parts: Iterable[Log], clock: Clock) -> Hours:
    """Returns the hours of a log, by UTC, else by the clock of the recording computer, else since its start.

    Args:
        parts: The parts of the log, with the quantities in `HOUR_SOURCES`, as far as the clock is not known.
        clock: The best clock that the log may have.
    """
    pace = ReplayPace(math.inf)
    for part in parts:
        times = _nanoseconds(pace.times(part))
        known, values = _clock(clock, part, None)
        if known.any():
            row = int(np.argmax(known))
            return Hours(clock, int(device_of(part.bid)[row]), int(values[row] - times[row]))
    return Hours("recording")


def _nanoseconds(seconds: npt.NDArray[np.float64]) -> npt.NDArray[np.int64]:
    return np.rint((np.minimum(seconds, LONGEST) + TOLERANCE) * 1e9).astype(np.int64)


def _clock(
    clock: Clock, part: Log, bid: int | None
) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.int64]]:
    """Returns which samples have a time on a clock, and the times in ns since 1970.

    Args:
        clock: The clock.
        part: The samples.
        bid: The device whose clock counts, or None for any.
    """
    if clock == "recording":
        return np.zeros(len(part), np.bool_), np.zeros(len(part), np.int64)
    if clock == "utc":
        known, values = ~np.isnat(part.utc), part.utc.astype(np.int64)
    else:
        known = np.isfinite(part.host_time)
        values = (np.where(known, part.host_time, 0.0) * 1e9).astype(np.int64)
    for name in RECEIVER:  # its samples come late
        if name in part:
            known[part[name].sample - part.first_sample] = False
    return known if bid is None else known & (device_of(part.bid) == bid), values
