"""HDF5 files, and those of them that MATLAB reads."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from xbus.export.columns import Array, Block, Blocks, Group, Path, groups_of
from xbus.export.forgiving import ForgivingFile, replacing_forgivingly
from xbus.export.format import Format, Writer
from xbus.export.part import Part
from xbus.extras import require
from xbus.protocol.keys import EntryKey

__all__ = ["Hdf5", "Hdf5File"]

#: Rows of a chunk, which is compressed by itself.
CHUNK = 1 << 13
#: Bytes before the HDF5 data of a MATLAB file.
USER_BLOCK = 512
#: What MATLAB calls the types of numbers.
MATLAB_CLASSES = {
    "f8": "double", "f4": "single", "i8": "int64", "i4": "int32", "i2": "int16", "i1": "int8",
    "u8": "uint64", "u4": "uint32", "u2": "uint16", "u1": "uint8",
}  # fmt: skip


@dataclass(frozen=True)
class Hdf5(Format):
    """Every quantity as a group of datasets: values, time and sample, with units as attributes."""

    def quantities(self, shape: Part) -> Sequence[EntryKey] | None:  # noqa: ARG002 - all
        """See `Format.quantities`."""
        require("h5py", "hdf5", "to write HDF5 files")
        return None

    @contextmanager
    def open(self, path: str | os.PathLike[str], shape: Part) -> Iterator[Writer]:
        """See `Format.open`."""
        groups = groups_of(shape)
        with replacing_forgivingly(path) as out, Hdf5File(out, groups) as file:
            for group in groups:
                file.describe(group)
            writer = _Hdf5Writer(file, groups)
            yield writer
            writer.close()


class _Hdf5Writer:
    def __init__(self, file: Hdf5File, groups: list[Group]) -> None:
        self._file, self._blocks = file, Blocks(groups)
        self._samples, self._arrays = 0, sum(len(group.arrays) for group in groups)

    @property
    def counts(self) -> dict[str, int]:
        return {"sample": self._samples, "array": self._arrays}

    def write(self, part: Part) -> None:
        self._samples += len(part)
        for block in self._blocks.add(part):
            self._file.append(block)

    def close(self) -> None:
        """Writes the last block."""
        self._file.append(self._blocks.rest())


class Hdf5File:
    """An HDF5 file whose datasets grow by whole chunks, so that each is compressed once.

    Args:
        out: Where it is written.
        groups: Its content.
        for_matlab: Reverse the dimensions and name the types, as MATLAB expects.
    """

    def __init__(
        self, out: ForgivingFile, groups: list[Group], *, for_matlab: bool = False
    ) -> None:
        self._is_matlab = for_matlab
        arrays = [array for group in groups for array in group.arrays]
        self._pending: dict[Path, npt.NDArray[Any]] = {
            array.path: np.empty((0, *array.shape), array.dtype) for array in arrays
        }
        h5py = require("h5py", "hdf5", "to write HDF5 files")
        self._out = out
        with self._errors():
            size = USER_BLOCK if for_matlab else 0
            self.file = h5py.File(self._out, "w", userblock_size=size)
            self._sets = {array.path: self._dataset(array) for array in arrays}

    def __enter__(self) -> Hdf5File:
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        with self._errors():
            try:
                if kind is None:
                    for path, rows in self._pending.items():
                        self._grow(path, rows)
                    if self._is_matlab:
                        self._finish_matlab()
            finally:
                self.file.close()

    def append(self, block: Block) -> None:
        """Appends rows to the datasets."""
        with self._errors():
            for path, rows in block.items():
                pending = np.concatenate([self._pending[path], rows])
                whole = len(pending) - len(pending) % CHUNK
                self._grow(path, pending[:whole])
                self._pending[path] = pending[whole:].copy()

    @contextmanager
    def _errors(self) -> Iterator[None]:
        """Raises the error of a write; those of the HDF5 library that follow from it are pages long."""
        try:
            yield
        finally:
            self._out.check()

    def describe(self, group: Group) -> None:
        """Adds what describes a group as attributes."""
        self.file[group.name].attrs.update({key: text for key, text in group.texts.items() if text})

    def add_text(self, path: Path, text: str) -> None:
        """Adds a text as MATLAB has it."""
        codes = np.frombuffer(text.encode("utf-16-le"), np.uint16)
        found = (
            self._matlab_empty(path, (0, 0))
            if not text
            else self.file.create_dataset("/".join(path), data=codes[:, np.newaxis])
        )
        found.attrs["MATLAB_class"] = np.bytes_("char")
        found.attrs["MATLAB_int_decode"] = np.int32(2)

    def _matlab_empty(self, path: Path, shape: tuple[int, ...]) -> Any:
        """Adds a matrix without elements: MATLAB stores its size."""
        found = self.file.create_dataset("/".join(path), data=np.array(shape, np.uint64))
        found.attrs["MATLAB_empty"] = np.uint8(1)
        return found

    def _finish_matlab(self) -> None:
        """Replaces datasets without rows, and marks groups as structs."""
        for path, dataset in self._sets.items():
            if not dataset.size:
                name, shape = dataset.attrs["MATLAB_class"], dataset.shape[::-1]
                del self.file["/".join(path)]
                self._matlab_empty(path, shape).attrs["MATLAB_class"] = name
        groups = {path[:depth] for path in self._sets for depth in range(1, len(path))}
        for group in groups:
            self.file["/".join(group)].attrs["MATLAB_class"] = np.bytes_("struct")

    def _dataset(self, array: Array) -> Any:
        shapes: list[tuple[int | None, ...]] = [(rows, *array.shape) for rows in (0, None, CHUNK)]
        if self._is_matlab:  # a scalar is a matrix with one column
            shapes = [(shape if array.shape else (*shape, 1))[::-1] for shape in shapes]
        found = self.file.create_dataset(
            "/".join(array.path),
            shapes[0],
            array.dtype,
            maxshape=shapes[1],
            chunks=shapes[2],
            compression="gzip",
            compression_opts=1,
            shuffle=True,
        )
        if self._is_matlab:
            found.attrs["MATLAB_class"] = np.bytes_(MATLAB_CLASSES[array.dtype.str[1:]])
        elif array.unit:
            found.attrs["unit"] = array.unit
        return found

    def _grow(self, path: Path, rows: npt.NDArray[Any]) -> None:
        dataset = self._sets[path]
        axis = dataset.ndim - 1 if self._is_matlab else 0
        before = dataset.shape[axis]
        if not len(rows):
            return
        dataset.resize(before + len(rows), axis)
        if self._is_matlab:
            dataset[..., before:] = rows.T
        else:
            dataset[before:] = rows
