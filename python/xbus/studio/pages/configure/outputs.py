"""The tab of outputs: quantities with rate, precision and coordinates, and how much of the line they need."""

from __future__ import annotations

import html
from functools import partial

from nicegui import ui

from xbus.protocol.ids import Coordinates, Precision
from xbus.protocol.tables import QUANTITIES
from xbus.protocol.values import EVERY
from xbus.studio.pages.configure.document import Document

__all__ = ["Outputs"]

#: Quantities of the presets; those that the product lacks are left out. None is its highest rate.
PRESETS: dict[str, dict[str, int | None]] = {
    "Orientation at 100 Hz": {
        "packet_counter": EVERY,
        "sample_time_fine": EVERY,
        "quaternion": 100,
        "acceleration": 100,
        "rate_of_turn": 100,
        "status_word": EVERY,
    },
    "Inertial data for processing": {
        "packet_counter": EVERY,
        "sample_time_fine": EVERY,
        "delta_v": None,
        "delta_q": None,
        "magnetic_field": None,
        "status_word": EVERY,
    },
    "Navigation": {
        "packet_counter": EVERY,
        "sample_time_fine": EVERY,
        "utc_time": EVERY,
        "quaternion": 100,
        "lat_lon": 100,
        "altitude_ellipsoid": 100,
        "velocity_xyz": 100,
        "gnss_pvt_data": EVERY,
        "status_word": EVERY,
    },
}


class Outputs:
    """The tab.

    Args:
        document: The settings.
    """

    def __init__(self, document: Document) -> None:
        self._document = document
        link = document.station.device.link
        is_serial = link.is_line and not document.station.is_virtual
        self._baudrate = link.baudrate if is_serial else None
        with ui.element("div").classes("xbus-card w-full"):
            with ui.row().classes("items-center gap-2 w-full"):
                for name, outputs in PRESETS.items():
                    ui.button(name, on_click=partial(self._preset, outputs)).props(
                        "outline dense no-caps size=sm"
                    )
            self._load = ui.html("", sanitize=False).classes("w-full mt-2")
            self._grid = ui.grid(columns="auto auto auto auto 1fr")
            self._grid.classes("items-center gap-x-4 gap-y-0 mt-2")
        self._draw()
        document.draw.append(self._draw)
        document.show.append(self._show_load)

    def _draw(self) -> None:
        """Draws all quantities of the product."""
        self._grid.clear()
        with self._grid:
            for head in ("quantity", "rate", "precision", "coordinates", ""):
                ui.label(head).classes("xbus-quiet text-xs")
            for name in QUANTITIES:
                if rates := self._document.draft.support.rates_of(name):
                    self._output(name, rates)

    def _output(self, name: str, rates: tuple[int, ...]) -> None:
        draft = self._document.draft
        row, output = QUANTITIES[name], draft.output(name)
        frequency = None if output is None else output.frequency

        def change() -> None:
            wanted = rate.value if box.value else None
            self._document.change(
                lambda: draft.set_output(
                    name,
                    wanted,
                    None if precision is None else precision.value,
                    None if coordinates is None else coordinates.value,
                )
            )

        box = ui.checkbox(name, value=output is not None, on_change=change).props("dense")
        box.tooltip(f"{row.manual}, data identifier 0x{row.id:04X} (Table 16)")
        options = {each: "every message" if each == EVERY else f"{each} Hz" for each in rates}
        if frequency is not None and frequency not in options:
            options[frequency] = "highest" if frequency == EVERY else f"{frequency} Hz"
        rate = ui.select(options, value=frequency or rates[0], on_change=change).props(
            "dense borderless"
        )
        precision = coordinates = None
        if row.kind == "real":
            names = [each.name for each in Precision]
            present = (
                output.precision.name
                if output is not None and output.precision is not None
                else names[0]
            )
            precision = ui.select(names, value=present, on_change=change).props("dense borderless")
        else:
            ui.label()
        if row.coordinates:
            systems = [each.name for each in Coordinates]
            system = None if output is None else output.coordinates
            present = system.name if isinstance(system, Coordinates) else systems[0]
            coordinates = ui.select(systems, value=present, on_change=change).props(
                "dense borderless"
            )
        else:
            ui.label()
        ui.label(row.unit).classes("xbus-quiet text-xs")

    def _preset(self, outputs: dict[str, int | None]) -> None:
        draft = self._document.draft
        offered = {name: draft.support.rates_of(name) for name in outputs}
        rates = {
            name: max(each for each in offered[name] if rate is None or each <= rate)
            for name, rate in outputs.items()
            if offered[name]
        }
        self._document.replace(lambda: draft.set(output_configuration=rates))

    def _show_load(self) -> None:
        """Shows how much of the line the outputs need."""
        self._load.set_content(self._line_load())

    def _line_load(self) -> str:
        draft = self._document.draft
        needed, capacity = draft.line_load(self._baudrate)
        if capacity is None:
            return f'<span class="xbus-quiet">about {needed:,} bytes per second</span>'
        share = needed / capacity
        level = "xbus-fault" if share > 1 else "xbus-caution" if share > 0.8 else "xbus-ok"
        reason = draft.overload(self._baudrate) if self._baudrate and share > 1 else None
        text = (
            reason or f"about {needed:,} bytes per second: {share:.0%} of {self._baudrate:,} baud"
        )
        width = min(100.0, 100 * share)
        return (
            '<div class="xbus-bar xbus-track">'
            f'<div class="{level} xbus-bar" style="width:{width:.0f}%">'
            f'</div></div><span class="{level} text-sm">{html.escape(text)}</span>'
        )
