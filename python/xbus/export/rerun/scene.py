"""What a viewer shows beside the numbers: axes, the body of a device, and the layout of its views."""

from __future__ import annotations

from typing import Any

from xbus.export.palette import COLOURS
from xbus.export.rerun.times import TIMELINES

__all__ = ["Scene"]

#: For each coordinate system the names of its axes, and its rotation to ENU as a quaternion x, y, z, w.
FRAMES = {
    "ENU": (("east", "north", "up"), (0.0, 0.0, 0.0, 1.0)),
    "NED": (("north", "east", "down"), (0.5**0.5, 0.5**0.5, 0.0, 0.0)),
    "NWU": (("north", "west", "up"), (0.0, 0.0, 0.5**0.5, 0.5**0.5)),
}
#: Half of the size of the body of a device in units of the scene, and its colour.
BODY, BODY_COLOR = (0.57, 0.42, 0.24), (120, 120, 120)
#: Length and colour of the axes of a coordinate system.
AXIS, AXIS_COLOR = 1.5, (160, 160, 160)
#: Where the scene is seen from.
EYE = (1.5, -4.0, 2.5)
#: Distance between devices in the scene.
SPACING = 4.0


class Scene:
    """The entities of a recording that are logged once, and the layout that follows from them.

    The axes of the scene are east, north and up. An orientation in other coordinates stays as it was
    recorded, and these coordinates are rotated.

    Args:
        rr: The module ``rerun``.
        recording: The recording stream.
    """

    def __init__(self, rr: Any, recording: Any) -> None:
        self._rr, self._recording = rr, recording
        self._known: set[str] = set()
        #: The entities in each plot, by its title, for each device.
        self._plots: dict[str, dict[str, list[str]]] = {}
        self._has_body = False
        #: The entities on the map.
        self._positions: list[str] = []
        #: Whether something was added since the layout was sent.
        self.has_changed = False
        recording.log("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)

    def add_device(self, path: str) -> None:
        """Adds a device. Devices stand side by side."""
        place = len(self._plots) * SPACING
        self._plots[path] = {}
        self._recording.log(path, self._rr.Transform3D(translation=(place, 0.0, 0.0)), static=True)

    def add_series(self, device: str, title: str, path: str, names: list[str]) -> None:
        """Adds lines to a plot.

        Args:
            device: Path of the device.
            title: Title of the plot.
            path: Path of the numbers.
            names: Name of each line.
        """
        if self._is_new(path):
            plot = self._plots[device].setdefault(title, [])
            # A plot has one entity with several lines, or several with one.
            colors = [
                _rgb(COLOURS[(len(plot) + number) % len(COLOURS)]) for number in range(len(names))
            ]
            self._recording.log(path, self._rr.SeriesLines(names=names, colors=colors), static=True)
            plot.append(path)

    def add_body(self, path: str, coordinates: str) -> str:
        """Adds the body of a device in a coordinate system, and returns the path of its orientation."""
        rr, frame = self._rr, f"{path}/{coordinates}"
        body = f"{frame}/sensor"
        if self._is_new(body):
            axes, rotation = FRAMES[coordinates]
            self._recording.log(frame, rr.Transform3D(quaternion=rotation), static=True)
            vectors = [(AXIS, 0, 0), (0, AXIS, 0), (0, 0, AXIS)]
            arrows = rr.Arrows3D(vectors=vectors, labels=axes, colors=[AXIS_COLOR] * 3)
            self._recording.log(f"{frame}/axes", arrows, static=True)
            box = rr.Boxes3D(half_sizes=[BODY], colors=[BODY_COLOR])
            self._recording.log(body, box, rr.TransformAxes3D(1.0), static=True)
            self._has_body = True
        return body

    def add_map(self, path: str) -> None:
        """Adds positions to the map."""
        if self._is_new(path):
            self._positions.append(path)

    def _is_new(self, path: str) -> bool:
        is_new = path not in self._known
        self._known.add(path)
        self.has_changed |= is_new
        return is_new

    def send_layout(self) -> None:
        """Sends the layout to the viewer: attitude, map and events on the left, series on the right."""
        rrb = self._rr.blueprint
        self.has_changed = False
        left = [rrb.TextLogView(name="events")]
        if self._positions:
            edge = rrb.TimeRangeBoundary.infinite()
            always = rrb.VisibleTimeRanges(
                [
                    rrb.VisibleTimeRange(name, start=edge, end=edge)
                    for name in ("sample", *TIMELINES)
                ]
            )
            overrides = dict.fromkeys(self._positions, always)
            left.insert(0, rrb.MapView(name="map", overrides=overrides))
        if self._has_body:
            eye = rrb.EyeControls3D(position=EYE, look_target=(0.0, 0.0, 0.0))
            left.insert(0, rrb.Spatial3DView(name="attitude (east, north, up)", eye_controls=eye))
        series = [
            rrb.Grid(
                *(
                    rrb.TimeSeriesView(name=title, origin=device, contents=paths)
                    for title, paths in plots.items()
                ),
                name=device,
            )
            for device, plots in self._plots.items()
            if plots
        ]
        views = [rrb.Vertical(*left), *([rrb.Tabs(*series)] if series else [])]
        layout = rrb.Blueprint(rrb.Horizontal(*views), collapse_panels=True)
        self._recording.send_blueprint(layout)


def _rgb(colour: str) -> tuple[int, ...]:
    """Returns red, green and blue of a colour such as ``"#d55e00"``."""
    return tuple(bytes.fromhex(colour[1:]))
