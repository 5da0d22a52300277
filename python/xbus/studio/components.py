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

__all__ = ["BLUR", "Attitude3D", "Chart", "CursorTable", "Horizon", "KeyPress", "Keys", "Map"]

#: For the end of a choice from a list, which takes letters for itself: keys are for the page again.
BLUR = "() => document.activeElement.blur()"


def _show(element: Element, props: dict[str, Any]) -> None:
    """Changes the properties of an element, if they differ."""
    if any(element.props.get(name) != value for name, value in props.items()):
        element.props.update(props)
        element.update()


class Chart(Element, component="static/chart.js"):
    """Curves of one series over time.

    Args:
        source: Port of the device.
        series: The series.
        title: Its name on the page.
        limits: The limits of the y axis if it is locked; None to take the present ones then.
        on_zoom: Called with begin and end when the user chooses a part of the time.
        on_place: Called with the time where the user clicks on a paused plot.
        on_lock: Called with the limits of the y axis that are kept from now on.
    """

    def __init__(
        self,
        source: str,
        series: Series,
        title: str,
        limits: tuple[float, float] | None,
        *,
        on_zoom: Callable[[float, float], Any],
        on_place: Callable[[float], Any],
        on_lock: Callable[[float, float], Any],
    ) -> None:
        super().__init__()
        label = f"{title} [{series.unit}]" if series.unit else title
        self.props["source"], self.props["name"], self.props["label"] = source, series.name, label
        self.props["fields"] = list(series.fields)
        self.props["limits"] = None if limits is None else list(limits)
        self.on("zoom", lambda event: on_zoom(event.args["begin"], event.args["end"]))
        self.on("place", lambda event: on_place(event.args["time"]))
        self.on("lock", lambda event: on_lock(event.args["min"], event.args["max"]))

    def show(self, **props: Any) -> None:
        """Changes what is shown.

        Args:
            props: ``span``; ``view`` (begin and end, or None for live); ``held`` (number of the samples that
                a paused plot shows, or None); ``locked``; ``cursors`` (times by name); ``active``, the cursor
                that moves; ``elapsed`` (whether times are those of a recording); ``speed``, with which live
                curves move on.
        """
        _show(self, props)


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
        self.show(cursors=[], apart="", heads=[], groups=[], elapsed=False)

    def show(self, **props: Any) -> None:
        """Changes ``cursors``, ``apart``, ``heads``, ``groups`` or ``elapsed``, as for `Chart`."""
        _show(self, props)


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
        _show(self, props)


class Horizon(Element, component="static/horizon.js"):
    """An artificial horizon with heading.

    Args:
        source: Port of the device.
    """

    def __init__(self, source: str) -> None:
        super().__init__()
        self.show(source=source, ended=False)

    def show(self, **props: Any) -> None:
        """Changes ``ended``: whether no attitude is expected, as at the end of a recording."""
        _show(self, props)


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
