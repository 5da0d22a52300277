"""Which positions and times are valid."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from xbus.export.part import Part, PartColumn
from xbus.protocol.tables import RECEIVER, STATUS_FLAGS
from xbus.protocol.values import GNSS_FIX_OK, POSITION_FIXES

__all__ = [
    "STATUS",
    "has_filter_fix",
    "has_fix",
    "has_fix_flags",
    "has_position",
    "is_place",
    "is_set",
    "known_time",
    "rows_of",
    "status_of",
]

#: Quantities with the status, the preferred one first, and the flags of a position of the filter.
STATUS, FIX_FLAGS = ("status_word", "status_byte"), ("filter_valid", "gnss_fix")
#: The largest coordinate of a position in ECEF, in metres.
FARTHEST = 1e9


def has_fix(rows: npt.NDArray[Any] | Mapping[str, Any]) -> npt.NDArray[np.bool_]:
    """Returns which rows of ``gnss_pvt_data`` have a position that the receiver marks as valid.

    Args:
        rows: Rows of the column, ``(N,)``, or the fields of one.
    """
    is_position = np.isin(rows["fixtype"], POSITION_FIXES)
    return np.asarray(is_position & (rows["flags"] & GNSS_FIX_OK > 0))


def has_position(part: Part, column: PartColumn) -> npt.NDArray[np.bool_]:
    """Returns which rows of ``lat_lon`` or ``position_ecef`` are a position with a fix, ``(N,)``."""
    is_fixed = has_filter_fix(part, column.sample, column.values)
    return is_place(column.name, column.values) & is_fixed


def is_place(name: str, values: npt.NDArray[Any]) -> npt.NDArray[np.bool_]:
    """Returns which rows of ``lat_lon`` or ``position_ecef`` are a place on Earth or near it, ``(N,)``."""
    limits = (90.0, 180.0) if name == "lat_lon" else (FARTHEST,) * 3
    found: npt.NDArray[np.bool_] = (np.abs(values) <= limits).all(axis=1)
    return found


def is_set(positions: npt.NDArray[Any]) -> npt.NDArray[np.bool_]:
    """Returns which positions of the filter are not zero, ``(N,)``; one without a position reports zero."""
    found: npt.NDArray[np.bool_] = (positions != 0).any(axis=1)
    return found


def has_fix_flags(words: npt.NDArray[Any] | int) -> npt.NDArray[np.bool_]:
    """Returns which status words or bytes have the flags of a position of the filter."""
    return np.asarray(np.all([STATUS_FLAGS[name].of(words) for name in FIX_FLAGS], axis=0))


def has_filter_fix(
    part: Part, sample: npt.NDArray[np.int64], positions: npt.NDArray[Any]
) -> npt.NDArray[np.bool_]:
    """Returns which positions of the filter have a fix, ``(N,)``.

    The position is not zero, and the status of the same sample, if there is one, has the flags
    ``filter_valid`` and ``gnss_fix``.

    Args:
        part: The part.
        sample: The sample of each position, ``(N,)``.
        positions: The positions, ``(N, k)``.
    """
    is_fixed = is_set(positions)
    if (status := status_of(part)) is not None:
        is_known, row = rows_of(status, sample)
        is_fixed[is_known] &= has_fix_flags(status.values[row])
    return is_fixed


def status_of(part: Part) -> PartColumn | None:
    """Returns the status word of a part, else its status byte; None if it has neither."""
    return next((part[name] for name in STATUS if name in part), None)


def rows_of(
    column: PartColumn, sample: npt.NDArray[np.int64]
) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.intp]]:
    """Returns which samples have a row in a column, and the last row of each that has."""
    row = np.searchsorted(column.sample, sample, side="right") - 1
    is_known = row >= 0
    is_known[is_known] = column.sample[row[is_known]] == sample[is_known]
    return is_known, row[is_known]


def known_time(part: Part) -> npt.NDArray[np.float64]:
    """Returns the time stamp of each sample in s; NaN without one.

    Without a fix, those of the GNSS receiver are arbitrary and count as unknown.
    """
    time = part.time.copy()
    for key in part:
        column = part[key]
        if column.name in RECEIVER:
            time[column.sample - part.first_sample] = np.nan
    if "gnss_pvt_data" in part:
        column = part["gnss_pvt_data"]
        fixed = column.sample[has_fix(column.values)] - part.first_sample
        time[fixed] = part.time[fixed]
    return time
