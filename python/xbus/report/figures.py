"""The plots of a report, as plotly takes them: data and layout, but for the colours of a theme."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from xbus.report.allan import allan_deviation
from xbus.report.gather import Gathered, Panel, Series
from xbus.report.thin import Bands, FloatArray
from xbus.report.track import SOURCES

__all__ = ["Figure", "events", "flags", "noise", "panel", "steps", "track", "tracks"]

Figure = dict[str, Any]

#: x, y, z and what else there is; to be seen on white and on black.
COLOURS = (
    "#e4572e",
    "#1f9d8a",
    "#3a86d4",
    "#b07aa1",
    "#c99a00",
    "#7f8c8d",
    "#8c564b",
    "#e377c2",
    "#5b6abf",
)
#: What says that something is wrong.
ALARM = "#d62828"
#: Pixels: of a plot, of a row of bands, and of what is around rows.
HEIGHT, ROW, AROUND = 280, 26, 70


def numbers(values: npt.NDArray[Any]) -> dict[str, str]:
    """An array as plotly reads it fastest; NaN is a gap."""
    short = values.dtype == np.float32
    data = np.asarray(values, "<f4" if short else "<f8")
    return {"dtype": "f4" if short else "f8", "bdata": base64.b64encode(data.tobytes()).decode()}


def axis_title(it: Gathered) -> str:
    """What stands under a plot over time."""
    if it.axis.kind != "time":
        return f"{it.axis.kind} since the start" if it.axis.kind == "packet counter" else "sample"
    if it.utc is None:
        return "time since the start, s"
    return f"time since {str(it.utc.astype('datetime64[ms]'))[11:]} UTC, s"


def _over_time(it: Gathered, name: str, data: list[Figure], y: Figure, height: int) -> Figure:
    x: Figure = {"title": {"text": axis_title(it)}}
    if it.end > 0:
        x["range"] = [0, it.end]
    return {
        "name": name,
        "is_over_time": True,
        "data": data,
        "layout": {"xaxis": x, "yaxis": y, "height": height, "showlegend": len(data) > 1},
    }


def panel(it: Gathered, series: Series, shown: Panel) -> Figure:
    """A quantity over time, a curve for each component."""
    data: list[Figure] = []
    for at, (name, curve) in enumerate(zip(shown.curves.names, shown.curves.curves, strict=True)):
        colour = COLOURS[at % len(COLOURS)]
        time, values = curve.drawn()
        both = {"type": "scatter", "name": name, "legendgroup": name}
        alone = curve.alone()
        if has_line := len(alone) < len(curve.time) or not len(alone):
            line = {"mode": "lines", "line": _line(colour)}
            data.append({**both, **line, "x": numbers(time), "y": numbers(values)})
        if len(alone):
            dots = {"mode": "markers", "marker": {"color": colour, "size": 3}}
            place = {"x": numbers(curve.time[alone]), "y": numbers(curve.values[alone])}
            data.append({**both, **dots, **place, "showlegend": not has_line})
    what = shown.title or series.name
    title = f"{what}, {shown.unit}" if shown.unit else what
    name = f"{series.anchor} {shown.title}".strip()
    figure = _over_time(it, name, data, {"title": {"text": title}}, HEIGHT)
    figure["layout"]["showlegend"] = len(shown.curves.names) > 1
    return figure


def _line(colour: str) -> Figure:
    return {"color": colour, "width": 1.2}


def steps(it: Gathered) -> Figure:
    """Time between samples."""
    curve = it.steps.curves[0]
    time, values = curve.drawn()
    data = {"type": "scatter", "mode": "lines", "x": numbers(time), "y": numbers(values)}
    y: Figure = {"title": {"text": "between samples, ms"}, "rangemode": "tozero"}
    # The time up to a sample, drawn over that time.
    line = {**_line(COLOURS[2]), "shape": "vh"}
    return _over_time(it, "steps", [{**data, "line": line}], y, 200)


def events(it: Gathered) -> Figure | None:
    """Where samples are missing, bytes are damaged and the device complained; None where nothing was."""
    lost = [f"{n:,.0f} lost" for n in it.lost.weight]
    damage = [f"{n:,.0f} bytes" for n in it.damage.weight]
    rows = [("samples lost", it.lost, lost), ("damage", it.damage, damage)]
    for name in ("Error", "Warning"):
        at = [x for x, event in zip(it.events, it.facts.events, strict=True) if event.name == name]
        bands = Bands()
        bands.add(at, at, np.ones(len(at)))
        rows.append((f"{name.lower()}s", bands, [f"{n:.0f}" for n in bands.weight]))
    return _bands(it, "events", [(*row, ALARM) for row in rows if len(row[1])])


def flags(it: Gathered) -> Figure | None:
    """When each flag of the status word was set."""
    rows = []
    for flag in it.flags.values():
        colour = ALARM if "clip" in flag.name else COLOURS[1]
        words = [f"{n:,.0f} rows" for n in flag.bands.weight]
        rows.append((flag.label, flag.bands, words, colour))
    return _bands(it, "status", rows)


def _bands(
    it: Gathered, name: str, rows: Sequence[tuple[str, Bands, list[str], str]]
) -> Figure | None:
    """A row for each; what is narrower than a pixel is drawn as one, or nobody would see it."""
    if not rows:
        return None
    pixel = max(it.end, 1e-9) / 600
    data = []
    for at, (label, bands, words, colour) in enumerate(rows):
        end = np.maximum(bands.end, bands.start + pixel)
        x = np.stack([bands.start, end, np.full(len(bands), np.nan)], axis=1).ravel()
        data.append(
            {
                "type": "scatter",
                "mode": "lines",
                "x": numbers(x),
                "y": numbers(np.full(len(x), float(-at))),
                "text": [text for word in words for text in (word, word, "")],
                "hovertemplate": "%{x:.6~g}: %{text}<extra></extra>",
                "name": label,
                "line": {"color": colour, "width": 12},
            }
        )
    y = {
        "tickmode": "array",
        "tickvals": [-at for at in range(len(rows))],
        "ticktext": [row[0] for row in rows],
        "range": [0.5 - len(rows), 0.5],
        "fixedrange": True,
        "showgrid": False,
        "zeroline": False,
    }
    figure = _over_time(it, name, data, y, AROUND + ROW * len(rows))
    figure["layout"]["showlegend"] = False
    return figure


def tracks(it: Gathered) -> list[str]:
    """The quantities that tell where the device was, the best first."""
    return [name for name in SOURCES if name in it.tracks and it.tracks[name].rows]


def track(it: Gathered) -> Figure | None:
    """Where the device was, in metres, a metre as long to the north as to the east."""
    known = tracks(it)
    if not known:
        return None
    origin = it.tracks[known[0]].origin
    data: list[Figure] = []
    # The best is drawn last, on top of the others.
    for at, name in reversed(list(enumerate(known))):
        one = it.tracks[name]
        gaps = np.flatnonzero(np.diff(one.piece)) + 1
        x, y, time = (np.insert(it, gaps, np.nan) for it in (*one.metres(origin), one.time))
        curve: Figure = {"type": "scatter", "x": numbers(x), "y": numbers(y), "name": name}
        curve["customdata"] = numbers(time)
        curve["hovertemplate"] = "%{customdata:.2f} s<br>%{x:.2f} m, %{y:.2f} m"
        if at:
            look = {"mode": "markers", "marker": {"color": COLOURS[4 - at], "size": 4}}
        else:
            look = {"mode": "lines", "line": {"color": COLOURS[2], "width": 2}}
        data.append(curve | look)
    east, north = it.tracks[known[0]].metres(origin)
    for name, row, symbol in (("start", 0, "circle"), ("end", -1, "square")):
        place = {"x": [float(east[row])], "y": [float(north[row])], "name": name}
        marker = {"size": 10, "symbol": symbol, "color": COLOURS[-row]}
        data.append({"type": "scatter", "mode": "markers", **place, "marker": marker})
    layout = {
        "xaxis": {"title": {"text": "east, m"}, "constrain": "domain"},
        "yaxis": {"title": {"text": "north, m"}, "scaleanchor": "x", "constrain": "domain"},
        "height": 520,
    }
    return {"name": "track", "is_over_time": False, "data": data, "layout": layout}


def noise(series: Series) -> tuple[Figure, list[tuple[FloatArray, FloatArray]]] | None:
    """The Allan deviation of each axis, and the same as numbers; None where there is too little."""
    assert series.longest is not None  # noqa: S101 - only of these
    best = series.longest.best
    if not best.seconds:
        return None
    curves = [allan_deviation(axis, best.rate) for axis in best.values.T]
    if len(curves[0][0]) < 2:
        return None
    unit = next(iter(series.panels.values())).unit
    data = [
        {
            "type": "scatter",
            "mode": "lines+markers",
            "x": numbers(tau),
            "y": numbers(deviation),
            "name": name,
            "line": {"color": COLOURS[at], "width": 1.5},
            "marker": {"size": 4},
        }
        for at, (name, (tau, deviation)) in enumerate(zip("xyz", curves, strict=True))
    ]
    layout = {
        "xaxis": {
            "title": {"text": "averaging time, s"},
            "type": "log",
            "dtick": 1,
            "exponentformat": "power",
        },
        "yaxis": {
            "title": {"text": f"{series.name}, {unit}"},
            "type": "log",
            "dtick": 1,
            "exponentformat": "power",
        },
        "height": 380,
    }
    figure = {"name": f"noise {series.name}", "is_over_time": False, "data": data, "layout": layout}
    return figure, curves
