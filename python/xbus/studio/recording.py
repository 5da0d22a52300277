"""A recording that the studio makes, and the notes beside it."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import shutil
import time
from datetime import UTC, datetime
from itertools import count
from pathlib import Path
from typing import NamedTuple

from xbus.device.recording import Recording

__all__ = ["NOTES", "Note", "StudioRecording", "new_file", "read_notes"]

#: Suffix of the side file with notes: one JSON object per line.
NOTES = ".notes"


class Note(NamedTuple):
    """A note.

    Attributes:
        time: When it was written, in seconds since 1970.
        text: The text; empty for a marker.
    """

    time: float
    text: str


class StudioRecording:
    """A recording in progress.

    Attributes:
        path: The first file.
        notes: The notes so far.
    """

    def __init__(self, path: Path, recording: Recording) -> None:
        self.path, self._recording = path, recording
        self.notes: list[Note] = []
        self._began = time.monotonic()
        self._ended: float | None = None

    @property
    def seconds(self) -> float:
        """Duration so far, in seconds."""
        return (self._ended or time.monotonic()) - self._began

    @property
    def bytes(self) -> int:
        """Recorded bytes."""
        return self._recording.bytes

    @property
    def samples(self) -> int:
        """Recorded samples."""
        return self._recording.samples

    @property
    def error(self) -> str | None:
        """Why the recording ended early, or None."""
        return self._recording.error

    @property
    def problem(self) -> str | None:
        """The sentence about an early end, or None."""
        return None if self.error is None else f"{self.path.name} ended early: {self.error}"

    @property
    def is_active(self) -> bool:
        """Whether it is running."""
        return self._ended is None and self._recording.is_active

    @property
    def seconds_left(self) -> float | None:
        """Seconds until the disk is full at the present rate; None if that is not known yet."""
        rate = self.bytes / self.seconds if self.seconds > 1 else 0
        try:
            return shutil.disk_usage(self.path.parent).free / rate if rate else None
        except OSError:  # the folder is gone
            return None

    def add_note(self, text: str) -> Note:
        """Appends a note to the side file, at once.

        Raises:
            OSError: The side file cannot be written.
        """
        note = Note(time.time(), text)
        stamp = datetime.fromtimestamp(note.time, UTC).isoformat(timespec="milliseconds")
        line = json.dumps({"time": stamp, "text": text}, ensure_ascii=False) + "\n"
        data = line.encode("utf-8", "replace")
        with self.path.with_name(self.path.name + NOTES).open("ab", buffering=0) as file:
            end = file.tell()
            if file.write(data) != len(data):  # the disk is full
                file.truncate(end)
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), file.name)
        self.notes.append(note)
        return note

    def stop(self) -> None:
        """Writes what is left, and closes the file; `error` says why it ended early."""
        if self._ended is None:
            with contextlib.suppress(OSError):
                self._recording.stop()
            self._ended = time.monotonic()


def read_notes(path: Path) -> list[Note]:
    """Returns the notes of a recording; lines that are not notes are left out."""
    try:
        lines = path.with_name(path.name + NOTES).read_text("utf-8", "replace").splitlines()
    except OSError:
        return []
    notes = []
    for line in lines:
        with contextlib.suppress(ValueError, TypeError, KeyError, OverflowError, RecursionError):
            entry = json.loads(line)
            seconds = datetime.fromisoformat(entry["time"]).timestamp()
            datetime.fromtimestamp(seconds)  # pages show local time, which ends with the year 9999
            notes.append(Note(seconds, str(entry["text"])))
    return notes


def new_file(folder: Path, stem: str) -> Path:
    """Creates an empty file for a recording, and returns its path.

    Raises:
        OSError: It cannot be created.
    """
    for number in count(1):
        path = folder / (f"{stem}.mtb" if number == 1 else f"{stem}-{number}.mtb")
        with contextlib.suppress(FileExistsError):
            path.touch(exist_ok=False)
            return path
    raise AssertionError
