"""Parts of a log that can be read by themselves, in any process and any order."""

from __future__ import annotations

import io
import math
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import reduce
from typing import Any, Protocol

from xbus import _core
from xbus.files import file_version, is_plain, local_name
from xbus.log.arrivals import Arrivals, HostTimes, arrivals_of
from xbus.log.hostclock import HostClock
from xbus.log.identity import Identity
from xbus.log.legacy import Legacy
from xbus.log.log import Log, LogDevice, MissingDeviceError, log_devices
from xbus.log.pieces import KnownPieces, pieces_of
from xbus.log.read import STEP, reader_of, thread_count
from xbus.log.source import (
    LogChangedError,
    QuantityFilter,
    Readable,
    Source,
    array_of,
    check_bid,
    open_range,
    open_source,
    quantity_filter,
    with_storage_options,
)
from xbus.protocol.keys import Key
from xbus.protocol.tables import device_of
from xbus.protocol.values import StringType
from xbus.remote import Version
from xbus.wire.strings import mask_of

__all__ = ["PART", "LogChangedError", "LogPart", "Part", "joined_parts", "split_log"]

#: Bytes after a part that decide how it ends: more than two of the longest frames.
LOOKAHEAD = 1 << 18
#: Default size of a part, in bytes of input. A process that reads one should have more to do than to start.
PART = 64 << 20
#: What messages say of a file that is no longer what it was.
CHANGED = "has changed since it was split; split it again"
SPLIT_CHANGED = "changed while it was split; split it again"


class Part(Protocol):
    """What can be written part by part: a `LogPart`, or a part of a capture.

    Attributes:
        end: Where the part ends in its input.
        samples: Number of its samples.
        earliest: The earliest `Log.time` of its samples in s, NaN if none has a time.
    """

    @property
    def end(self) -> int: ...  # noqa: D102
    @property
    def samples(self) -> int: ...  # noqa: D102
    @property
    def earliest(self) -> float: ...  # noqa: D102

    def read(self, *, quantities: Iterable[Key] | None = None) -> Log:
        """Returns the part as a log with the columns of the whole log."""

    def empty(self, *, quantities: Iterable[Key] | None = None) -> Log:
        """Returns a log without samples, with the columns of the whole log."""


@dataclass(frozen=True)
class _Whole:
    """What the parts of a log have in common.

    Attributes:
        versions: What changes with each piece of the input; None for bytes, which do not change.
        strings: String types to look for, as bits.
        bid: The device whose samples are read, or None for all.
        shape: The columns of the log.
        has_host_times: Whether a sample has a host time.
        devices: The devices that sent samples.
        is_plain: Whether the input is one local file that is not compressed.
    """

    versions: tuple[Version | None, ...]
    strings: int
    bid: int | None
    shape: _core.Shape
    has_host_times: bool
    devices: tuple[LogDevice, ...]
    is_plain: bool


@dataclass(frozen=True)
class _Begin:
    """How to read a part.

    Attributes:
        source: The input, or the bytes of the part.
        is_last: Whether no part follows.
        state: State of the reader at the beginning.
        identities: The identities of devices that are known by then.
        clocks: Their host clocks by then.
        arrivals: When the bytes of the part arrived, or None.
    """

    source: Any
    is_last: bool
    state: bytes
    identities: dict[int, Identity]
    clocks: dict[int, HostClock]
    arrivals: Arrivals | None = field(compare=False)


@dataclass(frozen=True)
class LogPart:
    """A part of a log that can be read by itself: a recipe, which can be pickled. Made by `split_log`.

    Attributes:
        start: Byte offset in the input at which the part begins.
        end: Byte offset at which it ends.
        first_sample: Index of its first sample in the log.
        samples: Number of its samples.
        earliest: The earliest `Log.time` of its samples in s, NaN if none has a time.
        latest: The latest time, in s.
        is_ascending: Whether all samples have a time and none is earlier than the one before.

    >>> import xbus
    >>> parts = xbus.split_log("tests/captures/walk.mtb", block_bytes=60_000)
    >>> [(part.first_sample, part.samples) for part in parts]
    [(0, 369), (369, 370), (739, 301)]
    """

    start: int
    end: int
    first_sample: int
    samples: int
    earliest: float
    latest: float
    is_ascending: bool
    _begin: _Begin = field(repr=False)
    _whole: _Whole = field(repr=False)

    def read(self, *, quantities: Iterable[Key] | None = None, threads: int | None = 1) -> Log:
        """Returns the part as a log whose samples, offsets, times and counters are those of the whole log.

        It has the columns of the whole log, with the same types; those of quantities that do not occur in the
        part are empty. So the tables of all parts have the same columns.

        Args:
            quantities: As in `read_log`.
            threads: As in `read_log`. One by default: usually each process reads another part.

        Raises:
            OSError: The input cannot be read.
            LogChangedError: The input has changed since it was split.
            ValueError: A quantity that does not exist, or fewer threads than one.

        >>> import xbus
        >>> parts = xbus.split_log("tests/captures/walk.mtb", block_bytes=20_000)
        >>> part = parts[1].read(quantities=["acceleration"])
        >>> len(part), part.first_sample == parts[0].samples
        (124, True)
        """
        keep, begin, whole = quantity_filter(quantities), self._begin, self._whole
        # Each comparison takes 3 % of the time of a part of a megabyte. The one after reading decides; this
        # one avoids requests and decompression in vain.
        if not whole.is_plain:
            _check_versions(begin.source, whole.versions, CHANGED)
        try:
            reader = reader_of(
                _opened(begin.source, self.start, self.end, plain=whole.is_plain),
                strict=False,
                quantities=keep,
                strings=whole.strings,
                part_bytes=self.end - self.start,
                threads=thread_count(threads),
                state=begin.state,
            )
            more = True
            while more and (begin.is_last or reader.position < self.end):
                more = reader.advance(
                    STEP if begin.is_last else min(STEP, self.end - reader.position)
                )
        except OSError:
            _check_versions(begin.source, whole.versions, CHANGED)  # why it cannot be read
            raise
        _check_versions(begin.source, whole.versions, CHANGED)
        if reader.position != self.end:
            raise self._changed()
        log = self._log(reader, keep)
        if len(log) != self.samples:
            raise self._changed()
        return log

    def empty(self, *, quantities: Iterable[Key] | None = None) -> Log:
        """Returns a log without samples, with the columns and the devices of the whole log.

        It gives the schema of the tables of all parts without reading any of them: types, units and names.

        Args:
            quantities: As in `read_log`.

        >>> import xbus
        >>> part = xbus.split_log("tests/captures/walk.mtb")[0]
        >>> part.empty(quantities=["temperature"]).to_arrow().schema.names
        ['sample', 'time', 'temperature']
        """
        keep = quantity_filter(quantities)
        core = self._shape(keep).empty()
        host_times = HostTimes(core, is_known=self._whole.has_host_times)
        return Log(core, quantities=keep, host_times=host_times, devices=self._whole.devices)

    def _shape(self, keep: QuantityFilter | None) -> _core.Shape:
        shape = self._whole.shape
        return shape if keep is None else shape.of_wanted(keep)

    def _log(self, reader: _core.Reader, keep: QuantityFilter | None) -> Log:
        begin, whole, shape = self._begin, self._whole, self._shape(keep)
        try:
            core = reader.take_last(shape if whole.bid is None else None)
            log = Log(
                core,
                quantities=keep,
                identities=begin.identities,
                host_times=self._host_times(core),
            )
            if whole.bid is not None:
                log = log.of_device(whole.bid, self.first_sample, shape)
        except ValueError as error:
            raise self._changed() from error
        return log

    def _host_times(self, core: _core.Part) -> HostTimes:
        begin = self._begin
        is_known = self._whole.has_host_times
        arrivals = begin.arrivals and begin.arrivals.loaded()
        return HostTimes(core, arrivals, begin.clocks, is_known=is_known)

    def _changed(self) -> LogChangedError:
        return LogChangedError(f"{_name(self._begin.source)} {CHANGED}")


def split_log(
    source: Source | Sequence[Source],
    *,
    block_bytes: int = PART,
    bid: int | None = None,
    rate: float | None = None,
    strings: Iterable[StringType | str] = (),
    legacy: Legacy | None = None,
    allow_restart: bool = False,
    threads: int | None = None,
    progress: Callable[[int], None] | None = None,
    storage_options: Mapping[str, Any] | None = None,
) -> list[LogPart]:
    """Splits a log into parts that can be read in any process and any order.

    The log is read once, without decoding its values, to find out what each part has to know about the
    others: the index of the first sample, clocks, counters, devices and columns. Together the parts are
    exactly the result of `read_log`.

    Args:
        source: As in `read_log`, but no file object. Bytes and arrays are copied into the parts. A part of a
            file at a URL requests its own bytes only, and the server must support that. A part of a
            compressed file is read from the start of the file.
        block_bytes: Approximate size of a part, in bytes of input.
        bid: As in `read_log`.
        rate: As in `read_log`.
        strings: As in `read_log`.
        legacy: As in `read_log`.
        allow_restart: As in `read_log`.
        threads: As in `read_log`.
        progress: Called with the number of bytes that are read so far, after each part.
        storage_options: As in `read_log`. The parts keep them, also when they are pickled.

    Returns:
        The parts, in order; at least one.

    Raises:
        TypeError: A file object, a pipe or a device, which can be read only once.
        ValueError: ``block_bytes`` less than 1. The other errors are those of `read_log`.
        LogChangedError: A file changed while it was split.

    >>> import xbus
    >>> from concurrent.futures import ThreadPoolExecutor
    >>> parts = xbus.split_log("tests/captures/walk.mtb", block_bytes=20_000)
    >>> def strongest(part):
    ...     values = part.read(quantities=["acceleration"])["acceleration"].values
    ...     return float((values**2).sum(axis=1).max() ** 0.5)
    >>> with ThreadPoolExecutor() as pool:
    ...     round(max(pool.map(strongest, parts)), 2)
    12.43
    """
    if block_bytes < 1:
        raise ValueError(f"block_bytes must be at least 1, not {block_bytes}")
    check_bid(bid)
    source = with_storage_options(source, storage_options)
    given: Any = tuple(source) if isinstance(source, list | tuple) else source
    if any(isinstance(one, Readable) for one in (given if isinstance(given, tuple) else (given,))):
        raise TypeError(
            "a log is split from a path, a URL or bytes; a file object can be read only once"
        )
    pieces = None
    if isinstance(given, tuple):
        pieces = pieces_of(tuple(map(_unchanging, given)), allow_restart=allow_restart)
        given = pieces.known()
        data = [source for source in pieces.sources if isinstance(source, bytes)]
        if len(data) == len(pieces.sources):
            pieces, given = None, b"".join(data)
    else:
        given = _unchanging(given)
    versions = _versions(given)
    if isinstance(given, KnownPieces):
        _check_sizes(given, versions)
    arrivals = arrivals_of(pieces or given)
    plain = _is_name(given) and is_plain(os.fsdecode(given))
    opened: Any = pieces or (
        open_range(given, 0, None) if _is_name(given) and not plain else open_source(given)
    )
    reader = reader_of(
        opened,
        strict=False,
        quantities=None,
        strings=mask_of(strings),
        legacy=legacy,
        part_bytes=block_bytes,
        rate=rate,
        threads=thread_count(threads),
        values=False,
    )
    first_pass = _FirstPass(bid)
    found = []
    try:
        for part in first_pass.parts(reader, given, block_bytes, arrivals):
            found.append(part)
            if progress is not None:
                progress(part[1])
    except OSError:
        _check_versions(given, versions, SPLIT_CHANGED)
        raise
    _check_versions(given, versions, SPLIT_CHANGED)
    whole = _Whole(
        versions,
        mask_of(strings),
        bid,
        first_pass.shape,
        first_pass.has_host_times,
        first_pass.devices,
        plain,
    )
    return [LogPart(*part, whole) for part in found]


def joined_parts(parts: Sequence[LogPart]) -> LogPart:
    """Returns neighbouring parts of a file as one."""
    first, last = parts[0], parts[-1]
    if len(parts) == 1:
        return first
    known = [part for part in parts if not math.isnan(part.earliest)]
    times = [time for part in known if part.samples for time in (part.earliest, part.latest)]
    return replace(
        first,
        end=last.end,
        samples=sum(part.samples for part in parts),
        earliest=min(times, default=math.nan),
        latest=max(times, default=math.nan),
        is_ascending=all(part.is_ascending for part in parts) and times == sorted(times),
        _begin=replace(first._begin, is_last=last._begin.is_last, arrivals=_arrivals_of(parts)),
    )


def _arrivals_of(parts: Sequence[LogPart]) -> Arrivals | None:
    """Returns the arrivals of the bytes of neighbouring parts, or None."""
    known = [part._begin.arrivals for part in parts if part._begin.arrivals is not None]
    return reduce(Arrivals.with_next, known) if known else None


class _FirstPass:
    """Reads a log once, without values, and finds its parts and its shape.

    Args:
        bid: The device whose samples are wanted, or None for all.
    """

    def __init__(self, bid: int | None) -> None:
        self._bid = bid
        self._shape, self._of_device = _core.Shape(), _core.Shape()
        self.has_host_times = False
        #: Number of samples of each device, by the BID of its first sample.
        self._samples: dict[int, int] = {}
        self._identities: dict[int, Identity] = {}

    @property
    def devices(self) -> tuple[LogDevice, ...]:
        """The devices that sent samples; only the wanted one if there is one."""
        devices = log_devices(self._samples, self._identities)
        return tuple(
            device
            for device in devices
            if self._bid is None or device_of(device.bid) == device_of(self._bid)
        )

    def _count(self, part: _core.Part) -> None:
        """Adds the samples of a part."""
        known = {device_of(bid): bid for bid in self._samples}
        for first, samples in part.devices:
            bid = known.get(device_of(first), first)
            self._samples[bid] = self._samples.get(bid, 0) + samples

    @property
    def shape(self) -> _core.Shape:
        return self._shape if self._bid is None else self._shape.of_device(self._of_device)

    def parts(
        self, reader: _core.Reader, source: Any, block_bytes: int, arrivals: Arrivals | None
    ) -> Iterator[tuple[int, int, int, int, float, float, bool, _Begin]]:
        """Yields the attributes of each part, and how to read it.

        Raises:
            MissingDeviceError: The log has no samples of the device.
        """
        is_bytes = not isinstance(source, KnownPieces) and not _is_name(source)
        clocks: dict[int, HostClock] = {}
        samples = 0
        more = True
        while more:
            start, state = reader.position, reader.state
            assert state is not None  # noqa: S101 - see below
            more = reader.advance(block_bytes)
            while (
                more and not reader.can_split
            ):  # a part ends with a frame or string, not in damage
                more = reader.advance(1)
            end = reader.position
            if end == start and start:
                break
            core = reader.take()
            log = Log(core, identities=self._identities)
            self._shape.add(core)
            self._count(core)
            own = core
            if self._bid is not None:
                own = core.of_device(self._bid, samples)
                self._of_device.add(own)
            data = _Bytes.of(source, start, end) if is_bytes else source
            arrived = None if arrivals is None else arrivals.between(start, end)
            begin = _Begin(data, not more, state, self._identities, clocks, arrived)
            earliest, latest, _, is_ascending = own.time_span
            yield start, end, samples, len(own), earliest, latest, is_ascending, begin
            samples += len(own)
            self._identities = log._identities
            if arrived is not None:
                clocks = HostTimes(core, arrived.loaded(), clocks).clocks
        self.has_host_times = bool(clocks)
        if self._bid is not None and not samples:
            raise MissingDeviceError(self._bid, self._samples)


@dataclass(frozen=True)
class _Bytes:
    """The bytes of a part, and what follows them."""

    data: bytes

    @classmethod
    def of(cls, source: Source, start: int, end: int) -> _Bytes:
        return cls(array_of(source)[start : end + LOOKAHEAD].tobytes())


def _opened(source: Any, start: int, end: int, *, plain: bool) -> Source | list[str]:
    """Returns what the core can read from ``start`` to ``end``; in a list, a file that is no pipe by now."""
    if isinstance(source, _Bytes):
        return io.BytesIO(source.data)
    if isinstance(source, KnownPieces):
        pieces = source.open()
        pieces.go_to(start, end)
        return pieces
    name = os.fsdecode(source)
    return [local_name(name)] if plain else open_range(source, start, end)


def _is_name(source: object) -> bool:
    return isinstance(source, str | os.PathLike)


def _unchanging(source: Any) -> Any:
    """Returns memory that others may write as bytes; other sources unchanged."""
    if _is_name(source) or isinstance(source, bytes):
        return source
    return array_of(source).tobytes()


def _name(source: Any) -> str:
    """Returns what messages call a source."""
    return os.fsdecode(source) if _is_name(source) else "the log"


def _each(source: Any) -> list[Any]:
    """Returns the pieces of a source."""
    return [piece for piece, *_ in source.pieces] if isinstance(source, KnownPieces) else [source]


def _versions(source: Any) -> tuple[Version | None, ...]:
    """Returns what changes with each piece; None for bytes, which do not change.

    Raises:
        OSError: A piece cannot be accessed.
        TypeError: A piece is a pipe or a device.
    """
    return tuple(file_version(os.fsdecode(one)) if _is_name(one) else None for one in _each(source))


def _check_sizes(pieces: KnownPieces, versions: tuple[Version | None, ...]) -> None:
    """Compares the sizes of pieces with what they were when their order was found.

    Raises:
        LogChangedError: One has changed.
    """
    for (source, _, size), version in zip(pieces.pieces, versions, strict=True):
        if None not in (size, version) and version[0] != size:  # type: ignore[index]
            raise LogChangedError(f"{_name(source)} {SPLIT_CHANGED}")


def _check_versions(source: Any, versions: tuple[Version | None, ...], problem: str) -> None:
    """Compares the pieces of a source with what they were.

    Raises:
        OSError: One cannot be accessed.
        LogChangedError: One has changed. The message is its name and ``problem``.
    """
    try:
        if _versions(source) == versions:
            return
    except TypeError:  # one has become a pipe or a device
        pass
    for one, before in zip(_each(source), versions, strict=True):
        try:
            is_same = _versions(one) == (before,)
        except TypeError:
            is_same = False
        if not is_same:
            raise LogChangedError(f"{_name(one)} {problem}")
