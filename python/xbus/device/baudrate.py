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
    restart(device, baudrate, "SetBaudrate")


def restart(device: Configurable, baudrate: int | None, changed_by: str = "Reset") -> None:
    """Resets a device in Config State, and follows it to the baud rate that it has afterwards.

    Args:
        device: The device.
        baudrate: The rate after the restart; None for a port that has none.
        changed_by: Name of the command that changed the rate, for the error.

    Raises:
        XbusTimeout: The device did not come back; the message says whether it still uses the old rate.
    """
    old = device.link.baudrate
    device.command("Reset")
    if baudrate is not None:
        device.link.baudrate = baudrate
    try:
        device.wake_up()
        device.commands.req_did()
    except XbusTimeout as missed:
        if baudrate is None or old is None or baudrate == old:
            raise
        _find_again(device, old, baudrate, changed_by, missed)


def _find_again(
    device: Configurable, old: int, new: int, changed_by: str, missed: XbusTimeout
) -> None:
    """Finds a device that should have another baud rate now, and puts it into Config State."""
    try:
        device.find_baudrate((new, old))
    except XbusTimeout:
        device.link.baudrate = new
        raise XbusTimeout(
            f"the device answers neither at {new} nor at {old} baud; power it off and on, or recover it"
            f" with xbus restore {device.link.name}",
            changed_by,
            missed.waited,
        ) from missed
    if device.link.baudrate == old:
        problem = f"the device did not change to {new} baud: it still uses {old}"
        raise XbusTimeout(problem, changed_by, missed.waited) from missed
    # WakeUp was missed, as when the port changes its rate late; the device measures meanwhile.
    device.command("GoToConfig")
    device.commands.req_did()
