"""How logs and columns appear in a terminal and in a notebook."""

from __future__ import annotations

import html
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from xbus.log.column import Column
    from xbus.log.log import Log

__all__ = ["column_html", "column_text", "log_html", "log_text"]

#: Rows of a column that a notebook shows.
SHOWN = 6


def log_text(log: Log) -> str:
    """Returns one line about the log, and one for each quantity: name, rows, rate, format."""
    rows = _quantities(log)
    widths = [max(map(len, cells), default=0) for cells in zip(*rows, strict=True)]
    lines = [
        f"  {name:<{widths[0]}}  {count:>{widths[1]}}  {rate:>{widths[2]}}  {form}".rstrip()
        for name, count, rate, form in rows
    ]
    return "\n".join([f"<Log {_summary(log)}>", *lines])


def log_html(log: Log) -> str:
    """Returns the same as an HTML table."""
    table = _table(("quantity", "rows", "rate", ""), _quantities(log))
    return f"<p>Log: {html.escape(_summary(log))}</p>{table}"


def column_text(column: Column) -> str:
    """Returns one line: name, shape, type and format."""
    dtype = "struct" if column.dtype.names else column.dtype
    form = _format(column)
    return f"<Column {column.name}: {column.shape} {dtype}{form and ', '}{form}>"


def column_html(column: Column) -> str:
    """Returns the first rows as an HTML table."""
    values = column.values[:SHOWN]
    numbers = values.tolist() if column.dtype.names else values.reshape(len(values), -1).tolist()
    times = [f"{time:.4f}" for time in column.time[:SHOWN]]
    rows = [(time, *map(str, row)) for time, row in zip(times, numbers, strict=True)]
    table = _table(("time", *(column.fields or (column.name,))), rows)
    more = f"<p>{len(column) - SHOWN} more rows</p>" if len(column) > SHOWN else ""
    return f"<p>{html.escape(column_text(column))}</p>{table}{more}"


def _summary(log: Log) -> str:
    stats, places = log.stats, len(log.damage)
    parts = [_count(len(log), "sample")]
    if np.isfinite(log.duration):
        parts.append(f"{log.duration:.2f} s")
    parts.append(_count(len(log.keys()), "quantity", "quantities"))
    if stats.strings:
        parts.append(_count(stats.strings, "string"))
    if stats.lost_samples:
        parts.append(f"{_count(stats.lost_samples, 'sample')} lost in {_count(stats.gaps, 'gap')}")
    if stats.skipped_bytes:
        skipped = _count(stats.skipped_bytes, "byte")
        parts.append(f"{skipped} skipped in {_count(places, 'place')}")
    parts += filter(None, [log.product_code, log.times_fault])
    return ", ".join(parts)


def _quantities(log: Log) -> list[tuple[str, str, str, str]]:
    return [
        (
            key if isinstance(key, str) else " ".join(key),
            str(len(column)),
            f"{column.rate:.1f} Hz" if np.isfinite(column.rate) else "",
            _format(column),
        )
        for key, column in log.items()
    ]


def _format(column: Column) -> str:
    return ", ".join(filter(None, [column.precision, column.coordinates, column.unit]))


def _count(number: int, one: str, many: str | None = None) -> str:
    return f"{number} {one if number == 1 else many or one + 's'}"


def _table(head: Iterable[str], rows: Iterable[Sequence[str]]) -> str:
    top = "".join(f"<th>{html.escape(cell)}</th>" for cell in head)
    body = "".join(
        "<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>" for row in rows
    )
    return f"<table><tr>{top}</tr>{body}</table>"
