"""``xbus baudrate``: changes the baud rate of a device."""

from __future__ import annotations

import click

from xbus.cli.connection import connect_device
from xbus.cli.failure import Failure
from xbus.errors import XbusError

__all__ = ["baudrate"]


@click.command(epilog="Example: xbus baudrate /dev/ttyUSB0 921600")
@click.argument("port")
@click.argument("rate", type=click.IntRange(1, 4_000_000))
@click.option(
    "--from",
    "current",
    type=click.IntRange(1, 4_000_000),
    metavar="RATE",
    help="Current rate. Default: try the usual rates.",
)
def baudrate(port: str, rate: int, current: int | None) -> None:
    """Changes the baud rate of a device and of its port.

    The device restarts, answers at the new rate, and keeps it. If it was measuring, it measures again.

    PORT is a serial port, or a pyserial URL that sets the rate of the port (rfc2217://HOST:PORT).
    """
    with connect_device(port, current) as device:
        name, old = device.link.name, device.link.baudrate
        try:
            with device.configure():
                device.set_baudrate(rate)
        except XbusError:  # DecodeError is a ValueError
            raise
        except ValueError as error:
            raise Failure(f"{error}; nothing was changed") from None
    click.echo(f"xbus: {name} uses {rate:,} baud now, before {old:,}", err=True)
