"""The recent past of a stream, and curves of it with few points that keep every extreme."""

from __future__ import annotations

import threading
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from xbus.log.column import Column
from xbus.log.log import Log
from xbus.protocol.keys import EntryKey
from xbus.protocol.tables import QUANTITIES, device_of

__all__ = ["Curve", "History", "Series", "series_name", "thin"]

#: Seconds to keep.
SPAN = 300.0
#: Rows of a series to keep at most: `SPAN` at 2 kHz.
MAX_ROWS = 600_000
#: A curve has a gap where samples are this many times further apart than usual.
GAP = 3.0
#: Seconds by which a clock that was set back differs from one that is merely corrected.
CLOCK_STEP = 1.0
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


def series_name(key: EntryKey) -> str:
    """Returns the name of a series, such as ``acceleration`` or ``quaternion NED``."""
    return key if isinstance(key, str) else " ".join(key)


class Series:
    """The recent numbers of one quantity.

    Attributes:
        name: Name of the quantity, and its coordinates if it has any.
        unit: Unit of the numbers.
        fields: Names of the components; a scalar has one, its own name.
    """

    def __init__(self, name: str, unit: str, fields: tuple[str, ...], rows: int = MAX_ROWS) -> None:
        self.name, self.unit, self.fields = name, unit, fields
        self._rows = rows
        self._time = np.empty(1024)
        self._values = np.empty((1024, len(fields)), np.float64)
        self._begin = self._end = 0

    @property
    def time(self) -> npt.NDArray[np.float64]:
        """Seconds since 1970 of each row, ascending."""
        return self._time[self._begin : self._end]

    @property
    def values(self) -> npt.NDArray[np.float64]:
        """The numbers, ``(n, k)``."""
        return self._values[self._begin : self._end]

    def end_of_columns(self, step: float) -> float:
        """Returns the time until which columns of pixels are complete; -inf without rows.

        Times ascend, so that the column before the one of the last row is. A column with a single row needs
        no other.
        """
        time = self.time[-16:]
        if not len(time):
            return -np.inf
        last = float(time[-1])
        is_sparse = len(time) > 1 and (last - time[0]) / (len(time) - 1) >= step
        return last if is_sparse else float(np.floor(last / step)) * step

    def add(self, time: npt.NDArray[np.float64], values: npt.NDArray[np.float64]) -> None:
        """Adds rows. Rows that are not after the last one, and those without a time, are left out.

        If all are more than a second earlier, the clock was set back: the series begins again.
        """
        time = np.nan_to_num(time, nan=-np.inf)
        last = self._time[self._end - 1] if self._end > self._begin else -np.inf
        if -np.inf < time.max(initial=-np.inf) < last - CLOCK_STEP:
            self._begin = self._end = 0
            last = -np.inf
        ahead = np.maximum.accumulate(np.concatenate([[last], time]))
        keep = ahead[1:] > ahead[:-1]
        if not keep.all():
            time, values = time[keep], values[keep]
        count = len(time)
        if self._end + count > len(self._time):
            self._make_room(count)
        self._time[self._end : self._end + count] = time
        self._values[self._end : self._end + count] = values
        self._end += count
        if count:
            old = int(np.searchsorted(self.time, time[-1] - SPAN))
            self._begin = max(self._begin + old, self._end - self._rows)

    def _make_room(self, count: int) -> None:
        kept = self._end - self._begin
        size = max(1024, 2 * (kept + count))
        time, values = np.empty(size), np.empty((size, len(self.fields)), np.float64)
        time[:kept], values[:kept] = self.time, self.values
        self._time, self._values = time, values
        self._begin, self._end = 0, kept


class History:
    """The recent numbers of all quantities of a stream. Several threads may use it."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._series: dict[str, Series] = {}
        self._devices: set[int] = set()
        self._received = 0.0

    @property
    def series(self) -> dict[str, Series]:
        """The series by name, in order of first arrival."""
        with self._lock:
            return dict(self._series)

    def add_block(self, block: Log, now: float) -> None:
        """Adds the samples of a block.

        Args:
            block: The block, with host times.
            now: When it was received, in seconds since 1970.
        """
        time = self._times(block, now)
        device = device_of(block.bid)
        with self._lock:
            self._devices.update(np.unique(device).tolist())
            for key in block:
                column = block[key]
                if not _is_numeric(column):
                    continue
                rows = column.sample - block.first_sample
                numbers = np.asarray(column.scaled, np.float64).reshape(len(rows), -1)
                if len(self._devices) == 1:
                    self._named(series_name(key), column).add(time[rows], numbers)
                    continue
                for bid in np.unique(device[rows]).tolist():
                    own = device[rows] == bid
                    name = f"{series_name(key)} of BID {bid}"
                    self._named(name, column).add(time[rows][own], numbers[own])

    def add_row(
        self, name: str, unit: str, fields: tuple[str, ...], time: float, numbers: Iterable[float]
    ) -> None:
        """Adds one row to a series that no quantity has.

        Args:
            name: Name of the series.
            unit: Unit of the numbers.
            fields: Names of the numbers.
            time: Seconds since 1970.
            numbers: One for each field.
        """
        with self._lock:
            series = self._series.setdefault(name, Series(name, unit, fields))
            series.add(np.array([time]), np.array([list(numbers)], np.float64))

    def _times(self, block: Log, now: float) -> npt.NDArray[np.float64]:
        """Returns the host time of each sample; the arrival of one without a time stamp is estimated."""
        time = block.host_time
        before, self._received = self._received, now
        if np.isfinite(time).all():
            return time
        begin = before if 0 < now - before < 1 else now - 0.001 * len(block)
        return np.where(np.isfinite(time), time, np.linspace(begin, now, len(block) + 1)[1:])

    def _named(self, name: str, column: Column) -> Series:
        series = self._series.get(name)
        if series is None:
            fields = tuple(column.fields) or (column.name,)
            series = self._series[name] = Series(name, column.unit, fields)
        return series

    def end_of_columns(self, name: str, step: float) -> float:
        """Returns the time until which the columns of pixels of a series are complete; -inf without one."""
        with self._lock:
            series = self._series.get(name)
            return -np.inf if series is None else series.end_of_columns(step)

    def curve(self, name: str, begin: float, end: float, step: float) -> Curve | None:
        """Returns the curve of a series after ``begin`` and until ``end``; None if there is no such series.

        Args:
            name: Name of the series.
            begin: Seconds since 1970; a point at this time is left out.
            end: Seconds since 1970; a point at this time is included.
            step: Seconds that one column of pixels covers.
        """
        with self._lock:
            series = self._series.get(name)
            if series is None:
                return None
            first, last = np.searchsorted(series.time, [begin, end], side="right")
            # The row before shows whether the curve begins with a gap.
            context = max(int(first) - 1, 0)
            time = series.time[context:last].copy()
            values = series.values[context:last].copy()
        return thin(time, values, step, skip=int(first) - context)


def _is_numeric(column: Column) -> bool:
    row = QUANTITIES[column.name]
    return column.values.dtype.names is None and not row.has_flags and row.kind != "id"


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

    A gap, where rows are further apart than three times the median, gets a point of NaN.

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
    places = np.flatnonzero(np.isin(begins, _gaps(time) - skip, assume_unique=False))
    if drawn is not rows:
        places = places[::POINTS]
    return Curve(np.insert(drawn, places, drawn[places]), np.insert(points, places, np.nan, axis=1))


def _gaps(time: npt.NDArray[np.float64]) -> npt.NDArray[np.intp]:
    """Returns the rows that come after a gap."""
    periods = np.diff(time)
    if len(periods) < 2:
        return np.empty(0, np.intp)
    return np.flatnonzero(periods > GAP * np.median(periods)) + 1


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
