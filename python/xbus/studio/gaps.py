"""Where samples are missing, by their times alone."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

__all__ = ["GAP", "Gaps", "find_gaps", "lost_time", "usual_period"]

FloatArray = npt.NDArray[np.float64]

#: A period is a gap if it is this many times longer than usual.
GAP = 3.0
#: Number of periods before a period, and after it, that show what is usual there: rates change.
NEAR = 8


class Gaps(NamedTuple):
    """Gaps in ascending times.

    Attributes:
        rows: The rows that come after a gap, ``(n,)``, ascending.
        usual: The period that is usual around each, in seconds, ``(n,)``.
    """

    rows: npt.NDArray[np.intp]
    usual: FloatArray


def find_gaps(time: FloatArray) -> Gaps:
    """Returns the gaps in ascending times, ``(n,)``.

    The usual period is the median of the eight before or of the eight after, whichever is longer. Thus a
    lower rate from some time on is no gap.

    >>> find_gaps(np.array([0.0, 1, 2, 6, 7, 8])).rows.tolist()
    [3]
    """
    periods = np.diff(time)
    if len(periods) < 2:
        return Gaps(np.empty(0, np.intp), np.empty(0))
    # The first period has none before it, and the last none after it.
    padded = np.pad(periods, NEAR, constant_values=np.nan)
    # A median is not below the least: few periods are long enough to need one.
    long = np.flatnonzero(periods > GAP * _least_around(padded, len(periods)))
    around = np.lib.stride_tricks.sliding_window_view(padded, 2 * NEAR + 1)[long]
    usual = np.fmax(_medians(around[:, :NEAR]), _medians(around[:, NEAR + 1 :]))
    is_gap = periods[long] > GAP * usual
    return Gaps(long[is_gap] + 1, usual[is_gap])


def _medians(rows: FloatArray) -> FloatArray:
    """Returns the median of each row without its NaN; NaN if nothing is left."""
    count = np.isfinite(rows).sum(axis=1)
    ordered, at = np.sort(rows, axis=1), np.arange(len(rows))  # NaN is last
    return np.asarray((ordered[at, (count - 1) // 2] + ordered[at, count // 2]) / 2)


def _least_around(padded: FloatArray, count: int) -> FloatArray:
    """Returns the shortest of the periods before and after each."""
    least = np.full(count, np.inf)
    for shift in (*range(NEAR), *range(NEAR + 1, 2 * NEAR + 1)):
        np.fmin(least, padded[shift : shift + count], out=least)
    return least


def usual_period(time: FloatArray) -> float:
    """Returns the median of the last eight periods, in seconds; NaN with less than two rows."""
    return float(np.median(np.diff(time[-NEAR - 1 :]))) if len(time) > 1 else np.nan


def lost_time(time: FloatArray, begin: float, end: float) -> float:
    """Returns the seconds between ``begin`` and ``end`` in which samples are missing.

    A sample covers the usual period after it; what is longer in a gap is lost. The time before the first row
    does not count.

    Args:
        time: Ascending times, ``(n,)``, also of some rows before ``begin`` and after ``end``.
        begin: Begin, on the same clock.
        end: End, on the same clock.

    Returns:
        Seconds; NaN if the rows are too few.

    >>> lost_time(np.array([0.0, 1, 2, 6, 7, 8]), 0.0, 5.0)
    2.0
    """
    if len(time) < 3:
        return np.nan
    rows, usual = find_gaps(time)
    starts, ends = time[rows - 1] + usual, time[rows]
    last = usual_period(time)
    if end - time[-1] > GAP * last:
        starts, ends = np.append(starts, time[-1] + last), np.append(ends, end)
    inside = np.minimum(ends, end) - np.maximum(starts, begin)
    return float(np.maximum(inside, 0.0).sum())
