"""The times of samples on the timelines of a rerun recording."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from xbus.export.part import Part
from xbus.extras import require

__all__ = ["TIMELINES", "Clock", "Times"]

#: Rows that are sent at once: few enough for the caches of the sender, and for the viewer to search.
ROWS = 1 << 15
#: The longest time in s whose nanoseconds fit into 64 bits.
MAX_TIME = 9.2e9
#: The timelines, beside the index of the sample, and the argument of `rerun.TimeColumn`.
TIMELINES = {"device_time": "duration", "utc": "timestamp", "host_time": "timestamp"}

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
Rows = IntArray | slice


class Clock:
    """The clock of a device, without the steps back of restarts, part by part.

    Attributes:
        shift: What is added to the clock at present, in s.
    """

    def __init__(self) -> None:
        self.shift = 0.0
        self._end = -np.inf
        self._has_restarted = False

    def shifted(
        self, time: FloatArray, starts: IntArray
    ) -> tuple[FloatArray, list[tuple[int, float]]]:
        """Returns times that do not overlap with those before a restart, and where the shift changes.

        Args:
            time: Time stamps of the next samples, ``(n,)``; NaN if unknown.
            starts: Rows with which the device begins again.

        Returns:
            The times, and for each change of `shift` the row and the new value.
        """
        shifted, changes = np.empty(len(time)), []
        edges = [0, *starts.tolist(), len(time)]
        for number, (start, end) in enumerate(pairwise(edges)):
            self._has_restarted |= number > 0
            known = start + np.flatnonzero(~np.isnan(time[start:end]))
            if len(known):
                first = float(time[known[0]])
                if self._has_restarted and first + self.shift < self._end:
                    self.shift = self._end - first
                    changes.append((int(known[0]), self.shift))
                self._has_restarted = False
                self._end = max(self._end, float(time[known].max()) + self.shift)
            shifted[start:end] = time[start:end] + self.shift
        return shifted, changes


class Times:
    """The time of each sample on the timelines on which it has one.

    Args:
        first: Index of the first sample.
        nanoseconds: For each of `TIMELINES` nanoseconds, with NaT where unknown.
    """

    def __init__(self, first: int, nanoseconds: dict[str, npt.NDArray[Any]]) -> None:
        self.first, self._nanoseconds = first, nanoseconds
        #: A bit for each timeline on which a sample has a time.
        self._known = sum(
            (~np.isnat(time)).astype(np.uint8) << bit
            for bit, time in enumerate(nanoseconds.values())
        )

    @classmethod
    def of(cls, part: Part, device_time: FloatArray) -> Times:
        """Returns the times of the samples of a part.

        Args:
            part: The part.
            device_time: Times of its samples, as `Clock` returns them.
        """
        return cls(
            part.first_sample,
            {
                "device_time": _nanoseconds(device_time).view("m8[ns]"),
                "utc": part.utc,
                "host_time": _nanoseconds(part.host_time).view("M8[ns]"),
            },
        )

    @property
    def last(self) -> Times:
        """The times of the last sample alone."""
        last = {name: time[-1:].copy() for name, time in self._nanoseconds.items()}
        return Times(self.first + len(self._known) - 1, last)

    @property
    def end(self) -> int:
        """The index after that of the last sample."""
        return self.first + len(self._known)

    def columns(self, samples: IntArray) -> Iterator[tuple[Rows, list[Any]]]:
        """Yields rows with times on the same timelines, a limited number at once, and their time columns.

        Args:
            samples: The index of the sample of each row.
        """
        rr = require("rerun", "rerun", "to write for the rerun viewer")
        for start in range(0, len(samples), ROWS):
            chunk = samples[start : start + ROWS]
            known = self._known[chunk - self.first]
            for kind in np.unique(known).tolist():
                own = np.flatnonzero(known == kind)
                index = chunk[own]
                times = [rr.TimeColumn("sample", sequence=index)]
                for bit, (name, argument) in enumerate(TIMELINES.items()):
                    if kind >> bit & 1:
                        values = self._nanoseconds[name][index - self.first]
                        times.append(rr.TimeColumn(name, **{argument: values}))
                is_whole = len(own) == len(chunk)
                yield slice(start, start + len(chunk)) if is_whole else start + own, times


def _nanoseconds(seconds: FloatArray) -> IntArray:
    """Returns nanoseconds; those of NaT where the seconds are unknown or too large."""
    with np.errstate(invalid="ignore"):
        known = np.abs(seconds) < MAX_TIME
    nat = np.datetime64("NaT", "ns").astype(np.int64)
    return np.where(known, np.round(np.where(known, seconds, 0.0) * 1e9).astype(np.int64), nat)
