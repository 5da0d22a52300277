"""Rates: rows per second, as measured and as the device is set."""

from __future__ import annotations

import math
from collections import Counter

import numpy as np
import numpy.typing as npt

from xbus.log.runs import PartRuns

__all__ = ["Rates"]

#: Share of the shortest intervals among which no sample was lost, in a log without packet counter.
SHORTEST = 0.05
#: An interval that is off the usual one by more than this factor is not of the same rate.
TOLERANCE = 1.5


class Rates:
    """The rates of rows, added part by part. Only time inside runs counts."""

    def __init__(self) -> None:
        #: For each run the number of stamped rows and the first and the last time stamp.
        self._stamps: dict[int, list[float]] = {}
        #: For each run the number of missing samples before the last stamped row.
        self._lost: dict[int, int] = {}
        #: Number of rows by the interval to the previous one, in us: all; without loss; by the counter.
        self._all: Counter[int] = Counter()
        self._intact: Counter[int] = Counter()
        self._counted: Counter[int] = Counter()
        self._rows = 0

    def add(
        self,
        runs: PartRuns,
        samples: npt.NDArray[np.int64],
        time: npt.NDArray[np.float64],
    ) -> None:
        """Adds rows.

        Args:
            runs: The runs of the samples of the part.
            samples: The sample of each row, counted from the start of the part, ``(n,)``.
            time: The time of each sample of the part in seconds, ``(N,)``; NaN without a time stamp.
        """
        self._rows += len(samples)
        samples = samples[np.isfinite(time[samples])]
        if not len(samples):
            return
        number = runs.run[samples]
        starts = np.array([0])
        if number.min() != number.max():
            order = np.argsort(number, kind="stable")
            samples, number = samples[order], number[order]
            starts = np.flatnonzero(np.diff(number, prepend=-1))
        for rows in np.split(samples, starts[1:]):
            self._add_run(int(runs.run[rows[0]]), time[rows], runs.lost[rows])

    def _add_run(
        self, number: int, time: npt.NDArray[np.float64], lost: npt.NDArray[np.int64]
    ) -> None:
        stamps = self._stamps.setdefault(number, [0, float(time[0]), 0.0])
        if stamps[0]:
            time = np.concatenate(([stamps[2]], time))
            lost = np.concatenate(([self._lost[number]], lost))
            stamps[0] -= 1
        stamps[0] += len(time)
        stamps[2], self._lost[number] = float(time[-1]), int(lost[-1])
        intervals, missing = np.rint(np.diff(time) * 1e6).astype(np.int64), np.diff(lost)
        is_ahead = intervals > 0
        intervals, missing = intervals[is_ahead], missing[is_ahead]
        _count(self._all, intervals)
        _count(self._intact, intervals[missing == 0])
        _count(self._counted, intervals // (1 + missing))

    @property
    def mean(self) -> float:
        """Rows per second; NaN for fewer than two time stamps in each run."""
        spans = [(rows - 1, last - first) for rows, first, last in self._stamps.values()]
        spans = [(steps, span) for steps, span in spans if span > 0]
        seconds = math.fsum(span for _, span in spans)  # the same in any order
        return sum(steps for steps, _ in spans) / seconds if seconds else float("nan")

    def nominal(self, samples: int, *, has_counter: bool) -> float:
        """Returns the rows per second between which no sample is missing; NaN if not known.

        Args:
            samples: Number of samples of the devices, with and without a row.
            has_counter: Whether samples have a packet counter, without which losses are not known.
        """
        if has_counter and self._intact:
            return _usual_rate(self._intact)
        if has_counter and self._rows == samples:
            return _usual_rate(self._counted)
        # Losses are not known, but among the shortest intervals there are few.
        if not (total := self._all.total()):
            return float("nan")
        shortest = _quantile(self._all, SHORTEST * total)
        return _usual_rate(
            {us: rows for us, rows in self._all.items() if us <= TOLERANCE * shortest}
        )


def _count(counter: Counter[int], intervals: npt.NDArray[np.int64]) -> None:
    values, rows = np.unique(intervals, return_counts=True)
    counter.update(dict(zip(values.tolist(), rows.tolist(), strict=True)))


def _quantile(counts: dict[int, int], rank: float) -> int:
    below = 0
    for interval in sorted(counts):
        below += counts[interval]
        if below > rank:
            break
    return interval


def _usual_rate(counts: dict[int, int]) -> float:
    """Returns the rate of the usual interval: the mean of those next to the median."""
    total = sum(counts.values())
    if not total:
        return float("nan")
    median = _quantile(counts, total / 2)
    if not median:
        return float("nan")
    usual = {
        us: rows for us, rows in counts.items() if median / TOLERANCE < us < median * TOLERANCE
    }
    mean = sum(us * rows for us, rows in usual.items()) / sum(usual.values())
    # Time stamps have a resolution of 0.1 ms, so a rate is known to about three digits.
    return round(1e6 / mean, 1 if mean < 1e5 else 3)
