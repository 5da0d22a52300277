"""A track on a base map: a plot in the pixels of Web Mercator, with tiles that a browser loads."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from xbus.export.palette import COLOURS
from xbus.plots.thin import FloatArray
from xbus.report.track import Track

__all__ = ["ATTRIBUTION", "SERVER", "base_map"]

#: Where the tiles come from. The server needs no key, and no Referer, which a page from a file does not send;
#: those of OpenStreetMap do.
SERVER = "https://basemaps.cartocdn.com"
TILES = SERVER + "/rastertiles/voyager/{z}/{x}/{y}.png"
ATTRIBUTION = "© OpenStreetMap contributors, © CARTO"
#: Side of a tile in pixels, and the largest zoom.
TILE, DEEPEST = 256, 18
#: Size of the map in pixels of its zoom: the track is no larger than this, and the tiles cover this.
TRACK, WIDTH, HEIGHT = 420.0, 1240.0, 520.0
#: The northern end of the map.
NORTH = 85.0511


def base_map(tracks: dict[str, Track]) -> dict[str, Any]:
    """Returns tracks on a map.

    Args:
        tracks: At least one, with positions; the best first.
    """
    places = {name: mercator(*track.degrees) for name, track in tracks.items()}
    x, y = next(iter(places.values()))
    centre = (x.min() + x.max()) / 2, (y.min() + y.max()) / 2
    span = max(float(np.ptp(x)), float(np.ptp(y)), 1e-12)
    zoom = int(np.clip(np.floor(np.log2(TRACK / TILE / span)), 0, DEEPEST))
    scale = TILE * 2.0**zoom
    traces = []
    for at, (name, (x, y)) in reversed(list(enumerate(places.items()))):
        gaps = np.flatnonzero(np.diff(tracks[name].piece)) + 1
        columns = ((x - centre[0]) * scale, (centre[1] - y) * scale, tracks[name].time)
        x, y, time = (np.insert(column, gaps, np.nan) for column in columns)
        line = {"color": COLOURS[at % len(COLOURS)], "width": 3}
        trace = {"type": "scatter", "mode": "lines", "x": x, "y": y, "name": name, "line": line}
        traces.append({**trace, "customdata": time, "hovertemplate": "%{customdata:.2f} s"})
    axis: dict[str, Any] = {"showticklabels": False, "showgrid": False, "zeroline": False}
    axis |= {"ticks": "", "showline": False}
    layout = {
        "xaxis": {**axis, "range": [-WIDTH / 2, WIDTH / 2], "constrain": "domain"},
        "yaxis": {**axis, "range": [-HEIGHT / 2, HEIGHT / 2], "scaleanchor": "x"},
        "images": list(_tiles(centre, zoom)),
        "height": HEIGHT + 80,
    }
    return {"name": "map", "is_over_time": False, "data": traces, "layout": layout}


def mercator(lat: FloatArray, lon: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Returns positions on the map, from 0 in the west to 1 in the east, and from 0 in the north to 1.

    >>> import numpy as np
    >>> [float(x) for x in mercator(np.array(0.0), np.array(0.0))]
    [0.5, 0.5]
    """
    angle = np.radians(np.clip(lat, -NORTH, NORTH))
    return ((lon + 180) / 360) % 1.0, (1 - np.arcsinh(np.tan(angle)) / np.pi) / 2


def _tiles(centre: tuple[float, float], zoom: int) -> Iterator[dict[str, Any]]:
    """Yields the tiles around a place of the map."""
    number = 2**zoom
    at = [place * number for place in centre]
    size = [length / 2 / TILE for length in (WIDTH, HEIGHT)]
    across, down = (
        range(int(np.floor(place - half)), int(np.floor(place + half)) + 1)
        for place, half in zip(at, size, strict=True)
    )
    for column in across:
        for row in down:
            if 0 <= row < number:
                yield {
                    "source": TILES.format(z=zoom, x=column % number, y=row),
                    "xref": "x",
                    "yref": "y",
                    "x": (column - at[0]) * TILE,
                    "y": (at[1] - row) * TILE,
                    "sizex": TILE,
                    "sizey": TILE,
                    "sizing": "stretch",
                    "layer": "below",
                }
