"""``xbus dump``: message by message."""

from __future__ import annotations

import time
from collections.abc import Iterator

import click

from xbus.cli.inputs import Input, label, no_frame, strings_option, task
from xbus.cli.output import called, is_terminal, put
from xbus.cli.progress import Progress

__all__ = ["dump"]

#: Bytes read at a time.
PIECE = 1 << 18
#: Seconds between two looks at a file that may have grown.
INTERVAL = 0.1


def _mids(
    ctx: click.Context,  # noqa: ARG001 - click's signature
    param: click.Parameter,  # noqa: ARG001
    values: tuple[str, ...],
) -> list[int | str]:
    """Messages as they were asked for: numbers, and names in the manual's spelling."""
    return [_mid(it) for it in values]


def _mid(value: str) -> int | str:
    from xbus.tables import MESSAGES

    try:
        mid = int(value, 0)
    except ValueError:
        return called(value, (it.name for it in MESSAGES), "message", "messages")
    if not 0 <= mid <= 0xFF:
        raise click.BadParameter(f"a message identifier is a byte, not {value}")
    return mid


@click.command(epilog="Example: xbus dump --mid Error --mid Warning walk.mtb")
@click.argument("file", type=click.Path(readable=False), metavar="FILE")
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
@click.option("--no-hex", is_flag=True, help="Leave out the frame in hex.")
@click.option("--json", "as_json", is_flag=True, help="One JSON object a line.")
def dump(
    file: str,
    wanted: list[int | str],
    strings: tuple[str, ...],
    follow: bool,
    no_hex: bool,
    as_json: bool,
) -> None:
    """One line per message, in words and in hex.

    A line has the offset of the frame in bytes, the time in seconds on the device clock, as sent (it
    wraps), the name, what the message says, and the frame. Precision and coordinates stand in
    parentheses where they are not Float32 and ENU. Strings and damage have lines of their own.

    FILE may be a pipe, or - for standard input; it is told as it comes.
    """
    from xbus.cli.teller import Teller

    def new() -> Teller:
        return Teller(wanted, strings=strings, with_hex=not no_hex, as_json=as_json)

    teller = new()
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
                put("\n".join(lines), now=True)
        if lines := teller.close():
            put("\n".join(lines))
    if not teller.frames:
        raise no_frame([file], teller.size)


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
