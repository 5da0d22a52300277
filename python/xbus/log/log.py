"""A log: the columns, messages and damage of a recording."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from xbus import _core
from xbus.export import tables
from xbus.formatting import describe_damage, describe_losses, format_count
from xbus.log.arrays import identical, read_only
from xbus.log.arrivals import HostTimes
from xbus.log.column import Column
from xbus.log.exports import Exports
from xbus.log.hostclock import HostClock
from xbus.log.identity import IDENTITY_MESSAGES, Identity, identities_of, identity_of
from xbus.log.messages import Messages, Unknown
from xbus.log.rendering import html_table, text_table
from xbus.log.resample import Resampled, check_rate, spans
from xbus.log.runs import PartRuns, Runs, steady_time
from xbus.log.source import QuantityFilter
from xbus.log.stats import Stats
from xbus.log.strings import Strings
from xbus.log.table_file import write_table
from xbus.log.trackers import Tracker, trackers_of
from xbus.protocol.configuration import Configuration, Firmware
from xbus.protocol.ids import MessageId
from xbus.protocol.keys import ByQuantity, EntryKey, Key, KeyIndex, QuantityKey
from xbus.protocol.tables import COLUMN_QUANTITIES, MASTER, UTC_SOURCES, UTC_VALID, device_of
from xbus.protocol.undecoded import Undecoded, describe_undecoded, output_mids

if TYPE_CHECKING:
    import pandas as pd
    import polars as pl
    import pyarrow as pa

    from xbus.log.plotting import PlotTime
    from xbus.plots.draw import Backend

__all__ = ["Log", "LogDevice", "MissingDeviceError", "log_devices"]


DAMAGE = np.dtype([("offset", "i8"), ("length", "i8"), ("reason", "U12")])


class MissingDeviceError(ValueError):
    """A log has no samples of a device.

    Args:
        device: BID or identifier of the device.
        bids: BIDs of the devices that sent samples.
    """

    def __init__(self, device: int, bids: Iterable[int]) -> None:
        found = ", ".join(map(str, bids))
        there = f"those of BID {found}" if found else "no samples"
        super().__init__(f"no samples of device {device}; the log has {there}")


class LogDevice(NamedTuple):
    """A device that sent samples of a log.

    Attributes:
        bid: Bus identifier, as in the first sample.
        device_id: Device identifier, or None.
        product_code: Product code, or None.
        firmware: Firmware revision, or None.
        samples: Number of its samples.
    """

    bid: int
    device_id: int | None
    product_code: str | None
    firmware: Firmware | None
    samples: int


def log_devices(
    samples: Mapping[int, int], identities: Mapping[int, Identity]
) -> tuple[LogDevice, ...]:
    """Returns the devices that sent samples.

    Args:
        samples: The number of samples of each device, by the BID of its first sample.
        identities: The identities by BID; 1 stands for FF too.
    """
    found = {bid: identity_of(identities, list(samples), bid) for bid in samples}
    return tuple(
        LogDevice(bid, identity.device_id, identity.product_code, identity.firmware, samples[bid])
        for bid, identity in found.items()
    )


class Log(ByQuantity[Column], Exports):
    """A decoded recording: a mapping from quantity to `Column`, with the other messages and the damage.

    ``log[key]`` takes a name (``"acceleration"``), a `DataId`, or a tuple of one of these with coordinates
    (``("quaternion", "NED")``). If a quantity occurs in two coordinate systems, its name alone names no
    column: ``"quaternion" in log`` is False, and ``log["quaternion"]`` raises a KeyError that names both.

    ``len(log)`` is the number of samples (MTData2 messages), not of quantities, and ``bool(log)`` is
    whether there are any. ``list(log)``, ``log.keys()``, ``log.values()`` and ``log.items()`` have one
    element per quantity.

    Logs can be pickled, and two are equal if everything that was decoded is identical, with NaN equal to NaN.

    Attributes:
        first_sample: Index of the first sample, from the start of the recording; 0 unless this is a later
            part.

    >>> import xbus
    >>> log = xbus.read_log("tests/captures/walk.mtb")
    >>> len(log), len(log.keys())
    (1040, 15)
    >>> log["acceleration"] == log[xbus.DataId.Acceleration]
    True
    """

    def __init__(
        self,
        core: _core.Part,
        *,
        quantities: QuantityFilter | None = None,
        identities: Mapping[int, Identity] | None = None,
        host_times: HostTimes | None = None,
        devices: tuple[LogDevice, ...] | None = None,
    ) -> None:
        self._core, self._filter, self._devices = core, quantities, devices
        self._earlier = dict(identities or {})
        self._host_times = host_times or HostTimes(core)
        self.first_sample: int = core.first
        columns = [Column(found, self._host_times) for found in core.columns if found.name]
        if quantities is not None:
            columns = [
                column
                for column in columns
                if (column.name, None) in quantities
                or (column.name, column.coordinates) in quantities
            ]
        keys = [(column.name, column.coordinates, column.precision) for column in columns]
        super().__init__(_key_index(tuple(keys)), columns, "log")

    # Columns

    def __len__(self) -> int:
        return len(self._core)

    # Samples

    @cached_property
    def offset(self) -> npt.NDArray[np.int64]:
        """Byte offset in the input at which the frame of each sample begins, ``(N,)`` int64."""
        return self._core.offset

    @cached_property
    def time(self) -> npt.NDArray[np.float64]:
        """Seconds on the device clock, unwrapped, ``(N,)`` float64; NaN for a sample without a time stamp."""
        return self._core.time

    @property
    def has_host_time(self) -> bool:
        """Whether a sample has a host time; for a part of `split_log`, whether one of the whole log has."""
        return self._host_times.known is not None

    @property
    def host_time(self) -> npt.NDArray[np.float64]:
        """When each sample was measured, on the clock of the recording computer, ``(N,)`` float64.

        Seconds since 1970, late by the minimum delay of the connection. A `HostClock` maps device time to
        host time with the arrivals in the side file ``NAME.times`` of a log ``NAME``. The value for a
        sample depends only on it and earlier samples, so it equals the one computed live. NaN for a sample
        without a time stamp or without a known arrival; all NaN without a side file.
        """
        return self._host_times.time

    @property
    def host_clock(self) -> HostClock | None:
        """The clock behind `host_time`, as of the last sample; None if no arrivals are known.

        In a log of several devices, the clock of the first one.
        """
        return next(iter(self._host_times.clocks.values()), None)

    @property
    def times_fault(self) -> str | None:
        """What is wrong with the side file of arrivals; None if it is good or missing."""
        return self._host_times.fault

    @cached_property
    def utc(self) -> npt.NDArray[np.datetime64]:
        """UTC of each sample, ``(N,)`` ``datetime64[ns]``; NaT for a sample without a valid one.

        From ``utc_time`` (Table 35), otherwise from ``gnss_pvt_data`` (Table 25), where the lowest three
        bits of ``valid`` are set. UTC of a GNSS receiver belongs to the device time of its own sample,
        which lags behind that of the neighbours.
        """
        utc = self._core.utc
        stamps = np.full(len(self), "NaT", "datetime64[ns]") if utc is None else utc
        return read_only(stamps.view("datetime64[ns]"))

    @cached_property
    def packet_counter(self) -> npt.NDArray[np.int64]:
        """Packet counter of each sample, unwrapped, ``(N,)`` int64; -1 for a sample without one."""
        return self._core.packet_counter

    @property
    def core(self) -> _core.Part:
        """The part of the log as the extension module has it."""
        return self._core

    @property
    def has_counter(self) -> bool:
        """Whether a sample has a packet counter, without which losses are not known."""
        return self._core.has_counter

    @cached_property
    def bid(self) -> npt.NDArray[np.uint8]:
        """Bus identifier of the frame of each sample, ``(N,)`` uint8."""
        return self._core.bid

    @cached_property
    def _all_runs(self) -> tuple[Runs, PartRuns]:
        runs = Runs()
        return runs, runs.add(self._core)

    @property
    def _runs(self) -> Runs:
        return self._all_runs[0]

    @cached_property
    def runs(self) -> npt.NDArray[Any]:
        """The runs of the devices: a structured array of bid, first, last, start and duration, read-only.

        A run is the samples of one device between two of its restarts: a WakeUp, ResetAck or
        GoToMeasurementAck message, or a clock that steps back by more than a second together with the packet
        counter. ``first`` and ``last`` are indices of samples, ``start`` is the earliest time stamp on the
        device clock, and ``duration`` the seconds from there to the latest; NaN for fewer than two time
        stamps. Time stamps of the GNSS receiver count only if there are no others: without a fix they are
        arbitrary. In a part of a log, runs start at its first sample.

        >>> import xbus
        >>> xbus.read_log("tests/captures/walk.mtb").runs["duration"].round(2).tolist()
        [9.99]
        """
        return self._runs.table()

    @cached_property
    def restarts(self) -> npt.NDArray[np.int64]:
        """Indices of the samples with which a run begins after a restart of its device, ``(n,)`` int64.

        The first run of a device begins without a restart. Unlike `runs`, this names a restart between this
        part of a log and the previous one.

        >>> import xbus
        >>> frames = [xbus.encode_sample({"packet_counter": 1}), xbus.encode_frame(0x3E, b"")]
        >>> xbus.read_log(b"".join(frames * 2)).restarts.tolist()
        [1]
        """
        return read_only(self._core.restarts.sample.astype(np.int64))

    @property
    def duration(self) -> float:
        """Seconds recorded: the sum of the runs of a device, the longest of several devices.

        NaN if no run has two time stamps.
        """
        return self._runs.duration

    # The devices

    @cached_property
    def devices(self) -> tuple[LogDevice, ...]:
        """The devices that sent samples, in the order of their first samples.

        BID FF and 1 are the same device.
        """
        if self._devices is not None:
            return self._devices
        runs, samples = self._runs.of_devices(), self._runs.rows["samples"]
        counts = {bid: int(samples[own].sum()) for bid, own in runs.items()}
        return log_devices(counts, self._identities)

    # Everything else

    @cached_property
    def messages(self) -> Messages:
        """The messages that are not samples, in order."""
        found = self._core.messages
        return Messages(
            found.mid, found.bid, found.offset, found.sample, found.ends, found.payloads
        )

    @cached_property
    def strings(self) -> Strings:
        """The string outputs between the frames, in order."""
        found = self._core.strings
        return Strings(
            found.place, found.offset, found.sample, found.ends, found.data, self._host_times
        )

    @cached_property
    def unknown(self) -> dict[int, Unknown]:
        """Packets that the tables do not explain, verbatim, by data identifier as received."""
        return {
            column.data_id: Unknown(column) for column in self._core.columns if column.name is None
        }

    @cached_property
    def undecoded(self) -> tuple[Undecoded, ...]:
        """Output that is kept verbatim and not decoded: how much, and why.

        These are MTData messages that do not fit their settings, messages that the manual does not list, and
        the packets in `unknown`.

        >>> import xbus
        >>> log = xbus.read_log(xbus.encode_frame(0x08, bytes(40)))
        >>> print(*log.undecoded)
        1 message 0x08, 40 bytes: which the manual does not list
        """
        mids, lengths = self.messages.mid, self.messages.length
        messages: list[Undecoded] = []
        for mid in output_mids(np.unique(mids).tolist()):
            sizes = lengths[mids == mid]
            if mid == MessageId.MTData:
                found, counts = np.unique(sizes, return_counts=True)
                pairs = zip(found.tolist(), counts.tolist(), strict=True)
                messages += [Undecoded.mtdata(length, count) for length, count in pairs]
            else:
                messages.append(Undecoded.messages(mid, len(sizes), int(sizes.sum())))
        packets = [Undecoded.packets(key, len(raw), raw.size) for key, raw in self.unknown.items()]
        return *messages, *packets

    @cached_property
    def trackers(self) -> dict[int, Tracker]:
        """What Awinda trackers sent, by device identifier: packet counter, losses and magnetic field.

        Empty if the log has no ``awinda_snapshot``. Such a file holds no orientation: trackers send
        increments, from which the vendor's software computes it.
        """
        return trackers_of(self.get("awinda_snapshot"))

    @cached_property
    def damage(self) -> npt.NDArray[Any]:
        """Ranges of bytes that are neither frame nor string: a structured array of offset, length and reason.

        The reason is what was found where the next frame was expected: ``"no preamble"``, ``"checksum"``,
        ``"too long"`` (more bytes than allowed), ``"truncated"`` (more bytes than the input has) or
        ``"implausible"`` (good checksum, but nothing that a device sends, and no frame follows).
        """
        found = self._core.damage
        damage = np.empty(len(found.offset), DAMAGE)
        damage["offset"], damage["length"] = found.offset, found.length
        for at, reason in enumerate(_core.damage_reasons()):
            damage["reason"][found.reason == at] = reason
        return read_only(damage)

    @cached_property
    def gaps(self) -> npt.NDArray[Any]:
        """Places where samples are missing: a structured array of sample, lost and bid, read-only.

        ``sample`` is the index of the sample after the gap, ``lost`` the number of samples that the packet
        counter of the device ``bid`` skips. `Stats.gaps` and `Stats.lost_samples` are the totals.
        """
        found = self._core.gaps
        gaps = np.empty(len(found.sample), [("sample", "i8"), ("lost", "i8"), ("bid", "u1")])
        gaps["sample"], gaps["lost"], gaps["bid"] = found.sample, found.lost, found.bid
        return read_only(gaps)

    @cached_property
    def stats(self) -> Stats:
        """Counts of what was read."""
        return Stats(**self._core.stats)

    # The device

    def device(self, which: int) -> Log:
        """Returns the log of one device alone, whose samples are counted from 0.

        Offsets are those in the whole input. Damage is that of the whole input, because it could be frames
        of any device. Strings are left out: they name no device.

        Args:
            which: BID (1 for FF too), or device identifier if it is more than 255.

        Raises:
            MissingDeviceError: The log has no samples of this device; a ValueError.

        >>> import xbus
        >>> frames = [xbus.encode_sample({"temperature": 20.0 + bid}, bid=bid) for bid in (1, 2, 1)]
        >>> xbus.read_log(b"".join(frames)).device(2)["temperature"].values.tolist()
        [22.0]
        """
        is_bid = 0 <= which <= MASTER
        for device in self.devices:
            if device_of(device.bid) == device_of(which) if is_bid else device.device_id == which:
                return self.of_device(device.bid)
        raise MissingDeviceError(which, [device.bid for device in self.devices])

    def of_device(self, bid: int, first_sample: int = 0, shape: _core.Shape | None = None) -> Log:
        """Returns the part of one device, which may have no samples in it.

        Args:
            bid: BID of the device.
            first_sample: Number of samples of the device before this part.
            shape: Shape of the whole log of the device, or None if this is not a part.
        """
        core = self._core.of_device(bid, first_sample, shape)
        device = device_of(bid)
        is_own = device_of(self.bid) == device
        times = self._host_times
        host_times = HostTimes.known_already(
            core,
            None if times.known is None else times.known[is_own],
            {other: clock for other, clock in times.clocks.items() if other == device},
            np.empty(0),
            times.fault,
        )
        bids = [found.bid for found in self.devices]
        identities = {device: identity_of(self._identities, bids, bid)}
        return Log(core, quantities=self._filter, identities=identities, host_times=host_times)

    @cached_property
    def _identities(self) -> dict[int, Identity]:
        """The identity of each device up to the end of this part, by BID; 1 stands for FF too."""
        return identities_of(self.messages.with_mids(*IDENTITY_MESSAGES), self._earlier)

    @cached_property
    def identity(self) -> Identity:
        """Identifier, product code, firmware and configuration of the device, from its messages.

        In a log of several devices, those of the first one; `devices` lists all.
        """
        return identity_of(self._identities, list(self._runs.of_devices()))

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

    def arrow_stream(
        self, keys: Key | Iterable[Key] | None = None, *, raw: bool = False
    ) -> _core.ArrowStream:
        """Returns the table of `to_arrow` as a stream for libraries that speak the Arrow C interface."""
        host_time = self._host_times.known
        if isinstance(keys, str | int | tuple):
            return _core.ArrowStream.rows(self[keys]._core, host_time, raw)
        columns = [self[key]._core for key in self._chosen(keys)]
        return _core.ArrowStream.wide(self._core, columns, host_time, raw)

    def _chosen(self, keys: Key | Iterable[Key] | None) -> list[EntryKey]:
        if keys is None:
            return list(self)
        if isinstance(keys, str | int | tuple):
            keys = [keys]
        return list(dict.fromkeys(map(self.resolve, keys)))

    def __arrow_c_stream__(self, requested_schema: object = None) -> object:
        """Returns the table of `to_arrow`, for libraries that speak the Arrow C interface."""
        return self.arrow_stream().__arrow_c_stream__(requested_schema)

    def resample(
        self,
        rate: float,
        quantities: Key | Iterable[Key] | None = None,
        *,
        max_gap: float | None = None,
    ) -> Resampled:
        """Returns quantities at a constant rate, on common times.

        Numbers are interpolated linearly; quaternions and rotation matrices by the shorter rotation (slerp);
        angles such as yaw and longitude across their jump at 180 degrees; status and other integers keep the
        previous value (`Quantity.interpolation` lists the methods). Of ``gnss_pvt_data``, the fields in
        metres, metres per second and degrees are interpolated; other fields of records keep the previous
        value. Fields are in the units of `Column.scaled`.

        Values are unknown before the first and after the last row of a quantity, and between two rows that
        are further apart than `max_gap`; a previous value is kept for at most `max_gap`. No value depends on
        two runs or on two devices. The times of a run begin at its first time stamp. There is no filter: if
        the new rate is lower, motion and vibration faster than half of it appear as slower ones.

        Args:
            rate: Rows per second.
            quantities: One key, or several. Default: all quantities with values between samples, and UTC;
                ``"utc_time"`` among them means `Resampled.utc`.
            max_gap: Longest bridged step between two rows of a quantity, s. Default: 2.5 times its usual
                step, so that one lost row is bridged.

        Raises:
            KeyError: The log does not have one of the quantities.
            ValueError: The rate is not a positive number; the log has no time stamps; or a quantity has no
                values between samples: counters, time stamps, events, and changes over one sampling period.

        >>> import xbus
        >>> log = xbus.read_log("tests/captures/walk.mtb")
        >>> resampled = log.resample(50, quantities=["acceleration", "quaternion"])
        >>> len(resampled), resampled["quaternion"].shape
        (500, (500, 4))
        """
        check_rate(rate)
        if max_gap is not None and not max_gap >= 0:
            raise ValueError(f"max_gap must be a number of seconds, at least 0, not {max_gap!r}")
        columns = [self[key] for key in self._chosen(quantities)]
        has_utc = any(column.name in UTC_SOURCES for column in columns)
        for column in columns:
            can_be = COLUMN_QUANTITIES[column.name].interpolation or column.name == "utc_time"
            if quantities is not None and not can_be:
                raise ValueError(
                    f"{column.name} has no values between samples, so it cannot be resampled; "
                    f"leave it out, or use log[{column.name!r}]"
                )
        columns = [column for column in columns if COLUMN_QUANTITIES[column.name].interpolation]
        if not np.isfinite(self.time).any():
            raise ValueError(
                "the log has no time stamps, without which nothing can be resampled; "
                "read_log(..., rate=100) derives them from the packet counter"
            )
        # UTC in samples of the GNSS receiver is that of its solution, some 10 ms from the time of the sample.
        steady = steady_time(self._core)
        is_steady = bool((~np.isnat(self.utc) & np.isfinite(steady)).any())
        return Resampled(
            rate,
            spans(*self._all_runs),
            columns,
            utc=(self.utc, steady if is_steady else self.time) if has_utc else None,
            max_gap=max_gap,
            first_sample=self.first_sample,
        )

    def plot(
        self,
        keys: Key | Iterable[Key] | None = None,
        *,
        time: PlotTime = "device",
        backend: Backend = "matplotlib",
        ax: Any = None,
    ) -> Any:
        """Draws quantities over time, one below the other.

        Plots of long logs have the minimum and the maximum of each of some 2,000 intervals, at the moments
        of their measurement, so no spike is lost. A line ends where rows are missing, and where a device
        restarted. Devices have separate curves. To see more of a part, read only that part:
        ``read_log(..., between=(60, 70))``.

        Args:
            keys: One key, or several. Default: all quantities with a plot.
            time: ``"device"``: seconds on the device's clock, as in `time`; after a restart the axis goes
                on one step after the last sample, because the length of the interruption is not known.
                Without time stamps it is the packet counter or the number of the sample. ``"utc"``: `utc`,
                and between its values the clock of the device. Samples of a run without UTC are left out,
                with a warning.
            backend: ``"matplotlib"``, or ``"plotly"`` for a figure to zoom in.
            ax: The Axes of matplotlib to draw into, or one for each plot. Default: a new figure.

        Returns:
            The Axes of matplotlib for one plot, an array of them for several; a Figure of plotly.

        Raises:
            ImportError: The extra ``plot``, or ``report`` for plotly, is not installed.
            KeyError: The log does not have one of the quantities.
            ValueError: A quantity has no plot, the log has no valid UTC, or there is nothing to plot.

        >>> import xbus
        >>> log = xbus.read_log("tests/captures/walk.mtb")
        >>> axes = log.plot(["acceleration", "rate_of_turn"])
        >>> [ax.get_ylabel() for ax in axes]
        ['acceleration, m/s2', 'rate_of_turn, rad/s']
        """
        from xbus.log.plotting import plot_columns  # most programs plot nothing
        from xbus.plots.panels import has_panels

        columns = [self[key] for key in self._chosen(keys)]
        if keys is None:
            columns = [column for column in columns if has_panels(column.name)]
        return plot_columns(columns, self._core, time=time, backend=backend, ax=ax)

    def to_arrow(self, keys: Key | Iterable[Key] | None = None, *, raw: bool = False) -> pa.Table:
        """Returns a pyarrow table.

        Without keys, or with a list of them: one row per sample, with the columns ``sample``, ``time``,
        ``host_time`` if arrivals are known, ``bid`` if several devices sent samples, ``utc`` (see `utc`) if
        ``utc_time`` or ``gnss_pvt_data`` is among the quantities, and one for each component of each quantity
        (``acceleration_x``), null if the sample lacks the quantity. With one key it has one row per packet of
        that quantity; for ``"gnss_sat_info"`` one row per satellite. The fields' metadata hold unit,
        coordinates, precision and data identifier.

        Fields of structs are in their units, null where the device does not provide them. ``utc_time`` is one
        timestamp, null where the device does not mark it as valid.

        The columns share memory. To free that of the others, make a table of the columns that you keep.

        Args:
            keys: One key, a list of keys, or None for all quantities.
            raw: Fields of structs as integers, as on the wire, instead of in their units.

        Raises:
            ImportError: The extra ``arrow`` is not installed.
            KeyError: The log does not have one of the quantities.

        >>> import xbus
        >>> log = xbus.read_log("tests/captures/walk.mtb")
        >>> log.to_arrow(["packet_counter", "acceleration"]).column_names
        ['sample', 'time', 'packet_counter', 'acceleration_x', 'acceleration_y', 'acceleration_z']
        """
        table: pa.Table = tables.arrow(self.arrow_stream(keys, raw=raw))
        return table

    def to_pandas(
        self, keys: Key | Iterable[Key] | None = None, *, raw: bool = False
    ) -> pd.DataFrame:
        """Returns the table of `to_arrow` as a pandas DataFrame.

        Integers with nulls become float64; 64-bit ones become UInt64.

        Args:
            keys: One key, a list of keys, or None for all quantities.
            raw: Fields of structs as integers, as on the wire, instead of in their units.

        Raises:
            ImportError: The extra ``pandas`` is not installed.
            KeyError: The log does not have one of the quantities.
        """
        frame: pd.DataFrame = tables.pandas(self.arrow_stream(keys, raw=raw))
        return frame

    def to_polars(
        self, keys: Key | Iterable[Key] | None = None, *, raw: bool = False
    ) -> pl.DataFrame:
        """Returns the table of `to_arrow` as a polars DataFrame.

        Args:
            keys: One key, a list of keys, or None for all quantities.
            raw: Fields of structs as integers, as on the wire, instead of in their units.

        Raises:
            ImportError: The extra ``polars`` is not installed.
            KeyError: The log does not have one of the quantities.
        """
        frame: pl.DataFrame = tables.polars(self.arrow_stream(keys, raw=raw))
        return frame

    def to_parquet(
        self,
        path: str | os.PathLike[str],
        keys: Key | Iterable[Key] | None = None,
        *,
        raw: bool = False,
    ) -> None:
        """Writes the table of `to_arrow` to a Parquet file, which appears whole or not at all.

        Args:
            path: Path of the file.
            keys: One key, a list of keys, or None for all quantities.
            raw: Fields of structs as integers, as on the wire, instead of in their units.

        Raises:
            KeyError: The log does not have one of the quantities.
            OSError: The file cannot be written.
        """
        write_table(self.arrow_stream(keys, raw=raw), path, "parquet")

    def to_csv(
        self,
        path: str | os.PathLike[str],
        keys: Key | Iterable[Key] | None = None,
        *,
        raw: bool = False,
    ) -> None:
        """Writes the table of `to_arrow` to a CSV file: a header, empty fields for nulls, dates in UTC.

        Args and errors are those of `to_parquet`.
        """
        write_table(self.arrow_stream(keys, raw=raw), path, "csv")

    def to_feather(
        self,
        path: str | os.PathLike[str],
        keys: Key | Iterable[Key] | None = None,
        *,
        raw: bool = False,
    ) -> None:
        """Writes the table of `to_arrow` to an Arrow file (Feather).

        Args and errors are those of `to_parquet`.
        """
        write_table(self.arrow_stream(keys, raw=raw), path, "arrow")

    def to_npz(
        self,
        path: str | os.PathLike[str],
        keys: Key | Iterable[Key] | None = None,
        *,
        raw: bool = False,
    ) -> None:
        """Writes the values of every quantity to an npz file, which appears whole or not at all.

        The arrays are:

        - ``NAME`` for each quantity (``NAME_ned`` if coordinates are mixed), one element per packet: the
          `Column.values` or, for structs, `Column.scaled`, a structured array in the units that
          ``xbus quantities`` lists. ``utc_time`` is ``datetime64[ns]``, NaT where the device does not mark
          it as valid.
        - ``NAME.sample`` and ``NAME.time`` for each quantity: sample index, and seconds on the device clock.
        - ``gnss_sat_info.satellites`` and ``gnss_sat_info.offsets``: see `Column.satellites`.
        - ``time`` and ``packet_counter.unwrapped``, one element per sample; ``host_time`` if arrivals are
          known; ``bid`` if several devices sent samples; ``utc`` if ``utc_time`` or ``gnss_pvt_data`` is
          among the quantities.
        - The name of each type of string, as `Strings.table`, without keys, if the log was read with all
          quantities.

        Args:
            path: Path of the file.
            keys: One key, a list of keys, or None for all quantities.
            raw: Structs as they are in `Column.values`: integers, as on the wire.

        Raises:
            KeyError: The log does not have one of the quantities.
            OSError: The file cannot be written.
        """
        tables.npz(self.npz_arrays(keys, raw=raw), path)

    def npz_arrays(
        self, keys: Key | Iterable[Key] | None = None, *, raw: bool = False
    ) -> dict[str, npt.NDArray[Any]]:
        """Returns the arrays of `to_npz`, by name."""
        chosen = self._chosen(keys)
        arrays: dict[str, npt.NDArray[Any]] = {"time": self.time}
        arrays["packet_counter.unwrapped"] = self.packet_counter
        if self._host_times.known is not None:
            arrays["host_time"] = self.host_time
        if len(self.devices) > 1:
            arrays["bid"] = self.bid
        if any(self[key].name in UTC_SOURCES for key in chosen):
            arrays["utc"] = self.utc
        for key in chosen:
            column = self[key]
            stem = key if isinstance(key, str) else f"{key[0]}_{key[1].lower()}"
            arrays[stem] = column.values if raw else _in_units(column)
            arrays[f"{stem}.sample"] = column.sample
            arrays[f"{stem}.time"] = column.time
            if column.name == "gnss_sat_info":
                arrays[f"{stem}.satellites"] = column.satellites
                arrays[f"{stem}.offsets"] = column.offsets
        if keys is None and self._filter is None:
            arrays |= {name: self.strings.table(name) for name in self.strings.counts if name}
        return arrays

    # Comparison and print

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Log):
            return NotImplemented
        return (
            (len(self), self.first_sample, self.stats, self.identity)
            == (len(other), other.first_sample, other.stats, other.identity)
            and list(self.items()) == list(other.items())
            and all(
                identical(getattr(self, name), getattr(other, name))
                for name in (
                    "offset",
                    "time",
                    "host_time",
                    "packet_counter",
                    "bid",
                    "damage",
                    "gaps",
                    "runs",
                )
            )
            and self.messages == other.messages
            and self.strings == other.strings
            and self.unknown == other.unknown
            and self.times_fault == other.times_fault
        )

    __hash__ = None  # type: ignore[assignment]

    def __reduce__(self) -> tuple[Any, ...]:
        return _unpickled, (
            self._core,
            self._filter,
            self._earlier,
            self._host_times,
            self._devices,
        )

    def __repr__(self) -> str:
        return text_table(f"<Log {self._summary()}>", self._quantity_rows(), "<>><")

    def _repr_html_(self) -> str:
        head = ("quantity", "rows", "rate", "")
        return html_table(f"Log: {self._summary()}", head, self._quantity_rows())

    def _summary(self) -> str:
        stats = self.stats
        parts = [
            format_count(len(self), "sample"),
            f"{self.duration:.2f} s" if np.isfinite(self.duration) else None,
            format_count(len(self.keys()), "quantity", "quantities"),
            format_count(stats.strings, "string") if stats.strings else None,
            describe_losses(stats.lost_samples, stats.gaps, has_counter=True)
            if stats.lost_samples
            else None,
            describe_damage(stats.skipped_bytes, len(self.damage)) if stats.skipped_bytes else None,
            self.product_code,
            self.times_fault,
            f"{format_count(len(self.trackers), 'Awinda tracker')}, no orientation"
            if "awinda_snapshot" in self
            else None,
            f"not decoded: {describe_undecoded(self.undecoded)}" if self.undecoded else None,
        ]
        return ", ".join(filter(None, parts))

    def _quantity_rows(self) -> list[tuple[str, str, str, str]]:
        return [
            (
                key if isinstance(key, str) else " ".join(key),
                f"{len(column):,}",
                f"{column.rate:,.1f} Hz" if np.isfinite(column.rate) else "",
                column._format,
            )
            for key, column in self.items()
        ]


@lru_cache
def _key_index(keys: tuple[tuple[str, str | None, str | None], ...]) -> KeyIndex:
    """Returns the index of these keys; all parts of a log have the same."""
    return KeyIndex(QuantityKey(*key) for key in keys)


def _in_units(column: Column) -> npt.NDArray[Any]:
    """Returns the values as in tables: structs in units, a UTC only where the device marks it as valid."""
    if column.name != "utc_time":
        return column.scaled
    is_valid = column.values["valid"] & UTC_VALID == UTC_VALID
    return np.where(is_valid, column.datetime, np.datetime64("NaT", "ns"))


def _unpickled(
    core: _core.Part,
    quantities: QuantityFilter | None,
    identities: dict[int, Identity],
    host_times: HostTimes,
    devices: tuple[LogDevice, ...] | None,
) -> Log:
    return Log(
        core,
        quantities=quantities,
        identities=identities,
        host_times=host_times,
        devices=devices,
    )
