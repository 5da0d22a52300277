"""Plots of columns: their rows on a time axis, each device and each run for itself."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from xbus import _core
from xbus.formatting import format_count
from xbus.log.axis import Axis
from xbus.log.runs import Runs, steady_time
from xbus.plots.draw import Backend, draw
from xbus.plots.panels import PlottedColumn, has_panels, label, panel_rows
from xbus.plots.plot import Plot, TimeAxis
from xbus.plots.thin import Curves, FloatArray, Steps
from xbus.protocol.tables import COLUMN_QUANTITIES, device_of

__all__ = ["PlotTime", "plot_columns"]

#: The time axes: the device's clock, or UTC.
PlotTime = Literal["device", "utc"]
#: Rows that are added to a curve at once; they stay in the cache of a processor.
CHUNK = 1 << 16
#: No UTC in the arrays of the extension module.
NO_UTC = np.iinfo(np.int64).min


def plot_columns(
    columns: Sequence[PlottedColumn],
    part: _core.Part,
    *,
    time: PlotTime,
    backend: Backend,
    ax: Any,
) -> Any:
    """Draws columns of a part of a log; see `xbus.log.log.Log.plot`."""
    for column in columns:
        if not has_panels(column.name):
            raise ValueError(_without_plot(column.name))
    if not sum(map(len, columns)):
        raise ValueError("nothing to plot: the log has no rows of a quantity with a plot")
    if time not in ("device", "utc"):
        raise ValueError(f"time must be 'device' or 'utc', not {time!r}")
    run = Runs().add(part).run
    axis, positions = _on_clock(part, run)
    if time == "utc":
        axis, positions = _in_utc(part, run, positions)
    # Numbers in a log can have any size.
    with np.errstate(over="ignore", invalid="ignore"):
        plots = [plot for column in columns for plot in _plots(column, part, run, positions)]
    return draw(plots, axis, backend=backend, ax=ax)


def _without_plot(name: str) -> str:
    if COLUMN_QUANTITIES[name].has_flags:
        return f"{name} is a word of bits, which has no plot; draw one of its flags: column.flags"
    return f"{name} has no plot; it is no measured number"


def _on_clock(part: _core.Part, run: npt.NDArray[np.int64]) -> tuple[TimeAxis, FloatArray]:
    """Returns the axis, and the position of each sample on the clock of its device."""
    axis = Axis()
    positions = axis.positions(part, run) + axis.origin
    label = "device time, s" if axis.kind == "time" else axis.kind
    return TimeAxis(label), positions


def _in_utc(
    part: _core.Part, run: npt.NDArray[np.int64], positions: FloatArray
) -> tuple[TimeAxis, FloatArray]:
    """Returns the axis, and the UTC of each sample in seconds from its origin; NaN where it is not known."""
    stamps = part.utc
    is_known = np.zeros(len(part), bool) if stamps is None else stamps != NO_UTC
    if stamps is None or not is_known.any():
        raise ValueError("the log has no valid UTC; leave out time='utc'")
    # The receiver states the UTC of its solution, some 10 ms from the time of its sample.
    is_steady = is_known & np.isfinite(steady_time(part))
    is_known = is_steady if is_steady.any() else is_known
    origin = int(stamps[is_known].min())
    utc = np.full(len(part), np.nan)
    order = np.argsort(run, kind="stable")
    for rows in np.split(order, np.flatnonzero(np.diff(run[order])) + 1):
        known = rows[is_known[rows]]
        if not len(known):
            continue
        # The clock of the device drifts; between two values of UTC it goes evenly.
        offset = (stamps[known] - origin) / 1e9 - positions[known]
        utc[rows] = positions[rows] + np.interp(positions[rows], positions[known], offset)
    if missing := int(np.count_nonzero(np.isnan(utc))):
        warnings.warn(
            f"{format_count(missing, 'sample')} of runs without valid UTC not plotted", stacklevel=4
        )
    return TimeAxis("UTC", np.datetime64(origin, "ns")), utc


def _plots(
    column: PlottedColumn, part: _core.Part, run: npt.NDArray[np.int64], positions: FloatArray
) -> list[Plot]:
    """Returns the plots of a column, with curves for each device."""
    samples = column.sample - part.first
    time, devices = positions[samples], device_of(part.bid)
    of_rows, is_one = devices[samples], len(np.unique(devices)) < 2
    coordinates = None if column.coordinates == "ENU" else column.coordinates
    name = " ".join(filter(None, (column.name, coordinates)))
    plots: dict[str, Plot] = {}
    for rows in panel_rows(column):
        for bid in np.unique(of_rows).tolist():
            own = (of_rows == bid) & np.isfinite(time)
            if not own.all():
                curves = _curves(rows.names, time[own], rows.values[own], run[samples][own])
            else:
                curves = _curves(rows.names, time, rows.values, run[samples])
            text = label(name, rows.title, rows.unit)
            text = f"{name}\n{text}" if rows.title else text
            plot = plots.setdefault(rows.title, Plot(text))
            plot.curves["" if is_one else f"BID {bid}"] = curves.by_name
    return list(plots.values())


def _curves(
    names: tuple[str, ...], time: FloatArray, values: npt.NDArray[Any], run: npt.NDArray[np.int64]
) -> Curves:
    """Returns the thinned rows of one device."""
    curves, steps = Curves(names), Steps()
    starts = np.diff(run, prepend=run[:1]) != 0
    for first in range(0, len(time), CHUNK):
        chunk = slice(first, first + CHUNK)
        curves.add(time[chunk], values[chunk], steps.breaks(time[chunk], starts[chunk]))
    return curves
