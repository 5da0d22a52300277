"""Statistics of the samples between two cursors."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

__all__ = ["Statistics", "difference", "statistics_of"]

FloatArray = npt.NDArray[np.float64]

#: Degrees of a turn.
TURN = 360.0
#: Seconds of a minute.
MINUTE = 60.0


class Statistics(NamedTuple):
    """Statistics of each component, ``(k,)``, in the unit of the quantity; NaN where they are not defined.

    Attributes:
        number: Number of finite values, int64.
        mean: Arithmetic mean.
        std: Standard deviation of these values: the mean square is over all of them.
        minimum: Smallest value.
        maximum: Largest value.
        peak_to_peak: Difference of these two.
        slope: Slope of the straight line of least squares, per minute.
    """

    number: npt.NDArray[np.int64]
    mean: FloatArray
    std: FloatArray
    minimum: FloatArray
    maximum: FloatArray
    peak_to_peak: FloatArray
    slope: FloatArray


def statistics_of(time: FloatArray, values: FloatArray, *, wraps: bool = False) -> Statistics:
    """Returns the statistics of samples; values that are NaN or infinite are left out.

    Args:
        time: Times in seconds, ``(n,)``.
        values: ``(n, k)``.
        wraps: Whether the values are degrees that jump by a turn: their statistics are those of the angle
            without jumps, so that they can be beyond 180 degrees.

    >>> found = statistics_of(np.array([0.0, 1, 2]), np.array([[1.0], [2.0], [np.nan]]))
    >>> found.number.tolist(), found.mean.tolist(), found.slope.tolist()
    ([2], [1.5], [60.0])
    """
    columns = values.shape[1]
    number = np.zeros(columns, np.int64)
    found = np.full((len(Statistics._fields) - 1, columns), np.nan)
    for at, column in enumerate(values.T):
        finite = np.isfinite(column)
        numbers = column[finite]
        number[at] = len(numbers)
        if not len(numbers):
            continue
        if wraps:
            numbers = np.unwrap(numbers, period=TURN)
        low, high = numbers.min(), numbers.max()
        slope = _slope(time[finite], numbers)
        found[:, at] = numbers.mean(), numbers.std(), low, high, high - low, MINUTE * slope
    return Statistics(number, *found)


def _slope(time: FloatArray, values: FloatArray) -> float:
    """Returns the slope of the line of least squares; NaN if all times are the same."""
    centred = time - time.mean()
    square = float(centred @ centred)
    return float(centred @ (values - values.mean())) / square if square > 0 else np.nan


def difference(before: FloatArray, after: FloatArray, *, wraps: bool = False) -> FloatArray:
    """Returns ``after - before``; with ``wraps``, the shorter way round in degrees.

    >>> difference(np.array([179.0]), np.array([-179.0]), wraps=True).tolist()
    [2.0]
    """
    change = after - before
    return (change + TURN / 2) % TURN - TURN / 2 if wraps else change
