"""Which way a device points: what its orientation says, whatever the form and coordinates it came in."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

__all__ = ["FORMS", "Attitude", "attitude", "ground", "tape"]

#: Quantities that tell it, the best first.
FORMS = ("quaternion", "rotation_matrix", "euler_angles")
#: Degrees from the lower to the upper edge of the picture, and degrees in a column of the compass.
HEIGHT, COLUMN = 60.0, 5.0
#: What is written on the compass, from north by the right.
POINTS = ("N", "NE", "E", "SE", "S", "SW", "W", "NW")
#: Degrees between two names, and between two marks.
NAMED, MARKED = 45, 15

Matrix = Sequence[Sequence[float]]


class Attitude(NamedTuple):
    """Which way a device points, in degrees; the same for ENU, NED and NWU.

    Attributes:
        heading: Where its x axis points, from north by the right, 0 to 360: the local north of the device.
        pitch: How far its x axis points up, -90 to 90.
        roll: How far its right side (-y) is down, -180 to 180.
    """

    heading: float
    pitch: float
    roll: float

    @property
    def point(self) -> str:
        """The point of the compass next to the heading."""
        return POINTS[round(self.heading / NAMED) % len(POINTS)]


def attitude(name: str, coordinates: str | None, row: Any) -> Attitude | None:
    """What a row of a column says; None where it is no orientation.

    Args:
        name: One of `FORMS`.
        coordinates: ``"ENU"``, ``"NED"`` or ``"NWU"``.
        row: ``(4,)``, ``(3, 3)`` or ``(3,)``.

    >>> attitude("euler_angles", "ENU", [10, 5, 60])
    Attitude(heading=30.0, pitch=-5.0, roll=10.0)
    >>> attitude("quaternion", "NED", [0, 1, 0, 0])  # lies flat and points north: z is up, and NED's down
    Attitude(heading=0.0, pitch=0.0, roll=0.0)
    """
    matrix = _MATRIX[name](np.ravel(row).tolist())
    if matrix is None or not all(math.isfinite(it) for line in matrix for it in line):
        return None
    # East, north and up of the sensor's axes: rows of the matrix, or their opposites.
    east, north, up = {
        "NED": (matrix[1], matrix[0], _opposite(matrix[2])),
        "NWU": (_opposite(matrix[1]), matrix[0], matrix[2]),
    }.get(coordinates or "ENU", tuple(matrix))
    heading = round(math.degrees(math.atan2(east[0], north[0])), 6)
    pitch = math.degrees(math.asin(max(-1.0, min(1.0, up[0]))))
    roll = math.degrees(math.atan2(up[1], up[2]))
    # What rounding leaves of nothing would be shown as -0, or as 360.
    return Attitude(*(round(it, 6) + 0.0 for it in (heading % 360, pitch, roll)))


def ground(shown: Attitude, columns: int, rows: int) -> list[list[bool]]:
    """The picture: what somebody sees who looks along the x axis. True is ground.

    Args:
        shown: Which way it points.
        columns: Width of the picture, in pixels that are as wide as high.
        rows: Its height; the middle of the picture is the direction of the axis.
    """
    step = HEIGHT / rows
    roll = math.radians(shown.roll)
    right, up = -math.sin(roll) * step, math.cos(roll) * step
    return [
        [
            shown.pitch + right * (column - (columns - 1) / 2) + up * ((rows - 1) / 2 - row) < 0
            for column in range(columns)
        ]
        for row in range(rows)
    ]


def tape(heading: float, columns: int, mark: str) -> str:
    """A compass of so many columns; the one in the middle is the heading."""
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


def _of_quaternion(row: Sequence[float]) -> Matrix | None:
    length = math.hypot(*row)
    if not length > 0:
        return None
    w, x, y, z = (it / length for it in row)
    return (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )


def _of_matrix(row: Sequence[float]) -> Matrix:
    return row[0:3], row[3:6], row[6:9]


def _of_angles(row: Sequence[float]) -> Matrix | None:
    if not all(map(math.isfinite, row)):
        return None
    (sr, cr), (sp, cp), (sy, cy) = (
        (math.sin(math.radians(it)), math.cos(math.radians(it))) for it in row
    )
    return (
        (cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr),
        (sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr),
        (-sp, cp * sr, cp * cr),
    )


def _opposite(line: Sequence[float]) -> Sequence[float]:
    return [-it for it in line]


_MATRIX = {
    "quaternion": _of_quaternion,
    "rotation_matrix": _of_matrix,
    "euler_angles": _of_angles,
}
