"""A log as a LazyFrame of polars: a query decodes only what it needs."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations
from typing import TYPE_CHECKING, Any, Final, Literal

from xbus.extras import require
from xbus.log.legacy import Legacy
from xbus.log.part_tables import SCAN_BLOCK, PartTables, read_ahead
from xbus.log.parts import LogPart, split_log
from xbus.log.read import thread_count
from xbus.log.source import Source
from xbus.protocol.values import StringType

if TYPE_CHECKING:
    import polars as pl

__all__ = ["scan_log"]

#: The columns of which each part knows the range of values.
RANGES = ("sample", "time")
#: The forms of `is_between`.
CLOSED: Final[tuple[Literal["both", "left", "right", "none"], ...]] = (
    "both",
    "left",
    "right",
    "none",
)


def scan_log(
    source: Source | Sequence[Source],
    *,
    block_bytes: int = SCAN_BLOCK,
    bid: int | None = None,
    rate: float | None = None,
    strings: Iterable[StringType | str] = (),
    legacy: Legacy | None = None,
    allow_restart: bool = False,
    raw: bool = False,
    threads: int | None = None,
    storage_options: Mapping[str, Any] | None = None,
) -> pl.LazyFrame:
    """Returns a log as a LazyFrame of polars, with the columns of ``read_log(...).to_polars()``.

    The log is read twice: at once, without decoding its values, to find the columns; and part by part when a
    query is collected, also with the streaming engine. A query decodes only the quantities that it needs,
    stops after the rows that it needs, and does not read parts that a condition on ``sample`` or ``time``
    excludes.

    Args:
        source: As in `split_log`: no file object and no pipe, because the log is read twice.
        block_bytes: Approximate size of a part, in bytes of input.
        bid: As in `read_log`.
        rate: As in `read_log`.
        strings: As in `read_log`.
        legacy: As in `read_log`.
        allow_restart: As in `read_log`.
        raw: Fields of structs as integers, as on the wire, instead of in their units.
        threads: Number of threads that decode; None for one per processor.
        storage_options: As in `split_log`.

    Raises:
        ImportError: The extra ``polars`` is not installed.
        LogChangedError: A file changed while it was read; this and OSError also while a query is collected.
            The other errors are those of `split_log`.

    >>> import polars as pl, xbus
    >>> log = xbus.scan_log("tests/captures/walk.mtb")
    >>> log.filter(pl.col("acceleration_z") > 12).select(pl.len()).collect().item()
    160
    """
    polars = require("polars", "polars", "to scan a log")
    plugins = require("polars.io.plugins", "polars", "to scan a log")
    count = thread_count(threads)
    parts = split_log(
        source,
        block_bytes=block_bytes,
        bid=bid,
        rate=rate,
        strings=strings,
        legacy=legacy,
        allow_restart=allow_restart,
        threads=threads,
        storage_options=storage_options,
    )
    tables = PartTables(parts, lambda stream: polars.DataFrame(stream).columns, raw=raw)
    frames = _Frames(polars, tables, parts, count)
    schema = polars.DataFrame(tables.schema).schema
    lazy: pl.LazyFrame = plugins.register_io_source(frames.read, schema=schema)
    return lazy


class _Frames:
    """The source of a LazyFrame."""

    def __init__(
        self, polars: Any, tables: PartTables, parts: Sequence[LogPart], threads: int
    ) -> None:
        self._polars, self._tables, self._parts, self._threads = polars, tables, parts, threads

    def read(
        self,
        columns: list[str] | None,
        predicate: pl.Expr | None,
        rows: int | None,
        batch_size: int | None,  # noqa: ARG002 - a hint
    ) -> Iterator[pl.DataFrame]:
        """Yields the rows for which ``predicate`` is true, of the first ``rows`` rows."""

        def read(part: LogPart) -> pl.DataFrame:
            # For a row index no column is needed, but polars takes no table without one.
            stream = self._tables.read(part, ["sample"] if columns == [] else columns)
            frame: pl.DataFrame = self._polars.DataFrame(stream)
            if columns is not None:
                frame = frame.select(columns) if columns else frame.drop("sample")
            if rows is not None:
                frame = frame.head(rows - (part.first_sample - self._parts[0].first_sample))
            return frame if predicate is None else frame.filter(predicate)

        ranges = [] if predicate is None else list(_ranges(self._polars, predicate))
        chosen = [
            part
            for part in self._parts
            if (rows is None or part.first_sample < rows)
            and all(one.allows(part) for one in ranges)
        ]
        try:
            yield from read_ahead(chosen, read, self._threads)
        except OSError as error:
            # polars keeps only the number and the text.
            if error.filename is None:
                raise
            raise OSError(error.errno, f"{error.strerror}: {error.filename!r}") from error


@dataclass(frozen=True)
class _Range:
    """A condition on a column: its values must lie between two numbers, which may be included."""

    column: str
    low: float
    high: float

    def allows(self, part: LogPart) -> bool:
        """Returns whether the part can have such values."""
        if self.column == "time":
            return part.latest >= self.low and part.earliest <= self.high
        return part.first_sample + part.samples > self.low and part.first_sample <= self.high


def _ranges(polars: Any, predicate: pl.Expr) -> Iterator[_Range]:
    """Yields the conditions on ``sample`` and ``time`` that must hold where a predicate does.

    An expression can be taken apart only into its inputs. Which operation joins them is found by joining them
    again. What this does not recognise gives no condition.
    """
    inputs = predicate.meta.pop()
    for one, other in permutations(inputs) if len(inputs) == 2 else ():
        if (one & other).meta.eq(predicate):
            yield from _ranges(polars, one)
            yield from _ranges(polars, other)
            return
    columns = [one for one in inputs if one.meta.is_column() and one.meta.output_name() in RANGES]
    numbers = [one for one in inputs if one.meta.is_literal()]
    if len(columns) == 1 and len(columns) + len(numbers) == len(inputs):
        yield from _comparison(polars, predicate, columns[0], numbers)


def _comparison(
    polars: Any, predicate: pl.Expr, column: pl.Expr, literals: list[pl.Expr]
) -> Iterator[_Range]:
    """Yields the condition if a predicate compares a column with numbers."""
    name = column.meta.output_name()
    values = [polars.select(literal).item() for literal in literals]
    if not all(type(value) in (int, float) and not math.isnan(value) for value in values):
        return
    if len(values) == 1:
        (literal,), (value,) = literals, values
        above = (column > literal, column >= literal, literal < column, literal <= column)
        below = (column < literal, column <= literal, literal > column, literal >= column)
        for low, high, forms in (
            (value, math.inf, above),
            (-math.inf, value, below),
            (value, value, (column == literal, literal == column)),
        ):
            if any(form.meta.eq(predicate) for form in forms):
                yield _Range(name, low, high)
    elif len(values) == 2:
        for (one, low), (other, high) in permutations(zip(literals, values, strict=True)):
            between = (column.is_between(one, other, closed) for closed in CLOSED)
            if any(form.meta.eq(predicate) for form in between):
                yield _Range(name, low, high)
                return
