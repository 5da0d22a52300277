"""Recordings of a CAN bus, written by python-can."""

from __future__ import annotations

import contextlib
import io
import os
import queue
import threading
import time
from pathlib import Path
from typing import Any

from xbus.can.ids import EXTENDED
from xbus.can.traffic import GROUP_COUNTER, SAMPLE_TIME, Devices
from xbus.captures import CAPTURE_SUFFIXES
from xbus.extras import require

__all__ = ["CanRecorder"]

#: The writers of python-can by suffix.
WRITERS = {
    ".asc": "ASCWriter",
    ".blf": "BLFWriter",
    ".log": "CanutilsLogWriter",
    ".trc": "TRCWriter",
    ".csv": "CSVWriter",
    ".mf4": "MF4Writer",
}
#: Formats that are not text.
BINARY = (".blf", ".mf4")
#: Bytes of frames that a BLF file has in one container, which a crash can lose.
BLF_CONTAINER = 16 << 10
#: Maximum number of frames that wait to be written.
MAX_QUEUE = 1 << 20
#: Number of frames within which the next file of a rotation begins with a group.
MAX_LATE = 1 << 12
#: Bytes of a frame in memory, about.
FRAME_BYTES = 16


class CanRecorder:
    """Writes the frames of a bus to files in a thread, until it is stopped.

    The format follows from the suffix. The text formats (.asc, .log, .trc, .csv) can be read up to the last
    flush if the program or the computer crashes, and a .blf file up to its last container of 16 KiB. An .mf4
    file is written when the recording ends. A .trc file lacks error frames and remote frames: the writer of
    python-can leaves them out.

    Args:
        path: The first file. With rotation, ``drive-0001.blf`` follows ``drive.blf``; a number that is in use
            is skipped.
        devices: The devices on the bus: the next file begins with a group of one.
        passing: Held while frames are added and their samples handed out, so that a recording that is stopped
            has the frames of all samples that were read before.
        flush: Maximum seconds until frames are written.
        fsync: Whether to wait for the disk at each flush.
        rotate_bytes: Size in bytes at which the next file begins.
        rotate_seconds: Seconds after which the next file begins.
        overwrite: Whether to replace an existing file that is not empty.

    Raises:
        FileExistsError: The file exists, and `overwrite` is False.
        ImportError: The extra ``can`` is not installed.
        OSError: The file cannot be created.
        ValueError: The suffix is not that of a capture, or a number is out of range.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        devices: Devices,
        passing: threading.Lock,
        *,
        flush: float = 0.5,
        fsync: bool = False,
        rotate_bytes: int | None = None,
        rotate_seconds: float | None = None,
        overwrite: bool = False,
    ) -> None:
        self._path = Path(path)
        self._suffix = self._path.suffix.lower()
        if self._suffix not in WRITERS:
            raise ValueError(
                f"a CAN bus is recorded as {', '.join(CAPTURE_SUFFIXES)}, not as {self._path.name}"
            )
        for name, value in {"rotate_bytes": rotate_bytes, "rotate_seconds": rotate_seconds}.items():
            if value is not None and value <= 0:
                raise ValueError(f"{name} must be greater than 0, not {value}")
        if self._suffix == ".mf4":
            require("asammdf", "can", "to write MF4 files")
        self._can = require("can", "can", "to record a CAN bus")
        self._starts = {
            key & ~EXTENDED
            for key, row in devices.messages.items()
            if row.code in (SAMPLE_TIME, GROUP_COUNTER)
        }
        self._flush_seconds, self._fsync = flush, fsync
        self._rotate_bytes, self._rotate_seconds = rotate_bytes, rotate_seconds
        self._files: list[str] = []
        self._samples = self._done_bytes = self._file_bytes = self._frames = self._number = (
            self._late
        ) = 0
        self._error: str | None = None
        self._is_stopped = False
        self._passing, self._stopping = passing, threading.Lock()
        self._begin(self._path, overwrite=overwrite)
        self._queue: queue.Queue[list[Any] | None] = queue.Queue()
        self._waiting = 0
        self._thread = threading.Thread(target=self._run, name=f"xbus {path}", daemon=True)
        self._thread.start()

    def _begin(self, path: Path, *, overwrite: bool = False) -> None:
        """Opens a file and its writer."""
        is_new = overwrite or not (path.exists() and path.stat().st_size)
        file: Any = path.open("wb+" if is_new else "xb+")
        if self._suffix not in BINARY:
            file = io.TextIOWrapper(file, "utf-8", newline="", write_through=True)
        self._file = file
        self._writer = getattr(self._can, WRITERS[self._suffix])(file)
        if self._suffix == ".blf":
            self._writer.max_container_size = BLF_CONTAINER
        self._files.append(str(path))
        self._began = self._flushed = time.monotonic()

    def add(self, messages: list[Any], samples: int) -> None:
        """Adds frames, which the thread writes, and the number of samples that are complete with them."""
        if self._error is not None or self._is_stopped:
            return
        if self._waiting + len(messages) > MAX_QUEUE:
            self._error = "the disk is too slow: the queue is full"
            self._queue.put(None)
            return
        self._samples += samples
        self._waiting += len(messages)
        self._queue.put(messages)

    def _run(self) -> None:
        try:
            while (messages := self._next()) is not None:
                for message in messages:
                    if self._is_full(message):
                        self._rotate()
                    self._writer.on_message_received(message)
                self._frames += len(messages)
                self._file_bytes = self._size()
                self._waiting -= len(messages)
                self._flush()
            self._end()
        except Exception as error:  # of the disk or a writer
            self._error = self._error or str(error) or type(error).__name__
            with contextlib.suppress(Exception):
                self._file.close()

    def _next(self) -> list[Any] | None:
        while True:
            try:
                return self._queue.get(timeout=self._flush_seconds)
            except queue.Empty:
                self._flush()

    def _flush(self) -> None:
        if time.monotonic() - self._flushed < self._flush_seconds:
            return
        self._flushed = time.monotonic()
        self._file.flush()
        if self._fsync:
            os.fsync(self._file.fileno())

    def _size(self) -> int:
        """Returns the size of the present file in bytes."""
        binary = self._file.buffer if isinstance(self._file, io.TextIOWrapper) else self._file
        return int(binary.tell())

    def _is_full(self, message: Any) -> bool:
        is_full = (self._rotate_bytes is not None and self._size() >= self._rotate_bytes) or (
            self._rotate_seconds is not None
            and time.monotonic() - self._began >= self._rotate_seconds
        )
        if not is_full:
            return False
        self._late += 1
        return message.arbitration_id in self._starts or self._late > MAX_LATE

    def _rotate(self) -> None:
        self._end()
        self._late = 0
        while True:
            self._number += 1
            path = self._path.with_stem(f"{self._path.stem}-{self._number:04}")
            try:
                self._begin(path)
            except FileExistsError:
                continue
            return

    def _end(self) -> None:
        """Ends the present file."""
        self._writer.stop()
        if not self._file.closed:
            self._file.close()
        self._file_bytes = 0
        self._done_bytes += Path(self._files[-1]).stat().st_size

    @property
    def state(self) -> dict[str, Any]:
        """What was recorded, like that of `_core.Recorder`."""
        return {
            "files": list(self._files),
            "bytes": self._done_bytes + self._file_bytes,
            "frames": self._frames,
            "samples": self._samples,
            "strings": 0,
            "message_counts": {},
            "queued_bytes": self._waiting * FRAME_BYTES,
            "active": self._thread.is_alive(),
            "error": self._error,
        }

    def stop(self) -> dict[str, Any]:
        """Writes the remaining frames, closes the file, and returns `state`."""
        with self._stopping:
            if not self._is_stopped:
                with self._passing:
                    self._is_stopped = True
                self._queue.put(None)
            self._thread.join()
        return self.state
