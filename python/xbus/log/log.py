"""A log: the columns, messages and damage of a recording."""

from __future__ import annotations

import os
from collections.abc import Iterator
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from xbus import _core
from xbus.log import export
from xbus.log.arrivals import HostTimes
from xbus.log.column import Column
from xbus.log.hostclock import HostClock
from xbus.log.identity import IDENTITY_MESSAGES, Identity
from xbus.log.messages import Messages, Unknown
from xbus.log.source import Wish
from xbus.log.stats import Stats
from xbus.log.strings import Strings
from xbus.protocol.configuration import Configuration, Firmware
from xbus.protocol.keys import Key
from xbus.protocol.tables import RECEIVER, UTC_VALID

if TYPE_CHECKING:
    import pandas as pd
    import polars as pl
    import pyarrow as pa

__all__ = ["Log", "steady_time"]


def steady_time(log: Log) -> npt.NDArray[np.float64]:
    """The times of samples, NaN for those of the GNSS receiver, which have a time of their own."""
    time = log.time.copy()
    for name in RECEIVER:
        if name in log:
            time[log[name].sample - log.first_sample] = np.nan
    return time


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
        found = self._core.damage
        dtype = [("offset", "i8"), ("length", "i8"), ("reason", "U12")]
        damage = np.empty(len(found.offset), dtype)
        damage["offset"], damage["length"] = found.offset, found.length
        damage["reason"] = np.array(_core.damage_reasons())[found.reason]
        damage.flags.writeable = False
        return damage

    @cached_property
    def stats(self) -> Stats:
        """What was counted while reading."""
        return Stats(**self._core.stats)

    # The device

    @cached_property
    def identity(self) -> Identity:
        """What the messages say about the device."""
        telling = np.flatnonzero(np.isin(self.messages.mid, IDENTITY_MESSAGES))
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
