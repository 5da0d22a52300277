"""``xbus config``: the settings of a device as a file."""

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
from xbus.describe.formatting import format_count

if TYPE_CHECKING:
    from xbus.device import Applied, ApplyError, Change, Device, Settings

__all__ = ["applied", "config", "read_file"]

_port = click.argument("port")
_file = click.argument("file", type=click.Path())


@click.group(epilog="Example: xbus config dump /dev/ttyUSB0 -o mti.toml")
def config() -> None:
    """Settings of a device as a file: dumped, compared, applied.

    The file is TOML, with a comment above each setting. What is left out of it stays as it is on the
    device.
    """


@config.command(epilog="Example: xbus config dump /dev/ttyUSB0 -o mti.toml")
@_port
@click.option("-o", "out", type=click.Path(), metavar="FILE", help="Write to FILE, not to stdout.")
@click.option(
    "--json", "as_json", is_flag=True, help="One JSON object, which apply and diff do not read."
)
@baudrate_option
def dump(port: str, out: str | None, as_json: bool, baudrate: int | None) -> None:
    """Reads all settings of a device.

    PORT is a serial port, a URL of pyserial (socket://HOST:PORT) or sim:PRODUCT, a virtual device.
    """
    from xbus.log.export import replacing

    with connect_device(port, baudrate) as device:
        settings = device.settings()
    text = f"{json.dumps(_all(settings), indent=2)}\n" if as_json else settings.to_toml()
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
@click.option("--exit-code", is_flag=True, help="Exit status 1 if something differs.")
@click.option("--json", "as_json", is_flag=True, help="A JSON list of the differences.")
@baudrate_option
def diff(port: str, file: str, exit_code: bool, as_json: bool, baudrate: int | None) -> None:
    """Shows where a device and a file differ: - the device, + the file."""
    from xbus.device.settings import plan_settings

    settings = read_file(file)
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
            click.echo("xbus: nothing differs", err=True)
    if exit_code and (changes or planned.is_other_product):
        raise click.exceptions.Exit(1)


@config.command(epilog="Example: xbus config apply /dev/ttyUSB0 mti.toml --dry-run")
@click.argument("ports", nargs=-1, required=True, metavar="PORT...")
@_file
@click.option("--dry-run", is_flag=True, help="Show what would be set, and set nothing.")
@click.option(
    "--force",
    is_flag=True,
    help="Accept a file for another product, and leave out the settings that the device cannot have.",
)
@click.option(
    "--no-line", is_flag=True, help="Any output fits: PORT is no serial line (USB of the device)."
)
@click.option(
    "--json",
    "as_json",
    is_flag=True,
    help="One JSON object: what was set and what not; for several ports a list.",
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
    """Sets on a device what a file says otherwise.

    First shows what is going to be set: - as it is, + as it will be. Every setting is checked before the
    first is sent, and read back. With several PORTs, each device is set in turn, and a table shows the
    results; a problem with one device does not stop the others.
    """
    from xbus.cli.config_bench import apply_to_all
    from xbus.device.settings import ApplyError

    settings = read_file(file)
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
            done = applied(
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
            print_json(_partly(failure.__cause__))
        raise
    if as_json:
        facts: dict[str, Any] = {
            "changes": [_change(change) for change in done.changes],
            "rounded": [_change(change) for change in done.rounded],
            "skipped": list(done.skipped),
            "needs_reset": done.needs_reset,
            "dry_run": dry_run,
        }
        print_json(facts)


def _all(settings: Settings) -> dict[str, Any]:
    """All settings by name, as `_plain` has them."""
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


def _partly(error: ApplyError) -> dict[str, Any]:
    """What was applied before an error, and what not."""
    return {
        "changes": [_change(change) for change in error.applied],
        "failed": error.failed.name,
        "failed_is_unknown": error.is_open,
        "not_applied": [change.name for change in error.not_applied],
    }


def _plain(name: str, value: Any) -> Any:
    """The value of a setting as a file has it, for JSON."""
    from xbus.describe.json_value import json_value
    from xbus.device.settings.table import SETTINGS

    return None if value is None else json_value(SETTINGS[name].converter.write(value))


def read_file(file: str) -> Settings:
    """The settings in a file.

    Raises:
        Failure: It cannot be read, or means nothing.
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
    """Problems of a file as a message: a line for each."""
    return "\nxbus: ".join(f"{label(file)}: {problem}" for problem in problems)


def applied(
    device: Device,
    settings: Settings,
    file: str,
    *,
    dry_run: bool = False,
    check_baudrate: bool = True,
    force: bool | None = None,
    show: bool = True,
) -> Applied:
    """Sets what differs, and shows it before and how it went.

    Args:
        device: The device.
        settings: The settings that it should have.
        file: Where they are from, for messages.
        dry_run: Whether to set nothing.
        check_baudrate: As for `Device.apply`.
        force: As for `Device.apply`; None for a command without the option.
        show: Whether to show the changes.

    Raises:
        Failure: Something cannot be applied, and nothing was; or it was in part.
    """
    from xbus.device.settings import Applied, ApplyError, apply_plan, plan_settings

    with device.configure():
        planned = plan_settings(
            device, settings, check_baudrate=check_baudrate, force=force is True
        )
        if planned.problems:
            is_forceable = planned.is_other_product and force is False
            advice = "; --force applies what fits" if is_forceable else ""
            raise Failure(f"{_lines(file, planned.problems)}; nothing was sent{advice}")
        for problem in planned.skipped:
            click.echo(f"xbus: left out: {label(file)}: {problem}", err=True)
        if show:
            for change in planned.changes:
                print_line(str(change), now=True)
        if not planned.changes or dry_run:
            what = f"{format_count(len(planned.changes), 'setting')} would be set"
            click.echo(f"xbus: {what if planned.changes else 'nothing differs'}", err=True)
            return Applied(planned.changes, skipped=planned.skipped)
        try:
            done = apply_plan(device, planned)
        except ApplyError as error:
            advice = f"apply {label(file)} again to go on"
            if show:
                advice += "; the lines with - say what it was before"
            raise Failure(f"{error.summary}; {advice}") from error
        except BaseException as error:  # Ctrl-C, SIGTERM
            for note in getattr(error, "__notes__", ()):
                click.echo(f"xbus: {note}", err=True)
            raise
    if show:
        for change in done.rounded:
            text = f"xbus: the device rounds {change.name}; - the file, + in effect\n{change}"
            click.echo(text, err=True)
    reset = "; ports and CAN change at the next reset" if done.needs_reset else ""
    click.echo(
        f"xbus: {format_count(len(done.changes), 'setting')} set and read back{reset}", err=True
    )
    return done
