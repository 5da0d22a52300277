"""GeoJSON (RFC 7946): tracks as lines, for web maps."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from xbus.export.positions import POINT, UNKNOWN, Points, extra_texts
from xbus.export.text import shortest, utc_text
from xbus.export.track import TrackFormat, TrackText

__all__ = ["GeoJson"]

#: The convention of several programs for times, which RFC 7946 does not define.
TIMES = "coordTimes"
#: The values that are text.
TEXTS = (TIMES, "fix")


class _GeoJsonText(TrackText):
    """A feature for each segment, and another one where it crosses the antimeridian.

    The values of points follow their places, so they wait aside.
    """

    separator = b",\n"
    #: Segments, and features that are complete.
    _segments = _features = 0
    #: Places in the present feature.
    _places = 0
    #: The last point, as an array of one.
    _last = np.empty(0, POINT)

    def write(self, points: Points, *, is_start: bool) -> None:
        if is_start:
            self._end_feature()
            self._segments += 1
            self._last = self._last[:0]
        joined = np.concatenate([self._last, points])
        first = len(self._last)
        for crossing in (np.flatnonzero(np.abs(np.diff(joined["lon"])) > 180) + 1).tolist():
            before, after = _at_antimeridian(joined[crossing - 1], joined[crossing])
            self._write(np.append(joined[first:crossing], before))
            self._end_feature()
            self._write(np.array([after]))
            first = crossing
        self._write(joined[first:])
        self._last = joined[-1:]

    def _write(self, points: Points) -> None:
        if not self._places:
            separator = self.separator if self._features else b""
            self._out.write(separator + b'{"type":"Feature","geometry":{"coordinates":[')
        heights = [text and "," + text for text in shortest(points["ellipsoid"])]
        fields = zip(shortest(points["lon"]), shortest(points["lat"]), heights, strict=True)
        self._out.write(self._joined(map("[%s,%s%s]".__mod__, fields)))
        for name in (TIMES, *self._extras):
            texts = utc_text(points["time"]) if name == TIMES else extra_texts(name, points)
            quote = '"' if name in TEXTS else ""
            values = (f"{quote}{text}{quote}" if text else "null" for text in texts)
            self._aside(name).write(self._joined(values))
        self._places += len(points)

    def _joined(self, texts: Iterable[str]) -> bytes:
        """Returns the next elements of an array."""
        return ("," * (self._places > 0) + ",".join(texts)).encode()

    def _end_feature(self) -> None:
        if not self._places:
            return
        # A line has two places or more.
        kind = "LineString" if self._places > 1 else "MultiPoint"
        head = json.dumps({"name": self._name, "segment": self._segments})
        self._out.write(f'],"type":"{kind}"}},"properties":{head[:-1]}'.encode())
        for name in (TIMES, *self._extras):
            self._out.write(f',"{name}":['.encode())
            self._copy_aside(name)
            self._out.write(b"]")
        self._out.write(b"}}")
        self._features += 1
        self._places = 0

    def close(self) -> None:
        self._end_feature()


def _at_antimeridian(before: Any, after: Any) -> tuple[Any, Any]:
    """Returns the point between two where they cross the antimeridian, once on each side of it."""
    side = 180.0 if before["lon"] > 0 else -180.0
    whole = after["lon"] + 2 * side - before["lon"]
    # No way between the two: both are on the antimeridian.
    share = (side - before["lon"]) / whole if whole else 0.0
    points = np.full(2, UNKNOWN)
    for name in ("lat", "msl", "ellipsoid"):
        points[name] = before[name] + share * (after[name] - before[name])
    step = after["time"] - before["time"]
    if not np.isnat(step):
        points["time"] = before["time"] + np.timedelta64(round(share * int(step.astype(int))), "ns")
    points["lon"] = side, -side
    return points[0], points[1]


@dataclass(frozen=True)
class GeoJson(TrackFormat):
    """A GeoJSON file with a feature for each segment of each device. See `TrackFormat` for the options.

    Heights are above the ellipsoid. A segment that crosses the antimeridian has a feature on each side of it.
    """

    title = "a GeoJSON file"
    without_msl = None
    head = b'{"type":"FeatureCollection","features":[\n'
    tail = b"\n]}\n"
    text = _GeoJsonText
