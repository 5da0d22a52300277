"""The feed of live curves: a WebSocket with binary messages, many times smaller than the samples.

A page sends text: a JSON object that shows a curve, replaces it, or hides it::

    {"show": {"id": 1, "source": "sim:MTi-630", "name": "acceleration", "step": 0.05, "span": 30}}
    {"show": {"id": 1, "source": "sim:MTi-630", "name": "acceleration", "step": 0.1, "begin": 0, "end": 9}}
    {"hide": 1}

``step`` is the time that a column of pixels covers. With ``span``, the server answers with as many seconds
before the last sample, and then with what is new, 20 times per second. With ``begin`` and ``end``, in seconds
since 1970, it answers once; ``held`` is then the number of the samples that a paused page holds, or null. The
times of a recording that is replayed are seconds since its beginning.

A message is about one curve, in little-endian numbers: ``id``, ``n``, ``k`` and ``final`` as U4, the times of
``n`` points in seconds since 1970 as F8, and ``k`` rows of ``n`` values as F8, one row for each component.
NaN is a gap. A column of pixels is sent when it is complete, so that no later message changes it.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
import struct
from collections.abc import AsyncIterator
from dataclasses import dataclass
from typing import Any

from starlette.websockets import WebSocket, WebSocketDisconnect

from xbus.studio.curves import Curve
from xbus.studio.history import History
from xbus.studio.hub import Hub
from xbus.studio.view import held_of

__all__ = ["encode_curve", "feed"]

#: Seconds between two messages about a curve.
PERIOD = 0.05
#: Curves of a page, and columns of pixels of a curve, at most.
MAX_CURVES, MAX_COLUMNS = 64, 8192
#: Bytes of the reason for closing a WebSocket, at most (RFC 6455, section 5.5).
MAX_REASON = 123
_HEAD = struct.Struct("<4I")


@dataclass
class _Shown:
    """A curve that a page shows.

    Attributes:
        id: Number that the page gave it.
        source, name: Port of the device, and name of the series.
        step: Seconds of a column of pixels.
        span: Seconds before the last sample to begin with.
        begin: Time until which the page has the curve; None if it has nothing.
        end: Time at which the curve ends; None if it goes on.
        held: Number of the samples that are held; None for the recent past.
    """

    id: int
    source: str
    name: str
    step: float
    span: float
    begin: float | None
    end: float | None
    held: int | None


def encode_curve(number: int, curve: Curve, *, final: bool) -> bytes:
    """Returns the message about a curve.

    >>> import numpy as np
    >>> encode_curve(7, Curve(np.array([1.0]), np.array([[2.0]])), final=True).hex()
    '07000000010000000100000001000000000000000000f03f0000000000000040'
    """
    head = _HEAD.pack(number, len(curve.time), len(curve.values), final)
    time, values = curve.time.astype("<f8"), curve.values.astype("<f8")
    return head + time.tobytes() + values.tobytes()


async def feed(socket: WebSocket, hub: Hub) -> None:
    """Serves one page until it closes."""
    await socket.accept()
    shown: dict[int, _Shown] = {}

    async def send() -> None:
        while True:
            for curve in list(shown.values()):
                if (message := _message(hub, curve)) is not None:
                    await socket.send_bytes(message)
                if curve.end is not None and shown.get(curve.id) is curve:
                    del shown[curve.id]
            await asyncio.sleep(PERIOD)

    sender = asyncio.create_task(send())
    try:
        async for text in _texts(socket):
            _update(shown, text)
    except ValueError as error:
        # The text may quote what the page sent.
        reason = str(error).encode("ascii", "backslashreplace")[:MAX_REASON].decode()
        await socket.close(1007, reason)
    finally:
        sender.cancel()
        with contextlib.suppress(asyncio.CancelledError, WebSocketDisconnect, RuntimeError):
            await sender  # the page closed while a message was on its way


async def _texts(socket: WebSocket) -> AsyncIterator[str]:
    """Yields what a page sends, until it closes.

    Raises:
        ValueError: It sends bytes.
    """
    while (message := await socket.receive())["type"] != "websocket.disconnect":
        if (text := message.get("text")) is None:
            raise ValueError("a message must be text")
        yield text


def _message(hub: Hub, curve: _Shown) -> bytes | None:
    """Returns what is new of a curve; None if nothing is."""
    history, end = _history(hub, curve), curve.end
    if history is None:
        return None
    if end is None:
        end = history.end_of_columns(curve.name, curve.step)
    # A series that began again, because the clock was set back, ends before what the page has.
    begin = curve.begin
    if begin is None or (curve.end is None and end < begin):
        begin = end - curve.span
    if not begin < end < math.inf:
        return None
    points = history.curve(curve.name, begin, end, curve.step)
    if points is None:
        return None
    curve.begin = end
    return encode_curve(curve.id, points, final=curve.end is not None)


def _history(hub: Hub, curve: _Shown) -> History | None:
    if curve.held is not None and (held := held_of(curve.held)) is not None:
        return held.history(curve.source)
    station = hub.stations.get(curve.source)
    return None if station is None else station.history


def _update(shown: dict[int, _Shown], text: str) -> None:
    """Shows or hides a curve.

    Raises:
        ValueError: The text asks for nothing of the kind.
    """
    try:
        match json.loads(text):
            case {"hide": number}:
                shown.pop(int(number), None)
            case {"show": dict(asked)}:
                curve = _parse(asked)
                if curve.id not in shown and len(shown) >= MAX_CURVES:
                    raise ValueError(f"a page has at most {MAX_CURVES} curves")
                shown[curve.id] = curve
            case _:
                raise ValueError("the message must show or hide a curve")
    except (KeyError, TypeError, OverflowError, RecursionError) as error:
        raise ValueError(f"not a request for a curve: {error!r}") from error


def _parse(asked: dict[str, Any]) -> _Shown:
    begin, end, held = asked.get("begin"), asked.get("end"), asked.get("held")
    curve = _Shown(
        int(asked["id"]) & 0xFFFFFFFF,
        str(asked["source"]),
        str(asked["name"]),
        float(asked["step"]),
        float(asked.get("span", 0.0)),
        None if begin is None else float(begin),
        None if end is None else float(end),
        None if held is None else int(held),
    )
    if not 1e-6 <= curve.step <= 1e6:
        raise ValueError("step must be between 1e-6 and 1e6 s")
    width = curve.span if curve.begin is None else (curve.end or curve.begin) - curve.begin
    if not 0 <= width / curve.step <= MAX_COLUMNS:
        raise ValueError(f"a curve has at most {MAX_COLUMNS} columns of pixels")
    return curve
