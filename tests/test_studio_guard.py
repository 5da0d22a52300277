"""Who may use the studio."""

from __future__ import annotations

import asyncio
from typing import Any
from urllib.parse import urlsplit

import pytest

pytest.importorskip("nicegui", reason="the extra studio is not installed")

from starlette.responses import PlainTextResponse

from xbus.studio.guard import Guard

OWN = "http://127.0.0.1:8080"


async def _page(scope: Any, receive: Any, send: Any) -> None:
    """Serves a page, and accepts every WebSocket."""
    if scope["type"] == "websocket":
        await send({"type": "websocket.accept"})
    else:
        await PlainTextResponse("the page")(scope, receive, send)


def ask(
    token: Any,
    target: Any = "/",
    *,
    kind: Any = "http",
    method: Any = "GET",
    base: Any = OWN,
    **headers: Any,
) -> Any:
    """Returns the messages that answer a request of a browser."""
    sent = []

    async def send(message: Any) -> None:
        sent.append(message)

    path, _, query = target.partition("?")
    scope = {
        "type": kind,
        "method": method,
        "path": path,
        "query_string": query.encode(),
        "headers": [
            (name.encode(), value.encode("latin-1"))
            for name, value in ({"host": urlsplit(base).netloc} | headers).items()
            if value is not None
        ],
    }

    async def receive() -> Any:
        raise AssertionError

    asyncio.run(Guard(_page, token)(scope, receive, send))
    return sent


def status(*args: Any, **options: Any) -> Any:
    return ask(*args, **options)[0]["status"]


def opens(*args: Any, **options: Any) -> Any:
    return ask(*args, kind="websocket", **options)[0]["type"] == "websocket.accept"


@pytest.mark.parametrize(
    ("host", "expected"),
    [
        ("127.0.0.1:8080", 200),
        ("localhost:8080", 200),
        ("[::1]:8080", 200),
        ("evil.example", 403),
        ("evil.example:8080", 403),
        ("127.0.0.1.evil.example", 403),
        ("[::1", 403),
        ("", 403),
        (None, 403),
    ],
)
def test_a_name_of_another_computer_is_refused(host: Any, expected: Any) -> None:
    assert status(None, host=host) == expected


@pytest.mark.parametrize(
    ("origin", "is_served"),
    [
        (OWN, True),
        ("http://127.0.0.1:9999", False),
        ("http://evil.example", False),
        ("http://[::1", False),
        ("null", False),
        (None, False),
    ],
)
def test_a_page_of_another_site_is_refused(origin: Any, is_served: Any) -> None:
    assert (status(None, method="POST", origin=origin) == 200) == is_served
    assert opens(None, "/feed", origin=origin) == is_served


def test_the_address_with_the_token_lets_a_browser_in() -> None:
    base = "http://192.168.1.7:8080"
    refusal = ask("secret", base=base)
    assert refusal[0]["status"] == 403
    assert b"token" in refusal[1]["body"]
    assert status("secret", "/?token=wrong", base=base) == 403
    assert not opens("secret", "/feed", base=base, origin=base)
    assert not opens("secret", "/feed?token=secret", base=base, origin=base)
    headers = dict(ask("secret", "/live?token=secret&dark=1", base=base)[0]["headers"])
    # The token leaves the address, so that it is neither in the history of the browser nor in a link.
    assert headers[b"location"] == b"/live?dark=1"
    assert b"HttpOnly" in headers[b"set-cookie"]
    assert b"SameSite=strict" in headers[b"set-cookie"]
    cookie = headers[b"set-cookie"].split(b";")[0].decode()
    assert status("secret", base=base, cookie=cookie) == 200
    assert opens("secret", "/feed", base=base, origin=base, cookie=cookie)


@pytest.mark.parametrize(
    "cookie", ["xbus_studio=wrong", "xbus_studio=", "=;;=", "xbus_studio=s\xe9cret", "a" * 10_000]
)
def test_a_wrong_cookie(cookie: Any) -> None:
    assert status("secret", cookie=cookie) == 403


def test_no_redirect_to_another_site() -> None:
    headers = dict(ask("secret", "//evil.example/?token=secret")[0]["headers"])
    assert headers[b"location"] == b"/evil.example/"
