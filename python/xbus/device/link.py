"""What carries the bytes: a port, anything that pyserial opens, or a virtual device in this process."""

from __future__ import annotations

import contextlib
import os
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import serial

from xbus import _core
from xbus.device.ports import SYSFS, is_usb_of_device, latency_timer, port_of, serial_number_of
from xbus.wire.link import Link, Received

if TYPE_CHECKING:
    from xbus.sim.device import SimulatedDevice

__all__ = ["SerialLink", "open_link"]

#: Bytes to read at a time from what has no descriptor, and seconds to wait for the first of them.
PIECE, PUMP_TIMEOUT = 1 << 12, 0.05
#: Seconds within which such a thread hears that its port was closed.
LONGEST_READ = 1.0
#: Most bytes that wait to be read, unless told otherwise: a minute at 4 Mbaud.
QUEUE = 24_000_000
#: The timer of an FTDI adapter at its fastest, in ms; it comes with 16.
FAST_TIMER = 1


class SerialLink:
    """A port of pyserial, which opens it, sets it up and writes; a thread without the interpreter reads.

    Args:
        port: An open or closed port. It is closed by `close` only if ``owned``.
        owned: Whether it was opened for this link.
        bound: Most bytes that wait to be read.
        strings: Strings to look for: see `_core.Scanner`.

    Attributes:
        acquisition: What takes in the bytes that come.
    """

    def __init__(self, port: Any, *, owned: bool, bound: int = QUEUE, strings: int = 0) -> None:
        self._port = port
        self._bound, self._strings = bound, strings
        self._owned = owned
        self.name = str(port.port or port.name)
        # Where a URL leads, what the rate is there is not known.
        self.is_line = "://" not in self.name and not is_usb_of_device(self.name)
        if not port.is_open:
            port.open()
        self._serial_number = serial_number_of(self.name)
        # Where the driver has no such mode it says so, in several ways.
        with contextlib.suppress(AttributeError, NotImplementedError, OSError, ValueError):
            port.set_low_latency_mode(True)
        self._begin()

    @property
    def trouble(self) -> str | None:
        """What is wrong with the port, and the cure; None if nothing is known to be."""
        timer = latency_timer(self.name)
        if timer is None or timer <= FAST_TIMER:
            return None
        return (
            f"the adapter of {self.name} keeps bytes back for {timer} ms: samples come in bursts; cure:"
            f" echo 1 | sudo tee {SYSFS / Path(self.name).resolve().name}/latency_timer"
        )

    def _begin(self) -> None:
        number = _descriptor(self._port)
        self.acquisition = _core.Acquisition(number, bound=self._bound, strings=self._strings)
        self._pump = _pump(self._port, self.acquisition) if number is None else None

    @property
    def epoch(self) -> int:
        """What to add to an arrival, in ns, for the time since 1970."""
        return self.acquisition.epoch

    @property
    def baudrate(self) -> int:
        """Bits per second."""
        return int(self._port.baudrate)

    @baudrate.setter
    def baudrate(self, rate: int) -> None:
        if rate == self._port.baudrate:
            return
        self._port.baudrate = rate
        if self.acquisition.recording is None:
            # What was noise at the other rate shall not be counted.
            self.acquisition.close()
            self._begin()

    def read(self, timeout: float) -> Received:
        """What has come."""
        taken = self.acquisition.read(timeout)
        if taken is None:
            raise ConnectionResetError(self.acquisition.ended)
        return Received(taken.data, taken.ends.tolist(), (taken.arrivals / 1e9).tolist())

    def write(self, data: bytes) -> None:
        """Sends."""
        self._port.write(data)

    def clock(self) -> float:
        """Seconds."""
        return time.monotonic()

    def pause(self, seconds: float) -> None:
        """Lets time pass."""
        time.sleep(seconds)

    def reopen(self) -> None:
        """Opens the port again; queue, counts and recording go on."""
        self.acquisition.end("the port is opened again")
        self._port.close()
        if self._pump is not None:
            self._pump.join(LONGEST_READ)
        try:
            self._port.open()
        except OSError:
            # Plugged in again it may have another name.
            if (name := port_of(self._serial_number)) is None:
                raise
            self._port.port = self.name = name
        number = _descriptor(self._port)
        if number is None:
            self.acquisition.resume()
            self._pump = _pump(self._port, self.acquisition)
        else:
            self.acquisition.open(number)

    def close(self) -> None:
        """Closes the port, or gives it back open."""
        self.acquisition.close()
        if self._owned:
            self._port.close()


def _descriptor(port: Any) -> int | None:
    """The descriptor of a port; None for a URL, and where ports have none."""
    if os.name != "posix" or "://" in str(port.port):
        return None
    try:
        return int(port.fileno())
    except (AttributeError, OSError):
        return None


def _pump(port: Any, acquisition: _core.Acquisition) -> threading.Thread:
    """Reads a port that has no descriptor in a thread of its own, until it or the acquisition ends."""

    def pump() -> None:
        try:
            while acquisition.ended is None:
                port.timeout = PUMP_TIMEOUT
                data = port.read(1)
                # A socket of pyserial knows only whether bytes wait, and not how many.
                port.timeout = 0
                acquisition.push(data + port.read(PIECE) if data else b"")
        except Exception as error:  # of any kind of port
            acquisition.end(str(error))

    thread = threading.Thread(target=pump, name=f"xbus {port.port}", daemon=True)
    thread.start()
    return thread


def open_link(
    port: str | serial.SerialBase | SimulatedDevice,
    baudrate: int,
    bound: int = QUEUE,
    strings: int = 0,
) -> Link:
    """A link to a port: a name, a pyserial URL, a pyserial object, ``"sim:PRODUCT"`` or a virtual device.

    Raises:
        OSError: The port cannot be opened.
        ValueError: No such virtual product.
    """
    if isinstance(port, serial.SerialBase):
        return SerialLink(port, owned=False, bound=bound, strings=strings)
    if not isinstance(port, str) or port.startswith("sim:"):
        from xbus.sim.link import SimLink  # whoever has a real device need not wait for it

        return SimLink(port, strings)
    made: Any = serial.serial_for_url(port, do_not_open=True, baudrate=baudrate, write_timeout=5)
    if "://" not in port:
        made.exclusive = True
    return SerialLink(made, owned=True, bound=bound, strings=strings)
