"""The runs of the devices of a log, part by part.

A run is the samples of one device between two of its restarts.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from xbus import _core
from xbus.log.arrays import read_only
from xbus.protocol.tables import RECEIVER, device_of

__all__ = ["DeviceRuns", "PartRuns", "Runs", "steady_time"]

RUN = np.dtype(
    [("bid", "u1"), ("first", "i8"), ("last", "i8"), ("start", "f8"), ("duration", "f8")]
)
#: Earliest and latest time stamp, and the number of time stamps.
SPAN = np.dtype([("start", "f8"), ("end", "f8"), ("stamps", "i8")])
#: What is kept of a run. ``bid`` is that of the first sample of the device.
STATE = np.dtype(
    [
        ("bid", "u1"),
        ("first", "i8"),
        ("last", "i8"),
        ("samples", "i8"),
        ("lost", "i8"),
        ("steady", SPAN),
        ("receiver", SPAN),
    ]
)


def steady_time(part: _core.Part) -> npt.NDArray[np.float64]:
    """Returns the time of each sample, ``(N,)``; NaN for those of the GNSS receiver, which has its own."""
    time = part.time.copy()
    for column in part.columns:
        if column.name in RECEIVER:
            time[column.sample - part.first] = np.nan
    return time


class PartRuns(NamedTuple):
    """The runs that the samples of a part belong to.

    Attributes:
        run: For each sample the number of its run in `Runs.table`, ``(N,)``.
        lost: For each sample the number of samples missing in its run up to it, ``(N,)``.
        present: The last run of each device, up to the end of the part.
    """

    run: npt.NDArray[np.int64]
    lost: npt.NDArray[np.int64]
    present: tuple[int, ...]


class DeviceRuns(NamedTuple):
    """What the runs of one device add up to.

    Attributes:
        samples: Number of samples.
        lost: Number of samples that are missing within runs.
        duration: Seconds recorded; NaN if not known.
        before: Seconds that were recorded before each run, ``(n,)``.
    """

    samples: int
    lost: int
    duration: float
    before: npt.NDArray[np.float64]


class Runs:
    """The runs of the devices of a log, in the order of their first samples. A run takes about 90 bytes."""

    def __init__(self) -> None:
        self._rows = np.zeros(4, STATE)
        self._size = 0
        #: The number of the present run of each device.
        self._present: dict[int, int] = {}

    def __len__(self) -> int:
        return self._size

    def add(self, part: _core.Part) -> PartRuns:
        """Adds the next part of the log, and returns the runs that its samples belong to."""
        size = len(part)
        if _is_one_run(part):
            return self._add_one_run(part, part.devices[0][0])
        run, lost = np.zeros(size, np.int64), np.zeros(size, np.int64)
        if not size:
            return PartRuns(run, lost, tuple(self._present.values()))
        bids = part.bid
        devices = device_of(bids)
        lost[part.gaps.sample - part.first] = part.gaps.lost
        begins = np.zeros(size, np.bool_)
        begins[part.restarts.sample - part.first] = True
        found, first = np.unique(devices, return_index=True)
        begins[
            [row for device, row in zip(found, first, strict=True) if device not in self._present]
        ] = True
        numbers = self._size - 1 + np.cumsum(begins)
        self._append(bids, devices, np.flatnonzero(begins))
        for device in found.tolist():
            rows = np.flatnonzero(devices == device) if len(found) > 1 else slice(None)
            own = np.where(begins[rows], numbers[rows], -1)
            run[rows] = np.maximum(np.maximum.accumulate(own), self._present.get(device, -1))
            self._present[device] = int(run[rows][-1])
        self._count(part, run, lost)
        return PartRuns(run, lost, tuple(self._present.values()))

    def _add_one_run(self, part: _core.Part, bid: int) -> PartRuns:
        """Adds a part whose samples belong to one run, the first one with this BID.

        The result is that of `add`, with less work.
        """
        device = device_of(bid)
        if device not in self._present:
            bids = np.array([bid], np.uint8)
            self._append(bids, device_of(bids), np.zeros(1, np.intp))
            self._present[device] = self._size - 1
        number, size = self._present[device], len(part)
        row = self._rows[number]
        lost = np.full(size, row["lost"], np.int64)
        if len(part.gaps.sample):
            steps = np.zeros(size, np.int64)
            steps[part.gaps.sample - part.first] = part.gaps.lost
            lost += np.cumsum(steps)
        row["first"] = part.first if row["first"] < 0 else row["first"]
        row["last"], row["lost"] = part.first + size - 1, lost[-1]
        row["samples"] += size
        if any(column.name in RECEIVER for column in part.columns):
            steady, time = steady_time(part), part.time
            is_steady = np.isfinite(steady)
            _extend_one(row["steady"], *_span_of(steady[is_steady]))
            _extend_one(row["receiver"], *_span_of(time[np.isfinite(time) & ~is_steady]))
        else:
            earliest, latest, known, _ = part.time_span
            _extend_one(row["steady"], earliest, latest, known)
        return PartRuns(np.full(size, number, np.int64), lost, tuple(self._present.values()))

    def _append(
        self,
        bids: npt.NDArray[np.uint8],
        devices: npt.NDArray[np.uint8],
        first: npt.NDArray[np.intp],
    ) -> None:
        """Adds empty runs that begin at these samples of a part."""
        size = self._size + len(first)
        if size > len(self._rows):
            rows = np.zeros(max(size, 2 * len(self._rows)), STATE)
            rows[: self._size] = self._rows[: self._size]
            self._rows = rows
        new = self._rows[self._size : size]
        own = bids[first]
        for device in set(devices[first].tolist()):
            is_own = devices[first] == device
            known = self._present.get(device)
            own[is_own] = own[is_own][0] if known is None else self._rows["bid"][known]
        new["bid"], new["first"] = own, -1
        for span in ("steady", "receiver"):
            new[span]["start"] = new[span]["end"] = np.nan
        self._size = size

    def _count(
        self, part: _core.Part, run: npt.NDArray[np.int64], lost: npt.NDArray[np.int64]
    ) -> None:
        """Adds the samples of a part to their runs, and adds up the losses within each run."""
        order = np.argsort(run, kind="stable") if np.any(run[1:] < run[:-1]) else slice(None)
        of_rows = run[order]
        starts = np.flatnonzero(np.diff(of_rows, prepend=-1))
        ends = np.append(starts[1:], len(of_rows)) - 1
        rows = self._rows[of_rows[starts]]
        total = np.cumsum(lost[order])
        before = rows["lost"] - total[starts] + lost[order][starts]
        lost[order] = total + np.repeat(before, ends - starts + 1)
        samples = part.first + np.arange(len(run))[order]
        rows["first"] = np.where(rows["first"] < 0, samples[starts], rows["first"])
        rows["last"], rows["lost"] = samples[ends], lost[order][ends]
        rows["samples"] += ends - starts + 1
        steady, time = steady_time(part)[order], part.time[order]
        is_steady = np.isfinite(steady)
        _extend(rows["steady"], steady, is_steady, starts)
        _extend(rows["receiver"], time, np.isfinite(time) & ~is_steady, starts)
        self._rows[of_rows[starts]] = rows

    @property
    def rows(self) -> npt.NDArray[Any]:
        """What is known of each run: a structured array of bid, samples, lost, and more."""
        return self._rows[: self._size]

    @property
    def spans(self) -> npt.NDArray[Any]:
        """The time stamps of each run: a structured array of start, end and stamps.

        Those of the receiver count only if there are no others: without a fix they are arbitrary.
        """
        rows = self.rows
        spans = rows["steady"].copy()
        others = spans["stamps"] == 0
        spans[others] = rows["receiver"][others]
        return spans

    @property
    def durations(self) -> npt.NDArray[np.float64]:
        """Seconds of each run; NaN for fewer than two time stamps."""
        spans = self.spans
        return np.where(spans["stamps"] > 1, spans["end"] - spans["start"], np.nan)

    def seconds_before(self) -> npt.NDArray[np.float64]:
        """Returns the seconds that its device recorded before each run."""
        before = np.empty(len(self))
        found = self.devices().values()
        for numbers, device in zip(self.of_devices().values(), found, strict=True):
            before[numbers] = device.before
        return before

    def devices(self) -> dict[int, DeviceRuns]:
        """Returns the sums of the runs of each device, by its BID, in the order of their first samples."""
        samples, lost, durations = self.rows["samples"], self.rows["lost"], self.durations
        return {
            bid: DeviceRuns(
                int(samples[own].sum()),
                int(lost[own].sum()),
                _recorded(durations[own]),
                np.concatenate(([0.0], np.nancumsum(durations[own])[:-1])),
            )
            for bid, own in self.of_devices().items()
        }

    def of_devices(self) -> dict[int, npt.NDArray[np.intp]]:
        """Returns the numbers of the runs of each device, by its BID, in the order of their first samples."""
        bids = self.rows["bid"]
        return {bid: np.flatnonzero(bids == bid) for bid in dict.fromkeys(bids.tolist())}

    @property
    def duration(self) -> float:
        """Seconds recorded: the sum of a device's runs, the longest of several devices; NaN if not known."""
        durations = [device.duration for device in self.devices().values()]
        return max((seconds for seconds in durations if math.isfinite(seconds)), default=math.nan)

    def table(self) -> npt.NDArray[Any]:
        """Returns a structured array of bid, first, last, start and duration, read-only."""
        table = np.empty(self._size, RUN)
        for name in ("bid", "first", "last"):
            table[name] = self.rows[name]
        table["start"], table["duration"] = self.spans["start"], self.durations
        return read_only(table)


def _is_one_run(part: _core.Part) -> bool:
    """Returns whether all samples of a part belong to one run."""
    return not len(part.restarts.sample) and len(part.devices) == 1


def _recorded(durations: npt.NDArray[np.float64]) -> float:
    """Returns the sum of the durations of runs that have one; NaN if none has."""
    known = durations[np.isfinite(durations)]
    return float(np.cumsum(known)[-1]) if len(known) else math.nan


def _span_of(stamps: npt.NDArray[np.float64]) -> tuple[float, float, int]:
    """Returns the earliest and the latest time stamp, NaN without any, and their number."""
    if not len(stamps):
        return math.nan, math.nan, 0
    return float(stamps.min()), float(stamps.max()), len(stamps)


def _extend_one(span: Any, earliest: float, latest: float, stamps: int) -> None:
    """Adds time stamps to one span."""
    span["start"] = np.fmin(span["start"], earliest)
    span["end"] = np.fmax(span["end"], latest)
    span["stamps"] += stamps


def _extend(
    spans: npt.NDArray[Any],
    time: npt.NDArray[np.float64],
    counts: npt.NDArray[np.bool_],
    starts: npt.NDArray[np.intp],
) -> None:
    """Adds time stamps to spans.

    Args:
        spans: The spans.
        time: Times of samples.
        counts: Whether each of them is a time stamp of its span.
        starts: Where the samples of each span begin.
    """
    stamps = np.where(counts, time, np.nan)
    spans["start"] = np.fmin(spans["start"], np.fmin.reduceat(stamps, starts))
    spans["end"] = np.fmax(spans["end"], np.fmax.reduceat(stamps, starts))
    spans["stamps"] += np.add.reduceat(counts.astype(np.int64), starts)
