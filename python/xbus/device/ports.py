"""The serial ports of this machine."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from serial.tools import list_ports

__all__ = [
    "BUS_SCHEMES",
    "SYSFS",
    "Port",
    "find_ports",
    "is_usb_of_device",
    "is_xsens",
    "latency_timer",
    "port_of",
    "serial_number_of",
]

#: How the names of ports on I²C and SPI begin.
BUS_SCHEMES = ("i2c", "spi", "ftdi-i2c", "ftdi-spi")
#: Where Linux has the latency timers of USB-serial adapters.
SYSFS = Path("/sys/bus/usb-serial/devices")
#: USB vendor identifier of Xsens.
XSENS = 0x2639
#: FTDI, and its product identifiers for converters by Xsens.
FTDI, XSENS_CONVERTERS = 0x0403, range(0xD388, 0xD390)


class Port(NamedTuple):
    """A serial port.

    Attributes:
        device: Name, as `connect` takes it.
        description: Description by the system.
        likely: Whether the USB identifiers are those of Xsens.
        serial_number: Serial number of the USB device, or None.
    """

    device: str
    description: str
    likely: bool
    serial_number: str | None


def find_ports() -> list[Port]:
    """Returns the serial ports of this machine, those with USB identifiers of Xsens first.

    A development kit or a converter of another make does not identify the device behind it.

    >>> import xbus
    >>> ports = [port.device for port in xbus.find_ports() if port.likely]  # ['/dev/ttyUSB0']
    """
    found = [
        Port(port.device, port.description, is_xsens(port.vid, port.pid), port.serial_number)
        for port in list_ports.comports()
    ]
    return sorted(found, key=lambda port: (not port.likely, port.device))


def is_usb_of_device(name: str) -> bool:
    """Returns whether a port is the USB port of a device itself, which has no baud rate."""
    return any(port.device == name and port.vid == XSENS for port in list_ports.comports())


def serial_number_of(name: str) -> str | None:
    """Returns the serial number of the USB device of a port, or None."""
    ports = list_ports.comports()
    return next((port.serial_number for port in ports if port.device == name), None)


def port_of(serial_number: str | None) -> str | None:
    """Returns the port of the USB device with a serial number, or None."""
    if serial_number is None:
        return None
    found = (port.device for port in list_ports.comports() if port.serial_number == serial_number)
    return next(found, None)


def latency_timer(name: str, sysfs: Path | None = None) -> int | None:
    """Returns the latency timer of an FTDI adapter in ms; None if the system does not report it."""
    try:
        return int(((sysfs or SYSFS) / Path(name).resolve().name / "latency_timer").read_text())
    except (OSError, ValueError):
        return None


def is_xsens(vendor: int | None, product: int | None) -> bool:
    """Returns whether USB identifiers are those of Xsens, or of a converter that FTDI made for Xsens."""
    return vendor == XSENS or (vendor == FTDI and product in XSENS_CONVERTERS)
