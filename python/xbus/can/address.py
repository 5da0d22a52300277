"""Addresses of CAN buses: ``can:INTERFACE:CHANNEL?OPTIONS``."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import parse_qsl, unquote

from xbus.can.ids import DeviceIds, device_ids, parse_ids
from xbus.can.read import check_rate
from xbus.errors import BusError
from xbus.extras import require

__all__ = ["DEFAULT_BITRATE", "SCHEME", "CanAddress", "open_bus", "parse_address"]

SCHEME = "can:"
#: Bits per second of a new MTi-600.
DEFAULT_BITRATE = 250_000
#: Interfaces whose bit rate is set elsewhere, or that have none.
WITHOUT_BITRATE = ("socketcan", "socketcand", "udp_multicast", "virtual")
EXAMPLE = "can:socketcan:can0 or can:pcan:PCAN_USBBUS1?bitrate=250000"


@dataclass(frozen=True)
class CanAddress:
    """Where a CAN bus is, and which devices are on it.

    Attributes:
        name: The address without options.
        interface: Interface of python-can.
        channel: Its channel.
        bitrate: Bits per second.
        ids: Identifiers of the devices, as in `xbus.read_can`; None for one with the default ones.
        rate: Groups per second of devices that send no SampleTime, or None.
        options: More options for python-can.
    """

    name: str
    interface: str
    channel: str
    bitrate: int = DEFAULT_BITRATE
    ids: list[DeviceIds] | None = None
    rate: float | None = None
    options: dict[str, Any] = field(default_factory=dict)


def parse_address(text: str, bitrate: int | None = None) -> CanAddress:
    """Returns the parts of an address.

    Args:
        text: ``can:INTERFACE:CHANNEL``, then ``?bitrate=500000``, ``&ids=0x100`` for each device,
            ``&rate=100`` for devices without SampleTime, and options of python-can.
        bitrate: Bits per second, if the address has none.

    Raises:
        ValueError: A part is missing, a number is out of range, or identifiers are used twice.

    >>> address = parse_address("can:socketcan:can0?ids=0x100&ids=0x200&bitrate=500000")
    >>> address.channel, address.bitrate, address.ids
    ('can0', 500000, [256, 512])
    """
    place, _, query = text.removeprefix(SCHEME).partition("?")
    interface, _, channel = place.partition(":")
    if not interface or not channel:
        raise ValueError(f"{text!r} is no address of a CAN bus; write {EXAMPLE}")
    ids: list[DeviceIds] = []
    options: dict[str, Any] = {}
    rate = None
    try:
        for name, value in parse_qsl(query, keep_blank_values=True, strict_parsing=bool(query)):
            if name == "ids":
                ids.append(parse_ids(value))
            elif name == "rate":
                rate = float(value)
            elif name == "bitrate":
                bitrate = int(value)
            else:
                options[name] = _option(value)
        check_rate(rate)
        device_ids(ids or None)
    except ValueError as error:
        raise ValueError(f"{text!r}: {error}") from error
    if bitrate is not None and bitrate < 1:
        raise ValueError(f"{text!r}: a bit rate is a positive number, not {bitrate}")
    name = f"{SCHEME}{interface}:{unquote(channel)}"
    return CanAddress(
        name, interface, unquote(channel), bitrate or DEFAULT_BITRATE, ids or None, rate, options
    )


def _option(value: str) -> bool | int | float | str:
    """Returns a value as python-can's options have it."""
    if value.lower() in ("true", "false"):
        return value.lower() == "true"
    for kind in (lambda text: int(text, 0), float):
        with contextlib.suppress(ValueError):
            return kind(value)
    return value


def open_bus(address: CanAddress, **options: Any) -> Any:
    """Returns an open bus of python-can.

    Args:
        address: Where it is.
        options: More options for python-can.

    Raises:
        ImportError: The extra ``can`` is not installed.
        BusError: The bus cannot be opened.
        ValueError: There is no such interface, or it does not know an option.
    """
    can = require("can", "can", "to use a CAN bus")
    with opening(address):
        if address.interface not in can.VALID_INTERFACES:
            names = ", ".join(sorted(can.VALID_INTERFACES))
            raise ValueError(
                f"{address.name}: python-can has no interface {address.interface!r}; it has {names}"
            )
        known = {} if address.interface in WITHOUT_BITRATE else {"bitrate": address.bitrate}
        return can.Bus(
            interface=address.interface,
            channel=address.channel,
            ignore_config=True,
            **known | address.options | options,
        )


@contextlib.contextmanager
def opening(address: CanAddress) -> Iterator[None]:
    """Makes a BusError of the errors that the libraries of interfaces raise."""
    try:
        yield
    except (ValueError, MemoryError):
        raise
    except Exception as error:  # of python-can and the libraries of any interface
        text = (getattr(error, "strerror", None) or str(error) or type(error).__name__).rstrip(".")
        hint = "check the name of the channel, and that its driver and library are installed"
        if address.interface == "socketcan":
            hint = (
                f"ip link shows the interfaces, and sudo ip link set {address.channel} up type can bitrate "
                f"{address.bitrate} switches one on"
            )
        raise BusError(
            getattr(error, "errno", None), f"cannot open {address.name}: {text}; {hint}"
        ) from error
