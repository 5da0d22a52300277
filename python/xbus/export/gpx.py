"""GPX 1.1: tracks with time, height, fix, satellites and dilutions of precision."""

from __future__ import annotations

from dataclasses import dataclass
from html import escape

import numpy as np

from xbus.export.positions import FIXES, Points
from xbus.export.text import formatted, shortest, utc_text
from xbus.export.track import TrackFormat, TrackText

__all__ = ["Gpx"]

#: The elements of a point are in the order of the schema.
POINT = '<trkpt lat="%s" lon="%s">%s%s%s%s%s%s%s%s</trkpt>\n'
#: Shown with the track if heights above sea level, which GPX readers expect, are not known.
ELLIPSOID = "<desc>Heights are above the WGS84 ellipsoid.</desc>\n"
FIX_ELEMENTS = tuple(name and f"<fix>{name}</fix>" for name in FIXES)


class _GpxText(TrackText):
    _is_open = False
    _has_segment = False

    def write(self, points: Points, *, is_start: bool) -> None:
        if not self._is_open:
            note = "" if self._has_msl else ELLIPSOID
            self._out.write(f"<trk>\n<name>{escape(self._name)}</name>\n{note}".encode())
            self._is_open = True
        if is_start:
            self._end_segment()
            self._out.write(b"<trkseg>\n")
            self._has_segment = True
        # A longitude of 180 degrees is written as -180, which is the same meridian.
        lon = np.where(points["lon"] == 180, -180.0, points["lon"])
        height = points["msl" if self._has_msl else "ellipsoid"]
        fields = (
            shortest(points["lat"]),
            shortest(lon),
            [text and f"<ele>{text}</ele>" for text in shortest(height)],
            [text and f"<time>{text}</time>" for text in utc_text(points["time"])],
            # To the tenth of a millimetre, since a difference of decimal numbers is not exact.
            formatted("<geoidheight>%.4f</geoidheight>", points["ellipsoid"] - points["msl"]),
            [FIX_ELEMENTS[fix] for fix in points["fix"].tolist()],
            formatted("<sat>%d</sat>", points["satellites"]),
            *(formatted(f"<{dop}>%.2f</{dop}>", points[dop]) for dop in ("hdop", "vdop", "pdop")),
        )
        self._out.write("".join(map(POINT.__mod__, zip(*fields, strict=True))).encode())

    def _end_segment(self) -> None:
        if self._has_segment:
            self._out.write(b"</trkseg>\n")

    def close(self) -> None:
        self._end_segment()
        self._out.write(b"</trk>\n")


@dataclass(frozen=True)
class Gpx(TrackFormat):
    """A GPX file with a track for each device. See `TrackFormat` for the options.

    ``ele`` is the height above sea level. If the log has none, it is the height above the ellipsoid, and the
    description of the track says so. ``geoidheight`` is the difference, where both are known.
    """

    title = "a GPX file"
    without_msl = "ellipsoid height"
    head = (
        b'<?xml version="1.0" encoding="UTF-8"?>\n'
        b'<gpx version="1.1" creator="xbus" xmlns="http://www.topografix.com/GPX/1/1">\n'
    )
    tail = b"</gpx>\n"
    text = _GpxText
