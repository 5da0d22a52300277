"""A log as a stream of Arrow record batches."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from xbus.extras import require
from xbus.log.legacy import Legacy
from xbus.log.part_tables import SCAN_BLOCK, read_ahead
from xbus.log.parts import LogPart, split_log
from xbus.log.read import thread_count
from xbus.log.source import Source, quantity_filter
from xbus.protocol.keys import Key
from xbus.protocol.values import StringType

if TYPE_CHECKING:
    import pyarrow as pa

__all__ = ["log_batches"]


def log_batches(
    source: Source | Sequence[Source],
    *,
    quantities: Iterable[Key] | None = None,
    block_bytes: int = SCAN_BLOCK,
    bid: int | None = None,
    rate: float | None = None,
    strings: Iterable[StringType | str] = (),
    legacy: Legacy | None = None,
    allow_restart: bool = False,
    raw: bool = False,
    threads: int | None = None,
    storage_options: Mapping[str, Any] | None = None,
) -> pa.RecordBatchReader:
    """Reads a log as a stream of record batches, for DuckDB, datasets, and logs larger than memory.

    Together the batches are exactly ``read_log(...).to_arrow()``. The log is read twice: at once, without
    decoding its values, to find the columns; and part by part as the batches are taken. Only a few parts are
    in memory at a time.

    Args:
        source: As in `split_log`: no file object and no pipe, because the log is read twice.
        quantities: As in `read_log`. Only these are decoded.
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
        ImportError: The extra ``arrow`` is not installed.
        LogChangedError: A file changed while it was read; this and OSError also while batches are taken. The
            other errors are those of `split_log`.

    >>> import xbus
    >>> reader = xbus.log_batches("tests/captures/walk.mtb", quantities=["temperature"])
    >>> reader.schema.names
    ['sample', 'time', 'temperature']
    >>> sum(batch.num_rows for batch in reader)
    1040
    """
    pa = require("pyarrow", "arrow", "to make record batches")
    count = thread_count(threads)
    keep = None if quantities is None else _checked(quantities)
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

    def read(part: LogPart) -> list[Any]:
        log = part.read(quantities=keep)
        return list(pa.RecordBatchReader.from_stream(log.arrow_stream(raw=raw)))

    def batches() -> Iterator[Any]:
        for found in read_ahead(parts, read, count):
            yield from found

    empty = parts[0].empty(quantities=keep)
    schema = pa.RecordBatchReader.from_stream(empty.arrow_stream(raw=raw)).schema
    return pa.RecordBatchReader.from_batches(schema, batches())


def _checked(quantities: Iterable[Key]) -> list[Key]:
    """Returns quantities as a list, before a log is read for nothing if one does not exist."""
    keys = quantities if isinstance(quantities, str | int) else list(quantities)
    quantity_filter(keys)
    return list(keys)
