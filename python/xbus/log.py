"""Logs: every sample, message and stretch of damage of a recording."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple, overload

import numpy as np
import numpy.typing as npt

from xbus import _core, export
from xbus.arrivals import HostTimes, arrivals_of
from xbus.column import Column
from xbus.configuration import TELLING, Configuration, Firmware, Identity
from xbus.errors import DecodeError
from xbus.hostclock import HostClock
from xbus.protocol.values import StringType
from xbus.source import Key, Source, Wish, open_reader, wishes
from xbus.strings import Strings, mask_of
from xbus.tables import RECEIVER

if TYPE_CHECKING:
    import pandas as pd
    import polars as pl
    import pyarrow as pa

__all__ = ["Log", "Message", "Messages", "Stats", "Unknown", "iter_log", "read_log"]

#: Bytes read at a time: between two of these, Ctrl-C is heard and progress is told.
STEP = 32 << 20
#: Bytes of input in a part of a log, unless told otherwise.
BLOCK = 64 << 20
#: The device vouches for date, time and UTC (Tables 25 and 35). Higher bits may be set, too.
UTC_VALID = 0b111


def steady_time(log: Log) -> npt.NDArray[np.float64]:
    """The times of samples, NaN for those of the GNSS receiver, which have a time of their own."""
    time = log.time.copy()
    for name in RECEIVER:
        if name in log:
            time[log[name].sample - log.first_sample] = np.nan
    return time


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
    wanted = wishes(quantities)
    reader = open_reader(source, strict=strict, wanted=wanted, strings=mask_of(strings))
    arrivals = arrivals_of(source)
    while reader.advance(STEP):
        pass
    part = reader.take()
    return Log(part, wanted=wanted, hosts=HostTimes(part, arrivals))


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
    wanted = wishes(quantities)
    reader = open_reader(
        source, strict=strict, wanted=wanted, strings=mask_of(strings), part_bytes=block_bytes
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
            hosts = HostTimes(core, arrivals, clocks)
            if arrivals is not None:
                clocks = hosts.clocks
            part = Log(core, wanted=wanted, identity=identity, hosts=hosts)
            identity = part.identity
            yield part
            if fault is not None:
                raise fault

    return parts()


@dataclass(frozen=True)
class Stats:
    """What was counted while reading.

    Attributes:
        bytes: Bytes of input.
        frames: Accepted frames.
        samples: MTData2 messages.
        messages: Other messages, malformed ones included.
        malformed: MTData2 messages that their packets do not tile, and empty ones.
        strings: String outputs.
        skipped_bytes: Bytes that belong to neither frame nor string.
        checksum_errors: Candidates refused by their checksum where a frame was due.
        lost_samples: Samples missing by the packet counter.
        gaps: Places where samples are missing.
    """

    bytes: int
    frames: int
    samples: int
    messages: int
    malformed: int
    strings: int
    skipped_bytes: int
    checksum_errors: int
    lost_samples: int
    gaps: int


class Message(NamedTuple):
    """A message that is no sample.

    Attributes:
        mid: Message identifier.
        name: The manual's name, or the MID in hex where it has none.
        bid: Bus identifier.
        payload: Its data.
        offset: Where its frame begins, in bytes from the start of the input.
        sample: Index of the next sample.
    """

    mid: int
    name: str
    bid: int
    payload: bytes
    offset: int
    sample: int


class Messages(Sequence[Message]):
    """The messages of a log that are no samples, in order; each is made when it is asked for.

    Attributes:
        mid, bid, offset, sample: Those of all messages, as arrays.
    """

    def __init__(self, core: _core.Part) -> None:
        self.mid, self.bid, self.offset, self.sample, self._ends, self._bytes = core.messages

    def __len__(self) -> int:
        return len(self.mid)

    @overload
    def __getitem__(self, index: int) -> Message: ...
    @overload
    def __getitem__(self, index: slice) -> list[Message]: ...
    def __getitem__(self, index: int | slice) -> Message | list[Message]:
        if isinstance(index, slice):
            return [self[it] for it in range(*index.indices(len(self)))]
        at = range(len(self))[index]
        mid = int(self.mid[at])
        payload = _piece(self._bytes, self._ends, at)
        name = _core.message_name(mid, len(payload)) or f"0x{mid:02X}"
        bid, offset, sample = int(self.bid[at]), int(self.offset[at]), int(self.sample[at])
        return Message(mid, name, bid, payload, offset, sample)

    def named(self, *names: str) -> list[Message]:
        """The messages with one of these names."""
        return [it for it in self if it.name in names]

    def __repr__(self) -> str:
        mids, counts = np.unique(self.mid, return_counts=True)
        kinds = (
            f"{_core.message_name(int(m), 1) or hex(m)}: {n}"
            for m, n in zip(mids, counts, strict=True)
        )
        return f"<Messages {len(self)}: {', '.join(kinds)}>"


class Unknown(Sequence[bytes]):
    """The packets of one data identifier that the tables cannot explain, verbatim.

    Attributes:
        sample: Which sample each belongs to, int64.
    """

    def __init__(self, core: _core.Column) -> None:
        assert core.ends is not None  # noqa: S101 - raw packets have ends
        self._core = core
        self._ends = core.ends
        self._bytes = core.values

    @cached_property
    def sample(self) -> npt.NDArray[np.int64]:
        """Which sample each belongs to, int64."""
        # Looks at every sample, and a hostile log can hold thousands of identifiers.
        return self._core.sample

    def __len__(self) -> int:
        return len(self._ends)

    @overload
    def __getitem__(self, index: int) -> bytes: ...
    @overload
    def __getitem__(self, index: slice) -> list[bytes]: ...
    def __getitem__(self, index: int | slice) -> bytes | list[bytes]:
        if isinstance(index, slice):
            return [self[it] for it in range(*index.indices(len(self)))]
        return _piece(self._bytes, self._ends, range(len(self))[index])

    def __repr__(self) -> str:
        return f"<Unknown {len(self)} packets, {len(self._bytes)} bytes>"


def _piece(data: npt.NDArray[np.uint8], ends: npt.NDArray[np.uint64], at: int) -> bytes:
    start = int(ends[at - 1]) if at else 0
    return data[start : int(ends[at])].tobytes()


def _count(number: int, one: str, many: str | None = None) -> str:
    return f"{number} {one if number == 1 else many or one + 's'}"


class Log:
    """A recording, decoded: columns of numbers, the other messages, and what was damaged.

    ``len(log)`` is the number of samples (MTData2 messages), ``list(log)`` the keys that ``log[key]``
    takes, each giving a `Column`. Where one quantity came in two coordinate systems, the key is
    (name, coordinates).
    """

    def __init__(
        self,
        core: _core.Part,
        *,
        wanted: list[Wish] | None = None,
        identity: Identity | None = None,
        hosts: HostTimes | None = None,
    ) -> None:
        self._core, self._wanted = core, wanted
        self._earlier = identity or Identity()
        self._hosts = hosts or HostTimes(core)
        #: Index of the first sample, counted from the beginning of the log; 0 but for parts.
        self.first_sample: int = core.first
        columns = [Column(it, core, self._hosts) for it in core.columns if it.name is not None]
        if wanted is not None:
            columns = [
                it
                for it in columns
                if (it.name, None) in wanted or (it.name, it.coordinates) in wanted
            ]
        self._columns: dict[tuple[str, str | None], Column] = {
            (it.name, it.coordinates): it for it in columns
        }

    # Columns

    def __len__(self) -> int:
        return len(self._core)

    def __iter__(self) -> Iterator[Key]:
        names = [name for name, _ in self._columns]
        for name, coordinates in self._columns:
            if names.count(name) > 1 and coordinates is not None:
                yield name, coordinates
            else:
                yield name

    def keys(self) -> list[Key]:
        """The keys that ``log[key]`` takes."""
        return list(self)

    def __contains__(self, key: object) -> bool:
        if isinstance(key, str):
            return any(name == key for name, _ in self._columns)
        return key in self._columns

    def __getitem__(self, key: Key) -> Column:
        if isinstance(key, tuple):
            if key in self._columns:
                return self._columns[key]
            raise KeyError(f"no {key!r} in this log; {self._what_there_is()}")
        found = [it for (name, _), it in self._columns.items() if name == key]
        if len(found) == 1:
            return found[0]
        if found:
            choices = " or ".join(f"log[{it.name!r}, {it.coordinates!r}]" for it in found)
            raise KeyError(f"{key!r} is in this log in several coordinate systems: {choices}")
        import difflib

        near = difflib.get_close_matches(str(key), [name for name, _ in self._columns], n=1)
        hint = f"did you mean {near[0]!r}?" if near else self._what_there_is()
        raise KeyError(f"no {key!r} in this log; {hint}")

    def _what_there_is(self) -> str:
        return f"it has {', '.join(map(repr, self))}" if self._columns else "it has no quantities"

    # Samples

    @cached_property
    def offset(self) -> npt.NDArray[np.int64]:
        """Where the frame of each sample begins, in bytes from the start of the input."""
        return self._core.offset

    @cached_property
    def time(self) -> npt.NDArray[np.float64]:
        """Seconds on the device clock of each sample, unwrapped; NaN where it carries no stamp."""
        return self._core.time

    @property
    def host_time(self) -> npt.NDArray[np.float64]:
        """When each sample was measured by the clock of the recording computer, ``(N,)`` float64.

        Seconds since 1970, later by the least delay of the connection: device time as a `HostClock` maps
        it, from the arrivals in the side file ``NAME.times`` that lies beside a log ``NAME``. The same as
        was said live: decided by what came before. NaN where a sample carries no time stamp, or no arrival
        is known, so everywhere without a side file.
        """
        return self._hosts.time

    @property
    def host_clock(self) -> HostClock | None:
        """The clock that `host_time` is from, as it was behind the last sample; None without arrivals.

        Of the first device, where there are several.
        """
        return next(iter(self._hosts.clocks.values()), None)

    @property
    def times_fault(self) -> str | None:
        """What is wrong with the side file of arrivals; None where nothing is, and without one."""
        return self._hosts.arrivals.fault if self._hosts.arrivals is not None else None

    @cached_property
    def utc(self) -> npt.NDArray[np.datetime64]:
        """UTC of each sample, ``(N,)`` ``datetime64[ns]``; NaT where it carries none that is valid.

        From ``utc_time`` (Table 35) and, in samples without, from ``gnss_pvt_data`` (Table 25); valid is what
        has all of the lowest three bits of ``valid`` set. That of a receiver's sample belongs to its own
        device time, which runs behind its neighbours.
        """
        utc = np.full(len(self), np.datetime64("NaT"), "datetime64[ns]")
        for name in ("gnss_pvt_data", "utc_time"):
            if name in self:
                column = self[name]
                valid = (column.values["valid"] & UTC_VALID == UTC_VALID) & ~np.isnat(
                    column.datetime
                )
                utc[column.sample[valid] - self.first_sample] = column.datetime[valid]
        utc.flags.writeable = False
        return utc

    @cached_property
    def packet_counter(self) -> npt.NDArray[np.int64]:
        """The packet counter of each sample, unwrapped; -1 where it carries none."""
        return self._core.packet_counter

    @cached_property
    def bid(self) -> npt.NDArray[np.uint8]:
        """The bus identifier of each sample's frame."""
        return self._core.bid

    @property
    def duration(self) -> float:
        """Seconds between the earliest and the latest time stamp; NaN for fewer than two.

        Those of the GNSS receiver count only where there are no others: without a fix they are arbitrary.
        """
        steady = steady_time(self)
        time = steady if np.isfinite(steady).any() else self.time
        stamped = time[np.isfinite(time)]
        return float(stamped.max() - stamped.min()) if len(stamped) > 1 else float("nan")

    # Everything else

    @cached_property
    def messages(self) -> Messages:
        """Every other message, in order."""
        return Messages(self._core)

    @cached_property
    def strings(self) -> Strings:
        """The string outputs that stand between the frames, in order."""
        return Strings(self._core, self._hosts.arrivals)

    @cached_property
    def unknown(self) -> dict[int, Unknown]:
        """Packets that the tables cannot explain, verbatim, by data identifier as received."""
        return {it.data_id: Unknown(it) for it in self._core.columns if it.name is None}

    @cached_property
    def damage(self) -> npt.NDArray[Any]:
        """Stretches of bytes that are no frame, as a structured array of offset, length and reason.

        The reason is what was wrong where the next frame was due: ``"no preamble"``, ``"checksum"``,
        ``"too long"`` or ``"truncated"`` (more bytes claimed than allowed, or than there are), or
        ``"implausible"`` (checksum good, but nothing that a device sends, and nothing follows).
        """
        offset, length, reason = self._core.damage
        dtype = [("offset", "i8"), ("length", "i8"), ("reason", "U12")]
        damage = np.empty(len(offset), dtype)
        damage["offset"], damage["length"] = offset, length
        damage["reason"] = np.array(_core.damage_reasons())[reason]
        return damage

    @cached_property
    def stats(self) -> Stats:
        """What was counted while reading."""
        return Stats(**self._core.stats)

    # The device

    @cached_property
    def identity(self) -> Identity:
        """What the messages say about the device."""
        telling = np.flatnonzero(np.isin(self.messages.mid, TELLING))
        return self._earlier.updated(self.messages[it] for it in telling.tolist())

    @property
    def device_id(self) -> int | None:
        """Device identifier, from a DeviceID or Configuration message."""
        return self.identity.device_id

    @property
    def product_code(self) -> str | None:
        """Product code, such as ``"MTi-630-8A1G6"``."""
        return self.identity.product_code

    @property
    def firmware(self) -> Firmware | None:
        """Firmware revision."""
        return self.identity.firmware

    @property
    def configuration(self) -> Configuration | None:
        """The Configuration message (Tables 13 and 14)."""
        return self.identity.configuration

    # Tables

    def _stream(self, key: Key | None = None) -> _core.ArrowStream:
        if key is None:
            columns = [it._core for it in self._columns.values()]
            return _core.ArrowStream.wide(self._core, columns, self._hosts.known)
        return _core.ArrowStream.rows(self[key]._core, self._hosts.known)

    def __arrow_c_stream__(self, requested_schema: object = None) -> object:
        """The wide table, for pyarrow, polars, DuckDB and whoever speaks the Arrow C interface."""
        return self._stream().__arrow_c_stream__(requested_schema)

    def to_arrow(self, key: Key | None = None) -> pa.Table:
        """A pyarrow table.

        Without a key: one row a sample, columns ``sample``, ``time``, ``host_time`` where arrivals are known,
        and one for each component of each quantity (``acceleration_x``), null where the sample lacks it. With
        a key: that quantity alone, one row a packet; ``"gnss_sat_info"`` gives one row a satellite. Unit,
        coordinates, precision and data identifier are in the fields' metadata.

        Raises:
            ImportError: The extra ``arrow`` is not installed.
            KeyError: The log has no such quantity.
        """
        table: pa.Table = export.arrow(self._stream(key))
        return table

    def to_pandas(self, key: Key | None = None) -> pd.DataFrame:
        """The same as a pandas DataFrame; integers with nulls become float64, those of 64 bits UInt64.

        Raises:
            ImportError: The extra ``pandas`` is not installed.
            KeyError: The log has no such quantity.
        """
        frame: pd.DataFrame = export.pandas(self._stream(key))
        return frame

    def to_polars(self, key: Key | None = None) -> pl.DataFrame:
        """The same as a polars DataFrame.

        Raises:
            ImportError: The extra ``polars`` is not installed.
            KeyError: The log has no such quantity.
        """
        frame: pl.DataFrame = export.polars(self._stream(key))
        return frame

    def to_parquet(self, path: str | os.PathLike[str], key: Key | None = None) -> None:
        """Writes the table of `to_arrow` as a Parquet file, whole or not at all.

        Raises:
            ImportError: The extra ``arrow`` is not installed.
            KeyError: The log has no such quantity.
            OSError: The file cannot be written.
        """
        export.parquet(self._stream(key), path)

    def to_csv(self, path: str | os.PathLike[str], key: Key | None = None) -> None:
        """The same as CSV: a header, empty fields for nulls, times in UTC."""
        export.csv(self._stream(key), path)

    def to_feather(self, path: str | os.PathLike[str], key: Key | None = None) -> None:
        """The same as an Arrow file (Feather)."""
        export.feather(self._stream(key), path)

    def to_npz(self, path: str | os.PathLike[str]) -> None:
        """Writes every quantity as an array of an npz file, whole or not at all.

        Beside each ``name`` (``name_ned`` where coordinates are mixed) stand ``name.sample`` and
        ``name.time``; beside them all ``time``, ``packet_counter.unwrapped`` and, where arrivals are known,
        ``host_time``, one for each sample. Each type of string has its `Strings.table` under its
        name, unless only some quantities were asked for.

        Raises:
            OSError: The file cannot be written.
        """
        arrays: dict[str, npt.NDArray[Any]] = {"time": self.time}
        arrays["packet_counter.unwrapped"] = self.packet_counter
        if self.host_clock is not None:
            arrays["host_time"] = self.host_time
        for key in self:
            column = self[key]
            stem = key if isinstance(key, str) else f"{key[0]}_{key[1].lower()}"
            arrays |= {
                stem: column.values,
                f"{stem}.sample": column.sample,
                f"{stem}.time": column.time,
            }
            if column.name == "gnss_sat_info":
                arrays |= {
                    f"{stem}.satellites": column.satellites,
                    f"{stem}.offsets": column.offsets,
                }
        if self._wanted is None:
            arrays |= {it: self.strings.table(it) for it in self.strings.counts if it}
        export.npz(arrays, path)

    # Print

    def _summary(self) -> str:
        stats = self.stats
        parts = [_count(len(self), "sample")]
        if np.isfinite(self.duration):
            parts.append(f"{self.duration:.2f} s")
        parts.append(_count(len(self._columns), "quantity", "quantities"))
        if stats.strings:
            parts.append(_count(stats.strings, "string"))
        if stats.lost_samples:
            lost = _count(stats.lost_samples, "sample")
            parts.append(f"{lost} lost in {_count(stats.gaps, 'gap')}")
        if stats.skipped_bytes:
            skipped = _count(stats.skipped_bytes, "byte")
            parts.append(f"{skipped} skipped in {_count(len(self.damage), 'place')}")
        if self.product_code:
            parts.append(self.product_code)
        if self.times_fault:
            parts.append(self.times_fault)
        return ", ".join(parts)

    def _rows(self) -> list[tuple[str, str, str, str]]:
        def label(key: Key) -> str:
            return key if isinstance(key, str) else " ".join(key)

        def rate(column: Column) -> str:
            return f"{column.rate:.1f} Hz" if np.isfinite(column.rate) else ""

        return [(label(it), str(len(self[it])), rate(self[it]), self[it]._about) for it in self]

    def __repr__(self) -> str:
        rows = self._rows()
        widths = [max(map(len, cells), default=0) for cells in zip(*rows, strict=True)]
        lines = [
            f"  {row[0]:<{widths[0]}}  {row[1]:>{widths[1]}}  {row[2]:>{widths[2]}}  {row[3]}".rstrip()
            for row in rows
        ]
        return "\n".join([f"<Log {self._summary()}>", *lines])

    def _repr_html_(self) -> str:
        import html

        head = "".join(f"<th>{it}</th>" for it in ("quantity", "rows", "rate", ""))
        body = "".join(
            "<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>"
            for row in self._rows()
        )
        return f"<p>Log: {html.escape(self._summary())}</p><table><tr>{head}</tr>{body}</table>"
