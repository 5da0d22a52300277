"""Parts of pages that draw live data in the browser."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from nicegui import ui
from nicegui.element import Element

from xbus.studio.history import Series

__all__ = ["Attitude3D", "Chart", "CursorTable", "Horizon", "KeyPress", "Keys", "Map"]


class Chart(Element, component="static/chart.js"):
    """Curves of one series over time.

    Args:
        source: Port of the device.
        series: The series.
        span: Seconds to show.
        on_zoom: Called with begin and end when the user chooses a part of the time.
        on_place: Called with the time where the user clicks on a paused plot.
    """

    def __init__(
        self,
        source: str,
        series: Series,
        span: float,
        on_zoom: Callable[[float, float], Any],
        on_place: Callable[[float], Any],
    ) -> None:
        super().__init__()
        self.props["source"], self.props["name"], self.props["unit"] = (
            source,
            series.name,
            series.unit,
        )
        self.props["fields"], self.props["span"] = list(series.fields), span
        self.props["view"], self.props["locked"] = None, False
        self.props["cursors"], self.props["active"] = {}, None
        self.on("zoom", lambda event: on_zoom(event.args["begin"], event.args["end"]))
        self.on("place", lambda event: on_place(event.args["time"]))

    def show(self, **props: Any) -> None:
        """Changes what is shown.

        Args:
            props: ``span``, ``view`` (begin and end, or None for live), ``locked``, ``cursors`` (times by
                name) and ``active``, the cursor that moves.
        """
        self.props.update(props)
        self.update()


@dataclass(frozen=True)
class KeyPress:
    """A key that was pressed.

    Attributes:
        key: Its name, as in JavaScript; letters are small.
        shift: Whether it was pressed with Shift.
        time: Seconds since 1970 below the mouse; None if that is on no plot.
        columns: Width of a plot in pixels.
    """

    key: str
    shift: bool
    time: float | None
    columns: int


class Keys(Element, component="static/keys.js"):
    """Keys of a page; typing in a field is left alone.

    Args:
        keys: Their names, as in JavaScript; letters are small.
        on_key: Called when one is pressed.
    """

    def __init__(self, keys: Iterable[str], on_key: Callable[[KeyPress], Any]) -> None:
        super().__init__()
        self.props["keys"] = list(keys)
        self.on("key", lambda event: on_key(KeyPress(**event.args)))


class CursorTable(Element, component="static/selection.js"):
    """A table of what is at two cursors and between them."""

    def __init__(self) -> None:
        super().__init__()
        self.show(cursors=[], apart="", heads=[], groups=[])

    def show(self, **props: Any) -> None:
        """Changes ``cursors``, ``apart``, ``heads`` or ``groups``."""
        self.props.update(props)
        self.update()


class Map(Element, component="static/map.js"):
    """The track of a device, in metres east and north of its first position.

    Args:
        source: Port of the device.
        name: Name of the series of the track.
        span: Seconds to show.
    """

    def __init__(self, source: str, name: str, span: float) -> None:
        super().__init__()
        self.show(source=source, name=name, span=span, marks={}, label="no position")

    def show(self, **props: Any) -> None:
        """Changes ``span``, ``accuracy`` (m or None), ``stale``, ``marks`` (east and north) or ``label``."""
        if any(self.props.get(name) != value for name, value in props.items()):
            self.props.update(props)
            self.update()


class Horizon(Element, component="static/horizon.js"):
    """An artificial horizon with heading.

    Args:
        source: Port of the device.
    """

    def __init__(self, source: str) -> None:
        super().__init__()
        self.props["source"] = source


class Attitude3D:
    """The device as a box with its axes, seen from the south-east, in a world of east, north and up."""

    #: Length, width and height of the box, and colours of the axes x, y and z.
    SIZE = (1.6, 1.1, 0.45)
    COLORS = ("#D55E00", "#009E73", "#0072B2")

    def __init__(self) -> None:
        with ui.scene(
            width=400, height=260, grid=(6, 6), background_color="#20242a", fps=15
        ) as scene:
            scene.classes("w-full rounded")
            with scene.group() as self._body:
                scene.box(*self.SIZE).material("#8fa3b8", opacity=0.9)
                for axis, color in enumerate(self.COLORS):
                    end = [0.0, 0.0, 0.0]
                    end[axis] = 1.6
                    scene.line([0, 0, 0], end).material(color)
                    scene.text("xyz"[axis], style=f"color: {color}; font-weight: 700").move(*end)
            for name, place in {"E": (2.4, 0, 0), "N": (0, 2.4, 0), "U": (0, 0, 1.9)}.items():
                scene.text(name, style="color: #aab").move(*place)
            scene.move_camera(2.6, -3.4, 2.2, 0, 0, 0, duration=0)

    def turn(self, axes: npt.NDArray[np.float64]) -> None:
        """Turns the box: the axes of the device in east, north and up, as columns ``(3, 3)``."""
        self._body.rotate_R(axes.tolist())
