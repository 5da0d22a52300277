"""What a virtual device sends while it measures, and when.

Three clocks make messages, each its own: the base rate of the device, each high-rate sensor, and the
GNSS receiver. One counter goes through all of them in the order of sending.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from xbus import _core
from xbus.protocol.ids import Coordinates
from xbus.protocol.tables import QUANTITIES, Quantity
from xbus.sim.sensors import IntArray, Sensors, Ticks, nanoseconds

__all__ = ["Stream"]

#: Ticks of SampleTimeFine in a second.
FINE_RATE = 10_000
#: Hz of the sensor component readout; it is a multiple of every base rate.
RAW_RATE = 2000
#: Hz of messages that carry nothing but time stamps and status: the default rate of Table 2.
COMPANIONS_RATE = 100
#: Hz of the GNSS receiver, and seconds from an epoch to its messages; real ones need 42 to 52 ms.
GNSS_RATE = 4
GNSS_DELAY = 0.045
#: By how many 0.1 ms HR samples miss the ticks of the base rate where they are not aligned (Tables 23, 24).
HR_PHASES = {"acceleration_hr": 2, "rate_of_turn_hr": 3}

#: What a device adds to the messages of its receiver, in this order.
GNSS_STAMPS = ("utc_time", "sample_time_coarse", "sample_time_fine", "packet_counter")
#: The messages of the receiver, in the order of sending, and what is in each.
GNSS_MESSAGES = (("gnss_sat_info",), ("gnss_pvt_data", "gnss_pvt_pulse"))

BY_ID = {it.id: it for it in QUANTITIES.values()}
#: The rate of what has none of its own.
EVERY = 0xFFFF
#: How many values are worked out at a time.
BLOCK = 256


class Stream:
    """The MTData2 messages of the Measurement State.

    A tick of the base rate sends one message if something but time stamps and status is due, with its
    packets in the order of the configuration. HR samples come in messages of their own, with the time
    stamps; so do `gnss_sat_info` and then `gnss_pvt_data`, 45 ms late and stamped with their epoch.
    Position and velocity are left out before the first fix. Triggers never come: nothing pulls the lines.

    Args:
        outputs: The configuration as acknowledged: data identifiers with their format bits, and Hz, which
            divide the base rate. Groups Timestamp and Status accompany messages whatever their rate.
        sensors: What is measured.
        base_rate: Hz of the device's ticks; raw values, where configured, raise it to 2000.
        synchronous_hr: Whether HR samples fall on the ticks, as on the 10- and 100-series.
        fine_wrap: Where `sample_time_fine` starts again at zero.
        fine_start: What `sample_time_fine` was at power-up, not wrapped.
        start: Seconds since power-up; the first tick after it is the first to send.
        counter: The first `packet_counter`.
        bid: Bus identifier of the frames.
        device_id: What the quantity of this name says.
        location_id: What the quantity of this name says.

    Attributes:
        sensors: What is measured; may be replaced while measuring, but for the time of the fix.
        counter: The next `packet_counter`, from 0 to 65535.

    Raises:
        ValueError: An identifier that no quantity has, or a rate that does not divide its base.

    >>> from xbus.sim.sensors import Sensors
    >>> from xbus.sim.trajectories import trajectory
    >>> from xbus.protocol.tables import PRODUCTS
    >>> sensors = Sensors(trajectory("still"), PRODUCTS[630])
    >>> stream = Stream([(0x1020, 0xFFFF), (0x3010, 100)], sensors=sensors, base_rate=400, fine_wrap=2**32)
    >>> for time, frame in stream.take(0.02, status=0):
    ...     print(time, frame.hex(" ").upper())
    0.01 FA FF 36 0C 10 20 02 00 00 30 10 04 00 01 89 FD C2
    0.02 FA FF 36 0C 10 20 02 00 01 30 10 04 00 01 89 FD C1
    """

    def __init__(
        self,
        outputs: Sequence[tuple[int, int]],
        *,
        sensors: Sensors,
        base_rate: int,
        fine_wrap: int,
        synchronous_hr: bool = False,
        fine_start: int = 0,
        start: float = 0.0,
        counter: int = 0,
        bid: int = 0xFF,
        device_id: int = 0,
        location_id: int = 0,
    ) -> None:
        self.sensors = sensors
        self.counter = counter
        self._bid = bid
        self._fine_start, self._fine_wrap = fine_start, fine_wrap
        self._device_id = device_id
        self._location_id = location_id
        self._sources = list(_sources(outputs, base_rate, synchronous_hr, sensors.time_to_fix))
        for source in self._sources:
            source.next = source.last(start) + 1

    def take(self, until: float, status: int) -> list[tuple[float, bytes]]:
        """The frames sent since the last call, or since the start, up to and at a time.

        How a stretch of time is cut into calls changes nothing.

        Args:
            until: Seconds since power-up.
            status: The `status_word` of these messages.

        Returns:
            When each was sent, in seconds since power-up, and the frame, in the order of sending.
        """
        batches: list[_Batch] = []
        for source in self._sources:
            first, source.next = source.next, max(source.next, source.last(until) + 1)
            batches += source.batches(np.arange(first, source.next, dtype=np.int64))
        if not batches:
            return []
        sent = np.concatenate([source.sent(ticks) for source, _, ticks in batches])
        order = np.argsort(sent, kind="stable")
        counters = np.empty(len(sent), np.int64)
        counters[order] = self._count(len(sent))
        frames: list[bytes] = []
        for source, packets, ticks in batches:
            numbers = counters[len(frames) : len(frames) + len(ticks)]
            frames += self._encode(source, packets, ticks, numbers, status)
        return [(at, frames[i]) for at, i in zip(sent[order].tolist(), order.tolist(), strict=True)]

    def latest(self, now: float, status: int) -> list[bytes]:
        """The answer to a trigger of SendLatest, ReqData for one: the newest sample of what is configured.

        That is one message with everything of the base rate, and one of each kind that the receiver has sent
        since the last time. HR samples have no part in it.

        Args:
            now: Seconds since power-up.
            status: The `status_word` of these messages.
        """
        frames = []
        for source in self._sources:
            tick = source.last(now)
            if source.is_gnss and tick >= source.next:
                source.next = tick + 1
            elif source.is_gnss or source.is_hr:
                continue
            packets = [it for it in source.packets if tick >= it.since]
            if packets:
                frames += self._encode(
                    source, packets, np.array([tick], np.int64), self._count(1), status
                )
        return frames

    def _count(self, messages: int) -> IntArray:
        numbers = (self.counter + np.arange(messages, dtype=np.int64)) % 2**16
        self.counter = (self.counter + messages) % 2**16
        return numbers

    def _encode(
        self,
        source: _Source,
        packets: list[_Packet],
        ticks: IntArray,
        counters: IntArray,
        status: int,
    ) -> list[bytes]:
        fine = ticks * FINE_RATE // source.rate + source.phase + self._fine_start

        def column(packet: _Packet) -> npt.NDArray[Any]:
            match packet.quantity.name:
                case "packet_counter":
                    return counters
                case "sample_time_fine" | "gnss_pvt_pulse":
                    return fine % self._fine_wrap
                case "sample_time_coarse":
                    return fine // FINE_RATE
                case "utc_time":
                    return self.sensors.utc_time(nanoseconds(ticks, source.rate, source.phase))
                case "status_word":
                    return np.full(len(ticks), status, np.int64)
                case "status_byte":
                    return np.full(len(ticks), status & 0xFF, np.int64)
                case "device_id":
                    return np.full(len(ticks), self._device_id, np.int64)
                case "location_id":
                    return np.full(len(ticks), self._location_id, np.int64)
            return packet.rows(self.sensors, ticks)

        columns = [(it.data_id, column(it)) for it in packets]
        frames = _core.encode_samples(columns, self._bid)
        bounds = [0, *frames.ends.tolist()]
        return [frames.data[start:end] for start, end in pairwise(bounds)]


class _Packet:
    """A configured packet: due at every so many ticks of its source from one of them on."""

    def __init__(
        self, data_id: int, quantity: Quantity, rate: int, source: _Source, since: int
    ) -> None:
        self.data_id, self.quantity = data_id, quantity
        self.rate, self.phase = rate, source.phase
        self.every, self.since = source.rate // rate, since
        self.accompanies = _accompanies(quantity)
        self._cached: tuple[Sensors, int, npt.NDArray[Any]] | None = None

    def rows(self, sensors: Sensors, ticks: IntArray) -> npt.NDArray[Any]:
        """The newest values at these ticks of the source, which rise."""
        own = ticks // self.every
        first, last = int(own[0]) // BLOCK, int(own[-1]) // BLOCK
        blocks = [self._block(sensors, it) for it in range(first, last + 1)]
        values = blocks[0] if len(blocks) == 1 else np.concatenate(blocks)
        return values[own - first * BLOCK]

    def _block(self, sensors: Sensors, block: int) -> npt.NDArray[Any]:
        # Always the same ticks together: then not even the last bit depends on how calls cut time.
        if self._cached is None or self._cached[0] is not sensors or self._cached[1] != block:
            ticks = Ticks(block * BLOCK, BLOCK, self.rate, self.phase)
            coordinates = (
                Coordinates(self.data_id & 0xC).name if self.quantity.coordinates else "ENU"
            )
            self._cached = sensors, block, sensors.read(self.quantity.name, ticks, coordinates)
        return self._cached[2]


class _Source:
    """What makes messages at a rate of its own: tick k is at ``k / rate + phase / 10000`` seconds."""

    def __init__(self, rate: int, phase: int = 0, delay: float = 0.0) -> None:
        self.rate, self.phase = rate, phase
        self.delay = delay
        self.packets: list[_Packet] = []
        self.next = 0

    @property
    def is_gnss(self) -> bool:
        return any(it.quantity.group == "GNSS" for it in self.packets)

    @property
    def is_hr(self) -> bool:
        return any(it.quantity.name in HR_PHASES for it in self.packets)

    def sent(self, ticks: Any) -> Any:
        """When the messages of these ticks are sent, in seconds since power-up."""
        return ticks / self.rate + (self.phase / FINE_RATE + self.delay)

    def last(self, time: float) -> int:
        """The last tick whose message has been sent at this time."""
        tick = math.floor((time - float(self.sent(0))) * self.rate)
        # Rounding may have led to a neighbour.
        while self.sent(tick + 1) <= time:
            tick += 1
        while self.sent(tick) > time:
            tick -= 1
        return tick

    def batches(self, ticks: IntArray) -> Iterator[_Batch]:
        """Those of these ticks that send something, by what they send."""
        if not len(ticks):
            return
        measured = [it for it in self.packets if not it.accompanies]
        if all(it.every == 1 and it.since <= ticks[0] for it in measured):
            yield self, self.packets, ticks
            return
        due = np.array([(ticks % it.every == 0) & (ticks >= it.since) for it in measured])
        layouts = (1 << np.arange(len(measured))) @ due
        for layout in np.unique(layouts[layouts > 0]).tolist():
            there = {it for i, it in enumerate(measured) if layout >> i & 1}
            packets = [it for it in self.packets if it.accompanies or it in there]
            yield self, packets, ticks[layouts == layout]


#: Messages of one layout: their source, packets and ticks.
_Batch: TypeAlias = tuple[_Source, list[_Packet], IntArray]


def _accompanies(quantity: Quantity) -> bool:
    """Whether it comes with messages and is no reason to send one."""
    return quantity.group in ("Timestamp", "Status")


def _sources(
    outputs: Sequence[tuple[int, int]], base_rate: int, synchronous_hr: bool, time_to_fix: float
) -> Iterator[_Source]:
    """In the order in which messages of the same time are sent."""
    rows = []
    for data_id, rate in outputs:
        if (quantity := BY_ID.get(data_id & 0xFFF0)) is None:
            raise ValueError(f"no quantity has the data identifier {data_id:#06x}")
        if quantity.group == "Indication":
            continue
        own_rate = not _accompanies(quantity) and quantity.group != "GNSS"
        if own_rate and not 0 < rate <= RAW_RATE:
            raise ValueError(f"{quantity.name}: {rate} Hz is no rate of a device")
        rows.append((data_id, quantity, rate if own_rate else EVERY))

    def is_base(quantity: Quantity) -> bool:
        return quantity.group != "GNSS" and quantity.name not in HR_PHASES

    def source(it: _Source, chosen: Sequence[tuple[int, Quantity, int]]) -> _Source:
        for data_id, quantity, rate in chosen:
            rate = it.rate if rate == EVERY else rate
            if it.rate % rate:
                raise ValueError(f"{quantity.name}: {rate} Hz do not divide {it.rate} Hz")
            needs_fix = quantity.group in ("Position", "Velocity")
            since = math.ceil(round(time_to_fix * it.rate, 6)) if needs_fix else 0
            it.packets.append(_Packet(data_id, quantity, rate, it, since))
        return it

    base = [it for it in rows if is_base(it[1])]
    if any(not _accompanies(it[1]) for it in base):
        raw = any(it[1].group == "Sensor Component Readout" for it in base)
        yield source(_Source(RAW_RATE if raw else base_rate), base)
    elif rows and base == rows:
        yield source(_Source(COMPANIONS_RATE), base)
    for name, phase in HR_PHASES.items():
        for row in rows:
            if row[1].name == name:
                chosen = [it for it in rows if it is row or it[1].group == "Timestamp"]
                yield source(_Source(row[2], 0 if synchronous_hr else phase), chosen)
    for names in GNSS_MESSAGES:
        there = [it for name in names for it in rows if it[1].name == name]
        if there:
            stamps = [it for name in GNSS_STAMPS for it in rows if it[1].name == name]
            yield source(_Source(GNSS_RATE, delay=GNSS_DELAY), there + stamps)
