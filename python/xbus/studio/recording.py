"""A recording that the studio makes, and the notes beside it."""

from __future__ import annotations

import contextlib
import json
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
    def is_active(self) -> bool:
        """Whether it is running."""
        return self._ended is None and self._recording.is_active

    @property
    def seconds_left(self) -> float | None:
        """Seconds until the disk is full at the present rate; None if that is not known yet."""
        rate = self.bytes / self.seconds if self.seconds > 1 else 0
        return shutil.disk_usage(self.path.parent).free / rate if rate else None

    def add_note(self, text: str) -> Note:
        """Appends a note to the side file, at once.

        Raises:
            OSError: The side file cannot be written.
        """
        note = Note(time.time(), text)
        stamp = datetime.fromtimestamp(note.time, UTC).isoformat(timespec="milliseconds")
        line = json.dumps({"time": stamp, "text": text}, ensure_ascii=False)
        with self.path.with_name(self.path.name + NOTES).open("a", encoding="utf-8") as file:
            file.write(line + "\n")
        self.notes.append(note)
        return note

    def stop(self) -> None:
        """Writes what is left, and closes the file; `error` tells why it ended early."""
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
        with contextlib.suppress(ValueError, TypeError, KeyError):
            entry = json.loads(line)
            notes.append(
                Note(datetime.fromisoformat(entry["time"]).timestamp(), str(entry["text"]))
            )
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
