"""Writes a log to a file part by part, so that the log need not fit into memory."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext

from xbus import _core
from xbus.export.format import Format, export
from xbus.export.replacing import replacing
from xbus.log.in_order import in_order
from xbus.log.log import Log
from xbus.log.part_tables import read_ahead
from xbus.log.parts import Part
from xbus.log.table_file import FileFormat, write_batches
from xbus.protocol.keys import EntryKey, Key

__all__ = ["chunk_rows", "export_parts", "write_parts"]


def chunk_rows(log: Log, key: EntryKey | None, *, raw: bool) -> int:
    """Returns how many rows of a table a chunk of a Parquet file has; key and raw are as in `write_parts`."""
    return _core.TableFile("parquet", log.arrow_stream(key, raw=raw)).chunk_rows


def write_parts(
    parts: Sequence[Part],
    path: str | os.PathLike[str],
    file_format: FileFormat,
    *,
    quantities: Sequence[Key] | None = None,
    key: EntryKey | None = None,
    raw: bool = False,
    threads: int = 1,
    reading: Callable[[], AbstractContextManager[None]] = nullcontext,
    read: Callable[[Part, Log], None] | None = None,
) -> dict[str, int]:
    """Writes the table of a log to a file, which appears whole or not at all.

    The table is that of `Log.to_arrow` for the whole log. Parts are decoded and encoded on several threads
    and written in their order.

    Args:
        parts: All parts of the log, from `split_log`.
        path: Path of the file.
        file_format: ``"parquet"``, ``"csv"`` or ``"arrow"``.
        quantities: As in `read_log`.
        key: As in `Log.to_arrow`: a quantity whose table has a row per packet, or None.
        raw: As in `Log.to_arrow`.
        threads: Number of threads. A part and half a chunk for each are in memory at a time, and some more.
        reading: Returns a context in which a part is read. It may replace errors of the input by others.
        read: Called with each part and its log, in order.

    Returns:
        The number of rows and columns, as ``{"row": 1000, "column": 40}``.

    Raises:
        OSError: The file cannot be written, or the log cannot be read.
        LogChangedError: The log has changed since it was split.
    """
    from concurrent.futures import ThreadPoolExecutor  # imported late: `import xbus` must be quick

    empty = parts[0].empty(quantities=quantities).arrow_stream(key, raw=raw)
    file = _core.TableFile(file_format, empty)

    def decode(part: Part) -> tuple[Part, Log, list[_core.Batch]]:
        with reading():
            log = part.read(quantities=quantities)
        return part, log, list(log.arrow_stream(key, raw=raw).batches())

    with replacing(path) as out, ThreadPoolExecutor(threads, thread_name_prefix="xbus") as pool:

        def batches() -> Iterator[_core.Batch]:
            # While this thread waits for a chunk, the others decode the parts of the next one.
            for part, log, found in in_order(pool, decode, parts, threads + 2):
                if read is not None:
                    read(part, log)
                yield from found

        rows = sum(write_batches(file, batches(), out, pool, (threads + 1) // 2))
    return {"row": rows, "column": len(empty.columns)}


def _key_of(shape: Log, key: EntryKey) -> EntryKey:
    """Returns the key of a column alone: its name may stand for other coordinate systems in a part, too."""
    if key not in shape or (coordinates := shape[key].coordinates) is None:
        return key
    return shape[key].name, coordinates


def export_parts(
    parts: Sequence[Part],
    path: str | os.PathLike[str],
    file_format: Format,
    *,
    quantities: Sequence[Key] | None = None,
    threads: int = 1,
    reading: Callable[[], AbstractContextManager[None]] = nullcontext,
    read: Callable[[Part, Log], None] | None = None,
) -> dict[str, int]:
    """Writes a log in the format of other software, to a file that appears whole or not at all.

    Args:
        parts: All parts of the log, from `split_log`.
        path: Path of the file.
        file_format: The format and its options.
        quantities: As in `read_log`. Only those that the format needs are decoded, and `Format.always`.
        threads: Number of threads that decode. As many parts are in memory at a time.
        reading: As in `write_parts`.
        read: As in `write_parts`.

    Returns:
        What was written, as `Writer.counts`.

    Raises:
        ExportError: The log has nothing that the format can hold, or more than it can hold.
        OSError: The file cannot be written, or the log cannot be read.
        LogChangedError: The log has changed since it was split.
    """
    if quantities is not None:
        quantities = [*quantities, *file_format.always]
    shape = parts[0].empty(quantities=quantities)
    needed = file_format.quantities(shape)
    file_format.check(sum(part.samples for part in parts))

    def logs(keys: Sequence[EntryKey] | None) -> Iterator[tuple[Part, Log]]:
        names = quantities if keys is None else [_key_of(shape, key) for key in keys]

        def decode(part: Part) -> tuple[Part, Log]:
            with reading():
                return part, part.read(quantities=names)

        return read_ahead(parts, decode, threads)

    def surveyed() -> Iterator[Log]:
        if (survey := file_format.survey(shape)) is not None:
            yield from (log for _, log in logs(survey.quantities))

    def written() -> Iterator[Log]:
        for part, log in logs(needed):
            if read is not None:
                read(part, log)
            yield log

    return export(file_format, shape, written(), path, surveyed=surveyed())
