"""Cuts recordings into parts of whole frames, byte for byte, while they are read."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from xbus import _core
from xbus.log.identity import HEAD_MESSAGES
from xbus.log.log import Log
from xbus.log.pacing import ReplayPace
from xbus.log.source import Readable
from xbus.protocol.ids import MessageId
from xbus.protocol.tables import RECEIVER, device_of
from xbus.wire.codec import encode_frame

__all__ = [
    "NEEDED", "Between", "Chunk", "Moment", "Parts", "cut", "seconds_of", "split_by_device", "split_by_size",
    "split_by_time",
]  # fmt: skip

#: A place in a recording: seconds since its first sample, or UTC as a datetime or text in ISO 8601.
Moment = float | str | datetime | np.datetime64
#: From the first moment on, up to but without the second; None for the start and the end.
Between = tuple[Moment | None, Moment | None]
#: Quantities to read from a log that is cut.
NEEDED = (*RECEIVER, "utc_time")
#: Reads the parts of a log from an input.
Parts = Callable[[Readable], Iterator[Log]]

#: A sample belongs to a moment if its time differs by less than this, in s: less than any tick.
TOLERANCE = 1e-6


class Chunk(NamedTuple):
    """Bytes of a piece.

    Attributes:
        piece: Number of the piece; the BID of a device.
        data: The next bytes of the piece.
    """

    piece: int
    data: bytes


class _Tee:
    """An input that keeps the bytes that were read from it until they are taken."""

    def __init__(self, source: Readable) -> None:
        #: From a buffered pipe, ``read1`` returns what is there.
        self._read = getattr(source, "read1", source.read)
        self._kept = bytearray()
        self._start = 0

    def read(self, size: int = -1, /) -> bytes:
        """Returns at most ``size`` bytes."""
        data: bytes = self._read(size)
        self._kept += data
        return data

    def take(self, end: int) -> bytes:
        """Returns the bytes up to an offset that were not taken yet."""
        count = end - self._start
        data = bytes(self._kept[:count])
        del self._kept[:count]
        self._start = end
        return data


class _Head:
    """The frames that every piece starts with: the latest of each of `HEAD_MESSAGES`."""

    def __init__(self) -> None:
        self._frames: dict[tuple[bool, int, int], bytes] = {}

    def add(self, part: Log, start: int, end: float) -> None:
        """Adds the messages of a part between two offsets."""
        messages = part.messages
        is_head = np.isin(messages.mid, HEAD_MESSAGES)
        is_head &= (messages.offset >= start) & (messages.offset < end)
        for row in np.flatnonzero(is_head).tolist():
            message = messages[row]
            frame = encode_frame(message.mid, message.payload, bid=message.bid)
            is_other = message.mid != MessageId.Configuration
            self._frames[is_other, message.mid, message.bid] = frame

    def __bytes__(self) -> bytes:
        return b"".join(frame for _, frame in sorted(self._frames.items()))


def cut(source: Readable, parts: Parts, start: float, end: float) -> Iterator[bytes]:
    """Yields the bytes of a recording between two times, with its Configuration at the start.

    The bytes begin with the frame of the first sample at or after ``start``, or with the first byte of the
    recording, and end before the frame of the first sample at or after ``end``.

    Args:
        source: The recording.
        parts: Reads the parts of a log, with the quantities in `NEEDED`.
        start: Seconds since the first sample.
        end: The same.

    Raises:
        ValueError: The samples have no time stamps.
    """
    pace = ReplayPace(math.inf)

    def number(part: Log) -> npt.NDArray[np.int64]:
        times = pace.times(part) + TOLERANCE
        return (times >= start).astype(np.int64) + (times >= end)

    for piece, data in _pieces(source, parts, number, 0 if start > 0 else 1):
        if piece == 1:
            yield data
        elif piece == 2:
            break
    _check_stamps(pace)


def split_by_time(source: Readable, parts: Parts, seconds: float) -> Iterator[Chunk]:
    """Yields the chunks of pieces that last this long.

    Raises:
        ValueError: The samples have no time stamps.
    """
    pace = ReplayPace(math.inf)

    def number(part: Log) -> npt.NDArray[np.int64]:
        return ((pace.times(part) + TOLERANCE) // seconds).astype(np.int64)

    yield from _pieces(source, parts, number, 0)
    _check_stamps(pace)


def split_by_size(source: Readable, parts: Parts, size: int) -> Iterator[Chunk]:
    """Yields the chunks of pieces that end with the first sample at which they have this many bytes."""
    piece = start = 0

    def number(part: Log) -> npt.NDArray[np.int64]:
        nonlocal piece, start
        numbers = np.empty(len(part), np.int64)
        at = 0
        while at < len(part):
            full = int(np.searchsorted(part.offset, start + size))
            numbers[at:full] = piece
            if full < len(part):
                piece, start = piece + 1, int(part.offset[full])
            at = full
        return numbers

    yield from _pieces(source, parts, number, 0)


def _pieces(
    source: Readable, parts: Parts, number: Callable[[Log], npt.NDArray[np.int64]], piece: int
) -> Iterator[Chunk]:
    """Yields the chunks of pieces, each of which begins with the frame of a sample.

    Args:
        source: The recording.
        parts: Reads its parts.
        number: Returns the number of the piece of each sample of the next part; never descending.
        piece: Number of the piece with the first byte.
    """
    tee, head = _Tee(source), _Head()
    start = end = 0
    is_first = True
    for part in parts(tee):
        numbers = number(part)
        if is_first and len(numbers):
            piece = max(piece, int(numbers[0]))  # what precedes the first sample belongs to it
            is_first = False
        changes = np.flatnonzero(np.diff(numbers, prepend=piece))
        for row in changes.tolist():
            offset = int(part.offset[row])
            if data := tee.take(offset):
                yield Chunk(piece, data)
            head.add(part, start, offset)
            start, piece = offset, int(numbers[row])
            if head_bytes := bytes(head):
                yield Chunk(piece, head_bytes)
        end += part.stats.bytes
        if data := tee.take(end):
            yield Chunk(piece, data)
        head.add(part, start, math.inf)
        start = end


def split_by_device(source: Readable, parts: Parts) -> Iterator[Chunk]:
    """Yields the frames of each device; strings and damage, which name no device, are left out.

    The number of a piece is the BID of its device, 1 for FF.
    """
    tee = _Tee(source)
    offset = 0
    for part in parts(tee):
        end = offset + part.stats.bytes
        data = tee.take(end)
        starts = np.concatenate([part.offset, part.messages.offset]) - offset
        bids = device_of(np.concatenate([part.bid, part.messages.bid]))
        order = np.argsort(starts)
        pieces: dict[int, list[bytes]] = {}
        for start, bid in zip(starts[order].tolist(), bids[order].tolist(), strict=True):
            size = _core.frame_size(data[start : start + _core.EXTENDED_HEADER_SIZE])
            assert size is not None  # noqa: S101 - a frame that was accepted
            pieces.setdefault(bid, []).append(data[start : start + size])
        for bid, found in pieces.items():
            yield Chunk(bid, b"".join(found))
        offset = end


def seconds_of(moments: Between, parts: Callable[[], Iterator[Log]]) -> tuple[float, float]:
    """Returns moments as seconds since the first sample.

    Args:
        moments: The moments.
        parts: Reads the parts of the recording, with the quantities in `NEEDED`, if UTC is needed.

    Raises:
        ValueError: A moment is no time, the second is not after the first, or the recording has no valid UTC.
    """
    if len(moments) != 2:
        raise ValueError(f"between has two moments, a start and an end, not {moments!r}")
    wanted = [_moment(moment) for moment in moments]
    if any(isinstance(moment, np.datetime64) for moment in wanted):
        times, utc = _utc(parts())
        origin = utc[0]
        known = (utc - origin) / np.timedelta64(1, "s")
        wanted = [
            _interpolated((moment - origin) / np.timedelta64(1, "s"), known, times)
            if isinstance(moment, np.datetime64)
            else moment
            for moment in wanted
        ]
    start, end = wanted
    start = 0.0 if start is None else float(start)
    end = math.inf if end is None else float(end)
    if not start < end:
        raise ValueError(f"the end must be after the start: {moments[0]} to {moments[1]}")
    return start, end


def _moment(moment: Moment | None) -> float | np.datetime64 | None:
    if moment is None or isinstance(moment, np.datetime64):
        return moment
    if isinstance(moment, int | float | np.number):
        if math.isnan(moment):
            raise ValueError("a moment must be a number of seconds or UTC, not NaN")
        return float(moment)
    try:
        date = datetime.fromisoformat(moment) if isinstance(moment, str) else moment
        if date.tzinfo is not None:
            date = date.astimezone(UTC).replace(tzinfo=None)
        return np.datetime64(date, "ns")
    except (AttributeError, ValueError):
        raise ValueError(
            f"{moment!r} is neither seconds nor UTC such as 2026-11-22T09:30:00"
        ) from None


def _utc(parts: Iterator[Log]) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.datetime64]]:
    """Returns seconds since the first sample, and UTC, where UTC is known."""
    pace = ReplayPace(math.inf)
    times, dates = [], []
    for part in parts:
        seconds = pace.times(part)
        is_known = ~np.isnat(part.utc)
        times.append(seconds[is_known])
        dates.append(part.utc[is_known])
    if not sum(map(len, times)):
        raise ValueError("the recording has no valid UTC; use seconds")
    return np.concatenate(times), np.concatenate(dates)


def _interpolated(
    at: np.float64, known: npt.NDArray[np.float64], times: npt.NDArray[np.float64]
) -> float:
    order = np.argsort(known, kind="stable")
    known, times = known[order], times[order]
    beyond = min(at - known[0], 0.0) + max(at - known[-1], 0.0)
    return float(np.interp(at, known, times) + beyond)


def _check_stamps(pace: ReplayPace) -> None:
    if not pace.is_stamped:
        raise ValueError("the samples have no time stamps, so times in the recording are not known")
