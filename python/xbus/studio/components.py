"""Parts of pages that draw live data in the browser."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
from nicegui import ui
from nicegui.element import Element

from xbus.studio.history import Series

__all__ = ["Attitude3D", "Chart", "Horizon"]


class Chart(Element, component="static/chart.js"):
    """Curves of one series over time.

    Args:
        source: Port of the device.
        series: The series.
        span: Seconds to show.
        on_zoom: Called with begin and end when the user chooses a part of the time.
    """

    def __init__(
        self, source: str, series: Series, span: float, on_zoom: Callable[[float, float], Any]
    ) -> None:
        super().__init__()
        self.props["source"], self.props["name"], self.props["unit"] = (
            source,
            series.name,
            series.unit,
        )
        self.props["fields"], self.props["span"] = list(series.fields), span
        self.props["view"], self.props["locked"] = None, False
        self.on("zoom", lambda event: on_zoom(event.args["begin"], event.args["end"]))

    def show(self, **props: Any) -> None:
        """Changes ``span``, ``view`` (begin and end, or None for live) or ``locked``."""
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
