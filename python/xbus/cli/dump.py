"""``xbus dump``: message by message."""

from __future__ import annotations

import contextlib
import os
import re
import stat
import time
from collections.abc import Iterator
from typing import TYPE_CHECKING, NoReturn

import click

from xbus.cli.connection import open_port, port_lost
from xbus.cli.inputs import Input, label, no_frame, strings_option, task
from xbus.cli.printing import find_name, is_terminal, print_line
from xbus.cli.progress import Progress
from xbus.describe.formatting import format_count

if TYPE_CHECKING:
    from xbus.cli.dump_lines import Teller

__all__ = ["dump"]

#: Bytes read at a time.
PIECE = 1 << 18
#: Seconds between two looks at a file that may have grown.
INTERVAL = 0.1
#: Bits per second of a port, unless told otherwise: the rate of a new device. Trying others would be asking.
BAUDRATE = 115_200


def _mids(
    ctx: click.Context,  # noqa: ARG001 - click's signature
    param: click.Parameter,  # noqa: ARG001
    values: tuple[str, ...],
) -> list[int | str]:
    """Messages as they were asked for: numbers, and names in the manual's spelling."""
    return [_mid(it) for it in values]


def _mid(value: str) -> int | str:
    from xbus.protocol.tables import MESSAGES

    try:
        mid = int(value, 0)
    except ValueError:
        return find_name(value, (it.name for it in MESSAGES.values()), "message", "messages")
    if not 0 <= mid <= 0xFF:
        raise click.BadParameter(f"a message identifier is a byte, not {value}")
    return mid


@click.command(epilog="Example: xbus dump --mid Error --mid Warning walk.mtb")
@click.argument("file", type=click.Path(readable=False), metavar="FILE|PORT")
@click.option(
    "--mid",
    "wanted",
    multiple=True,
    callback=_mids,
    metavar="MID",
    help="Only this message, by name or number (0x36), no strings, no damage; repeatable.",
)
@strings_option
@click.option("--follow", is_flag=True, help="Wait for more when the file ends, until Ctrl-C.")
@click.option(
    "--baudrate",
    type=click.IntRange(1, 4_000_000),
    metavar="RATE",
    help=f"Bits per second of PORT; {BAUDRATE} if not given.",
)
@click.option("--no-hex", is_flag=True, help="Leave out the frame in hex.")
@click.option("--json", "as_json", is_flag=True, help="One JSON object a line.")
def dump(
    file: str,
    wanted: list[int | str],
    strings: tuple[str, ...],
    follow: bool,
    baudrate: int | None,
    no_hex: bool,
    as_json: bool,
) -> None:
    """One line per message, in words and in hex.

    A line has the offset of the frame in bytes, the time in seconds on the device clock, as sent (it
    wraps), the name, what the message says, and the frame. Precision and coordinates stand in
    parentheses where they are not Float32 and ENU. Strings and damage have lines of their own.

    FILE may be a pipe, or - for standard input; it is told as it comes. With --follow also a PORT, a
    serial port, a URL of pyserial (socket://HOST:PORT) or sim:PRODUCT: all that comes, whatever it is.
    Nothing is sent to the device.
    """
    from xbus.cli.dump_lines import Teller

    def new() -> Teller:
        return Teller(wanted, strings=strings, with_hex=not no_hex, as_json=as_json)

    is_port = _is_port(file)
    if is_port and not follow:
        raise click.UsageError(
            f"{label(file)} is a port and has no end; --follow tells what comes until Ctrl-C"
        )
    if not is_port and baudrate is not None:
        raise click.UsageError(f"{label(file)} is no port and has no --baudrate")
    teller = new()
    if is_port:
        _listen(file, baudrate or BAUDRATE, teller)
        return
    # Where the lines themselves are seen to move, a bar would be in their way.
    quiet = follow or is_terminal()
    with (
        Progress(task(file), shown=not quiet) as progress,
        Input([file], progress) as source,
    ):
        for data in _pieces(source, follow=follow):
            if data is None:
                click.echo(
                    f"xbus: {label(file)} was cut short; reading it from its beginning", err=True
                )
                teller = new()
            elif lines := teller.feed(data):
                print_line("\n".join(lines), now=True)
        if lines := teller.close():
            print_line("\n".join(lines))
    if not teller.frames:
        raise no_frame([file], teller.size)


def _is_port(name: str) -> bool:
    """Whether this names a port: a URL, a virtual device, or a terminal, which is what systems call ports."""
    if "://" in name or name.startswith("sim:"):
        return True
    if os.name == "nt":
        return re.fullmatch(r"(\\\\\.\\)?COM\d+", name, re.IGNORECASE) is not None
    with contextlib.suppress(OSError, ValueError):
        if stat.S_ISCHR(os.stat(name).st_mode):  # noqa: PTH116 - pathlib is slow to import
            return _is_terminal(name)
    return False


def _is_terminal(name: str) -> bool:
    """Whether a device of the system is a terminal, and not such as /dev/null; one that is in use is."""
    try:
        number = os.open(name, os.O_RDONLY | os.O_NOCTTY | os.O_NONBLOCK)
    except OSError:
        return True
    try:
        return os.isatty(number)
    finally:
        os.close(number)


def _listen(port: str, baudrate: int, teller: Teller) -> NoReturn:
    """Tells what comes from a port until it is gone."""
    link = open_port(port, baudrate)
    dropped = 0
    try:
        while True:
            try:
                data = link.read(INTERVAL).data
            except OSError as error:
                if lines := teller.close():
                    print_line("\n".join(lines), now=True)
                raise port_lost(port, error) from error
            before, dropped = dropped, link.acquisition.stats()["dropped_bytes"]
            if dropped > before:
                lost = format_count(dropped - before, "byte")
                click.echo(f"xbus: {lost} came while nobody read the lines, and are lost", err=True)
            # Silence is an end: what is incomplete then is damage, and holds nothing back that comes later.
            if lines := teller.feed(data) if data else teller.close():
                print_line("\n".join(lines), now=True)
    finally:
        link.close()


def _pieces(source: Input, *, follow: bool) -> Iterator[bytes | None]:
    """The bytes as they come; None where the file begins anew."""
    source.open_next()
    while True:
        if data := source.read_here(PIECE):
            yield data
        elif not follow or not source.is_regular:
            return
        elif source.rewind_if_cut():
            yield None
        else:
            time.sleep(INTERVAL)
