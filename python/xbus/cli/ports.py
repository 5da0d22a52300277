"""``xbus ports``: serial ports, and the devices on them."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

import click

from xbus.cli.connection import connect_device
from xbus.cli.failure import Failure
from xbus.cli.printing import print_json_rows, print_line, print_table
from xbus.errors import XbusError, XbusTimeout
from xbus.formatting import device_name, printable

if TYPE_CHECKING:
    from xbus.device import Port

__all__ = ["port_as_json", "ports"]


@click.command(epilog="Example: xbus ports --identify")
@click.option(
    "--identify",
    is_flag=True,
    help="Connect to each Xsens port, or to all ports if there is none, and identify the device. Takes "
    "some seconds per port; a device that measures stops for a moment.",
)
@click.option("--json", "as_json", is_flag=True, help="Print a JSON list.")
def ports(identify: bool, as_json: bool) -> None:
    """Lists the serial ports of this machine, Xsens ports first.

    Converters of other vendors do not name the device behind them; use --identify.
    """
    from xbus.device import find_ports

    found = find_ports()
    candidates = ([port for port in found if port.likely] or found) if identify else []
    rows = [port_as_json(port) | (_identify(port) if port in candidates else {}) for port in found]
    if as_json:
        print_json_rows(rows)
    elif not rows:
        print_line("no serial port; check the cable")
    else:
        _print_rows(rows, identify=identify)


def port_as_json(port: Port) -> dict[str, Any]:
    """Returns a port by the names of its properties."""
    return {
        "port": port.device,
        "likely": port.likely,
        "description": port.description,
        "serial_number": port.serial_number,
    }


def _identify(port: Port) -> dict[str, Any]:
    """Returns the device on a port, or the problem."""
    if sys.stderr is not None and sys.stderr.isatty():
        click.echo(f"identifying {port.device}", err=True)
    try:
        with connect_device(port.device) as device, device.configure():
            return {
                "product_code": device.product_code,
                "device_id": None if device.device_id is None else device_name(device.device_id),
                "firmware": None if device.firmware is None else str(device.firmware),
                "baudrate": device.link.baudrate,
            }
    except XbusTimeout:
        return {"problem": "no answer"}
    except (Failure, XbusError) as error:
        return {"problem": str(error)}


def _print_rows(rows: list[dict[str, Any]], *, identify: bool) -> None:
    head = ["port", "Xsens", "description", "serial number"]
    cells = [
        [
            row["port"],
            "yes" if row["likely"] else "",
            row["description"],
            row["serial_number"] or "",
        ]
        for row in rows
    ]
    if identify:
        head.append("device")
        cells = [[*line, _describe(row)] for line, row in zip(cells, rows, strict=True)]
    print_table(head, cells, optional=["serial number"])


def _describe(row: dict[str, Any]) -> str:
    """Returns the device on a port as one line."""
    if "baudrate" not in row:
        return str(row.get("problem", "not identified"))
    code = printable(row["product_code"] or "no product code")
    return f"{code} {row['device_id']}, firmware {row['firmware']}, {row['baudrate']} baud"
