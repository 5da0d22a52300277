"""Live data: horizon, plots, numbers, lamps and events."""

from __future__ import annotations

import html
import time

from nicegui import ui

from xbus.protocol.tables import QUANTITIES
from xbus.protocol.values import SATELLITE_USED_BIT, GnssSystem
from xbus.studio.components import Attitude3D, Chart, Horizon
from xbus.studio.shell import Session
from xbus.studio.station import Station
from xbus.watch.attitude import ORIENTATIONS, axes_of
from xbus.watch.model import QuantityState
from xbus.watch.rows import format_elapsed
from xbus.watch.values import format_rate, format_unit, format_value

__all__ = ["live_page"]

#: Quantities to plot first, as far as the device sends them.
FIRST = ("acceleration", "rate_of_turn", "magnetic_field", "euler_angles", "quaternion", "delta_v")
#: Number of plots that are drawn at first.
PLOTS = 3
SPANS = {5: "5 s", 10: "10 s", 30: "30 s", 60: "1 min", 300: "5 min"}
#: Names of satellite systems by number, and a colour for each.
SYSTEMS = {system.value: system.label for system in GnssSystem}
COLORS = ("#0072B2", "#CC79A7", "#009E73", "#D55E00", "#999999", "#56B4E9", "#E69F00")
#: Width of the bar of a satellite, and height of the strongest signal, in pixels; a decibel is one.
WIDTH, HEIGHT = 16, 64
#: Age in seconds from which a value that has stopped is a dash.
GONE = 3.0


def live_page(session: Session) -> None:
    """Shows the selected device."""
    if (station := session.require_station()) is None:
        return
    session.show_command(
        f"xbus monitor {station.source}",
        f'for block in xbus.connect("{station.source}").blocks(seconds=0.1): ...',
    )
    with ui.row().classes("w-full gap-3 items-start no-wrap max-lg:flex-wrap"):
        with ui.column().classes("gap-3 grow min-w-0"):
            _Plots(station)
        with ui.column().classes("gap-3 w-[430px] shrink-0 max-lg:w-full"):
            with ui.element("div").classes("xbus-card w-full"):
                with ui.tabs().props("dense no-caps align=left") as views:
                    flat, solid = ui.tab("Horizon"), ui.tab("3D")
                with ui.tab_panels(views, value=flat).classes("w-full"):
                    with ui.tab_panel(flat).classes("p-0"):
                        Horizon(station.source)
                    with ui.tab_panel(solid).classes("p-0"):
                        _turning(station)
                heading = ui.label().classes("xbus-mono")
            with ui.element("div").classes("xbus-card w-full"):
                values = ui.html("", sanitize=False).classes("w-full overflow-x-auto")
            with ui.element("div").classes("xbus-card w-full") as receiver:
                satellites = ui.html("", sanitize=False).classes("w-full overflow-x-auto")
            with ui.element("div").classes("xbus-card w-full"):
                lamps = ui.html("", sanitize=False).classes("w-full")
            with ui.element("div").classes("xbus-card w-full"):
                events = ui.html("", sanitize=False).classes("w-full")

    def refresh() -> None:
        heading.set_text(_heading(station))
        values.set_content(_values(station))
        satellites.set_content(_satellites(station))
        receiver.set_visibility(bool(satellites.content))
        lamps.set_content(_lamps(station))
        events.set_content(_events(station))

    refresh()
    ui.timer(0.2, refresh)


def _turning(station: Station) -> None:
    """Draws the device in 3D, and turns it."""
    view = Attitude3D()
    ui.label("world axes: east, north, up").classes("xbus-quiet text-xs")

    def turn() -> None:
        for name in ORIENTATIONS:
            quantity = station.model.current(name)
            if quantity is not None:
                axes = axes_of(name, quantity.coordinates, quantity.value)
                if axes is not None:
                    view.turn(axes)
                return

    ui.timer(0.1, turn)


class _Plots:
    """The plots of a device, and their controls."""

    def __init__(self, station: Station) -> None:
        self._station = station
        self._charts: dict[str, Chart] = {}
        self._span = 10.0
        with ui.row().classes("items-center gap-2 w-full"):
            self._select = ui.select(
                {}, multiple=True, label="plots", on_change=self._choose
            ).classes("grow")
            self._select.props("dense use-chips")
            ui.select(
                SPANS, value=10, label="time", on_change=lambda event: self._set_span(event.value)
            ).props("dense")
            self._pause = (
                ui.button("Pause", icon="pause", on_click=self._toggle)
                .props("flat dense no-caps")
                .mark("pause")
            )
            ui.switch("lock y", on_change=lambda event: self._show(locked=event.value)).tooltip(
                "keeps the present limits of the y axes"
            )
        self._column = ui.column().classes("w-full gap-2")
        ui.label("Drag over a plot to see a part of the time in detail; Resume goes on.").classes(
            "xbus-quiet text-xs"
        )
        self._refresh()
        ui.timer(1.0, self._refresh)
        ui.keyboard(on_key=self._key)

    def _refresh(self) -> None:
        """Offers new series, and draws the first plots once their series exist."""
        names = [name for name in self._station.history.series if name != "attitude"]
        if names != list(self._select.options):
            self._select.set_options(names)
        if not self._select.value and names:
            first = [name for wanted in FIRST for name in names if name.split()[0] == wanted]
            self._select.set_value((first or names)[:PLOTS])

    def _choose(self) -> None:
        wanted, series = list(self._select.value or []), self._station.history.series
        for name in [name for name in self._charts if name not in wanted]:
            self._charts.pop(name).delete()
        with self._column:
            for name in wanted:
                if name not in self._charts and name in series:
                    self._charts[name] = Chart(
                        self._station.source, series[name], self._span, self._zoom
                    )

    def _show(self, **props: object) -> None:
        for chart in self._charts.values():
            chart.show(**props)

    def _set_span(self, span: float) -> None:
        self._span = float(span)
        self._resume()
        self._show(span=self._span)

    def _zoom(self, begin: float, end: float) -> None:
        self._pause.set_text("Resume")
        self._pause.props("icon=play_arrow")
        self._show(view=[begin, end])

    def _resume(self) -> None:
        self._pause.set_text("Pause")
        self._pause.props("icon=pause")
        self._show(view=None)

    def _toggle(self) -> None:
        if self._pause.text == "Resume":
            self._resume()
        else:
            now = max(
                (each.time[-1] for each in self._station.history.series.values() if len(each.time)),
                default=time.time(),
            )
            self._zoom(float(now) - self._span, float(now))

    def _key(self, event: object) -> None:
        if event.action.keydown and event.key == " ":  # type: ignore[attr-defined]
            self._toggle()


def _heading(station: Station) -> str:
    attitude = station.model.attitude
    if attitude is None:
        return "no attitude"
    near = ", near the zenith: heading and roll are not defined" if abs(attitude.pitch) > 88 else ""
    return (
        f"heading {attitude.heading % 360:05.1f}° {attitude.point}  "
        f"pitch {attitude.pitch + 0:+.1f}°  roll {attitude.roll + 0:+.1f}°{near}"
    )


def _values(station: Station) -> str:
    model = station.model
    rows = []
    for quantity in list(model.quantities.values()):
        age = model.now - quantity.updated_at
        row = QUANTITIES.get(quantity.name)
        title = "" if row is None else f"{row.manual}, data identifier 0x{row.id:04X}"
        is_stale = quantity.has_stopped(model.now)
        text = "–" if is_stale and age > GONE else format_value(quantity)
        rows.append(
            f'<tr class="{"xbus-stale" if is_stale else ""}" title="{html.escape(title)}">'
            f"<td>{html.escape(quantity.name)}</td><td>{_rate(quantity, model.now)}</td>"
            f"<td>{html.escape(format_unit(quantity))}</td><td>{html.escape(text)}</td>"
            f"<td>{f'{age:.0f} s ago' if is_stale else ''}</td></tr>"
        )
    head = "<tr><th>quantity</th><th>Hz</th><th>unit</th><th>latest</th><th></th></tr>"
    return f'<table class="xbus-table xbus-mono">{head}{"".join(rows)}</table>'


def _rate(quantity: QuantityState, now: float) -> str:
    return html.escape(format_rate(quantity.rate(now)))


def _satellites(station: Station) -> str:
    """Returns the signals of the satellites as bars; an empty string if the device sends none."""
    quantity = station.model.current("gnss_sat_info")
    if quantity is None or not len(quantity.value):
        return ""
    rows = sorted(quantity.value.tolist(), key=lambda row: (row[0], row[1]))
    bars = "".join(_signal(place, *row) for place, row in enumerate(rows))
    legend = " ".join(
        f'<span style="color:{_color(system)}">■</span> {SYSTEMS.get(system, f"system {system}")}'
        for system in sorted({row[0] for row in rows})
    )
    return (
        f'<div class="text-sm">signals, dBHz: {legend}; pale: not used</div>'
        f'<svg width="{WIDTH * len(rows)}" height="{HEIGHT + 14}">{bars}</svg>'
    )


def _signal(place: int, system: int, number: int, strength: int, flags: int) -> str:
    """Returns the bar of a satellite."""
    name = f"{SYSTEMS.get(system, f'system {system}')} {number}: {strength} dBHz"
    return (
        f'<g transform="translate({WIDTH * place},0)"><title>{name}</title>'
        f'<rect x="2" width="{WIDTH - 4}" y="{HEIGHT - strength}" height="{strength}" '
        f'fill="{_color(system)}" opacity="{1 if flags >> SATELLITE_USED_BIT & 1 else 0.35}"/>'
        f'<text x="{WIDTH / 2}" y="{HEIGHT + 11}" text-anchor="middle" font-size="8" '
        f'fill="currentColor">{number}</text></g>'
    )


def _color(system: int) -> str:
    return COLORS[system % len(COLORS)]


def _lamps(station: Station) -> str:
    status = station.model.status
    if status is None:
        return '<span class="xbus-quiet">no status word</span>'
    lamps = []
    for name, value in QUANTITIES[status.name].fields_of(int(status.value)).items():
        bad = name.startswith("clip") and value
        missing = name == "filter_valid" and not value
        level = (
            "xbus-fault"
            if bad
            else "xbus-caution"
            if missing
            else "xbus-ok"
            if value
            else "xbus-quiet"
        )
        mark = "●" if value else "○"
        lamps.append(
            f'<span class="xbus-lamp {level}">{mark} {html.escape(name)} {value if value > 1 else ""}</span>'
        )
    return '<div style="display:flex;flex-wrap:wrap;gap:4px">' + "".join(lamps) + "</div>"


def _events(station: Station) -> str:
    events = list(station.model.events)[-12:]
    if not events:
        return '<span class="xbus-quiet">no events</span>'
    return "".join(
        f'<div class="{"xbus-fault" if event.is_bad else "xbus-quiet"}">{format_elapsed(event.at)} '
        f"{html.escape(event.text)}</div>"
        for event in reversed(events)
    )
