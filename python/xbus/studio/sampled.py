"""A recording read in parts, so that a picture over its time is complete: any size takes the same time."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from xbus.files import is_plain, open_file
from xbus.log.axis import Axis
from xbus.log.log import Log
from xbus.log.read import read_log
from xbus.log.runs import Runs
from xbus.protocol.tables import RECEIVER
from xbus.studio.gaps import find_gaps

__all__ = ["Sampled", "columns_of", "sampled"]

FloatArray = npt.NDArray[np.float64]

#: A recording up to this size is read as a whole; of a larger one, parts of this size.
WHOLE, PART = 4 << 20, 24 << 10
#: The most parts that are read, and how often more are read where time has no samples.
MOST_PARTS, ROUNDS = 640, 16
#: The most bytes that are decompressed, and the size and the greatest number of parts that are kept of them.
MOST_DECOMPRESSED, SMALL_PART, MOST_SMALL_PARTS = 256_000_000, 4 << 10, 4096
#: Bytes that are decompressed at a time.
BLOCK = 1 << 20


class Sampled(NamedTuple):
    """Samples of a recording.

    Attributes:
        log: The samples of all parts that were read.
        position: Position of each sample in the recording, from 0 to 1, ``(N,)``: its time, or else its
            packet counter; its place in the bytes if neither is known.
        part: Number of the part with each sample, ``(N,)``. Between two parts are bytes that were not read.
        is_timed: Whether positions are not places in the bytes.
    """

    log: Log
    position: FloatArray
    part: npt.NDArray[np.intp]
    is_timed: bool

    def gaps(self, sample: npt.NDArray[np.int64]) -> list[tuple[float, float]]:
        """Returns where some of the samples are missing: begin and end of each gap, as positions.

        Between two parts, it is not known whether samples are missing.

        Args:
            sample: The indices of the samples, ascending.
        """
        if not self.is_timed:
            return []
        bounds = np.flatnonzero(np.diff(self.part[sample])) + 1
        found: list[tuple[float, float]] = []
        for own in np.split(self.position[sample], bounds):
            ascending = np.sort(own)
            rows = find_gaps(ascending).rows
            found += zip(ascending[rows - 1].tolist(), ascending[rows].tolist(), strict=True)
        return found


def sampled(files: Sequence[Path], columns: int, quantities: Iterable[str]) -> Sampled | None:
    """Returns samples for each column of a picture of a recording, as far as there are any.

    A large recording is read at places of the same distance. Where columns are empty, because the rate
    changes or samples are missing, more is read, until the bytes on both sides of a gap are known. A
    compressed one is decompressed once, and smaller parts of the same distance are decoded.

    Args:
        files: The pieces of the recording.
        columns: Number of columns.
        quantities: Names of the quantities to decode.

    Returns:
        The samples; None of a compressed recording with more than `MOST_DECOMPRESSED`.

    Raises:
        ImportError: The library for a compression is not installed.
        OSError: A file cannot be read.
    """
    quantities = (*RECEIVER, *quantities)
    if not all(is_plain(str(file)) for file in files):
        decompressed = _decompressed(files)
        return None if decompressed is None else _decoded(decompressed, quantities)
    known = _Bytes(files)
    if known.size <= WHOLE:
        known.read(0, known.size)
        return _decoded(known, quantities)
    known.read_at(_evenly(0, known.size - PART, columns), known.size)
    for _ in range(ROUNDS):
        if not (holes := _holes(known, _decoded(known, RECEIVER), columns)):
            break
        for start, end, count in holes:
            known.fill(start, end, count)
    return _decoded(known, quantities)


def columns_of(position: FloatArray, columns: int) -> npt.NDArray[np.intp]:
    """Returns the columns of positions from 0 to 1.

    >>> columns_of(np.array([0.0, 0.5, 1.0]), 10).tolist()
    [0, 5, 9]
    """
    return np.minimum((position * columns).astype(np.intp), columns - 1)


def _evenly(first: int, last: int, count: int) -> list[int]:
    """Returns whole numbers of about the same distance from the first to the last."""
    return [first + (last - first) * at // (count - 1) for at in range(count)]


class _Part(NamedTuple):
    """Bytes of a recording that follow each other.

    Attributes:
        start: Where they begin in the recording.
        end: Where they end.
        first: Where the first whole frame begins.
        frames: The bytes from there to the end of the last whole frame.
    """

    start: int
    end: int
    first: int
    frames: bytes


class _Bytes:
    """The bytes of a recording that are known.

    Args:
        files: The pieces of the recording, from which more can be read.
        known: What is known of it, by place.

    Attributes:
        size: Size of the recording in bytes.
    """

    def __init__(self, files: Sequence[Path], known: Mapping[int, bytes] | None = None) -> None:
        self._sizes = [(file, file.stat().st_size) for file in files]
        self._known = dict(known or {})
        ends = [start + len(data) for start, data in self._known.items()]
        self.size = max(sum(size for _, size in self._sizes), *ends, 0)
        self._trimmed: dict[tuple[int, int], _Part] = {}

    def read(self, start: int, end: int) -> None:
        """Reads a range of bytes."""
        data, base = b"", 0
        for file, size in self._sizes:
            first, last = max(start - base, 0), min(end - base, size)
            if first < last:
                with file.open("rb") as opened:
                    opened.seek(first)
                    data += opened.read(last - first)
            base += size
        if data:
            self._known[start] = data

    def read_at(self, places: Iterable[int], end: int) -> None:
        """Reads parts that begin at ascending places, up to an end, as long as there are not too many."""
        done = 0
        for place in places:
            start, done = max(place, done), min(place + PART, end)
            if start < done and len(self._known) < MOST_PARTS:
                self.read(start, done)

    def fill(self, start: int, end: int, count: int) -> None:
        """Reads a number of parts inside a range, or all of it if it is short."""
        if end - start <= 2 * PART:
            self.read_at(range(start, end, PART), end)
        else:
            self.read_at(_evenly(start, end - PART, count + 2)[1:-1], end)

    def parts(self) -> list[_Part]:
        """Returns the bytes that are known, in order."""
        joined: list[tuple[int, list[bytes]]] = []
        end = -1
        for start, data in sorted(self._known.items()):
            if start != end:
                joined.append((start, []))
            joined[-1][1].append(data)
            end = start + len(data)
        return [self._part(start, b"".join(data)) for start, data in joined]

    def _part(self, start: int, data: bytes) -> _Part:
        key = (start, len(data))
        if key not in self._trimmed:
            first, last = _whole_frames(data)
            self._trimmed[key] = _Part(start, start + len(data), start + first, data[first:last])
        return self._trimmed[key]


def _decompressed(files: Sequence[Path]) -> _Bytes | None:
    """Returns parts of the same distance of files that are compressed; None if they have too many bytes.

    How many bytes there are is known at the end only. So the distance between parts doubles whenever they are
    too many.
    """
    parts: dict[int, bytes] = {}
    size, step = 0, SMALL_PART
    for data in _small_parts(files):
        if size % step == 0:
            parts[size] = data
        if len(parts) > MOST_SMALL_PARTS:
            step *= 2
            parts = {start: part for start, part in parts.items() if start % step == 0}
        size += len(data)
        if size > MOST_DECOMPRESSED:
            return None
    return _Bytes([], parts)


def _small_parts(files: Sequence[Path]) -> Iterator[bytes]:
    """Yields the content of files in parts of `SMALL_PART` bytes; only the last one may be shorter."""
    data = b""
    for file in files:
        with contextlib.closing(open_file(str(file), is_regular=True)) as opened:
            while more := opened.read(BLOCK):
                data += more
                whole = len(data) - len(data) % SMALL_PART
                for start in range(0, whole, SMALL_PART):
                    yield data[start : start + SMALL_PART]
                data = data[whole:]
    if data:
        yield data


def _whole_frames(data: bytes) -> tuple[int, int]:
    """Returns where the first whole frame or string begins, and where the last one ends."""
    # Bytes from the middle of a file can look like compressed data, but not behind a zero.
    log = read_log(b"\0" + data, quantities=())
    offsets = (log.offset, log.messages.offset, log.strings.offset)
    first = min((int(each[0]) for each in offsets if len(each)), default=1 + len(data))
    last = 1 + len(data)
    for damage in reversed(log.damage):
        if damage["offset"] + damage["length"] < last:
            break
        last = int(damage["offset"])
    return first - 1, max(first, last) - 1


def _decoded(known: _Bytes, quantities: Iterable[str]) -> Sampled:
    """Returns the samples in the bytes that are known."""
    parts = known.parts()
    log = read_log(b"".join(part.frames for part in parts), quantities=quantities)
    starts = np.cumsum([0, *(len(part.frames) for part in parts)])[:-1]
    # Of several parts that begin at the same place, the last one is not empty.
    part = np.searchsorted(starts, log.offset, side="right") - 1
    axis = Axis()
    position = axis.positions(log.core, Runs().add(log.core).run)
    is_timed = axis.kind == "time" or len(parts) == 1
    if not is_timed:
        firsts = np.array([each.first for each in parts], np.int64)
        position = (log.offset - (starts - firsts)[part]) / known.size
    elif len(log):
        begin, span = position.min(), np.ptp(position)
        position = (position - begin) / (span or 1.0)
    return Sampled(log, position, part, is_timed)


def _holes(known: _Bytes, found: Sampled, columns: int) -> list[tuple[int, int, int]]:
    """Returns the bytes between two parts whose samples have empty columns between them.

    Returns:
        Start, end and number of columns. If parts without a sample are between the two, the longest range.
    """
    if not found.is_timed:
        return []
    parts, column = known.parts(), columns_of(found.position, columns)
    is_empty = np.ones(columns, np.bool_)
    is_empty[column] = False
    rows = np.flatnonzero(np.diff(found.part)) + 1
    holes = []
    for row in rows.tolist():
        count = int(is_empty[column[row - 1] : column[row]].sum())
        between = parts[found.part[row - 1] : found.part[row] + 1]
        start, end = max(
            ((one.end, other.start) for one, other in pairwise(between)),
            key=lambda unread: unread[1] - unread[0],
        )
        if count:
            holes.append((start, end, count))
    return holes
