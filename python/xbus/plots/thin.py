"""Long curves reduced to few points, part by part: no spike is lost, and no line crosses a gap."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

__all__ = ["Bands", "BoolArray", "Curve", "Curves", "FloatArray", "Steps", "bin_width", "thin"]

FloatArray: TypeAlias = npt.NDArray[np.float64]
BoolArray: TypeAlias = npt.NDArray[np.bool_]
Indices: TypeAlias = npt.NDArray[np.intp]

#: Maximum number of bins, about the width of a plot in pixels; long curves use at least half of them.
BINS = 2048
#: Minimum width of a bin as a power of two; finer than any time stamp.
MIN_EXPONENT = -30
#: A step is a gap if it is longer than the usual step times this factor.
GAP_FACTOR = 1.5
#: Number of steps that define the usual step; the rate can change in a recording.
BLOCK_STEPS = 256


def thin(time: FloatArray, values: npt.NDArray[Any], width: float) -> Indices:
    """Returns the rows with the minimum and the maximum of each bin, in order.

    Bins start at multiples of ``width``, so a bin of twice the width consists of two bins: thinning in steps
    gives the same result as thinning once.

    Args:
        time: Ascending, ``(N,)``, s.
        values: Finite numbers, ``(N,)``.
        width: Width of a bin, s.

    >>> import numpy as np
    >>> time = np.arange(8) / 8
    >>> thin(time, np.array([0, 5, 1, 2, 3, 3, -7, 3]), 0.5).tolist()
    [0, 1, 4, 6]
    """
    if not len(time):
        return np.empty(0, np.intp)
    return _extremes(_starts(time, width), values)


def _starts(time: FloatArray, width: float) -> Indices:
    """Returns the first row of each bin."""
    bins = np.floor(time / width)
    return np.flatnonzero(np.concatenate(([True], bins[1:] != bins[:-1])))


def _extremes(starts: Indices, values: npt.NDArray[Any]) -> Indices:
    sizes = np.diff(starts, append=len(values))
    found: list[Indices] = []
    for extreme in (np.minimum, np.maximum):
        hits = np.flatnonzero(values == np.repeat(extreme.reduceat(values, starts), sizes))
        of_bin = np.searchsorted(starts, hits, "right")
        found.append(hits[np.concatenate(([True], of_bin[1:] != of_bin[:-1]))])
    rows = np.sort(np.concatenate(found))
    is_first: BoolArray = np.append(True, rows[1:] != rows[:-1])
    return rows[is_first]


def bin_width(width: float, span: float) -> float:
    """Returns the smallest power of two, at least ``width``, with which `BINS` bins cover ``span`` seconds.

    >>> bin_width(0.5, 3600), bin_width(4, 3600)
    (2.0, 4)
    """
    return max(
        width, 2.0 ** max(MIN_EXPONENT, int(np.ceil(np.log2(max(span, 1e-300) / (BINS - 1)))))
    )


class Curve:
    """The points of one component; long curves keep only the extremes of each bin.

    Attributes:
        time, values: The points, in order of time.
        piece: Number of the piece of each point; there is no line between pieces.
    """

    def __init__(self) -> None:
        self.time: FloatArray = np.empty(0)
        self.values: npt.NDArray[Any] = np.empty(0, np.float32)
        self.piece: npt.NDArray[np.int64] = np.empty(0, np.int64)

    def add(
        self,
        time: FloatArray,
        values: npt.NDArray[Any],
        piece: npt.NDArray[np.int64],
        width: float,
    ) -> None:
        """Adds points; a ``width`` of 0 keeps all of them."""
        self.time = np.concatenate((self.time, time))
        self.values = np.concatenate((self.values, values))
        self.piece = np.concatenate((self.piece, piece))
        if np.any(self.time[1:] < self.time[:-1]):
            self._keep(np.argsort(self.time, kind="stable"))
        if width:
            self._keep(thin(self.time, self.values, width))

    def _keep(self, rows: Indices) -> None:
        self.time, self.values, self.piece = self.time[rows], self.values[rows], self.piece[rows]

    def line(self) -> tuple[FloatArray, npt.NDArray[Any]]:
        """Returns times and values with a NaN between two pieces."""
        gaps = np.flatnonzero(self.piece[1:] != self.piece[:-1]) + 1
        values = self.values if self.values.dtype == np.float32 else self.values.astype(np.float64)
        return np.insert(self.time, gaps, np.nan), np.insert(values, gaps, np.nan)

    def isolated(self) -> Indices:
        """Returns the points without a line to a neighbour; a line would not show them."""
        apart = np.concatenate(([True], self.piece[1:] != self.piece[:-1], [True]))
        return np.flatnonzero(apart[:-1] & apart[1:]) if len(self.piece) else np.empty(0, np.intp)


class Curves:
    """The components of a quantity and their statistics.

    Args:
        names: Names of the components.

    Attributes:
        curves: A curve for each name.
        width: Width of the bins, s; 0 while every point is kept.
        count, mean, square, minimum, maximum: Statistics of the finite values of each component, ``(k,)``;
            ``square`` is the sum of the squared deviations from the mean.
        missing: Number of values that are NaN or infinite.
    """

    def __init__(self, names: tuple[str, ...]) -> None:
        self.names = names
        self.curves = [Curve() for _ in names]
        self.width = 0.0
        self.rows = 0
        self.missing = 0
        self.count = np.zeros(len(names))
        self.mean, self.square = np.zeros(len(names)), np.zeros(len(names))
        self.minimum, self.maximum = np.full(len(names), np.inf), np.full(len(names), -np.inf)
        self._pieces = 0
        self._first, self._last = np.inf, -np.inf

    def add(self, time: FloatArray, values: npt.NDArray[Any], breaks: BoolArray) -> None:
        """Adds rows.

        Args:
            time: Times, ``(N,)``, s, finite.
            values: ``(N, k)``.
            breaks: Whether rows are missing before each row, ``(N,)``.
        """
        if not len(time):
            return
        piece = self._pieces + np.cumsum(breaks)
        self._pieces = int(piece[-1])
        order = np.argsort(time, kind="stable") if np.any(time[1:] < time[:-1]) else slice(None)
        time, values, piece = time[order], values[order], piece[order]
        self.rows += len(time)
        self._first, self._last = min(self._first, float(time[0])), max(self._last, float(time[-1]))
        if self.rows > 2 * BINS:
            self.width = bin_width(self.width, self._last - self._first)
        starts = _starts(time, self.width) if self.width else None
        finite = np.isfinite(values)
        for at, curve in enumerate(self.curves):
            column = np.ascontiguousarray(values[:, at])
            if finite[:, at].all():
                self._count(at, column)
                rows = slice(None) if starts is None else _extremes(starts, column)
                curve.add(time[rows], column[rows], piece[rows], self.width)
            else:
                self._add_finite(at, time, column, piece, finite[:, at])

    def _add_finite(
        self,
        at: int,
        time: FloatArray,
        column: npt.NDArray[Any],
        piece: npt.NDArray[np.int64],
        finite: BoolArray,
    ) -> None:
        """Adds the finite values of a column; the others are gaps."""
        # Each NaN starts a new piece.
        piece = piece + np.cumsum(~finite)
        self._pieces = max(self._pieces, int(piece[-1]))
        self.missing += int(np.count_nonzero(~finite))
        if finite.any():
            self._count(at, column[finite])
            self.curves[at].add(time[finite], column[finite], piece[finite], self.width)

    def _count(self, at: int, column: npt.NDArray[Any]) -> None:
        # The parallel algorithm of Chan et al. keeps its digits with a large mean.
        number = len(column)
        mean = float(column.mean(dtype=np.float64))
        square = float(np.square(column - mean).sum(dtype=np.float64))
        total = self.count[at] + number
        difference = mean - self.mean[at]
        self.square[at] += square + difference**2 * self.count[at] * number / total
        self.mean[at] += difference * number / total
        self.count[at] = total
        self.minimum[at] = min(self.minimum[at], column.min())
        self.maximum[at] = max(self.maximum[at], column.max())

    @property
    def by_name(self) -> dict[str, Curve]:
        """The curves, by the names of their components."""
        return dict(zip(self.names, self.curves, strict=True))

    @property
    def deviation(self) -> FloatArray:
        """Standard deviation of each component, ``(k,)``."""
        return np.sqrt(self.square / np.maximum(self.count, 1))


class Steps:
    """Finds gaps in the times of a quantity: steps much longer than the steps around them.

    Attributes:
        rows: Number of rows.
        gaps: Number of gaps.
        irregular: Number of steps, without gaps, that differ from the usual step by more than a tenth and a
            tick of the clock.
        usual: The usual step at the end, s; NaN before the second row.
    """

    #: A tick of SampleTimeFine, and the rounding of both ends, in seconds.
    TICK = 1.5e-4

    def __init__(self) -> None:
        self.rows = self.gaps = self.irregular = 0
        self.usual = float("nan")
        self._last: float | None = None

    def breaks(self, time: FloatArray, starts: BoolArray | None = None) -> BoolArray:
        """Returns whether rows are missing before each row, or its run begins there, ``(N,)``.

        Args:
            time: Times of the next rows, ``(N,)``, s.
            starts: Whether a run begins with a row, ``(N,)``: the step before it is not known. Default: none.
        """
        starts = np.zeros(len(time), bool) if starts is None else starts
        if not len(time):
            return starts
        self.rows += len(time)
        first = time[0] if self._last is None else self._last
        steps = np.diff(time, prepend=first)
        # The first row of all has no step.
        real = steps[1:] if self._last is None else steps
        self._last = float(time[-1])
        if not len(real):
            return starts
        usual = _usual(real)
        if len(real) < BLOCK_STEPS // 4 and np.isfinite(self.usual):
            usual[:] = self.usual  # too few for a median
        self.usual = float(usual[-1])
        is_start = starts[len(time) - len(real) :]
        long = ((real > GAP_FACTOR * usual) | (real < 0)) & ~is_start
        odd = ~long & ~is_start & (np.abs(real - usual) > np.maximum(0.1 * usual, self.TICK))
        self.gaps += int(np.count_nonzero(long))
        self.irregular += int(np.count_nonzero(odd))
        return np.concatenate((np.zeros(len(time) - len(real), bool), long)) | starts


def _usual(steps: FloatArray) -> FloatArray:
    """Returns the usual step around each step: the median of its block."""
    whole = len(steps) // BLOCK_STEPS * BLOCK_STEPS
    blocks = np.partition(steps[:whole].reshape(-1, BLOCK_STEPS), BLOCK_STEPS // 2, axis=1)
    medians = np.repeat(blocks[:, BLOCK_STEPS // 2], BLOCK_STEPS)
    if whole < len(steps):
        # The last block can overlap the one before.
        last = steps[-BLOCK_STEPS:]
        middle = np.partition(last, len(last) // 2)[len(last) // 2]
        medians = np.concatenate((medians, np.full(len(steps) - whole, middle)))
    # Rows with the same time stamp have a step of 0.
    return np.where(medians > 0, medians, steps.max())


class Bands:
    """Intervals of time; the nearest are merged if there are more than `BINS`.

    Attributes:
        start, end: Start and end of each interval, s, ascending.
        weight: Weight of each interval; a merged interval has the sum.
        width: Intervals that are at most this far apart are merged, s.
    """

    def __init__(self) -> None:
        self.start: FloatArray = np.empty(0)
        self.end: FloatArray = np.empty(0)
        self.weight: FloatArray = np.empty(0)
        # Adjacent intervals are merged, despite rounding.
        self.width = 1e-6

    def __len__(self) -> int:
        return len(self.start)

    def add(self, start: npt.ArrayLike, end: npt.ArrayLike, weight: npt.ArrayLike) -> None:
        """Adds intervals."""
        self.start = np.concatenate((self.start, np.asarray(start, np.float64)))
        self.end = np.concatenate((self.end, np.asarray(end, np.float64)))
        self.weight = np.concatenate((self.weight, np.asarray(weight, np.float64)))
        self._merge()
        while len(self) > BINS:
            span = self.end[-1] - self.start[0]
            self.width = max(2 * self.width, span / BINS / 16)
            self._merge()

    def _merge(self) -> None:
        if not len(self):
            return
        order = np.argsort(self.start, kind="stable")
        start, end, weight = self.start[order], np.maximum.accumulate(self.end[order]), self.weight
        first = np.flatnonzero(np.concatenate(([True], start[1:] - end[:-1] > self.width)))
        self.start = start[first]
        self.end = end[np.append(first[1:] - 1, len(end) - 1)]
        self.weight = np.add.reduceat(weight[order], first)
