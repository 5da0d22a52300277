"""The loop of the monitor: reads data, redraws the screen and handles keys until it ends."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from copy import deepcopy

from rich.console import Console
from rich.live import Live

from xbus.cli.monitor.keyboard import Keyboard
from xbus.cli.monitor.replay_source import ReplaySource
from xbus.cli.monitor.screen import Screen, ViewState, visible_rows
from xbus.watch.device_source import DeviceSource
from xbus.watch.model import Model
from xbus.watch.rows import value_rows

__all__ = ["watch"]

#: Time between two redraws without a key press, in seconds.
PERIOD = 0.2


def watch(
    source: DeviceSource | ReplaySource, model: Model, stop_requested: Callable[[], bool]
) -> None:
    """Shows a stream on a full screen until the user quits, and restores the terminal."""
    with Keyboard() as keyboard, _full_screen() as live, suppress(EOFError):
        loop = _Loop(source, model, keyboard, live)
        while not (stop_requested() or loop.is_done):
            loop.step()


@contextmanager
def _full_screen() -> Iterator[Live]:
    live = Live(
        console=Console(highlight=False),
        screen=True,
        auto_refresh=False,
        redirect_stdout=False,
        redirect_stderr=False,
    )
    live.start()
    try:
        yield live
    finally:
        with suppress(OSError):  # the terminal may be gone
            live.stop()


class _Loop:
    """Connects a source, its model, the keys and the screen."""

    def __init__(
        self, source: DeviceSource | ReplaySource, model: Model, keyboard: Keyboard, live: Live
    ) -> None:
        self._source, self._model, self._keyboard, self._live = source, model, keyboard, live
        self._view = ViewState()
        #: A copy of the model of a device, shown while the display is paused.
        self._paused: Model | None = None
        self._redraw_at = 0.0
        self.is_done = False

    def step(self) -> None:
        """Waits for data, a key or the next redraw, and handles it."""
        wait = min(self._source.wait(), self._redraw_at - time.monotonic())
        keys = self._keyboard.read(max(0.0, wait))
        for key in keys:
            self._handle_key(key)
        if self._source.wait() <= 0:
            self._source.advance(self._model)
        if keys or time.monotonic() >= self._redraw_at:
            self._redraw()
            self._redraw_at = time.monotonic() + PERIOD

    def _redraw(self) -> None:
        model = self._model
        if self._paused is not None:
            model = self._paused
            model.recording, model.events = self._model.recording, self._model.events
        self._live.update(Screen(model, self._view), refresh=True)

    def _handle_key(self, key: str) -> None:
        view = self._view
        if view.shows_help:
            view.shows_help = False
        elif view.is_typing:
            self._edit_filter(key)
        elif key == "escape":
            view.filter_text = ""
        elif key == "q":
            self.is_done = True
        elif key == "/":
            view.is_typing, view.filter_text, view.first_row = True, "", 0
        elif key == "?":
            view.shows_help = True
        elif key in ("p", " "):
            self._pause()
        elif key in ("up", "down", "page up", "page down"):
            self._scroll(key)
        elif isinstance(self._source, DeviceSource):
            if key == "r":
                self._source.toggle_recording(self._model)
            elif key == "m":
                self._source.start_measurement(self._model)

    def _edit_filter(self, key: str) -> None:
        view = self._view
        if key in ("escape", "enter"):
            view.is_typing = False
            view.filter_text = "" if key == "escape" else view.filter_text
        elif key == "backspace":
            view.filter_text = view.filter_text[:-1]
        elif len(key) == 1 and key.isprintable():
            view.filter_text += key

    def _pause(self) -> None:
        view = self._view
        view.is_paused = not view.is_paused
        if isinstance(self._source, ReplaySource):
            self._source.pause()
        else:
            self._paused = deepcopy(self._model) if view.is_paused else None

    def _scroll(self, key: str) -> None:
        rows = len(value_rows(self._model, self._view.filter_text))
        visible = visible_rows(*self._live.console.size, rows)
        step = {"up": -1, "down": 1, "page up": -visible, "page down": visible}[key]
        first = self._view.first_row + step
        self._view.first_row = max(0, min(first, rows - visible))
