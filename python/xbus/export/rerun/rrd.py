"""Files for the viewer rerun."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from xbus.export.format import Format, Writer
from xbus.export.part import Part
from xbus.export.replacing import replacing
from xbus.export.rerun.stream import RerunStream, names_of, new_recording
from xbus.export.valid import STATUS
from xbus.extras import require

__all__ = ["Rrd"]

#: How long rerun may take to write what it was sent, in s. Without a limit it waits for ever on a full disk.
TIMEOUT = 3600.0
#: Bytes that fit on no full disk.
PROBE = 1 << 20


@dataclass(frozen=True)
class Rrd(Format):
    """Orientation in 3D, series, positions on a map, and events."""

    #: The status decides which positions of the filter count, and UTC is a timeline.
    always = (*STATUS, "utc_time")

    def quantities(self, shape: Part) -> None:
        """See `Format.quantities`."""

    @contextmanager
    def open(self, path: str | os.PathLike[str], shape: Part) -> Iterator[Writer]:
        """See `Format.open`."""
        recording = new_recording()
        with replacing(path) as out:
            # rerun opens the file by itself.
            name = os.fspath(out.name)
            try:
                with _writing(name):
                    recording.save(name)
                writer = _RrdWriter(recording, name, names_of(shape.devices))
                yield writer
                writer.close()
            finally:
                recording.disconnect()
            if os.path.isfile(name):  # noqa: PTH113
                _check(name)


class _RrdWriter:
    def __init__(self, recording: Any, name: str, devices: Mapping[int, int]) -> None:
        self._recording, self._name = recording, name
        self._stream = RerunStream(recording, devices)

    @property
    def counts(self) -> dict[str, int]:
        return {"sample": self._stream.samples, "event": self._stream.events}

    def write(self, part: Part) -> None:
        self._stream.write(part)
        self._flush()

    def close(self) -> None:
        """Writes the events after the last sample."""
        self._stream.close()
        self._flush()

    def _flush(self) -> None:
        with _writing(self._name):
            self._recording.flush(timeout_sec=TIMEOUT)


@contextmanager
def _writing(name: str) -> Iterator[None]:
    """Replaces the error of rerun, which does not name the cause, by one of the system."""
    try:
        yield
    except RuntimeError as error:
        raise _failure(name) from error


def _check(name: str) -> None:
    """Checks that a file is complete: rerun only logs an error of writing its end."""
    try:
        require("rerun.chunk", "rerun", "to check .rrd files").RrdReader(name)
    except RuntimeError as error:
        raise _failure(name) from error


def _failure(name: str) -> OSError:
    """Returns the error that stops rerun from writing to a file, found by writing to its end."""
    try:
        with open(name, "ab") as out:  # noqa: PTH123
            out.write(bytes(PROBE))
    except OSError as error:
        return OSError(error.errno, error.strerror, name)
    return OSError(errno.EIO, os.strerror(errno.EIO), name)
