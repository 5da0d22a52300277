"""The attitude of a device, from any orientation output."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from xbus.geometry.quaternion import from_euler, to_matrix

__all__ = ["NAMED", "ORIENTATIONS", "POINTS", "Attitude", "attitude_of", "axes_of"]

#: Quantities that hold an orientation, the preferred one first.
ORIENTATIONS = ("quaternion", "rotation_matrix", "euler_angles")
#: Names on the compass, clockwise from north.
POINTS = ("N", "NE", "E", "SE", "S", "SW", "W", "NW")
#: Degrees between two names.
NAMED = 45


class Attitude(NamedTuple):
    """The attitude of a device in degrees; the same for ENU, NED and NWU.

    Attributes:
        heading: Direction of its x axis, clockwise from local north, 0 to 360.
        pitch: Elevation of its x axis, -90 to 90.
        roll: Rotation about its x axis, positive with the right side (-y) down, -180 to 180.
    """

    heading: float
    pitch: float
    roll: float

    @property
    def point(self) -> str:
        """The nearest point of the compass."""
        return POINTS[round(self.heading / NAMED) % len(POINTS)]


def attitude_of(name: str, coordinates: str | None, row: Any) -> Attitude | None:
    """Returns the attitude that a row of a column describes; None if it is not an orientation.

    Args:
        name: One of `ORIENTATIONS`.
        coordinates: ``"ENU"``, ``"NED"`` or ``"NWU"``.
        row: ``(4,)``, ``(3, 3)`` or ``(3,)``.

    >>> attitude_of("euler_angles", "ENU", [10, 5, 60])
    Attitude(heading=30.0, pitch=-5.0, roll=10.0)
    >>> attitude_of("quaternion", "NED", [0, 1, 0, 0])  # level, z up, pointing north
    Attitude(heading=0.0, pitch=0.0, roll=0.0)
    """
    matrix = axes_of(name, coordinates, row)
    if matrix is None:
        return None
    east, north, up = matrix.tolist()
    heading = round(math.degrees(math.atan2(east[0], north[0])), 6)
    pitch = math.degrees(math.asin(max(-1.0, min(1.0, up[0]))))
    roll = math.degrees(math.atan2(up[1], up[2]))
    # Rounding avoids -0 and 360.
    return Attitude(*(round(angle, 6) + 0.0 for angle in (heading % 360, pitch, roll)))


def axes_of(name: str, coordinates: str | None, row: Any) -> npt.NDArray[np.float64] | None:
    """Returns the axes of the sensor in east, north and up, as the columns of a matrix ``(3, 3)``.

    The arguments are those of `attitude_of`; None if the row is not an orientation.
    """
    numbers = np.ravel(row).tolist()
    if not all(map(math.isfinite, numbers)):
        return None
    values = np.array(numbers)
    if name == "quaternion":
        if not (length := math.hypot(*numbers)):
            return None
        matrix = to_matrix(values / length)
    else:
        matrix = (
            values.reshape(3, 3) if name == "rotation_matrix" else to_matrix(from_euler(values))
        )
    if coordinates == "NED":
        return matrix[[1, 0, 2]] * [[1], [1], [-1]]
    if coordinates == "NWU":
        return matrix[[1, 0, 2]] * [[-1], [1], [1]]
    return matrix
