"""``xbus view``: shows a recording or a device in the viewer rerun."""

from __future__ import annotations

import contextlib
import os
import shutil
import socket
import sys
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import click

from xbus.cli.connection import baudrate_option, bid_option, listen_option
from xbus.cli.decoding import PART, reading
from xbus.cli.failure import Failure, stop_requested
from xbus.cli.inputs import Input, check_port_options, is_recording, label, no_frame, reading_task
from xbus.cli.progress import Progress
from xbus.cli.recordings import show_unread_piece
from xbus.formatting import format_count

if TYPE_CHECKING:
    from xbus.export.rerun.stream import RerunStream
    from xbus.log.log import Log

__all__ = ["view"]

#: Seconds that the viewer may take to receive what it was sent.
TIMEOUT = 10.0


@click.command(epilog="Example: xbus view walk.mtb")
@click.argument("source", metavar="FILE|PORT")
@bid_option
@baudrate_option
@listen_option
@click.option(
    "--memory-limit",
    default="2GB",
    show_default=True,
    metavar="SIZE",
    help="Memory of the viewer: a size or a share such as 50%. It drops the oldest data beyond that.",
)
@click.option(
    "--viewer-port",
    type=click.IntRange(1, 65535),
    default=9876,
    show_default=True,
    metavar="N",
    help="TCP port of the viewer. A viewer that already listens there is used.",
)
def view(
    source: str,
    bid: int | None,
    baudrate: int | None,
    listen: bool,
    memory_limit: str,
    viewer_port: int,
) -> None:
    """Shows a recording or a device in the viewer rerun.

    The viewer shows the orientation in 3D, every quantity over time, positions on a map, and a log of
    restarts, lost samples, damage and messages. It stays open when the command ends.

    FILE is a recording. PORT is a serial port, a pyserial URL (socket://HOST:PORT), a bus (i2c:/dev/i2c-1,
    spi:/dev/spidev0.0, can:socketcan:can0), or sim:PRODUCT for a virtual device, which is shown until Ctrl-C.
    """
    if is_recording(source):
        check_port_options(source, baudrate=baudrate, listen=listen)
        _view_file(source, bid, viewer_port, memory_limit)
    else:
        _view_port(source, bid, viewer_port, memory_limit, baudrate=baudrate, listen=listen)


def _view_file(file: str, bid: int | None, viewer_port: int, memory_limit: str) -> None:
    from xbus.cli.stored import stored
    from xbus.export.rerun.stream import RerunStream, names_of

    show_unread_piece(file)
    task = reading_task(file)
    with (
        Progress(task) as progress,
        Input([file], progress) as source,
        stored(source, [file]) as stored_file,
        _viewer(viewer_port, memory_limit) as recording,
        reading(label(file)),
    ):
        # The first pass finds the identifiers of devices, which name what is shown.
        parts = stored_file.split(block_bytes=PART, bid=bid)
        stream = RerunStream(recording, names_of(parts[0].empty().devices))
        frames = 0
        for part in parts:
            log = part.read()
            frames += log.stats.frames
            stream.write(log)
            _flush(recording, viewer_port)
            progress.update(task, part.end, stored_file.size)
        if not frames:
            raise no_frame([file], stored_file.size, source.head)
        stream.close()
        _flush(recording, viewer_port)
    click.echo(f"{label(file)}: {_sent(stream)}", err=True)


def _view_port(
    port: str,
    bid: int | None,
    viewer_port: int,
    memory_limit: str,
    *,
    baudrate: int | None,
    listen: bool,
) -> None:
    from xbus.cli.live_input import live_input
    from xbus.export.rerun.stream import RerunStream

    with (
        stop_requested() as is_stopping,
        live_input(port, bid=bid, baudrate=baudrate, listen=listen) as live,
        _viewer(viewer_port, memory_limit) as recording,
    ):
        names = {} if live.device_id is None else {1: live.device_id}
        stream = RerunStream(recording, names)
        with contextlib.suppress(_ViewerClosedError):
            live.run(_ViewerSink(stream, recording), is_stopping)
        click.echo(f"{port}: {live.elapsed:,.1f} s, {_sent(stream)}; {live.losses()}", err=True)


def _sent(stream: RerunStream) -> str:
    return f"{format_count(stream.samples, 'sample')}, {format_count(stream.events, 'event')} shown"


class _ViewerClosedError(Exception):
    """The viewer was closed, which ends the command."""


class _ViewerSink:
    def __init__(self, stream: RerunStream, recording: Any) -> None:
        self._stream, self._recording = stream, recording

    def write(self, block: Log) -> None:
        self._stream.write(block)
        # Waits for the viewer: what it has not received yet would need memory.
        try:
            self._recording.flush(timeout_sec=TIMEOUT)
        except RuntimeError as error:
            raise _ViewerClosedError from error

    def note(self, text: str, *, is_bad: bool) -> None:
        self._stream.note(text, "WARN" if is_bad else "INFO")


@contextlib.contextmanager
def _viewer(port: int, memory_limit: str) -> Iterator[Any]:
    """Starts the viewer, or uses the one that listens on the port, and yields a recording stream to it."""
    recording = open_viewer(port, memory_limit)
    try:
        yield recording
    finally:
        recording.disconnect()


def open_viewer(port: int, memory_limit: str) -> Any:
    """Starts the viewer, or uses the one that listens on the port, and returns a recording stream to it.

    Raises:
        ImportError: The extra ``rerun`` is not installed.
        Failure: The viewer does not start.
    """
    from xbus.export.rerun.stream import new_recording
    from xbus.extras import require

    recording = new_recording()
    if not (_has_display() or _is_listening(port)):
        raise Failure(
            "cannot start the viewer: this session has no display; xbus decode -o FILE.rrd writes a file "
            "for a viewer elsewhere"
        )
    # The folder of an environment that is not activated is not in PATH.
    search = os.pathsep.join([os.path.dirname(sys.executable), os.environ.get("PATH", "")])  # noqa: PTH120
    try:
        require("rerun", "rerun", "to start the viewer").spawn(
            recording=recording,
            port=port,
            memory_limit=memory_limit,
            hide_welcome_screen=True,
            executable_path=shutil.which("rerun", path=search),
        )
    except (RuntimeError, ValueError) as error:
        reason = str(error).partition("\n")[0].rstrip(".")
        raise Failure(
            f"cannot start the viewer on port {port}: {reason}; xbus decode -o FILE.rrd writes a file for a"
            " viewer elsewhere"
        ) from error
    return recording


def _has_display() -> bool:
    """Returns whether windows can be shown; without a display the viewer ends when it starts."""
    names = ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET")
    return sys.platform != "linux" or any(os.environ.get(name) for name in names)


def _is_listening(port: int) -> bool:
    """Returns whether a program listens on a port of this computer."""
    try:
        socket.create_connection(("127.0.0.1", port), timeout=1).close()
    except OSError:
        return False
    return True


def _flush(recording: Any, port: int) -> None:
    try:
        recording.flush(timeout_sec=TIMEOUT)
    except RuntimeError as error:
        raise Failure(
            f"the viewer on port {port} does not receive data: it was closed, or another program uses the"
            " port; --viewer-port chooses another one"
        ) from error
