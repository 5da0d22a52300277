"""A plot over time, whatever draws it: its curves, and the horizontal axis."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from xbus.export.palette import Style, style_of
from xbus.plots.thin import Curve, FloatArray

__all__ = ["Line", "Plot", "TimeAxis"]


class TimeAxis(NamedTuple):
    """The horizontal axis.

    Attributes:
        label: What it shows, with its unit.
        origin: UTC at position 0, or None for an axis of numbers.
    """

    label: str
    origin: np.datetime64 | None = None

    def stamps(self, positions: FloatArray) -> npt.NDArray[Any]:
        """Returns positions in s as UTC, ``datetime64[ns]``, or as they are if the axis has numbers."""
        if self.origin is None:
            return positions
        # A gap has no position; plots break lines where there is no value.
        known = np.maximum.accumulate(
            np.where(np.isfinite(positions), np.arange(len(positions)), 0)
        )
        return self.origin + np.rint(positions[known] * 1e9).astype("timedelta64[ns]")


class Line(NamedTuple):
    """The points of one curve.

    Attributes:
        name: Name of the curve.
        style: How it is drawn.
        time, values: The points, with NaN between two pieces of the line.
        dots: The points without a line to a neighbour, as times and values.
    """

    name: str
    style: Style
    time: npt.NDArray[Any]
    values: npt.NDArray[Any]
    dots: tuple[npt.NDArray[Any], npt.NDArray[Any]]

    @property
    def is_dots(self) -> bool:
        """Whether no point has a line to a neighbour."""
        return 0 < len(self.dots[0]) == np.count_nonzero(np.isfinite(self.values))


@dataclass(frozen=True)
class Plot:
    """The curves of one panel.

    Attributes:
        label: Text at the vertical axis, with the unit, in one or two lines.
        curves: The curves by name, for each device or other source by its name, which is empty for the only
            one.
    """

    label: str
    curves: dict[str, dict[str, Curve]] = field(default_factory=dict)

    def lines(self, axis: TimeAxis) -> Iterator[Line]:
        """Yields the curves."""
        number = 0
        for device, curves in self.curves.items():
            for name, curve in curves.items():
                full = ", ".join(filter(None, (name, device)))
                yield _line(full, style_of(number), curve, axis)
                number += 1

    @property
    def has_names(self) -> bool:
        """Whether there is more than one curve."""
        return sum(map(len, self.curves.values())) > 1


def _line(name: str, style: Style, curve: Curve, axis: TimeAxis) -> Line:
    time, values = curve.line()
    alone = curve.isolated()
    return Line(
        name,
        style,
        axis.stamps(time),
        values,
        (axis.stamps(curve.time[alone]), curve.values[alone]),
    )
