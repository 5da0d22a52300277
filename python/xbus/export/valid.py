"""Which positions and times of a log are valid."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from xbus.export.part import Part
from xbus.protocol.tables import RECEIVER

__all__ = ["FIXES", "has_fix", "has_position", "known_time"]

#: Fix types of the receiver with a position (Table 25): 2D, 3D, GNSS and dead reckoning. 1 is dead reckoning
#: alone.
FIXES = (2, 3, 4)


def has_fix(rows: npt.NDArray[Any]) -> npt.NDArray[np.bool_]:
    """Returns which rows of ``gnss_pvt_data`` have a position that the receiver marks as valid, ``(N,)``."""
    fixed: npt.NDArray[np.bool_] = np.isin(rows["fixtype"], FIXES) & (rows["flags"] & 1 == 1)
    return fixed


def has_position(lat_lon: npt.NDArray[Any]) -> npt.NDArray[np.bool_]:
    """Returns which rows of ``lat_lon`` are a position, ``(N,)``. A filter without one reports zero."""
    valid = (np.abs(lat_lon) <= (90.0, 360.0)).all(axis=1)
    position: npt.NDArray[np.bool_] = valid & (lat_lon != 0).any(axis=1)
    return position


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
