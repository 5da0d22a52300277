"""The bar below the health of a device that is a replay: position, end, speed and restart."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Any

from nicegui import ui

from xbus.studio.components import BLUR
from xbus.studio.replaying import SPEEDS, Replaying
from xbus.studio.station import Station

__all__ = ["ReplayBar"]


class ReplayBar:
    """Shows and controls the replay of the selected device.

    Args:
        station: Returns the selected device.
        attempt: Runs an action in a thread, and shows its failure.
    """

    def __init__(
        self, station: Callable[[], Station | None], attempt: Callable[..., Awaitable[Any]]
    ) -> None:
        self._station, self._attempt = station, attempt
        self._shown: Replaying | None = None
        self._is_dragged = False
        with ui.element("div").classes("xbus-replay w-full") as self._row:
            self._name = ui.label().classes("font-semibold ellipsis shrink-0 max-w-[30%]")
            self._restart = ui.button(icon="replay", on_click=lambda: self._go(0.0))
            self._restart.props("flat dense round aria-label='replay from the beginning'")
            self._restart.tooltip("from the beginning")
            self._again = ui.button("Play again", icon="replay", on_click=lambda: self._go(0.0))
            self._again.props("flat dense no-caps").classes("shrink-0")
            self._slider = (
                ui.slider(min=0, max=1, step=0.1, value=0)
                .props("aria-label='position in the recording'")
                .classes("grow")
            )
            self._slider.on("pan", lambda event: self._drag(event.args == "start"))
            self._slider.on("change", lambda event: self._go(float(event.args)))
            self._time = ui.label().classes("xbus-mono whitespace-nowrap")
            self._end = ui.label("end of the recording").classes("xbus-quiet whitespace-nowrap")
            self._speed = ui.select(
                {speed: f"{speed:g}×" for speed in SPEEDS}, value=1, on_change=self._set_speed
            ).props("dense aria-label='speed'")
            self._speed.on("popup-hide", js_handler=BLUR)
        self.refresh()

    def refresh(self) -> None:
        """Shows the position of the selected device."""
        station = self._station()
        replaying = None if station is None else station.replaying
        self._row.set_visibility(replaying is not None)
        if replaying is None:
            return
        if replaying is not self._shown:
            self._shown = replaying
            self._name.set_text(replaying.name)
            self._slider.props(f"max={max(replaying.duration, 0.1):.1f}")
        position, is_over = replaying.position, replaying.is_over
        if not self._is_dragged:
            self._slider.set_value(round(position, 1))
        self._time.set_text(f"{position:,.1f} of {replaying.duration:,.1f} s")
        self._end.set_visibility(is_over)
        self._again.set_visibility(is_over)
        self._restart.set_visibility(not is_over)
        if self._speed.value != replaying.speed:
            self._speed.set_value(replaying.speed)

    def _drag(self, is_dragged: bool) -> None:
        self._is_dragged = is_dragged

    async def _go(self, seconds: float) -> None:
        if (station := self._station()) is not None:
            await self._attempt(station.replay_from, seconds)
            self.refresh()

    def _set_speed(self) -> None:
        if self._shown is not None and self._speed.value is not None:
            self._shown.speed = float(self._speed.value)
