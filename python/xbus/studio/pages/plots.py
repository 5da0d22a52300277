"""Plots of a device with their controls, keys, and the cursors A and B."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from nicegui import background_tasks, run, ui

from xbus.studio.components import Chart, CursorTable, KeyPress, Keys
from xbus.studio.cursors import NAMES, Cursors, Name
from xbus.studio.history import SPAN, Reading, Selection
from xbus.studio.station import ATTITUDE, TRACK, Station

__all__ = ["Plots", "table_of"]

#: Quantities to plot first, as far as the device sends them.
FIRST = ("acceleration", "rate_of_turn", "magnetic_field", "euler_angles", "quaternion", "delta_v")
#: Number of plots that are drawn at first.
PLOTS = 3
SPANS = {5: "5 s", 10: "10 s", 30: "30 s", 60: "1 min", 300: "5 min"}
#: Series that are drawn in other ways.
HIDDEN = (ATTITUDE, TRACK)
#: After a choice, keys are for the page again; a list takes letters for itself.
BLUR = "() => document.activeElement.blur()"
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
    ("?", "shows this list"),
)
#: The columns of the table of the cursors, and what they mean.
HEADS = (
    ("", "component"),
    ("A", "the last sample at cursor A or before it"),
    ("B", "the last sample at cursor B or before it"),
    ("B - A", "difference of these two; of an angle, the shorter way round"),
    ("n", "samples from one cursor to the other that are numbers"),
    ("mean", "arithmetic mean; like all on its right, of angles without jumps at 180 degrees"),
    ("std", "standard deviation: the root of the mean square of the deviations from the mean"),
    ("min", "smallest value"),
    ("max", "largest value"),
    ("max - min", "peak to peak"),
    ("slope/min", "slope of the line of least squares, per minute"),
)
#: Columns of pixels by which a cursor moves with Shift.
FAST = 10
#: Digits of a number that is no position on the scale, and of the spread of those that are.
DIGITS, SPREAD_DIGITS = 5, 4
#: Decimals of a number, at most.
MAX_DECIMALS = 12


class Plots:
    """The plots of a device, and their controls.

    Args:
        station: The device.
        on_cursors: Called when the cursors have changed, with their times by name.
    """

    def __init__(self, station: Station, on_cursors: Callable[[dict[Name, float]], None]) -> None:
        self._station = station
        self._on_cursors = on_cursors
        self._charts: dict[str, Chart] = {}
        self._span = 10
        self._cursors: Cursors | None = None
        self._is_measuring = self._is_outdated = False
        self._controls()
        self._column = ui.column().classes("w-full gap-2")
        ui.label(
            "Drag over a plot to see a part of the time in detail. Click on a paused plot to set a cursor."
        ).classes("xbus-quiet text-xs")
        keys = [" ", "Escape", "a", "b", "ArrowLeft", "ArrowRight", "+", "=", "-", "?"]
        Keys(keys, self._key)
        self._refresh()
        ui.timer(1.0, self._refresh)

    def _controls(self) -> None:
        self._select = ui.select({}, multiple=True, label="plots", on_change=self._choose)
        self._select.classes("w-full").props("dense use-chips").on("popup-hide", js_handler=BLUR)
        with ui.row().classes("items-center gap-1 w-full"):
            self._time = ui.select(
                SPANS,
                value=self._span,
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
            ui.switch("lock y", on_change=lambda event: self._show(locked=event.value)).tooltip(
                "keeps the present limits of the y axes"
            )
            ui.button(icon="keyboard", on_click=self._help).props(
                "dense flat round aria-label='keys of this page'"
            ).tooltip("keys of this page")

    def table(self) -> None:
        """Draws the table of the cursors, which is there while one is set."""
        with ui.element("div").classes("xbus-dock w-full") as self._dock:
            self._table = CursorTable()
            self._table.show(heads=HEADS)
        self._dock.set_visibility(False)

    def _refresh(self) -> None:
        """Offers new series, and draws the first plots once their series exist."""
        names = [name for name in self._station.history.series if name not in HIDDEN]
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
                    chart = Chart(
                        self._station.source, series[name], self._span, self._zoom, self._place
                    )
                    self._charts[name] = chart
                    chart.show(**self._view)
        self._measure()

    @property
    def _view(self) -> dict[str, Any]:
        """What all charts show."""
        cursors = self._cursors
        if cursors is None:
            return {"view": None, "cursors": {}, "active": None}
        return {
            "view": [cursors.begin, cursors.end],
            "cursors": dict(cursors.times),
            "active": cursors.active,
        }

    def _show(self, **props: object) -> None:
        for chart in self._charts.values():
            chart.show(**props)

    def _update(self) -> None:
        """Shows the view and the cursors as they are now."""
        cursors = self._cursors
        self._pause.set_text("Pause" if cursors is None else "Resume")
        self._pause.props(f"icon={'pause' if cursors is None else 'play_arrow'}")
        for name, button in self._buttons.items():
            is_active = cursors is not None and bool(cursors.times) and cursors.active == name
            button.props(remove="flat unelevated color")
            button.props("unelevated color=primary" if is_active else "flat color=primary")
        self._show(**self._view)
        self._measure()

    def _set_span(self, span: int) -> None:
        self._span = span
        self._resume()
        self._show(span=span)

    def _pause_now(self) -> Cursors:
        if self._cursors is None:
            ends = [each.time[-1:] for each in self._station.history.series.values()]
            last = float(max((end[0] for end in ends if len(end)), default=time.time()))
            self._cursors = Cursors(last - SPAN, last, last - self._span, last)
        return self._cursors

    def _resume(self) -> None:
        self._cursors = None
        self._update()

    def _toggle(self) -> None:
        if self._cursors is not None:
            self._resume()
        else:
            self._pause_now()
            self._update()

    def _zoom(self, begin: float, end: float) -> None:
        self._pause_now().show(begin, end)
        self._update()

    def _zoom_by(self, factor: float) -> None:
        """Shows more or less of the time; live plots have the spans that can be chosen."""
        if self._cursors is not None:
            self._cursors.zoom(factor)
            self._update()
            return
        spans = list(SPANS)
        place = spans.index(self._span) + (1 if factor > 1 else -1)
        self._time.set_value(spans[min(max(place, 0), len(spans) - 1)])

    def _place(self, at: float) -> None:
        if self._cursors is not None:
            self._cursors.place(at)
            self._update()

    def _place_at(self, name: Name, at: float | None) -> None:
        self._pause_now().choose(name, at)
        self._update()

    def _key(self, press: KeyPress) -> None:
        match press.key:
            case " ":
                self._toggle()
            case "Escape":
                self._resume()
            case "a" | "b" as letter:
                self._place_at("A" if letter == "a" else "B", press.time)
            case "ArrowLeft" | "ArrowRight" if self._cursors is not None:
                column = (self._cursors.end - self._cursors.begin) / max(press.columns, 1)
                count = FAST if press.shift else 1
                self._cursors.move(column * (count if press.key == "ArrowRight" else -count))
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
                times = {} if self._cursors is None else dict(self._cursors.times)
                names = list(self._charts)
                found = await run.io_bound(_selections, self._station, names, times)
                if self._dock.is_deleted:
                    return
                self._draw_table(times, found or [])
        finally:
            self._is_measuring = False

    def _draw_table(self, times: dict[Name, float], found: list[Selection]) -> None:
        active = None if self._cursors is None else self._cursors.active
        a, b = times.get("A"), times.get("B")
        self._table.show(
            cursors=[
                {"name": name, "time": times[name], "active": name == active}
                for name in NAMES
                if name in times
            ],
            apart="" if a is None or b is None else _apart(b - a),
            groups=[table_of(each, a, b) for each in found],
        )
        self._dock.set_visibility(bool(times))
        self._on_cursors(times)


def _selections(station: Station, names: list[str], times: dict[Name, float]) -> list[Selection]:
    if not times:
        return []
    a, b = times.get("A"), times.get("B")
    found = (station.history.selection(name, a, b) for name in names)
    return [each for each in found if each is not None]


def _apart(seconds: float) -> str:
    return f"B - A {seconds:.6f} s" + (f", {1 / abs(seconds):.5g} Hz" if seconds else "")


def table_of(selection: Selection, a: float | None, b: float | None) -> dict[str, Any]:
    """Returns the rows about a series for the table of the cursors.

    Args:
        selection: The series at the cursors and between them.
        a: Time of cursor A; None without one.
        b: Time of cursor B; None without one.
    """
    series = selection.series
    notes = []
    if selection.lost is not None:
        notes.append(_lost(selection.lost))
    starts = [at for at in (a, b) if at is not None]
    if starts and min(starts) < selection.first:
        late = selection.first - min(starts)
        notes.append(f"the samples begin {late:.3g} s after the first cursor")
    readings = {"A": selection.a, "B": selection.b}
    old = [name for name, reading in readings.items() if reading is not None and reading.is_old]
    for name, at in (("A", a), ("B", b)):
        if name in old and at is not None and (reading := readings[name]) is not None:
            notes.append(f"{name}: the last sample is {at - reading.time:.3g} s older")
    return {
        "name": series.name,
        "title": f"{series.name} [{series.unit}]" if series.unit else series.name,
        "notes": notes,
        "old": old,
        "rows": [_row(selection, at) for at in range(len(series.fields))],
    }


def _lost(seconds: float) -> str:
    if math.isnan(seconds):
        return "too few samples to know what is lost"
    return f"lost {seconds:.3f} s" if seconds else "nothing lost"


def _row(selection: Selection, at: int) -> list[str]:
    """Returns the cells of a component."""

    def value(reading: Reading | None) -> float:
        return math.nan if reading is None else float(reading.values[at])

    before, after, statistics = value(selection.a), value(selection.b), selection.statistics
    field = selection.series.fields[at]
    if statistics is None:
        spread = 0.0
        rest = [""] * (len(HEADS) - 4)
    else:
        spread = float(statistics.peak_to_peak[at])
        places = [statistics.mean, statistics.minimum, statistics.maximum]
        mean, low, high = (_place(float(each[at]), spread) for each in places)
        widths = [statistics.std, statistics.peak_to_peak, statistics.slope]
        std, width, slope = (_width(float(each[at])) for each in widths)
        rest = [str(int(statistics.number[at])), mean, std, low, high, width, slope]
    change = "" if selection.change is None else _width(float(selection.change[at]))
    return [field, _place(before, spread), _place(after, spread), change, *rest]


def _place(value: float, spread: float) -> str:
    """Returns a value with the digits that show how it differs from others that are ``spread`` apart."""
    if not math.isfinite(value):
        return "-"
    if not (spread > 0 and math.isfinite(spread)):
        return f"{value:.9g}"
    decimals = min(max(SPREAD_DIGITS - 1 - math.floor(math.log10(spread)), 0), MAX_DECIMALS)
    return f"{np.round(value, decimals) + 0.0:.{decimals}f}"


def _width(value: float) -> str:
    return "-" if not math.isfinite(value) else f"{value:.{DIGITS}g}"
