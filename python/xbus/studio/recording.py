"""A recording that the studio makes, and the notes beside it."""

from __future__ import annotations

import contextlib
import errno
import json
import math
import os
import shutil
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

from xbus.device.recording import Recording

__all__ = ["NOTES", "Note", "StudioRecording", "read_notes"]

#: Suffix of the side file with notes: one JSON object per line.
NOTES = ".notes"
#: Free bytes below which a disk is taken as full.
ALMOST_FULL = 1_000_000


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

    Args:
        path: The first file.
        recording: The recording.
        duration: Seconds after which it is over; None for no limit.

    Attributes:
        path: The first file.
        notes: The notes so far.
    """

    def __init__(self, path: Path, recording: Recording, duration: float | None = None) -> None:
        self.path, self._recording = path, recording
        self._duration = math.inf if duration is None else duration
        self.notes: list[Note] = []
        self._began = time.monotonic()
        self._ended: float | None = None
        self._is_stopped = False

    @property
    def seconds(self) -> float:
        """Duration so far, in seconds; it stands still after an early end."""
        if self._ended is None and self.error is not None:
            self._ended = time.monotonic()
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
    def files(self) -> int:
        """Number of files so far."""
        return len(self._recording.files)

    @property
    def problem(self) -> str | None:
        """The sentence about an early end, with the remedy, or None."""
        if self.error is None:
            return None
        try:
            is_full = shutil.disk_usage(self.path.parent).free < ALMOST_FULL
        except OSError:  # the folder is gone
            is_full = False
        remedy = "free some space" if is_full else "check the disk"
        name = self.path.name
        return (
            f"{name} ended early: {self.error}; what came before is kept; {remedy} and record again"
        )

    @property
    def is_over(self) -> bool:
        """Whether its time limit has passed."""
        return self.seconds >= self._duration

    def add_note(self, text: str, seconds: float | None = None) -> Note:
        """Appends a note to the side file, at once.

        Args:
            text: The text; a marker has none.
            seconds: Time of the note, in seconds since 1970; None for now.

        Raises:
            OSError: The side file cannot be written.
        """
        note = Note(time.time() if seconds is None else seconds, text)
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
        if not self._is_stopped:
            self._is_stopped = True
            with contextlib.suppress(OSError):
                self._recording.stop()
            self._ended = self._ended or time.monotonic()


def read_notes(path: Path) -> list[Note]:
    """Returns the notes of a recording; lines that are not notes are left out."""
    try:
        # `splitlines` would also end a line at separators that a note may contain.
        lines = path.with_name(path.name + NOTES).read_text("utf-8", "replace").split("\n")
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
