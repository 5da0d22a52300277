"""Browsers that leave before they have an answer."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

pytest.importorskip("nicegui", reason="the extra studio is not installed")

from starlette.middleware.base import BaseHTTPMiddleware, RequestResponseEndpoint
from starlette.requests import Request
from starlette.responses import Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from xbus.studio.disconnects import Disconnects


class Through(BaseHTTPMiddleware):
    """As the middleware of NiceGUI: it looks at each response."""

    async def dispatch(self, request: Request, call_next: RequestResponseEndpoint) -> Response:
        return await call_next(request)


async def _ends_with_its_browser(_: Scope, receive: Receive, send: Send) -> None:
    """Sends no response, as when a transfer is cancelled."""
    while (await receive())["type"] != "http.disconnect":
        pass


async def _sends_nothing(_: Scope, receive: Receive, send: Send) -> None:
    pass


async def _breaks_when_its_browser_leaves(_: Scope, receive: Receive, send: Send) -> None:
    while (await receive())["type"] != "http.disconnect":
        pass
    raise RuntimeError("broken")


async def _is_broken(_: Scope, receive: Receive, send: Send) -> None:
    raise RuntimeError("broken")


def _get(app: ASGIApp) -> None:
    """Requests a page as a browser that leaves at once."""
    scope: Scope = {"type": "http", "method": "GET", "path": "/", "headers": []}
    messages: list[Message] = [{"type": "http.disconnect"}, {"type": "http.request", "body": b""}]

    async def receive() -> Message:
        return messages.pop() if len(messages) > 1 else messages[0]

    async def send(_: Any) -> None:
        pass

    asyncio.run(asyncio.wait_for(app(scope, receive, send), 10))


def test_a_browser_that_leaves_is_no_error() -> None:
    app = Through(_ends_with_its_browser)
    with pytest.raises(RuntimeError, match="No response returned"):
        _get(app)
    _get(Disconnects(app))


@pytest.mark.parametrize("app", [_is_broken, _breaks_when_its_browser_leaves])
def test_other_errors_are_raised(app: ASGIApp) -> None:
    with pytest.raises(RuntimeError, match="broken"):
        _get(Disconnects(app))


def test_an_answer_is_expected_while_the_browser_is_there() -> None:
    with pytest.raises(RuntimeError, match="No response returned"):
        _get(Disconnects(Through(_sends_nothing)))
