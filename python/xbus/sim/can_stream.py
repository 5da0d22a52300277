"""The frames that a virtual MTi-600 sends on CAN in Measurement, and their times."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from xbus.protocol.can import CAN_MESSAGES, CanMessage, frame_bits
from xbus.protocol.tables import QUANTITIES
from xbus.protocol.values import CanOutput
from xbus.sim.clock import SECOND
from xbus.sim.sensors import PHASE_RATE, PVT_FIELDS, IntArray, Sensors, Ticks, nanoseconds

__all__ = ["CanFrame", "CanStream", "can_groups_per_second", "deltav_exponent"]

#: Groups per second of a device that sends nothing with a rate: the default rate of Table 2.
STAMPS_RATE = 100
#: Number of values that are computed at a time.
BLOCK_VALUES = 256
#: Codes of messages.
ERROR, SAMPLE_TIME, GROUP_COUNTER, UTC_TIME, STATUS_WORD, DELTA_V = (
    0x01,
    0x05,
    0x06,
    0x07,
    0x11,
    0x31,
)
#: Code of Error: the output buffer overflowed.
OVERFLOW = b"\1"
#: Quantities without values before the first fix.
NEED_FIX = ("Position", "Velocity")


class CanFrame(NamedTuple):
    """A frame on the bus.

    Attributes:
        time: When it has been sent, in seconds since the device was created.
        can_id: Identifier.
        extended: Whether the identifier has 29 bits.
        data: Its data.
    """

    time: float
    can_id: int
    extended: bool
    data: bytes


def deltav_exponent(rate: int) -> int:
    """Returns the exponent of the unit of DeltaV, 2^-e m/s, at a rate in Hz (MT1604P, section 6.4.1).

    >>> [deltav_exponent(rate) for rate in (400, 100, 80, 1)]
    [17, 15, 14, 8]
    """
    return 8 + math.floor(math.log2(1.28 * rate))


def can_groups_per_second(rates: Sequence[int]) -> int:
    """Returns the rate whose ticks contain the ticks of all rates, in Hz."""
    return math.lcm(*rates) if rates else STAMPS_RATE


class CanStream:
    """The frames of the CAN output configuration.

    All frames of a sample instant are a group, in the order in which the bus sends them: the lowest
    identifier first. There is a group whenever an output with a rate is due; outputs without one are in
    every group. Position and velocity are missing before the first fix, and UtcTime while the receiver has
    no time.

    A group must be sent before the next one. If the bus cannot do that, with the most stuff bits that frames
    can have, the rest of the group is dropped and Error 1 is sent.

    Args:
        outputs: The outputs; those that the product or CAN does not have are left out.
        bitrate: Bits per second of the bus.
        sensors: The sensors. They can be replaced.
        fine_start: SampleTime at time zero, in 0.1 ms.
        start: Time in ns; the first group after it is the first to be sent.
    """

    def __init__(
        self,
        outputs: Sequence[CanOutput],
        *,
        bitrate: int,
        sensors: Sensors,
        fine_start: int,
        start: int,
    ) -> None:
        self.sensors = sensors
        self._bitrate, self._fine_start = bitrate, fine_start
        self._counter = 0
        number = sensors.product.number
        sent = [
            (CAN_MESSAGES[output.data_id], output)
            for output in outputs
            if output.data_id in CAN_MESSAGES
            and CAN_MESSAGES[output.data_id].signals
            and number in CAN_MESSAGES[output.data_id].products
        ]
        self._error = next(
            (output for row, output in sent if row.code == ERROR), CanOutput(ERROR, False, 1, 0)
        )
        sent = [(row, output) for row, output in sent if row.kind != "event"]
        rates = {output.data_id: _rate_of(row, output) for row, output in sent}
        self._rate = can_groups_per_second([rate for rate in rates.values() if rate])
        self._signals = [
            _Output(row, output, rates[output.data_id], self._rate) for row, output in sent
        ]
        self._signals.sort(key=lambda signal: signal.priority)
        self._due = sorted({signal.every for signal in self._signals if signal.has_rate}) or [1]
        self._next = self._last(start) + 1

    def _last(self, time: int) -> int:
        """Returns the last tick up to a time in ns."""
        return -(-(time + 1) * self._rate // SECOND) - 1

    def take(self, until: int, status: int) -> list[CanFrame]:
        """Returns the frames of the groups since the last call, up to and including a time in ns.

        The number of calls for a duration has no effect.

        Args:
            until: The time in ns.
            status: The status word of these groups.
        """
        first, self._next = self._next, max(self._next, self._last(until) + 1)
        if first == self._next or not self._signals:
            return []
        ticks = np.arange(first, self._next, dtype=np.int64)
        ticks = ticks[np.any([ticks % every == 0 for every in self._due], axis=0)]
        if not len(ticks):
            return []
        rows = [self._rows(signal, ticks, status) for signal in self._signals]
        self._counter += len(ticks)
        frames: list[CanFrame] = []
        for at, tick in enumerate(ticks.tolist()):
            group = [(signal, row[at]) for signal, row in zip(self._signals, rows, strict=True)]
            self._send(frames, tick, [(signal, data) for signal, data in group if data])
        return frames

    def _send(
        self, frames: list[CanFrame], tick: int, group: Sequence[tuple[_Output, bytes]]
    ) -> None:
        """Adds the frames of a group, as long as the bus sends them before the next group."""
        time = tick / self._rate
        end = min(tick // every * every + every for every in self._due) / self._rate
        for signal, data in group:
            bits = frame_bits(len(data), is_extended=signal.output.extended)
            if time + bits / self._bitrate > end:
                error = self._error
                time += frame_bits(len(OVERFLOW), is_extended=error.extended) / self._bitrate
                frames.append(CanFrame(time, error.can_id, error.extended, OVERFLOW))
                return
            time += bits / self._bitrate
            frames.append(CanFrame(time, signal.output.can_id, signal.output.extended, data))

    def _rows(self, signal: _Output, ticks: IntArray, status: int) -> list[bytes]:
        """Returns the data of a message at ticks; empty where it is not due."""
        due = (
            np.flatnonzero(ticks % signal.every == 0) if signal.has_rate else np.arange(len(ticks))
        )
        found = [b""] * len(ticks)
        if not len(due):
            return found
        own = ticks[due]
        match signal.row.code:
            case 0x05:
                values = own * PHASE_RATE // self._rate + self._fine_start
                data = signal.integers(values[:, np.newaxis] % 2**32)
            case 0x06:
                data = signal.integers((self._counter + due)[:, np.newaxis] % 2**16)
            case 0x11:
                data = signal.integers(np.full((len(due), 1), status, np.int64))
            case 0x07:
                fields = self.sensors.utc_time(nanoseconds(own, self._rate, 0))
                values = np.column_stack(
                    [fields[:, 1] - 2000, fields[:, 2:7], fields[:, 0] // 100_000]
                )
                data = [
                    frame if valid else b""
                    for frame, valid in zip(
                        signal.integers(values), fields[:, 7].tolist(), strict=True
                    )
                ]
            case _:
                data = signal.measured(self.sensors, own)
        for at, frame in zip(due.tolist(), data, strict=True):
            found[at] = frame
        return found


class _Output:
    """A message that is sent at ``every``-th tick, or with every group."""

    def __init__(self, row: CanMessage, output: CanOutput, rate: int | None, ticks: int) -> None:
        self.row, self.output = row, output
        self.has_rate = rate is not None
        self.rate = rate or ticks
        self.every = ticks // self.rate
        number, is_long = output.can_id, output.extended
        # Arbitration compares the first eleven bits, and the shorter identifier wins.
        self.priority = (number >> 18, 1, number & 0x3FFFF) if is_long else (number, 0, 0)
        self._exponent = deltav_exponent(self.rate) if row.code == DELTA_V else None
        self._type = np.dtype([(signal.name, f">{signal.type}") for signal in row.signals])
        self._cached: tuple[Sensors, int, list[bytes]] | None = None

    def integers(self, counts: npt.NDArray[Any]) -> list[bytes]:
        """Returns the data of rows of integers, which are limited to the ranges of the signals."""
        rows = np.empty(len(counts), self._type)
        for signal, column in zip(self.row.signals, counts.T, strict=True):
            low, high = signal.limits
            rows[signal.name] = np.clip(column, low, high)
        return [row.tobytes() for row in rows]

    def measured(self, sensors: Sensors, ticks: IntArray) -> list[bytes]:
        """Returns the data of a measured quantity at ticks."""
        frames = []
        for own in (ticks // self.every).tolist():
            block = own // BLOCK_VALUES
            # Blocks are fixed, so not even the last bit of a result depends on the times of the calls.
            if self._cached is None or self._cached[:2] != (sensors, block):
                first = Ticks(block * BLOCK_VALUES, BLOCK_VALUES, self.rate)
                self._cached = sensors, block, self._block(sensors, first)
            frames.append(self._cached[2][own % BLOCK_VALUES])
        return frames

    def _block(self, sensors: Sensors, ticks: Ticks) -> list[bytes]:
        data = self.integers(self._counts(sensors, ticks))
        quantity = QUANTITIES.get(self.row.quantity or "")
        if quantity is None or quantity.group not in NEED_FIX:
            return data
        has_fix = ticks.time >= sensors.time_to_fix
        return [
            frame if fixed else b"" for frame, fixed in zip(data, has_fix.tolist(), strict=True)
        ]

    def _counts(self, sensors: Sensors, ticks: Ticks) -> npt.NDArray[Any]:
        """Returns the integers of the signals, ``(n, k)``."""
        row, name = self.row, self.row.quantity or ""
        match row.kind, name:
            case "record", "gnss_receiver_status":
                pvt = sensors.read("gnss_pvt_data", ticks)
                names = ("fixtype", "numSV", "flags", "valid")
                columns = [pvt[:, list(PVT_FIELDS).index(field)] for field in names]
                return np.column_stack([*columns, np.full(ticks.count, sensors.satellites)])
            case "record", _:
                pvt = sensors.read("gnss_pvt_data", ticks)
                return pvt[:, [list(PVT_FIELDS).index(signal.name) for signal in row.signals]]
            case _, "baro_pressure":
                values = sensors.pressure(ticks)[:, np.newaxis]
            case "component", _:
                place = "XYZ".index(row.name[-1])
                values = sensors.read(name, ticks)[:, place : place + 1]
            case _:
                values = sensors.read(name, ticks).reshape(ticks.count, -1)
        if self._exponent is not None:
            counts = np.rint(values * 2**self._exponent)
            return np.column_stack([counts, np.full(ticks.count, self._exponent)])
        return np.rint(values * [signal.per_unit for signal in row.signals])


def _rate_of(row: CanMessage, output: CanOutput) -> int | None:
    """Returns the rate of an output in Hz; None if it is in every group."""
    if output.rate is None:
        return row.max_rate
    return min(output.rate, row.max_rate or output.rate)
