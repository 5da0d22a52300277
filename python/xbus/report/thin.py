"""Long curves in few points, taken in part by part: no spike is lost, and no line crosses a gap."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

__all__ = ["Bands", "BoolArray", "Curve", "Curves", "FloatArray", "Steps", "coarser", "thin"]

FloatArray: TypeAlias = npt.NDArray[np.float64]
BoolArray: TypeAlias = npt.NDArray[np.bool_]
Indices: TypeAlias = npt.NDArray[np.intp]

#: About as many pixels as a plot is wide; half as many at least are in use once there are more points.
BINS = 2048
#: The least width of a bin, as a power of two: finer than any time stamp.
FINEST = -30
#: A step that is longer than this, in times of the usual one, is a gap.
LONG = 1.5
#: Rows over which a step is the usual one: the rate may change on the way.
AROUND = 256


def thin(time: FloatArray, values: npt.NDArray[Any], width: float) -> Indices:
    """The rows of the least and the greatest value in each bin of ``width`` seconds, in order.

    Bins begin at multiples of ``width``, so that of twice the width holds two of them whole: thinning what
    was thinned before is thinning all at once.

    Args:
        time: Ascending, ``(N,)``, s.
        values: Finite numbers, ``(N,)``.
        width: Of a bin, s.

    >>> import numpy as np
    >>> time = np.arange(8) / 8
    >>> thin(time, np.array([0, 5, 1, 2, 3, 3, -7, 3]), 0.5).tolist()
    [0, 1, 4, 6]
    """
    if not len(time):
        return np.empty(0, np.intp)
    return _extremes(_starts(time, width), values)


def _starts(time: FloatArray, width: float) -> Indices:
    """The first row of each bin."""
    bins = np.floor(time / width)
    return np.flatnonzero(np.concatenate(([True], bins[1:] != bins[:-1])))


def _extremes(starts: Indices, values: npt.NDArray[Any]) -> Indices:
    sizes = np.diff(starts, append=len(values))
    found = []
    for extreme in (np.minimum, np.maximum):
        hits = np.flatnonzero(values == np.repeat(extreme.reduceat(values, starts), sizes))
        of_bin = np.searchsorted(starts, hits, "right")
        found.append(hits[np.concatenate(([True], of_bin[1:] != of_bin[:-1]))])
    return np.union1d(*found)


def coarser(width: float, span: float) -> float:
    """The least power of two, not under ``width``, of which no more than `BINS` cover so many seconds.

    >>> coarser(0.5, 3600), coarser(4, 3600)
    (2.0, 4)
    """
    return max(width, 2.0 ** max(FINEST, int(np.ceil(np.log2(max(span, 1e-300) / (BINS - 1))))))


class Curve:
    """Points of one component: as they came while they are few, then the extremes of each bin.

    Attributes:
        time, values: The points that are drawn, in order of time.
        piece: Grows where nothing is to be drawn between a point and the one before.
    """

    def __init__(self) -> None:
        self.time: FloatArray = np.empty(0)
        self.values: npt.NDArray[Any] = np.empty(0, np.float32)
        self.piece: npt.NDArray[np.int64] = np.empty(0, np.int64)

    def join(
        self,
        time: FloatArray,
        values: npt.NDArray[Any],
        piece: npt.NDArray[np.int64],
        width: float,
    ) -> None:
        """Takes in more points; ``width`` of a bin is zero while all of them are kept."""
        self.time = np.concatenate((self.time, time))
        self.values = np.concatenate((self.values, values))
        self.piece = np.concatenate((self.piece, piece))
        if np.any(self.time[1:] < self.time[:-1]):
            self._pick(np.argsort(self.time, kind="stable"))
        if width:
            self._pick(thin(self.time, self.values, width))

    def _pick(self, rows: Indices) -> None:
        self.time, self.values, self.piece = self.time[rows], self.values[rows], self.piece[rows]

    def drawn(self) -> tuple[FloatArray, npt.NDArray[Any]]:
        """Times and values with a NaN between two pieces, where the line has a gap."""
        gaps = np.flatnonzero(self.piece[1:] != self.piece[:-1]) + 1
        values = self.values if self.values.dtype == np.float32 else self.values.astype(np.float64)
        return np.insert(self.time, gaps, np.nan), np.insert(values, gaps, np.nan)

    def alone(self) -> Indices:
        """The points with no line to either side, which as a line would not be seen."""
        apart = np.concatenate(([True], self.piece[1:] != self.piece[:-1], [True]))
        return np.flatnonzero(apart[:-1] & apart[1:]) if len(self.piece) else np.empty(0, np.intp)


class Curves:
    """The components of a quantity, and what is counted of them.

    Args:
        names: Of the components.

    Attributes:
        curves: One for each name.
        width: Of the bins of which the extremes are kept, s; zero while every point is.
        count, mean, square, least, greatest: Of the finite values of each component, ``(k,)``; ``square`` is
            the sum of the squared deviations from the mean.
        missing: How many values are NaN or infinite.
    """

    def __init__(self, names: tuple[str, ...]) -> None:
        self.names = names
        self.curves = [Curve() for _ in names]
        self.width = 0.0
        self.rows = 0
        self.missing = 0
        self.count = np.zeros(len(names))
        self.mean, self.square = np.zeros(len(names)), np.zeros(len(names))
        self.least, self.greatest = np.full(len(names), np.inf), np.full(len(names), -np.inf)
        self._pieces = 0
        self._first, self._last = np.inf, -np.inf

    def add(self, time: FloatArray, values: npt.NDArray[Any], breaks: BoolArray) -> None:
        """Takes in rows.

        Args:
            time: ``(N,)``, s, finite.
            values: ``(N, k)``.
            breaks: Before which rows something is missing.
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
            self.width = coarser(self.width, self._last - self._first)
        starts = _starts(time, self.width) if self.width else None
        finite = np.isfinite(values)
        for at, curve in enumerate(self.curves):
            column = np.ascontiguousarray(values[:, at])
            if finite[:, at].all():
                self._count(at, column)
                rows = slice(None) if starts is None else _extremes(starts, column)
                curve.join(time[rows], column[rows], piece[rows], self.width)
            else:
                self._add_some(at, time, column, piece, finite[:, at])

    def _add_some(
        self,
        at: int,
        time: FloatArray,
        column: npt.NDArray[Any],
        piece: npt.NDArray[np.int64],
        finite: BoolArray,
    ) -> None:
        """Takes in a column of which some values are none: these are gaps."""
        # Each breaks the line on its own account, for good.
        piece = piece + np.cumsum(~finite)
        self._pieces = max(self._pieces, int(piece[-1]))
        self.missing += int(np.count_nonzero(~finite))
        if finite.any():
            self._count(at, column[finite])
            self.curves[at].join(time[finite], column[finite], piece[finite], self.width)

    def _count(self, at: int, column: npt.NDArray[Any]) -> None:
        # Chan's way to join means and squares, which loses no digits to a large mean.
        many = len(column)
        mean = float(column.mean(dtype=np.float64))
        square = float(np.square(column - mean).sum(dtype=np.float64))
        total = self.count[at] + many
        apart = mean - self.mean[at]
        self.square[at] += square + apart**2 * self.count[at] * many / total
        self.mean[at] += apart * many / total
        self.count[at] = total
        self.least[at] = min(self.least[at], column.min())
        self.greatest[at] = max(self.greatest[at], column.max())

    @property
    def deviation(self) -> FloatArray:
        """Standard deviation of each component, ``(k,)``."""
        return np.sqrt(self.square / np.maximum(self.count, 1))


class Steps:
    """Finds where rows of one quantity are missing, by their times: steps much longer than those around.

    Attributes:
        rows: How many rows there were.
        gaps: How many gaps.
        irregular: Steps that differ from the usual one by more than a tenth and a tick of the clock, gaps
            not counted.
        usual: The usual step at the end, s; NaN before there are two rows.
    """

    #: A tick of SampleTimeFine and the rounding of both ends, s.
    TICK = 1.5e-4

    def __init__(self) -> None:
        self.rows = self.gaps = self.irregular = 0
        self.usual = float("nan")
        self._last: float | None = None

    def breaks(self, time: FloatArray) -> BoolArray:
        """Before which rows something is missing, ``(N,)``."""
        if not len(time):
            return np.zeros(0, bool)
        self.rows += len(time)
        first = time[0] if self._last is None else self._last
        steps = np.diff(time, prepend=first)
        # The first step of all is none.
        real = steps[1:] if self._last is None else steps
        self._last = float(time[-1])
        if not len(real):
            return np.zeros(len(time), bool)
        usual = _usual(real)
        if len(real) < AROUND // 4 and np.isfinite(self.usual):
            usual[:] = self.usual  # too few to say what is usual
        self.usual = float(usual[-1])
        long = (real > LONG * usual) | (real < 0)
        odd = ~long & (np.abs(real - usual) > np.maximum(0.1 * usual, self.TICK))
        self.gaps += int(np.count_nonzero(long))
        self.irregular += int(np.count_nonzero(odd))
        return np.concatenate((np.zeros(len(time) - len(real), bool), long))


def _usual(steps: FloatArray) -> FloatArray:
    """For each step the usual one around it: the median of its block."""
    whole = len(steps) // AROUND * AROUND
    blocks = np.partition(steps[:whole].reshape(-1, AROUND), AROUND // 2, axis=1)
    medians = np.repeat(blocks[:, AROUND // 2], AROUND)
    if whole < len(steps):
        # The last block may share rows with the one before.
        last = steps[-AROUND:]
        middle = np.partition(last, len(last) // 2)[len(last) // 2]
        medians = np.concatenate((medians, np.full(len(steps) - whole, middle)))
    # Rows that share a stamp have no step between them.
    return np.where(medians > 0, medians, steps.max())


class Bands:
    """Stretches of time, of which no more are kept than can be drawn.

    Where there are more than `BINS`, those that are nearest to each other become one.

    Attributes:
        start, end: Of each stretch, s, ascending.
        weight: What each stretch stands for, summed where several became one.
        width: Stretches that are no farther apart than this, s, are one.
    """

    def __init__(self) -> None:
        self.start: FloatArray = np.empty(0)
        self.end: FloatArray = np.empty(0)
        self.weight: FloatArray = np.empty(0)
        # What ends where the next begins is one, but for rounding.
        self.width = 1e-6

    def __len__(self) -> int:
        return len(self.start)

    def add(self, start: npt.ArrayLike, end: npt.ArrayLike, weight: npt.ArrayLike) -> None:
        """Takes in stretches."""
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
