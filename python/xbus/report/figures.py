"""The plots of a report as plotly figures, with numpy arrays; the page adds the colours of its theme."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from xbus.export.palette import ALARM, COLOURS
from xbus.plots.panels import label
from xbus.plots.plot import Plot, TimeAxis
from xbus.plots.thin import Bands, FloatArray
from xbus.plots.traces import traces
from xbus.report.allan import allan_deviation
from xbus.report.data import Panel, ReportData, Series
from xbus.report.field_quality import FieldQuality

__all__ = [
    "Figure",
    "events",
    "field",
    "flags",
    "noise",
    "panel",
    "profiles",
    "spectrogram",
    "spectrum",
    "steps",
    "track",
    "tracks",
]

Figure = dict[str, Any]

#: Heights in pixels: a plot, a row of bands, and the margin around the rows.
HEIGHT, ROW, MARGIN = 295, 26, 90
#: Planes in which a magnetic field is drawn, by axis, and dots in each, at most about.
PLANES = ((0, 1), (0, 2), (1, 2))
MAX_DOTS = 1000
#: Height of a band, and the smallest width of a mark, in pixels.
BAND, MARK = 12, 2


def axis_title(data: ReportData) -> str:
    """Returns the title of the horizontal axis; the page replaces that of an axis of time."""
    if data.axis.kind == "time":
        return "time since the start, s"
    return "packet counter since the start" if data.axis.kind == "packet counter" else "sample"


def _over_time(data: ReportData, name: str, traces: list[Figure], y: Figure, height: int) -> Figure:
    x: Figure = {"title": {"text": axis_title(data)}}
    if data.end > 0:
        x["range"] = [0, data.end]
    return {
        "name": name,
        "is_over_time": True,
        # For the marks of the axis: milliseconds of UTC since 1970 where each run starts, and their rate.
        "clock": [
            [piece.start, None if piece.utc is None else piece.utc / 1e6, piece.rate]
            for piece in data.clock
        ]
        if data.axis.kind == "time"
        else None,
        "data": traces,
        "layout": {"xaxis": x, "yaxis": y, "height": height, "showlegend": len(traces) > 1},
    }


def panel(data: ReportData, series: Series, panel: Panel) -> Figure:
    """Returns a quantity over time, with a curve for each component."""
    plot = Plot(label(series.name, panel.title, panel.unit), {"": panel.curves.by_name})
    return _plot(data, f"{series.anchor} {panel.title}".strip(), plot)


def _plot(data: ReportData, name: str, plot: Plot) -> Figure:
    drawn = [trace for line in plot.lines(TimeAxis("")) for trace in traces(line)]
    figure = _over_time(data, name, drawn, {"title": {"text": plot.label}}, HEIGHT)
    figure["layout"]["showlegend"] = plot.has_names
    return figure


class Profile(NamedTuple):
    """A plot below the track.

    Attributes:
        label: Text at the vertical axis.
        curves: Quantity, title of its panel, component, and name of the curve.
    """

    label: str
    curves: tuple[tuple[str, str, str, str], ...]


#: The plots below the track, by name.
PROFILES = {
    "height": Profile(
        "height above ellipsoid, m",
        (
            ("altitude_ellipsoid", "", "altitude_ellipsoid", "filter"),
            ("gnss_pvt_data", "height", "height", "receiver"),
        ),
    ),
    "height above the sea": Profile(
        "height above sea level, m",
        (
            ("altitude_msl", "", "altitude_msl", "filter"),
            ("gnss_pvt_data", "height", "hMSL", "receiver"),
        ),
    ),
    "speed": Profile(
        "horizontal speed, m/s",
        (
            ("velocity_xyz", "", "speed", "filter"),
            ("gnss_pvt_data", "velocity", "gSpeed", "receiver"),
        ),
    ),
    "accuracy": Profile(
        "stated accuracy, m",
        (
            ("gnss_pvt_data", "stated accuracy", "hAcc", "horizontal"),
            ("gnss_pvt_data", "stated accuracy", "vAcc", "vertical"),
        ),
    ),
}


def profiles(data: ReportData) -> Iterator[Figure]:
    """Yields height, speed and accuracy over time, as far as they are known."""
    for name, profile in PROFILES.items():
        plot = Plot(profile.label)
        for quantity, title, component, curve_name in profile.curves:
            for series in data.series:
                panel = series.panels.get(title)
                if series.name != quantity or panel is None:
                    continue
                curve = panel.curves.by_name[component]
                if len(curve.time):
                    plot.curves.setdefault(series.device, {})[curve_name] = curve
        if plot.curves:
            yield _plot(data, name, plot)


def _line(colour: str) -> Figure:
    return {"color": colour, "width": 1.2}


def steps(data: ReportData) -> Figure:
    """Returns the time between samples."""
    traces = []
    for at, (bid, curves) in enumerate(sorted(data.steps.items())):
        time, values = curves.curves[0].line()
        traces.append(
            {
                "type": "scatter",
                "mode": "lines",
                "name": f"BID {bid}",
                "x": time,
                "y": values,
                # The step before a sample extends over the time before the sample.
                "line": {**_line(COLOURS[(2 + at) % len(COLOURS)]), "shape": "vh"},
            }
        )
    y: Figure = {"title": {"text": "between samples, ms"}, "rangemode": "tozero"}
    return _over_time(data, "steps", traces, y, 230)


def events(data: ReportData) -> Figure | None:
    """Returns the times of losses, damage, errors and warnings; None if there are none."""
    lost = [f"{n:,.0f} lost" for n in data.lost.weight]
    damage = [f"{n:,.0f} bytes" for n in data.damage.weight]
    rows = [("samples lost", data.lost, lost), ("damage", data.damage, damage)]
    for name, marks in data.marks.items():
        rows.append((f"{name.lower()}s", marks, [f"{n:.0f}" for n in marks.weight]))
    return _bands(data, "events", [(*row, ALARM) for row in rows if len(row[1])])


def flags(data: ReportData) -> Figure | None:
    """Returns the times when each flag of the status word was set; None if no flag was set."""
    rows = []
    for flag in data.flags.values():
        colour = ALARM if "clip" in flag.name else COLOURS[1]
        texts = [f"{n:,.0f} rows" for n in flag.bands.weight]
        rows.append((flag.label, flag.bands, texts, colour))
    return _bands(data, "status", rows)


def _bands(
    data: ReportData, name: str, rows: Sequence[tuple[str, Bands, list[str], str]]
) -> Figure | None:
    """Returns a row of bands for each label.

    A mark of constant width at the start of each band keeps short ones visible: plotly leaves out lines that
    are shorter than a pixel, and how much that is depends on the width of the window.
    """
    if not rows:
        return None
    traces = []
    for at, (name_of_row, bands, texts, colour) in enumerate(rows):
        x = np.stack([bands.start, bands.end, np.full(len(bands), np.nan)], axis=1).ravel()
        traces.append(
            {
                "type": "scatter",
                "mode": "lines+markers",
                "x": x,
                "y": np.full(len(x), float(-at)),
                "text": [part for text in texts for part in (text, text, "")],
                "hovertemplate": "%{x:.6~g}: %{text}<extra></extra>",
                "name": name_of_row,
                "line": {"color": colour, "width": BAND},
                "marker": {
                    "symbol": "line-ns-open",
                    "size": BAND / 1.4,  # plotly's line is that much longer
                    "line": {"color": colour, "width": MARK},
                },
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
    figure = _over_time(data, name, traces, y, MARGIN + ROW * len(rows))
    figure["layout"]["showlegend"] = False
    return figure


def tracks(data: ReportData) -> list[str]:
    """Returns the names of the tracks with a position, the best first."""
    return [name for name, positions in data.tracks.items() if positions.rows]


def track(data: ReportData) -> Figure | None:
    """Returns the track in metres east and north, on equal scales; None without a position."""
    names = tracks(data)
    if not names:
        return None
    best = data.tracks[names[0]]
    traces: list[Figure] = []
    # The best is drawn last, on top of the others.
    for at, name in reversed(list(enumerate(names))):
        positions = data.tracks[name]
        gaps = np.flatnonzero(np.diff(positions.piece)) + 1
        columns = (*positions.metres(best.origin), positions.time)
        x, y, time = (np.insert(column, gaps, np.nan) for column in columns)
        trace: Figure = {"type": "scatter", "x": x, "y": y, "name": name}
        trace["customdata"] = time
        trace["hovertemplate"] = "%{customdata:.2f} s<br>%{x:.2f} m, %{y:.2f} m"
        if at:
            style = {
                "mode": "markers",
                "marker": {"color": COLOURS[(4 - at) % len(COLOURS)], "size": 4},
            }
        else:
            style = {"mode": "lines", "line": {"color": COLOURS[2], "width": 2}}
        traces.append(trace | style)
    east, north = best.metres(best.origin)
    for name, row, symbol in (("start", 0, "circle"), ("end", -1, "square")):
        point = {"x": [float(east[row])], "y": [float(north[row])], "name": name}
        marker = {"size": 10, "symbol": symbol, "color": COLOURS[-row]}
        traces.append({"type": "scatter", "mode": "markers", **point, "marker": marker})
    layout = {
        "xaxis": {"title": {"text": "east, m"}, "constrain": "domain"},
        "yaxis": {"title": {"text": "north, m"}, "scaleanchor": "x", "constrain": "domain"},
        "height": 520,
    }
    return {"name": "track", "is_over_time": False, "data": traces, "layout": layout}


def spectrum(series: Series) -> Figure:
    """Returns the amplitude spectral density of each axis; the series has one."""
    assert series.spectrum is not None  # noqa: S101 - see `xbus.report.sections`
    frequency, density = series.spectrum.density()
    drawn = [
        {
            "type": "scatter",
            "mode": "lines",
            "x": frequency,
            "y": np.where(amplitude > 0, amplitude, np.nan),
            "name": name,
            "line": _line(COLOURS[at]),
        }
        for at, (name, amplitude) in enumerate(zip("xyz", np.sqrt(density.T), strict=True))
    ]
    unit = next(iter(series.panels.values())).unit
    scale = {"type": "log", "dtick": 1, "exponentformat": "power"}
    layout = {
        "xaxis": {"title": {"text": "frequency, Hz"}, **scale},
        "yaxis": {"title": {"text": f"{series.name}, {unit}/√Hz"}, **scale},
        "height": 380,
    }
    name = f"spectrum {series.anchor}"
    return {"name": name, "is_over_time": False, "data": drawn, "layout": layout}


def spectrogram(data: ReportData, series: Series) -> Figure:
    """Returns the spectral density over time, the sum of the axes; the series has one."""
    assert series.spectrum is not None  # noqa: S101 - see `xbus.report.sections`
    time, frequency, density = series.spectrum.over_time()
    with np.errstate(divide="ignore"):
        decibels = 10 * np.log10(density).astype(np.float32)
    unit = next(iter(series.panels.values())).unit
    drawn = {
        "type": "heatmap",
        "x": time,
        "y": frequency,
        "z": np.where(np.isfinite(decibels), decibels, np.float32(np.nan)),
        "colorscale": "Cividis",
        "hovertemplate": "%{x:.2f} s, %{y:.4g} Hz: %{z:.1f} dB<extra></extra>",
        "colorbar": {
            "title": {"text": f"dB ({unit})²/Hz", "side": "top"},
            "orientation": "h",
            "y": 1,
            "yanchor": "bottom",
            "x": 0,
            "xanchor": "left",
            "len": 0.6,
            "thickness": 8,
        },
    }
    y = {"title": {"text": f"{series.name}, Hz"}}
    figure = _over_time(data, f"spectrogram {series.anchor}", [drawn], y, 340)
    figure["layout"]["margin"] = {"l": 70, "r": 15, "t": 60, "b": 60}
    return figure


def field(series: Series, quality: FieldQuality) -> Figure:
    """Returns a magnetic field in three planes, before and after its correction if there is one."""
    clouds = [("as recorded", quality.points, COLOURS[1])]
    if quality.ellipsoid is not None:
        clouds.append(("corrected", quality.ellipsoid.corrected(quality.points), COLOURS[2]))
    end = 1.05 * max(float(np.abs(points).max()) for _, points, _ in clouds)
    axis = {"range": [-end, end], "nticks": 5, "constrain": "domain"}
    traces: list[Figure] = []
    layout: Figure = {"height": 360, "hovermode": False}
    for at, (across, up) in enumerate(PLANES):
        number = str(at + 1) if at else ""
        for name, points, colour in clouds:
            shown = points[:: max(1, len(points) // MAX_DOTS)].astype(np.float32)
            trace = {
                "type": "scatter",
                "mode": "markers",
                "x": shown[:, across],
                "y": shown[:, up],
                "xaxis": f"x{number}",
                "yaxis": f"y{number}",
                "name": name,
                "legendgroup": name,
                "showlegend": not at,
                "marker": {"color": colour, "size": 3},
            }
            traces.append(trace)
        left = at * 0.36
        layout[f"xaxis{number}"] = {
            "title": {"text": f"{'xyz'[up]} over {'xyz'[across]}, a.u."},
            "domain": [left, left + 0.28],
            **axis,
        }
        layout[f"yaxis{number}"] = {
            "title": {"text": ""},
            "anchor": f"x{number}",
            "scaleanchor": f"x{number}",
            **axis,
        }
    return {
        "name": f"field {series.anchor}",
        "is_over_time": False,
        "data": traces,
        "layout": layout,
    }


def noise(series: Series) -> tuple[Figure, list[tuple[FloatArray, FloatArray]]] | None:
    """Returns the Allan deviation of each axis as a plot and as numbers; None if there are too few rows."""
    assert series.longest is not None  # noqa: S101 - see `xbus.report.noise`
    best = series.longest.best
    if not best.seconds:
        return None
    curves = [allan_deviation(axis, best.rate) for axis in best.values.T]
    if len(curves[0][0]) < 2:
        return None
    unit = next(iter(series.panels.values())).unit
    traces = [
        {
            "type": "scatter",
            "mode": "lines+markers",
            "x": tau,
            "y": deviation,
            "name": name,
            "line": {"color": COLOURS[at], "width": 1.5},
            "marker": {"size": 4},
        }
        for at, (name, (tau, deviation)) in enumerate(zip("xyz", curves, strict=True))
    ]
    scale = {"type": "log", "dtick": 1, "exponentformat": "power"}
    layout = {
        "xaxis": {"title": {"text": "averaging time, s"}, **scale},
        "yaxis": {"title": {"text": f"{series.name}, {unit}"}, **scale},
        "height": 380,
    }
    name = f"noise {series.anchor}"
    return {"name": name, "is_over_time": False, "data": traces, "layout": layout}, curves
