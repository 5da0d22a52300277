"""``xbus restore``: restores the communication with a device."""

from __future__ import annotations

import click

from xbus.cli.connection import open_port
from xbus.cli.number_type import NumberRange

__all__ = ["restore"]


@click.command(epilog="Example: xbus restore /dev/ttyUSB0")
@click.argument("port")
@click.option(
    "--timeout",
    type=NumberRange(0, 3600, min_open=True),
    default=60,
    show_default=True,
    metavar="S",
    help="Seconds to wait for the device.",
)
def restore(port: str, timeout: float) -> None:
    """Restores the communication with a silent device.

    For a device that answers at no baud rate (section 7.2 of the manual). Run the command, then switch the
    device off and on. Afterwards the baud rate is 115200, the output configuration
    and the synchronization have their defaults, and the device is in Config State.

    PORT is a serial port. The USB port of a device does not need this: unplug the device and plug it in
    again.
    """
    from xbus.device import Device
    from xbus.protocol.products import DEFAULT_BAUDRATE

    with Device(open_port(port, DEFAULT_BAUDRATE)) as device:
        click.echo(f"xbus: switch the device off and on now, within {timeout:g} s", err=True)
        device.restore_communication(timeout)
        rate = device.link.baudrate
    click.echo(
        f"xbus: {port} answers at {rate:,} baud, with default outputs, in Config State;"
        f" xbus send {port} GoToMeasurement starts it",
        err=True,
    )
