"""``xbus studio``: devices in a browser."""

from __future__ import annotations

import contextlib
import signal
import webbrowser
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from xbus.cli.failure import Failure, cannot, stop_requested
from xbus.cli.inputs import is_recording, label
from xbus.cli.recordings import several_recordings
from xbus.files import RECORDING_SUFFIX, uncompressed_name

if TYPE_CHECKING:
    from xbus.studio.hub import Hub

__all__ = ["studio"]

#: Virtual devices of ``--demo``.
DEMO = ("sim:MTi-680G", "sim:MTi-630", "sim:MTi-3")


@click.command(epilog="Example: xbus studio --demo")
@click.argument("names", nargs=-1, metavar="[PORT|FILE|FOLDER]...")
@click.option("--demo", is_flag=True, help="Open three virtual devices.")
@click.option(
    "--folder",
    type=click.Path(file_okay=False, path_type=Path),
    metavar="DIR",
    help="Folder for recordings. Default: FOLDER, or else the current folder.",
)
@click.option(
    "--host",
    default="127.0.0.1",
    show_default=True,
    metavar="ADDRESS",
    help="Address to listen on. With another one than the default, a browser needs the token of the URL.",
)
@click.option(
    "--port",
    "tcp_port",
    type=click.IntRange(0, 65535),
    default=8080,
    show_default=True,
    metavar="N",
    help="TCP port to listen on; 0 for any free one.",
)
@click.option("--no-browser", is_flag=True, help="Do not open a browser.")
def studio(
    names: tuple[str, ...],
    demo: bool,
    folder: Path | None,
    host: str,
    tcp_port: int,
    no_browser: bool,
) -> None:
    """Shows, configures and records devices in a browser.

    Opens the devices on PORT, replays FILE, lists the recordings of FOLDER, prints the URL of the page and
    opens it. Devices stay open, and recordings go on, when the page is closed. Ctrl-C stops recordings and
    closes the devices.

    PORT is a serial port, a pyserial URL (socket://HOST:PORT), a bus (i2c:/dev/i2c-1, spi:/dev/spidev0.0), or
    sim:PRODUCT for a virtual device. FILE is a recording; pieces of one recording (walk.mtb, walk-0001.mtb,
    ...) are replayed one after the other. New recordings go to FOLDER too. Requires the extra: pip install
    "xbus-mti[studio]".
    """
    from xbus.extras import require

    require("nicegui", "studio", "to show pages in a browser")
    from xbus.network import is_loopback, url_host
    from xbus.studio.guard import new_token
    from xbus.studio.hub import Hub
    from xbus.studio.server import bind, serve

    token = None if is_loopback(host) else new_token()
    sources, folder = _sources(names, folder)
    hub = Hub(folder)
    try:
        with contextlib.closing(bind(host, tcp_port)) as listener:
            url = f"http://{url_host(host)}:{listener.getsockname()[1]}/" + (
                f"?token={token}" if token else ""
            )

            def started() -> None:
                # Not earlier: NiceGUI looks through all objects of the process when it starts, and a tuple
                # that the thread of a device builds at that moment would fail.
                with _interruptible():
                    _open(hub, sources, demo=demo)
                with contextlib.suppress(BrokenPipeError):  # the pages are there all the same
                    click.echo(f"studio: {url}")
                if token is not None:
                    click.echo(f"xbus: {_reach(host)}", err=True)
                if not no_browser:
                    webbrowser.open(url)

            with stop_requested():
                serve(hub, listener, token, started)
    except OSError as error:
        raise cannot(f"listen on {host} port {tcp_port}", error) from error
    finally:
        problems = hub.close_all()
    if problems:
        raise Failure("; ".join(problems))


def _sources(names: Sequence[str], folder: Path | None) -> tuple[list[str], Path]:
    """Returns the devices and replays that arguments name, and the folder of recordings."""
    from xbus.studio.replaying import replay_source

    folders = [name for name in names if Path(name).is_dir()]
    if len(folders) + (folder is not None) > 1:
        raise click.UsageError(
            "the studio has one folder of recordings; name one, as FOLDER or --folder"
        )
    files = [name for name in names if is_recording(name)]
    recordings = several_recordings(files)
    for recording in recordings:
        recording.show_notes()
    replays = [replay_source(map(Path, recording.files)) for recording in recordings]
    ports = [name for name in names if name not in (*folders, *files)]
    for name in ports:
        if uncompressed_name(name).lower().endswith(RECORDING_SUFFIX):
            raise Failure(f"there is no recording {label(name)}; check the name")
    return ports + replays, Path(folders[0]) if folders else folder or Path()


def _reach(host: str) -> str:
    """Returns the sentence about an address that other computers reach."""
    if host in ("0.0.0.0", "::"):  # noqa: S104 - compared only
        return (
            "every computer that reaches this one can use the page with this token; there, write the"
            f" address of this computer in place of {host}"
        )
    return f"every computer that reaches {host} can use the page with this token"


@contextlib.contextmanager
def _interruptible() -> Iterator[None]:
    """Ctrl-C raises KeyboardInterrupt, as it does outside of a server."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _open(hub: Hub, sources: Sequence[str], *, demo: bool) -> None:
    from xbus.errors import XbusError
    from xbus.studio.hub import HubError

    try:
        for source in sources:
            hub.open(source).measure()
        for source in DEMO if demo else ():
            hub.open(source).show_all()
    except (HubError, XbusError) as error:
        raise Failure(str(error)) from error
