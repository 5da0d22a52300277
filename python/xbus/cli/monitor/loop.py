"""The loop: takes in, draws, and does what the keys say, until it is to end."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from copy import deepcopy

from xbus.cli.monitor.model import Model
from xbus.cli.monitor.rows import table
from xbus.cli.monitor.sources import Live, Replay
from xbus.cli.monitor.terminal import Terminal
from xbus.cli.monitor.view import Shown, draw, room

__all__ = ["watch"]

#: Seconds between two pictures, where no key asks for one.
PERIOD = 0.2


def watch(
    source: Live | Replay, model: Model, terminal: Terminal, is_stopped: Callable[[], bool]
) -> None:
    """Shows a stream until the user has seen enough."""
    watching = _Watching(source, model, terminal)
    with suppress(EOFError):  # nobody sees it any more
        while not (is_stopped() or watching.is_done):
            watching.step()


class _Watching:
    """What is shown, and what it is shown of."""

    def __init__(self, source: Live | Replay, model: Model, terminal: Terminal) -> None:
        self._source, self._model, self._terminal = source, model, terminal
        self._shown = Shown()
        #: What stands still while the display of a device does.
        self._still: Model | None = None
        self._draw_at = 0.0
        self.is_done = False

    def step(self) -> None:
        """Waits for what is next: bytes, a key, or the time to draw."""
        wait = min(self._source.wait(), self._draw_at - time.monotonic())
        keys = self._terminal.keys(max(0.0, wait))
        for key in keys:
            self._press(key)
        if self._source.wait() <= 0:
            self._source.advance(self._model)
        if keys or time.monotonic() >= self._draw_at:
            self._draw()
            self._draw_at = time.monotonic() + PERIOD

    def _draw(self) -> None:
        columns, lines = self._terminal.size
        model = self._model
        if self._still is not None:
            model = self._still
            model.recorded, model.events = self._model.recorded, self._model.events
        self._terminal.show(draw(model, self._shown, columns, lines, self._terminal.glyphs))

    def _press(self, key: str) -> None:
        shown = self._shown
        if shown.is_help:
            shown.is_help = False
        elif shown.is_typing:
            self._type(key)
        elif key == "escape":
            shown.wanted = ""
        elif key == "q":
            self.is_done = True
        elif key == "/":
            shown.is_typing, shown.wanted, shown.first = True, "", 0
        elif key == "?":
            shown.is_help = True
        elif key in ("p", " "):
            self._pause()
        elif key in ("up", "down", "page up", "page down"):
            self._move(key)
        elif isinstance(self._source, Live):
            if key == "r":
                self._source.record(self._model)
            elif key == "m":
                self._source.measure(self._model)

    def _type(self, key: str) -> None:
        shown = self._shown
        if key in ("escape", "enter"):
            shown.is_typing = False
            shown.wanted = "" if key == "escape" else shown.wanted
        elif key == "backspace":
            shown.wanted = shown.wanted[:-1]
        elif len(key) == 1 and key.isprintable():
            shown.wanted += key

    def _pause(self) -> None:
        shown = self._shown
        shown.is_paused = not shown.is_paused
        if isinstance(self._source, Replay):
            self._source.pause()
        else:
            self._still = deepcopy(self._model) if shown.is_paused else None

    def _move(self, key: str) -> None:
        found = len(table(self._model, self._shown.wanted))
        there = room(*self._terminal.size, found)
        step = {"up": -1, "down": 1, "page up": -there, "page down": there}[key]
        self._shown.first = max(0, min(self._shown.first + step, found - there))
