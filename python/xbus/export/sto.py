"""OpenSim's orientations (.sto): a column of quaternions for each device."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import IO, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from xbus.export.format import ExportError, Format, Writer
from xbus.export.part import Part, PartDevice, device_label
from xbus.export.replacing import replacing
from xbus.export.ros.measured import Measured
from xbus.export.text import shortest
from xbus.protocol.keys import EntryKey
from xbus.protocol.tables import device_of

__all__ = ["Sto"]

FloatArray = npt.NDArray[np.float64]

ORIENTATIONS = ("quaternion", "rotation_matrix", "euler_angles")
#: Name of a column; OpenSim takes what stands before the suffix as the name of a body.
NAME = re.compile(r"[A-Za-z0-9_.\-]+")
SUFFIX = "_imu"
#: Rows that are written at a time.
STEP = 1 << 16
#: A row has samples of other devices that are at most this many samples of the log before or after that of
#: the first device, which limits what is remembered.
REACH = 10_000


class _Track(NamedTuple):
    """Orientations of a device: the samples, their times in s, and quaternions, q0 first."""

    sample: npt.NDArray[np.int64]
    time: npt.NDArray[np.float64]
    q: npt.NDArray[np.float64]

    @classmethod
    def empty(cls) -> _Track:
        return cls(np.empty(0, np.int64), np.empty(0), np.empty((0, 4)))

    def rows(self, rows: slice | npt.NDArray[np.bool_]) -> _Track:
        """Returns some of the rows."""
        return _Track(self.sample[rows], self.time[rows], self.q[rows])


@dataclass(frozen=True)
class Sto(Format):
    """Orientations for OpenSim, in ENU (z is up), with the time since the first row.

    There is a row for each sample of the device that was first in the log, if every other device has a sample
    nearer to it than half the time to the next. The devices must share a clock, as those of one bus do.

    Attributes:
        sto_names: Names of devices, by device identifier: ``"0080001E=pelvis,0080001F=torso"``. Other devices
            are named by their identifier.
    """

    sto_names: str | None = None

    def __post_init__(self) -> None:
        self._names  # raises  # noqa: B018

    @property
    def _names(self) -> dict[str, str]:
        """The names by device identifier."""
        names: dict[str, str] = {}
        for pair in (self.sto_names or "").split(",") if self.sto_names else ():
            device, equals, name = (text.strip() for text in pair.partition("="))
            if not (NAME.fullmatch(device) and equals and NAME.fullmatch(name)):
                raise ValueError(f"names are such as 0080001E=pelvis,0080001F=torso, not {pair!r}")
            names[device.upper()] = name.removesuffix(SUFFIX)
        if len(set(names.values())) < len(names):
            raise ValueError(f"two devices have the same name in {self.sto_names!r}")
        return names

    def quantities(self, shape: Part) -> Sequence[EntryKey]:
        """See `Format.quantities`."""
        found = [key for key in shape if (key if isinstance(key, str) else key[0]) in ORIENTATIONS]
        if not found:
            raise ExportError(
                "an .sto file needs orientation (quaternion, rotation_matrix or euler_angles)"
            )
        return found

    @contextmanager
    def open(self, path: str | os.PathLike[str], shape: Part) -> Iterator[Writer]:
        """See `Format.open`."""
        self.quantities(shape)
        labels = _labels(shape.devices, self._names)
        with replacing(path) as out:
            out.write(b"DataType=Quaternion\nversion=3\nOpenSimVersion=4.5\nendheader\n")
            out.write("\t".join(["time", *labels]).encode() + b"\n")
            writer = _StoWriter(out, [device_of(device.bid) for device in shape.devices])
            yield writer
            writer.close()


def _labels(devices: Sequence[PartDevice], names: Mapping[str, str]) -> list[str]:
    """Returns the labels of the columns.

    Raises:
        ExportError: A name is of a device that is not in the log.
    """
    found = [device_label(device) for device in devices]
    if unknown := set(names) - set(found):
        there = ", ".join(found)
        raise ExportError(f"no device {min(unknown)} to be named; the log has {there}")
    return [names.get(label, label) + SUFFIX for label in found]


class _StoWriter:
    def __init__(self, out: IO[bytes], devices: Sequence[int]) -> None:
        self._out = out
        self._tracks = {device: _Track.empty() for device in devices}
        #: The last sample of the log whose rows are written; the time of the first row and of the last.
        self._end = -1
        self._start = self._last = -np.inf
        self._counts = {"row": 0}

    @property
    def counts(self) -> dict[str, int]:
        return dict(self._counts)

    def write(self, part: Part) -> None:
        if len(part.restarts):
            raise ExportError(
                f"a device restarts at sample {part.restarts[0]:,}, and an .sto file has one time axis; "
                "choose samples before or after it with between=, or cut the recording with xbus cut"
            )
        bids = device_of(part.bid)
        end = part.first_sample + len(part) - 1 - REACH
        for device, track in self._tracks.items():
            new, is_known = _orientations(part, bids == device)
            self._count("omitted orientation", ~is_known)
            known: list[Any] = [np.concatenate(pair) for pair in zip(track, new, strict=True)]
            self._tracks[device] = _Track(*known)
        self._write(end)
        for device, track in self._tracks.items():
            # Later rows have samples from here on, and the time between them.
            first = int(np.searchsorted(track.sample, end - REACH))
            self._tracks[device] = track.rows(slice(first, None))

    def _write(self, end: int) -> None:
        """Writes the rows up to a sample of the log, of which all samples within `REACH` are known."""
        first, *others = self._tracks.values()
        rows = np.flatnonzero((first.sample > self._end) & (first.sample <= end))
        self._end = max(end, self._end)
        if not len(rows):
            return
        limit = _half_step(first, rows)
        is_complete = np.ones(len(rows), np.bool_)
        quaternions = [first.q[rows]]
        for other in others:
            place, is_near = _nearest(other, first, rows, limit)
            is_complete &= is_near
            quaternions.append(other.q[place] if len(other.q) else np.zeros((len(rows), 4)))
        # The time axis must rise.
        time = first.time[rows]
        before = np.maximum.accumulate(np.concatenate([[self._last], time[:-1]]))
        is_complete &= time > before
        self._last = max(self._last, float(time.max()))
        self._count("row", is_complete)
        self._count("incomplete row", ~is_complete)
        self._write_text(time[is_complete], [q[is_complete] for q in quaternions])

    def _count(self, what: str, found: npt.NDArray[np.bool_]) -> None:
        if number := int(np.count_nonzero(found)):
            self._counts[what] = self._counts.get(what, 0) + number

    def _write_text(self, time: npt.NDArray[np.float64], quaternions: list[FloatArray]) -> None:
        for first in range(0, len(time), STEP):
            rows = slice(first, first + STEP)
            if np.isinf(self._start):
                self._start = float(time[0])
            # Time stamps have 0.1 ms.
            columns = [shortest((time[rows] - self._start).round(6))]
            columns += [
                list(map(",".join, zip(*map(shortest, q[rows].T), strict=True)))
                for q in quaternions
            ]
            lines = map("\t".join, zip(*columns, strict=True))
            self._out.write(("\n".join(lines) + "\n").encode())

    def close(self) -> None:
        """Writes the last rows.

        Raises:
            ExportError: There is no row.
        """
        self._write(
            max(
                (int(track.sample[-1]) for track in self._tracks.values() if len(track.sample)),
                default=-1,
            )
        )
        if not self._counts["row"]:
            several = len(self._tracks) > 1
            raise ExportError(
                "at no time all devices have an orientation; do they share a clock? bid= chooses one"
                if several
                else "no orientation has a time stamp and is a rotation, neither zeros nor NaN; "
                "rate=HZ gives times to a log with a counter"
            )


def _orientations(part: Part, only: npt.NDArray[np.bool_]) -> tuple[_Track, npt.NDArray[np.bool_]]:
    """Returns the orientations of a device that have a time and are rotations, and which they are."""
    sample, q = Measured(part, converts=True, is_driver=False, only=only).orientation
    if not len(q):
        return _Track.empty(), np.empty(0, np.bool_)
    track = _Track(sample + part.first_sample, part.time[sample], q)
    is_known = np.isfinite(track.time) & np.isfinite(q).all(axis=1) & q.any(axis=1)
    return track.rows(is_known), is_known


def _half_step(track: _Track, rows: npt.NDArray[np.intp]) -> FloatArray:
    """Returns half of the time from each row to the nearer one beside it; 0 if there is none in reach."""
    steps = np.abs(np.diff(track.time))
    steps[np.diff(track.sample) > REACH] = np.inf
    steps = np.concatenate([[np.inf], steps, [np.inf]])
    step = np.minimum(steps[rows], steps[rows + 1])
    return np.where(np.isinf(step), 0.0, step / 2)


def _nearest(
    other: _Track, first: _Track, rows: npt.NDArray[np.intp], limit: FloatArray
) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.bool_]]:
    """Returns which sample of another device belongs to each of these rows, and whether it is near enough.

    It is the one before or after it in the log.
    """
    if not len(other.sample):
        return np.zeros(len(rows), np.intp), np.zeros(len(rows), np.bool_)
    after = np.searchsorted(other.sample, first.sample[rows])
    places = np.clip(np.stack([after - 1, after]), 0, len(other.sample) - 1)
    distance = np.abs(other.time[places] - first.time[rows])
    distance[np.abs(other.sample[places] - first.sample[rows]) > REACH] = np.inf
    choice = np.argmin(distance, axis=0)
    columns = np.arange(len(rows))
    # Times are float64: a tie must not depend on their last bits.
    return places[choice, columns], distance[choice, columns] <= limit + 1e-6
