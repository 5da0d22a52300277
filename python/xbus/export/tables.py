"""Tables as those of other libraries, and arrays as npz files."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
import numpy.typing as npt

from xbus import _core
from xbus.export.replacing import replacing
from xbus.extras import require

if TYPE_CHECKING:
    import pyarrow as pa

__all__ = ["arrow", "npz", "pandas", "pandas_from_arrow", "polars", "stream_of"]

#: What dates and times of numpy are in a table.
KINDS = {"M8[ns]": "datetime", "M8[D]": "date", "m8[us]": "time"}
#: Most arrays of a DataFrame. pandas warns when a column is added to more than 100, and users add some.
MOST_ARRAYS = 50
#: Bytes of memory that arrays share: a piece of this size has huge pages, which numpy requests, and malloc
#: uses it again. A column that is kept keeps its piece in memory.
PIECE = 16 << 20
#: Each array begins at a multiple of this in shared memory.
ALIGNMENT = 64


class Stream(Protocol):
    """A table with the Arrow C stream interface."""

    def __arrow_c_stream__(self, requested_schema: Any = None) -> object:
        """Returns the stream, in a capsule."""
        ...


def arrow(stream: Stream) -> Any:
    """Returns a pyarrow table."""
    pa = require("pyarrow", "arrow", "to make Arrow tables")
    return pa.RecordBatchReader.from_stream(stream).read_all()


def pandas(stream: _core.ArrowStream, *, use_threads: bool = True) -> Any:
    """Returns the table of a log as a pandas DataFrame.

    Args:
        stream: The table.
        use_threads: Whether several threads of pyarrow convert its columns.
    """
    pd = require("pandas", "pandas", "to make pandas DataFrames")
    pa = require("pyarrow", "arrow", "to make pandas DataFrames")
    schema = pa.RecordBatchReader.from_stream(stream).schema
    if len(schema) > MOST_ARRAYS:
        return pandas_from_arrow(arrow(stream), use_threads=use_threads)
    # The core writes these straight into arrays. pyarrow converts the others: dates, and integers whose type
    # may change with nulls.
    numbers = [
        field
        for field in schema
        if pa.types.is_floating(field.type)
        or (pa.types.is_integer(field.type) and not field.nullable and field.type != pa.uint64())
    ]
    columns: dict[str, Any] = {}
    for field, array in zip(numbers, _memory(numbers, stream.row_count), strict=True):
        if field.nullable:
            array.fill(np.nan)
        columns[field.name] = array
    if stream.row_count:
        stream.select(list(columns)).write(list(columns.values()))
    if others := [name for name in schema.names if name not in columns]:
        columns |= pandas_from_arrow(arrow(stream.select(others)), use_threads=False).items()
    return pd.DataFrame({name: columns[name] for name in schema.names}, copy=False)


def _memory(fields: Sequence[Any], rows: int) -> Iterable[npt.NDArray[Any]]:
    """Yields an array for each column. Several share a piece of memory."""
    dtypes = [np.dtype(field.type.to_pandas_dtype()) for field in fields]
    sizes = [-(-rows * dtype.itemsize // ALIGNMENT) * ALIGNMENT for dtype in dtypes]
    piece = np.empty(0, np.uint8)
    for number, (dtype, size) in enumerate(zip(dtypes, sizes, strict=True)):
        if size > len(piece):
            piece = np.empty(max(size, min(PIECE, sum(sizes[number:]))), np.uint8)
        yield piece[: rows * dtype.itemsize].view(dtype)
        piece = piece[size:]


def pandas_from_arrow(table: pa.Table, *, use_threads: bool = True) -> Any:
    """Returns a table of pyarrow as a pandas DataFrame.

    Args:
        table: The table.
        use_threads: As in `pandas`.
    """
    pd = require("pandas", "pandas", "to make pandas DataFrames")
    pa = require("pyarrow", "arrow", "to make pandas DataFrames")
    # pandas converts integers with nulls to float64, which has only 53 bits.
    types = {pa.uint64(): pd.UInt64Dtype()}
    return table.to_pandas(types_mapper=types.get, use_threads=use_threads)


def polars(stream: Stream) -> Any:
    """Returns a polars DataFrame."""
    return require("polars", "polars", "to make polars DataFrames").DataFrame(stream)


def stream_of(
    columns: Iterable[tuple[str, npt.NDArray[Any], Mapping[str, str]]],
) -> _core.ArrowStream:
    """Returns a table of arrays.

    Args:
        columns: Name, values and metadata of each column. Null are NaN, NaT, empty texts and masked values.
            ``datetime64[ns]`` is UTC, and ``timedelta64[us]`` is a time of day.
    """
    return _core.ArrowStream.arrays([_column(*column) for column in columns])


def _column(name: str, values: npt.NDArray[Any], metadata: Mapping[str, str]) -> dict[str, Any]:
    mask = np.ma.getmaskarray(values) if np.ma.isMaskedArray(values) else None
    data: Any = np.ascontiguousarray(np.ma.getdata(values))
    kind = "number"
    match data.dtype.kind:
        case "f":
            mask = np.isnan(data)
        case "M" | "m":
            kind = KINDS[data.dtype.str[1:]]
            mask = np.isnat(data)
            data = data.astype(np.int64).astype(np.int32 if kind == "date" else np.int64)
        case "U":
            kind = "text"
            data = [text or None for text in data.tolist()]
    if mask is not None and not mask.any():
        mask = None
    return {"name": name, "kind": kind, "values": data, "mask": mask, "metadata": dict(metadata)}


def npz(
    arrays: Mapping[str, npt.NDArray[Any]],
    path: str | os.PathLike[str],
    written: Callable[[int], None] | None = None,
) -> None:
    """Writes an npz file, as `numpy.savez` does.

    Args:
        arrays: The arrays by name.
        path: Path of the file.
        written: Is called with the number of bytes of each array that is written.
    """
    from zipfile import ZipFile

    with replacing(path) as out, ZipFile(out, "w") as file:
        for name, array in arrays.items():
            with file.open(f"{name}.npy", "w", force_zip64=True) as member:
                np.lib.format.write_array(member, np.asanyarray(array), allow_pickle=False)
            if written is not None:
                written(array.nbytes)
