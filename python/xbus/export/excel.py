"""Excel workbooks: a sheet with one row for each sample."""

from __future__ import annotations

import math
import os
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

import numpy as np
import numpy.typing as npt

from xbus.export.columns import stem
from xbus.export.forgiving import replacing_forgivingly
from xbus.export.format import ExportError, Format, Writer
from xbus.export.part import Part
from xbus.extras import require
from xbus.protocol.keys import EntryKey
from xbus.protocol.tables import UTC_SOURCES

__all__ = ["Excel"]

#: Rows and columns of a sheet, and the rows of its head: names and units.
MOST_ROWS, MOST_COLUMNS, HEAD = 1_048_576, 16_384, 2
#: Rows that are converted at a time.
BLOCK = 1 << 12
#: Dates are days since 1899-12-30.
DAYS_BEFORE_1970 = 25_569
#: The same file for the same log: the date of its creation is that of the format.
CREATED = datetime(2007, 1, 30, tzinfo=UTC)


@dataclass(frozen=True)
class Excel(Format):
    """One row for each sample: time, UTC as a date, and all quantities, with units in the second row."""

    most_samples = MOST_ROWS - HEAD

    def quantities(self, shape: Part) -> Sequence[EntryKey] | None:
        """See `Format.quantities`."""
        require("xlsxwriter", "excel", "to write Excel workbooks")
        if (count := len(_columns(shape))) > MOST_COLUMNS:
            raise ExportError(f"an Excel sheet has {MOST_COLUMNS:,} columns, not {count:,}")
        return None

    @contextmanager
    def open(self, path: str | os.PathLike[str], shape: Part) -> Iterator[Writer]:
        """See `Format.open`."""
        xlsxwriter = require("xlsxwriter", "excel", "to write Excel workbooks")
        with (
            replacing_forgivingly(path) as out,
            tempfile.TemporaryDirectory(prefix="xbus-") as folder,
        ):
            book = xlsxwriter.Workbook(out, {"constant_memory": True, "tmpdir": folder})
            book.use_zip64()
            book.set_properties({"created": CREATED})
            sheet = book.add_worksheet("samples")
            with closing(sheet.row_data_fh):  # else it stays open after an error
                writer = _ExcelWriter(self, book, sheet, shape)
                yield writer
                book.close()


@dataclass(frozen=True)
class _Column:
    """A column of the sheet.

    Attributes:
        name: Its name.
        unit: The unit.
        key: The quantity, or None for what every sample has.
        field: Which component or field of the quantity.
    """

    name: str
    unit: str
    key: EntryKey | None = None
    field: Any = ()


def _columns(shape: Part) -> list[_Column]:
    columns = [_Column("sample", ""), _Column("time", "s"), _Column("bid", "")]
    if shape.has_host_time:
        columns.append(_Column("host_time", "UTC"))
    if any(name in shape for name in UTC_SOURCES):
        columns.append(_Column("utc", "UTC"))
    for key in shape:
        found, name = shape[key], stem(key)
        values = found.scaled
        if values.dtype.names:
            columns += [
                _Column(f"{name}_{field}", found.units.get(field, ""), key, field)
                for field in values.dtype.names
            ]
        elif values.ndim > 1:
            places = np.ndindex(*values.shape[1:])
            columns += [
                _Column(f"{name}_{field}", found.unit, key, (slice(None), *place))
                for field, place in zip(found.fields, places, strict=True)
            ]
        else:
            columns.append(_Column(name, found.unit, key))
    return columns


class _ExcelWriter:
    def __init__(self, file_format: Excel, book: Any, sheet: Any, shape: Part) -> None:
        self._format, self._rows = file_format, 0
        self._columns = _columns(shape)
        self._sheet = sheet
        self._sheet.freeze_panes(HEAD, 2)
        date = book.add_format({"num_format": "yyyy-mm-dd hh:mm:ss.000"})
        for number, column in enumerate(self._columns):
            if column.unit == "UTC":
                self._sheet.set_column(number, number, 24, date)
        self._dates = [date if column.unit == "UTC" else None for column in self._columns]
        self._sheet.write_row(0, 0, [column.name for column in self._columns])
        self._sheet.write_row(1, 0, [column.unit for column in self._columns])

    @property
    def counts(self) -> dict[str, int]:
        return {"row": self._rows, "column": len(self._columns)}

    def write(self, part: Part) -> None:
        self._format.check(self._rows + len(part))
        values = [_values(part, column) for column in self._columns]
        for first in range(0, len(part), BLOCK):
            columns = [_cells(one[first : first + BLOCK]) for one in values]
            for cells in zip(*columns, strict=True):
                self._write_row(cells)

    def _write_row(self, cells: Sequence[float | str | None]) -> None:
        row = HEAD + self._rows
        for at, cell in enumerate(cells):
            if isinstance(cell, str):
                self._sheet.write_string(row, at, cell)
            elif cell is not None:
                self._sheet.write_number(row, at, cell, self._dates[at])
        self._rows += 1


def _values(part: Part, column: _Column) -> npt.NDArray[Any]:
    """Returns the values of a column, masked where a row has no value."""
    if column.key is None:
        match column.name:
            case "sample":
                return part.first_sample + np.arange(len(part))
            case "time":
                return part.time
            case "bid":
                return part.bid
            case "host_time":
                return part.host_time / 86_400 + DAYS_BEFORE_1970
            case _:
                return np.where(
                    np.isnat(part.utc),
                    np.nan,
                    part.utc.astype(np.int64) / 86_400e9 + DAYS_BEFORE_1970,
                )
    found = part[column.key]
    rows = found.scaled[column.field]
    values = np.ma.array(np.zeros(len(part), rows.dtype), mask=True)
    values[found.sample - part.first_sample] = rows
    return np.ma.asarray(values)


def _cells(values: npt.NDArray[Any]) -> list[float | str | None]:
    """Returns the cells of a column: numbers, None, and a text for what is no number of Excel."""
    cells: list[Any] = values.tolist()
    if np.ma.getdata(values).dtype.kind != "f":
        return cells
    return [
        cell if cell is None or math.isfinite(cell) else None if math.isnan(cell) else str(cell)
        for cell in cells
    ]
