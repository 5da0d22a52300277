"""Ports and devices of commands."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import click

from xbus.cli.failure import Failure
from xbus.cli.number_type import NumberRange
from xbus.describe.failures import port_failure, system_error
from xbus.errors import XbusError
from xbus.protocol.tables import MASTER, device_of

if TYPE_CHECKING:
    from xbus.device import Device
    from xbus.wire.link import Link

__all__ = [
    "address_of",
    "baudrate_option",
    "bid_option",
    "connect_device",
    "duration_option",
    "listen_option",
    "open_port",
    "port_lost",
    "speed_option",
]

#: The option for the baud rate of a port.
baudrate_option = click.option(
    "--baudrate",
    type=click.IntRange(1, 4_000_000),
    metavar="RATE",
    help="Bits per second. Default: try the usual rates.",
)

#: The option to choose a device of a bus.
bid_option = click.option(
    "--bid",
    type=click.IntRange(1, 255),
    metavar="N",
    help="Read only the device with this bus identifier; 1 and 255 are the same device.",
)

#: The option to listen only.
listen_option = click.option(
    "--listen",
    is_flag=True,
    help="Never send a byte: for a line that is only tapped, or a device that another program has"
    " configured. With --baudrate, the line may be silent at first.",
)

#: The option for the speed of a replay.
speed_option = click.option(
    "--speed",
    type=NumberRange(min=0, min_open=True),
    metavar="X",
    help="Replay speed of FILE; 2 is twice as fast as recorded.",
)

#: The option to stop after some seconds.
duration_option = click.option(
    "--duration",
    type=NumberRange(min=0, min_open=True),
    metavar="S",
    help="Stop after S seconds; with FILE, seconds of the recording.",
)


def connect_device(
    port: str,
    baudrate: int | None = None,
    *,
    bid: int = MASTER,
    listen: bool = False,
    strings: Sequence[str] = (),
) -> Device:
    """Returns the device on a port; the arguments are those of `xbus.connect`.

    Raises:
        Failure: The port cannot be opened.
        UsageError: The name is not a port.
        XbusError: The device does not answer.
    """
    from xbus.device import connect

    with _opening(port):
        return connect(port, baudrate, bid=bid, listen=listen, strings=strings)


def address_of(bid: int | None) -> int:
    """Returns the bus identifier of `connect_device` that selects a device of `bid_option`.

    255 would be all devices on the port: 1 is the device that sends either of the two.
    """
    return MASTER if bid is None else device_of(bid)


def open_port(port: str, baudrate: int) -> Link:
    """Opens a port to listen; nothing is sent.

    Raises:
        Failure: The port cannot be opened.
        UsageError: The name is not a port.
    """
    from xbus.device.link import CAN_SCHEME, open_link

    if port.startswith(CAN_SCHEME):
        raise Failure(
            f"{port} has CAN frames and no bytes; xbus record {port} -o bus.log records them as text"
        )
    with _opening(port):
        return open_link(port, baudrate)


@contextlib.contextmanager
def _opening(port: str) -> Iterator[None]:
    try:
        yield
    except XbusError:  # XbusTimeout is an OSError
        raise
    except OSError as error:
        raise Failure(port_failure(port, error)) from error
    except ValueError as error:
        raise click.UsageError(f"{port} is not a port: {error}") from None


def port_lost(port: str, error: OSError) -> Failure:
    """Returns the failure of a port that is gone."""
    text = system_error(error)[1].removeprefix("the port is gone: ")
    return Failure(f"{port} is gone: {text}; check the cable")
