"""The feed of live curves: what a page asks for, and what it gets."""

from __future__ import annotations

import asyncio
import gc
import json
import math
import struct
from typing import Any

import numpy as np
import pytest

pytest.importorskip("nicegui", reason="the extra studio is not installed")

from starlette.websockets import WebSocket

from xbus.studio.feed import feed
from xbus.studio.history import SPAN, History, Series
from xbus.studio.view import Held, Plot, held_of


class FakeHub:
    """A hub with one device that has a history."""

    def __init__(self) -> None:
        self.history = History()
        self.stations = {"sim:MTi-630": self}

    def measure(self, begin: Any, end: Any) -> None:
        time = np.arange(begin, end, 0.01)
        series = Series("acceleration", "m/s2", ("x", "y"))
        self.history.add_rows(series, time, np.column_stack([np.sin(time), time]))


def decoded(message: Any) -> Any:
    number, n, k, final = struct.unpack("<4I", message[:16])
    time = np.frombuffer(message, "<f8", n, 16)
    values = np.frombuffer(message, "<f8", n * k, 16 + 8 * n).reshape(k, n)
    return number, time, values, bool(final)


def talk(hub: Any, *steps: Any) -> Any:
    """Runs the feed; each step is what the page sends, or a number of messages to wait for and a function."""
    received, closed = [], []

    async def run() -> None:
        inbox: asyncio.Queue[Any] = asyncio.Queue()
        outbox: asyncio.Queue[Any] = asyncio.Queue()
        await inbox.put({"type": "websocket.connect"})

        async def send(message: Any) -> None:
            await outbox.put(message)

        socket = WebSocket({"type": "websocket", "headers": []}, inbox.get, send)
        task = asyncio.create_task(feed(socket, hub))
        assert (await outbox.get())["type"] == "websocket.accept"
        for step in steps:
            if not isinstance(step, tuple):
                kind = "text" if isinstance(step, str) else "bytes"
                await inbox.put({"type": "websocket.receive", kind: step})
                continue
            count, then = step
            for _ in range(count):
                message = await asyncio.wait_for(outbox.get(), 30)
                if message["type"] == "websocket.close":
                    closed.append((message["code"], message["reason"]))
                else:
                    received.append(decoded(message["bytes"]))
            then()
        await inbox.put({"type": "websocket.disconnect", "code": 1000})
        await asyncio.wait_for(task, 30)

    asyncio.run(run())
    return received, closed


def show(**asked: Any) -> Any:
    return json.dumps(
        {"show": {"id": 1, "source": "sim:MTi-630", "name": "acceleration", "step": 0.001, **asked}}
    )


def nothing() -> None:
    pass


def test_a_curve_begins_with_the_past_and_goes_on_with_what_is_new() -> None:
    hub = FakeHub()
    hub.measure(100, 110)
    received, _ = talk(hub, show(span=5), (1, lambda: hub.measure(110, 111)), (1, nothing))
    (first, past, _, _), (_, new, values, final) = received
    assert first == 1
    assert (past[0], past[-1]) == pytest.approx((105.0, 109.99), abs=0.011)
    assert new == pytest.approx(np.arange(110, 111, 0.01))
    assert values[1] == pytest.approx(new, rel=1e-6)
    assert not final


def test_messages_joined_are_the_curve() -> None:
    hub = FakeHub()
    hub.measure(100, 101)
    steps = [(1, lambda at=at: hub.measure(at, at + 1)) for at in range(101, 105)]
    received, _ = talk(hub, show(span=1, step=0.25), *steps, (1, nothing))
    time = np.concatenate([time for _, time, _, _ in received])
    values = np.concatenate([values for _, _, values, _ in received], axis=1)
    whole = hub.history.curve("acceleration", 99.99, 104.75 - 1e-9, 0.25)
    assert whole is not None
    assert time == pytest.approx(whole.time)
    assert values == pytest.approx(whole.values)


def test_a_clock_that_is_set_back_begins_the_curve_again() -> None:
    hub = FakeHub()
    hub.measure(100, 110)
    received, _ = talk(hub, show(span=5), (1, lambda: hub.measure(50, 60)), (1, nothing))
    _, (_, time, values, _) = received
    assert (time[0], time[-1]) == pytest.approx((55.0, 59.99), abs=0.011)
    assert values[1] == pytest.approx(time)


def test_a_part_of_the_past_is_answered_once() -> None:
    hub = FakeHub()
    hub.measure(100, 110)
    received, _ = talk(hub, show(begin=102, end=104, step=0.1), (1, nothing))
    ((_, time, values, final),) = received
    assert final
    assert 102 < time[0] < 102.1
    assert time[-1] == pytest.approx(104, abs=0.011)
    assert len(time) <= 4 * 21
    assert values.shape == (2, len(time))


def test_a_paused_curve_keeps_its_past() -> None:
    hub = FakeHub()
    hub.measure(1000, 1010)
    held, plot = Held(1005.0), Plot("sim:MTi-630", "acceleration")
    held.hold(plot, hub.history)
    hub.measure(1010, 1010 + 1.5 * SPAN)
    held.hold(plot, hub.history)  # again: what is held stays
    asked = {"begin": 1002, "end": 1010, "step": 0.1}
    (past, live), _ = talk(
        hub, show(held=held.number, **asked), show(id=2, held=None, **asked), (2, nothing)
    )
    assert (past[1][0], past[1][-1]) == pytest.approx((1002.0, 1005.0), abs=0.011)
    assert len(live[1]) == 0
    # Nothing is held any longer than a page has it.
    number = held.number
    del held
    gc.collect()
    assert held_of(number) is None
    received, _ = talk(hub, show(held=number, begin=1400, end=1402, step=0.1), (1, nothing))
    assert received[0][1][-1] == pytest.approx(1402, abs=0.011)


def test_a_hidden_curve_is_not_sent() -> None:
    hub = FakeHub()
    hub.measure(100, 101)
    received, _ = talk(
        hub,
        show(id=1, span=1),
        (1, nothing),
        json.dumps({"hide": 1}),
        show(id=2, span=1),
        (1, lambda: hub.measure(101, 102)),
        (1, nothing),
    )
    assert [number for number, *_ in received] == [1, 2, 2]


def test_a_device_that_is_not_open_sends_nothing() -> None:
    hub = FakeHub()
    hub.measure(100, 101)
    received, closed = talk(hub, show(source="sim:MTi-3", span=1), show(id=2, span=1), (1, nothing))
    assert [number for number, *_ in received] == [2]
    assert not closed


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{}",
        "[]",
        "null",
        '{"show": 1}',
        '{"show": {"id": 1}}',
        '{"hide": []}',
        '{"hide": 1e400}',
        show(step=0),
        show(step=math.nan),
        show(span=-1),
        show(span=math.inf),
        show(begin=0, end=1e9),
        show(begin=10, end=1),
        show(id="x"),
        show(held="x"),
        show(step="é" * 200),
        show(step="\ud800"),
        b"\x00\xff",
        "[" * 100_000,
    ],
)
def test_a_wrong_request_closes_the_feed(text: Any) -> None:
    _, closed = talk(FakeHub(), text, (1, nothing))
    ((code, reason),) = closed
    assert code == 1007
    assert 0 < len(reason.encode()) <= 123


def test_a_page_has_a_limited_number_of_curves() -> None:
    _, closed = talk(FakeHub(), *[show(id=number, span=1) for number in range(65)], (1, nothing))
    assert closed == [(1007, "a page has at most 64 curves")]
