"""A log as named arrays, in blocks that do not depend on its parts: the content of HDF5 and MATLAB files."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from xbus.export.part import Part, PartColumn
from xbus.protocol.keys import EntryKey
from xbus.protocol.tables import UTC_SOURCES

__all__ = ["Array", "Block", "Blocks", "Group", "Path", "groups_of", "stem"]

#: Names of the groups in which an array is, and its own.
Path = tuple[str, ...]
#: The rows of arrays.
Block = dict[Path, npt.NDArray[np.generic]]
#: Samples of a block.
BLOCK = 1 << 16


@dataclass(frozen=True)
class Array:
    """An array, one row of which is added after the other.

    Attributes:
        path: Where it is.
        dtype: Type of the numbers.
        shape: Shape of a row.
        unit: Unit of the numbers; empty for counts and bits.
    """

    path: Path
    dtype: np.dtype[np.generic]
    shape: tuple[int, ...] = ()
    unit: str = ""


@dataclass(frozen=True)
class Group:
    """A quantity, or what is known about each sample.

    Attributes:
        name: Name of the group.
        arrays: Its arrays.
        texts: What describes it: coordinates, precision, data identifier.
    """

    name: str
    arrays: tuple[Array, ...]
    texts: dict[str, str]


def groups_of(shape: Part) -> list[Group]:
    """Returns the groups of a log: its samples, and each quantity.

    Args:
        shape: The log, or one without samples that has its columns.
    """
    return [_samples(shape), *(_quantity(shape, key) for key in shape)]


def _samples(shape: Part) -> Group:
    names = {"time": ("f8", "s"), "packet_counter": ("i8", ""), "bid": ("u1", "")}
    if shape.has_host_time:
        names["host_time"] = "f8", "s since 1970"
    if any(name in shape for name in UTC_SOURCES):
        names["utc"] = "f8", "s since 1970"
    arrays = (
        Array(("samples", name), np.dtype(code), unit=unit) for name, (code, unit) in names.items()
    )
    return Group("samples", tuple(arrays), {})


def stem(key: EntryKey) -> str:
    """Returns the name of a quantity, with its coordinates if the log has several."""
    return key if isinstance(key, str) else f"{key[0]}_{key[1].lower()}"


def _quantity(shape: Part, key: EntryKey) -> Group:
    column, name = shape[key], stem(key)
    values = column.scaled
    if values.dtype.names:
        arrays = [
            Array((name, "values", field), values.dtype[field], (), column.units.get(field, ""))
            for field in values.dtype.names
        ]
    else:
        arrays = [Array((name, "values"), values.dtype, values.shape[1:], column.unit)]
    arrays += _rows(name)
    if column.name == "gnss_sat_info":
        of_one = column.satellites.dtype
        arrays += [
            Array((name, "satellites", field), of_one[field]) for field in of_one.names or ()
        ]
        arrays += [Array((name, "satellites", "sample"), np.dtype("i8"))]
    texts = {
        "fields": ", ".join(column.fields),
        "coordinates": column.coordinates or "",
        "precision": column.precision or "",
        "data_id": f"0x{column.data_id:04X}",
    }
    return Group(name, tuple(arrays), texts)


def _rows(name: str) -> list[Array]:
    return [Array((name, "time"), np.dtype("f8"), (), "s"), Array((name, "sample"), np.dtype("i8"))]


class Blocks:
    """Divides a log into blocks, which end at the same samples however the log is divided into parts.

    Args:
        groups: The groups of the log.
    """

    def __init__(self, groups: list[Group]) -> None:
        self._groups = groups
        self._pending: list[tuple[npt.NDArray[np.int64], Block]] = []
        self._end = BLOCK

    def add(self, part: Part) -> Iterator[Block]:
        """Adds the next part, and yields the blocks that are complete."""
        self._pending += _arrays_of(part)
        while part.first_sample + len(part) >= self._end:
            yield self._take()
            self._end += BLOCK

    def rest(self) -> Block:
        """Returns the last block."""
        self._end = np.iinfo(np.int64).max
        return self._take()

    def _take(self) -> Block:
        """Returns the rows of the samples before the end of the block."""
        taken: dict[Path, list[npt.NDArray[np.generic]]] = {}
        left = []
        for samples, block in self._pending:
            at = int(np.searchsorted(samples, self._end))
            for path, values in block.items():
                taken.setdefault(path, []).append(values[:at])
            if at < len(samples):
                left.append((samples[at:], {path: values[at:] for path, values in block.items()}))
        self._pending = left
        return {
            array.path: np.concatenate(taken[array.path])
            for group in self._groups
            for array in group.arrays
            if array.path in taken
        }


def _arrays_of(part: Part) -> Iterator[tuple[npt.NDArray[np.int64], Block]]:
    """Yields arrays of a part, with the sample of each row."""
    samples: Block = {
        ("samples", "time"): part.time,
        ("samples", "packet_counter"): part.packet_counter,
        ("samples", "bid"): part.bid,
    }
    if part.has_host_time:
        samples["samples", "host_time"] = part.host_time
    if any(name in part for name in UTC_SOURCES):
        utc = part.utc
        seconds = utc.astype(np.int64) / 1e9
        samples["samples", "utc"] = np.where(np.isnat(utc), np.nan, seconds)
    yield part.first_sample + np.arange(len(part)), samples
    for key in part:
        column, name = part[key], stem(key)
        values = column.scaled
        rows: Block = {(name, "time"): column.time, (name, "sample"): column.sample}
        for field in values.dtype.names or ():
            rows[name, "values", field] = values[field]
        if not values.dtype.names:
            rows[name, "values"] = values
        yield column.sample, rows
        if column.name == "gnss_sat_info":
            yield _satellites(column, name)


def _satellites(column: PartColumn, name: str) -> tuple[npt.NDArray[np.int64], Block]:
    found = column.satellites
    samples = np.repeat(column.sample, np.diff(column.offsets))
    block: Block = {(name, "satellites", "sample"): samples}
    for field in found.dtype.names or ():
        block[name, "satellites", field] = found[field]
    return samples, block
