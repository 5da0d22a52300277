"""``xbus config``: the settings of a device as a file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from xbus.cli.connection import baudrate_option, connect_device
from xbus.cli.failure import Failure, cannot
from xbus.cli.inputs import label
from xbus.cli.printing import print_line
from xbus.describe.formatting import format_count

if TYPE_CHECKING:
    from xbus.device import Device, Settings

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
@baudrate_option
def dump(port: str, out: str | None, baudrate: int | None) -> None:
    """Reads all settings of a device.

    PORT is a serial port, a URL of pyserial (socket://HOST:PORT) or sim:PRODUCT, a virtual device.
    """
    from xbus.log.export import replacing

    with connect_device(port, baudrate) as device:
        text = device.settings().to_toml()
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
@baudrate_option
def diff(port: str, file: str, baudrate: int | None) -> None:
    """Shows where a device and a file differ: - the device, + the file."""
    from xbus.device.settings import plan_settings

    settings = read_file(file)
    with connect_device(port, baudrate) as device, device.configure():
        changes = plan_settings(device, settings).changes
    for it in changes:
        print_line(str(it))
    if not changes:
        click.echo("xbus: nothing differs", err=True)


@config.command(epilog="Example: xbus config apply /dev/ttyUSB0 mti.toml --dry-run")
@_port
@_file
@click.option("--dry-run", is_flag=True, help="Show what would be set, and set nothing.")
@click.option(
    "--no-line", is_flag=True, help="Any output fits: PORT is no serial line (USB of the device)."
)
@baudrate_option
def apply(port: str, file: str, dry_run: bool, no_line: bool, baudrate: int | None) -> None:
    """Sets on a device what a file says otherwise.

    First shows what is going to be set: - as it is, + as it will be. Every setting is checked before the
    first is sent, and read back.
    """
    settings = read_file(file)
    with connect_device(port, baudrate) as device:
        applied(device, settings, file, dry_run=dry_run, check_baudrate=not no_line)


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
        raise Failure(f"{label(file)}: {error}") from None


def applied(
    device: Device,
    settings: Settings,
    file: str,
    *,
    dry_run: bool = False,
    check_baudrate: bool = True,
) -> None:
    """Shows what is going to be set, sets it, and says how that went.

    Raises:
        Failure: Something cannot be applied, and nothing was; or it was in part.
    """
    from xbus.device.settings import ApplyError, apply_plan, plan_settings

    with device.configure():
        planned = plan_settings(device, settings, check_baudrate=check_baudrate)
        if planned.problems:
            reasons = [f"{label(file)}: {problem}" for problem in planned.problems]
            raise Failure("\nxbus: ".join(reasons) + "; nothing was sent")
        for change in planned.changes:
            print_line(str(change), now=True)
        if not planned.changes or dry_run:
            what = f"{format_count(len(planned.changes), 'setting')} would be set"
            click.echo(f"xbus: {what if planned.changes else 'nothing differs'}", err=True)
            return
        try:
            done = apply_plan(device, planned)
        except ApplyError as error:
            advice = f"apply {label(file)} again to go on; the lines with - say what it was before"
            raise Failure(f"{error.summary}; {advice}") from error
        except BaseException as error:  # Ctrl-C, SIGTERM
            for note in getattr(error, "__notes__", ()):
                click.echo(f"xbus: {note}", err=True)
            raise
    for change in done.rounded:
        click.echo(f"xbus: the device rounds {change.name}; - the file, + in effect", err=True)
        click.echo(str(change), err=True)
    reset = "; ports and CAN change at the next reset" if done.needs_reset else ""
    click.echo(
        f"xbus: {format_count(len(done.changes), 'setting')} set and read back{reset}", err=True
    )
