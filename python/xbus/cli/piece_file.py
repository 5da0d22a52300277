"""A file with a part of a recording, and the side file with the arrivals of its bytes."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from typing import IO, TYPE_CHECKING

import numpy as np

from xbus.cli.export_target import writing
from xbus.export.replacing import replacing
from xbus.log.arrivals import Arrivals, side_files

if TYPE_CHECKING:
    import numpy.typing as npt

    from xbus.log.cutting import Chunk

__all__ = ["PieceFile", "piece_file"]


class PieceFile:
    """A file that is written in chunks. Made by `piece_file`.

    Args:
        file: The opened file.
        out: Its path.
        arrivals: When the bytes of the recording arrived, or None.

    Attributes:
        size: Number of bytes written.
    """

    def __init__(self, file: IO[bytes], out: str, arrivals: Arrivals | None) -> None:
        self._file, self._out, self._arrivals = file, out, arrivals
        self._end: list[npt.NDArray[np.int64]] = []
        self._time: list[npt.NDArray[np.int64]] = []
        self.size = 0

    def write(self, chunk: Chunk) -> None:
        """Writes the bytes of a chunk."""
        with writing(self._out):
            self._file.write(chunk.data)
        if self._arrivals is not None and len(chunk.start):
            end, time = self._arrivals.of_ranges(chunk.start, chunk.end)
            self._end.append(end + self.size)
            self._time.append(time)
        self.size += len(chunk.data)

    @property
    def arrivals(self) -> Arrivals | None:
        """The arrivals of the bytes written, None if none is known."""
        if not sum(map(len, self._end)):
            return None
        return Arrivals(np.concatenate(self._end), np.concatenate(self._time), self.size)


@contextlib.contextmanager
def piece_file(out: str, arrivals: Arrivals | None) -> Iterator[PieceFile]:
    """Opens a file for a part of a recording, which appears with its side file when it is complete.

    A side file of an earlier OUT is removed: it would give wrong host times.

    Args:
        out: Path of the file.
        arrivals: When the bytes of the recording arrived, or None.

    Raises:
        Failure: A file cannot be written.
    """
    with writing(out), replacing(out) as file:
        piece = PieceFile(file, out, arrivals)
        yield piece
        file.flush()
        if os.path.exists(out) and not os.path.isfile(out):  # noqa: PTH110, PTH113 - pathlib is slow to import
            return  # a pipe has no side file
        (side,) = side_files(out)
        if (known := piece.arrivals) is None:
            with contextlib.suppress(FileNotFoundError):
                os.remove(side)  # noqa: PTH107
        else:
            with replacing(side) as side_file:
                side_file.write(known.to_bytes())
