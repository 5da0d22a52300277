"""Reads logs: whole, or in parts."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from xbus.errors import DecodeError
from xbus.log.arrivals import HostTimes, arrivals_of
from xbus.log.hostclock import HostClock
from xbus.log.identity import Identity
from xbus.log.log import Log
from xbus.log.source import Source, open_reader, quantity_filter
from xbus.protocol.keys import Key
from xbus.protocol.values import StringType
from xbus.wire.strings import mask_of

__all__ = ["iter_log", "read_log"]

#: Bytes read at a time: Ctrl-C and progress are handled between two reads.
STEP = 32 << 20
#: Default size of a part of a log, in bytes of input.
BLOCK = 64 << 20


def read_log(
    source: Source,
    *,
    strict: bool = False,
    quantities: Iterable[Key] | None = None,
    strings: Iterable[StringType | str] = (),
) -> Log:
    """Reads a whole log.

    Args:
        source: A path, bytes, a uint8 array, a binary file object, or (with the extra ``fsspec``) a URL.
            Files are read in pieces and not mapped: one that another program truncates simply ends there.
            Arrays are not copied. A side file ``NAME.times`` with the arrivals of ``NAME`` gives
            `Log.host_time`.
        strict: Raise at the first damage instead of reporting it in `Log.damage`.
        quantities: Keys of the quantities to keep, or None for all of them.
        strings: String types without checksum and terminator to parse too: ``["EM1000"]``. All other types
            are always parsed; so is EM1000 if a StringOutputType message in the log enables it.

    Raises:
        DecodeError: With ``strict``, at the first damage.
        OSError: The file cannot be read.
        TypeError: The source, or a key, is of the wrong type.
        ValueError: A quantity or string type that does not exist.

    >>> import xbus
    >>> log = xbus.read_log("tests/captures/walk.mtb")
    >>> len(log), log.stats.lost_samples
    (1040, 0)
    >>> log["euler_angles"].fields
    ('roll', 'pitch', 'yaw')
    """
    keep = quantity_filter(quantities)
    reader = open_reader(source, strict=strict, quantities=keep, strings=mask_of(strings))
    arrivals = arrivals_of(source)
    while reader.advance(STEP):
        pass
    part = reader.take()
    return Log(part, quantities=keep, host_times=HostTimes(part, arrivals))


def iter_log(
    source: Source,
    *,
    block_bytes: int = BLOCK,
    strict: bool = False,
    quantities: Iterable[Key] | None = None,
    strings: Iterable[StringType | str] = (),
) -> Iterator[Log]:
    """Reads a log in parts, for logs larger than memory.

    Each part is a `Log` whose samples, offsets, times and counters continue those of the previous part:
    joined, the parts equal the result of `read_log`.

    Args:
        source: As in `read_log`.
        block_bytes: Approximate size of a part, in bytes of input.
        strict: Raise at the first damage, after the part with the samples before it.
        quantities: As in `read_log`.
        strings: As in `read_log`.

    Raises:
        DecodeError: With ``strict``, at the first damage.
        OSError: The file cannot be read.
        TypeError: The source, or a key, is of the wrong type.
        ValueError: A quantity or string type that does not exist, or ``block_bytes`` less than 1.

    >>> import xbus
    >>> parts = xbus.iter_log("tests/captures/walk.mtb", block_bytes=10_000)
    >>> sum(len(part) for part in parts)
    1040
    """
    if block_bytes < 1:
        raise ValueError(f"block_bytes must be at least 1, not {block_bytes}")
    keep = quantity_filter(quantities)
    reader = open_reader(
        source, strict=strict, quantities=keep, strings=mask_of(strings), part_bytes=block_bytes
    )
    arrivals = arrivals_of(source)

    def parts() -> Iterator[Log]:
        identity = Identity()
        clocks: dict[int, HostClock] = {}
        more = True
        while more:
            fault = None
            try:
                more = reader.advance(block_bytes)
            except DecodeError as error:
                fault = error
            core = reader.take()
            host_times = HostTimes(core, arrivals, clocks)
            if arrivals is not None:
                clocks = host_times.clocks
            part = Log(core, quantities=keep, identity=identity, host_times=host_times)
            identity = part.identity
            yield part
            if fault is not None:
                raise fault

    return parts()
