"""Links to a device: a serial port, what else pyserial opens, or a virtual device in this process."""

from __future__ import annotations

import contextlib
import os
import threading
import time
import weakref
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

import serial

from xbus import _core
from xbus.device.ports import (
    BUS_SCHEMES,
    SYSFS,
    is_usb_of_device,
    latency_timer,
    port_of,
    serial_number_of,
)
from xbus.wire.link import Link, Need

if TYPE_CHECKING:
    from xbus.can.link import CanLink
    from xbus.mtssp.bus import Bus
    from xbus.sim.buses import SimI2c, SimSpi
    from xbus.sim.device import SimulatedDevice

__all__ = ["CAN_SCHEME", "SerialLink", "check_bid", "open_can", "open_link"]

#: Maximum bytes of a read from a port without a file descriptor, and seconds to wait for the first byte.
MAX_READ, READ_TIMEOUT = 1 << 12, 0.05
#: Seconds within which the thread of such a port ends after the port was closed.
JOIN_TIMEOUT = 1.0
#: Default bytes that wait to be read at most: a minute at 4 Mbaud.
QUEUE_BYTES = 24_000_000
#: What the address of a CAN bus begins with.
CAN_SCHEME = "can:"
#: Lowest latency timer of an FTDI adapter, in ms; its default is 16.
MIN_LATENCY = 1


class SerialLink:
    """A port of pyserial, which opens, configures and writes it. A native thread reads.

    Args:
        port: An open or closed port. `close` closes it only if ``owned``.
        owned: Whether it was opened for this link.
        bid: Bus identifier of the device whose frames are handed out; 0xFF for all.
        bound: Maximum number of bytes of samples that wait to be read.
        strings: Strings to look for: see `_core.Scanner`.

    Attributes:
        acquisition: Receives the bytes, and queues what is in them.
    """

    refusal = None

    def __init__(
        self,
        port: Any,
        *,
        owned: bool,
        bid: int = 0xFF,
        bound: int = QUEUE_BYTES,
        strings: int = 0,
    ) -> None:
        self._port = port
        self._bid, self._bound, self._strings = bid, bound, strings
        self._owned = owned
        #: Held while the port is closed: pyserial closes its descriptor twice if two threads do that.
        self._closing = threading.Lock()
        self.name = str(port.port or port.name)
        # The rate of a port behind a URL is not known.
        self.is_line = "://" not in self.name and not is_usb_of_device(self.name)
        if not port.is_open:
            port.open()
        self._serial_number = serial_number_of(self.name)
        # A driver without this mode raises one of several exceptions.
        with contextlib.suppress(AttributeError, NotImplementedError, OSError, ValueError):
            port.set_low_latency_mode(True)
        self._begin()

    @property
    def trouble(self) -> str | None:
        """A problem of the port, with its remedy; None if none is known."""
        timer = latency_timer(self.name)
        if timer is None or timer <= MIN_LATENCY:
            return None
        return (
            f"the adapter of {self.name} holds bytes back for {timer} ms, so samples arrive in bursts; run:"
            f" echo 1 | sudo tee {SYSFS / Path(self.name).resolve().name}/latency_timer"
        )

    def _begin(self) -> None:
        number = _descriptor(self._port)
        self.acquisition = _core.Acquisition(
            number, bid=self._bid, bound=self._bound, strings=self._strings
        )
        self._pump = _pump(self._port, self.acquisition) if number is None else None
        # A link that is dropped without `close` does not keep port and threads: neither refers to it.
        self._finalizer = weakref.finalize(self, _close, self._port, self.acquisition, self._owned)

    def restart(self) -> None:
        """Begins a new acquisition."""
        self._finalizer.detach()
        self.acquisition.close()
        self._begin()

    @property
    def baudrate(self) -> int | None:
        """Bits per second."""
        return int(self._port.baudrate)

    @baudrate.setter
    def baudrate(self, rate: int | None) -> None:
        if rate != self._port.baudrate:
            self._port.baudrate = rate
            # The rest of an incomplete frame will not come at the other rate.
            self.acquisition.interrupt()

    def wait(self, timeout: float, **need: Unpack[Need]) -> bool:
        """Waits up to ``timeout`` seconds: see `_core.Acquisition.wait`."""
        return self.acquisition.wait(timeout, **need)

    def write(self, data: bytes) -> None:
        """Sends bytes."""
        try:
            self._port.write(data)
        except (AttributeError, TypeError, ValueError) as error:
            # pyserial uses a descriptor that is gone if another thread closes the port meanwhile.
            if self.acquisition.ended is None:
                raise
            raise ConnectionResetError(f"{self.name} was closed") from error

    def clock(self) -> float:
        """Returns the time in seconds on the clock of arrivals."""
        return time.monotonic()

    def pause(self, seconds: float) -> None:
        """Waits."""
        time.sleep(seconds)

    def reopen(self) -> None:
        """Opens the port again. Queue, counts and recording continue."""
        self.acquisition.end("the port is opened again")
        with self._closing:
            self._port.close()
        if self._pump is not None:
            self._pump.join(JOIN_TIMEOUT)
        try:
            self._port.open()
        except OSError:
            # The port may have another name after it was plugged in again.
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
        """Closes the port if it was opened for this link."""
        with self._closing:
            _close(self._port, self.acquisition, self._owned)
        self._finalizer.detach()

    def abandon(self) -> None:
        """Gives up the port without a trace, in a forked process: it belongs to the parent."""
        self._finalizer.detach()
        # Closing a socket or an RFC 2217 port would end the connection of the parent.
        self._port.is_open = False


def _close(port: Any, acquisition: _core.Acquisition, owned: bool) -> None:
    acquisition.close()
    if owned:
        port.close()


def _descriptor(port: Any) -> int | None:
    """Returns the file descriptor of a port; None for a URL, and on systems without."""
    if os.name != "posix" or "://" in str(port.port):
        return None
    try:
        return int(port.fileno())
    except (AttributeError, OSError):
        return None


def _pump(port: Any, acquisition: _core.Acquisition) -> threading.Thread:
    """Starts a thread that reads a port without a file descriptor, until the port or the acquisition ends."""

    def pump() -> None:
        try:
            while acquisition.ended is None:
                port.timeout = READ_TIMEOUT
                data = port.read(1)
                # pyserial reports only whether a socket has bytes, and not how many.
                port.timeout = 0
                acquisition.push(data + port.read(MAX_READ) if data else b"")
        except Exception as error:  # of any kind of port
            acquisition.end(str(error))

    thread = threading.Thread(target=pump, name=f"xbus {port.port}", daemon=True)
    thread.start()
    return thread


def check_bid(bid: int) -> None:
    """Raises ValueError if a device cannot have a bus identifier."""
    if not (1 <= bid <= 31 or bid == 0xFF):
        raise ValueError(f"a device has the bus identifier 0xFF or 1 to 31, not {bid}")


def open_can(
    port: str, bitrate: int | None = None, *, bid: int = 0xFF, bound: int = QUEUE_BYTES
) -> CanLink:
    """Returns a link to the devices on a CAN bus: ``can:INTERFACE:CHANNEL``.

    Args:
        port: The address, as for `connect`.
        bitrate: Bits per second, if the address has none.
        bid: As for `SerialLink`.
        bound: As for `SerialLink`.

    Raises:
        ImportError: The extra ``can`` is not installed.
        OSError: The bus cannot be opened.
        ValueError: The address is not valid.
    """
    from xbus.can.address import parse_address
    from xbus.can.link import CanLink

    return CanLink(parse_address(port, bitrate), bid=bid, bound=bound)


def open_link(
    port: str | serial.SerialBase | SimulatedDevice | SimI2c | SimSpi | Bus,
    baudrate: int,
    *,
    bid: int = 0xFF,
    bound: int = QUEUE_BYTES,
    strings: int = 0,
) -> Link:
    """Returns a link to a port: a name or an object, as `connect` takes them.

    Args:
        port: The port.
        baudrate: Bits per second, for a port that is opened here.
        bid: As for `SerialLink`.
        bound: As for `SerialLink`.
        strings: As for `SerialLink`.

    Raises:
        OSError: The port cannot be opened.
        ValueError: There is no such virtual product, or no such bus identifier.
        ImportError: The extra for this port is not installed.
    """
    check_bid(bid)
    if isinstance(port, serial.SerialBase):
        return SerialLink(port, owned=False, bid=bid, bound=bound, strings=strings)
    if isinstance(port, str) and port.startswith(CAN_SCHEME):
        return open_can(port, bid=bid, bound=bound)
    if isinstance(port, str) and port.partition(":")[0] in BUS_SCHEMES:
        from xbus.device.bus_port import open_bus_port  # not needed for serial ports

        return open_bus_port(port, bid=bid, bound=bound)
    if not isinstance(port, str) or port.startswith("sim:"):
        return _open_object(port, bid=bid, bound=bound, strings=strings)
    opened: Any = serial.serial_for_url(port, do_not_open=True, baudrate=baudrate, write_timeout=5)
    if "://" not in port:
        opened.exclusive = True
    return SerialLink(opened, owned=True, bid=bid, bound=bound, strings=strings)


def _open_object(
    port: str | SimulatedDevice | SimI2c | SimSpi | Bus, *, bid: int, bound: int, strings: int
) -> Link:
    """Returns a link to a virtual device, or to a bus that the caller has opened."""
    # not needed for real devices at serial ports
    from xbus.device.bus_link import BusLink
    from xbus.sim.bus_link import BusSimLink, bus_of, host_bus
    from xbus.sim.buses import SimI2c, SimSpi
    from xbus.sim.device import SimulatedDevice
    from xbus.sim.link import SimLink
    from xbus.sim.options import device_of

    if isinstance(port, str):
        port = bus_of(port) or device_of(port)
    if isinstance(port, SimulatedDevice):
        return SimLink(port, bid=bid, bound=bound, strings=strings)
    if isinstance(port, SimI2c | SimSpi):
        if not port.is_live:
            return BusSimLink(port, bid=bid, bound=bound)
        port = host_bus(port)
    bus = port
    return BusLink(lambda: bus, bus.name, owned=False, bid=bid, bound=bound)
