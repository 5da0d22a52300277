"""Resampling: quantities of a log at a constant rate, on common times."""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable, Iterable, Iterator
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from xbus import _core
from xbus.export import tables
from xbus.geometry import quaternion
from xbus.log.arrays import read_only
from xbus.log.column import Column
from xbus.log.runs import PartRuns, Runs
from xbus.log.table_file import write_table
from xbus.protocol.keys import ByQuantity, EntryKey, KeyIndex, QuantityKey
from xbus.protocol.tables import COLUMN_QUANTITIES, Field, Quantity

if TYPE_CHECKING:
    import pandas as pd
    import polars as pl
    import pyarrow as pa

__all__ = ["GAP_STEPS", "Resampled", "Span", "check_rate", "interpolated", "spans"]

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]

#: Default of the longest gap between two rows that is bridged, in usual steps of the quantity: one lost row.
GAP_STEPS = 2.5
#: Times that differ by less are the same, s: a tick of SampleTimeFine is 100 times as long.
SAME = 1e-6
#: Units of record fields that change steadily; other fields are counts, dates, bits or parts of a date.
STEADY_UNITS = ("m", "m/s", "deg")

#: More rows than this, and than this many for each sample, are refused.
MOST_ROWS, MOST_PER_SAMPLE = 10_000_000, 1000


class Span(NamedTuple):
    """The time of one run.

    Attributes:
        bid: Bus identifier of the device.
        run: Index of the run.
        samples: Indices of its samples in the part, ascending.
        start, end: First and last time stamp, s.
    """

    bid: int
    run: int
    samples: npt.NDArray[np.intp]
    start: float
    end: float

    def steps(self, rate: float) -> float:
        """Returns the number of steps of a constant rate."""
        return float(np.floor((self.end - self.start + SAME) * rate))

    def grid(self, rate: float) -> FloatArray:
        """Returns the times of a constant rate, from the start."""
        return self.start + np.arange(int(self.steps(rate)) + 1) / rate


def spans(runs: Runs, of_samples: PartRuns) -> Iterator[Span]:
    """Yields the time of each run that has time stamps, the runs of one device after those of another.

    Args:
        runs: The runs of the log.
        of_samples: The runs that its samples belong to.
    """
    order = np.argsort(of_samples.run, kind="stable")
    samples = np.split(order, np.searchsorted(of_samples.run[order], np.arange(1, len(runs))))
    stamps, bids = runs.spans, runs.rows["bid"]
    for number in itertools.chain.from_iterable(runs.of_devices().values()):
        span = stamps[number]
        if span["stamps"]:
            own = samples[number]
            yield Span(
                int(bids[number]), int(number), own, float(span["start"]), float(span["end"])
            )


class Resampled(ByQuantity[npt.NDArray[Any]]):
    """Quantities of a log at a constant rate: a mapping from key to values, one row for each time.

    Comes from `Log.resample`. ``len(resampled)`` is the number of rows. Interpolated values are float64, NaN
    where they are unknown. Values that keep the previous one, such as ``status_word``, and records are masked
    arrays.

    Attributes:
        rate: Rows per second.
        time: Seconds on the device clock, ``(N,)`` float64, read-only. The times of a run begin at its first
            time stamp.
        run: Index of the run of each row in `Log.runs`, ``(N,)`` int64, read-only.
        bid: Bus identifier of the device of each row, ``(N,)`` uint8, read-only.
        utc: UTC, ``(N,)`` ``datetime64[ns]``, read-only; interpolated between samples that have it. NaT
            elsewhere, and if the quantities include neither ``utc_time`` nor ``gnss_pvt_data``.

    >>> import xbus
    >>> log = xbus.read_log("tests/captures/walk.mtb")
    >>> resampled = log.resample(50, quantities=["acceleration", "quaternion"])
    >>> resampled
    <Resampled 500 rows at 50 Hz: acceleration, quaternion>
    >>> resampled["acceleration"].shape
    (500, 3)
    """

    def __init__(
        self,
        rate: float,
        spans: Iterable[Span],
        columns: Iterable[Column],
        *,
        utc: tuple[npt.NDArray[np.datetime64], FloatArray] | None,
        max_gap: float | None,
        first_sample: int,
    ) -> None:
        self.rate = rate
        self._columns = list(columns)
        spans = list(spans)
        _check_rows(spans, rate)
        grids = [span.grid(rate) for span in spans]
        self.time: FloatArray = read_only(np.concatenate([np.empty(0), *grids]))
        counts = [len(grid) for grid in grids]
        self.run = read_only(np.repeat([span.run for span in spans], counts).astype(np.int64))
        self.bid = read_only(np.repeat([span.bid for span in spans], counts).astype(np.uint8))
        values = [
            _joined(
                [
                    interpolated(column, _rows_of(column, span, first_sample), grid, max_gap)
                    for span, grid in zip(spans, grids, strict=True)
                ],
                column,
            )
            for column in self._columns
        ]
        stamps = [
            _interpolated_utc(utc, span, grid, max_gap)
            for span, grid in zip(spans, grids, strict=True)
        ]
        self.utc = read_only(np.concatenate([np.empty(0, "datetime64[ns]"), *stamps]))
        index = KeyIndex(
            QuantityKey(column.name, column.coordinates, column.precision)
            for column in self._columns
        )
        super().__init__(index, values, "resampled log")

    def __len__(self) -> int:
        return len(self.time)

    # Tables

    def to_arrow(self) -> pa.Table:
        """Returns a pyarrow table: ``time`` and a column for each component; null where a value is unknown.

        Names, units and metadata are those of `Log.to_arrow`. With several devices there is a column
        ``bid``, with several runs a column ``run``, and where UTC is known a column ``utc``.

        Raises:
            ImportError: The extra ``arrow`` is not installed.
        """
        table: pa.Table = tables.arrow(self.arrow_stream())
        return table

    def arrow_stream(self) -> _core.ArrowStream:
        """Returns the table of `to_arrow` as a stream for libraries that speak the Arrow C interface."""
        return tables.stream_of(self._series())

    def __arrow_c_stream__(self, requested_schema: object = None) -> object:
        """Returns the table of `to_arrow`, for libraries that speak the Arrow C interface."""
        return self.arrow_stream().__arrow_c_stream__(requested_schema)

    def to_pandas(self) -> pd.DataFrame:
        """Returns the table of `to_arrow` as a pandas DataFrame.

        Raises:
            ImportError: The extra ``pandas`` is not installed.
        """
        frame: pd.DataFrame = tables.pandas_from_arrow(self.to_arrow())
        return frame

    def to_polars(self) -> pl.DataFrame:
        """Returns the table of `to_arrow` as a polars DataFrame.

        Raises:
            ImportError: The extra ``polars`` is not installed.
        """
        frame: pl.DataFrame = tables.polars(self.arrow_stream())
        return frame

    def to_parquet(self, path: str | os.PathLike[str]) -> None:
        """Writes the table of `to_arrow` to a Parquet file, which appears whole or not at all.

        Raises:
            OSError: The file cannot be written.
        """
        write_table(self.arrow_stream(), path, "parquet")

    def to_csv(self, path: str | os.PathLike[str]) -> None:
        """Writes the table of `to_arrow` to a CSV file. Errors are those of `to_parquet`."""
        write_table(self.arrow_stream(), path, "csv")

    def to_feather(self, path: str | os.PathLike[str]) -> None:
        """Writes the table of `to_arrow` to an Arrow file. Errors are those of `to_parquet`."""
        write_table(self.arrow_stream(), path, "arrow")

    def to_npz(self, path: str | os.PathLike[str]) -> None:
        """Writes ``time``, ``run``, ``bid``, ``utc`` and the values of each quantity to an npz file.

        Beside masked values there is ``NAME.known``, True where the value is known; for records by field.

        Raises:
            OSError: The file cannot be written.
        """
        tables.npz(self.npz_arrays(), path)

    def npz_arrays(self) -> dict[str, npt.NDArray[Any]]:
        """Returns the arrays of `to_npz`, by name."""
        names = ("time", "run", "bid", "utc")
        arrays: dict[str, npt.NDArray[Any]] = {name: getattr(self, name) for name in names}
        for key, values in self.items():
            stem = _stem(key)
            arrays[stem] = np.ma.getdata(values)
            if np.ma.isMaskedArray(values):
                mask = np.ma.getmaskarray(values)
                # Of a record, the mask has a byte for each field.
                known = ~np.ascontiguousarray(mask).view(np.bool_)
                arrays[f"{stem}.known"] = known.view(mask.dtype).reshape(mask.shape)
        return arrays

    def __repr__(self) -> str:
        return f"<Resampled {len(self):,} rows at {self.rate:g} Hz: {', '.join(map(_stem, self))}>"

    def _series(self) -> Iterator[tuple[str, npt.NDArray[Any], dict[str, str]]]:
        """Yields name, values and metadata of each column of the table."""
        yield "time", self.time, {"unit": "s"}
        if len(np.unique(self.bid)) > 1:
            yield "bid", self.bid, {}
        if len(np.unique(self.run)) > 1:
            yield "run", self.run, {}
        if not np.isnat(self.utc).all():
            yield "utc", self.utc, {}
        for (key, values), column in zip(self.items(), self._columns, strict=True):
            row, stem = COLUMN_QUANTITIES[column.name], _stem(key)
            metadata = {"data_id": f"0x{column.data_id:04X}"}
            if column.coordinates:
                metadata["coordinates"] = column.coordinates
            units = [field.unit for field in row.fields] or [row.unit] * row.numbers
            for (name, component), unit in zip(_components(row, values), units, strict=True):
                pairs = {"unit": unit, **metadata} if unit else metadata
                yield f"{stem}_{name}" if name else stem, component, pairs


def _check_rows(spans: list[Span], rate: float) -> None:
    """Raises ValueError if the number of rows shows that the rate or the time stamps are wrong."""
    samples = sum(len(span.samples) for span in spans)
    rows = sum(span.steps(rate) for span in spans)
    if rows > max(MOST_ROWS, MOST_PER_SAMPLE * samples):
        seconds = sum(span.end - span.start for span in spans)
        raise ValueError(
            f"{rows:,.0f} rows would be made of {samples:,} samples; choose a lower rate than {rate:g} Hz, "
            f"or check the time stamps, which span {seconds:,.0f} s"
        )


def check_rate(rate: float) -> None:
    """Checks the rate of a resampling.

    Raises:
        ValueError: It is not a positive number.
    """
    if not (np.isfinite(rate) and rate > 0):
        raise ValueError(f"rate must be a positive number of rows per second, not {rate!r}")


def _stem(key: EntryKey) -> str:
    return key if isinstance(key, str) else f"{key[0]}_{key[1].lower()}"


def _components(row: Quantity, values: npt.NDArray[Any]) -> Iterator[tuple[str, npt.NDArray[Any]]]:
    """Yields name and values of each component or field, in the order of the wire."""
    if row.fields:
        for field in row.fields:
            yield field.name, values[field.name]
    elif row.is_matrix:
        for name in row.components:
            yield name, values[:, int(name[1]) - 1, int(name[2]) - 1]
    elif row.components:
        for at, name in enumerate(row.components):
            yield name, values[:, at]
    else:
        yield "", values


def _rows_of(column: Column, span: Span, first_sample: int) -> npt.NDArray[np.intp]:
    """Returns the rows of a column in a run, in order of time, the last of those with the same time.

    Rows outside the run are left out: samples of a GNSS receiver without a fix have arbitrary times.
    """
    sample = column.sample - first_sample
    # The runs of one device follow each other, so a log with many costs no more than one.
    first, end = np.searchsorted(sample, (span.samples[0], span.samples[-1] + 1))
    rows = first + np.flatnonzero(np.isin(sample[first:end], span.samples, kind="table"))
    return np.asarray(rows[_ordered(column.time[rows], span)])


def _ordered(time: FloatArray, span: Span) -> npt.NDArray[np.intp]:
    """Returns the indices of the times in a run, ascending, the last of those that are the same."""
    rows = np.flatnonzero((time >= span.start - SAME) & (time <= span.end + SAME))
    rows = rows[np.argsort(time[rows], kind="stable")]
    is_last = np.append(np.diff(time[rows]) > SAME, True)[: len(rows)]
    return np.asarray(rows[is_last])


class _Neighbours(NamedTuple):
    """The rows around each time of a grid.

    Attributes:
        left, right: Their indices.
        weight: Place between them, 0 to 1.
        is_between: Whether the grid's time is on a row, or between two that are near enough.
        is_after: Whether the left row is near enough.
    """

    left: npt.NDArray[np.intp]
    right: npt.NDArray[np.intp]
    weight: FloatArray
    is_between: BoolArray
    is_after: BoolArray


def _neighbours(stamps: FloatArray, grid: FloatArray, max_gap: float | None) -> _Neighbours:
    if max_gap is None:
        max_gap = GAP_STEPS * float(np.median(np.diff(stamps))) if len(stamps) > 1 else 0.0
    last = np.searchsorted(stamps, grid + SAME, "right") - 1
    left = np.maximum(last, 0)
    right = np.minimum(left + 1, len(stamps) - 1)
    since, step = grid - stamps[left], stamps[right] - stamps[left]
    is_on = since <= SAME
    right = np.where(is_on, left, right)  # values of the next row, which may be NaN, do not count
    weight = np.where(is_on, 0.0, since / np.where(step > 0, step, 1.0))
    is_between = (last >= 0) & (is_on | ((right > left) & (step <= max_gap + SAME)))
    is_after = (last >= 0) & (since <= max_gap + SAME)
    return _Neighbours(left, right, weight, is_between, is_after)


def interpolated(
    column: Column, rows: npt.NDArray[np.intp], grid: FloatArray, max_gap: float | None
) -> npt.NDArray[Any]:
    """Returns the values of rows of a column at the times of a grid.

    Args:
        column: A quantity whose row has an ``interpolation``.
        rows: Rows with ascending times.
        grid: Times, ``(N,)``, s.
        max_gap: Longest bridged step between two rows, s; None means `GAP_STEPS` usual steps.

    Returns:
        float64 with NaN, or a masked array: see `Resampled`.
    """
    row = COLUMN_QUANTITIES[column.name]
    if not len(rows):
        return _unknown(column, len(grid))
    near = _neighbours(column.time[rows], grid, max_gap)
    if row.fields:
        return _records(column.scaled[rows], row, near)
    values = column.values[rows]
    if row.interpolation == "previous":
        # A row is known or unknown as a whole.
        is_unknown = np.broadcast_to(~near.is_after, values.shape[:0:-1] + near.left.shape).T
        return np.ma.masked_array(values[near.left], is_unknown)
    assert row.interpolation is not None  # noqa: S101 - a precondition
    with np.errstate(invalid="ignore", over="ignore"):  # a log can contain any number
        mixed = _MIXES[row.interpolation](values, near)
    mixed[~near.is_between] = np.nan
    return mixed


def _interpolated_utc(
    known: tuple[npt.NDArray[np.datetime64], FloatArray] | None,
    span: Span,
    grid: FloatArray,
    max_gap: float | None,
) -> npt.NDArray[np.datetime64]:
    """Returns the UTC of the times of a grid, from UTC and time of the samples of a log."""
    found = np.full(len(grid), "NaT", "datetime64[ns]")
    if known is None:
        return found
    utc, time = known
    samples = span.samples[~np.isnat(utc[span.samples])]
    rows = samples[_ordered(time[samples], span)]
    if len(rows):
        near = _neighbours(time[rows], grid, max_gap)
        # Nanoseconds since 1970 exceed the digits of a float64.
        since = (utc[rows] - utc[rows[0]]).astype(np.int64)
        nanoseconds = np.rint(_linear(since, near)).astype("timedelta64[ns]")
        found[near.is_between] = (utc[rows[0]] + nanoseconds)[near.is_between]
    return found


def _linear(values: npt.NDArray[Any], near: _Neighbours) -> FloatArray:
    before, after = (values[side].astype(np.float64) for side in (near.left, near.right))
    weight = near.weight.reshape(-1, *[1] * (values.ndim - 1))
    return before + np.where(weight == 0, 0.0, after - before) * weight


def _angle(values: npt.NDArray[Any], near: _Neighbours) -> FloatArray:
    """Interpolates degrees the shorter way; the range is that of the input: from -180 or from 0."""
    before, after = (values[side].astype(np.float64) for side in (near.left, near.right))
    weight = near.weight.reshape(-1, *[1] * (values.ndim - 1))
    step = (after - before + 180) % 360 - 180
    mixed = before + np.where(weight == 0, 0.0, step) * weight
    lowest = np.where((values < 0).any(axis=0), -180.0, 0.0)
    mixed = np.where(mixed < lowest, mixed + 360, mixed)
    return np.where(mixed > lowest + 360, mixed - 360, mixed)


def _rotation(values: npt.NDArray[Any], near: _Neighbours) -> FloatArray:
    is_matrix = values.ndim == 3
    wide = values.astype(np.float64)
    turns = quaternion.from_matrix(wide) if is_matrix else wide
    mixed = quaternion.slerp(turns[near.left], turns[near.right], near.weight)
    return quaternion.to_matrix(mixed) if is_matrix else mixed


_MIXES: dict[str, Callable[[npt.NDArray[Any], _Neighbours], FloatArray]] = {
    "linear": _linear,
    "angle": _angle,
    "rotation": _rotation,
}


def _is_steady(field: Field, row: Quantity) -> bool:
    return row.interpolation == "linear" and field.unit in STEADY_UNITS


def _records(
    records: npt.NDArray[Any], row: Quantity, near: _Neighbours
) -> np.ma.MaskedArray[Any, Any]:
    """Interpolates fields in `STEADY_UNITS`; the others keep the previous value."""
    mixed = np.ma.empty(len(near.left), records.dtype)
    for field in row.fields:
        values = records[field.name]
        if _is_steady(field, row):
            mix = _angle if field.unit == "deg" else _linear
            values, is_known = mix(values, near), near.is_between
        else:
            values, is_known = values[near.left], near.is_after
        if values.dtype.kind == "f":
            values = np.where(is_known, values, np.nan)
        mixed[field.name] = np.ma.masked_array(values, ~is_known)
    return mixed


def _unknown(column: Column, count: int) -> npt.NDArray[Any]:
    """Returns rows of which nothing is known."""
    row = COLUMN_QUANTITIES[column.name]
    if row.fields:
        return np.ma.masked_array(np.zeros(count, column.scaled.dtype), True)
    if row.interpolation == "previous":
        return np.ma.masked_array(np.zeros((count, *row.shape), column.dtype), True)
    return np.full((count, *row.shape), np.nan)


def _joined(parts: list[npt.NDArray[Any]], column: Column) -> npt.NDArray[Any]:
    parts = parts or [_unknown(column, 0)]
    data = read_only(np.concatenate([np.ma.getdata(part) for part in parts]))
    if not np.ma.isMaskedArray(parts[0]):
        return data
    return np.ma.masked_array(data, np.concatenate([np.ma.getmaskarray(part) for part in parts]))
