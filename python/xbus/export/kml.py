"""KML: tracks with time, for Google Earth."""

from __future__ import annotations

from dataclasses import dataclass
from html import escape
from itertools import pairwise

import numpy as np

from xbus.export.positions import Points, extra_texts
from xbus.export.text import shortest, utc_text
from xbus.export.track import TrackFormat, TrackText

__all__ = ["Kml"]

#: The values of points: name, type and what is displayed.
FIELDS = (
    ("fix", "string", "Fix"),
    ("satellites", "int", "Satellites"),
    ("accuracy", "double", "Accuracy, m"),
    ("altitude_accuracy", "double", "Accuracy of height, m"),
)


class _KmlText(TrackText):
    """A folder with a placemark for each segment.

    A `gx:Track` has all times first, then all places, then the other values: so these wait aside.
    Points without UTC cannot be in a `gx:Track` and become a line.
    """

    #: Placemarks so far, and points in the present one.
    _placemarks = _points = 0
    #: Whether its points have times.
    _is_timed = False

    def write(self, points: Points, *, is_start: bool) -> None:
        if not self._placemarks:
            self._out.write(f"<Folder>\n<name>{escape(self._name)}</name>\n".encode())
        is_timed = ~np.isnat(points["time"])
        bounds = [0, *(np.flatnonzero(np.diff(is_timed)) + 1).tolist(), len(points)]
        for first, end in pairwise(bounds):
            if (is_start and not first) or is_timed[first] != self._is_timed:
                self._end_placemark()
                self._begin_placemark(is_timed=bool(is_timed[first]))
            self._write(points[first:end])

    def _begin_placemark(self, *, is_timed: bool) -> None:
        self._placemarks += 1
        self._is_timed = is_timed
        self._out.write(f"<Placemark>\n<name>Segment {self._placemarks}</name>\n".encode())
        if is_timed:
            self._out.write(f"<gx:Track>\n{self._altitude_mode}".encode())

    @property
    def _altitude_mode(self) -> str:
        """The element for heights; "absolute" is above sea level."""
        mode = "absolute" if self._has_msl else "clampToGround"
        return f"<altitudeMode>{mode}</altitudeMode>\n"

    def _write(self, points: Points) -> None:
        self._points += len(points)
        height = points["msl"] if self._has_msl else np.full(len(points), np.nan)
        before = " " if self._is_timed else ","
        heights = [text and before + text for text in shortest(height)]
        fields = zip(shortest(points["lon"]), shortest(points["lat"]), heights, strict=True)
        place = "<gx:coord>%s %s%s</gx:coord>\n" if self._is_timed else "%s,%s%s\n"
        self._aside("places").write("".join(map(place.__mod__, fields)).encode())
        if self._is_timed:
            stamps = utc_text(points["time"])
            self._out.write("".join([f"<when>{text}</when>\n" for text in stamps]).encode())
            for name in self._extras:
                values = [f"<gx:value>{text}</gx:value>\n" for text in extra_texts(name, points)]
                self._aside(name).write("".join(values).encode())

    def _end_placemark(self) -> None:
        if not self._points:
            return
        if self._is_timed:
            self._copy_aside("places")
            self._write_values()
            self._out.write(b"</gx:Track>\n</Placemark>\n")
        else:
            # A line has two points or more.
            shape = "LineString" if self._points > 1 else "Point"
            self._out.write(f"<{shape}>\n{self._altitude_mode}<coordinates>\n".encode())
            self._copy_aside("places")
            self._out.write(f"</coordinates>\n</{shape}>\n</Placemark>\n".encode())
        self._points = 0

    def _write_values(self) -> None:
        if not self._extras:
            return
        self._out.write(b'<ExtendedData>\n<SchemaData schemaUrl="#point">\n')
        for name in self._extras:
            self._out.write(f'<gx:SimpleArrayData name="{name}">\n'.encode())
            self._copy_aside(name)
            self._out.write(b"</gx:SimpleArrayData>\n")
        self._out.write(b"</SchemaData>\n</ExtendedData>\n")

    def close(self) -> None:
        self._end_placemark()
        self._out.write(b"</Folder>\n")


@dataclass(frozen=True)
class Kml(TrackFormat):
    """A KML file with a folder for each device and a track for each segment.

    `TrackFormat` has the options. Heights are above sea level; without them, the track is on the ground.
    """

    title = "a KML file"
    without_msl = "omitted height"
    head = (
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        '<kml xmlns="http://www.opengis.net/kml/2.2" xmlns:gx="http://www.google.com/kml/ext/2.2">\n'
        '<Document>\n<Schema id="point">\n'
        + "".join(
            f'<gx:SimpleArrayField name="{name}" type="{kind}"><displayName>{title}</displayName>'
            "</gx:SimpleArrayField>\n"
            for name, kind, title in FIELDS
        )
        + "</Schema>\n"
    ).encode()
    tail = b"</Document>\n</kml>\n"
    text = _KmlText
