"""Live data: horizon, plots, numbers, lamps and events."""

from __future__ import annotations

import html
import math
from collections.abc import Callable
from typing import Any

from nicegui import ui

from xbus.protocol.tables import QUANTITIES, STATUS_FLAGS
from xbus.protocol.values import SATELLITE_USED_BIT, GnssSystem
from xbus.studio.commands import command_line
from xbus.studio.components import Attitude3D, Horizon, Map
from xbus.studio.history import History
from xbus.studio.pages.plots import Plots
from xbus.studio.shell import Session
from xbus.studio.station import TRACK, TRACK_SPAN, Station
from xbus.studio.track import Track
from xbus.studio.view import Plot, View
from xbus.watch.attitude import ORIENTATIONS, axes_of
from xbus.watch.model import QuantityState
from xbus.watch.rows import format_elapsed, format_length
from xbus.watch.values import format_rate, format_unit, format_value

__all__ = ["live_page"]

#: Seconds of the track that the map shows.
MAP_SPANS = {60: "1 min", 300: "5 min", int(TRACK_SPAN): "1 h"}
#: Where the positions on the map come from.
SOURCES = {"filter": "filter", "gnss": "GNSS receiver"}
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
    if (replaying := station.replaying) is None:
        session.show_command(
            command_line("monitor", station.source),
            f'for block in xbus.connect("{station.source}").blocks(seconds=0.1): ...',
        )
    else:
        command = command_line("monitor", *replaying.files)
        session.show_command(
            command if len(replaying.files) == 1 else "",  # it takes one file
            f"log = xbus.read_log({[*replaying.files]})",
        )
    # Pages of the same device do not disturb each other; the next one begins with what was shown last.
    view, track = station.view.copy(), Plot(station.source, TRACK)

    def remember(**shown: Any) -> None:
        for name, value in shown.items():
            setattr(view, name, value)
        station.view = view.copy()

    with ui.row().classes("w-full gap-3 items-start no-wrap max-lg:flex-wrap"):
        with ui.column().classes("gap-3 grow min-w-0"):
            plots = Plots(
                session,
                station,
                view,
                on_view=remember,
                on_cursors=lambda: place.mark(plots.history(track)),
            )
        with ui.column().classes("gap-3 w-[430px] shrink-0 max-lg:w-full"):
            with ui.element("div").classes("xbus-card w-full"):
                with ui.tabs().props("dense no-caps align=left") as views:
                    flat, solid = ui.tab("Horizon"), ui.tab("3D")
                panels = ui.tab_panels(views, value=view.attitude).classes("w-full")
                panels.on_value_change(lambda event: remember(attitude=event.value))
                with panels:
                    with ui.tab_panel(flat).classes("p-0"):
                        horizon = Horizon(station.source)
                    with ui.tab_panel(solid).classes("p-0"):
                        _turning(station)
                heading = ui.label().classes("xbus-mono")
            place = _Map(station, view, lambda span: remember(map_span=span))
            with ui.element("div").classes("xbus-card w-full"):
                values = ui.html("", sanitize=False).classes("w-full overflow-x-auto")
            with ui.element("div").classes("xbus-card w-full") as receiver:
                satellites = ui.html("", sanitize=False).classes("w-full overflow-x-auto")
            with ui.element("div").classes("xbus-card w-full"):
                lamps = ui.html("", sanitize=False).classes("w-full")
            with ui.element("div").classes("xbus-card w-full"):
                events = ui.html("", sanitize=False).classes("w-full")
    plots.begin()

    def refresh() -> None:
        horizon.show(ended=replaying is not None and replaying.is_over)
        place.refresh()
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


class _Map:
    """The track of a device on a map, if it sends positions."""

    def __init__(self, station: Station, view: View, on_span: Callable[[int], None]) -> None:
        self._station, self._view = station, view
        with ui.element("div").classes("xbus-card w-full") as self._card:
            with ui.row().classes("w-full items-center justify-between"):
                ui.label("Map").classes("text-sm")
                spans = ui.toggle(MAP_SPANS, value=view.map_span).props("dense flat no-caps")
            self._map = Map(station.source, TRACK, view.map_span)
            spans.on_value_change(lambda event: self._map.show(span=event.value))
            spans.on_value_change(lambda event: on_span(event.value))
            self._place = ui.label().classes("xbus-mono")
            self._origin = ui.label().classes("xbus-quiet text-xs")
        self.refresh()

    def refresh(self) -> None:
        """Shows where the device is now."""
        model, track = self._station.model, self._station.model.track
        self._card.set_visibility(track.source is not None or track.latest is not None)
        pvt = model.current("gnss_pvt_data")
        accuracy = None if pvt is None else float(pvt.value["hAcc"])
        accuracy = None if accuracy is None or not math.isfinite(accuracy) else accuracy
        is_sent = track.quantity is not None and model.current(track.quantity) is not None
        place, origin = _position(track, accuracy, is_sent=is_sent)
        self._place.set_text(place)
        self._origin.set_text(origin)
        is_stale = not (is_sent and track.is_fixed)
        self._map.show(accuracy=accuracy, stale=is_stale, label=f"{place}, {origin}")

    def mark(self, history: History | None) -> None:
        """Marks where the device was at the cursors, by a history."""
        marks, cursors = {}, self._view.cursors
        for name, at in ({} if cursors is None else cursors.times).items():
            found = None if history is None else history.selection(TRACK, at, None)
            if found is not None and found.a is not None and not found.a.is_old:
                east, north = found.a.values.tolist()
                if math.isfinite(east):
                    marks[name] = [east, north]
        self._map.show(marks=marks)


def _position(track: Track, accuracy: float | None, *, is_sent: bool) -> tuple[str, str]:
    """Returns the last position in words, and where it is from."""
    if track.latest is None:
        return "no position", "no fix yet"
    lat, lon = float(track.latest["lat"]), float(track.latest["lon"])
    north, east = "N" if lat >= 0 else "S", "E" if lon >= 0 else "W"
    place = f"{abs(lat):.7f}° {north}, {abs(lon):.7f}° {east}"
    if not is_sent:
        return place, "the last position; none is sent now"
    if track.source is None or not track.is_fixed:
        return place, "the last position; no fix now"
    around = "" if accuracy is None else f"; accuracy by the receiver {format_length(accuracy)}"
    return place, f"position of the {SOURCES[track.source]}{around}"


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
            f"<td>{html.escape(format_unit(quantity))}</td>"
            f'<td class="xbus-latest">{html.escape(text)}</td>'
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
        flag = STATUS_FLAGS[name]
        meaning = flag.values.get(value, str(value)) if flag.width > 1 else ""
        lamps.append(
            f'<span class="xbus-lamp {level}" title="{html.escape(flag.meaning)}">'
            f"{mark} {html.escape(name)} {html.escape(meaning)}</span>"
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
