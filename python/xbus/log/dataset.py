"""A log as a partitioned dataset: a folder of files that other software reads as one table."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext
from itertools import groupby, pairwise
from operator import itemgetter
from typing import BinaryIO

import numpy as np
import numpy.typing as npt

from xbus import _core
from xbus.export.format import ExportError
from xbus.export.replacing import replacing_folder
from xbus.log.hours import HOUR_SOURCES, Hours, find_hours
from xbus.log.in_order import in_order
from xbus.log.log import Log
from xbus.log.part_tables import read_ahead
from xbus.log.parts import Part
from xbus.log.table_file import FileFormat, chunks, write
from xbus.protocol.keys import EntryKey, Key
from xbus.protocol.tables import UTC_SOURCES

__all__ = ["DatasetError", "write_dataset"]

#: The most files: their names have four digits, and UTC that jumps with each sample must not fill a disk.
MOST_FILES = 10_000


class DatasetError(ExportError):
    """A log cannot be written as a dataset."""


def write_dataset(
    parts: Sequence[Part],
    path: str | os.PathLike[str],
    file_format: FileFormat,
    *,
    suffix: str,
    size: int,
    by_hour: bool = False,
    quantities: Sequence[Key] | None = None,
    key: EntryKey | None = None,
    raw: bool = False,
    threads: int = 1,
    reading: Callable[[], AbstractContextManager[None]] = nullcontext,
    read: Callable[[Part, Log], None] | None = None,
) -> dict[str, int]:
    """Writes the table of a log to the files of a folder, which appears whole or not at all.

    Args:
        parts: All parts of the log, from `split_log`.
        path: Path of the folder.
        file_format: As in `write_parts`.
        suffix: Suffix of the files.
        size: A file ends with the first chunk at which it has this many bytes.
        by_hour: Write a folder for each hour, as in `Hours`.
        quantities: As in `write_parts`.
        key: The same.
        raw: The same.
        threads: The same.
        reading: The same.
        read: The same.

    Returns:
        The number of rows, columns and files.

    Raises:
        DatasetError: Hours are not known, or there are more than `MOST_FILES` files.
        ForeignFilesError: The folder exists and has other files than those of a dataset.
        OSError: A file cannot be written, or the log cannot be read.
        LogChangedError: The log has changed since it was split.
    """
    from concurrent.futures import ThreadPoolExecutor  # imported late: `import xbus` must be quick

    shape = parts[0].empty(quantities=quantities)
    keys = key if key is not None else list(shape)
    empty = shape.arrow_stream(keys, raw=raw)
    encoder = _core.TableFile(file_format, empty)
    hours, needed = None, quantities
    if by_hour:
        hours = _hours(parts, threads, reading)
        needed = None if quantities is None else [*quantities, *HOUR_SOURCES]

    def decode(part: Part) -> tuple[Part, Log, list[_core.Batch]]:
        with reading():
            log = part.read(quantities=needed)
        return part, log, list(log.arrow_stream(keys, raw=raw).batches())

    ahead = (threads + 1) // 2
    with (
        replacing_folder(path) as folder,
        _Files(folder, file_format, empty, suffix, size) as files,
        ThreadPoolExecutor(threads, thread_name_prefix="xbus") as pool,
    ):

        def batches() -> Iterator[tuple[str, _core.Batch]]:
            for part, log, found in in_order(pool, decode, parts, ahead):
                if read is not None:
                    read(part, log)
                if hours is None:
                    yield from (("", batch) for batch in found)
                else:
                    yield from _by_hour(found, hours.of_samples(log)[_samples(log, key)], hours)

        def groups() -> Iterator[tuple[str, list[_core.Batch]]]:
            for place, found in groupby(batches(), itemgetter(0)):
                for chunk in chunks((batch for _, batch in found), encoder.chunk_rows):
                    yield place, chunk

        def encode(group: tuple[str, list[_core.Batch]]) -> tuple[str, _core.Chunk]:
            return group[0], encoder.encode(group[1])

        for place, chunk in in_order(pool, encode, groups(), ahead):
            files.append(place, chunk)
    return {"row": files.rows, "column": len(empty.columns), "part": files.count}


def _hours(
    parts: Sequence[Part], threads: int, reading: Callable[[], AbstractContextManager[None]]
) -> Hours:
    """Returns the hours of a log.

    Raises:
        DatasetError: They are not known.
    """
    shape = parts[0].empty()
    is_utc = any(name in shape for name in UTC_SOURCES)
    is_host = "host_time" in shape.arrow_stream([]).columns

    def read(part: Part) -> Log:
        with reading():
            return part.read(quantities=HOUR_SOURCES)

    hours = Hours("recording")
    if is_utc:
        hours = find_hours(read_ahead(parts, read, threads), "utc")
    if is_host and hours.clock == "recording":
        hours = find_hours(read_ahead(parts, read, threads), "host")
    if hours.clock == "recording" and all(np.isnan(part.earliest) for part in parts):
        raise DatasetError(
            "the samples have no time stamps, so hours are not known; add rate=, or omit by_hour="
        )
    return hours


def _samples(log: Log, key: EntryKey | None) -> npt.NDArray[np.int64]:
    """Returns the sample of each row of a table, counted from the start of the part."""
    if key is None:
        return np.arange(len(log))
    column = log[key]
    samples = column.sample - log.first_sample
    return np.repeat(samples, np.diff(column.offsets)) if key == "gnss_sat_info" else samples


def _by_hour(
    batches: Sequence[_core.Batch], row_hours: npt.NDArray[np.int64], hours: Hours
) -> Iterator[tuple[str, _core.Batch]]:
    """Yields the rows of each hour, with its folder."""
    start = 0
    for batch in batches:
        own = row_hours[start : start + len(batch)]
        start += len(batch)
        bounds = [0, *(np.flatnonzero(np.diff(own)) + 1).tolist(), len(own)]
        for first, end in pairwise(bounds):
            if end > first:
                yield hours.folder(int(own[first])), batch.rows(first, end)


class _Files:
    """The files of a dataset, one after the other.

    Args:
        folder: Path of the folder.
        file_format: The format of the files.
        empty: A table with their columns.
        suffix: Their suffix.
        size: A file with this many bytes is followed by another one.

    Attributes:
        rows: Number of rows written.
        count: Number of files.
    """

    def __init__(
        self,
        folder: str,
        file_format: FileFormat,
        empty: _core.ArrowStream,
        suffix: str,
        size: int,
    ) -> None:
        self._folder, self._suffix, self._size = folder, suffix, size
        self._format, self._empty = file_format, empty
        self._place: str | None = None
        self._numbers: dict[str, int] = {}
        self._file = _core.TableFile(file_format, empty)
        self._out: BinaryIO | None = None
        self.rows = self.count = 0

    def __enter__(self) -> _Files:
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        if kind is None:
            self._close()
        elif self._out is not None:
            self._out.close()

    def append(self, place: str, chunk: _core.Chunk) -> None:
        """Writes a chunk to the file of a folder, the present one or the next."""
        if self._out is None or place != self._place or self._out.tell() >= self._size:
            self._close()
            self._open(place)
        assert self._out is not None  # noqa: S101 - see `_open`
        write(self._out, self._file.append(chunk))
        self.rows += len(chunk)

    def _open(self, place: str) -> None:
        if self.count == MOST_FILES:
            other = ", or omit by_hour=" if place else ""
            raise DatasetError(
                f"it would be more than {MOST_FILES:,} files; choose a larger size={other}"
            )
        number = self._numbers.get(place, 0)
        self._numbers[place], self._place = number + 1, place
        self.count += 1
        folder = os.path.join(self._folder, place)  # noqa: PTH118 - pathlib is slow to import
        os.makedirs(folder, exist_ok=True)  # noqa: PTH103
        self._file = _core.TableFile(self._format, self._empty)
        self._out = open(os.path.join(folder, f"part-{number:04}{self._suffix}"), "xb")  # noqa: PTH118, PTH123, SIM115
        write(self._out, self._file.start())

    def _close(self) -> None:
        if self._out is not None:
            with self._out:
                write(self._out, self._file.finish())
            self._out = None
