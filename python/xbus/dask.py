"""Logs as dask DataFrames: each worker reads its own ranges of the files.

>>> import xbus.dask
>>> frame = xbus.dask.read_logs("tests/captures/walk.mtb", block_bytes=20_000)
>>> frame.npartitions
9
"""

from __future__ import annotations

import errno
import glob
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from xbus.export import tables
from xbus.extras import require
from xbus.files import is_url, local_name
from xbus.log.legacy import Legacy, legacy_outputs
from xbus.log.part_tables import PartTables
from xbus.log.parts import PART, LogPart, joined_parts, split_log
from xbus.protocol.values import StringType
from xbus.remote import Url, matching_urls
from xbus.wire.strings import string_types

if TYPE_CHECKING:
    import dask.dataframe as dd
    import pandas as pd
    import pyarrow as pa

__all__ = ["read_logs"]

PURPOSE = "to read logs with dask"
#: The column with the name of the file.
FILE = "file"
#: Most parts that are joined to one partition, because the times at their ends are equal.
MOST_JOINED = 8

#: The name of a file, or the names of the pieces of a recording.
Name = str | os.PathLike[str]


def read_logs(
    sources: Name | Sequence[Name | Sequence[Name]],
    *,
    index: str | None = "time",
    block_bytes: int = PART,
    bid: int | None = None,
    rate: float | None = None,
    strings: Iterable[StringType | str] = (),
    legacy: Legacy | None = None,
    allow_restart: bool = False,
    raw: bool = False,
    storage_options: Mapping[str, Any] | None = None,
) -> dd.DataFrame:
    """Returns logs as a dask DataFrame, in partitions of a part of a file.

    The rows and columns are those of ``read_log(file).to_pandas()`` for one file after the other. A column
    ``file`` names the file. Columns that a file does not have are null in its rows.

    At once, each file is read in one task, without decoding its values, to find its columns and parts; the
    tasks run on the cluster if there is one. Each partition then requests only its bytes and decodes only the
    quantities of the columns that a computation needs. Workers must be able to read the files by these names.

    Args:
        sources: Names of files, URLs, or patterns. Each file is a recording. A list in the list holds the
            pieces of one recording.
        index: The column that becomes the index; None for a plain index and all columns. With ``"time"``,
            divisions are known if the times of all samples are known and ascend, from each file to the next
            one too; with ``"sample"`` if there is one file.
        block_bytes: Approximate size of a partition, in bytes of input. The DataFrame of all columns is about
            as large. Up to eight neighbours that share a time become one partition, with parts without
            samples between them. If more share a time, divisions are not known.
        bid: As in `read_log`.
        rate: As in `read_log`.
        strings: As in `read_log`.
        legacy: As in `read_log`.
        allow_restart: As in `read_log`.
        raw: Fields of structs as integers, as on the wire, instead of in their units.
        storage_options: Options of the file system of URLs, as for `fsspec.open`.

    Raises:
        ImportError: The extra ``dask`` is not installed, here or on a worker.
        FileNotFoundError: A file does not exist, or a pattern has no matches.
        OSError: A file cannot be read.
        ValueError: The same column has different coordinates or units in two files, or no column has the name
            ``index``. The other errors are those of `split_log`.
        LogChangedError: A file changed while it was read. This and OSError also occur in computations.

    >>> import xbus.dask
    >>> frame = xbus.dask.read_logs(["tests/captures/walk.mtb", "tests/captures/field.mtb"])
    >>> frame.groupby("file", observed=True)["acceleration_z"].count().compute().to_dict()
    {'tests/captures/walk.mtb': 1000, 'tests/captures/field.mtb': 978}
    """
    dask = require("dask", "dask", PURPOSE)
    frames = require("dask.dataframe", "dask", PURPOSE)
    recordings = _recordings(sources, storage_options or {})
    options = {
        "block_bytes": block_bytes,
        "bid": bid,
        "rate": rate,
        "strings": string_types(strings),
        "legacy": legacy_outputs(legacy),
        "allow_restart": allow_restart,
        "threads": 1,
    }
    split = dask.delayed(split_log, pure=False)
    found = dask.compute(*(split(recording, **options) for recording in recordings))
    names = [_name(recording) for recording in recordings]
    schema = _schema(zip(names, found, strict=True), raw=raw)
    reader = _Reader(schema.serialize().to_pybytes(), tuple(names), index, raw)
    partitions = [
        _Partition(file, part)
        for file, parts in enumerate(found)
        for part in _partitions(parts, index)
    ]
    # Parts without samples add no rows, and they have no place in divisions.
    partitions = [one for one in partitions if one.part.samples] or partitions[:1]
    # Its tables have no strings to convert: the tasks for that would only cost time.
    with dask.config.set({"dataframe.convert-string": False}):
        frame: dd.DataFrame = frames.from_map(
            reader.read,
            partitions,
            meta=reader.meta(),
            divisions=_divisions([one.part for one in partitions], index, len(names)),
            label="read-logs",
        )
    return frame


# Names


def _recordings(
    sources: Name | Sequence[Name | Sequence[Name]], options: Mapping[str, Any]
) -> list[str | list[str]]:
    """Returns the name of each file, or the names of the pieces of each recording, each once.

    Raises:
        TypeError: A source has no name.
        ValueError: There are no sources.
    """
    recordings: list[str | list[str]] = []
    for source in sources if isinstance(sources, list | tuple) else [sources]:
        if isinstance(source, str | os.PathLike):
            found: Iterable[str | list[str]] = _expand(source, options)
        elif isinstance(source, list | tuple):
            found = [[file for piece in source for file in _expand(piece, options)]]
        else:
            raise TypeError(
                f"dask reads files and URLs by their names, not {type(source).__name__}"
            )
        recordings += [one for one in found if one not in recordings]
    if not recordings:
        raise ValueError("read_logs needs at least one file")
    return recordings


def _expand(source: Name, options: Mapping[str, Any]) -> list[str]:
    name = os.fsdecode(os.fspath(source))
    path = local_name(name)
    if is_url(path):
        files = matching_urls(Url(name, options))
    elif glob.has_magic(path) and not os.path.lexists(path):
        files = sorted(glob.glob(path, recursive=True))  # noqa: PTH207 - pathlib is slow to import
    else:
        files = [path]
    if not files:
        raise FileNotFoundError(errno.ENOENT, "no file matches", name)
    return files


def _name(recording: str | list[str]) -> str:
    """Returns what the column ``file`` has for a recording."""
    return str(recording if isinstance(recording, str) else recording[0])


# Partitions


@dataclass(frozen=True)
class _Partition:
    """A part of a file, which is known by its number."""

    file: int
    part: LogPart


@dataclass(frozen=True)
class _Reader:
    """Reads partitions.

    Attributes:
        schema: The columns of the table, without the one with the file, as an Arrow message: a worker without
            pyarrow could not even load a schema, and would end without a word.
        files: The names of all files.
        index: The column that becomes the index, or None.
        raw: As in `read_logs`.
    """

    schema: bytes
    files: tuple[str, ...]
    index: str | None
    raw: bool

    def meta(self) -> pd.DataFrame:
        """Returns the DataFrame without rows."""
        schema = self._schema()
        if self.index is not None and self.index not in (names := schema.names):
            raise ValueError(
                f"no column has the name {self.index!r} of the index; choose from {names}"
            )
        return self._completed(tables.pandas_from_arrow(schema.empty_table()), schema, 0, None)

    def _schema(self) -> pa.Schema:
        arrow = require("pyarrow", "dask", PURPOSE)
        schema: pa.Schema = arrow.ipc.read_schema(arrow.py_buffer(self.schema))
        return schema

    def read(self, partition: _Partition, columns: list[str] | None = None) -> pd.DataFrame:
        """Returns a partition with these columns, or all of them."""
        arrow, schema = require("pyarrow", "dask", PURPOSE), self._schema()
        names = schema.names
        if columns is not None:  # one is always read, for the number of rows
            wanted = {*columns, self.index, "sample"}
            names = [name for name in names if name in wanted]
        part_tables = PartTables(
            [partition.part],
            lambda stream: arrow.RecordBatchReader.from_stream(stream).schema.names,
            raw=self.raw,
        )
        own = [name for name in names if name in part_tables.columns]
        stream = part_tables.read(partition.part, own)
        fields = arrow.schema([schema.field(name) for name in names])
        # A task is one thread of dask, which runs as many of them as there are processors.
        if arrow.RecordBatchReader.from_stream(stream).schema == fields:
            frame = tables.pandas(stream, use_threads=False)
        else:  # some columns are missing, have fewer bits or another order
            table = tables.arrow(stream)
            arrays = [
                table[field.name].cast(field.type)
                if field.name in own
                else arrow.nulls(len(table), field.type)
                for field in fields
            ]
            frame = tables.pandas_from_arrow(arrow.table(arrays, fields), use_threads=False)
        return self._completed(frame, fields, partition.file, columns)

    def _completed(
        self, frame: pd.DataFrame, fields: pa.Schema, file: int, columns: list[str] | None
    ) -> pd.DataFrame:
        """Returns a table with the column of the file and the index."""
        arrow, pandas = require("pyarrow", "dask", PURPOSE), require("pandas", "dask", PURPOSE)
        # As in a table of a whole log, where to_pandas does this if there are nulls.
        floats = {
            field.name: "float64"
            for field in fields
            if field.nullable
            and arrow.types.is_integer(field.type)
            and field.type != arrow.uint64()
        }
        if floats:
            frame = frame.astype(floats)
        if columns is None or FILE in columns:
            codes = np.full(len(frame), file, np.int32)
            names = pandas.Categorical.from_codes(codes, categories=list(self.files))
            # To insert it into a frame of more than a hundred columns would give a warning.
            column = pandas.Series(names, index=frame.index, name=FILE)
            frame = pandas.concat([frame, column], axis="columns")
        if self.index is not None:
            frame = frame.set_index(self.index)
        return frame if columns is None else frame[columns]


def _schema(logs: Iterable[tuple[str, list[LogPart]]], *, raw: bool) -> pa.Schema:
    """Returns the columns of all logs, with types that hold the values of each.

    Raises:
        ValueError: The same column has different coordinates or units.
    """
    arrow = require("pyarrow", "dask", PURPOSE)
    schemas: list[pa.Schema] = []
    seen: dict[str, tuple[str, dict[bytes, bytes]]] = {}
    for name, parts in logs:
        stream = parts[0].empty().arrow_stream(raw=raw)
        schema = arrow.RecordBatchReader.from_stream(stream).schema
        for field in schema:
            first, known = seen.setdefault(field.name, (name, field.metadata or {}))
            for entry in (b"coordinates", b"unit"):
                one, other = known.get(entry), (field.metadata or {}).get(entry)
                if one != other:
                    raise ValueError(
                        f"{field.name} is in {_text(one)} in {first} but in {_text(other)} in {name}; read "
                        "these files separately"
                    )
        schemas.append(schema)
    unified = arrow.unify_schemas(schemas, promote_options="permissive")
    everywhere = set.intersection(*(set(schema.names) for schema in schemas))
    return arrow.schema(
        [field.with_nullable(field.nullable or field.name not in everywhere) for field in unified]
    )


def _text(entry: bytes | None) -> str:
    return "none" if entry is None else entry.decode()


def _partitions(parts: list[LogPart], index: str | None) -> list[LogPart]:
    """Returns the parts of a file. If all times ascend, neighbours that share one are joined.

    A time in two partitions cannot be a division. Parts without samples between them are joined too, others
    are left out. At most `MOST_JOINED` parts become one.
    """
    if index != "time" or not all(part.is_ascending for part in parts):
        return parts
    groups: list[range] = []
    for number, part in enumerate(parts):
        if not part.samples:  # such parts may lie between two that share a time
            continue
        last = groups[-1] if groups else range(0)
        if last and part.earliest == parts[last[-1]].latest and number - last[0] < MOST_JOINED:
            groups[-1] = range(last[0], number + 1)
        else:
            groups.append(range(number, number + 1))
    return [joined_parts(parts[group.start : group.stop]) for group in groups] or parts[:1]


def _divisions(parts: Sequence[LogPart], index: str | None, files: int) -> tuple[float, ...] | None:
    """Returns the first index of each partition, and the last one of the last; None if they are not known."""
    if index == "sample" and files == 1 and parts[-1].samples:
        last = parts[-1].first_sample + parts[-1].samples - 1
        return (*(part.first_sample for part in parts), last)
    if index != "time" or not all(part.is_ascending and part.samples for part in parts):
        return None
    if any(one.latest >= other.earliest for one, other in pairwise(parts)):
        return None
    return (*(part.earliest for part in parts), parts[-1].latest)
