"""The host of a module: reads its pipes into an acquisition, and writes messages to it."""

from __future__ import annotations

import errno
import threading
from collections.abc import Callable, Iterator
from functools import partial
from typing import NamedTuple, TypeVar

from xbus import _core
from xbus.errors import BusError, DecodeError
from xbus.mtssp.bus import Bus
from xbus.mtssp.codec import PREFIX, PipeStatus, problem_of, reduce
from xbus.protocol.ids import MessageId
from xbus.protocol.mtssp import MAX_INPUT, OPCODES, PIPE_OVERFLOW, DataReady, Opcode

__all__ = ["Clock", "Host"]

#: Seconds for which all transfers may fail: a module does not answer while it starts.
MAX_FAILURE = 1.0
#: Seconds between two attempts.
RETRY_PAUSE = 0.005
#: Error numbers of Linux for a byte that is not acknowledged. Other systems lack one of them.
NACK = (getattr(errno, "EREMOTEIO", errno.ENXIO), errno.ENXIO)
#: The longest payload of a frame.
MAX_PAYLOAD = 0xFFFF

T = TypeVar("T")


class Clock(NamedTuple):
    """The clock of a link.

    Attributes:
        now: Returns the time in seconds.
        pause: Waits some seconds.
    """

    now: Callable[[], float]
    pause: Callable[[float], None]


class Host:
    """Reads the pipes of a module into an acquisition, and writes messages to it.

    Two threads may use it. A transfer that fails is counted and repeated. Each message is one transfer.

    Args:
        bus: The bus.
        acquisition: Gets what the module sends, as frames; damaged messages as well.
        clock: The clock.
        data_ready: What the pin DRDY shall do; None: what it does after power-up. It is set again when the
            module wakes up, because no document says that a module keeps it.
    """

    def __init__(
        self,
        bus: Bus,
        acquisition: _core.Acquisition,
        clock: Clock,
        data_ready: DataReady | None = None,
    ) -> None:
        self.bus = bus
        self._acquisition, self._clock, self._data_ready = acquisition, clock, data_ready
        #: Held during a transfer.
        self._using = threading.Lock()
        self._failing_since: float | None = None
        acquisition.count_bus()

    def begin(self) -> PipeStatus:
        """Waits until the module answers, and configures it. Returns the state of its pipes.

        Raises:
            BusError: It does not answer within a second.
        """
        self._insist(self._configure)
        return self._insist(self._status)

    def receive(self) -> bool:
        """Reads a message of each pipe that has one, and returns whether there was any.

        Raises:
            BusError: All transfers have failed for a second.
        """
        found = False
        try:
            for frame in self._frames():
                found = True
                self._pass_on(frame)
        except BusError:
            self._acquisition.count_bus(transfer_errors=1)
            now = self._clock.now()
            if self._failing_since is None:
                self._failing_since = now
            elif now - self._failing_since >= MAX_FAILURE:
                self._failing_since = None
                raise
        else:
            self._failing_since = None
        return found

    def _frames(self) -> Iterator[bytes]:
        status = self._status()
        if status.notification:
            yield PREFIX + self._read(Opcode.NOTIFICATION_PIPE, status.notification)
        if status.measurement:
            yield PREFIX + self._read(Opcode.MEASUREMENT_PIPE, status.measurement)

    def _pass_on(self, frame: bytes) -> None:
        self._acquisition.push(frame, self._clock.now())
        message = frame[len(PREFIX) :]
        if problem_of(message) is not None:
            # Its length may promise more bytes, and the next message must not be taken for them.
            self._acquisition.interrupt()
        elif message[0] == MessageId.Error and message[2] == PIPE_OVERFLOW:
            self._acquisition.count_bus(overruns=1)
        elif message[0] == MessageId.WakeUp:
            self._configure()

    def send(self, data: bytes) -> None:
        """Writes frames, each as a message. A transfer that fails is repeated for up to a second.

        Raises:
            BusError: All transfers failed.
            ValueError: The bytes are not whole frames, or one is too long for the module. Nothing was sent.
        """
        messages = [reduce(frame) for frame in _split(data)]
        if (longest := max(map(len, messages), default=0)) > MAX_INPUT:
            raise ValueError(
                f"a message of {longest:,} bytes exceeds the {MAX_INPUT} bytes that an MTi accepts on I²C"
                " and SPI; nothing was sent"
            )
        for message in messages:
            self._insist(partial(self._write, Opcode.CONTROL_PIPE, message))

    def _configure(self) -> None:
        if self._data_ready is not None:
            self._write(Opcode.CONFIGURE_PROTOCOL, bytes([self._data_ready]))

    def _status(self) -> PipeStatus:
        data = self._read(Opcode.PIPE_STATUS)
        try:
            return PipeStatus.parse(data)
        except DecodeError as error:
            raise BusError(errno.EIO, f"{error}; {self.bus.advice}") from error

    def _read(self, opcode: Opcode, size: int | None = None) -> bytes:
        size = size or OPCODES[opcode].size or 0
        data = self._transfer(partial(self.bus.read, opcode, size))
        if len(data) != size:
            what = f"{len(data)} bytes of {size} were received"
            raise BusError(errno.EIO, f"{what}; {self.bus.advice}")
        return data

    def _write(self, opcode: Opcode, data: bytes) -> None:
        self._transfer(partial(self.bus.write, opcode, data))

    def _transfer(self, transfer: Callable[[], T]) -> T:
        try:
            with self._using:
                return transfer()
        except OSError as error:  # those of pyftdi, too
            text = f"{_meaning(error)}; {self.bus.advice}"
            raise BusError(error.errno or errno.EIO, text) from error

    def _insist(self, transfer: Callable[[], T]) -> T:
        """Repeats a transfer until it succeeds.

        Raises:
            BusError: It failed for a second.
        """
        until = self._clock.now() + MAX_FAILURE
        while True:
            try:
                return transfer()
            except BusError:
                self._acquisition.count_bus(transfer_errors=1)
                if self._clock.now() >= until:
                    raise
            self._clock.pause(RETRY_PAUSE)


def _meaning(error: OSError) -> str:
    """Returns what an error of a transfer means."""
    if isinstance(error, BusError):
        return str(error)
    if error.errno in NACK or "NACK" in str(error):
        return "nothing answers at this address (no acknowledge)"
    if error.errno == errno.ETIMEDOUT:
        return "the transfer timed out: the clock was held low for too long"
    return f"the transfer failed: {error.strerror or error}"


def _split(data: bytes) -> list[bytes]:
    """Returns the frames that bytes consist of.

    Raises:
        ValueError: There are other bytes.
    """
    found = _core.RequestScanner(MAX_PAYLOAD).feed(data, True)
    frames = [_core.encode_frame(frame.bid, frame.mid, frame.payload) for frame in found]
    if not frames or b"".join(frames) != data:
        raise ValueError(
            f"I²C and SPI carry whole messages, and {data.hex(' ').upper()} is not one; nothing was sent"
        )
    return frames
