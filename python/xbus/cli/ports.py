"""``xbus ports``: where a device may be."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

import click

from xbus.cli.connection import connect_device
from xbus.cli.failure import Failure
from xbus.cli.printing import print_json_rows, print_line, print_table
from xbus.errors import XbusError, XbusTimeout

if TYPE_CHECKING:
    from xbus.device import Port

__all__ = ["ports"]


@click.command(epilog="Example: xbus ports --identify")
@click.option(
    "--identify",
    is_flag=True,
    help="Connect to each port that says Xsens, or to all if none does, and read who is there: seconds for"
    " each. A device that measures stops for a moment.",
)
@click.option("--json", "as_json", is_flag=True, help="A JSON list.")
def ports(identify: bool, as_json: bool) -> None:
    """The serial ports of this machine, those that say Xsens first.

    Converters of another make do not say what is behind them; --identify finds out.
    """
    from xbus.device import find_ports

    found = find_ports()
    asked = ([it for it in found if it.likely] or found) if identify else []
    rows = [_facts(it) | (_who(it) if it in asked else {}) for it in found]
    if as_json:
        print_json_rows(rows)
    elif not rows:
        print_line("no serial port; is the device plugged in?")
    else:
        _put_rows(rows, identify=identify)


def _facts(port: Port) -> dict[str, Any]:
    return {
        "port": port.device,
        "likely": port.likely,
        "description": port.description,
        "serial_number": port.serial_number,
    }


def _who(port: Port) -> dict[str, Any]:
    """Who is behind a port, or why that cannot be told."""
    from xbus.describe.text import device_name

    if sys.stderr is not None and sys.stderr.isatty():
        click.echo(f"asking {port.device}", err=True)
    try:
        with connect_device(port.device) as device, device.configure():
            return {
                "product_code": device.product_code,
                "device_id": None if device.device_id is None else device_name(device.device_id),
                "firmware": None if device.firmware is None else str(device.firmware),
                "baudrate": device.link.baudrate,
            }
    except XbusTimeout:
        return {"problem": "nothing was heard"}
    except (Failure, XbusError) as error:
        return {"problem": str(error)}


def _put_rows(rows: list[dict[str, Any]], *, identify: bool) -> None:
    head = ["port", "Xsens", "description", "serial number"]
    cells = [
        [it["port"], "yes" if it["likely"] else "", it["description"], it["serial_number"] or ""]
        for it in rows
    ]
    if identify:
        head.append("device")
        cells = [[*row, _device(it)] for row, it in zip(cells, rows, strict=True)]
    print_table(head, cells, optional=["serial number"])


def _device(facts: dict[str, Any]) -> str:
    """A device in a line."""
    from xbus.describe.text import printable

    if "baudrate" not in facts:
        return str(facts.get("problem", "not asked"))
    code = printable((facts["product_code"] or "no product code").encode())
    number = facts["device_id"]
    return f"{code} {number}, firmware {facts['firmware']}, {facts['baudrate']} baud"
