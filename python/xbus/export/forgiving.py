"""A file for libraries that do not survive a full disk."""

from __future__ import annotations

import io
import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import BinaryIO

from xbus.export.format import ExportError
from xbus.export.replacing import replacing

__all__ = ["ForgivingFile", "replacing_forgivingly"]


class ForgivingFile(io.RawIOBase):
    """A file whose writes never fail: what follows the first error is dropped.

    HDF5 files and archives write once more when they are closed after an error, and HDF5 ends the process
    if that fails too.

    Args:
        file: The file, which is not closed.
    """

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self._error: OSError | None = None

    def check(self) -> None:
        """Raises the error of the first write that failed."""
        if self._error is not None:
            raise self._error

    def readable(self) -> bool:
        """Returns True."""
        return True

    def writable(self) -> bool:
        """Returns True."""
        return True

    def seekable(self) -> bool:
        """Returns True."""
        return True

    def readinto(self, buffer: memoryview) -> int:  # type: ignore[override]
        """Reads bytes into a buffer, and returns their number."""
        data = self._file.read(len(buffer))
        buffer[: len(data)] = data
        return len(data)

    def write(self, data: bytes | memoryview) -> int:  # type: ignore[override]
        """Writes all bytes, or drops them, and returns their number."""
        size = memoryview(data).nbytes
        if self._error is None:
            view = memoryview(data).cast("B")
            try:
                while view:
                    view = view[self._file.write(view) :]
            except OSError as error:
                self._error = error
        return size

    def seek(self, offset: int, whence: int = 0) -> int:
        """Changes the position."""
        return self._file.seek(offset, whence)

    def tell(self) -> int:
        """Returns the position."""
        return self._file.tell()

    def truncate(self, size: int | None = None) -> int:
        """Changes the size."""
        return size or 0 if self._error else self._file.truncate(size)


@contextmanager
def replacing_forgivingly(path: str | os.PathLike[str]) -> Iterator[ForgivingFile]:
    """Opens a file to write and read that replaces ``path`` when it is complete, as `replacing`.

    Raises:
        ExportError: ``path`` is a pipe or a device.
        OSError: The file cannot be written.
    """
    if os.path.exists(path) and not os.path.isfile(path):  # noqa: PTH110, PTH113 - pathlib is slow to import
        raise ExportError(f"{os.fspath(path)} is no regular file, which this format needs")
    with replacing(path) as out, open(out.name, "w+b", buffering=0) as raw:  # noqa: PTH123
        file = ForgivingFile(raw)
        yield file
        file.check()
