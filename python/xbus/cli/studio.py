"""``xbus studio``: devices in a browser."""

from __future__ import annotations

import contextlib
import webbrowser
from pathlib import Path
from typing import TYPE_CHECKING

import click

from xbus.cli.failure import Failure, cannot, stop_requested

if TYPE_CHECKING:
    from xbus.studio.hub import Hub

__all__ = ["studio"]

#: Virtual devices of ``--demo``.
DEMO = ("sim:MTi-680G", "sim:MTi-630", "sim:MTi-3")


@click.command(epilog="Example: xbus studio --demo")
@click.argument("sources", nargs=-1, metavar="[PORT]...")
@click.option("--demo", is_flag=True, help="Open three virtual devices.")
@click.option(
    "--folder",
    type=click.Path(file_okay=False, path_type=Path),
    default=Path(),
    metavar="DIR",
    help="Folder for recordings. Default: the current folder.",
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
    sources: tuple[str, ...], demo: bool, folder: Path, host: str, tcp_port: int, no_browser: bool
) -> None:
    """Shows, configures and records devices in a browser.

    Opens the devices on PORT, prints the URL of the page and opens it. Devices stay open, and recordings go
    on, when the page is closed. Ctrl-C stops recordings and closes the devices.

    PORT is a serial port, a pyserial URL (socket://HOST:PORT), a bus (i2c:/dev/i2c-1, spi:/dev/spidev0.0), or
    sim:PRODUCT for a virtual device. Requires the extra: pip install "xbus-mti[studio]".
    """
    from xbus.extras import require

    require("nicegui", "studio", "to show pages in a browser")
    from xbus.network import is_loopback, url_host
    from xbus.studio.guard import new_token
    from xbus.studio.hub import Hub
    from xbus.studio.server import bind, serve

    token = None if is_loopback(host) else new_token()
    hub = Hub(folder)
    try:
        with contextlib.closing(bind(host, tcp_port)) as listener:
            _open(hub, sources, demo=demo)
            url = f"http://{url_host(host)}:{listener.getsockname()[1]}/" + (
                f"?token={token}" if token else ""
            )

            def started() -> None:
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


def _reach(host: str) -> str:
    """Returns the sentence about an address that other computers reach."""
    if host in ("0.0.0.0", "::"):  # noqa: S104 - compared only
        return (
            "every computer that reaches this one can use the page with this token; there, write the"
            f" address of this computer in place of {host}"
        )
    return f"every computer that reaches {host} can use the page with this token"


def _open(hub: Hub, sources: tuple[str, ...], *, demo: bool) -> None:
    from xbus.errors import XbusError
    from xbus.studio.hub import HubError

    try:
        for source in sources:
            hub.open(source).measure()
        for source in DEMO if demo else ():
            hub.open(source).show_all()
    except (HubError, XbusError) as error:
        raise Failure(str(error)) from error
