"""Browsers that leave before they have an answer."""

from __future__ import annotations

from starlette.types import ASGIApp, Message, Receive, Scope, Send

__all__ = ["Disconnects"]

#: What Starlette says of a request that was ended.
NO_RESPONSE = "No response returned."


class Disconnects:
    """Middleware that drops the error of a request whose browser has left.

    A quick click on another page ends the requests of the first one. The middleware of Starlette then raises
    RuntimeError, and the server would print its traceback (https://github.com/encode/starlette/issues/2516).

    Args:
        app: The application.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Passes a request on."""
        has_left = False

        async def watched() -> Message:
            nonlocal has_left
            message = await receive()
            has_left = has_left or message["type"] == "http.disconnect"
            return message

        try:
            await self._app(scope, watched, send)
        except RuntimeError as error:
            if not has_left or str(error) != NO_RESPONSE:
                raise
