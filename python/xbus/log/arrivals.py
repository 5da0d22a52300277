"""The side file of a recording, with the arrivals of its bytes.

``NAME.mtb.times`` belongs to ``NAME.mtb``, and to ``NAME.mtb.gz``, its compressed form. The side file may be
compressed in the same way (``NAME.mtb.times.gz``). Offsets are those of the decompressed bytes.

It begins with a header of 24 bytes: ``XBUSTIME``, the version (1) and the size of a record (16) as U4, and
the nanoseconds to add to the steady clock of the host for the time since 1970, as I8. Each record is about a
piece of bytes that was read at once: the offset in ``NAME.mtb`` at which it ends (U8), and its arrival on the
clock of the host, in ns since 1970 (I8). All numbers are little-endian. An incomplete last record is ignored.

A side file is read only if it is a regular file. One with many more records than the recording has bytes is
not used: a piece has at least one byte. The records of a long recording stay in the file, unless it is
compressed, and are read part by part. A record in memory takes 16 bytes.
"""

from __future__ import annotations

import contextlib
import os
from bisect import bisect_left
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cached_property
from typing import Any, BinaryIO, NamedTuple, Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

from xbus import _core
from xbus.files import (
    content_size,
    is_url,
    local_name,
    open_file,
    suffix_of_compression,
    uncompressed_name,
)
from xbus.log.arrays import read_only
from xbus.log.hostclock import HostClock
from xbus.log.source import LogChangedError, Source
from xbus.protocol.tables import LATE, device_of

__all__ = [
    "HEADER",
    "SUFFIX",
    "Arrivals",
    "HostTimes",
    "arrivals_of",
    "joined",
    "records_of",
    "side_files",
]

#: Suffix of a side file.
SUFFIX = ".times"
HEAD = np.dtype([("magic", "S8"), ("version", "<u4"), ("size", "<u4"), ("epoch", "<i8")])
RECORD = np.dtype([("end", "<u8"), ("arrival", "<i8")])
EXPECTED = (b"XBUSTIME", 1, RECORD.itemsize)
#: The header of a side file that was copied from another one.
HEADER = np.array([(*EXPECTED, 0)], HEAD).tobytes()
#: Bytes to decompress at a time.
BLOCK = 1 << 20
#: The most records that are kept in memory, if the file is not compressed.
MOST_HELD = 1 << 18
#: Records that a side file may have beyond one for each byte of the log, which a power cut can shorten.
SPARE = 1 << 20
#: A power cut can cost the log more of its end than the side file, but not more than this, in ns.
LOST = 60 * 10**9


class Arrivals:
    """When the bytes of a log arrived.

    Args:
        end: Byte offset in the log at which each piece ends, ``(n,)`` int64, ascending.
        time: When the piece arrived, in ns since 1970, ``(n,)`` int64.
        size: Size of the log in bytes.
        fault: What is wrong with the side file, or None.
    """

    def __init__(
        self,
        end: npt.NDArray[np.int64],
        time: npt.NDArray[np.int64],
        size: int,
        fault: str | None = None,
    ) -> None:
        self._end, self._time, self.size, self.fault = end, time, size, fault

    def loaded(self) -> Arrivals:
        """Returns the same arrivals, in memory."""
        return self

    def between(self, start: int, end: int) -> Arrivals:
        """Returns the arrivals of the bytes from ``start`` to ``end``, for the same log."""
        first, last = np.searchsorted(self._end, [start + 1, end])
        part = slice(first, last + 1)
        return Arrivals(self._end[part], self._time[part], self.size, self.fault)

    def chunks(self) -> list[Chunk]:
        """Returns the arrivals as chunks, in order."""
        return [_Held(self._end, self._time)] if len(self._end) else []

    def of(self, end: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
        """Returns the arrivals of the bytes before ascending offsets; fewer if not all are known."""
        if not len(end):
            return np.empty(0, np.int64)
        near = self.between(int(end[0]) - 1, int(end[-1])).loaded()
        known = np.searchsorted(end, near._end[-1], side="right") if len(near._end) else 0
        return near._time[np.searchsorted(near._end, end[:known])]

    def of_ranges(
        self, start: npt.NDArray[np.int64], end: npt.NDArray[np.int64]
    ) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
        """Returns the arrivals of ranges of the log that are joined, as ``end`` and ``time``.

        Args:
            start: Offset at which each range begins, ``(n,)``, ascending.
            end: Offset at which it ends.
        """
        if not len(start):
            return np.empty(0, np.int64), np.empty(0, np.int64)
        near = self.between(int(start[0]), int(end[-1])).loaded()
        if not len(near._end):
            return np.empty(0, np.int64), np.empty(0, np.int64)
        inner = near._end[slice(*np.searchsorted(near._end, [start[0], end[-1]]))]
        ends = np.union1d(inner, end)
        ends = ends[ends <= near._end[-1]]
        ranges = np.searchsorted(end, ends)
        is_inside = ends > start[ranges]
        ends, ranges = ends[is_inside], ranges[is_inside]
        sizes = end - start
        return ends - start[ranges] + (np.cumsum(sizes) - sizes)[ranges], near.of(ends)

    def with_next(self, other: Arrivals) -> Arrivals:
        """Returns the arrivals of two neighbouring ranges of the same log, from `between`."""
        # What contains the border is in both.
        before = self.chunks()
        last = before[-1].last if before else -1
        behind = [chunk.within(last, self.size) for chunk in other.chunks() if chunk.last > last]
        return StoredArrivals([*before, *behind], self.size, self.fault)

    def span(self) -> tuple[int, int] | None:
        """Returns the first and the last arrival in ns since 1970; None if there are none."""
        chunks = self.chunks()
        return (int(chunks[0].load()[1][0]), int(chunks[-1].load()[1][-1])) if chunks else None

    def blocks(self) -> Iterator[bytes]:
        """Yields the content of a side file."""
        yield HEADER
        for chunk in self.chunks():
            yield records_of(*chunk.load())


class StoredArrivals(Arrivals):
    """Arrivals that are read from the side file where they are needed, for those of a long recording.

    Args:
        chunks: All of them.
        size: As for `Arrivals`.
        fault: The same.
    """

    def __init__(self, chunks: Sequence[Chunk], size: int, fault: str | None = None) -> None:
        self._chunks, self.size, self.fault = list(chunks), size, fault

    def loaded(self) -> Arrivals:
        """Returns the same arrivals, in memory.

        Raises:
            LogChangedError: A side file has changed.
        """
        loaded = [chunk.load() for chunk in self._chunks]
        end, time = (
            np.concatenate([np.empty(0, np.int64), *(one[at] for one in loaded)]) for at in (0, 1)
        )
        return Arrivals(end, time, self.size, self.fault)

    def between(self, start: int, end: int) -> Arrivals:
        """Returns the arrivals of the bytes from ``start`` to ``end``, and perhaps more."""
        first, last = (bisect_left(self._chunks, at, key=_last) for at in (start + 1, end))
        chunks = [chunk.within(start, end) for chunk in self._chunks[first : last + 1]]
        return StoredArrivals(chunks, self.size, self.fault)

    def chunks(self) -> list[Chunk]:
        """Returns the arrivals as chunks, in order."""
        return self._chunks


class Chunk(Protocol):
    """Some of the arrivals of a log."""

    @property
    def last(self) -> int:
        """Offset in the log at which the last piece ends."""

    @property
    def pieces(self) -> int:
        """Number of pieces, at least one."""

    def load(self) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
        """Returns the ends and times of the pieces."""

    def within(self, start: int, end: int) -> Chunk:
        """Returns the pieces of the bytes from ``start`` to ``end``, and perhaps more."""

    def shifted(self, by: int) -> Chunk:
        """Returns the same with other offsets."""


def _last(chunk: Chunk) -> int:
    return chunk.last


class _Held(NamedTuple):
    """A chunk in memory."""

    end: npt.NDArray[np.int64]
    time: npt.NDArray[np.int64]

    @property
    def last(self) -> int:
        return int(self.end[-1])

    @property
    def pieces(self) -> int:
        return len(self.end)

    def load(self) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
        return self

    def within(self, start: int, end: int) -> _Held:
        first, last = np.searchsorted(self.end, [start + 1, end])
        return _Held(self.end[first : last + 1], self.time[first : last + 1])

    def shifted(self, by: int) -> _Held:
        return _Held(self.end + by, self.time)


class _Stored(NamedTuple):
    """A chunk in a side file.

    Attributes:
        path: Path of the file.
        first: Number of the first record.
        pieces: As in `Chunk`.
        last: The same.
        shift: What is added to the offsets in the file.
    """

    path: str
    first: int
    pieces: int
    last: int
    shift: int = 0

    def load(self) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
        try:
            with contextlib.closing(open_file(self.path, is_regular=True)) as file:
                file.seek(HEAD.itemsize + self.first * RECORD.itemsize)
                data = file.read(self.pieces * RECORD.itemsize)
        except OSError as error:
            raise LogChangedError(
                f"{self.path} cannot be read any more: {error.strerror}"
            ) from error
        if len(data) == self.pieces * RECORD.itemsize:
            end, time = _arrays(np.frombuffer(data, RECORD))
            if end[-1] + self.shift == self.last and bool((end[1:] >= end[:-1]).all()):
                return end + self.shift, time
        raise LogChangedError(f"{self.path} changed while its log was read; read the log again")

    def within(self, start: int, end: int) -> _Stored:  # noqa: ARG002 - see `Chunk`
        return self

    def shifted(self, by: int) -> _Stored:
        return self._replace(last=self.last + by, shift=self.shift + by)


def _arrays(records: npt.NDArray[Any]) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Returns ends and times of records."""
    end = np.minimum(records["end"], np.iinfo(np.int64).max).astype(np.int64)
    return end, records["arrival"].astype(np.int64)


def records_of(end: npt.NDArray[np.int64], time: npt.NDArray[np.int64]) -> bytes:
    """Returns the records of a side file."""
    records = np.empty(len(end), RECORD)
    records["end"], records["arrival"] = end, time
    return records.tobytes()


@runtime_checkable
class Timed(Protocol):
    """A source that has the arrivals of its bytes."""

    def arrivals(self) -> Arrivals | None:
        """Returns the arrivals, or None if they are not known."""
        ...


class HostTimes:
    """Host times of the samples and strings of a part of a log, computed on first access.

    Args:
        part: The part.
        arrivals: When its bytes arrived, or None if that is not known.
        earlier: The clocks of the devices as of the end of the previous part, by BID.
        is_known: Whether a sample of the whole log has a host time. None if this part decides it.
    """

    def __init__(
        self,
        part: _core.Part,
        arrivals: Arrivals | None = None,
        earlier: Mapping[int, HostClock] | None = None,
        *,
        is_known: bool | None = None,
    ) -> None:
        self.part = part
        #: What is wrong with the side file; None if it is good or missing.
        self.fault: str | None = arrivals.fault if arrivals is not None else None
        self._arrivals = arrivals
        self._earlier, self._is_known = earlier or {}, is_known

    @classmethod
    def known_already(
        cls,
        part: _core.Part,
        time: npt.NDArray[np.float64] | None,
        clocks: dict[int, HostClock],
        strings: npt.NDArray[np.float64],
        fault: str | None = None,
    ) -> HostTimes:
        """Returns host times that are computed already.

        Args:
            part: The part.
            time: Of each sample, ``(n,)``; None if no arrivals are known.
            clocks: The clock of each device as of the last sample.
            strings: When each string arrived.
            fault: What is wrong with the side file.
        """
        host_times = cls(part)
        host_times.fault, host_times.strings = fault, read_only(strings)
        host_times._computed = (None if time is None else read_only(time)), clocks
        return host_times

    @cached_property
    def _computed(self) -> tuple[npt.NDArray[np.float64] | None, dict[int, HostClock]]:
        return self._compute(len(self.part))

    def clocks_before(self, row: int) -> dict[int, HostClock]:
        """Returns the clock of each device as of the sample before a row of the part."""
        return self._compute(row)[1]

    def _compute(self, rows: int) -> tuple[npt.NDArray[np.float64] | None, dict[int, HostClock]]:
        """Returns the host times of the first rows, NaN for the others, and the clocks after them."""
        part = self.part
        clocks = {bid: clock.copy() for bid, clock in self._earlier.items()}
        if self._is_known is False or (self._arrivals is None and not self._is_known):
            return None, clocks
        time = np.full(len(part), np.nan)
        if self._arrivals is None:
            return read_only(time), clocks
        leads = np.ones(len(part), np.bool_)
        for column in part.columns:
            if column.name in LATE:
                leads[column.sample - part.first] = False
        arrival = self._arrivals.of(part.end)[:rows]
        bids = device_of(part.bid)[: len(arrival)]
        for bid in np.unique(bids).tolist():
            clock = clocks.setdefault(bid, HostClock())
            own = np.flatnonzero(bids == bid)
            time[own] = clock.update(part.time[own], arrival[own], leads[own])
        return (read_only(time) if clocks or self._is_known else None), clocks

    @property
    def known(self) -> npt.NDArray[np.float64] | None:
        """The same as `time`, or None if no arrivals are known."""
        return self._computed[0]

    @property
    def clocks(self) -> dict[int, HostClock]:
        """The clock of each device as of the last sample, by BID; 1 stands for FF too."""
        return self._computed[1]

    @cached_property
    def time(self) -> npt.NDArray[np.float64]:
        """Seconds since 1970 of each sample, ``(n,)`` float64, read-only; NaN if not known."""
        return read_only(np.full(len(self.part), np.nan)) if self.known is None else self.known

    @cached_property
    def strings(self) -> npt.NDArray[np.float64]:
        """Seconds since 1970 at which each string arrived, ``(n,)`` float64, read-only; NaN if not known."""
        found = self.part.strings
        times = np.full(len(found.offset), np.nan)
        if self._arrivals is not None:
            lengths = np.diff(found.ends.astype(np.int64), prepend=0)
            arrived = self._arrivals.of(np.asarray(found.offset + lengths, np.int64))
            times[: len(arrived)] = arrived / 1e9
        return read_only(times)

    def for_column(self, part: _core.Part) -> HostTimes:
        """Returns the host times of the same samples for a part with one of the columns."""
        return HostTimes.known_already(part, self.known, {}, np.empty(0))

    def __reduce__(self) -> tuple[Any, ...]:
        state = self.part, self.known, self.clocks, self.strings, self.fault
        return HostTimes.known_already, state


def side_files(path: str) -> tuple[str, ...]:
    """Returns the names that the side file of a log can have, the first one that exists counts.

    >>> side_files("walk.mtb"), side_files("walk.mtb.gz")
    (('walk.mtb.times',), ('walk.mtb.times', 'walk.mtb.times.gz'))
    """
    compression = suffix_of_compression(path)
    side = uncompressed_name(path) + SUFFIX
    return (side, side + compression) if compression else (side,)


def arrivals_of(source: Source) -> Arrivals | None:
    """Returns the arrivals in the side file of a log, or None without one.

    Call this before the log is read: it may grow.
    """
    if isinstance(source, Timed):
        return source.arrivals()
    if not isinstance(source, str | os.PathLike):
        return None
    path = local_name(os.fsdecode(source))
    if is_url(path):
        return None
    for side in side_files(path):
        try:
            with contextlib.closing(open_file(side, is_regular=True)) as file:
                return _arrivals(file, side, content_size(path))
        except FileNotFoundError:
            continue
        except OSError as error:
            return _none(f"{side} cannot be read: {error.strerror}")
    return None


def _arrivals(file: BinaryIO, side: str, size: int) -> Arrivals:
    """Reads a side file block by block.

    Args:
        file: The side file.
        side: Its name.
        size: Size of the log in bytes.
    """
    head = _read_head(file)
    if len(head) < HEAD.itemsize or np.frombuffer(head, HEAD)[0].item()[:3] != EXPECTED:
        return _none(f"{side} is not a side file of version 1")
    needed = _Needed(size, side if hasattr(file, "seek") else None)
    held, before = np.empty(0, RECORD), 0  # the last record, and the number of those before it
    for new in _records(file):
        records = np.concatenate((held, new))
        falls = np.flatnonzero(records["end"][1:] < records["end"][:-1])
        if len(falls):
            # Which of the two is wrong is not known; those before are as good as in a file cut there.
            needed.add(records[: falls[0]])
            number = before + int(falls[0])
            fault = (
                f"{side} is damaged: offsets descend after record {number}; the rest is not used"
            )
            return needed.arrivals(fault)
        needed.add(records[:-1])
        held, before = records[-1:], before + len(records) - 1
        if before > size + SPARE:
            return _none(f"{side} has more records than the log has bytes")
    needed.add(held)
    if not len(held) or needed.within is None or (last := held[0])["end"] == size:
        return needed.arrivals()
    fault = f"{side} is for {last['end']} bytes, but the log has {size}"
    if abs(int(last["arrival"]) - int(needed.within["arrival"])) > LOST:
        return _none(f"{fault}: it belongs to another log")
    return needed.arrivals(fault)


class _Needed:
    """The records up to the end of a log.

    Args:
        size: Size of the log in bytes.
        path: The side file, or None if it is compressed: its records are kept in memory.

    Attributes:
        within: The record of the piece that contains the end of the log; None if it is missing.
    """

    def __init__(self, size: int, path: str | None) -> None:
        self._size, self._path = size, path
        self._chunks: list[Chunk] = []
        self._count = 0
        self.within: Any = None

    def add(self, records: npt.NDArray[Any]) -> None:
        """Adds the next records."""
        if self.within is not None or not len(records):
            return
        inside = int(np.searchsorted(records["end"], self._size))
        self.within = records[inside] if inside < len(records) else None
        held = _Held(*_arrays(records[: inside + 1]))
        chunk: Chunk = held
        if self._path is not None:
            chunk = _Stored(self._path, self._count, len(held.end), held.last)
        self._chunks.append(chunk)
        self._count += len(held.end)

    def arrivals(self, fault: str | None = None) -> Arrivals:
        """Returns the arrivals of the log."""
        return _arrivals_in(self._chunks, self._size, fault)


def _read_head(file: BinaryIO) -> bytes:
    head = b""
    while len(head) < HEAD.itemsize and (data := file.read(HEAD.itemsize - len(head))):
        head += data
    return head


def _records(file: BinaryIO) -> Iterator[npt.NDArray[Any]]:
    """Yields the records of a side file, some at a time; an incomplete last one is left out."""
    rest = b""
    while data := file.read(BLOCK):
        data = rest + data
        whole = len(data) // RECORD.itemsize
        rest = data[whole * RECORD.itemsize :]
        if whole:
            yield np.frombuffer(data, RECORD, whole)


def joined(several: Iterable[Arrivals | None]) -> Arrivals | None:
    """Returns the arrivals of files that are one recording, up to the first file without all arrivals."""
    chunks: list[Chunk] = []
    faults: list[str] = []
    start: int | None = None
    for arrivals in several:
        if arrivals is None:
            break
        own, start = arrivals.chunks(), start or 0
        chunks += [chunk.shifted(start) for chunk in own]
        faults += [arrivals.fault] if arrivals.fault else []
        start += arrivals.size
        if arrivals.fault or not own or own[-1].last < arrivals.size:
            break  # the arrivals of the next file must not stand for the rest of this one
    return None if start is None else _arrivals_in(chunks, start, faults[0] if faults else None)


def _arrivals_in(chunks: Sequence[Chunk], size: int, fault: str | None) -> Arrivals:
    """Returns the arrivals in chunks, in memory if they are few."""
    arrivals = StoredArrivals(chunks, size, fault)
    is_small = sum(chunk.pieces for chunk in chunks) <= MOST_HELD
    return arrivals.loaded() if is_small else arrivals


def _none(fault: str) -> Arrivals:
    return Arrivals(np.empty(0, np.int64), np.empty(0, np.int64), 0, fault)
