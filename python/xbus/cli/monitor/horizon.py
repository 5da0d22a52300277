"""Pictures of an attitude: horizon and compass."""

from __future__ import annotations

import math

from xbus.watch.attitude import NAMED, POINTS, Attitude

__all__ = ["compass", "horizon"]

#: Field of view of the horizon, from its lower to its upper edge, and of a column of the compass, in degrees.
VIEW, COLUMN = 60.0, 5.0
#: Degrees between two marks on the compass.
MARKED = 15


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
