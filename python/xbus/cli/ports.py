"""``xbus ports``: where a device may be."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from xbus.cli.output import put, put_json_rows, put_table

if TYPE_CHECKING:
    from xbus.device import Port

__all__ = ["ports"]


@click.command(epilog="Example: xbus ports --identify")
@click.option(
    "--identify",
    is_flag=True,
    help="Connect to each port that says Xsens, or to all if none does, and read who is there. A device that"
    " measures stops for a moment.",
)
@click.option("--json", "as_json", is_flag=True, help="A JSON list.")
def ports(identify: bool, as_json: bool) -> None:
    """The serial ports of this machine, those that say Xsens first.

    Converters of another make do not say what is behind them; --identify finds out.
    """
    from xbus.device import find_ports

    found = find_ports()
    likely = [it for it in found if it.likely] or found
    rows = [_facts(it, identify=identify and it in likely) for it in found]
    if as_json:
        put_json_rows(rows)
    elif not rows:
        put("no serial port; is the device plugged in?")
    else:
        head = ["port", "Xsens", "description", "device"]
        cells = [
            [it["port"], "yes" if it["likely"] else "", it["description"], it["device"] or ""]
            for it in rows
        ]
        put_table(head, cells, spare=[])


def _facts(port: Port, *, identify: bool) -> dict[str, Any]:
    facts = {"port": port.device, "likely": port.likely, "description": port.description}
    return {
        **facts,
        "serial_number": port.serial_number,
        "device": _who(port) if identify else None,
    }


def _who(port: Port) -> str:
    """Who is behind a port, in a line."""
    from xbus.cli.words import device_name
    from xbus.device import connect
    from xbus.errors import XbusError

    try:
        with connect(port.device) as device, device.configure():
            number = device_name(device.device_id or 0)
            code = device.product_code or "no product code"
            return f"{code} {number}, firmware {device.firmware}, {device.link.baudrate} baud"
    except (XbusError, OSError) as error:
        return f"nobody: {error}"
