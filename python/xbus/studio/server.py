"""The server of the studio: pages, feed and files on one address."""

from __future__ import annotations

import contextlib
import socket
from collections.abc import AsyncIterator, Callable
from pathlib import Path

import uvicorn
from fastapi import FastAPI, WebSocket
from nicegui import ui
from starlette.staticfiles import StaticFiles

from xbus.studio.feed import feed
from xbus.studio.guard import Guard
from xbus.studio.hub import Hub
from xbus.studio.pages.devices import devices_page
from xbus.studio.pages.live import live_page
from xbus.studio.pages.record import record_page
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
        on_start: Called once pages can be opened.
    """

    @contextlib.asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        on_start()
        yield

    app = FastAPI(docs_url=None, redoc_url=None, openapi_url=None, lifespan=lifespan)
    app.mount("/static", StaticFiles(directory=STATIC))

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
        Guard(app, token), log_level="warning", timeout_graceful_shutdown=2, lifespan="on"
    )
    uvicorn.Server(config).run(sockets=[listener])


def _root(hub: Hub) -> None:
    """Draws a page."""
    session = Session(hub)

    def opened(page: str, build: Callable[[Session], None]) -> Callable[..., None]:
        def show(key: str | None = None) -> None:
            session.page, session.key = page, key or session.key
            build(session)

        return show

    with frame(session):
        live, record = opened("live", live_page), opened("record", record_page)
        ui.sub_pages(
            {
                "/": lambda: opened("devices", devices_page)(),
                "/live": lambda: live(),
                "/live/{key}": lambda key: live(key),
                "/record": lambda: record(),
                "/record/{key}": lambda key: record(key),
            }
        ).classes("w-full")
