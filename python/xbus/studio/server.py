"""The server of the studio: pages, feed and files on one address."""

from __future__ import annotations

import contextlib
import socket
from collections.abc import AsyncIterator, Callable
from pathlib import Path

import uvicorn
from fastapi import FastAPI, WebSocket
from nicegui import ui
from starlette.responses import FileResponse, PlainTextResponse, Response
from starlette.staticfiles import StaticFiles

from xbus.studio.disconnects import Disconnects
from xbus.studio.feed import feed
from xbus.studio.guard import Guard
from xbus.studio.hub import Hub
from xbus.studio.pages.configure import configure_page
from xbus.studio.pages.devices import devices_page
from xbus.studio.pages.live import live_page
from xbus.studio.pages.messages import messages_page
from xbus.studio.pages.record import record_page
from xbus.studio.pages.recordings import recordings_page
from xbus.studio.pages.rtk import rtk_page
from xbus.studio.shell import Session, frame

__all__ = ["bind", "serve"]

STATIC = Path(__file__).parent / "static"


def bind(host: str, port: int) -> socket.socket:
    """Returns a socket that listens.

    Raises:
        OSError: The address is in use, or is none of this computer.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    listener = socket.socket(family, socket.SOCK_STREAM)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind((host, port))
        listener.listen(128)
    except OSError:
        listener.close()
        raise
    return listener


def serve(
    hub: Hub, listener: socket.socket, token: str | None, on_start: Callable[[], None]
) -> None:
    """Serves pages until Ctrl-C or SIGTERM. The hub stays open.

    Args:
        hub: The devices.
        listener: As `bind` returns it.
        token: The token that browsers need; None for a loopback address.
        on_start: Called once the server has started. What it raises ends the server and is raised here.
    """
    failures: list[BaseException] = []

    @contextlib.asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        try:
            on_start()
        except BaseException as error:  # uvicorn would print a traceback
            failures.append(error)
            server.should_exit = True
        yield

    app = FastAPI(docs_url=None, redoc_url=None, openapi_url=None, lifespan=lifespan)
    app.mount("/static", StaticFiles(directory=STATIC))

    @app.get("/recordings/file/{name:path}")
    async def report(name: str) -> Response:
        """Serves a report that was made from a recording of the folder."""
        path = _report(hub.folder, name)
        if path is None:
            return PlainTextResponse("there is no such report", status_code=404)
        # A report runs scripts; it must not act as a page of the studio.
        return FileResponse(path, headers={"Content-Security-Policy": "sandbox allow-scripts"})

    @app.websocket("/feed")
    async def live(connection: WebSocket) -> None:
        await feed(connection, hub)

    ui.run_with(
        app,
        root=lambda: _root(hub),
        title="xbus studio",
        dark=None,
        reconnect_timeout=10,
        show_welcome_message=False,
    )
    config = uvicorn.Config(
        Guard(Disconnects(app), token),
        log_level="warning",
        timeout_graceful_shutdown=2,
        lifespan="on",
    )
    server = uvicorn.Server(config)
    server.run(sockets=[listener])
    if failures:
        raise failures[0]


def _report(folder: Path, name: str) -> Path | None:
    """Returns the path of a report in a folder or the folders in it; None if there is none."""
    try:
        path = (folder / name).resolve()
        is_inside = path.is_relative_to(folder.resolve())
        return path if is_inside and path.suffix == ".html" and path.is_file() else None
    except (OSError, ValueError):  # no name of a file
        return None


#: What draws each page.
BUILDERS: dict[str, Callable[[Session], None]] = {
    "devices": devices_page,
    "live": live_page,
    "configure": configure_page,
    "record": record_page,
    "recordings": recordings_page,
    "rtk": rtk_page,
    "messages": messages_page,
}


def _root(hub: Hub) -> None:
    """Draws a page."""
    session = Session(hub)

    def opened(page: str) -> Callable[..., None]:
        def show(key: str | None = None) -> None:
            session.begin_page(page, key)
            BUILDERS[page](session)

        return show

    routes: dict[str, Callable[..., None]] = {"/": lambda: opened("devices")()}
    for page in BUILDERS:
        routes[f"/{page}"] = lambda page=page: opened(page)()
        routes[f"/{page}/{{key}}"] = lambda key, page=page: opened(page)(key)
    with frame(session):
        ui.sub_pages(routes).classes("w-full")
