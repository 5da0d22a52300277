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

#: Bytes read at a time: between two of these, Ctrl-C is heard and progress is told.
STEP = 32 << 20
#: Bytes of input in a part of a log, unless told otherwise.
BLOCK = 64 << 20


def read_log(
    source: Source,
    *,
    strict: bool = False,
    quantities: Iterable[Key] | None = None,
    strings: Iterable[StringType | str] = (),
) -> Log:
    """Reads a log whole.

    Args:
        source: A path, bytes, a uint8 array, a binary file object, or (with the extra ``fsspec``) a
            URL. Files are read piece by piece and not mapped, so one that another program cuts short
            meanwhile just ends there. An array is used where it lies, without a copy. Beside a path
            ``NAME``, a side file ``NAME.times`` of arrivals gives `Log.host_time`.
        strict: Raise at the first damage instead of reporting it.
        quantities: Names of the quantities to keep, or (name, coordinates); all of them if None.
        strings: Strings to look for that nothing but their length tells from noise: ``["EM1000"]``. All
            others are found, and EM1000 too where a StringOutputType in the log says that it is on.

    Raises:
        DecodeError: With ``strict``, at the first bytes that do not add up.
        OSError: The file cannot be read.
        ValueError: A quantity or string that does not exist.

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

    Each part is a `Log` with samples, offsets, times and counters that go on from the part before;
    joined, the parts are what `read_log` gives.

    Args:
        source: As in `read_log`.
        block_bytes: Bytes of input in a part, about.
        strict: Raise at the first damage; the samples before it are handed over first.
        quantities: As in `read_log`.
        strings: As in `read_log`.

    Raises:
        DecodeError: With ``strict``, at the first bytes that do not add up.
        OSError: The file cannot be read.
        ValueError: A quantity or string that does not exist, or a block without a byte.

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
