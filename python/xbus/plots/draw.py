"""Draws plots with matplotlib or plotly."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np

from xbus.extras import require
from xbus.plots.plot import Plot, TimeAxis
from xbus.plots.traces import traces

__all__ = ["BACKENDS", "Backend", "draw"]

Backend = Literal["matplotlib", "plotly"]
BACKENDS: tuple[Backend, ...] = ("matplotlib", "plotly")
#: Width of a figure and height of a plot in inches; a single plot is higher.
WIDTH, HEIGHT, SINGLE = 9.0, 2.4, 3.6
#: Height of a plot of plotly in pixels, and of a single one.
PIXELS, SINGLE_PIXELS = 240, 400


def draw(plots: Sequence[Plot], axis: TimeAxis, *, backend: Backend, ax: Any) -> Any:
    """Draws plots one below the other, on a common time axis.

    Args:
        plots: At least one.
        axis: The horizontal axis.
        backend: The library.
        ax: The Axes of matplotlib to draw into: one, or one for each plot; None for a new figure.

    Returns:
        The Axes of the plot, an array of them for several plots; a Figure of plotly.

    Raises:
        ImportError: The extra ``plot`` or ``report`` is not installed.
        ValueError: The backend has another name, or the number of Axes is not that of the plots.
    """
    if backend not in BACKENDS:
        raise ValueError(f"backend must be 'matplotlib' or 'plotly', not {backend!r}")
    if backend == "matplotlib":
        return _with_matplotlib(plots, axis, ax)
    if ax is not None:
        raise ValueError("ax is for matplotlib; plotly returns a new Figure")
    return _with_plotly(plots, axis)


def _with_matplotlib(plots: Sequence[Plot], axis: TimeAxis, ax: Any) -> Any:
    all_axes = _new_axes(len(plots)) if ax is None else np.atleast_1d(np.asarray(ax, object))
    if all_axes.size != len(plots):
        raise ValueError(f"there are {len(plots)} plots, but {all_axes.size} Axes in ax")
    for axes, plot in zip(all_axes.ravel(), plots, strict=True):
        _draw_axes(axes, plot, axis)
    for axes in all_axes.ravel():
        axes.set_xlabel(axis.label)
        axes.label_outer()  # for Axes that share a time axis
    if ax is not None:
        return ax
    return all_axes if len(plots) > 1 else all_axes[0]


def _matplotlib(module: str) -> Any:
    return require(module, "plot", "to plot with matplotlib")


def _new_axes(number: int) -> Any:
    """Returns an array of Axes of a new figure."""
    height = SINGLE if number == 1 else HEIGHT * number
    figure, axes = _matplotlib("matplotlib.pyplot").subplots(
        number, sharex=True, squeeze=False, figsize=(WIDTH, height), layout="constrained"
    )
    figure.align_ylabels()
    return axes[:, 0]


def _draw_axes(axes: Any, plot: Plot, axis: TimeAxis) -> None:
    for line in plot.lines(axis):
        colour = line.style.colour
        style = "--" if line.style.is_dashed else "-"
        label = line.name if plot.has_names else "_"
        if not line.is_dots:
            axes.plot(line.time, line.values, style, color=colour, lw=0.9, label=label)
            label = "_"
        if len(line.dots[0]):
            axes.plot(*line.dots, ".", color=colour, ms=3, label=label)
    axes.set_ylabel(plot.label)
    axes.grid(alpha=0.3)
    axes.margins(x=0)
    for formatter in (axes.xaxis.get_major_formatter(), axes.yaxis.get_major_formatter()):
        if hasattr(formatter, "set_useOffset"):
            formatter.set_useOffset(False)  # whole numbers are easier to read
    if plot.has_names:
        # Above the plot it hides no curve.
        place = {"loc": "lower right", "bbox_to_anchor": (1, 1), "borderaxespad": 0.1}
        axes.legend(**place, fontsize="small", ncols=5, frameon=False)
    if axis.origin is not None:
        dates = _matplotlib("matplotlib.dates")
        locator = dates.AutoDateLocator()
        axes.xaxis.set_major_locator(locator)
        axes.xaxis.set_major_formatter(dates.ConciseDateFormatter(locator))


def _with_plotly(plots: Sequence[Plot], axis: TimeAxis) -> Any:
    make_subplots = require("plotly.subplots", "report", "to plot with plotly").make_subplots
    number = len(plots)
    height = SINGLE_PIXELS if number == 1 else PIXELS * number
    figure = make_subplots(
        rows=number, shared_xaxes=True, vertical_spacing=0.12 / number if number > 1 else 0
    )
    for row, plot in enumerate(plots, 1):
        legend = f"legend{row}" if row > 1 else "legend"
        for line in plot.lines(axis):
            for trace in traces(line):
                group = f"{row} {trace['legendgroup']}"
                figure.add_trace({**trace, "legendgroup": group, "legend": legend}, row, 1)
        place = figure.layout[f"yaxis{row}" if row > 1 else "yaxis"].domain
        figure.update_layout({legend: {"y": place[1], "yanchor": "top", "x": 1.01}})
        if not plot.has_names:
            figure.update_traces({"showlegend": False}, row=row, col=1)
        figure.update_yaxes(title_text=plot.label.replace("\n", "<br>"), row=row, col=1)
    figure.update_xaxes(title_text=axis.label, row=number, col=1)
    return figure.update_layout(height=height, margin={"l": 70, "r": 20, "t": 30, "b": 50})
