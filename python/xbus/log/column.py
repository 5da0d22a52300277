"""One quantity of a log."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import cached_property
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np
import numpy.typing as npt

from xbus import _core
from xbus.export import tables
from xbus.log.arrays import identical, read_only
from xbus.log.arrivals import HostTimes
from xbus.log.flags import Flags
from xbus.log.rates import Rates
from xbus.log.rendering import html_table
from xbus.log.runs import Runs
from xbus.protocol.tables import COLUMN_QUANTITIES, Field, Quantity

if TYPE_CHECKING:
    import pandas as pd
    import polars as pl
    import pyarrow as pa

    from xbus.log.plotting import PlotTime
    from xbus.plots.draw import Backend

__all__ = ["Column"]

#: Rows that a notebook shows.
SHOWN = 6


class Column:
    """Every packet of one quantity, one row each, in the order in which they were received.

    Comes from a log: ``log["acceleration"]``. A column behaves like the array of its `values`: it has a
    length, a shape and a dtype, can be indexed and iterated, and numpy, pandas and polars take it as it is.
    Arithmetic is on ``column.values``. A name of `fields` gives one component: ``column["x"]``. All arrays
    are read-only.

    Columns can be pickled, and two are equal if all of their arrays are identical, with NaN equal to NaN.

    Attributes:
        name: Name of the quantity, as in the manual, in snake_case.
        unit: Unit of the values; empty for numbers without a unit and for structs, whose fields have `units`.
        precision: ``"Float32"``, ``"Fp1220"``, ``"Fp1632"`` or ``"Float64"``; None if several occur, and for
            integers.
        coordinates: ``"ENU"``, ``"NED"`` or ``"NWU"``; None if the manual defines none for the quantity.
        data_id: Data identifier as received; the one with format bits zero if several occur.

    >>> import numpy as np
    >>> import xbus
    >>> column = xbus.read_log("tests/captures/walk.mtb")["acceleration"]
    >>> column.shape, column.dtype, column.unit
    ((1000, 3), dtype('float32'), 'm/s2')
    >>> f"{np.mean(column['z']):.2f}", column[:10].shape
    ('9.81', (10, 3))
    """

    def __init__(self, core: _core.Column, host_times: HostTimes) -> None:
        assert core.name is not None  # noqa: S101 - unknown identifiers have no column
        self._core = core
        # The part and not the Log: a reference to the Log would be a cycle, and keep parts of a long log in
        # memory.
        self._part = host_times.part
        self._host_times = host_times
        self._row: Quantity = COLUMN_QUANTITIES[core.name]
        self.name: str = core.name
        self.unit: str = self._row.unit
        self.precision: str | None = core.precision
        self.coordinates: str | None = core.coordinates
        self.data_id: int = core.data_id

    # The column as an array

    def __len__(self) -> int:
        return len(self._core)

    def __getitem__(self, index: Any) -> Any:
        """Returns rows of `values` by index, slice or mask, or one component by its name.

        Raises:
            IndexError: The index is out of range.
            KeyError: The quantity has no component or field of this name.
        """
        if not isinstance(index, str):
            return self.values[index]
        if index not in self.fields:
            fields = ", ".join(self.fields) or "only one number, without a name"
            raise KeyError(f"{self.name} has no {index!r}; it has {fields}")
        if self._row.fields:
            return self.values[index]
        place = self.fields.index(index)
        return (
            self.values[:, place // 3, place % 3] if self._row.is_matrix else self.values[:, place]
        )

    def __iter__(self) -> Iterator[Any]:
        return iter(self.values)

    def __array__(
        self, dtype: npt.DTypeLike | None = None, copy: bool | None = None
    ) -> npt.NDArray[Any]:
        return np.array(self.values, dtype, copy=copy)

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of `values`: ``(N,)``, ``(N, k)`` or ``(N, 3, 3)``."""
        return self.values.shape

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type of `values`."""
        return self.values.dtype

    @cached_property
    def fields(self) -> tuple[str, ...]:
        """Names of the components or fields of a row, in the order of the last axes of `values`.

        Empty for a scalar.
        """
        if self._row.fields:
            return tuple(field.name for field in self._row.fields)
        return tuple(sorted(self._row.components)) if self._row.is_matrix else self._row.components

    # Arrays

    @cached_property
    def values(self) -> npt.NDArray[Any]:
        """The numbers, read-only.

        ``(N,)`` for scalars and ``(N, k)`` for vectors: float32 for Float32, float64 for the other
        precisions and mixed ones (exact), integers as on the wire. ``rotation_matrix`` is ``(N, 3, 3)``:
        ``values[n, i, j]`` is row i, column j. Structs are structured arrays ``(N,)`` of raw integers, with
        the manual's field names.
        """
        flat: npt.NDArray[Any] = self._core.values
        if self._row.fields:
            return flat.view(_dtype(self._row.fields))
        rows = flat.reshape(-1, *self._row.shape)
        # A matrix is column by column on the wire (section 5.3.6).
        return rows.transpose(0, 2, 1) if self._row.is_matrix else rows

    @cached_property
    def sample(self) -> npt.NDArray[np.int64]:
        """Index of the sample of each row, from the start of the log, ``(N,)`` int64."""
        return read_only(self._core.sample)

    @cached_property
    def time(self) -> npt.NDArray[np.float64]:
        """Seconds on the device clock, unwrapped, ``(N,)`` float64; NaN if the sample has no time stamp."""
        return read_only(self._part.time[self.sample - self._part.first])

    @cached_property
    def host_time(self) -> npt.NDArray[np.float64]:
        """Seconds since 1970 on the clock of the host, ``(N,)`` float64: see `Log.host_time`."""
        return read_only(self._host_times.time[self.sample - self._part.first])

    @cached_property
    def scaled(self) -> npt.NDArray[Any]:
        """The fields of a struct in SI units and degrees, as a structured array ``(N,)``.

        Fields with a scale are float64, with NaN for the value that means "not provided"; counts, dates and
        bits stay integers. For a quantity that is not a struct, `scaled` is `values`.
        """
        return _scaled(self.values, self._row.fields) if self._row.fields else self.values

    @property
    def units(self) -> dict[str, str]:
        """Unit of each field of `scaled` for a struct; empty for counts, dates and bits."""
        return {field.name: field.unit for field in self._row.fields}

    @cached_property
    def flags(self) -> Flags:
        """The bits of ``status_word`` or ``status_byte`` by name (Table 27).

        Raises:
            AttributeError: The quantity has no flags.

        >>> import xbus
        >>> xbus.read_log(xbus.encode_sample({"status_word": 0b10}))["status_word"].flags["filter_valid"]
        array([ True])
        """
        if not self._row.has_flags:
            self._refuse("flags", "status_word and status_byte have")
        return Flags(self.values, self._row)

    @cached_property
    def datetime(self) -> npt.NDArray[np.datetime64]:
        """``utc_time`` or ``gnss_pvt_data`` as ``datetime64[ns]``, ``(N,)``; NaT for an impossible date.

        The device marks a valid time in ``values["valid"]`` (Tables 35 and 25); `Log.utc` has only valid
        times.

        Raises:
            AttributeError: The quantity has no date.
        """
        if (nanoseconds := self._core.nanoseconds) is None:
            self._refuse("datetime", "utc_time and gnss_pvt_data have")
        return read_only(nanoseconds.view("datetime64[ns]"))

    @cached_property
    def satellites(self) -> npt.NDArray[Any]:
        """One structured row (gnssId, svId, cno, flags) for each satellite of ``gnss_sat_info`` (Table 26).

        The satellites of row ``n`` are ``satellites[offsets[n]:offsets[n + 1]]``.

        Raises:
            AttributeError: The quantity is not ``gnss_sat_info``.
        """
        if not self._row.entry:
            self._refuse("satellites", "gnss_sat_info has")
        return self._core.entries.view(_dtype(self._row.entry))

    @cached_property
    def offsets(self) -> npt.NDArray[np.int64]:
        """Index into `satellites` at which each row begins, and their number at the end, ``(N + 1,)`` int64.

        Raises:
            AttributeError: The quantity is not ``gnss_sat_info``.
        """
        if not self._row.entry:
            self._refuse("offsets", "gnss_sat_info has")
        counts = self.values[self._row.fields[1].name]
        return read_only(np.concatenate(([0], np.cumsum(counts, dtype=np.int64))))

    def _refuse(self, attribute: str, others: str) -> NoReturn:
        raise AttributeError(f"{self.name} has no {attribute}; {others}")

    @cached_property
    def _rates(self) -> Rates:
        rates = Rates()
        part = self._part
        rates.add(Runs().add(part), self.sample - part.first, part.time)
        return rates

    @property
    def rate(self) -> float:
        """Measured rows per second of a device; NaN for fewer than two time stamps.

        Only time inside `Log.runs` counts. In a log of several devices it is their mean.
        """
        return self._rates.mean

    @property
    def nominal_rate(self) -> float:
        """Rows per second of a device where no sample is missing, in Hz; NaN if not known.

        The rate that the device is set to, whatever was lost. It comes from the usual interval between two
        rows without a gap between them. Without a packet counter it comes from the shortest intervals.
        """
        return self._rates.nominal(len(self._part), has_counter=self._part.has_counter)

    # Tables

    def __arrow_c_stream__(self, requested_schema: object = None) -> object:
        """Returns the table of `to_arrow`, for libraries that speak the Arrow C interface."""
        return self.arrow_stream().__arrow_c_stream__(requested_schema)

    def arrow_stream(self, *, raw: bool = False) -> _core.ArrowStream:
        """Returns the table of `to_arrow` as a stream for libraries that speak the Arrow C interface."""
        return _core.ArrowStream.rows(self._core, self._host_times.known, raw)

    def to_arrow(self, *, raw: bool = False) -> pa.Table:
        """Returns a pyarrow table: one row per packet, with ``sample``, ``time`` and the values.

        The same as `Log.to_arrow` with the key of the column. ``gnss_sat_info`` has one row per satellite.

        Args:
            raw: Fields of structs as integers, as on the wire, instead of in their units.

        Raises:
            ImportError: The extra ``arrow`` is not installed.
        """
        table: pa.Table = tables.arrow(self.arrow_stream(raw=raw))
        return table

    def to_pandas(self, *, raw: bool = False) -> pd.DataFrame:
        """Returns the table of `to_arrow` as a pandas DataFrame.

        Args:
            raw: Fields of structs as integers, as on the wire, instead of in their units.

        Raises:
            ImportError: The extra ``pandas`` is not installed.
        """
        frame: pd.DataFrame = tables.pandas(self.arrow_stream(raw=raw))
        return frame

    def to_polars(self, *, raw: bool = False) -> pl.DataFrame:
        """Returns the table of `to_arrow` as a polars DataFrame.

        Args:
            raw: Fields of structs as integers, as on the wire, instead of in their units.

        Raises:
            ImportError: The extra ``polars`` is not installed.
        """
        frame: pl.DataFrame = tables.polars(self.arrow_stream(raw=raw))
        return frame

    # Plots

    def plot(
        self, *, time: PlotTime = "device", backend: Backend = "matplotlib", ax: Any = None
    ) -> Any:
        """Draws the quantity over time; see `Log.plot`.

        Args:
            time: As for `Log.plot`.
            backend: As for `Log.plot`.
            ax: The Axes of matplotlib to draw into, or one for each plot. Default: a new figure.

        Returns:
            The Axes of matplotlib, or an array of them if the quantity has several plots, such as
            ``lat_lon``; a Figure of plotly.

        Raises:
            ImportError: The extra ``plot``, or ``report`` for plotly, is not installed.
            ValueError: The quantity has no plot or no rows, or the log has no valid UTC.
        """
        from xbus.log.plotting import plot_columns  # most programs plot nothing

        return plot_columns([self], self._part, time=time, backend=backend, ax=ax)

    # Comparison, pickle and print

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Column):
            return NotImplemented
        return (
            (self.name, self.coordinates, self.precision, self.data_id)
            == (other.name, other.coordinates, other.precision, other.data_id)
            and identical(self._core.values, other._core.values)
            and identical(self._core.entries, other._core.entries)
            and identical(self.sample, other.sample)
            and identical(self.time, other.time)
            and identical(self.host_time, other.host_time)
        )

    __hash__ = None  # type: ignore[assignment]

    def __reduce__(self) -> tuple[Any, ...]:
        # Without the other columns of the part.
        return _unpickled, (self._host_times.for_column(self._part.only(self._core)),)

    def __repr__(self) -> str:
        dtype = "struct" if self.dtype.names else self.dtype
        form = f", {self._format}" if self._format else ""
        return f"<Column {self.name}: {self.shape} {dtype}{form}>"

    def _repr_html_(self) -> str:
        fields = self._row.fields
        is_struct = bool(fields)
        values = self.values[:SHOWN]
        values = _scaled(values, fields) if fields else values
        numbers = values.tolist() if is_struct else values.reshape(len(values), -1).tolist()
        # NaN in a field of a struct stands for "not provided", elsewhere it is what was sent.
        nan = "" if is_struct else "NaN"
        times = ["" if math.isnan(time) else f"{time:.4f}" for time in self.time[:SHOWN].tolist()]
        rows = [
            (time, *(nan if number != number else str(number) for number in row))
            for time, row in zip(times, numbers, strict=True)
        ]
        names = self.fields or (self.name,)
        units = self.units
        head = (f"{name}, {units[name]}" if units.get(name) else name for name in names)
        return html_table(repr(self), ("time", *head), rows, more=max(0, len(self) - SHOWN))

    @property
    def _format(self) -> str:
        return ", ".join(filter(None, [self.precision, self.coordinates, self.unit]))


def _unpickled(host_times: HostTimes) -> Column:
    return Column(host_times.part.columns[0], host_times)


def _dtype(fields: tuple[Field, ...]) -> np.dtype[Any]:
    return np.dtype([(field.name, field.type) for field in fields])


def _scaled(values: npt.NDArray[Any], fields: tuple[Field, ...]) -> npt.NDArray[Any]:
    columns = {field.name: field.scaled(values[field.name]) for field in fields}
    table = np.empty(len(values), [(name, column.dtype) for name, column in columns.items()])
    for name, column in columns.items():
        table[name] = column
    return read_only(table)
