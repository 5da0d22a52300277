"""Noise of sensors at rest: the overlapping Allan deviation and the figures derived from it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from xbus.plots.thin import FloatArray

__all__ = ["Floor", "Longest", "Stretch", "allan_deviation", "at_one_second", "flicker_floor"]

#: Averaging times per decade.
PER_DECADE = 10
#: Data length divided by the longest averaging time, where the deviation has an uncertainty of a quarter.
PARTS = 9
#: Minimum of an Allan deviation divided by the bias instability: sqrt(2 ln 2 / pi).
FLAT = 0.664


def allan_deviation(
    values: npt.ArrayLike, rate: float, sizes: npt.ArrayLike | None = None
) -> tuple[FloatArray, FloatArray]:
    """Returns the overlapping Allan deviation (IEEE Std 952, NIST SP 1065).

    Args:
        values: Rows at a constant rate, ``(N,)``, in any unit.
        rate: Rows per second.
        sizes: Numbers of rows to average, ascending. Default: about ten per decade, up to a ninth of the
            rows.

    Returns:
        Averaging times in s and deviations in the unit of the values, both ``(k,)`` float64; empty for fewer
        than ten rows.

    Raises:
        ValueError: The rate is not positive, or a size is larger than half of the rows.

    >>> import numpy as np
    >>> tau, deviation = allan_deviation(np.random.default_rng(1).normal(size=100_000), 100)
    >>> tau[[0, -1]].tolist(), float(deviation[0].round(2))
    ([0.01, 111.11], 1.0)
    """
    rows = np.asarray(values, np.float64)
    if rate <= 0:
        raise ValueError(f"rate must be positive, not {rate}")
    chosen = _sizes(len(rows)) if sizes is None else np.asarray(sizes, np.int64)
    if len(chosen) and (chosen.min() < 1 or 2 * chosen.max() > len(rows)):
        raise ValueError(f"sizes must be 1 to half of the {len(rows)} rows")
    if not len(chosen):
        return np.empty(0), np.empty(0)
    # A constant does not change the result; without the mean the sums keep their digits.
    phase = np.concatenate(([0.0], np.cumsum(rows - rows.mean())))
    deviation = np.empty(len(chosen))
    for at, size in enumerate(chosen.tolist()):
        second = phase[2 * size :] - phase[size:-size]
        second -= phase[size:-size] - phase[: -2 * size]
        # Not np.dot: its threads wait busily, which on a busy machine takes most of the time of a report.
        deviation[at] = np.sqrt(np.square(second, out=second).mean() / 2) / size
    return chosen / rate, deviation


def _sizes(rows: int) -> npt.NDArray[np.int64]:
    top = rows // PARTS
    if top < 1:
        return np.empty(0, np.int64)
    number = int(np.ceil(PER_DECADE * np.log10(top))) + 1
    return np.unique(np.geomspace(1, top, number).round().astype(np.int64))


def at_one_second(tau: FloatArray, deviation: FloatArray) -> tuple[float, float] | None:
    """Returns the deviation at an averaging time of 1 s, and the slope of the curve on logarithmic axes.

    The slope of white noise is -1/2; the deviation at 1 s is then its random walk. The result is None if the
    times do not include 1 s.

    >>> import numpy as np
    >>> tau = np.array([0.1, 0.8, 1.5, 10])
    >>> np.round(at_one_second(tau, 0.02 / np.sqrt(tau)), 6).tolist()
    [0.02, -0.5]
    """
    if not len(tau) or tau[0] > 1 or tau[-1] < 1 or not np.all(deviation > 0):
        return None
    log_tau, log = np.log(tau), np.log(deviation)
    value = np.exp(np.interp(0, log_tau, log))
    # The slope over a factor of two to both sides, as far as there are data.
    ends = np.clip([-np.log(2), np.log(2)], log_tau[0], log_tau[-1])
    low, high = np.interp(ends, log_tau, log)
    slope = (high - low) / (ends[1] - ends[0]) if ends[1] > ends[0] else np.nan
    return float(value), float(slope)


class Floor(NamedTuple):
    """The minimum of a curve.

    Attributes:
        tau: Averaging time at the minimum, s.
        bias: The bias instability, in the unit of the values.
        is_reached: False if the curve still falls at its end; the bias instability is smaller then.
    """

    tau: float
    bias: float
    is_reached: bool


def flicker_floor(tau: FloatArray, deviation: FloatArray) -> Floor:
    """Returns the minimum of a curve and the bias instability.

    >>> import numpy as np
    >>> flicker_floor(np.array([1.0, 10, 100]), np.array([0.03, 0.00664, 0.02]))
    Floor(tau=10.0, bias=0.01, is_reached=True)
    """
    at = int(np.argmin(deviation))
    return Floor(float(tau[at]), float(deviation[at]) / FLAT, at < len(tau) - 1)


class Stretch:
    """A stretch of rows without a gap, in limited memory.

    Pairs of rows are averaged when there are more than `MAX_ROWS`. The Allan deviation at longer times does
    not change.

    Attributes:
        size: Number of rows of the log that each row averages.
        start, end: Times of the first and the last row, s.
        rows: Number of rows of the log.
    """

    #: 24 MiB for three axes.
    MAX_ROWS = 1 << 20

    def __init__(self, width: int) -> None:
        self._width = width
        #: Grows by doubling: to copy all rows for each part would take most of the time of a report.
        self._buffer = np.empty((1024, width))
        self._used = 0
        self.size = 1
        self.start = self.end = float("nan")
        self.rows = 0
        #: Rows of an incomplete mean.
        self._rest = np.empty((0, width))

    def add(self, time: FloatArray, values: FloatArray) -> None:
        """Adds the rows that follow the last ones."""
        if not self.rows:
            self.start = float(time[0])
        self.end = float(time[-1])
        self.rows += len(time)
        rows = np.concatenate((self._rest, values))
        whole = len(rows) - len(rows) % self.size
        self._rest = rows[whole:]
        means = rows[:whole]
        if self.size > 1:
            means = means.reshape(-1, self.size, self._width).mean(axis=1)
        self._append(means)
        while self._used > self.MAX_ROWS:
            if self._used % 2:
                self._rest = np.concatenate((np.repeat(self.values[-1:], self.size, 0), self._rest))
                self._used -= 1
            pairs = self.values.reshape(-1, 2, self._width).mean(axis=1)
            self._used = 0
            self._append(pairs)
            self.size *= 2

    def _append(self, rows: FloatArray) -> None:
        needed = self._used + len(rows)
        if needed > len(self._buffer):
            buffer = np.empty((max(needed, 2 * len(self._buffer)), self._width))
            buffer[: self._used] = self.values
            self._buffer = buffer
        self._buffer[self._used : needed] = rows
        self._used = needed

    @property
    def values(self) -> FloatArray:
        """The rows, ``(N, k)`` float64."""
        return self._buffer[: self._used]

    @property
    def seconds(self) -> float:
        """Seconds from the first row to the last."""
        return self.end - self.start if self.rows else 0.0

    @property
    def rate(self) -> float:
        """Values per second."""
        return (self.rows - 1) / self.seconds / self.size if self.seconds > 0 else float("nan")


class Longest:
    """Finds the longest stretch of a quantity, part by part.

    Attributes:
        best: The longest stretch.
        stretches: Number of stretches.
    """

    def __init__(self, width: int) -> None:
        self.best = self._current = Stretch(width)
        self._width = width
        self.stretches = 1
        self._is_cut = False

    def add(
        self, time: FloatArray, values: npt.NDArray[np.floating], breaks: npt.NDArray[np.bool_]
    ) -> None:
        """Adds rows.

        Args:
            time: Times of the rows, ``(N,)``, s.
            values: ``(N, k)``. A row with a NaN or an infinity counts as missing.
            breaks: Whether rows are missing before each row, ``(N,)``.
        """
        if not len(time):
            return
        finite = np.isfinite(values).all(axis=1)
        after = np.concatenate(([self._is_cut], ~finite[:-1]))
        self._is_cut = not finite[-1]
        time, values, breaks = time[finite], values[finite], (breaks | after)[finite]
        cuts = np.flatnonzero(breaks)
        self.stretches += len(cuts)
        edges = np.array([0, *cuts, len(time)])
        self._extend(time[: edges[1]], values[: edges[1]])
        if not len(cuts):
            return
        # Only the longest of the stretches inside this part can be the best.
        seconds = time[edges[2:-1] - 1] - time[edges[1:-2]]
        for at in [int(np.argmax(seconds)) + 1] if len(seconds) else []:
            self._current = Stretch(self._width)
            self._extend(time[edges[at] : edges[at + 1]], values[edges[at] : edges[at + 1]])
        self._current = Stretch(self._width)
        self._extend(time[edges[-2] :], values[edges[-2] :])

    def _extend(self, time: FloatArray, values: npt.NDArray[np.floating]) -> None:
        if len(time):
            self._current.add(time, values.astype(np.float64))
        if self._current.seconds > self.best.seconds:
            self.best = self._current
