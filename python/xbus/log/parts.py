"""Parts of a log that can be read by themselves, in any process and any order."""

from __future__ import annotations

import io
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

from xbus.errors import XbusError
from xbus.files import file_version, is_plain
from xbus.log.arrivals import Arrivals, HostTimes, arrivals_of
from xbus.log.hostclock import HostClock
from xbus.log.identity import Identity
from xbus.log.log import Log
from xbus.log.pieces import Pieces, pieces_of
from xbus.log.read import BLOCK, STEP, reader_of, thread_count
from xbus.log.source import Readable, Source, array_of, open_range, quantity_filter
from xbus.protocol.keys import Key
from xbus.protocol.values import StringType
from xbus.remote import Version
from xbus.wire.strings import mask_of

__all__ = ["LogPart", "split_log"]

#: Bytes after a part that decide how it ends: more than two of the longest frames.
LOOKAHEAD = 1 << 18
#: What messages say of a file that is no longer what it was.
CHANGED = "has changed since it was split; split it again"


@dataclass(frozen=True)
class LogPart:
    """A part of a log that can be read by itself: a recipe, which can be pickled. Made by `split_log`.

    Attributes:
        start: Byte offset in the input at which the part begins.
        end: Byte offset at which it ends.
        first_sample: Index of its first sample in the log.
        samples: Number of its samples.
    """

    start: int
    end: int
    first_sample: int
    samples: int
    _source: Any = field(repr=False)
    _versions: tuple[Version | None, ...] = field(repr=False)
    _is_last: bool = field(repr=False)
    _state: bytes = field(repr=False)
    _identities: dict[int, Identity] = field(repr=False)
    _clocks: dict[int, HostClock] = field(repr=False)
    _strings: int = field(repr=False)
    _allow_restart: bool = field(repr=False)

    def read(self, *, quantities: Iterable[Key] | None = None, threads: int | None = 1) -> Log:
        """Returns the part as a log whose samples, offsets, times and counters are those of the whole log.

        Args:
            quantities: As in `read_log`.
            threads: As in `read_log`. One by default: usually each process reads a part of its own.

        Raises:
            OSError: The input cannot be read.
            XbusError: The input has changed since it was split.
            ValueError: A quantity that does not exist, or fewer threads than one.

        >>> import xbus
        >>> parts = xbus.split_log("tests/captures/walk.mtb", block_bytes=20_000)
        >>> part = parts[1].read(quantities=["acceleration"])
        >>> len(part), part.first_sample == parts[0].samples
        (124, True)
        """
        keep = quantity_filter(quantities)
        _check_versions(self._source, self._versions, CHANGED)
        source, arrivals = _opened(
            self._source, self.start, self.end, allow_restart=self._allow_restart
        )
        reader = reader_of(
            source,
            strict=False,
            quantities=keep,
            strings=self._strings,
            part_bytes=self.end - self.start,
            threads=thread_count(threads),
            state=self._state,
        )
        more = True
        while more and (self._is_last or reader.position < self.end):
            more = reader.advance(STEP if self._is_last else min(STEP, self.end - reader.position))
        core = reader.take()
        _check_versions(self._source, self._versions, CHANGED)
        if (reader.position, core.first, len(core)) != (self.end, self.first_sample, self.samples):
            raise XbusError(f"{_name(self._source)} {CHANGED}")
        host_times = HostTimes(core, arrivals, self._clocks)
        return Log(core, quantities=keep, identities=self._identities, host_times=host_times)


def split_log(
    source: Source | Sequence[Source],
    *,
    block_bytes: int = BLOCK,
    rate: float | None = None,
    strings: Iterable[StringType | str] = (),
    allow_restart: bool = False,
    threads: int | None = None,
) -> list[LogPart]:
    """Splits a log into parts that can be read in any process and any order.

    The log is read once, to find out what each part has to know about those before it: the index of the first
    sample, clocks, counters and devices. Together the parts are exactly the result of `read_log`.

    Args:
        source: As in `read_log`, but no file object. Bytes and arrays are copied into the parts. A part of a
            file at a URL requests its own bytes only, and the server must support that. A part of a
            compressed file is read from the start of the file.
        block_bytes: Approximate size of a part, in bytes of input.
        rate: As in `read_log`.
        strings: As in `read_log`.
        allow_restart: As in `read_log`.
        threads: As in `read_log`.

    Returns:
        The parts, in order; at least one.

    Raises:
        TypeError: A file object, which can be read only once.
        ValueError: ``block_bytes`` less than 1. The other errors are those of `read_log`.
        XbusError: A file changed while it was split.

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
    given: Any = tuple(source) if isinstance(source, list | tuple) else source
    if any(isinstance(one, Readable) for one in (given if isinstance(given, tuple) else (given,))):
        raise TypeError(
            "split_log needs a path, a URL or bytes; a file object can be read only once"
        )
    is_bytes = not isinstance(given, tuple) and not _is_name(given)
    versions = _versions(given)
    opened, arrivals = _opened(given, 0, allow_restart=allow_restart)
    mask = mask_of(strings)
    reader = reader_of(
        opened,
        strict=False,
        quantities=[],
        strings=mask,
        part_bytes=block_bytes,
        rate=rate,
        threads=thread_count(threads),
    )
    parts: list[LogPart] = []
    identities: dict[int, Identity] = {}
    clocks: dict[int, HostClock] = {}
    more = True
    while more:
        start, state = reader.position, reader.state
        assert state is not None  # noqa: S101 - see below
        more = reader.advance(block_bytes)
        while more and not reader.can_split:  # a part ends with a frame or string, not in damage
            more = reader.advance(1)
        core = reader.take()
        end = reader.position
        if end == start and parts:
            break
        host_times = HostTimes(core, arrivals, clocks)
        parts.append(
            LogPart(
                start,
                end,
                core.first,
                len(core),
                _Bytes.of(given, start, end) if is_bytes else given,
                versions,
                not more,
                state,
                identities,
                clocks,
                mask,
                allow_restart,
            )
        )
        if arrivals is not None:
            clocks = host_times.clocks
        identities = Log(core, quantities=[], identities=identities)._identities
    _check_versions(given, versions, "changed while it was split; split it again")
    return parts


@dataclass(frozen=True)
class _Bytes:
    """The bytes of a part, and what follows them."""

    data: bytes

    @classmethod
    def of(cls, source: Source, start: int, end: int) -> _Bytes:
        return cls(array_of(source)[start : end + LOOKAHEAD].tobytes())


def _opened(
    source: Any, start: int, end: int | None = None, *, allow_restart: bool
) -> tuple[Source | Readable, Arrivals | None]:
    """Returns what the core can read from ``start`` to ``end`` or the end, and the arrivals of all bytes."""
    if isinstance(source, _Bytes):
        return io.BytesIO(source.data), None
    whole = pieces_of(source, allow_restart=allow_restart) if isinstance(source, tuple) else source
    arrivals = arrivals_of(whole)
    if isinstance(whole, Pieces):
        if end is not None:
            whole.go_to(start, end)
        return whole, arrivals
    if not _is_name(whole) or is_plain(os.fsdecode(whole)):
        return whole, arrivals
    return open_range(whole, start, end), arrivals


def _is_name(source: object) -> bool:
    return isinstance(source, str | os.PathLike)


def _name(source: Any) -> str:
    """Returns what messages call a source."""
    return os.fsdecode(source) if _is_name(source) else "the log"


def _each(source: Any) -> tuple[Any, ...]:
    """Returns the pieces of a source."""
    return source if isinstance(source, tuple) else (source,)


def _versions(source: Any) -> tuple[Version | None, ...]:
    """Returns what changes with each piece; None for bytes, which do not change."""
    return tuple(file_version(os.fsdecode(one)) if _is_name(one) else None for one in _each(source))


def _check_versions(source: Any, versions: tuple[Version | None, ...], problem: str) -> None:
    """Compares the pieces of a source with what they were.

    Raises:
        OSError: One cannot be accessed.
        XbusError: One has changed. The message is its name and ``problem``.
    """
    for one, before, now in zip(_each(source), versions, _versions(source), strict=True):
        if before != now:
            raise XbusError(f"{_name(one)} {problem}")
