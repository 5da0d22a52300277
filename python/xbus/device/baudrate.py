"""The baud rate of a device, changed together with that of its port."""

from __future__ import annotations

from dataclasses import replace

from xbus.device.configurable import Configurable
from xbus.errors import XbusTimeout
from xbus.protocol.values import PortProtocol, baud_code

__all__ = ["change_baudrate", "restart"]


def change_baudrate(device: Configurable, baudrate: int) -> None:
    """Sets the baud rate of a device in Config State, resets it, and follows; see `Device.set_baudrate`."""
    if device.link.baudrate is None:
        raise ValueError(
            f"{device.link.name} has no baud rate; commands.set_baudrate sets that of its serial port"
        )
    code = baud_code(baudrate)
    device.session.validate("SetBaudrate", code)
    if device.support is not None and "SetPortConfig" in device.support.messages:
        device.commands.set_port_config(
            replace(port, baud_code=code) if port.protocol == PortProtocol.XBUS else port
            for port in device.commands.req_port_config()
        )
    else:
        device.command("SetBaudrate", code)
    restart(device, baudrate)


def restart(device: Configurable, baudrate: int | None) -> None:
    """Resets a device in Config State, and follows it to the baud rate that it has afterwards.

    Args:
        device: The device.
        baudrate: The rate after the restart; None for a port that has none.
    """
    old = device.link.baudrate
    device.command("Reset")
    if baudrate is not None:
        device.link.baudrate = baudrate
    try:
        device.wake_up()
        device.commands.req_did()
    except XbusTimeout as timeout:
        if baudrate is None or old is None or baudrate == old:
            raise
        try:
            device.find_baudrate((baudrate, old))
            if device.link.baudrate == baudrate:
                # WakeUp was missed, as when the port changes its rate late; the device measures meanwhile.
                device.command("GoToConfig")
                device.commands.req_did()
                return
            problem = f"the device did not change to {baudrate} baud: it still uses {old}"
        except XbusTimeout:
            device.link.baudrate = baudrate
            problem = (
                f"the device answers neither at {baudrate} nor at {old} baud; power it off and on, or recover"
                f" it with xbus restore {device.link.name}"
            )
        raise XbusTimeout(problem, "SetBaudrate", timeout.waited) from timeout
