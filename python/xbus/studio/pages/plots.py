"""Plots of a device with their controls, keys, and the cursors A and B."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from nicegui import background_tasks, run, ui

from xbus.studio.components import BLUR, Chart, CursorTable, KeyPress, Keys
from xbus.studio.cursor_table import HEADS, apart, table_of
from xbus.studio.cursors import NAMES, Cursors, Name
from xbus.studio.history import SPAN, History, Selection
from xbus.studio.shell import Session
from xbus.studio.station import ATTITUDE, TRACK, Station
from xbus.studio.view import Held, Plot, View

__all__ = ["Plots"]

#: Quantities to plot first, as far as the device sends them.
FIRST = ("acceleration", "rate_of_turn", "magnetic_field", "euler_angles", "quaternion", "delta_v")
#: Number of plots that are drawn at first.
PLOTS = 3
SPANS = {5: "5 s", 10: "10 s", 30: "30 s", 60: "1 min", 300: "5 min"}
#: Series that are drawn in other ways.
HIDDEN = (ATTITUDE, TRACK)
HINT = (
    "Drag over a plot to see a part of the time in detail. Click on a paused plot to set a cursor."
)
OTHERS = "The list of plots ends with the quantities of the other devices."
#: The keys of the page, for the user.
HELP = (
    ("Space", "pauses the plots, and resumes them"),
    ("Escape", "resumes the plots and removes the cursors"),
    (
        "A, B",
        "put cursor A or B at the mouse, or else into the plots; a click moves the cursor too",
    ),
    ("←, →", "move the cursor by a column of pixels, with Shift by ten"),
    ("+, -", "show less or more time"),
    ("C", "clears the counts of losses, damage and samples out of range"),
    ("?", "shows this list"),
)
#: Columns of pixels by which a cursor moves with Shift.
FAST = 10


class Plots:
    """The plots of a device, and their controls.

    Args:
        session: The page.
        station: The device.
        view: What is shown, which changes with the controls.
        on_view: Called when it has changed.
        on_cursors: Called when the cursors have changed.
    """

    def __init__(
        self,
        session: Session,
        station: Station,
        view: View,
        *,
        on_view: Callable[[], None],
        on_cursors: Callable[[], None],
    ) -> None:
        self._hub, self._station, self._view = session.hub, station, view
        self._on_view, self._on_cursors = on_view, on_cursors
        self._charts: dict[Plot, Chart] = {}
        self._titles: dict[Plot, str] = {}
        self._is_measuring = self._is_outdated = False
        self._controls()
        self._column = ui.element("div")
        self._arrange()
        self._hint = ui.label(HINT).classes("xbus-quiet text-xs")
        keys = [" ", "Escape", "a", "b", "c", "ArrowLeft", "ArrowRight", "+", "=", "-", "?"]
        Keys(keys, self._key)

    def _controls(self) -> None:
        view = self._view
        self._select = ui.select(
            {}, value=view.plots, multiple=True, label="plots", on_change=self._choose
        )
        self._select.classes("w-full").props("dense use-chips").on("popup-hide", js_handler=BLUR)
        with ui.row().classes("items-center gap-1 w-full"):
            self._time = ui.select(
                SPANS,
                value=view.span,
                label="time",
                on_change=lambda event: self._set_span(event.value),
            ).props("dense")
            self._time.on("popup-hide", js_handler=BLUR)
            self._pause = (
                ui.button("Pause", icon="pause", on_click=self._toggle)
                .props("flat dense no-caps")
                .classes("w-24")  # the other controls keep their places
                .mark("pause")
            )
            self._buttons = {}
            for name in NAMES:
                button = ui.button(name, on_click=lambda name=name: self._place_at(name, None))
                button.props(f"dense flat aria-label='cursor {name}'").classes("w-8").tooltip(
                    f"cursor {name}: values, and statistics between A and B"
                )
                self._buttons[name] = button
            for icon, text, factor in (
                ("zoom_in", "less time", 0.5),
                ("zoom_out", "more time", 2.0),
            ):
                ui.button(icon=icon, on_click=lambda factor=factor: self._zoom_by(factor)).props(
                    f"dense flat round aria-label='{text}'"
                ).tooltip(text)
            ui.switch(
                "lock y",
                value=view.limits is not None,
                on_change=lambda event: self._set_locked(event.value),
            ).tooltip("keeps the present limits of the y axes")
            ui.button(icon="grid_view", on_click=self._toggle_grid).props(
                "dense flat round aria-label='two plots side by side'"
            ).tooltip("two plots side by side, or one below the other")
            ui.button(icon="keyboard", on_click=self._help).props(
                "dense flat round aria-label='keys of this page'"
            ).tooltip("keys of this page")

    def begin(self) -> None:
        """Draws the plots, and the table of the cursors, which is there while one is set."""
        with ui.element("div").classes("xbus-dock w-full") as self._dock:
            self._table = CursorTable()
            self._table.show(heads=HEADS, elapsed=self._station.replaying is not None)
        self._dock.set_visibility(False)
        self._refresh()
        self._update()
        ui.timer(0.5, self._refresh)

    def _refresh(self) -> None:
        """Offers new series, and draws plots once their series exist."""
        offered = self._offered()
        if offered != self._titles:
            # What is in the list keeps its place, because the user may be choosing.
            before = {plot: offered[plot] for plot in self._titles if plot in offered}
            self._titles = offered = before | offered
            self._select.set_options(offered)
            has_others = any(plot.source != self._station.source for plot in offered)
            self._hint.set_text(f"{HINT} {OTHERS}" if has_others else HINT)
        plots, stations = self._view.plots, self._hub.stations
        if plots is None:
            own = [plot for plot in offered if plot.source == self._station.source]
            first = [plot for wanted in FIRST for plot in own if plot.name.split()[0] == wanted]
            if own:
                self._select.set_value((first or own)[:PLOTS])
        elif any(plot.source not in stations for plot in plots):
            self._select.set_value([plot for plot in plots if plot.source in stations])
        else:
            self._draw()
        self._show()

    def _offered(self) -> dict[Plot, str]:
        """Returns the series that can be plotted, and their titles: those of other devices too.

        The times of a recording are others than those of a device.
        """
        own = self._station
        offered = {Plot(own.source, name): name for name in _series_names(own)}
        if own.replaying is None:
            for source, (station, title) in self._hub.titled().items():
                if station is not own and station.replaying is None:
                    names = _series_names(station)
                    offered |= {Plot(source, name): f"{name}, {title}" for name in names}
        return offered

    def history(self, plot: Plot) -> History | None:
        """Returns the history with the samples of a plot, which are held while plots are paused.

        Returns:
            None if its device is closed.
        """
        station, held = self._hub.stations.get(plot.source), self._view.held
        if held is None:
            return None if station is None else station.history
        if station is not None:
            held.hold(plot, station.history)
        return held.history(plot.source)

    def _choose(self) -> None:
        self._view.plots = list(self._select.value or [])
        self._draw()
        self._on_view()

    def _draw(self) -> None:
        """Draws the plots that are chosen, as soon as their series exist."""
        wanted = self._view.plots or []
        before = list(self._charts)
        for plot in [plot for plot in self._charts if plot not in wanted]:
            self._charts.pop(plot).delete()
        with self._column:
            for plot in wanted:
                if plot not in self._charts:
                    self._draw_one(plot)
        if before != list(self._charts):
            self._show()
            self._measure()

    def _draw_one(self, plot: Plot) -> None:
        history = self.history(plot)
        series = None if history is None else history.series.get(plot.name)
        if series is not None:
            self._charts[plot] = Chart(
                plot.source,
                series,
                self._titles.get(plot, plot.name),
                (self._view.limits or {}).get(plot),
                on_zoom=self._zoom,
                on_place=self._place,
                on_lock=lambda low, high: self._keep_limits(plot, low, high),
            )

    def _show(self) -> None:
        """Makes the charts show the view as it is now."""
        view, cursors, replaying = self._view, self._view.cursors, self._station.replaying
        props: dict[str, Any] = {
            "span": view.span,
            "locked": view.limits is not None,
            "view": None if cursors is None else [cursors.begin, cursors.end],
            "held": None if view.held is None else view.held.number,
            "cursors": {} if cursors is None else dict(cursors.times),
            "active": None if cursors is None else cursors.active,
            "elapsed": replaying is not None,
            "speed": 1 if replaying is None else 0 if replaying.is_over else replaying.speed,
        }
        for chart in self._charts.values():
            chart.show(**props)

    def _update(self) -> None:
        """Shows the view and the cursors as they are now."""
        cursors = self._view.cursors
        self._pause.set_text("Pause" if cursors is None else "Resume")
        self._pause.props(f"icon={'pause' if cursors is None else 'play_arrow'}")
        for name, button in self._buttons.items():
            is_active = cursors is not None and bool(cursors.times) and cursors.active == name
            button.props(remove="flat unelevated color")
            button.props("unelevated color=primary" if is_active else "flat color=primary")
        self._show()
        self._measure()
        self._on_view()

    def _set_span(self, span: int) -> None:
        self._view.span = span
        self._resume()

    def _toggle_grid(self) -> None:
        self._view.is_grid = not self._view.is_grid
        self._arrange()
        self._on_view()

    def _arrange(self) -> None:
        grid = " xbus-grid" if self._view.is_grid else ""
        self._column.classes(replace=f"xbus-plots{grid} w-full")

    def _set_locked(self, is_locked: bool) -> None:
        self._view.limits = {} if is_locked else None
        self._show()
        self._on_view()

    def _keep_limits(self, plot: Plot, low: float, high: float) -> None:
        if self._view.limits is not None:
            self._view.limits[plot] = low, high
            self._on_view()

    def _pause_now(self) -> Cursors:
        view = self._view
        if view.cursors is None:
            ends = [each.time[-1:] for each in self._station.history.series.values()]
            last = float(max((end[0] for end in ends if len(end)), default=time.time()))
            view.cursors = Cursors(last - SPAN, last, last - view.span, last)
            view.held = Held(last)
            for plot in (*self._charts, Plot(self._station.source, TRACK)):
                self.history(plot)  # holds it
        return view.cursors

    def _resume(self) -> None:
        self._view.cursors = self._view.held = None
        self._update()

    def _toggle(self) -> None:
        if self._view.cursors is not None:
            self._resume()
        else:
            self._pause_now()
            self._update()

    def _zoom(self, begin: float, end: float) -> None:
        self._pause_now().show(begin, end)
        self._update()

    def _zoom_by(self, factor: float) -> None:
        """Shows more or less of the time; live plots have the spans that can be chosen."""
        if self._view.cursors is not None:
            self._view.cursors.zoom(factor)
            self._update()
            return
        spans = list(SPANS)
        place = spans.index(self._view.span) + (1 if factor > 1 else -1)
        self._time.set_value(spans[min(max(place, 0), len(spans) - 1)])

    def _place(self, at: float) -> None:
        if self._view.cursors is not None:
            self._view.cursors.place(at)
            self._update()

    def _place_at(self, name: Name, at: float | None) -> None:
        self._pause_now().choose(name, at)
        self._update()

    def _key(self, press: KeyPress) -> None:
        cursors = self._view.cursors
        match press.key:
            case " ":
                self._toggle()
            case "Escape":
                self._resume()
            case "a" | "b" as letter:
                self._place_at("A" if letter == "a" else "B", press.time)
            case "c":
                self._station.clear_counts()
            case "ArrowLeft" | "ArrowRight" if cursors is not None:
                column = (cursors.end - cursors.begin) / max(press.columns, 1)
                count = FAST if press.shift else 1
                cursors.move(column * (count if press.key == "ArrowRight" else -count))
                self._update()
            case "+" | "=":
                self._zoom_by(0.5)
            case "-":
                self._zoom_by(2.0)
            case "?":
                self._help()

    def _help(self) -> None:
        with ui.dialog() as dialog, ui.card().classes("xbus-card"):
            ui.label("Keys").classes("font-semibold")
            with ui.grid(columns="auto 1fr").classes("gap-x-4 gap-y-1"):
                for keys, text in HELP:
                    ui.label(keys).classes("xbus-mono")
                    ui.label(text)
            ui.button("Close", on_click=dialog.close).props("flat dense no-caps")
        dialog.on("hide", dialog.delete)
        dialog.open()

    def _measure(self) -> None:
        """Computes what is at the cursors and between them, in a thread; the last state wins."""
        self._is_outdated = True
        if not self._is_measuring:
            self._is_measuring = True
            background_tasks.create(self._measure_until_done())

    async def _measure_until_done(self) -> None:
        try:
            while self._is_outdated:
                self._is_outdated = False
                cursors = self._view.cursors
                times = {} if cursors is None else dict(cursors.times)
                shown = [(plot, self.history(plot)) for plot in self._charts]
                found = await run.io_bound(_selections, shown, times)
                if self._dock.is_deleted:
                    return
                self._draw_table(times, found or [])
        finally:
            self._is_measuring = False

    def _draw_table(self, times: dict[Name, float], found: list[tuple[Plot, Selection]]) -> None:
        active = None if self._view.cursors is None else self._view.cursors.active
        a, b = times.get("A"), times.get("B")
        self._table.show(
            cursors=[
                {"name": name, "time": times[name], "active": name == active}
                for name in NAMES
                if name in times
            ],
            apart="" if a is None or b is None else apart(b - a),
            groups=[
                table_of(self._titles.get(plot, plot.name), each, a, b) for plot, each in found
            ],
        )
        self._dock.set_visibility(bool(times))
        self._on_cursors()


def _series_names(station: Station) -> list[str]:
    return [name for name in station.history.series if name not in HIDDEN]


def _selections(
    shown: list[tuple[Plot, History | None]], times: dict[Name, float]
) -> list[tuple[Plot, Selection]]:
    """Returns what the series of plots are at the cursors."""
    a, b = times.get("A"), times.get("B")
    found = [
        (plot, None if history is None or not times else history.selection(plot.name, a, b))
        for plot, history in shown
    ]
    return [(plot, selection) for plot, selection in found if selection is not None]
