"""The recent past of a stream: its curves, and what it is at cursors and between them."""

from __future__ import annotations

import threading
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from xbus.log.column import Column
from xbus.log.log import Log
from xbus.protocol.keys import EntryKey
from xbus.protocol.tables import QUANTITIES, device_of
from xbus.studio.curves import Curve, thin, thin_path
from xbus.studio.gaps import GAP, NEAR, lost_time, usual_period
from xbus.studio.statistics import Statistics, difference, statistics_of

__all__ = ["SPAN", "History", "Reading", "Selection", "Series", "series_name"]

#: Seconds to keep.
SPAN = 300.0
#: Rows of a series to keep at most: `SPAN` at 2 kHz.
MAX_ROWS = 600_000
#: Seconds by which a clock that was set back differs from one that is merely corrected.
CLOCK_STEP = 1.0


class Reading(NamedTuple):
    """The last row at a cursor or before it.

    Attributes:
        time: Seconds since 1970 of the row.
        values: ``(k,)``.
        is_old: Whether the next row is overdue at the cursor.
    """

    time: float
    values: npt.NDArray[np.float64]
    is_old: bool


class Selection(NamedTuple):
    """What a series is at two cursors and between them.

    Attributes:
        series: The series.
        first: Seconds since 1970 of the first row that is kept.
        a, b: What it is at the cursors; None for a cursor without one, or before the first row.
        change: From A to B, ``(k,)``; None without one of them.
        statistics: Of the rows from one cursor to the other, both included; None without one of them.
        lost: Seconds between the cursors without samples; NaN if they are too few. None as above.
    """

    series: Series
    first: float
    a: Reading | None
    b: Reading | None
    change: npt.NDArray[np.float64] | None
    statistics: Statistics | None
    lost: float | None


def series_name(key: EntryKey) -> str:
    """Returns the name of a series, such as ``acceleration`` or ``quaternion NED``."""
    return key if isinstance(key, str) else " ".join(key)


class Series:
    """The recent numbers of one quantity.

    Attributes:
        name: Name of the quantity, and its coordinates if it has any.
        unit: Unit of the numbers.
        fields: Names of the components; a scalar has one, its own name.
        wraps: Whether the numbers are degrees that jump by a turn.
        is_path: Whether the components belong together, as those of a position do.
    """

    def __init__(
        self,
        name: str,
        unit: str,
        fields: tuple[str, ...],
        *,
        rows: int = MAX_ROWS,
        span: float = SPAN,
        wraps: bool = False,
        is_path: bool = False,
    ) -> None:
        self.name, self.unit, self.fields = name, unit, fields
        self.wraps, self.is_path = wraps, is_path
        self._rows, self._span = rows, span
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
        time = np.where(np.isnan(time), -np.inf, time)
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
            old = int(np.searchsorted(self.time, time[-1] - self._span))
            self._begin = max(self._begin + old, self._end - self._rows)

    def part(self, begin: float, end: float) -> Series:
        """Returns a copy of the rows from ``begin`` to ``end``, both included."""
        first, last = np.searchsorted(self.time, begin), np.searchsorted(self.time, end, "right")
        part = Series(
            self.name,
            self.unit,
            self.fields,
            rows=self._rows,
            span=self._span,
            wraps=self.wraps,
            is_path=self.is_path,
        )
        part._time = self.time[first:last].copy()
        part._values = self.values[first:last].copy()
        part._end = len(part._time)
        return part

    def _make_room(self, count: int) -> None:
        kept = self._end - self._begin
        time, values = self._time, self._values
        if kept + count > 0.75 * len(time):
            size = 2 * (kept + count)
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

    def add_block(self, block: Log, time: npt.NDArray[np.float64]) -> None:
        """Adds the samples of a block.

        Args:
            block: The block.
            time: The time of each sample, in seconds since 1970; samples without one are left out.
        """
        with self._lock:
            self._devices.update(device_of(bid) for bid, _ in block.core.devices)
            device = device_of(block.bid) if len(self._devices) > 1 else None
            for key in block:
                column = block[key]
                if not _is_numeric(column):
                    continue
                rows = column.sample - block.first_sample
                numbers = np.asarray(column.scaled, np.float64).reshape(len(rows), -1)
                if device is None:
                    self._named(series_name(key), column).add(time[rows], numbers)
                    continue
                for bid in np.unique(device[rows]).tolist():
                    own = device[rows] == bid
                    name = f"{series_name(key)} of BID {bid}"
                    self._named(name, column).add(time[rows][own], numbers[own])

    def copy(self, name: str, begin: float, end: float) -> Series | None:
        """Returns a copy of a series between two times in seconds since 1970, to which nothing is added.

        Returns:
            None if there is no such series.
        """
        with self._lock:
            series = self._series.get(name)
            return None if series is None else series.part(begin, end)

    def put(self, series: Series) -> None:
        """Adds a whole series, in place of one that has its name."""
        with self._lock:
            self._series[series.name] = series

    def add_rows(
        self, series: Series, time: npt.NDArray[np.float64], numbers: npt.NDArray[np.float64]
    ) -> None:
        """Adds rows to a series that no quantity has.

        Args:
            series: The series; it is known by its name from then on.
            time: Seconds since 1970, ``(n,)``.
            numbers: ``(n, k)``.
        """
        with self._lock:
            self._series.setdefault(series.name, series).add(time, numbers)

    def times(self, block: Log, now: float) -> npt.NDArray[np.float64]:
        """Returns the host time of each sample of a block, in seconds since 1970.

        The arrival of a sample without a time stamp is estimated.

        Args:
            block: The block, with host times.
            now: When it was received, in seconds since 1970.
        """
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
            wraps = QUANTITIES[column.name].interpolation == "angle"
            series = self._series[name] = Series(name, column.unit, fields, wraps=wraps)
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
            # The rows before show whether the curve begins with a gap.
            context = max(int(first) - NEAR - 1, 0)
            time = series.time[context:last].copy()
            values = series.values[context:last].copy()
        draw = thin_path if series.is_path else thin
        return draw(time, values, step, skip=int(first) - context)

    def selection(self, name: str, a: float | None, b: float | None) -> Selection | None:
        """Returns what a series is at two cursors, in seconds since 1970, and from one to the other.

        It is computed from every sample that is kept.

        Returns:
            None if there is no such series, or nothing in it.
        """
        with self._lock:
            series = self._series.get(name)
            if series is None or not len(series.time):
                return None
            first = float(series.time[0])
            before, after = (None if at is None else _reading(series, at) for at in (a, b))
            if a is None or b is None:
                return Selection(series, first, before, after, None, None, None)
            begin, end = min(a, b), max(a, b)
            low = int(np.searchsorted(series.time, begin, side="left"))
            high = int(np.searchsorted(series.time, end, side="right"))
            time, values = series.time[low:high].copy(), series.values[low:high].copy()
            # Rows around it show what is usual.
            around = series.time[max(low - 2 * NEAR, 0) : high + 2 * NEAR].copy()
        return Selection(
            series,
            first,
            before,
            after,
            None
            if before is None or after is None
            else difference(before.values, after.values, wraps=series.wraps),
            statistics_of(time, values, wraps=series.wraps),
            lost_time(around, begin, end),
        )


def _reading(series: Series, at: float) -> Reading | None:
    """Returns the last row at a time or before it."""
    row = int(np.searchsorted(series.time, at, side="right")) - 1
    if row < 0:
        return None
    time = float(series.time[row])
    usual = usual_period(series.time[: row + 1])
    return Reading(time, series.values[row].copy(), at - time > GAP * usual)


def _is_numeric(column: Column) -> bool:
    row = QUANTITIES[column.name]
    return column.values.dtype.names is None and not row.has_flags and row.kind != "id"
