"""``xbus reset``: restarts a device."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from xbus.cli.connection import baudrate_option, connect_device

if TYPE_CHECKING:
    from xbus.device import Device

__all__ = ["reset"]


@click.command(epilog="Example: xbus reset /dev/ttyUSB0")
@click.argument("port")
@click.option("--config", is_flag=True, help="Leave the device in Config State.")
@baudrate_option
def reset(port: str, config: bool, baudrate: int | None) -> None:
    """Restarts a device and waits until it has started.

    Settings that are not stored are lost. Without --config the device starts as after power-on: it measures,
    unless its option flag DisableAutoMeasurement is set.

    PORT is a serial port, a pyserial URL (socket://HOST:PORT), a bus (i2c:/dev/i2c-1, spi:/dev/spidev0.0), or
    sim:PRODUCT for a virtual device.
    """
    with connect_device(port, baudrate) as device:
        device.reset(config=True)
        # WakeUpAck has no answer; the answer to this request shows that the device is in Config State.
        stays = _stays_in_config(device)
        if not config and not stays:
            device.go_to_measurement()
        state = device.state.value
    click.echo(f"xbus: {device.link.name} has restarted; its state is {state}", err=True)


def _stays_in_config(device: Device) -> bool:
    """Returns whether the device stays in Config State after power-on."""
    from xbus.protocol.values import OptionFlag

    return bool(device.commands.req_option_flags() & OptionFlag.DISABLE_AUTO_MEASUREMENT)
