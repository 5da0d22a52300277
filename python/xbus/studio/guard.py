"""Who may use the studio: this computer only, or everyone with the token."""

from __future__ import annotations

import hmac
import secrets
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qsl, urlencode, urlsplit

from starlette.datastructures import Headers
from starlette.responses import PlainTextResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Receive, Scope, Send
from starlette.websockets import WebSocketClose

from xbus.network import is_loopback

__all__ = ["Guard", "new_token"]

#: Name of the cookie and of the parameter of the address.
TOKEN = "token"  # noqa: S105 - a name
COOKIE = "xbus_studio"


def new_token() -> str:
    """Returns a random token of 192 bits."""
    return secrets.token_urlsafe(24)


class Guard:
    """Middleware that refuses what does not come from a page of the studio.

    - Without a token, the name in the address must be one of this computer. Otherwise a page of another site
      could reach the studio through a name that it resolves to 127.0.0.1.
    - With a token, the cookie must have it. The address that the studio prints sets the cookie.
    - A WebSocket, and a request that changes something, must come from a page of the studio itself: browsers
      send their origin.

    Args:
        app: The application.
        token: The token; None if the studio listens on a loopback address.
    """

    def __init__(self, app: ASGIApp, token: str | None) -> None:
        self._app, self._token = app, token

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Passes a request on, or refuses it."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        if (answer := self._answer(scope, headers)) is None:
            await self._app(scope, receive, send)
        elif scope["type"] == "websocket":
            await WebSocketClose(1008)(scope, receive, send)
        else:
            await answer(scope, receive, send)

    def _answer(self, scope: Scope, headers: Headers) -> Response | None:
        """Returns the answer to a request that is not passed on."""
        host = headers.get("host", "")
        if self._token is None and not is_loopback(_host_name(host)):
            return _refusal("open the studio at the address that it printed, on this computer")
        if not _is_own_page(scope, headers, host):
            return _refusal("this request comes from a page of another site")
        if self._token is None or self._is_token(_cookie(headers)):
            return None
        query = dict(parse_qsl(scope.get("query_string", b"").decode("latin-1")))
        if scope["type"] == "http" and self._is_token(query.pop(TOKEN, "")):
            # A path that begins with two slashes would lead to another site.
            path = "/" + scope["path"].lstrip("/") + (f"?{urlencode(query)}" if query else "")
            response = RedirectResponse(path, status_code=303)
            response.set_cookie(COOKIE, self._token, httponly=True, samesite="strict")
            return response
        return _refusal("open the whole address that xbus studio printed; it ends with the token")

    def _is_token(self, value: str) -> bool:
        return hmac.compare_digest(value.encode(), (self._token or "").encode())


def _is_own_page(scope: Scope, headers: Headers, host: str) -> bool:
    """Returns whether a browser sent a request from a page of the studio."""
    origin = headers.get("origin")
    if origin is None:
        # Browsers send the origin of a WebSocket, and of a request that changes something.
        return scope["type"] == "http" and scope["method"] in ("GET", "HEAD")
    return origin.partition("://")[2] == host


def _host_name(host: str) -> str:
    """Returns the name of a ``Host`` header, without its port; an empty string if it is none."""
    try:
        return urlsplit(f"//{host}").hostname or ""
    except ValueError:
        return ""


def _cookie(headers: Headers) -> str:
    cookies: SimpleCookie = SimpleCookie()
    try:
        cookies.load(headers.get("cookie", ""))
    except CookieError:
        return ""
    return cookies[COOKIE].value if COOKIE in cookies else ""


def _refusal(text: str) -> Response:
    headers: dict[str, Any] = {"Cache-Control": "no-store"}
    return PlainTextResponse(f"xbus studio: {text}\n", status_code=403, headers=headers)
