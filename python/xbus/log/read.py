"""Reads logs: whole, or in parts."""

from __future__ import annotations

import functools
import math
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

from xbus import _core
from xbus.errors import DecodeError
from xbus.log.arrivals import HostTimes, arrivals_of
from xbus.log.cut_source import CutSource
from xbus.log.cutting import NEEDED
from xbus.log.hostclock import HostClock
from xbus.log.identity import Identity
from xbus.log.legacy import Legacy, legacy_outputs
from xbus.log.log import Log, MissingDeviceError
from xbus.log.memory import keep_freed_memory
from xbus.log.moments import Between, seconds_of
from xbus.log.pieces import Pieces, pieces_of
from xbus.log.source import (
    LONGEST,
    QuantityFilter,
    Readable,
    Source,
    check_bid,
    check_head,
    input_name,
    open_binary,
    open_source,
    quantity_filter,
    size_hint,
    with_storage_options,
)
from xbus.protocol.keys import Key
from xbus.protocol.values import StringType
from xbus.wire.strings import mask_of, string_types

__all__ = ["BLOCK", "STEP", "cut_parts", "iter_log", "read_log", "reader_of", "thread_count"]

#: Bytes that a thread reads at a time: Ctrl-C and progress are handled between two reads.
STEP = 32 << 20
#: Default size of a part, in bytes of input. Smaller parts cost more calls, and the columns of larger ones
#: do not fit into the processor's caches.
BLOCK = 8 << 20
#: Size of the parts of a log that is cut.
CUT_BLOCK = 1 << 20


def read_log(
    source: Source | Sequence[Source],
    *,
    strict: bool = False,
    quantities: Iterable[Key] | None = None,
    bid: int | None = None,
    rate: float | None = None,
    strings: Iterable[StringType | str] = (),
    legacy: Legacy | None = None,
    between: Between | None = None,
    allow_restart: bool = False,
    threads: int | None = None,
    storage_options: Mapping[str, Any] | None = None,
) -> Log:
    """Reads a whole log.

    Args:
        source: A path, bytes, a uint8 array, a binary file object, or (with the extra ``fsspec``) a URL.
            Files are not mapped: one that another program truncates simply ends there. Files in the formats
            .gz, .xz, .bz2 and (extra ``zstd``) .zst are decompressed; names and first bytes show which these
            are. Bytes are read in place; an array or bytearray is copied block by block, so another thread
            may write to it. A side file ``NAME.times`` with the arrivals of ``NAME`` or ``NAME.gz`` gives
            `Log.host_time`.

            A list or tuple of these is one recording in pieces, in any order: each must continue another
            one. The names that the recorder gives (``walk.mtb``, ``walk-0001.mtb``) determine the order;
            otherwise it is the given one or, if that does not fit, the order of the times.
        strict: Raise at the first damage instead of reporting it in `Log.damage`.
        quantities: Keys of the quantities to keep, or None for all of them.
        bid: Keep only the device with this BID, as `Log.device` does; None for all devices.
        rate: Rate of the packet counter in Hz, for logs with a counter but no time: samples without a time
            stamp get the time ``packet_counter / rate``. Devices that send time stamps keep theirs.
        strings: String types without checksum and terminator to parse too: ``["EM1000"]``. All other types
            are always parsed; so is EM1000 if a StringOutputType message in the log enables it.
        legacy: OutputMode and OutputSettings of MTData, the output of older devices, whose messages do not
            say what they contain: ``(0x0006, 0x00000001)``. Needed only for a log that does not have them:
            they are read from Configuration, from replies, and from requests that the device acknowledged.
            What the log says takes precedence from there on. A list of pairs holds those of the trackers of
            an Xbus Master.
        between: Read only the samples from the first moment on, up to but without the second. A moment is
            a number of seconds since the first sample, or UTC as a datetime or as text
            (``"2026-11-22T09:30:00"``); None stands for the start or the end. The log is that of the bytes
            of these samples, behind the Configuration, as ``xbus cut`` writes them: `Log.offset`, the
            sample indices and the unwrapping of times start there. `Log.host_time` is that of the whole log.
            With ``bid``, the seconds are those of this device.
        allow_restart: Accept that the device restarted between two pieces. This is always accepted if the
            names say that the recorder started one file after the other.
        threads: Number of threads that decode; None for one per processor. It never changes the result.
            Only arrays and uncompressed local files of more than 2 MiB are read by several threads.
        storage_options: Options of the file systems of URLs, as for `fsspec.open`.

    Raises:
        DecodeError: With ``strict``, at the first damage.
        ImportError: The extra for a URL or a compressed file is not installed.
        MissingDeviceError: The log has no samples of the device ``bid``.
        OSError: The file cannot be read.
        TypeError: The source, a key, or ``legacy`` is of the wrong type.
        ValueError: A quantity or string type that does not exist, a BID that is not from 0 to 255, settings
            of an unknown layout, a rate that is not a positive number, fewer threads than one, pieces of
            different recordings, bytes or a file object with compressed data, or a CAN capture: `read_can`
            reads those.

    >>> import xbus
    >>> log = xbus.read_log("tests/captures/walk.mtb")
    >>> len(log), log.stats.lost_samples
    (1040, 0)
    >>> log["euler_angles"].fields
    ('roll', 'pitch', 'yaw')
    """
    check_bid(bid)
    keep, kinds = quantity_filter(quantities), string_types(strings)
    source = with_storage_options(source, storage_options)
    source = _one_source(source, between, rate, bid, kinds, legacy, allow_restart=allow_restart)
    threads = thread_count(threads)
    reader = reader_of(
        open_source(source),
        strict=strict,
        quantities=keep,
        strings=mask_of(kinds),
        legacy=legacy,
        rate=rate,
        threads=threads,
    )
    host_times = _host_times(source)
    while reader.advance(STEP * threads):
        pass
    part = reader.take_last()
    log = Log(part, quantities=keep, host_times=host_times(part))
    return log if bid is None or between is not None else log.device(bid)


def iter_log(
    source: Source | Sequence[Source],
    *,
    block_bytes: int = BLOCK,
    strict: bool = False,
    quantities: Iterable[Key] | None = None,
    bid: int | None = None,
    rate: float | None = None,
    strings: Iterable[StringType | str] = (),
    legacy: Legacy | None = None,
    between: Between | None = None,
    allow_restart: bool = False,
    storage_options: Mapping[str, Any] | None = None,
) -> Iterator[Log]:
    """Reads a log in parts, for logs larger than memory.

    Each part is a `Log` whose samples, offsets, times and counters continue those of the previous part:
    joined, the parts equal the result of `read_log`.

    A part has columns for the quantities that occur in it. If a quantity occurs in several coordinate
    systems, a part with only one of them lists it under its plain name; check `Column.coordinates`. The parts
    of `split_log` have the columns of the whole log.

    Args:
        source: As in `read_log`. A part from a pipe or socket is returned as soon as its bytes are there.
        block_bytes: Approximate size of a part, in bytes of input.
        strict: Raise at the first damage, after the part with the samples before it.
        quantities: As in `read_log`.
        bid: As in `read_log`. Parts without samples of the device are empty; the error follows the last part
            if all are.
        rate: As in `read_log`.
        strings: As in `read_log`.
        legacy: As in `read_log`.
        between: As in `read_log`.
        allow_restart: As in `read_log`.
        storage_options: As in `read_log`.

    Raises:
        ValueError: ``block_bytes`` less than 1. The other errors are those of `read_log`.

    >>> import xbus
    >>> parts = xbus.iter_log("tests/captures/walk.mtb", block_bytes=10_000)
    >>> sum(len(part) for part in parts)
    1040
    """
    if block_bytes < 1:
        raise ValueError(f"block_bytes must be at least 1, not {block_bytes}")
    check_bid(bid)
    keep, kinds = quantity_filter(quantities), string_types(strings)
    source = with_storage_options(source, storage_options)
    source = _one_source(source, between, rate, bid, kinds, legacy, allow_restart=allow_restart)
    reader = reader_of(
        open_source(source),
        strict=strict,
        quantities=keep,
        strings=mask_of(kinds),
        legacy=legacy,
        part_bytes=block_bytes,
        rate=rate,
    )
    host_times = _host_times(source)

    def parts() -> Iterator[Log]:
        identities: dict[int, Identity] = {}
        bids: dict[int, None] = {}
        first_sample = 0
        more = True
        while more:
            fault = None
            try:
                more = reader.advance(block_bytes)
            except DecodeError as error:
                fault = error
            core = reader.take()
            part = Log(core, quantities=keep, identities=identities, host_times=host_times(core))
            identities = part._identities
            if bid is not None and between is None:
                bids |= dict.fromkeys(device.bid for device in part.devices)
                part = part.of_device(bid, first_sample)
                first_sample += len(part)
            yield part
            if fault is not None:
                raise fault
        if bid is not None and between is None and not first_sample:
            raise MissingDeviceError(bid, bids)

    return parts()


def _host_times(source: Source) -> Callable[[_core.Part], HostTimes]:
    """Returns a function that returns the host times of the next part of a source."""
    if isinstance(source, CutSource):
        return source.host_times
    arrivals = arrivals_of(source)
    clocks: dict[int, HostClock] = {}
    start = 0

    def host_times(part: _core.Part) -> HostTimes:
        nonlocal clocks, start
        if arrivals is None:
            return HostTimes(part)
        end = start + part.stats["bytes"]
        found = HostTimes(part, arrivals.between(start, end).loaded(), clocks)
        start, clocks = end, found.clocks
        return found

    return host_times


def _one_source(
    source: Source | Sequence[Source],
    between: Between | None,
    rate: float | None,
    bid: int | None,
    strings: Sequence[StringType],
    legacy: Legacy | None,
    *,
    allow_restart: bool,
) -> Source:
    """Returns one source for the pieces of a recording, or for a part of it."""
    whole: Source = source  # type: ignore[assignment]
    if isinstance(source, list | tuple):
        whole = pieces_of(source, allow_restart=allow_restart)
    if between is None:
        return whole
    arrivals = arrivals_of(whole)

    def opened() -> Any:
        return open_binary(whole.again() if isinstance(whole, Pieces) else whole)

    def parts() -> Iterator[Log]:
        """Reads the recording once before it is cut."""
        file = opened()
        is_given = file is source
        if is_given and not hasattr(file, "seek"):
            raise ValueError("a stream cannot be cut by UTC, because it is read once; use seconds")
        start = file.tell() if is_given else 0
        yield from cut_parts(file, rate=rate, bid=bid, strings=strings, legacy=legacy)
        if is_given:
            file.seek(start)
        else:
            file.close()

    start, end = seconds_of(between, parts)
    file = opened()
    return CutSource(
        file,
        lambda tee: cut_parts(tee, rate=rate, strings=strings, legacy=legacy),
        start,
        end,
        bid=bid,
        arrivals=arrivals,
        is_owned=file is not source,
    )


def thread_count(threads: int | None) -> int:
    """Returns the number of threads to use: one per processor for None.

    Raises:
        ValueError: Fewer than one.
    """
    if threads is not None and threads < 1:
        raise ValueError(f"threads must be at least 1, not {threads}")
    return threads or os.cpu_count() or 1


def cut_parts(
    source: Readable,
    *,
    rate: float | None = None,
    bid: int | None = None,
    strings: Iterable[StringType | str] = (),
    legacy: Legacy | None = None,
) -> Iterator[Log]:
    """Returns the parts of a log that is cut; the arguments are those of `read_log`."""
    return iter_log(
        source,
        block_bytes=CUT_BLOCK,
        quantities=NEEDED,
        rate=rate,
        bid=bid,
        strings=strings,
        legacy=legacy,
    )


def reader_of(
    opened: Source | list[str],
    *,
    strict: bool,
    quantities: QuantityFilter | None,
    strings: int,
    legacy: Legacy | None = None,
    part_bytes: int | None = None,
    rate: float | None = None,
    threads: int = 1,
    values: bool = True,
    state: bytes | None = None,
) -> _core.Reader:
    """Returns a reader for parts of ``part_bytes``, or for one part.

    It keeps values, or only counts rows. It is at the start of the input, or where another reader had
    ``state``.
    """
    if rate is not None and not 0 < rate < math.inf:
        raise ValueError(f"rate must be a positive number of Hz, not {rate!r}")
    if part_bytes is not None:
        keep_freed_memory()
    paths = opened.paths if isinstance(opened, Pieces) and threads > 1 else None
    reader = _core.Reader(
        paths or opened,
        limit=LONGEST,
        strict=strict,
        wanted=quantities,
        strings=strings,
        legacy=legacy_outputs(legacy),
        part_bytes=size_hint(paths or opened) if part_bytes is None else part_bytes,
        rate=rate,
        threads=threads,
        values=values,
        state=state,
        check=functools.partial(check_head, name=input_name(opened)) if state is None else None,
    )
    if paths:  # the reader takes the sizes that they have now
        opened.check_sizes(paths)  # type: ignore[union-attr]
    return reader
