"""Noise figures of sensors at rest: the overlapping Allan deviation, and what is read off it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from xbus.report.thin import FloatArray

__all__ = ["Floor", "Longest", "Stretch", "allan_deviation", "at_one_second", "flicker_floor"]

#: Averaging times in each decade.
PER_DECADE = 10
#: The longest averaging time is this part of the data: there the deviation is uncertain by a quarter.
PARTS = 9
#: The flat part of an Allan deviation over the bias instability behind it: sqrt(2 ln 2 / pi).
FLAT = 0.664


def allan_deviation(
    values: npt.ArrayLike, rate: float, sizes: npt.ArrayLike | None = None
) -> tuple[FloatArray, FloatArray]:
    """The overlapping Allan deviation (IEEE Std 952, NIST SP 1065).

    Args:
        values: Rows at equal distances in time, ``(N,)``, in any unit.
        rate: Rows per second.
        sizes: Over how many rows to average, ascending; about ten in each decade, up to a ninth of the rows,
            if None.

    Returns:
        Averaging times in s and the deviations in the unit of the values, both ``(k,)`` float64; empty for
        less than ten rows.

    Raises:
        ValueError: The rate is not positive, or a size does not fit into the rows twice.

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
    # A constant does not count, and without it the sums keep their digits.
    phase = np.concatenate(([0.0], np.cumsum(rows - rows.mean())))
    deviation = np.empty(len(chosen))
    for at, size in enumerate(chosen.tolist()):
        second = phase[2 * size :] - phase[size:-size]
        second -= phase[size:-size] - phase[: -2 * size]
        deviation[at] = np.sqrt(np.dot(second, second) / len(second) / 2) / size
    return chosen / rate, deviation


def _sizes(rows: int) -> npt.NDArray[np.int64]:
    top = rows // PARTS
    if top < 1:
        return np.empty(0, np.int64)
    many = int(np.ceil(PER_DECADE * np.log10(top))) + 1
    return np.unique(np.geomspace(1, top, many).round().astype(np.int64))


def at_one_second(tau: FloatArray, deviation: FloatArray) -> tuple[float, float] | None:
    """The deviation at an averaging time of 1 s, and the slope of the curve there on log-log paper.

    White noise has the slope -1/2, and the deviation is its random walk then. None where the times do
    not go from below 1 s to above.

    >>> import numpy as np
    >>> tau = np.array([0.1, 0.8, 1.5, 10])
    >>> np.round(at_one_second(tau, 0.02 / np.sqrt(tau)), 6).tolist()
    [0.02, -0.5]
    """
    if not len(tau) or tau[0] > 1 or tau[-1] < 1 or not np.all(deviation > 0):
        return None
    log_tau, log = np.log(tau), np.log(deviation)
    value = np.exp(np.interp(0, log_tau, log))
    # Over a factor of two to both sides, as far as there are data.
    ends = np.clip([-np.log(2), np.log(2)], log_tau[0], log_tau[-1])
    low, high = np.interp(ends, log_tau, log)
    slope = (high - low) / (ends[1] - ends[0]) if ends[1] > ends[0] else np.nan
    return float(value), float(slope)


class Floor(NamedTuple):
    """The least deviation of a curve.

    Attributes:
        tau: Averaging time at which it is, s.
        bias: Bias instability that it stands for, in the unit of the values.
        is_reached: False where the curve was still falling at its end: the true one is less.
    """

    tau: float
    bias: float
    is_reached: bool


def flicker_floor(tau: FloatArray, deviation: FloatArray) -> Floor:
    """Bias instability by the least deviation.

    >>> import numpy as np
    >>> flicker_floor(np.array([1.0, 10, 100]), np.array([0.03, 0.00664, 0.02]))
    Floor(tau=10.0, bias=0.01, is_reached=True)
    """
    at = int(np.argmin(deviation))
    return Floor(float(tau[at]), float(deviation[at]) / FLAT, at < len(tau) - 1)


class Stretch:
    """The longest stretch of rows without a gap, kept in a bounded room.

    What is longer than `MOST` rows is averaged pair by pair as often as it takes, which leaves the Allan
    deviation at longer times as it is.

    Attributes:
        values: Rows, ``(N, k)`` float64.
        size: How many rows of the log each of them is the mean of.
        start, end: Times of the first and the last row, s.
        rows: Rows of the log in it.
    """

    #: 24 MiB for three axes.
    MOST = 1 << 20

    def __init__(self, width: int) -> None:
        self._width = width
        self.values = np.empty((0, width))
        self.size = 1
        self.start = self.end = float("nan")
        self.rows = 0
        #: Rows that are not yet a whole mean.
        self._rest = np.empty((0, width))

    def add(self, time: FloatArray, values: FloatArray) -> None:
        """Takes in rows that go on where the last ones ended."""
        if not self.rows:
            self.start = float(time[0])
        self.end = float(time[-1])
        self.rows += len(time)
        rows = np.concatenate((self._rest, values))
        whole = len(rows) - len(rows) % self.size
        self._rest = rows[whole:]
        means = rows[:whole].reshape(-1, self.size, self._width).mean(axis=1)
        self.values = np.concatenate((self.values, means))
        while len(self.values) > self.MOST:
            if len(self.values) % 2:
                self._rest = np.concatenate((np.repeat(self.values[-1:], self.size, 0), self._rest))
                self.values = self.values[:-1]
            self.values = self.values.reshape(-1, 2, self._width).mean(axis=1)
            self.size *= 2

    @property
    def seconds(self) -> float:
        """From the first row to the last."""
        return self.end - self.start if self.rows else 0.0

    @property
    def rate(self) -> float:
        """Values per second."""
        return (self.rows - 1) / self.seconds / self.size if self.seconds > 0 else float("nan")


class Longest:
    """The longest stretch of one quantity, found part by part.

    Attributes:
        best: It.
        stretches: How many there were.
    """

    def __init__(self, width: int) -> None:
        self.best = self._now = Stretch(width)
        self._width = width
        self.stretches = 1
        self._is_cut = False

    def add(
        self, time: FloatArray, values: npt.NDArray[np.floating], breaks: npt.NDArray[np.bool_]
    ) -> None:
        """Takes in rows; ``breaks`` says before which of them some are missing.

        Those with a value that is no number are missing, too.
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
        self._go_on(time[: edges[1]], values[: edges[1]])
        if not len(cuts):
            return
        # Of those that begin and end here only the longest can matter.
        seconds = time[edges[2:-1] - 1] - time[edges[1:-2]]
        for at in [int(np.argmax(seconds)) + 1] if len(seconds) else []:
            self._now = Stretch(self._width)
            self._go_on(time[edges[at] : edges[at + 1]], values[edges[at] : edges[at + 1]])
        self._now = Stretch(self._width)
        self._go_on(time[edges[-2] :], values[edges[-2] :])

    def _go_on(self, time: FloatArray, values: npt.NDArray[np.floating]) -> None:
        if len(time):
            self._now.add(time, values.astype(np.float64))
        if self._now.seconds > self.best.seconds:
            self.best = self._now
