"""Awinda trackers: what is known of their snapshots, one tracker at a time."""

from __future__ import annotations

import os
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from xbus import _core
from xbus.export import tables
from xbus.formatting import device_name
from xbus.log.arrays import read_only
from xbus.log.column import Column

if TYPE_CHECKING:
    import pyarrow as pa

__all__ = ["Tracker", "TrackerCounts", "TrackerSummary", "count_losses", "trackers_of"]

#: A frame number that steps back by more starts again: a snapshot that is sent again is late by less.
RESTART_STEP = 1 << 15
#: Maximum number of trackers that are counted. A station has 32 at most.
MAX_TRACKERS = 1000
#: Frame numbers have 32 bits; those of each run are compared with those of the same run only.
RUN_BITS = 33


class Tracker:
    """What one Awinda tracker sent, in the order in which it was measured.

    Snapshots that were sent again are in their place, each once. The increments, from which the vendor's
    software computes the orientation, have no published scale; they are in ``log["awinda_snapshot"]``.

    Attributes:
        device_id: Identifier of the tracker.
        sample: Index of the sample of each row, ``(N,)`` int64, read-only.
        packet_counter: Frame number, ``(N,)`` int64, read-only; its low 16 bits are the packet counter of the
            vendor's exports.
        magnetic_field: ``(N, 3)`` float64 in a.u., read-only.
        lost_samples: Number of frame numbers that are missing.
        gaps: Number of places at which they are missing.
    """

    def __init__(self, device_id: int, column: Column, rows: npt.NDArray[np.intp]) -> None:
        self.device_id = device_id
        frame = column.values["frame"][rows].astype(np.int64)
        order, _ = _in_order(frame)
        self.lost_samples, self.gaps = count_losses(frame)
        rows = rows[order]
        self.sample = read_only(column.sample[rows])
        self.packet_counter = read_only(frame[order])
        scaled = column.scaled[rows]
        self.magnetic_field = read_only(
            np.stack([scaled[name] for name in ("magX", "magY", "magZ")], axis=1)
        )

    def __len__(self) -> int:
        return len(self.sample)

    def keys(self) -> tuple[str, str]:
        """Returns the names of the quantities."""
        return "packet_counter", "magnetic_field"

    def __repr__(self) -> str:
        return f"<Tracker {self.device_id:08X}: {len(self):,} rows, {self.lost_samples:,} lost>"

    def to_arrow(self) -> pa.Table:
        """Returns a pyarrow table: ``sample``, ``packet_counter`` and the components of the magnetic field.

        Raises:
            ImportError: The extra ``arrow`` is not installed.
        """
        table: pa.Table = tables.arrow(self.arrow_stream())
        return table

    def arrow_stream(self) -> _core.ArrowStream:
        """Returns the table of `to_arrow` as a stream for libraries that speak the Arrow C interface."""
        return tables.stream_of(
            [
                ("sample", self.sample, {}),
                ("packet_counter", self.packet_counter, {}),
                *(
                    (f"magnetic_field_{axis}", values, {"unit": "a.u."})
                    for axis, values in zip("xyz", self.magnetic_field.T, strict=True)
                ),
            ]
        )

    def __arrow_c_stream__(self, requested_schema: object = None) -> object:
        """Returns the table of `to_arrow`, for libraries that speak the Arrow C interface."""
        return self.arrow_stream().__arrow_c_stream__(requested_schema)

    def to_npz(self, path: str | os.PathLike[str]) -> None:
        """Writes ``sample``, ``packet_counter`` and ``magnetic_field`` to an npz file.

        Raises:
            OSError: The file cannot be written.
        """
        tables.npz(self.npz_arrays(), path)

    def npz_arrays(self) -> dict[str, npt.NDArray[Any]]:
        """Returns the arrays of `to_npz`, by name."""
        names = ("sample", "packet_counter", "magnetic_field")
        return {name: getattr(self, name) for name in names}


def trackers_of(column: Column | None) -> dict[int, Tracker]:
    """Returns the trackers in a column of snapshots, by identifier, in the order in which they appear."""
    return (
        {key: Tracker(key, column, rows) for key, rows in _rows_of(column)}
        if column is not None
        else {}
    )


def _rows_of(column: Column) -> Iterator[tuple[int, npt.NDArray[np.intp]]]:
    ids = column.values["deviceId"]
    order = np.argsort(ids, kind="stable")
    found, starts = np.unique(ids[order], return_index=True)
    rows = np.split(order, starts[1:]) if len(found) else []
    for _, device_id, own in sorted(zip(order[starts].tolist(), found.tolist(), rows, strict=True)):
        yield device_id, own


def _in_order(frame: npt.NDArray[np.int64]) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.int64]]:
    """Returns the rows by run and frame number, each number once, and the run of each row."""
    run = np.cumsum(np.diff(frame, prepend=frame[:1]) < -RESTART_STEP).astype(np.int64)
    order = np.lexsort((frame, run))
    is_new = np.ones(len(order), bool)
    is_new[1:] = (np.diff(frame[order]) != 0) | (np.diff(run[order]) != 0)
    return order[is_new], run


def count_losses(frame: npt.NDArray[np.int64]) -> tuple[int, int]:
    """Returns how many frame numbers are missing between others, and in how many places.

    Args:
        frame: Frame numbers of one tracker, in the order in which they arrived. One that is late by more than
            `RESTART_STEP` fills no gap.

    >>> import numpy as np
    >>> count_losses(np.array([5, 6, 9, 8, 12]))
    (3, 2)
    """
    counter = _FrameCounter()
    counter.add(frame)
    return counter.losses


class _FrameCounter:
    """Counts missing frame numbers, part by part. It keeps only numbers between which others can still come.

    Attributes:
        rows: Number of frame numbers, with those that came again.
    """

    def __init__(self) -> None:
        self.rows = 0
        self._lost = self._gaps = 0
        #: The numbers of the present run from the last one on that is older than `RESTART_STEP`, ascending.
        self._recent = np.empty(0, np.int64)
        self._last = np.empty(0, np.int64)

    def add(self, frame: npt.NDArray[np.int64]) -> None:
        """Adds the next numbers, in the order in which they arrived."""
        if not len(frame):
            return
        self.rows += len(frame)
        step = np.diff(np.concatenate((self._last if len(self._last) else frame[:1], frame)))
        self._last = frame[-1:].copy()
        run = np.cumsum(step < -RESTART_STEP)
        number = frame + (run << RUN_BITS)
        highest = np.maximum.accumulate(np.concatenate((self._recent[-1:], number)))
        in_time = highest[-len(number) :] - number <= RESTART_STEP
        seen = np.union1d(self._recent, number[in_time])
        start = run[-1] << RUN_BITS
        oldest = max(start, seen[-1] - RESTART_STEP)
        # Between the numbers before this place no others can come.
        final = max(np.searchsorted(seen, oldest, "right") - 1, np.searchsorted(seen, start))
        lost, gaps = _missing(seen[: final + 1])
        self._lost, self._gaps = self._lost + lost, self._gaps + gaps
        self._recent = seen[final:] - start

    @property
    def losses(self) -> tuple[int, int]:
        """How many numbers are missing between others, and in how many places."""
        lost, gaps = _missing(self._recent)
        return self._lost + lost, self._gaps + gaps


def _missing(numbers: npt.NDArray[np.int64]) -> tuple[int, int]:
    """Returns how many numbers are missing in ascending ones of the same runs, and in how many places."""
    step = np.diff(numbers)[np.diff(numbers >> RUN_BITS) == 0] - 1
    return int(step.sum()), int(np.count_nonzero(step))


class TrackerSummary(NamedTuple):
    """An Awinda tracker.

    Attributes:
        device_id: Its identifier in hex.
        rows: Number of snapshots, with those that were sent again.
        lost_samples: Number of missing frame numbers.
        gaps: Number of places at which they are missing.
    """

    device_id: str
    rows: int
    lost_samples: int
    gaps: int


class TrackerCounts:
    """Counts the snapshots of each tracker, part by part, in memory that does not depend on their number."""

    def __init__(self) -> None:
        self._counters: dict[int, _FrameCounter] = {}

    def add(self, column: Column | None) -> None:
        """Adds the snapshots of a part; of new trackers only the first `MAX_TRACKERS`."""
        if column is None:
            return
        frame = column.values["frame"]
        for device_id, rows in _rows_of(column):
            if device_id in self._counters or len(self._counters) < MAX_TRACKERS:
                counter = self._counters.setdefault(device_id, _FrameCounter())
                counter.add(frame[rows].astype(np.int64))

    def summaries(self) -> dict[int, TrackerSummary]:
        """Returns the trackers by device identifier, in the order in which they appear."""
        return {
            device_id: TrackerSummary(device_name(device_id), counter.rows, *counter.losses)
            for device_id, counter in self._counters.items()
        }
