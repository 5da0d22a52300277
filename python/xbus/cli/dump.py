"""``xbus dump``: one line per message."""

from __future__ import annotations

import contextlib
import os
import re
import stat
import time
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, NoReturn

import click

from xbus.cli.connection import open_port, port_lost
from xbus.cli.failure import Failure
from xbus.cli.input_options import InputOptions, input_options
from xbus.cli.inputs import Input, label, no_frame, reading_task
from xbus.cli.printing import find_name, is_terminal, print_line
from xbus.cli.progress import Progress
from xbus.cli.recordings import Recording
from xbus.formatting import format_count

if TYPE_CHECKING:
    from xbus.cli.dump_lines import DumpFormatter
    from xbus.wire.link import Link

__all__ = ["dump"]

#: The schemes of pyserial's URLs; other URLs are those of files.
PORT_SCHEMES = ("alt", "cp2110", "hwgrep", "loop", "rfc2217", "socket", "spy")
#: Bytes to read at a time.
BLOCK = 1 << 18
#: Interval to check whether a file has grown, or the port is gone, in seconds.
INTERVAL = 0.1
#: Interval to report bytes of a port that belong to no message, in seconds.
NOISE_INTERVAL = 1.0


def _mids(
    ctx: click.Context,  # noqa: ARG001 - click's signature
    param: click.Parameter,  # noqa: ARG001
    values: tuple[str, ...],
) -> list[int | str]:
    """Returns messages as numbers, or names in the spelling of the manual."""
    return [_mid(value) for value in values]


def _mid(value: str) -> int | str:
    from xbus.protocol.tables import MESSAGES

    try:
        mid = int(value, 0)
    except ValueError:
        return find_name(value, (row.name for row in MESSAGES.values()), "message", "messages")
    if not 0 <= mid <= 0xFF:
        raise click.BadParameter(f"{value} is not a message identifier; use 0 to 255, or a name")
    return mid


@click.command(epilog="Example: xbus dump --mid Error --mid Warning walk.mtb")
@input_options(metavar="IN...|PORT")
@click.option(
    "--mid",
    "wanted",
    multiple=True,
    callback=_mids,
    metavar="MID",
    help="Print only this message, by name or number (0x36), without strings and damage; repeatable.",
)
@click.option(
    "--follow", is_flag=True, help="Wait for more data at the end of the file, until Ctrl-C."
)
@click.option(
    "--baudrate",
    type=click.IntRange(1, 4_000_000),
    metavar="RATE",
    help="Bits per second of PORT. Default: 115200, the rate of a new device.",
)
@click.option("--no-hex", is_flag=True, help="Omit the frame in hex.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object per line.")
def dump(
    inputs: InputOptions,
    wanted: list[int | str],
    follow: bool,
    baudrate: int | None,
    no_hex: bool,
    as_json: bool,
) -> None:
    """Prints one line per message, as text and in hex.

    A line has the byte offset of the frame, the time in seconds on the device clock (unwrapped), the name,
    the content, and the frame. Precision and coordinates are in parentheses unless they are Float32 and
    ENU. Strings and damage have separate lines.

    IN is a file, a folder, a pattern ("*.mtb"), a URL, or - for standard input; the pieces of one recording
    are joined. With --follow it is one file that grows, or a PORT: a serial port, a pyserial URL
    (socket://HOST:PORT), a bus (i2c:/dev/i2c-1, spi:/dev/spidev0.0), or sim:PRODUCT for a virtual device.
    Nothing is sent to the device.
    """
    from xbus.cli.dump_lines import DumpFormatter
    from xbus.protocol.products import DEFAULT_BAUDRATE
    from xbus.protocol.tables import device_of

    def new_formatter() -> DumpFormatter:
        return DumpFormatter(wanted, **inputs.for_log, with_hex=not no_hex, as_json=as_json)

    ports = [name for name in inputs.names if _is_port(name)]
    if ports and not follow:
        raise click.UsageError(
            f"{label(ports[0])} is a port and has no end; add --follow to print messages until Ctrl-C"
        )
    if follow and len(inputs.names) > 1:
        raise click.UsageError("--follow is for one file or port")
    if not ports and baudrate is not None:
        raise click.UsageError(f"{label(inputs.names[0])} is not a port and has no --baudrate")
    if ports:
        if inputs.is_hex:
            raise click.UsageError(f"{label(ports[0])} is a port; --hex is for files")
        # Trying other rates would send requests.
        _listen(ports[0], baudrate or DEFAULT_BAUDRATE, new_formatter())
        return
    recording = Recording(list(inputs.names)) if follow else inputs.recording("dump each by itself")
    recording.show_notes()
    files = recording.files
    formatter = new_formatter()
    # A progress bar would mix with lines on the terminal.
    quiet = follow or is_terminal()
    with (
        Progress(reading_task(files[0]), shown=not quiet) as progress,
        inputs.opened(files, progress) as source,
    ):
        for data in _growing(source) if follow else _blocks(source):
            if data is None:
                text = f"{label(files[0])} was truncated; reading from its start"
                click.echo(f"xbus: {text}", err=True)
                formatter = new_formatter()
            elif lines := formatter.feed(data):
                print_line("\n".join(lines), flush=True)
        if lines := formatter.close():
            print_line("\n".join(lines))
    if not formatter.frames:
        raise no_frame(files, formatter.size, source.head)
    if (note := formatter.rate_use.note) is not None:
        click.echo(f"xbus: {recording.heading}: {note}", err=True)
    if inputs.bid is not None and device_of(inputs.bid) not in formatter.devices:
        found = ", ".join(map(str, sorted(formatter.devices))) or "no BID, only strings"
        names = ", ".join(map(label, files))
        raise Failure(f"no messages of BID {inputs.bid} in {names}; it has those of {found}")


def _is_port(name: str) -> bool:
    """Returns whether this is a port: a URL of pyserial, a bus, a virtual device, or a terminal device."""
    from xbus.device.ports import BUS_SCHEMES

    buses = (f"{scheme}:" for scheme in BUS_SCHEMES)
    if name.startswith(("sim:", "can:", *buses, *(f"{scheme}://" for scheme in PORT_SCHEMES))):
        return True
    if os.name == "nt":
        return re.fullmatch(r"(\\\\\.\\)?COM\d+", name, re.IGNORECASE) is not None
    with contextlib.suppress(OSError, ValueError):
        if stat.S_ISCHR(os.stat(name).st_mode):  # noqa: PTH116 - pathlib is slow to import
            return _is_terminal(name)
    return False


def _is_terminal(name: str) -> bool:
    """Returns whether a character device is a terminal, unlike /dev/null; a device in use counts as one."""
    try:
        number = os.open(name, os.O_RDONLY | os.O_NOCTTY | os.O_NONBLOCK)
    except OSError:
        return True
    try:
        return os.isatty(number)
    finally:
        os.close(number)


def _listen(port: str, baudrate: int, formatter: DumpFormatter) -> None:
    """Prints the messages of a port until it is gone, or Ctrl-C; then the totals."""
    link = open_port(port, baudrate)
    try:
        _print_messages(link, port, formatter)
    except BrokenPipeError:  # the reader of the output has seen enough
        raise
    except BaseException:
        _print_totals(port, baudrate, link.acquisition.stats(link.clock())["counts"])
        raise
    finally:
        link.close()


def _print_messages(link: Link, port: str, formatter: DumpFormatter) -> NoReturn:
    acquisition = link.acquisition
    dropped, undecided, shown_at = 0, 0, link.clock()
    while True:
        seen = acquisition.waiting.events_added
        items = acquisition.take_all()
        stats = acquisition.stats(link.clock())
        if items is None:
            raise port_lost(port, ConnectionResetError(acquisition.ended))
        if lines := formatter.add(items):
            print_line("\n".join(lines), flush=True)
        before, dropped = dropped, sum(stats["dropped"].values())
        if dropped > before:
            lost = format_count(dropped - before, "message")
            click.echo(f"xbus: {lost} lost: the reader of the output is too slow", err=True)
        # Damage has a line when it ends. Bytes at a wrong baud rate never do.
        waiting = stats["counts"]["skipped_bytes"] - formatter.damaged_bytes
        if items:
            undecided, shown_at = 0, link.clock()
        elif waiting > undecided and link.clock() - shown_at >= NOISE_INTERVAL:
            undecided, shown_at = waiting, link.clock()
            count = format_count(waiting, "byte")
            click.echo(f"xbus: {count} without a message so far", err=True)
        link.wait(INTERVAL, samples=1, strings=True, events=seen)


def _print_totals(port: str, baudrate: int, counts: dict[str, Any]) -> None:
    parts = [
        format_count(counts["samples"], "sample"),
        format_count(counts["messages"], "other message"),
    ]
    if strings := sum(counts["strings"].values()):
        parts.append(format_count(strings, "string"))
    if counts["skipped_bytes"]:
        parts.append(f"{format_count(counts['skipped_bytes'], 'byte')} damaged")
    text = f"{label(port)}: {', '.join(parts)}"
    if counts["bytes"] and not (counts["frames"] or strings):
        text += (
            f"; {baudrate} baud is probably not the rate of the device: xbus identify {label(port)} finds it,"
            " and --baudrate sets it"
        )
    click.echo(f"xbus: {text}", err=True)


def _blocks(source: Input) -> Iterator[bytes]:
    while data := source.read(BLOCK):
        yield data


def _growing(source: Input) -> Iterator[bytes | None]:
    """Yields the bytes of a file, and what is appended; None if the file was truncated and is read again."""
    source.open_next()
    while True:
        if data := source.read_current(BLOCK):
            yield data
        elif not source.is_regular:
            return
        elif source.rewind_if_truncated():
            yield None
        else:
            time.sleep(INTERVAL)
