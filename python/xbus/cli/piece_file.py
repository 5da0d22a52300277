"""A file with a part of a recording, and the side file with the arrivals of its bytes."""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Iterator
from tempfile import SpooledTemporaryFile
from typing import IO, TYPE_CHECKING

from xbus.cli.export_target import writing
from xbus.export.replacing import replacing
from xbus.log.arrivals import HEADER, Arrivals, records_of, side_files

if TYPE_CHECKING:
    from xbus.log.cutting import Chunk

__all__ = ["PieceFile", "piece_file"]

#: Bytes of records that are kept in memory; more are written to a temporary file.
MOST_HELD = 4 << 20


class PieceFile:
    """A file that is written in chunks. Made by `piece_file`.

    Args:
        file: The opened file.
        out: Its path.
        arrivals: When the bytes of the recording arrived, or None.
        records: A temporary file for the arrivals of what is written.

    Attributes:
        size: Number of bytes written.
    """

    def __init__(
        self, file: IO[bytes], out: str, arrivals: Arrivals | None, records: IO[bytes]
    ) -> None:
        self._file, self._out = file, out
        self._arrivals, self._records = arrivals, records
        self.size = 0

    def write(self, chunk: Chunk) -> None:
        """Writes the bytes of a chunk."""
        with writing(self._out):
            self._file.write(chunk.data)
        if self._arrivals is not None and len(chunk.start):
            end, time = self._arrivals.of_ranges(chunk.start, chunk.end)
            self._records.write(records_of(end + self.size, time))
        self.size += len(chunk.data)

    @property
    def has_arrivals(self) -> bool:
        """Whether the arrival of a byte is known."""
        return self._records.tell() > 0

    def write_arrivals(self, file: IO[bytes]) -> None:
        """Writes the side file."""
        self._records.seek(0)
        file.write(HEADER)
        shutil.copyfileobj(self._records, file)


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
    with writing(out), replacing(out) as file, SpooledTemporaryFile(MOST_HELD) as records:
        piece = PieceFile(file, out, arrivals, records)
        yield piece
        file.flush()
        if os.path.exists(out) and not os.path.isfile(out):  # noqa: PTH110, PTH113 - pathlib is slow to import
            return  # a pipe has no side file
        (side,) = side_files(out)
        if piece.has_arrivals:
            with replacing(side) as side_file:
                piece.write_arrivals(side_file)
        else:
            with contextlib.suppress(FileNotFoundError):
                os.remove(side)  # noqa: PTH107
