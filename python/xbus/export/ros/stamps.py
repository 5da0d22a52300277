"""The times of messages: one time base for a whole file.

It is the best that a sample of the log has: UTC, otherwise the clock of the host, otherwise that of the
device. A sample with a time of the base has that time. Any other sample has that of the last one with such a
time, plus what has passed since on the clock of the device; before the first one, less what passes until it.
A time that does not agree with the one before counts for its sample only, until the next one agrees with it.

A run without any time of the base, after a restart or of another device, is joined to the sample before its
first one, as if no time had passed between the two. Runs before the first known one are joined to it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Literal, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from xbus.export.part import Part
from xbus.export.ros.measured import columns_of
from xbus.protocol.tables import RECEIVER, UTC_SOURCES, device_of

__all__ = ["TIME_QUANTITIES", "Base", "Stamps", "TimeBase"]

#: The quantities that decide times, and those of the receiver, whose clock differs.
TIME_QUANTITIES = tuple(dict.fromkeys((*UTC_SOURCES, *RECEIVER)))

Base: TypeAlias = Literal["utc", "host", "device", "none"]
Times = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]

#: Messages have seconds since 1970 as a signed number of 32 bits.
END = 2**31 * 10**9
#: Times that differ by no more than this agree, in ns. A sample of the GNSS receiver without a fix has an
#: arbitrary device time; a damaged frame can pass its checksum and have any time.
NEAR = 10**9
UNKNOWN = np.iinfo(np.int64).min


class _Segment(NamedTuple):
    """The samples of one run in a part.

    Attributes:
        run: Number of the run in the log.
        rows: Indices of the samples in the part, rising.
        time: Their times on the device clock in ns.
        is_known: Whether a sample has one that is not arbitrary.
    """

    run: int
    rows: npt.NDArray[np.intp]
    time: Times
    is_known: Mask


class _Runs:
    """Numbers the runs of the devices, part by part."""

    def __init__(self) -> None:
        self._present: dict[int, int] = {}
        #: The last time of each run that is not of the receiver.
        self._last: dict[int, int] = {}
        self.count = 0

    def segments(self, part: Part) -> Iterator[_Segment]:
        """Yields the samples of each run of a part."""
        if not len(part):
            return
        time = part.time
        is_finite = np.isfinite(time)
        nanoseconds = np.rint(np.where(is_finite, time, 0) * 1e9).astype(np.int64)
        is_late = np.zeros(len(part), np.bool_)
        for name in RECEIVER:
            for column in columns_of(part, name):
                is_late[column.sample - part.first_sample] = True
        devices = device_of(part.bid)
        begins = np.zeros(len(part), np.bool_)
        begins[part.restarts - part.first_sample] = True
        found, first = np.unique(devices, return_index=True)
        begins[
            [row for device, row in zip(found, first, strict=True) if device not in self._present]
        ] = True
        numbers = self.count - 1 + np.cumsum(begins)
        self.count = int(numbers[-1]) + 1
        for device in found.tolist():
            own = np.flatnonzero(devices == device)
            for rows in np.split(own, np.flatnonzero(begins[own])):
                if not len(rows):
                    continue
                if begins[rows[0]]:
                    self._present[device] = int(numbers[rows[0]])
                run = self._present[device]
                known = self._known(run, nanoseconds[rows], is_finite[rows], is_late[rows])
                yield _Segment(run, rows, nanoseconds[rows], known)

    def _known(self, run: int, time: Times, is_finite: Mask, is_late: Mask) -> Mask:
        """Returns which times are not arbitrary: all but those of the receiver far from the others."""
        leads = is_finite & ~is_late
        if leads.all():
            self._last[run] = int(time[-1])
            return leads
        before = _filled(np.where(leads, time, UNKNOWN), self._last.get(run, UNKNOWN))
        if before[-1] != UNKNOWN:
            self._last[run] = int(before[-1])
        near = (before == UNKNOWN) | (np.abs(time - np.where(before == UNKNOWN, 0, before)) <= NEAR)
        return np.asarray(is_finite & (leads | near))


def _timed(segments: Iterable[_Segment]) -> list[_Segment]:
    """Returns the segments with a known time, in the order of the first one.

    So a segment comes after the one with the sample before its first known time.
    """
    timed = [segment for segment in segments if segment.is_known.any()]
    return sorted(timed, key=lambda segment: int(segment.rows[np.argmax(segment.is_known)]))


def _filled(values: Times, before: int) -> Times:
    """Returns values with the last known one in the place of `UNKNOWN`; ``before`` comes before the first."""
    known = values != UNKNOWN
    place = np.maximum.accumulate(np.where(known, np.arange(len(values)), -1))
    return np.where(place < 0, before, values[place])


def _utc(part: Part) -> Times:
    stamps: Times = part.utc.astype("datetime64[ns]").view(np.int64)
    return np.where((stamps >= 0) & (stamps < END), stamps, UNKNOWN)


def _host(part: Part) -> Times:
    host = part.host_time
    is_known = (host >= 0) & (host < END / 1e9)
    return np.where(is_known, np.rint(np.where(is_known, host, 0) * 1e9).astype(np.int64), UNKNOWN)


@dataclass
class _Run:
    """What is known of a run.

    Attributes:
        offsets: For ``utc`` and ``host`` what to add to the device time, in ns, by the first sample with
            both that agrees with the next one.
        last: The same by the last sample with both, until there is one that agrees.
        start: Its first device time, or None.
        joined: The run of the sample before the first one, and the device time of that sample.
    """

    offsets: dict[str, int] = field(default_factory=dict)
    last: dict[str, int] = field(default_factory=dict)
    start: int | None = None
    joined: tuple[int, int] | None = None


class Stamps(NamedTuple):
    """The times of the samples of a part, in ns since 1970.

    Attributes:
        measured: When each sample was measured.
        ordered: The order of messages: never less than that of a sample before, and without doubtful times.
    """

    measured: Times
    ordered: npt.NDArray[np.uint64]


class TimeBase:
    """Finds the time base of a log in a first pass, and gives times in a second one.

    >>> import xbus
    >>> log = xbus.read_log("tests/captures/walk.mtb")
    >>> times = TimeBase()
    >>> times.add(log)
    >>> times.base
    'utc'
    >>> times.second_pass().stamps(log).measured[:2].view("datetime64[ns]").astype(str).tolist()
    ['2026-11-22T09:30:00.000000000', '2026-11-22T09:30:00.010000000']
    """

    def __init__(self) -> None:
        self._numbers = _Runs()
        self._runs: list[_Run] = []
        #: Their numbers in the order of their first device times: a run is joined to one before it.
        self._order: list[int] = []
        #: The last sample with a device time: its run, and the time.
        self._last: tuple[int, int] | None = None
        #: The first one.
        self._first: tuple[int, int] | None = None
        #: The first time of each base that a sample has itself.
        self._earliest: dict[Base, int] = {}

    def add(self, part: Part) -> None:
        """Adds the next part of the log: the first pass."""
        sources: dict[Base, Times] = {"utc": _utc(part), "host": _host(part)}
        for base, known in sources.items():
            if base not in self._earliest and len(found := known[known != UNKNOWN]):
                self._earliest[base] = int(found[0])
        segments = list(self._numbers.segments(part))
        self._runs += [_Run() for _ in range(self._numbers.count - len(self._runs))]
        run_of = np.full(len(part), UNKNOWN)
        time_of = np.full(len(part), UNKNOWN)
        for segment in segments:
            rows = segment.rows[segment.is_known]
            run_of[rows], time_of[rows] = segment.run, segment.time[segment.is_known]
        last_run, last_time = self._last or (UNKNOWN, UNKNOWN)
        # With the sample before the part, so that each sample has one before it.
        runs = _filled(np.append(last_run, run_of), UNKNOWN)
        times = _filled(np.append(last_time, time_of), UNKNOWN)
        for segment in _timed(segments):
            self._add(segment, sources, runs, times)
        if runs[-1] != UNKNOWN:
            self._last = int(runs[-1]), int(times[-1])
        if self._first is None and len(timed := np.flatnonzero(run_of != UNKNOWN)):
            self._first = int(run_of[timed[0]]), int(time_of[timed[0]])

    def _add(
        self, segment: _Segment, sources: dict[Base, Times], runs: Times, times: Times
    ) -> None:
        """Adds the samples of a run; the others are the run and the time of the sample before each."""
        run = self._runs[segment.run]
        rows, time = segment.rows[segment.is_known], segment.time[segment.is_known]
        if run.start is None:
            run.start = int(time[0])
            self._order.append(segment.run)
            if runs[rows[0]] != UNKNOWN:
                run.joined = int(runs[rows[0]]), int(times[rows[0]])
        for base, known in sources.items():
            own = known[rows]
            found = (own - time)[own != UNKNOWN]
            if base in run.offsets or not len(found):
                continue
            if base in run.last:
                found = np.append(run.last[base], found)
            agree = np.flatnonzero(np.abs(np.diff(found)) <= NEAR)
            run.last[base] = int(found[-1])
            if len(agree):
                run.offsets[base] = int(found[agree[0]])

    @property
    def base(self) -> Base:
        """The time base: the best one that a sample of the log has."""
        for base in ("utc", "host"):
            if base in self._earliest:
                return base
        return "none" if self._first is None else "device"

    def second_pass(self) -> _SecondPass:
        """Returns what gives times to the parts, from the first one on."""
        offsets = self._offsets()
        start = self._earliest.get(self.base, 0)
        if self._first is not None:
            run, time = self._first
            if (offset := offsets[run]) is not None:
                start = offset + time
        return _SecondPass(self.base, offsets, start)

    def _offsets(self) -> list[int | None]:
        """Returns for each run what to add to the device time, in ns.

        None if it follows from the sample before: the offset of a run with times changes with each of them.
        """
        base = self.base
        known = [run.offsets.get(base, run.last.get(base)) for run in self._runs]
        if base == "device" and self._first is not None:
            known[self._first[0]] = 0
        # Runs after a known one follow it, those before the first known one precede it; others follow those.
        follows = [offset is not None for offset in known]
        for number in self._order:
            joined = self._runs[number].joined
            follows[number] |= joined is not None and follows[joined[0]]
        for number in reversed(self._order):
            run, offset = self._runs[number], known[number]
            if offset is None or run.joined is None or run.start is None:
                continue
            before, time = run.joined
            if not follows[before] and known[before] is None:
                known[before] = offset + run.start - time
        return known


class _SecondPass:
    """Gives times to the samples of the parts, in order."""

    def __init__(self, base: Base, offsets: Sequence[int | None], start: int) -> None:
        self.base = base
        self._numbers = _Runs()
        #: For each run what to add to the device time, as of the last sample; None until the sample before
        #: decides.
        self._offsets = list(offsets)
        #: The same by a sample that does not agree, until the next one.
        self._doubted: dict[int, int] = {}
        self._before, self._highest = start, 0

    def stamps(self, part: Part) -> Stamps:
        """Returns the times of the samples of the next part."""
        known = _known_times(part, self.base)
        trusted = known.copy()
        for run, rows, time, is_known in _timed(self._numbers.segments(part)):
            own = known[rows]
            offsets = np.where(is_known & (own != UNKNOWN), own - time, UNKNOWN)
            offset = self._offsets[run]
            if offset is None:
                first = int(np.argmax(is_known))
                offset = self._time_before(int(rows[first]), trusted) - int(time[first])
            doubtful = self._doubtful(run, offset, offsets)
            own[doubtful] = offsets[doubtful] = UNKNOWN
            offsets = _filled(offsets, offset)
            self._offsets[run] = int(offsets[-1])
            derived = np.where(is_known, time + offsets, UNKNOWN)
            trusted[rows] = np.where(own != UNKNOWN, own, derived)
        # A sample without any time has that of the sample before.
        trusted = _filled(trusted, self._before)
        self._before = int(trusted[-1]) if len(trusted) else self._before
        trusted = np.clip(trusted, 0, END - 1)
        ordered = np.maximum.accumulate(np.append(self._highest, trusted))[1:]
        self._highest = int(ordered[-1]) if len(ordered) else self._highest
        measured = np.where(known != UNKNOWN, known, trusted)
        return Stamps(measured, ordered.astype(np.uint64))

    def _time_before(self, row: int, trusted: Times) -> int:
        """Returns the time of the last sample before a row that has one."""
        while row > 0:
            row -= 1
            if trusted[row] != UNKNOWN:
                return int(trusted[row])
        return self._before

    def _doubtful(self, run: int, good: int, offsets: Times) -> npt.NDArray[np.intp]:
        """Returns which samples have a time that agrees neither with that before nor with a doubtful one."""
        found = np.flatnonzero(offsets != UNKNOWN)
        steps = np.diff(offsets[found], prepend=good)
        if run not in self._doubted and (np.abs(steps) <= NEAR).all():
            return np.empty(0, np.intp)
        doubted, rows = self._doubted.pop(run, None), []
        for row, offset in zip(found.tolist(), offsets[found].tolist(), strict=True):
            agrees = abs(offset - good) <= NEAR
            if agrees or (doubted is not None and abs(offset - doubted) <= NEAR):
                good, doubted = offset, None
            else:
                doubted = offset
                rows.append(row)
        if doubted is not None:
            self._doubted[run] = doubted
        return np.array(rows, np.intp)


def _known_times(part: Part, base: Base) -> Times:
    """Returns the times that samples have themselves."""
    if base == "utc":
        return _utc(part)
    if base == "host":
        return _host(part)
    return np.full(len(part), UNKNOWN)
