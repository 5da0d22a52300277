"""Curves with few points that keep every extreme and every gap."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from xbus.plots.thin import thin as extreme_rows
from xbus.studio.gaps import find_gaps

__all__ = ["Curve", "thin", "thin_path"]

#: Points of a curve for each column of pixels: the first, the two extremes, the last.
POINTS = 4


class Curve(NamedTuple):
    """Points to draw.

    Attributes:
        time: Seconds since 1970, ``(n,)`` float64, ascending.
        values: ``(k, n)`` float64, one row for each component; NaN in gaps.
    """

    time: npt.NDArray[np.float64]
    values: npt.NDArray[np.float64]


def thin(
    time: npt.NDArray[np.float64],
    values: npt.NDArray[np.float64],
    step: float,
    *,
    skip: int = 0,
) -> Curve:
    """Returns a curve with at most four points per column of pixels: first, extremes in order, last.

    Args:
        time: Ascending times, ``(n,)``.
        values: ``(n, k)``.
        step: Time that a column of pixels covers. Columns begin at multiples of it.
        skip: Rows at the beginning that are not drawn, but show whether there is a gap before the first.

    A gap, as `find_gaps` finds it, gets a point of NaN.

    >>> time = np.arange(8.0)
    >>> values = np.array([[0, 5, -7, 1, 2, 2, 2, 2]], np.float64).T
    >>> thin(time, values, 8.0).values
    array([[ 0.,  5., -7.,  2.]])
    """
    rows = time[skip:]
    if len(rows) > POINTS and len(rows) > POINTS * (rows[-1] - rows[0]) / step:
        drawn, points, begins = _extremes(rows, values[skip:], step)
    else:
        drawn, points, begins = rows, values[skip:].T, np.arange(len(rows))
    # A gap inside a column of pixels is not visible.
    places = np.flatnonzero(np.isin(begins, find_gaps(time).rows - skip))
    if drawn is not rows:
        places = places[::POINTS]
    return Curve(np.insert(drawn, places, drawn[places]), np.insert(points, places, np.nan, axis=1))


def thin_path(
    time: npt.NDArray[np.float64],
    values: npt.NDArray[np.float64],
    step: float,
    *,
    skip: int = 0,
) -> Curve:
    """Returns a path with few points, each of which is a row; see `thin` for the arguments.

    Of each column of pixels, it has the extremes of each component. A row with NaN, and a gap, interrupt the
    path.

    >>> time = np.arange(6.0)
    >>> values = np.array([[0, 1, 2, np.nan, 4, 5], [5, 4, 3, np.nan, 1, 0]], np.float64).T
    >>> thin_path(time, values, 3.0).values
    array([[ 0.,  2., nan,  4.,  5.],
           [ 5.,  3., nan,  1.,  0.]])
    """
    known = np.asarray(np.isfinite(values).all(axis=1))
    rows = skip + np.flatnonzero(known[skip:])
    kept = [rows[extreme_rows(time[rows], axis[rows], step)] for axis in values.T]
    # The row after a gap, and the first one of those with NaN.
    gaps = find_gaps(time).rows
    breaks = np.flatnonzero(~known & np.append(True, known)[:-1])
    places = np.concatenate([*kept, breaks, gaps])
    drawn = np.unique(places[places >= skip])
    places = np.flatnonzero(np.isin(drawn, gaps))
    points = values[drawn].T
    return Curve(
        np.insert(time[drawn], places, time[drawn][places]),
        np.insert(points, places, np.nan, axis=1),
    )


def _extremes(
    time: npt.NDArray[np.float64], values: npt.NDArray[np.float64], step: float
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64], npt.NDArray[np.intp]]:
    """Returns times and values of the points, and the row at which the column of each point begins."""
    starts = np.flatnonzero(np.diff(np.floor(time / step), prepend=-np.inf))
    ends = np.append(starts[1:], len(time)) - 1
    low, high = np.fmin.reduceat(values, starts), np.fmax.reduceat(values, starts)
    # The extreme that comes first is drawn first.
    column = np.repeat(np.arange(len(starts)), ends + 1 - starts)
    order = np.arange(len(time))[:, None]
    at_low, at_high = (
        np.minimum.reduceat(np.where(values == extreme[column], order, len(time)), starts)
        for extreme in (low, high)
    )
    first, second = np.where(at_low <= at_high, (low, high), (high, low))
    points = np.stack([values[starts], first, second, values[ends]])
    begin, end = time[starts, None], time[ends, None]
    drawn = begin + (end - begin) * np.linspace(0, 1, POINTS)
    rows = points.transpose(2, 1, 0).reshape(values.shape[1], -1)
    return drawn.ravel(), rows, np.repeat(starts, POINTS)
