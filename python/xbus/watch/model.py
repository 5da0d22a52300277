"""The state of a stream: plain data that a source updates and the screen shows."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from xbus.log.column import Column
from xbus.log.log import Log
from xbus.log.runs import steady_time
from xbus.protocol.tables import STATUS_FLAGS, device_of
from xbus.protocol.undecoded import output_mids, output_name, undecoded_output
from xbus.protocol.values import State
from xbus.rtk.fix import Fix
from xbus.watch.attitude import ORIENTATIONS, Attitude, attitude_of
from xbus.watch.rate import RATE_SPAN, Rate

__all__ = ["Clipped", "Counts", "Model", "MonitorEvent", "QuantityState", "RecordingState"]

#: A quantity has stopped after this many periods without a packet, and at least this many seconds.
STOPPED_PERIODS, STOPPED_SECONDS = 3.0, 1.5
#: Flags of axes that are out of range, and the names of the axes.
CLIP_FLAGS = {
    name: name.removeprefix("clip_").replace("_", " ")
    for name in STATUS_FLAGS
    if name.startswith("clip_")
}
#: Number of events to keep.
MAX_EVENTS = 100


@dataclass
class QuantityState:
    """The latest value and the rate of a quantity, or of a type of string.

    Attributes:
        name: Name of the quantity, or the data identifier in hex if it is unknown.
        coordinates: ``"ENU"``, ``"NED"``, ``"NWU"``, or None.
        unit: Unit of the numbers; empty for a struct, whose fields have their own units.
        fields: Names of the components or fields.
        units: Units of the fields of a struct.
        count: Number of packets received.
        value: The latest row of the column, scaled; the bytes of an unknown packet; the satellites of
            ``gnss_sat_info``; the text of a string.
        updated_at: When the value arrived, on the clock of the source.
    """

    name: str
    coordinates: str | None = None
    unit: str = ""
    fields: tuple[str, ...] = ()
    units: dict[str, str] = field(default_factory=dict)
    count: int = 0
    value: Any = None
    updated_at: float = -math.inf
    _rate: Rate = field(default_factory=Rate)
    #: When the last packet with a time stamp arrived; -inf while the host clock measures the rate.
    _stamped_at: float = -math.inf

    def update(self, count: int, now: float, stamp: float) -> None:
        """Counts packets.

        Args:
            count: Number of packets.
            now: Time of arrival on the clock of the source, s.
            stamp: Time of the last packet on the device clock, s; NaN if none of them has one.
        """
        is_stamped = math.isfinite(stamp)
        self.count += count
        self.updated_at = now
        if not is_stamped and now - self._stamped_at <= RATE_SPAN:
            return  # those of the receiver have none; the next stamp measures the rate
        if is_stamped != math.isfinite(self._stamped_at):
            self._rate = Rate()  # on the other clock
        self._stamped_at = now if is_stamped else -math.inf
        self._rate.add(stamp if is_stamped else now, self.count)

    def restart_rate(self) -> None:
        """Measures the rate from now on: before, the device did not send for a while."""
        self._rate = Rate()

    def has_stopped(self, now: float) -> bool:
        """Returns whether a packet is overdue."""
        rate = self._rate.value
        return now - self.updated_at > max(STOPPED_SECONDS, STOPPED_PERIODS / rate if rate else 0.0)

    def rate(self, now: float) -> float | None:
        """Returns packets per second: 0 if they have stopped, None if not measured yet.

        The device clock measures the rate, or the host clock if the device sends no time stamps.
        """
        return 0.0 if self.has_stopped(now) else self._rate.value


@dataclass
class Counts:
    """Totals since the stream is watched, and the amount of data that waits now.

    Attributes:
        samples, bytes: Received data.
        lost_samples, gaps: Samples missing by the packet counter, and the number of places.
        skipped_bytes, checksum_errors, malformed: Damage.
        errors, warnings: Messages of the device.
        overruns, dropped_samples: Data dropped by the driver, and unread.
        queued_bytes, unread_samples: Waiting data.
    """

    samples: int = 0
    bytes: int = 0
    lost_samples: int = 0
    gaps: int = 0
    skipped_bytes: int = 0
    checksum_errors: int = 0
    malformed: int = 0
    errors: int = 0
    warnings: int = 0
    overruns: int = 0
    dropped_samples: int = 0
    queued_bytes: int = 0
    unread_samples: int = 0


@dataclass
class RecordingState:
    """A recording: its files, its size in bytes, and the error that ended it early, or None."""

    file: str
    bytes: int
    error: str | None = None

    def __str__(self) -> str:
        early = "" if self.error is None else f"; the recording ended early: {self.error}"
        return f"recorded {self.bytes:,} bytes in {self.file}{early}"


@dataclass
class MonitorEvent:
    """An event: seconds since the stream is watched, text, and whether it is a problem."""

    at: float
    text: str
    is_bad: bool = True


class Clipped(NamedTuple):
    """Samples of an axis that were out of range: their number, and when the last one arrived."""

    samples: int
    at: float


@dataclass
class Model:
    """The state of a stream.

    Attributes:
        name: Port or file.
        device: Product code of the device, once known.
        state: State of the device; None for a recording.
        is_lost: Whether the port is gone.
        is_listening: Whether nothing is ever sent.
        baudrate: Baud rate of the port; None for a recording or if unknown.
        now: Seconds on the clock of the source.
        begin: When it was first watched, on the same clock.
        progress: Share of a recording that was replayed, 0 to 1; None for a port.
        quantities: Quantities by name and coordinates, in order of first arrival.
        last_attitude: The last attitude of the device, and its time; None if there is none.
        fix: The GNSS fix.
        counts: Totals.
        clipped: The axes that were out of range, as ``"acc x"``; ``"a sensor"`` if it is not known which.
        devices: BIDs of the devices that sent samples; 1 stands for FF too.
        events: The latest events.
        recording: The current recording.
        corrections: What was forwarded from a caster, in words; None without one.
        on_several_devices: What follows, or the remedy, if samples of several devices are mixed.
    """

    name: str
    device: str | None = None
    state: State | None = None
    is_lost: bool = False
    is_listening: bool = False
    baudrate: int | None = None
    now: float = 0.0
    begin: float = 0.0
    progress: float | None = None
    quantities: dict[tuple[str, str | None], QuantityState] = field(default_factory=dict)
    last_attitude: tuple[Attitude, float] | None = None
    fix: Fix = field(default_factory=Fix)
    counts: Counts = field(default_factory=Counts)
    clipped: dict[str, Clipped] = field(default_factory=dict)
    devices: set[int] = field(default_factory=set)
    events: deque[MonitorEvent] = field(default_factory=lambda: deque(maxlen=MAX_EVENTS))
    recording: RecordingState | None = None
    corrections: str | None = None
    on_several_devices: str = "values and rates mix them"

    @property
    def elapsed(self) -> float:
        """Seconds since the stream is watched."""
        return self.now - self.begin

    @property
    def attitude(self) -> Attitude | None:
        """The current attitude; None if there is none or it is too old."""
        if self.last_attitude is None or self.now - self.last_attitude[1] > STOPPED_SECONDS:
            return None
        return self.last_attitude[0]

    @property
    def status(self) -> QuantityState | None:
        """The status word, or else the status byte, if it has not stopped."""
        return self.current("status_word") or self.current("status_byte")

    @property
    def has_faults(self) -> bool:
        """Whether samples were lost, damaged, dropped or out of range, as far as they are counted."""
        counts = self.counts
        return bool(
            self.clipped
            or counts.lost_samples
            or counts.skipped_bytes
            or counts.checksum_errors
            or counts.malformed
            or counts.overruns
            or counts.dropped_samples
        )

    def add_event(self, text: str, *, is_bad: bool = True) -> None:
        """Adds an event that happens now."""
        self.events.append(MonitorEvent(self.elapsed, text, is_bad))

    def restart_rates(self) -> None:
        """Measures all rates from now on."""
        for quantity in self.quantities.values():
            quantity.restart_rate()

    def current(self, name: str) -> QuantityState | None:
        """Returns the latest quantity with this name, in any coordinates, if it has not stopped."""
        found = [quantity for (other, _), quantity in self.quantities.items() if other == name]
        active = [quantity for quantity in found if not quantity.has_stopped(self.now)]
        return max(active, key=lambda quantity: quantity.updated_at, default=None)

    def add_block(self, block: Log, now: float) -> None:
        """Updates the state with the samples since the last call.

        Args:
            block: The samples.
            now: When the last of them arrived, on the clock of the source.
        """
        self.now = now
        times = steady_time(block.core)
        columns = [block[key] for key in block]
        updated = {
            column.name: self._add_column(column, now, times[column.sample - block.first_sample])
            for column in columns
        }
        for data_id, packets in block.unknown.items():
            name = f"0x{data_id:04X}"
            quantity = self.quantities.setdefault((name, None), QuantityState(name))
            quantity.value = packets[-1]
            quantity.update(len(packets), now, math.nan)
        self._add_devices(block)
        self._add_strings(block, now)
        self._update_attitude(updated, now)
        self._update_clipping(block, now)
        self.fix.update_from_block(block)

    def _add_devices(self, block: Log) -> None:
        """Adds an event if another device sends samples, which are shown as those of the first."""
        before = len(self.devices)
        self.devices |= {device_of(bid) for bid, _ in block.core.devices}
        if len(self.devices) > max(before, 1):
            bids = ", ".join(map(str, sorted(self.devices)))
            self.add_event(
                f"samples of several devices (BID {bids}) are shown as those of one; "
                f"{self.on_several_devices}"
            )

    def add_undecoded(self, counts: Mapping[int, int]) -> None:
        """Updates the outputs that are not decoded, such as legacy MTData.

        Args:
            counts: Totals of messages by message identifier.
        """
        for mid in output_mids(counts):
            name = output_name(mid)
            quantity = self.quantities.get((name, None))
            if quantity is None:
                quantity = self.quantities[name, None] = QuantityState(name)
                quantity.value = "not decoded"
                self.add_event(f"the device sends {undecoded_output(mid)}")
            if new := counts[mid] - quantity.count:
                quantity.update(new, self.now, math.nan)

    def _add_strings(self, block: Log, now: float) -> None:
        for string in block.strings:
            name = "" if string.type is None else str(string.type.name)
            quantity = self.quantities.setdefault(
                (name, None), QuantityState(name or "other strings")
            )
            quantity.value = string.text
        for name, count in block.strings.counts.items():
            self.quantities[name, None].update(count, now, math.nan)

    def _add_column(
        self, column: Column, now: float, times: npt.NDArray[np.float64]
    ) -> QuantityState:
        name, coordinates = column.name, column.coordinates
        quantity = self.quantities.get((name, coordinates))
        if quantity is None:
            quantity = QuantityState(name, coordinates, column.unit, column.fields, column.units)
            self.quantities[name, coordinates] = quantity
        if name == "gnss_sat_info":
            quantity.value = column.satellites[column.offsets[-2] :]
        else:
            quantity.value = column.scaled[-1]
        # Samples of the GNSS receiver have times of their own, arbitrary without a fix.
        known = times[np.isfinite(times)]
        quantity.update(len(column), now, float(known[-1]) if len(known) else math.nan)
        return quantity

    def _update_attitude(self, updated: dict[str, QuantityState], now: float) -> None:
        name = next((name for name in ORIENTATIONS if name in updated), None)
        if name is not None:
            quantity = updated[name]
            attitude = attitude_of(name, quantity.coordinates, quantity.value)
            self.last_attitude = None if attitude is None else (attitude, now)

    def _update_clipping(self, block: Log, now: float) -> None:
        """Counts the samples of a block that are out of range: a short event must not pass unseen."""
        if "status_word" not in block:
            return
        words = block["status_word"].values
        axes = {name: STATUS_FLAGS[flag].of(words) for flag, name in CLIP_FLAGS.items()}
        # Which sensor it was is not known of words without a flag of an axis.
        is_known = np.any([*axes.values()], axis=0)
        axes["a sensor"] = STATUS_FLAGS["clipping"].of(words) & ~is_known
        found = {
            name: count for name, is_out in axes.items() if (count := int(np.count_nonzero(is_out)))
        }
        for name, count in found.items():
            before = self.clipped[name].samples if name in self.clipped else 0
            self.clipped[name] = Clipped(before + count, now)
