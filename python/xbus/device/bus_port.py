"""Ports on I²C and SPI by name: ``i2c:/dev/i2c-1@0x6b``, ``spi:/dev/spidev0.0``; and on FTDI adapters."""

from __future__ import annotations

import contextlib
import errno
import math
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple
from urllib.parse import parse_qsl

from xbus.device.bus_link import POLL_SECONDS, BusLink
from xbus.device.pins import GpioDataReady, GpioReset
from xbus.errors import BusError
from xbus.extras import require
from xbus.mtssp.bus import (
    Bus,
    FtdiI2cBus,
    FtdiSpiBus,
    I2cBus,
    SpiBus,
    check_address,
    check_speed,
)
from xbus.protocol.mtssp import DEFAULT_ADDRESS, MAX_I2C_HZ, MAX_SPI_HZ

__all__ = ["BusPort", "open_bus_port", "parse_bus_port"]

#: Default clock in Hz of SPI, and of I²C on an FTDI adapter.
SPI_SPEED, FTDI_I2C_SPEED = 1_000_000, 400_000
#: The options of a port by its scheme.
PIN_OPTIONS = ("drdy", "reset", "chip")
OPTIONS: dict[str, tuple[str, ...]] = {
    "i2c": (*PIN_OPTIONS, "poll"),
    "spi": ("speed", *PIN_OPTIONS, "poll"),
    "ftdi-i2c": ("speed", "poll"),
    "ftdi-spi": ("speed", "cs", "poll"),
}
#: Limits of the seconds between two looks at the pipes.
POLL_LIMITS = (1e-4, 1.0)
#: The chip selects of an FTDI adapter.
MAX_CS_COUNT = 5
#: Why a bus cannot be opened, by error number.
CAUSES = {
    errno.ENOENT: "there is no such bus; switch it on, on a Raspberry Pi with raspi-config",
    errno.EACCES: "permission denied; become a member of the group {group}: sudo usermod -aG {group} $USER,"
    " and log in again",
    errno.EPERM: "permission denied; become a member of the group {group}",
    errno.EBUSY: "it is in use; close the program that uses it",
}


class BusPort(NamedTuple):
    """What the name of a port on a bus says.

    Attributes:
        scheme: ``i2c``, ``spi``, ``ftdi-i2c`` or ``ftdi-spi``.
        bus: Path of the bus, or URL of the adapter.
        address: I²C address.
        speed: Clock in Hz; None where the system sets it.
        cs: Chip select of an adapter.
        poll: Seconds between two looks at empty pipes.
        drdy: Number or name of the GPIO line at DRDY, or None.
        reset: The same at nRST.
        chip: Path of the GPIO chip.
    """

    scheme: str
    bus: str
    address: int = DEFAULT_ADDRESS
    speed: int | None = None
    cs: int = 0
    poll: float = POLL_SECONDS
    drdy: str | None = None
    reset: str | None = None
    chip: str = "/dev/gpiochip0"


def parse_bus_port(name: str) -> BusPort:
    """Returns what the name of a port says: ``SCHEME:BUS[@ADDRESS][?OPTION=VALUE&...]``.

    Raises:
        ValueError: An unknown option, or a value that is not valid.

    >>> parse_bus_port("i2c:/dev/i2c-1@0x1d?drdy=24").address
    29
    """
    place, _, query = name.partition("?")
    scheme, _, bus = place.partition(":")
    found: dict[str, Any] = {"scheme": scheme}
    if scheme.endswith("i2c"):
        bus, at, address = bus.partition("@")
        if at:
            found["address"] = check_address(_number("the address", address))
    if not bus:
        raise ValueError(f"{name} names no bus; use {_EXAMPLES[scheme]}")
    found["bus"] = f"{_PREFIXES[scheme]}{bus}" if bus[0].isdigit() else bus
    options = OPTIONS[scheme]
    for option, text in parse_qsl(query, keep_blank_values=True):
        if option not in options:
            more = _WHY_NOT.get((scheme, option), "")
            raise ValueError(
                f"{scheme}: has no option {option}{more}; its options are {', '.join(options)}"
            )
        if option in found:
            raise ValueError(f"the option {option} is given twice")
        found[option] = _PARSERS[option](option, text)
    if scheme != "i2c":
        highest = MAX_I2C_HZ if scheme == "ftdi-i2c" else MAX_SPI_HZ
        default = FTDI_I2C_SPEED if scheme == "ftdi-i2c" else SPI_SPEED
        found["speed"] = check_speed(found.get("speed", default), highest)
    if "chip" in found and not {"drdy", "reset"} & set(found):
        raise ValueError("the option chip is for drdy and reset")
    return BusPort(**found)


def _number(name: str, text: str) -> int:
    try:
        return int(text, 0)
    except ValueError:
        raise ValueError(f"{name} must be a whole number, not {text!r}") from None


def _cs(name: str, text: str) -> int:
    number = _number(name, text)
    if not 0 <= number < MAX_CS_COUNT:
        raise ValueError(f"{name} must be from 0 to {MAX_CS_COUNT - 1}, not {number}")
    return number


def _poll(name: str, text: str) -> float:
    low, high = POLL_LIMITS
    try:
        seconds = float(text)
    except ValueError:
        seconds = math.nan
    if not low <= seconds <= high:
        raise ValueError(f"{name} must be from {low:g} to {high:g} seconds, not {text!r}")
    return seconds


def _text(name: str, text: str) -> str:
    if not text:
        raise ValueError(f"{name} is empty")
    return text


_PARSERS: dict[str, Callable[[str, str], Any]] = {
    "speed": _number,
    "cs": _cs,
    "poll": _poll,
    "drdy": _text,
    "reset": _text,
    "chip": _text,
}
#: Of a bus that is given as a number, by scheme.
_PREFIXES = {"i2c": "/dev/i2c-", "spi": "/dev/spidev", "ftdi-i2c": "", "ftdi-spi": ""}
_EXAMPLES = {
    "i2c": "i2c:/dev/i2c-1@0x6b",
    "spi": "spi:/dev/spidev0.0",
    "ftdi-i2c": "ftdi-i2c:ftdi://ftdi:232h/1@0x6b",
    "ftdi-spi": "ftdi-spi:ftdi://ftdi:232h/1",
}
_WHY_NOT = {
    (
        "i2c",
        "speed",
    ): ": Linux sets the clock of I²C, on a Raspberry Pi with dtparam=i2c_arm_baudrate=400000 in"
    " config.txt",
}


def open_bus_port(name: str, *, bid: int, bound: int) -> BusLink:
    """Opens a port on a bus: see `parse_bus_port` and `BusLink`.

    Raises:
        BusError: The bus or a pin cannot be opened, or no device answers.
        ImportError: The extra is not installed.
        ValueError: The name is not valid.
    """
    port = parse_bus_port(name)
    with contextlib.ExitStack() as pins:
        drdy = reset = None
        if port.drdy is not None:
            drdy = pins.enter_context(contextlib.closing(GpioDataReady(port.chip, port.drdy)))
        if port.reset is not None:
            reset = pins.enter_context(contextlib.closing(GpioReset(port.chip, port.reset)))
        link = BusLink(
            lambda: _OPENERS[port.scheme](port, name),
            name,
            data_ready=drdy,
            reset=reset,
            poll=port.poll,
            bid=bid,
            bound=bound,
        )
        pins.pop_all()  # the link closes them
    return link


def _open_i2c(port: BusPort, name: str) -> Bus:
    smbus2 = require("smbus2", "i2c", "to use I²C")
    with _opening(group="i2c"):
        bus = smbus2.SMBus(port.bus)
    if not bus.funcs & smbus2.smbus2.I2cFunc.I2C:
        bus.close()
        raise BusError(
            errno.EOPNOTSUPP, "the adapter has SMBus only; MTSSP needs plain I²C transfers"
        )
    return I2cBus(bus, port.address, name=name)


def _open_spi(port: BusPort, name: str) -> Bus:
    spidev = require("spidev", "spi", "to use SPI")
    spi = spidev.SpiDev()
    with _opening(group="spi"):
        spi.open_path(port.bus)
    try:
        with _opening(group="spi"):
            return SpiBus(spi, port.speed or SPI_SPEED, name=name)
    except BaseException:
        spi.close()
        raise


def _open_ftdi_i2c(port: BusPort, name: str) -> Bus:
    controller = require("pyftdi.i2c", "ftdi", "to use FTDI adapters").I2cController()
    with _opening_adapter():
        controller.configure(port.bus, frequency=port.speed, clockstretching=True)
    return FtdiI2cBus(controller, port.address, name=name)


def _open_ftdi_spi(port: BusPort, name: str) -> Bus:
    controller = require("pyftdi.spi", "ftdi", "to use FTDI adapters").SpiController(
        cs_count=port.cs + 1
    )
    with _opening_adapter():
        controller.configure(port.bus)
        return FtdiSpiBus(controller, port.cs, port.speed or SPI_SPEED, name=name)


_OPENERS: dict[str, Callable[[BusPort, str], Bus]] = {
    "i2c": _open_i2c,
    "spi": _open_spi,
    "ftdi-i2c": _open_ftdi_i2c,
    "ftdi-spi": _open_ftdi_spi,
}


@contextlib.contextmanager
def _opening(group: str) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        cause = CAUSES.get(error.errno or 0, "{error}").format(
            group=group, error=error.strerror or error
        )
        raise BusError(error.errno, cause) from error


@contextlib.contextmanager
def _opening_adapter() -> Iterator[None]:
    usbtools = require("pyftdi.usbtools", "ftdi", "to use FTDI adapters")
    try:
        yield
    except (OSError, usbtools.UsbToolsError, ValueError) as error:  # ValueError: no USB library
        raise BusError(
            errno.ENODEV,
            f"{error}; libusb must be installed; ftdi_urls.py lists the adapters; on Linux you need write"
            " access to the USB device",
        ) from error
