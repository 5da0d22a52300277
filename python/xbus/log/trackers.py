"""Awinda trackers: what is known of their snapshots, one tracker at a time."""

from __future__ import annotations

import os
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from xbus import _core
from xbus.export import tables
from xbus.log.arrays import read_only
from xbus.log.column import Column

if TYPE_CHECKING:
    import pyarrow as pa

__all__ = ["Tracker", "count_losses", "frames_of", "trackers_of"]

#: A frame number that steps back by more starts again: a snapshot that is sent again is late by less.
RESTART_STEP = 1 << 15


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


def frames_of(column: Column | None) -> dict[int, npt.NDArray[np.int64]]:
    """Returns the frame numbers of each tracker in a column of snapshots, in the order of arrival."""
    if column is None:
        return {}
    return {key: column.values["frame"][rows].astype(np.int64) for key, rows in _rows_of(column)}


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
        frame: Frame numbers of one tracker, in the order in which they arrived.

    >>> import numpy as np
    >>> count_losses(np.array([5, 6, 9, 8, 12]))
    (3, 2)
    """
    order, run = _in_order(frame)
    step = np.diff(frame[order])[np.diff(run[order]) == 0] - 1
    return int(step.sum()), int(np.count_nonzero(step))
