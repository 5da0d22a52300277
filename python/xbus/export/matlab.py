"""MATLAB files: version 5 if they are small, else version 7.3, which is HDF5."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from xbus.export.columns import Array, Block, Blocks, Group, Path, groups_of
from xbus.export.forgiving import ForgivingFile, replacing_forgivingly
from xbus.export.format import Format, Writer
from xbus.export.hdf5 import Hdf5File
from xbus.export.part import Part
from xbus.extras import require
from xbus.protocol.keys import EntryKey

__all__ = ["Matlab"]

#: Bytes of arrays up to which a file has version 5, which is written from memory.
LIMIT = 64 << 20
#: The start of a file, after the version: MATLAB prints it.
TEXT = "Platform: any, Created by: xbus"
#: Bytes of the text, and what follows it: no subsystem data, version and byte order.
TEXT_SIZE, VERSION_7_3 = 116, bytes(8) + b"\x00\x02IM"


@dataclass(frozen=True)
class Matlab(Format):
    """A struct for each quantity, with values, time, sample, unit and what describes the quantity."""

    def quantities(self, shape: Part) -> Sequence[EntryKey] | None:  # noqa: ARG002 - all
        """See `Format.quantities`."""
        _scipy_io()
        # Only known to be needed when much is written; the extra has both.
        require("h5py", "matlab", "to write MATLAB files")
        return None

    @contextmanager
    def open(self, path: str | os.PathLike[str], shape: Part) -> Iterator[Writer]:
        """See `Format.open`."""
        with replacing_forgivingly(path) as out, _MatlabWriter(out, groups_of(shape)) as writer:
            yield writer


def _scipy_io() -> Any:
    return require("scipy.io", "matlab", "to write MATLAB files")


class _MatlabWriter:
    def __init__(self, out: ForgivingFile, groups: list[Group]) -> None:
        self._out, self._groups = out, groups
        self._blocks = Blocks(groups)
        self._samples = self._size = 0
        #: The blocks of a file that is small so far, and the file if it is not.
        self._kept: list[Block] = []
        self._file: Hdf5File | None = None
        self._stack = ExitStack()

    def __enter__(self) -> _MatlabWriter:
        return self

    def __exit__(self, *error: Any) -> None:
        if error[0] is None:
            self._append(self._blocks.rest())
            if self._file is not None:
                for path, text in _texts(self._groups).items():
                    self._file.add_text(path, text)
        self._stack.__exit__(*error)
        if error[0] is None:
            if self._file is None:
                self._write_small()
            else:
                self._out.seek(0)
                self._out.write(_text("7.3", "HDF5 schema 1.00 .") + VERSION_7_3)

    @property
    def counts(self) -> dict[str, int]:
        return {"sample": self._samples, "struct": len(self._groups)}

    def write(self, part: Part) -> None:
        self._samples += len(part)
        for block in self._blocks.add(part):
            self._append(block)

    def _append(self, block: Block) -> None:
        self._size += sum(rows.nbytes for rows in block.values())
        if self._file is None and self._size > LIMIT:
            self._file = self._stack.enter_context(
                Hdf5File(self._out, self._groups, for_matlab=True)
            )
            for kept in self._kept:
                self._file.append(kept)
            self._kept = []
        if self._file is None:
            self._kept.append(block)
        else:
            self._file.append(block)

    def _write_small(self) -> None:
        """Writes a file of version 5."""
        content = _nested(
            {array.path: self._joined(array) for group in self._groups for array in group.arrays}
            | _texts(self._groups)
        )
        _scipy_io().savemat(
            self._out, content, long_field_names=True, do_compression=True, oned_as="column"
        )
        self._out.seek(0)
        self._out.write(_text("5.0"))  # instead of one with the present time

    def _joined(self, array: Array) -> npt.NDArray[Any]:
        empty = np.empty((0, *array.shape), array.dtype)
        return np.concatenate([empty, *(block.get(array.path, empty) for block in self._kept)])


def _text(version: str, more: str = "") -> bytes:
    return f"MATLAB {version} MAT-file, {TEXT} {more}".encode().ljust(TEXT_SIZE)


def _texts(groups: list[Group]) -> dict[Path, str]:
    """Returns the texts that describe arrays, by their places in the structs."""
    texts: dict[Path, str] = {}
    for group in groups:
        texts |= {(group.name, name): text for name, text in group.texts.items()}
        for array in group.arrays:
            is_values = array.path[1] == "values"
            if is_values or group.name == "samples":
                texts[group.name, "unit", *array.path[2 if is_values else 1 :]] = array.unit
    return {path: text for path, text in texts.items() if text or path[1:] == ("unit",)}


def _nested(items: dict[Path, Any]) -> dict[str, Any]:
    tree: dict[str, Any] = {}
    for path, value in items.items():
        place = tree
        for name in path[:-1]:
            place = place.setdefault(name, {})
        place[path[-1]] = value
    return tree
