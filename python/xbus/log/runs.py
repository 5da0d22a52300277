"""The runs of the devices of a log, part by part.

A run is the samples of one device between two of its restarts.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from xbus import _core
from xbus.log.arrays import read_only
from xbus.protocol.tables import RECEIVER, device_of

__all__ = ["PartRuns", "Run", "Runs", "recorded", "steady_time"]

RUN = np.dtype(
    [("bid", "u1"), ("first", "i8"), ("last", "i8"), ("start", "f8"), ("duration", "f8")]
)


def steady_time(part: _core.Part) -> npt.NDArray[np.float64]:
    """Returns the time of each sample, ``(N,)``; NaN for those of the GNSS receiver, which has its own."""
    time = part.time.copy()
    for column in part.columns:
        if column.name in RECEIVER:
            time[column.sample - part.first] = np.nan
    return time


class Span:
    """The earliest and the latest time stamp, and the number of time stamps."""

    def __init__(self) -> None:
        self.start = self.end = float("nan")
        self.stamps = 0

    def add(self, stamps: npt.NDArray[np.float64]) -> None:
        """Adds time stamps, in any order."""
        if len(stamps):
            self.start = float(np.fmin(self.start, stamps.min()))
            self.end = float(np.fmax(self.end, stamps.max()))
            self.stamps += len(stamps)

    @property
    def duration(self) -> float:
        """Seconds; NaN for fewer than two time stamps."""
        return self.end - self.start if self.stamps > 1 else float("nan")


@dataclass
class Run:
    """The samples of one device between two of its restarts.

    Attributes:
        bid: BID of the device, as in its first sample.
        first: Index of the first sample.
        last: Index of the last sample.
        samples: Number of samples.
        lost: Number of samples that are missing.
    """

    bid: int
    first: int
    last: int
    samples: int = 0
    lost: int = 0
    _steady: Span = field(default_factory=Span)
    _receiver: Span = field(default_factory=Span)

    @property
    def span(self) -> Span:
        """Time stamps of the receiver count only if there are no others: without a fix they are arbitrary."""
        return self._steady if self._steady.stamps else self._receiver

    def add_times(self, steady: npt.NDArray[np.float64], time: npt.NDArray[np.float64]) -> None:
        """Adds the times of samples, and the same with NaN for the samples of the receiver."""
        is_steady = np.isfinite(steady)
        self._steady.add(steady[is_steady])
        self._receiver.add(time[np.isfinite(time) & ~is_steady])


class PartRuns(NamedTuple):
    """The runs that the samples of a part belong to.

    Attributes:
        run: For each sample the number of its run in `Runs.all`, ``(N,)``.
        lost: For each sample the number of samples missing in its run up to it, ``(N,)``.
    """

    run: npt.NDArray[np.int64]
    lost: npt.NDArray[np.int64]


class Runs:
    """The runs of the devices of a log.

    Attributes:
        all: The runs, in the order of their first samples.
    """

    def __init__(self) -> None:
        self.all: list[Run] = []
        #: The number of the present run of each device.
        self._present: dict[int, int] = {}

    def add(self, part: _core.Part) -> PartRuns:
        """Adds the next part of the log, and returns the runs that its samples belong to."""
        size = len(part)
        run, lost = np.zeros(size, np.int64), np.zeros(size, np.int64)
        if not size:
            return PartRuns(run, lost)
        bids = part.bid
        devices = device_of(bids)
        lost[part.gaps.sample - part.first] = part.gaps.lost
        restarts = part.restarts.sample - part.first
        found = []
        for device in np.unique(devices).tolist():
            rows = np.flatnonzero(devices == device)
            starts = restarts[devices[restarts] == device]
            pieces = np.split(rows, np.searchsorted(rows, starts))
            if not len(pieces[0]) or device in self._present:
                head, *pieces = pieces
                self._extend(self._present.get(device), head, run, lost)
            found += [(int(rows[0]), device, rows) for rows in pieces]
        for first, device, rows in sorted(found, key=lambda piece: piece[0]):
            earlier = self._present.get(device)
            bid = int(bids[first]) if earlier is None else self.all[earlier].bid
            self._present[device] = len(self.all)
            self.all.append(Run(bid, part.first + first, part.first + first))
            self._extend(self._present[device], rows, run, lost)
        self._add_times(part, run)
        return PartRuns(run, lost)

    def _extend(
        self,
        number: int | None,
        rows: npt.NDArray[np.intp],
        run: npt.NDArray[np.int64],
        lost: npt.NDArray[np.int64],
    ) -> None:
        """Adds the samples in ``rows`` to a run."""
        if number is None or not len(rows):
            return
        present = self.all[number]
        run[rows] = number
        lost[rows] = present.lost + np.cumsum(lost[rows])
        present.lost = int(lost[rows[-1]])
        present.samples += len(rows)

    def _add_times(self, part: _core.Part, run: npt.NDArray[np.int64]) -> None:
        steady = steady_time(part)
        order = np.argsort(run, kind="stable") if len(self.all) > 1 else np.arange(len(run))
        starts = np.flatnonzero(np.diff(run[order], prepend=-1))
        for rows in np.split(order, starts[1:]):
            present = self.all[int(run[rows[0]])]
            present.last = part.first + int(rows[-1])
            present.add_times(steady[rows], part.time[rows])

    def seconds_before(self) -> list[float]:
        """Returns the seconds that its device recorded before each run."""
        recorded: dict[int, float] = {}
        before = []
        for run in self.all:
            before.append(recorded.get(run.bid, 0.0))
            seconds = run.span.duration if run.span.stamps > 1 else 0.0
            recorded[run.bid] = before[-1] + seconds
        return before

    def of_devices(self) -> dict[int, list[Run]]:
        """Returns the runs of each device, by its BID, in the order of their first samples."""
        devices: dict[int, list[Run]] = {}
        for run in self.all:
            devices.setdefault(run.bid, []).append(run)
        return devices

    @property
    def duration(self) -> float:
        """Seconds recorded: the sum of a device's runs, the longest of several devices; NaN if not known."""
        durations = [recorded(runs) for runs in self.of_devices().values()]
        return max((seconds for seconds in durations if np.isfinite(seconds)), default=np.nan)

    def table(self) -> npt.NDArray[Any]:
        """Returns a structured array of bid, first, last, start and duration, read-only."""
        rows = [
            (run.bid, run.first, run.last, run.span.start, run.span.duration) for run in self.all
        ]
        return read_only(np.array(rows, RUN))


def recorded(runs: Iterable[Run]) -> float:
    """Returns the sum of the durations of runs that have one; NaN if none has."""
    durations = [run.span.duration for run in runs if run.span.stamps > 1]
    return sum(durations) if durations else float("nan")
