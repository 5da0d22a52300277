"""``xbus config``: settings of a device as a file."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from xbus.cli.connection import baudrate_option, connect_device
from xbus.cli.failure import Failure, cannot
from xbus.cli.inputs import label
from xbus.cli.printing import print_json, print_line
from xbus.formatting import format_count

if TYPE_CHECKING:
    from xbus.device import Applied, ApplyError, Change, Device, Settings

__all__ = ["apply_settings", "config", "read_settings"]

_port = click.argument("port")
_file = click.argument("file", type=click.Path())


@click.group(epilog="Example: xbus config dump /dev/ttyUSB0 -o mti.toml")
def config() -> None:
    """Reads, compares and applies settings as a file.

    The file is TOML with a comment above each setting. Settings that are not in the file do not change.
    """


@config.command(epilog="Example: xbus config dump /dev/ttyUSB0 -o mti.toml")
@_port
@click.option(
    "-o", "out", type=click.Path(), metavar="FILE", help="Write to FILE instead of stdout."
)
@click.option(
    "--json", "as_json", is_flag=True, help="Write a JSON object, which apply and diff cannot read."
)
@baudrate_option
def dump(port: str, out: str | None, as_json: bool, baudrate: int | None) -> None:
    """Reads all settings of a device.

    PORT is a serial port, a pyserial URL (socket://HOST:PORT), a bus (i2c:/dev/i2c-1, spi:/dev/spidev0.0), or
    sim:PRODUCT for a virtual device.
    """
    from xbus.export.replacing import replacing

    with connect_device(port, baudrate) as device:
        settings = device.settings()
    text = f"{json.dumps(_settings_dict(settings), indent=2)}\n" if as_json else settings.to_toml()
    if out is None:
        print_line(text.removesuffix("\n"))
        return
    try:
        with replacing(out) as file:
            file.write(text.encode())
    except OSError as error:
        raise cannot(f"write {label(out)}", error) from error


@config.command(epilog="Example: xbus config diff /dev/ttyUSB0 mti.toml")
@_port
@_file
@click.option("--exit-code", is_flag=True, help="Exit with status 1 if there are differences.")
@click.option("--json", "as_json", is_flag=True, help="Print a JSON list of the differences.")
@baudrate_option
def diff(port: str, file: str, exit_code: bool, as_json: bool, baudrate: int | None) -> None:
    """Shows the differences between a device (-) and a file (+)."""
    from xbus.device.settings import plan_settings

    settings = read_settings(file)
    with connect_device(port, baudrate) as device, device.configure():
        planned = plan_settings(device, settings)
    changes = planned.changes
    if planned.is_other_product:
        product = planned.before.product or "another product"
        click.echo(
            f"xbus: {label(file)} is for {settings.product!r}, the device is {product}", err=True
        )
    if as_json:
        print_json([_change(change) for change in changes])
    else:
        for change in changes:
            print_line(str(change))
        if not changes:
            click.echo("xbus: no differences", err=True)
    if exit_code and (changes or planned.is_other_product):
        raise click.exceptions.Exit(1)


@config.command(epilog="Example: xbus config apply /dev/ttyUSB0 mti.toml --dry-run")
@click.argument("ports", nargs=-1, required=True, metavar="PORT...")
@_file
@click.option("--dry-run", is_flag=True, help="Show the changes without applying them.")
@click.option(
    "--force",
    is_flag=True,
    help="Accept a file for another product, and skip settings that the device does not support.",
)
@click.option(
    "--no-line",
    is_flag=True,
    help="Do not check the data rate against the baud rate: PORT is the USB port of the device.",
)
@click.option(
    "--json",
    "as_json",
    is_flag=True,
    help="Print the result as a JSON object; for several ports as a list.",
)
@baudrate_option
def apply(
    ports: tuple[str, ...],
    file: str,
    dry_run: bool,
    force: bool,
    no_line: bool,
    as_json: bool,
    baudrate: int | None,
) -> None:
    """Applies a settings file to a device.

    Only settings that differ are sent. First prints the changes: - the old value, + the new value. All
    settings are checked before the first is sent, and read back. With several PORTs, each device is set in
    turn, and a table shows the results; a problem with one device does not stop the others.
    """
    from xbus.cli.config_bench import apply_to_all
    from xbus.device.settings import ApplyError

    settings = read_settings(file)
    if len(ports) > 1:
        apply_to_all(
            ports,
            settings,
            dry_run=dry_run,
            check_baudrate=not no_line,
            force=force,
            baudrate=baudrate,
            as_json=as_json,
        )
        return
    try:
        with connect_device(ports[0], baudrate) as device:
            done = apply_settings(
                device,
                settings,
                file,
                dry_run=dry_run,
                check_baudrate=not no_line,
                force=force,
                show=not as_json,
            )
    except Failure as failure:
        if as_json and isinstance(failure.__cause__, ApplyError):
            print_json(_partial_result(failure.__cause__))
        raise
    if as_json:
        result: dict[str, Any] = {
            "changes": [_change(change) for change in done.changes],
            "rounded": [_change(change) for change in done.rounded],
            "skipped": list(done.skipped),
            "needs_reset": done.needs_reset,
            "dry_run": dry_run,
        }
        print_json(result)


def _settings_dict(settings: Settings) -> dict[str, Any]:
    """Returns all known settings by name, for JSON."""
    from xbus.device.settings.table import SETTINGS

    values = {name: getattr(settings, name) for name in SETTINGS}
    known = {name: _plain(name, value) for name, value in values.items() if value is not None}
    return {"product": settings.product, **known}


def _change(change: Change) -> dict[str, Any]:
    return {
        "setting": change.name,
        "before": _plain(change.name, change.before),
        "after": _plain(change.name, change.after),
    }


def _partial_result(error: ApplyError) -> dict[str, Any]:
    """Returns which settings were applied before an error, for JSON."""
    return {
        "changes": [_change(change) for change in error.applied],
        "failed": error.failed.name,
        "failed_is_unknown": error.is_open,
        "not_applied": [change.name for change in error.not_applied],
    }


def _plain(name: str, value: Any) -> Any:
    """Returns the value of a setting as in a file, for JSON."""
    from xbus.describe.json_value import json_value
    from xbus.device.settings.table import SETTINGS

    return None if value is None else json_value(SETTINGS[name].converter.write(value))


def read_settings(file: str) -> Settings:
    """Returns the settings in a file.

    Raises:
        Failure: The file cannot be read, or is not a settings file.
    """
    from xbus.device import Settings

    try:
        return Settings.from_toml(Path(file).read_text("utf-8"))
    except OSError as error:
        raise cannot(f"read {label(file)}", error) from error
    except UnicodeDecodeError as error:
        raise Failure(f"{label(file)}: byte {error.start} is not UTF-8; this is not TOML") from None
    except ValueError as error:
        raise Failure(_lines(file, str(error).splitlines())) from None


def _lines(file: str, problems: Sequence[str]) -> str:
    """Returns the problems of a file as a message with a line for each."""
    return "\nxbus: ".join(f"{label(file)}: {problem}" for problem in problems)


def apply_settings(
    device: Device,
    settings: Settings,
    file: str,
    *,
    dry_run: bool = False,
    check_baudrate: bool = True,
    force: bool | None = None,
    show: bool = True,
) -> Applied:
    """Prints the changes, applies them and prints the result.

    Args:
        device: The device.
        settings: The new settings.
        file: The file with the settings, for messages.
        dry_run: Whether to only print the changes.
        check_baudrate: As for `Device.apply`.
        force: As for `Device.apply`; None for a command without this option.
        show: Whether to print the changes.

    Raises:
        Failure: A setting cannot be applied and nothing was sent, or only a part was applied.
    """
    from xbus.device.settings import Applied, ApplyError, apply_plan, plan_settings

    with device.configure():
        planned = plan_settings(
            device, settings, check_baudrate=check_baudrate, force=force is True
        )
        if planned.problems:
            is_forceable = planned.is_other_product and force is False
            remedy = (
                "; --force applies the settings that the device supports" if is_forceable else ""
            )
            raise Failure(f"{_lines(file, planned.problems)}; nothing was sent{remedy}")
        for problem in planned.skipped:
            click.echo(f"xbus: skipped: {label(file)}: {problem}", err=True)
        if show:
            for change in planned.changes:
                print_line(str(change), flush=True)
        if not planned.changes or dry_run:
            number = format_count(len(planned.changes), "setting")
            result = f"{number} would be set" if planned.changes else "no differences"
            click.echo(f"xbus: {result}", err=True)
            return Applied(planned.changes, skipped=planned.skipped)
        try:
            done = apply_plan(device, planned)
        except ApplyError as error:
            remedy = f"apply {label(file)} again to continue"
            if show:
                remedy += "; the lines with - show the old values"
            raise Failure(f"{error.summary}; {remedy}") from error
        except BaseException as error:  # Ctrl-C, SIGTERM
            for note in getattr(error, "__notes__", ()):
                click.echo(f"xbus: {note}", err=True)
            raise
    if show:
        for change in done.rounded:
            text = f"xbus: the device rounds {change.name}: - the file, + the device\n{change}"
            click.echo(text, err=True)
    reset = "; ports and CAN change at the next reset" if done.needs_reset else ""
    click.echo(
        f"xbus: {format_count(len(done.changes), 'setting')} set and read back{reset}", err=True
    )
    return done
