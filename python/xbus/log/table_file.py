"""Writes tables to Parquet, CSV and Arrow files, on all processors."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from typing import TYPE_CHECKING, BinaryIO, Literal, TypeAlias

from xbus import _core
from xbus.export.replacing import replacing
from xbus.log.in_order import in_order

if TYPE_CHECKING:
    from concurrent.futures import Executor

    import numpy as np
    import numpy.typing as npt

__all__ = ["FileFormat", "chunks", "write", "write_batches", "write_table"]

FileFormat: TypeAlias = Literal["parquet", "csv", "arrow"]

#: Bytes to write at a time. For a longer write Linux takes larger pages, which it rarely has at hand: in a
#: virtual machine, 1 GB in writes of 4 MiB took 2.3 s instead of 0.35 s.
PIECE = 1 << 18


def write_table(
    table: _core.ArrowStream,
    path: str | os.PathLike[str],
    file_format: FileFormat,
    *,
    threads: int | None = None,
    written: Callable[[int], None] | None = None,
) -> None:
    """Writes a table to a file, which appears whole or not at all.

    Args:
        table: The table.
        path: Path of the file.
        file_format: ``"parquet"``, ``"csv"`` or ``"arrow"``.
        threads: Number of threads that encode; None for one per processor. It does not change the file.
        written: Called with the number of rows after each chunk.

    Raises:
        OSError: The file cannot be written.
    """
    from concurrent.futures import ThreadPoolExecutor  # imported late: `import xbus` must be quick

    threads = threads or os.cpu_count() or 1
    file = _core.TableFile(file_format, table)
    with replacing(path) as out, ThreadPoolExecutor(threads) as pool:
        for rows in write_batches(file, table.batches(), out, pool, threads):
            if written is not None:
                written(rows)


def write_batches(
    file: _core.TableFile,
    batches: Iterable[_core.Batch],
    out: BinaryIO,
    pool: Executor,
    ahead: int,
) -> Iterator[int]:
    """Writes batches and yields the number of rows of each chunk after it is written.

    Args:
        file: Makes the file.
        batches: The rows, in order. They may have any sizes.
        out: Where the bytes go.
        pool: Encodes chunks.
        ahead: Number of chunks that are encoded while another one is written.
    """
    write(out, file.start())
    groups = chunks(batches, file.chunk_rows)
    for chunk in in_order(pool, file.encode, groups, ahead):
        write(out, file.append(chunk))
        yield len(chunk)
    write(out, file.finish())


def write(out: BinaryIO, data: npt.NDArray[np.uint8]) -> None:
    """Writes bytes to a file."""
    for start in range(0, len(data), PIECE):
        out.write(data[start : start + PIECE].data)


def chunks(batches: Iterable[_core.Batch], size: int) -> Iterator[list[_core.Batch]]:
    """Yields batches that have ``size`` rows together, the last ones fewer."""
    group: list[_core.Batch] = []
    missing = size
    for batch in batches:
        first = 0
        while first < len(batch):
            end = min(first + missing, len(batch))
            group.append(batch.rows(first, end))
            missing -= end - first
            first = end
            if not missing:
                yield group
                group, missing = [], size
    if group:
        yield group
