"""Cuts recordings into parts of whole frames, byte for byte, while they are read."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from xbus import _core
from xbus.log.arrivals import Arrivals
from xbus.log.identity import HEAD_MESSAGES, SETTINGS_MESSAGES, has_mtdata
from xbus.log.log import Log, MissingDeviceError
from xbus.log.messages import Messages
from xbus.log.pacing import ReplayPace
from xbus.log.source import Readable, input_name
from xbus.protocol.ids import MessageId
from xbus.protocol.tables import RECEIVER, device_of
from xbus.wire.codec import encode_frame
from xbus.wire.message import Message

__all__ = [
    "NEEDED", "Chunk", "Parts", "cut", "device_heads", "split_by_device", "split_by_size", "split_by_time",
]  # fmt: skip

#: Quantities to read from a log that is cut.
NEEDED = (*RECEIVER, "utc_time")
#: Reads the parts of a log from an input.
Parts = Callable[[Readable], Iterator[Log]]

#: A sample belongs to a moment if its time differs by less than this, in s: less than any tick.
TOLERANCE = 1e-6


#: The ranges of frames that are repeated.
NOWHERE = np.empty(0, np.int64)


class Chunk(NamedTuple):
    """Bytes of a piece.

    Attributes:
        piece: Number of the piece; the BID of a device.
        data: The next bytes of the piece.
        start: Offset in the recording at which each range of bytes in ``data`` begins, ``(n,)`` int64. No
            ranges stand for frames that are repeated at the start of a piece.
        end: Offset at which it ends.
    """

    piece: int
    data: bytes
    start: npt.NDArray[np.int64] = NOWHERE
    end: npt.NDArray[np.int64] = NOWHERE


class _Tee:
    """An input that keeps the bytes that were read from it until they are taken.

    Args:
        source: The input.
        arrivals: When its bytes arrived, or None if that is not known.

    Attributes:
        name: The name of the input for messages.
    """

    def __init__(self, source: Readable, arrivals: Arrivals | None = None) -> None:
        self.name = input_name(source)
        #: From a buffered pipe, ``read1`` returns what is there.
        self._read = getattr(source, "read1", source.read)
        self._arrivals = arrivals
        self._kept = bytearray()
        self._start = 0

    def arrivals(self) -> Arrivals | None:
        """Returns the arrivals of the bytes."""
        return self._arrivals

    def read(self, size: int = -1, /) -> bytes:
        """Returns at most ``size`` bytes."""
        data: bytes = self._read(size)
        self._kept += data
        return data

    def take(self, piece: int, end: int) -> Chunk:
        """Returns the bytes up to an offset that were not taken yet, as bytes of a piece."""
        start, count = self._start, end - self._start
        data = bytes(self._kept[:count])
        del self._kept[:count]
        self._start = end
        return Chunk(piece, data, np.array([start]), np.array([end]))


class _Head:
    """The frames that every piece starts with: the latest of each of `HEAD_MESSAGES`.

    Args:
        bid: The only device in the pieces, or None. The messages of other BIDs describe it too as long as it
            is the only one that sends samples, as in `identity_of`.
    """

    def __init__(self, bid: int | None = None) -> None:
        self._bid = bid
        self._frames: dict[tuple[bool, int, int], bytes] = {}
        #: The last requests for settings of MTData.
        self._requested: dict[tuple[int, int], bytes] = {}

    def add(self, messages: Messages, rows: npt.NDArray[np.intp], start: int, end: float) -> None:
        """Adds messages between two offsets.

        Args:
            messages: The messages of a part.
            rows: Those of `HEAD_MESSAGES`, from `_head_rows`.
            start: The first offset.
            end: The offset after the last.
        """
        first, last = np.searchsorted(messages.offset[rows], [start, end])
        for row in rows[first:last].tolist():
            message = messages[row]
            frame = encode_frame(message.mid, message.payload, bid=message.bid)
            is_other = message.mid != MessageId.Configuration
            if message.mid in SETTINGS_MESSAGES:
                self._add_settings(message, frame)
                continue
            if not is_other and has_mtdata(message.payload):
                self._frames = {
                    key: kept
                    for key, kept in self._frames.items()
                    if key[1] not in SETTINGS_MESSAGES
                }
            self._frames[is_other, message.mid, message.bid] = frame

    def _add_settings(self, message: Message, frame: bytes) -> None:
        """Adds a reply with OutputMode or OutputSettings, or an acknowledged request.

        An acknowledgement without its request leaves the settings unknown.
        """
        mid, bid = message.mid, message.bid
        if mid in (MessageId.SetOutputMode, MessageId.SetOutputSettings):
            self._requested[mid, bid] = frame
            return
        requested = None if message.payload else self._requested.get((mid - 1, bid))
        if requested is None:
            self._frames.pop((True, mid - 1, bid), None)
        else:
            self._frames[True, mid - 1, bid] = requested
        self._frames[True, mid, bid] = frame

    def frames(self, devices: Iterable[int]) -> bytes:
        """Returns the frames.

        Args:
            devices: The devices that have sent samples, by BID; 1 stands for FF too.
        """
        return b"".join(
            frame
            for (_, _, bid), frame in sorted(self._frames.items())
            if self._bid is None or device_of(bid) == self._bid or set(devices) <= {self._bid}
        )


def _head_rows(messages: Messages) -> npt.NDArray[np.intp]:
    return np.flatnonzero(np.isin(messages.mid, HEAD_MESSAGES))


def _frames_of(own: Log) -> npt.NDArray[np.int64]:
    """Returns where the frames of a part of one device begin, ``(n,)``, ascending."""
    return np.sort(np.concatenate([own.offset, own.messages.offset]))


def _only(starts: npt.NDArray[np.int64], chunk: Chunk) -> Chunk:
    """Returns the frames in a chunk that begin at some of these offsets."""
    begin, end = int(chunk.start[0]), int(chunk.end[0])
    starts = starts[slice(*np.searchsorted(starts, [begin, end]).tolist())]
    frames = []
    for start in (starts - begin).tolist():
        size = _core.frame_size(chunk.data[start : start + _core.EXTENDED_HEADER_SIZE])
        assert size is not None  # noqa: S101 - a frame that was accepted
        frames.append(chunk.data[start : start + size])
    return Chunk(
        chunk.piece, b"".join(frames), starts, starts + np.array(list(map(len, frames)), np.int64)
    )


def cut(
    source: Readable,
    parts: Parts,
    start: float,
    end: float,
    *,
    bid: int | None = None,
    arrivals: Arrivals | None = None,
) -> Iterator[Chunk]:
    """Yields the bytes of a recording between two times, with its Configuration at the start.

    The bytes begin with the frame of the first sample at or after ``start``, or with the first byte of the
    recording, and end before the frame of the first sample at or after ``end``.

    Args:
        source: The recording.
        parts: Reads the parts of a log, with the quantities in `NEEDED`.
        start: Seconds since the first sample.
        end: The same.
        bid: Leave out other devices, strings and damage; the times are those of this device.
        arrivals: When the bytes of the recording arrived, for the host times of the parts.

    Raises:
        MissingDeviceError: The device has no samples.
        ValueError: The samples have no time stamps.
    """
    pace = ReplayPace(math.inf)

    def number(part: Log) -> npt.NDArray[np.int64]:
        times = pace.times(part) + TOLERANCE
        return (times >= start).astype(np.int64) + (times >= end)

    tee = _Tee(source, arrivals)
    for chunk in _pieces(tee, parts, number, 0 if start > 0 else 1, bid):
        if chunk.piece == 1:
            yield chunk
        elif chunk.piece == 2:
            break
    _check_stamps(pace)


def split_by_time(
    source: Readable, parts: Parts, seconds: float, *, bid: int | None = None
) -> Iterator[Chunk]:
    """Yields the chunks of pieces that last this long.

    Raises:
        MissingDeviceError: The device has no samples.
        ValueError: The samples have no time stamps.
    """
    pace = ReplayPace(math.inf)

    def number(part: Log) -> npt.NDArray[np.int64]:
        return ((pace.times(part) + TOLERANCE) // seconds).astype(np.int64)

    yield from _pieces(_Tee(source), parts, number, 0, bid)
    _check_stamps(pace)


def split_by_size(
    source: Readable, parts: Parts, size: int, *, bid: int | None = None
) -> Iterator[Chunk]:
    """Yields the chunks of pieces that end with the first sample at which they have this many bytes.

    The bytes of other devices count, too, although they are left out with ``bid``.

    Raises:
        MissingDeviceError: The device has no samples.
    """
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

    yield from _pieces(_Tee(source), parts, number, 0, bid)


def _pieces(
    tee: _Tee,
    parts: Parts,
    number: Callable[[Log], npt.NDArray[np.int64]],
    piece: int,
    bid: int | None,
) -> Iterator[Chunk]:
    """Yields the chunks of pieces, each of which begins with the frame of a sample.

    Args:
        tee: The recording.
        parts: Reads its parts.
        number: Returns the number of the piece of each sample of the next part; never descending.
        piece: Number of the piece with the first byte.
        bid: The only device in the pieces, or None for all.
    """
    device = None if bid is None else device_of(bid)
    head = _Head(device)
    devices: set[int] = set()
    start = end = 0
    is_first = True

    def taken(upto: int) -> Iterator[Chunk]:
        chunk = tee.take(piece, upto)
        chunk = chunk if device is None else _only(frames_of_device, chunk)
        if chunk.data:
            yield chunk

    for part in parts(tee):
        devices |= set(np.unique(device_of(part.bid)).tolist())
        own = part if device is None else part.of_device(device)
        frames_of_device = NOWHERE if device is None else _frames_of(own)
        head_rows = _head_rows(part.messages)
        numbers = number(own)
        if is_first and len(numbers):
            piece = max(piece, int(numbers[0]))  # what precedes the first sample belongs to it
            is_first = False
        changes = np.flatnonzero(np.diff(numbers, prepend=piece))
        for row in changes.tolist():
            offset = int(own.offset[row])
            yield from taken(offset)
            head.add(part.messages, head_rows, start, offset)
            start, piece = offset, int(numbers[row])
            if frames := head.frames(devices):
                yield Chunk(piece, frames)
        end += part.stats.bytes
        yield from taken(end)
        head.add(part.messages, head_rows, start, math.inf)
        start = end
    if device is not None and device not in devices:
        raise MissingDeviceError(device, sorted(devices))


def split_by_device(source: Readable, parts: Parts, heads: Mapping[int, bytes]) -> Iterator[Chunk]:
    """Yields the frames of each device; strings and damage, which name no device, are left out.

    The number of a piece is the BID of its device, 1 for FF.

    Args:
        source: The recording.
        parts: Reads its parts.
        heads: The frames to put before those of each device, from `device_heads`.
    """
    tee = _Tee(source)
    begun: set[int] = set()
    end = 0
    for part in parts(tee):
        end += part.stats.bytes
        chunk = tee.take(0, end)
        for bid in np.unique(device_of(np.concatenate([part.bid, part.messages.bid]))).tolist():
            if bid not in begun and bid in heads:
                yield Chunk(bid, heads[bid])
            begun.add(bid)
            yield _only(_frames_of(part.of_device(bid)), chunk._replace(piece=bid))


def device_heads(parts: Iterable[Log]) -> dict[int, bytes]:
    """Returns the frames that identify each device and would otherwise not be at the start of its piece.

    These are its own messages after its first sample, and those of other BIDs if no other device sends
    samples: each part then has the identity that the device has in the whole recording.

    Args:
        parts: The parts of the whole recording.
    """
    # Settings of MTData count from where they are.
    mids = [mid for mid in HEAD_MESSAGES if mid not in SETTINGS_MESSAGES]
    first: dict[int, int] = {}
    messages: dict[tuple[int, int], Message] = {}
    for part in parts:
        devices, rows = np.unique(device_of(part.bid), return_index=True)
        for device, row in zip(devices.tolist(), rows.tolist(), strict=True):
            first.setdefault(device, part.first_sample + row)
        for message in part.messages.with_mids(*mids):
            messages.setdefault((message.mid, message.bid), message)
    heads = {}
    for device, sample in first.items():
        heads[device] = b"".join(
            encode_frame(message.mid, message.payload, bid=message.bid)
            for message in messages.values()
            if (message.sample > sample if device_of(message.bid) == device else len(first) == 1)
        )
    return heads


def _check_stamps(pace: ReplayPace) -> None:
    if not pace.is_stamped:
        raise ValueError("the samples have no time stamps, so times in the recording are not known")
