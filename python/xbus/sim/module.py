"""A virtual 1-series module on I²C or SPI: its pipes, as MTSSP reads and writes them."""

from __future__ import annotations

import time
from collections import deque

from xbus import _core
from xbus.mtssp.codec import PREFIX, PipeStatus, ProtocolInfo, expand, problem_of
from xbus.protocol.ids import MessageId
from xbus.protocol.mtssp import DEFAULT_DATA_READY, MAX_INPUT, PIPE_OVERFLOW, DataReady, Opcode
from xbus.protocol.tables import MASTER, PRODUCTS
from xbus.sim.bus_faults import BusFaults, Fate, Fates
from xbus.sim.device import SimulatedDevice
from xbus.wire.codec import LONGEST_LIVE, encode_frame

__all__ = ["PIPE_BYTES", "Module"]

#: The products with I²C and SPI.
SERIES = "1-series"
#: Bytes of a pipe. The size of real pipes is not published.
PIPE_BYTES = 2048
#: The protocol version that is reported. No document gives the number.
VERSION = 1
OVERFLOW = encode_frame(MessageId.Error, bytes([PIPE_OVERFLOW]))[len(PREFIX) :]


class Pipe:
    """Messages that wait to be read, in order; at least one fits.

    Args:
        size: Most bytes of the messages.
    """

    def __init__(self, size: int) -> None:
        self._size = size
        self.messages: deque[bytes] = deque()

    def add(self, message: bytes) -> bool:
        """Adds a message, unless the pipe is full; returns whether it was added."""
        if self.messages and sum(map(len, self.messages)) + len(message) > self._size:
            return False
        self.messages.append(message)
        return True

    @property
    def next_size(self) -> int:
        """Bytes of the next message; 0 if there is none."""
        return len(self.messages[0]) if self.messages else 0


class Module:
    """The pipes of a virtual device, and what a transfer does with them.

    Args:
        device: The device, of the 1-series and without a baud rate.
        faults: Faults of the bus.
        pipe_bytes: Bytes of each pipe.
        live: Whether the time of the device is that of the computer. If not, each transfer takes device time.

    Attributes:
        device: The device.
        data_ready: The data-ready configuration.
        fates: Draws what becomes of transfers.
        opcode: The opcode of the last transfer that had one.

    Raises:
        ValueError: The device has no I²C and SPI, or is on a serial line.
    """

    def __init__(
        self,
        device: str | SimulatedDevice,
        *,
        faults: BusFaults | None = None,
        pipe_bytes: int = PIPE_BYTES,
        live: bool = False,
    ) -> None:
        self.device = SimulatedDevice(device) if isinstance(device, str) else device
        if self.device.product.series != SERIES:
            names = ", ".join(row.name for row in PRODUCTS.values() if row.series == SERIES)
            raise ValueError(
                f"the {self.device.product.name} has neither I²C nor SPI; {names} have"
            )
        if self.device.is_serial or self.device.faults is not None:
            raise ValueError("a device on I²C or SPI has no baud rate, and other faults: BusFaults")
        self.faults = faults or BusFaults()
        self._pipe_bytes = pipe_bytes
        self._live_since = time.monotonic() - self.device.time if live else None
        self._scanner = _core.Scanner(LONGEST_LIVE, 0)
        self._clear()

    @property
    def is_live(self) -> bool:
        """Whether the time of the device is that of the computer."""
        return self._live_since is not None

    @property
    def faults(self) -> BusFaults:
        """The faults of the bus; they can be replaced at any time."""
        return self._faults

    @faults.setter
    def faults(self, faults: BusFaults) -> None:
        self._faults, self.fates = faults, Fates(faults)

    def _clear(self) -> None:
        self._notifications, self._measurements = Pipe(self._pipe_bytes), Pipe(self._pipe_bytes)
        self.data_ready = DEFAULT_DATA_READY
        self.opcode = 0

    # Time

    def begin(self) -> Fate:
        """Begins a transfer, and returns what becomes of it."""
        if self._live_since is not None:
            due = time.monotonic() - self._live_since
            self.device.advance(max(due - self.device.time, 0.0))
        self.collect()
        if self.device.is_booting or not self.device.plugged:
            return Fate.NACK
        return self.fates.next(self.device.time)

    def spend(self, seconds: float) -> None:
        """Lets the time of a transfer pass."""
        if self._live_since is None:
            self.device.advance(seconds)

    # Pipes

    def collect(self) -> None:
        """Moves what the device has sent into the pipes."""
        for item in self._scanner.feed(self.device.read(), False):
            if isinstance(item, _core.ScannedFrame):  # strings have no pipe
                self._add(item)

    def _add(self, frame: _core.ScannedFrame) -> None:
        if frame.mid == MessageId.WakeUp:  # what waited was lost at the restart
            self._clear()
        if self.fates.is_dropped():
            return
        message = encode_frame(frame.mid, frame.payload, bid=MASTER)[len(PREFIX) :]
        is_sample = frame.mid == MessageId.MTData2
        pipe = self._measurements if is_sample else self._notifications
        # A pipe that is full for long gets one report, or the reports would fill the other pipe.
        if not pipe.add(message) and OVERFLOW not in self._notifications.messages:
            self._notifications.messages.append(OVERFLOW)

    @property
    def drdy(self) -> bool:
        """Whether the pin DRDY is high."""
        self.collect()
        is_active = (
            DataReady.NOTIFICATIONS in self.data_ready and self._notifications.next_size > 0
        ) or (DataReady.MEASUREMENTS in self.data_ready and self._measurements.next_size > 0)
        return is_active != (DataReady.IDLE_HIGH in self.data_ready)

    # Transfers

    def select(self, opcode: int) -> None:
        """Begins with an opcode, which stays selected for the reads after it."""
        self.opcode = opcode

    @property
    def is_write(self) -> bool:
        """Whether the opcode writes data."""
        return self.opcode in (Opcode.CONFIGURE_PROTOCOL, Opcode.CONTROL_PIPE)

    def write(self, data: bytes) -> None:
        """Takes the data after the opcode."""
        if self.opcode == Opcode.CONFIGURE_PROTOCOL and data:
            self.data_ready = DataReady(data[0])
        elif self.opcode == Opcode.CONTROL_PIPE:
            if len(data) > MAX_INPUT:  # a longer message resets the buffer
                data = data[(len(data) - 1) // MAX_INPUT * MAX_INPUT :]
            if problem_of(data) is None:
                self.device.write(expand(data))

    def read(self, size: int) -> bytes:
        """Returns the data of the opcode. Beyond its end, the message begins again."""
        data = self._content()
        return (data * (size // len(data) + 1))[:size] if data else bytes(size)

    def end_read(self, size: int) -> None:
        """Removes a message that was read to its end."""
        pipe = self._pipe()
        if pipe is not None and 0 < pipe.next_size <= size:
            pipe.messages.popleft()

    def _content(self) -> bytes:
        if self.opcode == Opcode.PIPE_STATUS:
            return PipeStatus(self._notifications.next_size, self._measurements.next_size).encode()
        if self.opcode == Opcode.PROTOCOL_INFO:
            return ProtocolInfo(VERSION, self.data_ready).encode()
        pipe = self._pipe()
        return pipe.messages[0] if pipe is not None and pipe.messages else b""

    def _pipe(self) -> Pipe | None:
        pipes: dict[int, Pipe] = {
            Opcode.NOTIFICATION_PIPE: self._notifications,
            Opcode.MEASUREMENT_PIPE: self._measurements,
        }
        return pipes.get(self.opcode)
