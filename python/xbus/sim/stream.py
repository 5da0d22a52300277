"""The MTData2 messages of a virtual device in Measurement, and their times.

Messages have three kinds of sources, each with its own clock: the base rate of the device, high-rate sensors,
and the GNSS receiver. One packet counter counts the messages of all sources in the order of sending.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from xbus import _core
from xbus.protocol.ids import Coordinates
from xbus.protocol.tables import QUANTITIES, Quantity
from xbus.protocol.values import EVERY, Output
from xbus.sim.sensors import PHASE_RATE, IntArray, Sensors, Ticks, nanoseconds

__all__ = ["Stream"]

#: Ticks of SampleTimeFine in a second.
FINE_RATE = PHASE_RATE
#: Hz of the sensor component readout, a multiple of every base rate.
RAW_RATE = 2000
#: Hz of messages that contain only time stamps and status: the default rate of Table 2.
COMPANIONS_RATE = 100
#: Hz of the GNSS receiver, and seconds from an epoch to its messages; real receivers need 42 to 52 ms.
GNSS_RATE = 4
GNSS_DELAY = 0.045
#: Delay of HR samples after the ticks of the base rate where they are not aligned, in 0.1 ms (Tables 23, 24).
HR_PHASES = {"acceleration_hr": 2, "rate_of_turn_hr": 3}

#: Time stamps that a device adds to the messages of its receiver, in this order.
GNSS_STAMPS = ("utc_time", "sample_time_coarse", "sample_time_fine", "packet_counter")
#: The messages of the receiver in the order of sending, each with its quantities.
GNSS_MESSAGES = (("gnss_sat_info",), ("gnss_pvt_data", "gnss_pvt_pulse"))

#: Number of values that are computed at a time.
BLOCK_VALUES = 256
#: Largest value of StatusByte, which is the low byte of the status word.
STATUS_BYTE = 0xFF


class Stream:
    """The MTData2 messages of the Measurement State.

    A tick of the base rate sends one message if a quantity other than time stamps and status is due. Packets
    are in the order of the configuration. HR samples have their own messages, with the time stamps.
    `gnss_sat_info` and `gnss_pvt_data` have their own messages too, 45 ms late and with the time stamps of
    their epoch. Position and velocity are missing before the first fix. Triggers are not part of the stream.

    Args:
        outputs: The acknowledged configuration: data identifiers with their format bits, and rates in Hz that
            divide the base rate. Groups Timestamp and Status accompany messages at any rate.
        sensors: The sensors.
        base_rate: Hz of the device's ticks. Raw values raise it to 2000.
        synchronous_hr: Whether HR samples coincide with the ticks, as on the 10- and 100-series.
        fine_wrap: Value at which `sample_time_fine` wraps to zero.
        fine_start: `sample_time_fine` at power-up, not wrapped.
        start: Seconds since power-up; the first tick after this time is the first to be sent.
        counter: The first `packet_counter`.
        bid: Bus identifier of the frames.
        device_id: Value of the quantity `device_id`.
        location_id: Value of the quantity `location_id`.

    Attributes:
        sensors: The sensors. They can be replaced during the measurement, except for the time of the fix.
        counter: The next `packet_counter`, from 0 to 65535.

    Raises:
        ValueError: No quantity has a data identifier, or a rate does not divide its base rate.

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
        """Returns the frames sent since the last call, up to and including a time.

        The number of calls for a duration has no effect.

        Args:
            until: Seconds since power-up.
            status: The `status_word` of these messages.

        Returns:
            For each frame its time in seconds since power-up and its bytes, in the order of sending.
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
        times = sent[order].tolist()
        return [(time, frames[i]) for time, i in zip(times, order.tolist(), strict=True)]

    def latest(self, now: float, status: int) -> list[bytes]:
        """Returns the reply to ReqData, or to a trigger with SendLatest: the newest samples.

        These are one message with all quantities of the base rate, and each message that the receiver has
        sent since the last call. HR samples are not included.

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
            packets = [packet for packet in source.packets if tick >= packet.since]
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
                    return np.full(len(ticks), status & STATUS_BYTE, np.int64)
                case "device_id":
                    return np.full(len(ticks), self._device_id, np.int64)
                case "location_id":
                    return np.full(len(ticks), self._location_id, np.int64)
            return packet.rows(self.sensors, ticks)

        columns = [(packet.data_id, column(packet)) for packet in packets]
        frames = _core.encode_samples(columns, self._bid)
        bounds = [0, *frames.ends.tolist()]
        return [frames.data[start:end] for start, end in pairwise(bounds)]


class _Packet:
    """A configured packet: due at every ``every``-th tick of its source, from tick ``since`` on."""

    def __init__(
        self, data_id: int, quantity: Quantity, rate: int, source: _Source, since: int
    ) -> None:
        self.data_id, self.quantity = data_id, quantity
        self.rate, self.phase = rate, source.phase
        self.every, self.since = source.rate // rate, since
        self.accompanies = _accompanies(quantity)
        self._cached: tuple[Sensors, int, npt.NDArray[Any]] | None = None

    def rows(self, sensors: Sensors, ticks: IntArray) -> npt.NDArray[Any]:
        """Returns the newest values at ticks of the source, which must ascend."""
        own = ticks // self.every
        first, last = int(own[0]) // BLOCK_VALUES, int(own[-1]) // BLOCK_VALUES
        blocks = [self._block(sensors, block) for block in range(first, last + 1)]
        values = blocks[0] if len(blocks) == 1 else np.concatenate(blocks)
        return values[own - first * BLOCK_VALUES]

    def _block(self, sensors: Sensors, block: int) -> npt.NDArray[Any]:
        # Blocks are fixed, so not even the last bit of a result depends on the times of the calls.
        if self._cached is None or self._cached[0] is not sensors or self._cached[1] != block:
            ticks = Ticks(block * BLOCK_VALUES, BLOCK_VALUES, self.rate, self.phase)
            coordinates = Output(self.data_id).coordinates
            name = coordinates.name if isinstance(coordinates, Coordinates) else "ENU"
            self._cached = sensors, block, sensors.read(self.quantity.name, ticks, name)
        return self._cached[2]


class _Source:
    """A source of messages with its own rate: tick k is at ``k / rate + phase / 10000`` seconds."""

    def __init__(self, rate: int, phase: int = 0, delay: float = 0.0) -> None:
        self.rate, self.phase = rate, phase
        self.delay = delay
        self.packets: list[_Packet] = []
        self.next = 0

    @property
    def is_gnss(self) -> bool:
        return any(packet.quantity.group == "GNSS" for packet in self.packets)

    @property
    def is_hr(self) -> bool:
        return any(packet.quantity.name in HR_PHASES for packet in self.packets)

    def sent(self, ticks: Any) -> Any:
        """Returns when the messages of ticks are sent, in seconds since power-up."""
        return ticks / self.rate + (self.phase / PHASE_RATE + self.delay)

    def last(self, time: float) -> int:
        """Returns the last tick whose message is sent by a time."""
        tick = math.floor((time - float(self.sent(0))) * self.rate)
        # Rounding can lead to a neighbouring tick.
        while self.sent(tick + 1) <= time:
            tick += 1
        while self.sent(tick) > time:
            tick -= 1
        return tick

    def batches(self, ticks: IntArray) -> Iterator[_Batch]:
        """Groups the ticks that send a message by the packets of the message."""
        if not len(ticks):
            return
        measured = [packet for packet in self.packets if not packet.accompanies]
        if all(packet.every == 1 and packet.since <= ticks[0] for packet in measured):
            yield self, self.packets, ticks
            return
        is_due = np.array(
            [(ticks % packet.every == 0) & (ticks >= packet.since) for packet in measured]
        )
        # Each tick has a number with one bit for each packet that is due.
        combinations = (1 << np.arange(len(measured))) @ is_due
        for combination in np.unique(combinations[combinations > 0]).tolist():
            due = {packet for i, packet in enumerate(measured) if combination >> i & 1}
            packets = [packet for packet in self.packets if packet.accompanies or packet in due]
            yield self, packets, ticks[combinations == combination]


#: Messages with the same packets: their source, packets and ticks.
_Batch: TypeAlias = tuple[_Source, list[_Packet], IntArray]


class _Configured(NamedTuple):
    """A line of the configuration. The rate is `EVERY` for quantities that have no rate."""

    data_id: int
    quantity: Quantity
    rate: int


def _accompanies(quantity: Quantity) -> bool:
    """Returns whether a quantity is part of messages, but does not cause one."""
    return quantity.group in ("Timestamp", "Status")


def _is_base(quantity: Quantity) -> bool:
    """Returns whether a quantity is part of the messages at the base rate."""
    return quantity.group != "GNSS" and quantity.name not in HR_PHASES


def _configured(outputs: Sequence[tuple[int, int]]) -> list[_Configured]:
    rows = []
    for data_id, rate in outputs:
        name = Output(data_id).quantity
        if name is None:
            raise ValueError(f"no quantity has the data identifier {data_id:#06x}")
        quantity = QUANTITIES[name]
        if quantity.group == "Indication":
            continue
        has_rate = not _accompanies(quantity) and quantity.group != "GNSS"
        if has_rate and not 0 < rate <= RAW_RATE:
            raise ValueError(f"{name}: the rate must be 1 to {RAW_RATE} Hz, not {rate} Hz")
        rows.append(_Configured(data_id, quantity, rate if has_rate else EVERY))
    return rows


def _with_packets(source: _Source, rows: Sequence[_Configured], time_to_fix: float) -> _Source:
    """Adds the packets of a source."""
    for data_id, quantity, rate in rows:
        rate = source.rate if rate == EVERY else rate
        if source.rate % rate:
            raise ValueError(f"{quantity.name}: {rate} Hz does not divide {source.rate} Hz")
        needs_fix = quantity.group in ("Position", "Velocity")
        since = math.ceil(round(time_to_fix * source.rate, 6)) if needs_fix else 0
        source.packets.append(_Packet(data_id, quantity, rate, source, since))
    return source


def _sources(
    outputs: Sequence[tuple[int, int]], base_rate: int, synchronous_hr: bool, time_to_fix: float
) -> Iterator[_Source]:
    """Returns the sources, in the order in which their messages of the same time are sent."""
    rows = _configured(outputs)
    base = [row for row in rows if _is_base(row.quantity)]
    if any(not _accompanies(row.quantity) for row in base):
        has_raw = any(row.quantity.group == "Sensor Component Readout" for row in base)
        yield _with_packets(_Source(RAW_RATE if has_raw else base_rate), base, time_to_fix)
    elif rows and base == rows:
        yield _with_packets(_Source(COMPANIONS_RATE), base, time_to_fix)
    for name, phase in HR_PHASES.items():
        for hr in rows:
            if hr.quantity.name == name:
                chosen = [row for row in rows if row is hr or row.quantity.group == "Timestamp"]
                source = _Source(hr.rate, 0 if synchronous_hr else phase)
                yield _with_packets(source, chosen, time_to_fix)
    for names in GNSS_MESSAGES:
        content = [row for name in names for row in rows if row.quantity.name == name]
        if content:
            stamps = [row for name in GNSS_STAMPS for row in rows if row.quantity.name == name]
            source = _Source(GNSS_RATE, delay=GNSS_DELAY)
            yield _with_packets(source, content + stamps, time_to_fix)
