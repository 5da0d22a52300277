"""The attitude of a device, from any orientation output, and the pictures of it: horizon and compass."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from xbus.geometry.quaternion import from_euler, to_matrix

__all__ = ["ORIENTATIONS", "Attitude", "attitude_of", "compass", "horizon"]

#: Quantities that hold an orientation, the preferred one first.
ORIENTATIONS = ("quaternion", "rotation_matrix", "euler_angles")
#: Field of view of the horizon, from its lower to its upper edge, and of a column of the compass, in degrees.
VIEW, COLUMN = 60.0, 5.0
#: Names on the compass, clockwise from north.
POINTS = ("N", "NE", "E", "SE", "S", "SW", "W", "NW")
#: Degrees between two names, and between two marks.
NAMED, MARKED = 45, 15


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
    # The axes of the sensor in east, north and up.
    if coordinates == "NED":
        matrix = matrix[[1, 0, 2]] * [[1], [1], [-1]]
    elif coordinates == "NWU":
        matrix = matrix[[1, 0, 2]] * [[-1], [1], [1]]
    east, north, up = matrix.tolist()
    heading = round(math.degrees(math.atan2(east[0], north[0])), 6)
    pitch = math.degrees(math.asin(max(-1.0, min(1.0, up[0]))))
    roll = math.degrees(math.atan2(up[1], up[2]))
    # Rounding avoids -0 and 360.
    return Attitude(*(round(angle, 6) + 0.0 for angle in (heading % 360, pitch, roll)))


def horizon(attitude: Attitude, columns: int, rows: int) -> list[list[bool]]:
    """Returns the picture of an artificial horizon, looking along the x axis. True is ground.

    Args:
        attitude: Attitude of the device.
        columns: Width of the picture in square pixels.
        rows: Height of the picture; its middle is the direction of the x axis.
    """
    step = VIEW / rows
    roll = math.radians(attitude.roll)
    right, up = -math.sin(roll) * step, math.cos(roll) * step
    return [
        [
            attitude.pitch + right * (column - (columns - 1) / 2) + up * ((rows - 1) / 2 - row) < 0
            for column in range(columns)
        ]
        for row in range(rows)
    ]


def compass(heading: float, columns: int, mark: str) -> str:
    """Returns a compass strip; its middle column is the heading."""
    middle = columns // 2
    cells = [" "] * columns
    begin = math.ceil((heading - COLUMN * (middle + 1)) / MARKED) * MARKED
    end = heading + COLUMN * (middle + 1)
    for degrees in range(begin, math.floor(end) + 1, MARKED):
        at = middle + round((degrees - heading) / COLUMN)
        name = POINTS[degrees // NAMED % len(POINTS)] if degrees % NAMED == 0 else mark
        for place, letter in enumerate(name, at):
            if 0 <= place < columns:
                cells[place] = letter
    return "".join(cells)
