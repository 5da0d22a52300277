"""What carries the bytes: a port, anything that pyserial opens, or a virtual device in this process."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any, Protocol

import serial

from xbus.device.ports import is_usb_of_device

if TYPE_CHECKING:
    from xbus.sim.device import SimulatedDevice

__all__ = ["Link", "SerialLink", "open_link"]


class Link(Protocol):
    """Carries bytes both ways.

    Attributes:
        name: What the user calls it.
        baudrate: Bits per second; setting it changes the rate of this side.
        is_line: Whether the baud rate limits what can be carried, as on a serial line.
    """

    name: str
    baudrate: int
    is_line: bool

    def read(self, timeout: float) -> bytes:
        """What has come; waits for the first byte, but no longer than ``timeout`` seconds. Raises OSError."""

    def write(self, data: bytes) -> None:
        """Sends. Raises OSError."""

    def clock(self) -> float:
        """Seconds, from any beginning, as time-outs count them."""

    def pause(self, seconds: float) -> None:
        """Lets time pass."""

    def reopen(self) -> None:
        """Opens it again after it was lost. Raises OSError."""

    def close(self) -> None:
        """Closes it, if it was opened here."""


#: Bytes to read at a time from what is no serial line.
PIECE = 1 << 12


class SerialLink:
    """A port of pyserial.

    Args:
        port: An open or closed port. It is closed by `close` only if ``owned``.
        owned: Whether it was opened for this link.
    """

    def __init__(self, port: Any, *, owned: bool) -> None:
        self._port = port
        self._owned = owned
        self._timeout = port.timeout
        self.name = str(port.port or port.name)
        self._is_url = "://" in self.name
        # Where a URL leads, what the rate is there is not known.
        self.is_line = not self._is_url and not is_usb_of_device(self.name)
        if not port.is_open:
            port.open()

    @property
    def baudrate(self) -> int:
        """Bits per second."""
        return int(self._port.baudrate)

    @baudrate.setter
    def baudrate(self, rate: int) -> None:
        self._port.baudrate = rate

    def read(self, timeout: float) -> bytes:
        """What has come."""
        self._set_timeout(timeout)
        first = self._port.read(1)
        if not first:
            return b""
        if not self._is_url:
            return bytes(first + self._port.read(self._port.in_waiting))
        # A socket of pyserial knows only whether bytes wait, and not how many.
        self._set_timeout(0)
        return bytes(first + self._port.read(PIECE))

    def _set_timeout(self, timeout: float) -> None:
        if self._port.timeout != timeout:  # pyserial sets the whole port up again
            self._port.timeout = timeout

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
        """Opens the port again."""
        self._port.close()
        self._port.open()

    def close(self) -> None:
        """Closes the port, or gives it back as it was."""
        if self._owned:
            self._port.close()
        else:
            self._port.timeout = self._timeout


def open_link(port: str | serial.SerialBase | SimulatedDevice, baudrate: int) -> Link:
    """A link to a port: a name, a pyserial URL, a pyserial object, ``"sim:PRODUCT"`` or a virtual device.

    Raises:
        OSError: The port cannot be opened.
        ValueError: No such virtual product.
    """
    if isinstance(port, serial.SerialBase):
        return SerialLink(port, owned=False)
    if not isinstance(port, str) or port.startswith("sim:"):
        from xbus.sim.link import SimLink  # whoever has a real device need not wait for it

        return SimLink(port)
    made: Any = serial.serial_for_url(port, do_not_open=True, baudrate=baudrate, write_timeout=5)
    if "://" not in port:
        made.exclusive = True
    return SerialLink(made, owned=True)
