"""The mountpoints of a caster, to choose one: the nearest first."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from nicegui import ui

from xbus.geometry.earth import geodetic_to_ecef
from xbus.rtk import Mountpoint, Position

__all__ = ["Mountpoints", "nearest_first"]

#: Mountpoints that are shown; some casters have thousands.
SHOWN = 50


class Mountpoints:
    """The list.

    Args:
        on_choose: Called with the name of the mountpoint that is chosen.
    """

    def __init__(self, on_choose: Callable[[str], Any]) -> None:
        self._on_choose = on_choose
        self._found: list[tuple[Mountpoint, float | None]] = []
        self._search = ui.input("filter: name, place, format or country", on_change=self._draw)
        self._search.props("dense clearable debounce=300").classes("w-80")
        self._note = ui.label().classes("xbus-quiet text-sm")
        self._rows = ui.column().classes("w-full max-h-96 overflow-auto gap-0 flex-nowrap")
        self.show([], None)

    def show(self, points: Sequence[Mountpoint], position: Position | None) -> None:
        """Shows mountpoints; the position is that of the device, or None."""
        self._found = nearest_first(points, position)
        self._search.set_visibility(len(points) > 1)
        self._draw()

    def show_state(self, text: str) -> None:
        """Shows why there are none yet."""
        self.show([], None)
        self._note.set_text(text)
        self._note.set_visibility(bool(text))

    def _draw(self) -> None:
        wanted = (self._search.value or "").lower().strip()
        found = [(point, far) for point, far in self._found if wanted in _text(point).lower()]
        self._note.set_text(
            _summary(len(found), is_sorted=any(far is not None for _, far in found))
        )
        self._note.set_visibility(bool(self._found))
        self._rows.clear()
        with self._rows:
            for point, far in found[:SHOWN]:
                self._row(point, far)

    def _row(self, point: Mountpoint, far: float | None) -> None:
        with ui.row().classes("items-center w-full no-wrap gap-3"):
            ui.button(point.name, on_click=lambda: self._on_choose(point.name)).props(
                "flat dense no-caps"
            ).classes("shrink-0")
            away = "" if far is None else f"{far / 1000:,.0f} km away"
            needs = "computed for your position" if point.needs_position else ""
            facts = (away, point.place, point.format, point.systems, point.country, needs)
            ui.label(", ".join(filter(None, facts))).classes("text-sm xbus-quiet")


def nearest_first(
    points: Sequence[Mountpoint], position: Position | None
) -> list[tuple[Mountpoint, float | None]]:
    """Returns mountpoints with their distances in m, in a straight line from a position, the nearest first.

    Those whose place is not known, for which many casters write 0° N, 0° E, are the last ones, without a
    distance.
    """
    here = None if position is None else geodetic_to_ecef(position.lat, position.lon, 0.0)

    def distance(point: Mountpoint) -> float | None:
        if here is None or point.lat is None or point.lon is None or point.lat == point.lon == 0:
            return None
        return float(np.linalg.norm(geodetic_to_ecef(point.lat, point.lon, 0.0) - here))

    found = [(point, distance(point)) for point in points]
    return sorted(found, key=lambda each: np.inf if each[1] is None else each[1])


def _text(point: Mountpoint) -> str:
    return " ".join((point.name, point.place, point.format, point.systems, point.country))


def _summary(count: int, *, is_sorted: bool) -> str:
    order = "the nearest first" if is_sorted else "in the order of the caster"
    if count <= SHOWN:
        return f"{count} mountpoints, {order}" if count else "no mountpoint has this text"
    return f"the first {SHOWN} of {count:,} mountpoints, {order}; filter them to find others"
