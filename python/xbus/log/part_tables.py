"""The tables of the parts of a log, as one: which quantities a column needs, and parts read ahead."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from typing import TypeVar

from xbus import _core
from xbus.log.in_order import in_order
from xbus.log.log import Log
from xbus.log.parts import LogPart, Part
from xbus.protocol.tables import UTC_SOURCES

__all__ = ["SCAN_BLOCK", "PartTables", "read_ahead"]

#: Default size of the parts of a log that is read as a stream of tables, in bytes of input: large enough that
#: their number costs little, small enough that a few of them and their tables fit into little memory.
SCAN_BLOCK = 16 << 20

P = TypeVar("P", bound=Part)
T = TypeVar("T")


class PartTables:
    """The wide tables of the parts of a log. For a choice of columns only the needed quantities are decoded.

    Args:
        parts: The parts.
        names_of: Returns the names of the columns of a table.
        raw: As in `Log.to_arrow`.

    Attributes:
        empty: A log without samples that has the columns of the parts.
    """

    def __init__(
        self,
        parts: Sequence[LogPart],
        names_of: Callable[[_core.ArrowStream], Iterable[str]],
        *,
        raw: bool,
    ) -> None:
        self._raw = raw
        self.empty = parts[0].empty()
        self._quantities = _quantities_of_columns(self.empty, names_of, raw=raw)

    @property
    def columns(self) -> Collection[str]:
        """The names of the columns."""
        return self._quantities.keys()

    @property
    def schema(self) -> _core.ArrowStream:
        """A table without rows, with the columns of all parts."""
        return self.empty.arrow_stream(raw=self._raw)

    def read(self, part: LogPart, columns: Sequence[str] | None) -> _core.ArrowStream:
        """Returns the table of a part with these columns, in the order of the table; all columns for None."""
        if columns is None:
            return part.read().arrow_stream(raw=self._raw)
        needed = {name: None for column in columns for name in self._quantities[column]}
        stream = part.read(quantities=list(needed)).arrow_stream(raw=self._raw)
        return stream.select(list(columns))


def _quantities_of_columns(
    log: Log, names_of: Callable[[_core.ArrowStream], Iterable[str]], *, raw: bool
) -> dict[str, tuple[str, ...]]:
    """Returns the names of the quantities that each column of a wide table needs."""
    systems: dict[str, list[str | tuple[str, str]]] = {}
    for key in log:
        systems.setdefault(key if isinstance(key, str) else key[0], []).append(key)
    stamps = names_of(log.arrow_stream([], raw=raw))
    needed: dict[str, tuple[str, ...]] = dict.fromkeys(stamps, ())
    for name, keys in systems.items():
        for column in names_of(log.arrow_stream(keys, raw=raw)):
            needed.setdefault(column, (name,))
    if "utc" in needed:
        needed["utc"] = tuple(name for name in UTC_SOURCES if name in systems)
    return needed


def read_ahead(parts: Iterable[P], read: Callable[[P], T], threads: int) -> Iterator[T]:
    """Yields what ``read`` returns for each part, in order, and has several threads work on the next ones."""
    if threads == 1:
        yield from map(read, parts)
        return
    from concurrent.futures import ThreadPoolExecutor  # imported late: `import xbus` must be quick

    pool = ThreadPoolExecutor(threads, thread_name_prefix="xbus")
    try:
        yield from in_order(pool, read, parts, threads)
    finally:
        # Without waiting: a consumer that stops may drop the generator in a thread of the pool.
        pool.shutdown(wait=False, cancel_futures=True)
