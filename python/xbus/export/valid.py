"""Which positions of a log are valid."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = ["FIXES", "has_fix", "has_position"]

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
