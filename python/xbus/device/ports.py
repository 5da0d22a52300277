"""Serial ports that a device may be behind."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from serial.tools import list_ports

__all__ = ["Port", "find_ports", "is_usb_of_device", "latency_timer", "port_of", "serial_number_of"]

#: Where Linux has the timers of USB-serial adapters.
SYSFS = Path("/sys/bus/usb-serial/devices")
#: USB vendor identifier of Xsens.
XSENS = 0x2639
#: FTDI, and its product identifiers that are set aside for converters by Xsens.
FTDI, XSENS_CONVERTERS = 0x0403, range(0xD388, 0xD390)


class Port(NamedTuple):
    """A serial port.

    Attributes:
        device: Its name, as `connect` takes it.
        description: What the system calls it.
        likely: Whether its USB identifiers say Xsens.
        serial_number: Serial number of the USB device, or None.
    """

    device: str
    description: str
    likely: bool
    serial_number: str | None


def find_ports() -> list[Port]:
    """The serial ports of this machine, those that say Xsens first.

    A development kit or a converter of another make says nothing about what is behind it.
    """
    found = [
        Port(it.device, it.description, _likely(it.vid, it.pid), it.serial_number)
        for it in list_ports.comports()
    ]
    return sorted(found, key=lambda it: (not it.likely, it.device))


def is_usb_of_device(name: str) -> bool:
    """Whether a port is the USB port of a device itself, where baud rates mean nothing."""
    return any(it.device == name and it.vid == XSENS for it in list_ports.comports())


def serial_number_of(name: str) -> str | None:
    """The serial number of the USB device behind a port; None where there is none."""
    return next((it.serial_number for it in list_ports.comports() if it.device == name), None)


def port_of(serial_number: str | None) -> str | None:
    """The port behind which a USB device with this serial number is, or None."""
    if serial_number is None:
        return None
    found = (it.device for it in list_ports.comports() if it.serial_number == serial_number)
    return next(found, None)


def latency_timer(name: str) -> int | None:
    """After how many ms an FTDI adapter hands over what it has; None where Linux does not tell."""
    try:
        return int((SYSFS / Path(name).resolve().name / "latency_timer").read_text())
    except (OSError, ValueError):
        return None


def _likely(vendor: int | None, product: int | None) -> bool:
    return vendor == XSENS or (vendor == FTDI and product in XSENS_CONVERTERS)
