"""Rates: rows per second, as measured and as the device is set."""

from __future__ import annotations

import copy
import itertools
import math
import operator
from collections.abc import Hashable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from xbus.log.runs import PartRuns

__all__ = ["Rates", "SharedRates"]

#: Share of the shortest intervals among which no sample was lost, in a log without packet counter.
SHORTEST = 0.05
#: An interval that is off the usual one by more than this factor is not of the same rate.
TOLERANCE = 1.5
#: Maximum number of different intervals that are counted exactly.
MAX_INTERVALS = 1 << 16
#: Intervals in us from which on a clock is damaged, rather than a row late.
MAX_INTERVAL = 2.0**62


class _Intervals:
    """Counts the rows by the interval to the previous one, in us.

    If there are more than `MAX_INTERVALS` different ones, which no regular rate has, they are rounded
    to 12 bits.

    Attributes:
        us: The different intervals, ascending, ``(k,)``.
        rows: Number of rows with each.
    """

    def __init__(self) -> None:
        self.us = np.empty(0, np.int64)
        self.rows = np.empty(0, np.int64)
        self._is_rounded = False

    def add(self, us: npt.NDArray[np.int64], rows: npt.NDArray[np.int64]) -> None:
        """Adds different intervals, and the number of rows with each."""
        if len(us):
            self._count(np.concatenate((self.us, us)), np.concatenate((self.rows, rows)))
        if len(self.us) > MAX_INTERVALS and not self._is_rounded:
            self._is_rounded = True
            self._count(self.us, self.rows)

    def _count(self, us: npt.NDArray[np.int64], rows: npt.NDArray[np.int64]) -> None:
        if self._is_rounded:
            _, exponent = np.frexp(us.astype(np.float64))
            unit = np.int64(1) << np.maximum(exponent - 12, 0).astype(np.int64)
            us = us // unit * unit
        self.us, place = np.unique(us, return_inverse=True)
        self.rows = np.bincount(place, rows).astype(np.int64)

    def quantile(self, rank: float) -> int:
        """Returns the interval of the row with this number, in the order of intervals."""
        at = np.searchsorted(np.cumsum(self.rows), rank, side="right")
        return int(self.us[min(int(at), len(self.us) - 1)])

    def usual_rate(self) -> float:
        """Returns the rate of the usual interval: the mean of those next to the median; NaN without rows."""
        if not len(self.us) or not (median := self.quantile(int(self.rows.sum()) / 2)):
            return float("nan")
        is_usual = (self.us > median / TOLERANCE) & (self.us < median * TOLERANCE)
        us, rows = self.us[is_usual].tolist(), self.rows[is_usual].tolist()
        mean: float = sum(map(operator.mul, us, rows)) / sum(rows)
        # Time stamps have a resolution of 0.1 ms, so a rate is known to about three digits.
        return round(1e6 / mean, 1 if mean < 1e5 else 3)

    def up_to(self, us: float) -> _Intervals:
        """Returns the intervals that are no longer than this."""
        found = _Intervals()
        found.us, found.rows = self.us[self.us <= us], self.rows[self.us <= us]
        return found


#: The stamped rows of a run: their number, the first and the last time stamp, and the losses before the last.
_RUN = np.dtype([("run", "i8"), ("rows", "i8"), ("first", "f8"), ("last", "f8"), ("lost", "i8")])


class Rates:
    """The rates of rows, added part by part. Only time inside runs counts."""

    def __init__(self) -> None:
        #: The runs that can go on.
        self._open = np.empty(0, _RUN)
        #: Of the other runs, the intervals and the seconds.
        self._steps = 0
        self._seconds: list[npt.NDArray[np.float64]] = []
        #: Intervals: all; without loss; by the counter.
        self._all, self._intact, self._counted = _Intervals(), _Intervals(), _Intervals()
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
        stamps = time[samples]
        is_known = np.isfinite(stamps)
        if not is_known.all():
            samples, stamps = samples[is_known], stamps[is_known]
        if len(samples):
            self._add_stamped(runs.run[samples], stamps, runs.lost[samples])
        self._close(runs.present)

    def _add_stamped(
        self,
        run: npt.NDArray[np.int64],
        time: npt.NDArray[np.float64],
        lost: npt.NDArray[np.int64],
    ) -> None:
        """Adds rows with time stamps, each run after its last row so far."""
        known = self._open
        run = np.concatenate((known["run"], run))
        time = np.concatenate((known["last"], time))
        lost = np.concatenate((known["lost"], lost))
        if np.any(run[1:] < run[:-1]):
            order = np.argsort(run, kind="stable")
            run, time, lost = run[order], time[order], lost[order]
        starts = np.flatnonzero(np.diff(run, prepend=-1))
        ends = np.append(starts[1:], len(run)) - 1
        found = np.empty(len(starts), _RUN)
        found["run"], found["rows"], found["first"] = run[starts], ends - starts + 1, time[starts]
        found["last"], found["lost"] = time[ends], lost[ends]
        earlier = np.searchsorted(found["run"], known["run"])
        found["rows"][earlier] += known["rows"] - 1
        found["first"][earlier] = known["first"]
        self._open = found

        is_same = run[1:] == run[:-1]
        intervals = np.rint(np.diff(time) * 1e6)
        # A step that no integer has is damage.
        is_ahead = is_same & (intervals > 0) & (intervals < MAX_INTERVAL)
        intervals, missing = intervals[is_ahead].astype(np.int64), np.diff(lost)[is_ahead]
        different = intact = counted = np.unique(intervals, return_counts=True)
        if missing.any():
            intact = np.unique(intervals[missing == 0], return_counts=True)
            counted = np.unique(intervals // (1 + missing), return_counts=True)
        self._all.add(*different)
        self._intact.add(*intact)
        self._counted.add(*counted)

    def _close(self, present: Sequence[int]) -> None:
        """Keeps only the sums of the runs that cannot go on."""
        goes_on = np.isin(self._open["run"], present)
        steps, seconds = _spans(self._open[~goes_on])
        self._steps += steps
        if len(seconds):
            self._seconds.append(seconds)
        self._open = self._open[goes_on]

    @property
    def mean(self) -> float:
        """Rows per second; NaN for fewer than two time stamps in each run."""
        steps, seconds = _spans(self._open)
        total = math.fsum(itertools.chain(*self._seconds, seconds))  # the same in any order
        return (self._steps + steps) / total if total else float("nan")

    def nominal(self, samples: int, *, has_counter: bool) -> float:
        """Returns the rows per second between which no sample is missing; NaN if not known.

        Args:
            samples: Number of samples of the devices, with and without a row.
            has_counter: Whether samples have a packet counter, without which losses are not known.
        """
        if has_counter and len(self._intact.us):
            return self._intact.usual_rate()
        if has_counter and self._rows == samples:
            return self._counted.usual_rate()
        # Losses are not known, but among the shortest intervals there are few.
        if not (total := int(self._all.rows.sum())):
            return float("nan")
        shortest = self._all.quantile(SHORTEST * total)
        return self._all.up_to(TOLERANCE * shortest).usual_rate()


class SharedRates:
    """The rates of several series of rows, such as quantities, added part by part.

    Most quantities have a row in each sample. Series that had the same rows up to now share one `Rates`.
    Once they differ, each has its own.
    """

    def __init__(self) -> None:
        self._rates: dict[Hashable, Rates] = {}

    def __getitem__(self, name: Hashable) -> Rates:
        """Returns the rates of a series."""
        return self._rates[name]

    def add(
        self,
        runs: PartRuns,
        series: Mapping[Hashable, npt.NDArray[np.int64]],
        time: npt.NDArray[np.float64],
    ) -> None:
        """Adds the rows of a part.

        Args:
            runs: As in `Rates.add`.
            series: The sample of each row, by the name of the series.
            time: As in `Rates.add`.
        """
        new = Rates()
        groups: dict[Rates, list[tuple[npt.NDArray[np.int64], list[Hashable]]]] = {}
        for name, samples in series.items():
            known = groups.setdefault(self._rates.get(name, new), [])
            names = next((names for same, names in known if np.array_equal(same, samples)), None)
            if names is None:
                known.append((samples, [name]))
            else:
                names.append(name)
        others = {rates for name, rates in self._rates.items() if name not in series}
        for rates, known in groups.items():
            copies = [copy.deepcopy(rates) for _ in known[1:]]
            own = copy.deepcopy(rates) if rates in others else rates
            for each, (samples, names) in zip((own, *copies), known, strict=True):
                each.add(runs, samples, time)
                self._rates |= dict.fromkeys(names, each)


def _spans(runs: npt.NDArray[Any]) -> tuple[int, npt.NDArray[np.float64]]:
    """Returns the number of intervals in runs, and the seconds of each; runs of no time do not count."""
    seconds = runs["last"] - runs["first"]
    return int((runs["rows"] - 1)[seconds > 0].sum()), seconds[seconds > 0]
