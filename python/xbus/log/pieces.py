"""A recording in several pieces, such as the files of ``xbus record --rotate``, as one input.

The order is that of the recorder's names (``walk.mtb``, ``walk-0001.mtb``, ...) or the given one, or, if that
does not fit, the order of the times at the start of each piece. Whether each piece continues the previous one
is decided from the samples at their ends.
"""

from __future__ import annotations

import errno
import math
import os
import re
import stat
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, BinaryIO, NamedTuple

import numpy as np

from xbus import _core
from xbus.files import (
    is_plain,
    is_url,
    local_name,
    suffix_of_compression,
    uncompressed_name,
)
from xbus.log.arrivals import Arrivals, arrivals_of, joined
from xbus.log.identity import IDENTITY_MESSAGES, Identity
from xbus.log.log import Log
from xbus.log.runs import steady_time
from xbus.log.source import (
    LONGEST,
    Readable,
    Source,
    array_of,
    check_head,
    open_binary,
    open_range,
    skip,
)
from xbus.protocol.configuration import Configuration
from xbus.protocol.ids import MessageId
from xbus.protocol.tables import PRODUCTS, device_of
from xbus.remote import SHORTER, remote_version

__all__ = ["PieceName", "Pieces", "PiecesError", "name_of_piece", "piece_name", "pieces_of"]

#: Most pieces that several threads read: all of them are open at once.
MOST_OPEN = 256
#: Bytes at each end of a piece to search for samples: the second number if the first has none.
WINDOWS = (1 << 16, 1 << 22)
#: The times after which SampleTimeFine, in ticks of 0.1 ms, starts again from zero, in s.
WRAPS = tuple({product.fine_wrap / 10_000 for product in PRODUCTS.values()})
#: The longest step over such a wrap, in s. A longer one is taken for a step back.
WRAP_STEP = 60.0
#: The longest gap, in samples, between pieces whose names do not say that they belong together. Samples whose
#: frames are cut seem to be missing.
DIRECT_GAP = 10
#: The longest piece, in bytes, that may be a part of one frame, so that it need not have a sample.
FRAGMENT = 4096
#: What is wrong with a piece that can be read only once.
NO_PIECE = "cannot be one of several pieces, because its end is needed first; save it to a file"
#: The clock of a computer can be set back between two pieces, by this many ns.
ADJUSTMENT = 60 * 10**9


class PieceName(NamedTuple):
    """The name of a piece: what all pieces of a recording have in common, and the number.

    Attributes:
        recording: The path of the first piece, without the suffix of a compression.
        number: Number of the piece; 0 for the first, whose name has none.
    """

    recording: str
    number: int


class PiecesError(ValueError):
    """Two inputs are not pieces of one recording.

    Attributes:
        one: Name of the earlier piece.
        other: Name of the piece that does not continue it.
        reason: Why it does not.
        is_restart: Whether the device may have restarted between the two.
    """

    def __init__(self, one: str, other: str, reason: str, *, is_restart: bool) -> None:
        remedy = "read each recording by itself"
        if is_restart:
            remedy += ", or pass allow_restart=True if the device restarted in between"
        super().__init__(f"{other} does not continue {one}: {reason}; {remedy}")
        self.one, self.other, self.reason, self.is_restart = one, other, reason, is_restart


class Stamp(NamedTuple):
    """Time in s and packet counter of a device at one end of a piece; NaN and -1 if there are none.

    The interval is the median step of the time near this end.
    """

    time: float
    counter: int
    interval: float = math.nan


@dataclass(frozen=True)
class Ends:
    """What the start and the end of a piece show.

    Attributes:
        first: The first stamp of each device, by BID.
        last: The last stamp of each device, by BID.
        device_ids: The device identifiers in the messages at the start, by BID.
        head: The Configuration message before the first sample, or None.
    """

    first: dict[int, Stamp] = field(default_factory=dict)
    last: dict[int, Stamp] = field(default_factory=dict)
    device_ids: dict[int, set[int]] = field(default_factory=dict)
    head: bytes | None = None


@dataclass(frozen=True)
class Piece:
    """One of the inputs of a recording.

    Attributes:
        source: The input.
        name: Its name for messages.
        ends: What its start and its end show.
        arrivals: When its bytes arrived, or None.
        size: Its size in bytes, or None if that is not known.
        start: Where it begins if it is a file object.
    """

    source: Source
    name: str
    ends: Ends
    arrivals: Arrivals | None
    size: int | None
    start: int = 0


def piece_name(path: str) -> PieceName:
    """Returns what the name of a file says about its place in a recording.

    >>> piece_name("logs/walk-0012.mtb.gz")
    PieceName(recording='logs/walk.mtb', number=12)
    """
    folder, name = os.path.split(path)
    name = uncompressed_name(name)
    stem, suffix = os.path.splitext(name)  # noqa: PTH122 - pathlib is slow to import
    found = re.fullmatch(r"(.+)-([0-9]{4,})", stem)
    if found is None:
        return PieceName(os.path.join(folder, name), 0)  # noqa: PTH118
    return PieceName(os.path.join(folder, found[1] + suffix), int(found[2]))  # noqa: PTH118


def name_of_piece(recording: str, number: int) -> str:
    """Returns the name of a piece, as the recorder gives it: the inverse of `piece_name`.

    >>> name_of_piece("logs/walk.mtb", 12), name_of_piece("logs/walk.mtb", 0)
    ('logs/walk-0012.mtb', 'logs/walk.mtb')
    """
    stem, suffix = os.path.splitext(recording)  # noqa: PTH122 - pathlib is slow to import
    return f"{stem}-{number:04}{suffix}" if number else recording


class Pieces:
    """The pieces of one recording, in order, as one binary file object. Made by `pieces_of`.

    Attributes:
        names: Name of each piece, in order.
        notes: What is unusual: pieces that are missing, and restarts between pieces.
    """

    def __init__(self, pieces: Sequence[Piece], notes: Sequence[str] = ()) -> None:
        self._pieces = list(pieces)
        self.names = [piece.name for piece in pieces]
        self.sources = [piece.source for piece in pieces]
        self.notes = list(notes)
        self._unopened = list(pieces)
        self._file: BinaryIO | Readable | None = None
        self._is_owned = False
        self._name = ""
        #: Bytes of the current piece that are not read yet; fewer than 0 if it has grown.
        self._left = 0
        #: The bytes of the next piece and those after it that are read, if they are known.
        self._range: tuple[int, int] | None = None

    def __length_hint__(self) -> int:
        """Size of all pieces in bytes, 0 if not known."""
        sizes = [piece.size for piece in self._pieces]
        return 0 if None in sizes else sum(size or 0 for size in sizes)

    @property
    def paths(self) -> list[str] | None:
        """The paths of the pieces if these are local files, and not too many to have them all open."""
        paths = [
            local_name(os.fsdecode(source))
            for source in self.sources
            if isinstance(source, str | os.PathLike) and is_plain(os.fsdecode(source))
        ]
        return paths if len(paths) == len(self._unopened) <= MOST_OPEN else None

    def check_sizes(self, paths: Sequence[str]) -> None:
        """Raises OSError if one of the `paths` has become shorter since its end was read."""
        for path, piece in zip(paths, self._pieces, strict=True):
            if os.stat(path).st_size < (piece.size or 0):  # noqa: PTH116
                raise OSError(errno.EIO, SHORTER, piece.name)

    def known(self) -> KnownPieces:
        """Returns what is needed to read the pieces in another process."""
        return KnownPieces(tuple((piece.source, piece.name, piece.size) for piece in self._pieces))

    def go_to(self, start: int, end: int) -> None:
        """Goes to ``start``, without opening the pieces before. The pieces are read up to ``end``."""
        while self._unopened and (size := self._unopened[0].size) is not None and size <= start:
            self._unopened.pop(0)
            start, end = start - size, end - size
        self._range = (start, end)
        if self._unopened and self._unopened[0].size is None:
            self._range = (0, end)
            skip(self, start)

    def read(self, size: int = -1, /) -> bytes:
        """Returns at most ``size`` bytes; none after the last piece.

        Raises:
            OSError: A piece cannot be read, or has become shorter: the next one does not continue it.
        """
        while True:
            if self._file is None:
                if not self._unopened:
                    return b""
                piece = self._unopened.pop(0)
                self._name, self._left = piece.name, piece.size or 0
                self._file = self._open(piece)
                self._is_owned = self._file is not piece.source
                if not self._is_owned:
                    self._file.seek(piece.start)  # type: ignore[attr-defined]
            if data := self._file.read(size):
                self._left -= len(data)
                return data
            if self._left > 0:
                raise OSError(errno.EIO, SHORTER, self._name)
            self.close()

    def _open(self, piece: Piece) -> BinaryIO | Readable:
        if self._range is None:
            return open_binary(piece.source)
        start, end = self._range
        self._range = (0, end - (piece.size or 0))
        self._left -= start
        return open_range(piece.source, start, end)

    def again(self) -> Pieces:
        """Returns the same pieces, to be read from their start."""
        return Pieces(self._pieces, self.notes)

    def close(self) -> None:
        """Closes the current piece, unless the caller opened it."""
        if self._file is not None and self._is_owned:
            self._file.close()  # type: ignore[attr-defined]
        self._file = None

    def __del__(self) -> None:
        self.close()

    def arrivals(self) -> Arrivals | None:
        """Returns the arrivals of the bytes, from the side files; None if a piece has none."""
        return joined(piece.arrivals for piece in self._pieces)


@dataclass(frozen=True)
class KnownPieces:
    """Pieces that are checked and in order: source, name and size of each."""

    pieces: tuple[tuple[Source, str, int | None], ...]

    def open(self) -> Pieces:
        """Returns the pieces, without their arrivals."""
        return Pieces(
            [Piece(source, name, Ends(), None, size) for source, name, size in self.pieces]
        )


def pieces_of(
    sources: Sequence[Source],
    *,
    allow_restart: bool = False,
    direct: bool = False,
) -> Pieces:
    """Returns the pieces of a recording in order.

    Args:
        sources: The pieces, in any order.
        allow_restart: Accept that a device restarted between two pieces. With the consecutive names that the
            recorder gives, this is always accepted.
        direct: Accept only pieces that continue the previous one without a long gap.

    Raises:
        PiecesError: A piece does not continue the previous one.
        OSError: A piece cannot be read.
        ValueError: There are no pieces, or one is a stream or pipe whose end cannot be read before its start.
    """
    if not sources:
        raise ValueError("a recording in pieces needs at least one piece")
    pieces = [_piece(source, at) for at, source in enumerate(sources)]
    numbers = _numbers(pieces)
    if numbers is not None:
        ranks = sorted(range(len(pieces)), key=numbers.__getitem__)
        pieces, numbers = [pieces[at] for at in ranks], [numbers[at] for at in ranks]
        return Pieces(pieces, _check(pieces, numbers, allow_restart=allow_restart, direct=direct))
    orders = [pieces, *_by_time(pieces)]
    # An order without a long gap is better than one with a gap of days, in which the clock has wrapped.
    tries = [(order, True) for order in orders] + [(order, False) for order in orders if not direct]
    errors = []
    for order, is_direct in tries:
        try:
            notes = _check(order, None, allow_restart=allow_restart, direct=is_direct)
        except PiecesError as error:
            errors.append(error)
        else:
            return Pieces(order, notes)
    raise errors[0 if direct else len(orders)]


# The ends of a piece


def _piece(source: Source, at: int) -> Piece:
    name = f"piece {at + 1}"
    size: int | None = None
    if isinstance(source, str | os.PathLike):
        name = os.fsdecode(os.fspath(source))
        if not is_url(name) and stat.S_ISFIFO(os.stat(local_name(name)).st_mode):  # noqa: PTH116
            raise ValueError(f"{name} is a pipe and {NO_PIECE}")
        if is_plain(name):
            size = os.stat(local_name(name)).st_size  # noqa: PTH116
        elif is_url(name) and not suffix_of_compression(name):
            size, _ = remote_version(name)
    elif not isinstance(source, Readable):
        size = len(array_of(source))
    ends, start = _ends(source, name), 0
    if isinstance(source, Readable):
        file: Any = source
        start = file.tell()
        size = file.seek(0, os.SEEK_END) - start
        file.seek(start)
    return Piece(source, name, ends, arrivals_of(source), size, start)


def _ends(source: Source, name: str) -> Ends:
    ends = Ends()
    for window in WINDOWS:
        head, tail, is_whole = _windows(source, window)
        check_head(head, name)
        start = _decode(head)
        end = start if is_whole else _decode(tail)
        ends = _ends_of(start, end)
        if is_whole or (ends.first and ends.last):
            break
    return ends


def _windows(source: Source, window: int) -> tuple[bytes, bytes, bool]:
    """Returns the first and the last bytes of a piece, and whether the first are all of them."""
    file: Any = open_binary(source)
    is_given = file is source
    try:
        start = file.tell() if is_given else 0
        head = _read(file, window)
        tail = head
        if hasattr(file, "seek"):
            size = file.seek(0, os.SEEK_END) - start
            file.seek(start + max(size - window, 0))
            tail, is_whole = _read(file, window), size <= window
        else:
            is_whole = True
            while data := file.read(window):
                tail, is_whole = (tail + data)[-window:], False
    except (AttributeError, OSError) as error:
        if not is_given:
            raise
        raise ValueError(f"a stream {NO_PIECE}") from error
    else:
        if is_given:
            file.seek(start)
        return head, tail, is_whole
    finally:
        if not is_given:
            file.close()


def _read(file: Readable, size: int) -> bytes:
    """Returns ``size`` bytes, or fewer at the end of the file."""
    data = b""
    while len(data) < size and (more := file.read(size - len(data))):
        data += more
    return data


def _decode(data: bytes) -> Log:
    reader = _core.Reader(np.frombuffer(data, np.uint8), limit=LONGEST, strict=False, wanted=None)
    while reader.advance(len(data) + 1):
        pass
    return Log(reader.take())


def _ends_of(start: Log, end: Log) -> Ends:
    messages = [message for message in start.messages if message.mid in IDENTITY_MESSAGES]
    ids: dict[int, set[int]] = {}
    for message in messages:
        if (number := Identity().updated([message]).device_id) is not None:
            ids.setdefault(int(device_of(message.bid)), set()).add(number)
    heads = (
        message.payload
        for message in messages
        if message.mid == MessageId.Configuration and message.sample == 0
    )
    return Ends(_stamps(start, 0), _stamps(end, -1), ids, next(heads, None))


def _stamps(log: Log, at: int) -> dict[int, Stamp]:
    """Returns the first (0) or last (-1) stamp of each device."""
    stamps = {}
    time, bids = steady_time(log.core), device_of(log.bid)
    for bid in np.unique(bids).tolist():
        times = time[(bids == bid) & np.isfinite(time)]
        counters = log.packet_counter[(bids == bid) & (log.packet_counter >= 0)]
        stamps[bid] = Stamp(
            float(times[at]) if len(times) else math.nan,
            int(counters[at]) % 65536 if len(counters) else -1,
            float(np.median(np.diff(times))) if len(times) > 1 else math.nan,
        )
    return stamps


# Order and continuity


def _numbers(pieces: Sequence[Piece]) -> list[int] | None:
    """Returns the numbers in the names; None if the names are not those of one recording."""
    if len(pieces) < 2 or not all(isinstance(piece.source, str | os.PathLike) for piece in pieces):
        return None
    names = [piece_name(piece.name) for piece in pieces]
    numbers = [name.number for name in names]
    is_one = len({name.recording for name in names}) == 1 and len(set(numbers)) == len(numbers)
    return numbers if is_one else None


def _by_time(pieces: list[Piece]) -> list[list[Piece]]:
    """Returns orders by the first time or packet counter of each piece; none if one has neither.

    Both start again from zero after a while. The second order assumes that this was in the longest gap.
    """
    stamps = [next(iter(piece.ends.first.values()), Stamp(math.nan, -1)) for piece in pieces]
    keys: list[float] = [stamp.time for stamp in stamps]
    if not all(map(math.isfinite, keys)):
        keys = [stamp.counter for stamp in stamps]
        if min(keys) < 0:
            return []
    ranks = sorted(range(len(pieces)), key=keys.__getitem__)
    gaps = [keys[after] - keys[before] for before, after in pairwise(ranks)]
    start = gaps.index(max(gaps)) + 1 if gaps else 0
    return [[pieces[at] for at in order] for order in (ranks, ranks[start:] + ranks[:start])]


def _check(
    pieces: Sequence[Piece], numbers: list[int] | None, *, allow_restart: bool, direct: bool
) -> list[str]:
    """Returns what is unusual about pieces that belong together.

    Raises:
        PiecesError: They do not.
    """
    notes = []
    if numbers is not None and numbers[0]:
        notes.append(_missing(pieces[0].name, range(numbers[0])))
    last: dict[int, Stamp] = {}
    ids: dict[int, set[int]] = {}
    for at, (one, other) in enumerate(pairwise(pieces)):
        last |= one.ends.last
        for bid, found in one.ends.device_ids.items():
            ids[bid] = ids.get(bid, set()) | found
        is_consecutive = numbers is not None and numbers[at] + 1 == numbers[at + 1]
        if numbers is not None and not is_consecutive:
            missing = range(numbers[at] + 1, numbers[at + 1])
            notes.append(_missing(one.name, missing))
        if reason := _conflict(ids, last, other):
            raise PiecesError(one.name, other.name, reason, is_restart=False)
        if reason := _step_back(last, other.ends.first):
            by_recorder = (
                is_consecutive
                and numbers is not None
                and numbers[0] == 0
                and _is_one_session(pieces[0], one, other)
            )
            if not (allow_restart or by_recorder):
                raise PiecesError(one.name, other.name, reason, is_restart=True)
            if not allow_restart and _extent(one) == _extent(other):
                raise PiecesError(one.name, other.name, "it has the same samples", is_restart=True)
            notes.append(f"the device restarted before {other.name}")
        elif numbers is not None and _has_same_start(one, other):
            continue
        elif direct and (reason := _doubt(pieces[0], one, other, last)):
            raise PiecesError(one.name, other.name, reason, is_restart=False)
    return notes


def _conflict(ids: dict[int, set[int]], last: dict[int, Stamp], other: Piece) -> str | None:
    """Returns why a piece cannot follow those before; None if it can.

    Args:
        ids: The device identifiers in the pieces before, by BID. More devices can appear on a bus.
        last: The last stamp of each device in the pieces before.
        other: The piece.
    """
    for bid, found in other.ends.device_ids.items():
        if bid in ids and not ids[bid] & found:
            return f"it is from device {_hex(found)}, not {_hex(ids[bid])}"
    if last and other.ends.first and not last.keys() & other.ends.first.keys():
        return f"it has BID {_list(other.ends.first)}, not {_list(last)}"
    return None


def _extent(piece: Piece) -> tuple[dict[int, Stamp], dict[int, Stamp], int | None]:
    return piece.ends.first, piece.ends.last, piece.size


def _has_same_start(one: Piece, other: Piece) -> bool:
    """Returns whether two pieces begin with the same Configuration, in which their recording has a date."""
    if one.ends.head is None or one.ends.head != other.ends.head:
        return False
    configuration = Configuration.read(one.ends.head)
    return bool(configuration and configuration.date and configuration.date.strip("0"))


def _is_one_session(base: Piece, one: Piece, other: Piece) -> bool:
    """Returns whether nothing denies that the recorder started ``other`` after ``one`` in the same run.

    The Configuration at the start of each file has the date and time at which the recording started.
    """
    if base.ends.head is not None and other.ends.head not in (None, base.ends.head):
        return False
    before, after = (
        None if piece.arrivals is None else piece.arrivals.span() for piece in (one, other)
    )
    return before is None or after is None or after[0] >= before[1] - ADJUSTMENT


def _steps(
    last: dict[int, Stamp], first: dict[int, Stamp]
) -> Iterator[tuple[Stamp, Stamp, float | None, int | None]]:
    """Yields the stamps of each device on both sides, and the steps of its clock and its counter."""
    for bid in last.keys() & first.keys():
        one, other = last[bid], first[bid]
        time = None
        if math.isfinite(one.time) and math.isfinite(other.time):
            time = other.time - one.time
            wrapped = [time + wrap for wrap in WRAPS if 0 <= time + wrap <= WRAP_STEP]
            time = min(wrapped, default=time) if time < 0 else time
        counter = (other.counter - one.counter) % 65536 if min(one[1], other[1]) >= 0 else None
        yield one, other, time, counter


def _step_back(last: dict[int, Stamp], first: dict[int, Stamp]) -> str | None:
    """Returns how the clock of a device goes back, or its counter if it has no clock; None if it does not."""
    for one, other, time, counter in _steps(last, first):
        if time is not None:
            if time < 0:
                return f"the clock goes back from {one.time:,.2f} s to {other.time:,.2f} s"
        elif counter is not None and not 0 < counter < 32768:
            return f"the packet counter goes back from {one.counter} to {other.counter}"
    return None


def _doubt(base: Piece, one: Piece, other: Piece, last: dict[int, Stamp]) -> str | None:
    """Returns why it is doubtful that a piece directly continues the previous one; None if it does."""
    if base.ends.head is not None and other.ends.head not in (None, base.ends.head):
        return "it starts with another Configuration"
    for piece, stamps in ((one, last), (other, other.ends.first)):
        if not stamps and (piece.size is None or piece.size > FRAGMENT):
            return f"{piece.name} has no samples that show it"
    for before, _, time, counter in _steps(last, other.ends.first):
        if counter is not None:
            if counter > DIRECT_GAP:
                return f"it begins {counter:,} samples later"
        elif time is None:
            return "neither time stamps nor a packet counter show that it does"
        elif not time <= DIRECT_GAP * before.interval:
            return f"it begins {time:,.2f} s later"
    return None


def _missing(name: str, numbers: range) -> str:
    recording = piece_name(name).recording
    first, last = (name_of_piece(recording, number) for number in (numbers[0], numbers[-1]))
    return f"{first} is missing" if first == last else f"{first} to {last} are missing"


def _hex(ids: set[int]) -> str:
    return ", ".join(f"{number:08X}" for number in sorted(ids))


def _list(bids: dict[int, Stamp]) -> str:
    return ", ".join(map(str, sorted(bids)))
