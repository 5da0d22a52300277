"""``xbus config apply`` for several devices: one settings file, one row for each port."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import click

from xbus.cli.connection import connect_device
from xbus.cli.failure import Failure
from xbus.cli.printing import print_json_rows, print_table
from xbus.errors import XbusError
from xbus.formatting import device_name, format_count, printable

if TYPE_CHECKING:
    from xbus.device import Settings

__all__ = ["apply_to_all"]


def apply_to_all(
    ports: Sequence[str],
    settings: Settings,
    *,
    dry_run: bool,
    check_baudrate: bool,
    force: bool,
    baudrate: int | None,
    as_json: bool,
) -> None:
    """Applies settings to one device after the other, and prints a table.

    A problem with one device does not stop the others.

    Raises:
        Failure: At least one device does not have the settings.
        UsageError: Two ports are the same one.
    """
    _check_distinct(ports)
    rows = []
    for port in ports:
        if sys.stderr is not None and sys.stderr.isatty():
            click.echo(f"setting {port}", err=True)
        options = {"dry_run": dry_run, "check_baudrate": check_baudrate, "force": force}
        rows.append(_apply(port, settings, baudrate, **options))
    if as_json:
        print_json_rows(rows)
    else:
        head = ["port", "device", "result"]
        print_table(head, [[row["port"], _device(row), _result(row)] for row in rows], optional=[])
    failed = [row["port"] for row in rows if row["problem"] is not None]
    if failed:
        devices = format_count(len(rows), "device")
        raise Failure(f"{len(failed)} of {devices} do not have the settings: {', '.join(failed)}")


def _check_distinct(ports: Sequence[str]) -> None:
    known: dict[str, str] = {}
    for port in ports:
        # A symbolic link, such as those in /dev/serial/by-id, is a second name of a port.
        path = os.path.normcase(os.path.realpath(port))
        if path in known:
            both = f"{known[path]} and {port} are the same port"
            problem = f"{port} is given twice" if known[path] == port else both
            raise click.UsageError(f"{problem}; give each port once")
        known[path] = port


def _apply(
    port: str, settings: Settings, baudrate: int | None, *, dry_run: bool, **options: bool
) -> dict[str, Any]:
    """Returns what was done at a port, or why nothing was."""
    from xbus.device import ApplyError

    row: dict[str, Any] = {
        "port": port,
        "product_code": None,
        "device_id": None,
        "changes": [],
        "skipped": [],
        "dry_run": dry_run,
        "problem": None,
    }
    try:
        with connect_device(port, baudrate) as device, device.configure():
            row["product_code"] = device.product_code
            row["device_id"] = None if device.device_id is None else device_name(device.device_id)
            done = device.apply(settings, dry_run=dry_run, **options)
            row["changes"] = [change.name for change in done.changes]
            row["skipped"] = list(done.skipped)
    except ApplyError as error:
        row["changes"] = [change.name for change in error.applied]
        row["problem"] = error.summary
    except click.ClickException as error:
        row["problem"] = error.format_message()
    except (XbusError, ValueError) as error:
        row["problem"] = "; ".join(str(error).splitlines())
    return row


def _device(row: dict[str, Any]) -> str:
    code = printable(row["product_code"] or "")
    return f"{code} {row['device_id'] or ''}".strip()


def _result(row: dict[str, Any]) -> str:
    if row["problem"] is not None:
        return str(row["problem"])
    count = format_count(len(row["changes"]), "setting")
    text = f"{count} {'would be set' if row['dry_run'] else 'set'}"
    if not row["changes"]:
        text = "no differences"
    return f"{text}, {len(row['skipped'])} skipped" if row["skipped"] else text
