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

#: Quantities of the presets, of which the page names those that the product lacks. None is the highest rate.
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
                    button = ui.button(name, on_click=partial(self._preset, outputs))
                    button.props("outline no-caps")
            self._left_out = ui.label().classes("xbus-caution text-sm mt-1")
            self._load = ui.html("", sanitize=False).classes("w-full mt-2")
            self._grid = ui.grid(columns="auto auto auto auto 1fr")
            self._grid.classes("items-center gap-x-4 gap-y-0 mt-2")
        self._draw()
        document.draw.append(self._draw)
        document.show.append(self._show_load)

    def _draw(self) -> None:
        """Draws all quantities of the product."""
        self._left_out.set_text("")
        self._grid.clear()
        with self._grid:
            for head in ("quantity", "rate", "precision", "coordinates", ""):
                ui.label(head).classes("xbus-quiet text-xs")
            for name in QUANTITIES:
                if rates := self._document.draft.support.rates_of(name):
                    self._output(name, rates)

    def _output(self, name: str, rates: tuple[int, ...]) -> None:
        """Draws one quantity. Without a rate it is not sent; a rate that is chosen ticks it."""
        draft = self._document.draft
        row, output = QUANTITIES[name], draft.output(name)
        frequency = None if output is None else output.frequency

        def tick() -> None:
            if box.value != (rate.value is not None):
                rate.set_value(rates[0] if box.value else None)

        def change() -> None:
            box.set_value(rate.value is not None)
            show_highest()
            self._document.change(
                lambda: draft.set_output(
                    name,
                    rate.value,
                    None if precision is None else precision.value,
                    None if coordinates is None else coordinates.value,
                )
            )

        def show_highest() -> None:
            highest = "every message" if rates[0] == EVERY else f"up to {rates[0]} Hz"
            if rate.value is None:
                rate.props(f'display-value="{highest}"').classes("xbus-offered")
            else:
                rate.props(remove="display-value").classes(remove="xbus-offered")

        box = ui.checkbox(name, value=output is not None, on_change=tick).props("dense")
        box.tooltip(f"{row.manual}, data identifier 0x{row.id:04X} (Table 16)")
        options = {each: "every message" if each == EVERY else f"{each} Hz" for each in rates}
        if frequency is not None and frequency not in options:
            options[frequency] = "highest" if frequency == EVERY else f"{frequency} Hz"
        rate = ui.select(options, value=frequency, on_change=change)
        rate.props(f'dense borderless aria-label="rate of {name}"')
        show_highest()

        def format_of(kind: str, names: list[str], present: str) -> ui.select:
            control = ui.select(names, value=present, on_change=change)
            control.props(f'dense borderless aria-label="{kind} of {name}"')
            return control.bind_enabled_from(box, "value")

        precision = coordinates = None
        if row.kind == "real":
            names = [each.name for each in Precision]
            number = None if output is None else output.precision
            present = names[0] if number is None else number.name
            precision = format_of("precision", names, present)
        else:
            ui.label()
        if row.coordinates:
            names = [each.name for each in Coordinates]
            system = None if output is None else output.coordinates
            present = system.name if isinstance(system, Coordinates) else names[0]
            coordinates = format_of("coordinates", names, present)
        else:
            ui.label()
        ui.label(row.unit).classes("xbus-quiet text-xs")

    def _preset(self, outputs: dict[str, int | None]) -> None:
        draft = self._document.draft
        offered = {name: draft.support.rates_of(name) for name in outputs}
        rates = {
            name: max(
                (each for each in offered[name] if rate is None or each <= rate),
                default=offered[name][-1],
            )
            for name, rate in outputs.items()
            if offered[name]
        }
        self._document.replace(lambda: draft.set(output_configuration=rates))
        if lacking := [name for name in outputs if name not in rates]:
            product = draft.support.product.title
            self._left_out.set_text(
                f"Left out, because the {product} does not have them: {', '.join(lacking)}"
            )

    def _show_load(self) -> None:
        """Shows how much of the line the outputs need."""
        self._load.set_content(self._line_load())

    def _line_load(self) -> str:
        draft = self._document.draft
        needed, capacity = draft.line_load(self._baudrate)
        if capacity is None:
            text = f"about {needed:,} bytes per second; this connection has no limit by baud rate"
            return f'<span class="xbus-quiet">{text}</span>'
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
