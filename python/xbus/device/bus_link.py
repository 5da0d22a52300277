"""The link to a device on I²C or SPI: a thread reads its pipes."""

from __future__ import annotations

import errno
import threading
import time
import weakref
from collections.abc import Callable
from typing import Protocol, Unpack

from xbus import _core
from xbus.errors import BusError
from xbus.mtssp.bus import Bus
from xbus.mtssp.host import Clock, Host
from xbus.protocol.mtssp import DEFAULT_DATA_READY
from xbus.wire.link import Need

__all__ = ["POLL_SECONDS", "BusLink", "DataReadyPin", "ResetPin"]

#: Default seconds between two looks at empty pipes, without the pin DRDY.
POLL_SECONDS = 0.002
#: Seconds between two looks at pipes that are empty according to the pin.
PIN_POLL_SECONDS = 0.1
#: Number of looks at pin and pipes before they disagree: a message may arrive between the two.
PIN_CHECKS = 5
#: Seconds within which the thread ends after the link was closed.
JOIN_TIMEOUT = 2.0


class DataReadyPin(Protocol):
    """An input that is connected to DRDY."""

    def is_active(self) -> bool:
        """Returns whether it is high."""

    def wait(self, timeout: float) -> None:
        """Waits until it becomes high, up to ``timeout`` seconds; also for a moment that has passed."""

    def close(self) -> None:
        """Releases the input."""


class ResetPin(Protocol):
    """An output that is connected to nRST."""

    def pulse(self) -> None:
        """Pulls it low for a moment."""

    def close(self) -> None:
        """Releases the output."""


class BusLink:
    """A device on I²C or SPI.

    Args:
        open_bus: Opens the bus.
        name: Name for messages to users.
        owned: Whether the link closes the bus.
        data_ready: The input at DRDY; None: the pipes are polled.
        reset: The output at nRST, used if the device does not answer; None if there is none.
        poll: Seconds between two looks at empty pipes, without ``data_ready``.
        bid: Bus identifier of the device whose frames are handed out; 0xFF for all.
        bound: Maximum number of bytes of samples that wait to be read.

    Attributes:
        acquisition: Receives the messages, and queues what is in them.

    Raises:
        BusError: The bus cannot be opened, or no device answers.
    """

    is_line = False
    trouble = None
    refusal = None

    def __init__(
        self,
        open_bus: Callable[[], Bus],
        name: str,
        *,
        owned: bool = True,
        data_ready: DataReadyPin | None = None,
        reset: ResetPin | None = None,
        poll: float = POLL_SECONDS,
        bid: int = 0xFF,
        bound: int = 24_000_000,
    ) -> None:
        self.name = name
        self._open_bus, self._pin, self._reset, self._poll = open_bus, data_ready, reset, poll
        self._owned, self._bid, self._bound = owned, bid, bound
        self._closing = threading.Lock()
        self._acquire()

    @property
    def baudrate(self) -> int | None:
        """None: a bus has no baud rate."""
        return None

    @baudrate.setter
    def baudrate(self, rate: int | None) -> None:
        if rate is not None:
            raise ValueError(f"{self.name} has no baud rate")

    def _acquire(self) -> None:
        self.acquisition = _core.Acquisition(None, bid=self._bid, bound=self._bound)
        self._start()

    def restart(self) -> None:
        """Begins a new acquisition."""
        self._stop()
        self.acquisition.close()
        self._acquire()

    def _start(self) -> None:
        try:
            bus = self._open_bus()
            try:
                drdy = None if self._pin is None else DEFAULT_DATA_READY
                host = Host(bus, self.acquisition, Clock(self.clock, self.pause), drdy)
                self._begin(host)
            except BaseException:
                if self._owned:
                    bus.close()
                raise
        except BusError as error:
            raise BusError(error.errno, f"cannot open {self.name}: {error}") from error
        if self.acquisition.ended is not None:
            self.acquisition.resume()
        self._host = host
        self._reader = _Reader(
            host, self.acquisition, self._pin, self._poll, bus.close if self._owned else None
        )
        self._thread = threading.Thread(
            target=self._reader.run, name=f"xbus {self.name}", daemon=True
        )
        self._thread.start()
        # A link that is dropped without `close` keeps neither bus nor thread: they do not refer to it.
        self._finalizer = weakref.finalize(self, _end, self._reader.stopped, self.acquisition)

    def _begin(self, host: Host) -> None:
        try:
            status = host.begin()
        except BusError:
            if self._reset is None:
                raise
            self._reset.pulse()
            status = host.begin()
        if self._pin is None:
            return
        for _ in range(PIN_CHECKS):
            is_active = self._pin.is_active()
            if is_active == any(status):
                return
            status = host.begin()
        level, pipes = ("high", "no message") if is_active else ("low", "messages")
        raise BusError(
            errno.EIO,
            f"DRDY is {level}, but the device has {pipes}; check wire and number of the line, or leave drdy"
            " out",
        )

    def _stop(self) -> None:
        self._finalizer.detach()
        self._reader.stopped.set()
        self._thread.join(JOIN_TIMEOUT)

    def wait(self, timeout: float, **need: Unpack[Need]) -> bool:
        """Waits up to ``timeout`` seconds: see `_core.Acquisition.wait`."""
        return self.acquisition.wait(timeout, **need)

    def write(self, data: bytes) -> None:
        """Sends frames."""
        if self.acquisition.ended is None:
            try:
                self._host.send(data)
            except TypeError:  # of smbus2, if another thread closes the bus meanwhile
                if self.acquisition.ended is None:
                    raise
            else:
                return
        raise ConnectionResetError(f"{self.name} was closed")

    @staticmethod
    def clock() -> float:
        """Returns the time in seconds on the clock of arrivals."""
        return time.monotonic()

    @staticmethod
    def pause(seconds: float) -> None:
        """Waits."""
        time.sleep(seconds)

    def reopen(self) -> None:
        """Opens the bus again. Queue, counts and recording continue.

        Raises:
            BusError: It cannot be opened, or the device does not answer, even after a reset.
        """
        self.acquisition.end("the bus is opened again")
        self._stop()
        self._start()

    def close(self) -> None:
        """Closes the bus, and releases the pins."""
        with self._closing:
            self.acquisition.close()
            self._stop()
            for pin in (self._pin, self._reset):
                if pin is not None:
                    pin.close()

    def abandon(self) -> None:
        """Gives up the bus without a trace, in a forked process, in which the thread does not run."""
        self._finalizer.detach()


class _Reader:
    """What the thread does: it reads the pipes until the link or the acquisition ends.

    Args:
        host: Reads the pipes.
        acquisition: The acquisition.
        pin: The input at DRDY, or None.
        poll: Seconds between two looks at empty pipes.
        close: Called at the end, or None.

    Attributes:
        stopped: Ends the thread.
    """

    def __init__(
        self,
        host: Host,
        acquisition: _core.Acquisition,
        pin: DataReadyPin | None,
        poll: float,
        close: Callable[[], None] | None,
    ) -> None:
        self._host, self._acquisition, self._pin, self._poll = host, acquisition, pin, poll
        self._close = close
        self.stopped = threading.Event()

    def run(self) -> None:
        """Reads the pipes, and closes the bus at the end."""
        try:
            while not self.stopped.is_set() and self._acquisition.ended is None:
                if not self._host.receive():
                    self._wait()
        except Exception as error:  # of any kind of bus
            self._acquisition.end(str(error))
        finally:
            if self._close is not None:
                self._close()

    def _wait(self) -> None:
        # A pin that is active though nothing was read: transfers fail, or a message has just arrived.
        if self._pin is None or self._pin.is_active():
            self.stopped.wait(self._poll)
        else:
            self._pin.wait(PIN_POLL_SECONDS)


def _end(stopped: threading.Event, acquisition: _core.Acquisition) -> None:
    stopped.set()
    acquisition.close()
