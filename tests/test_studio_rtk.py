"""The mountpoints of a caster in the studio."""

from __future__ import annotations

import pytest

pytest.importorskip("nicegui", reason="the extra studio is not installed")

from xbus.rtk import Mountpoint, Position
from xbus.studio.pages.mountpoints import nearest_first


def point(name: str, lat: float | None, lon: float | None) -> Mountpoint:
    return Mountpoint(name, "", "RTCM 3.2", "", "GPS", "NLD", lat, lon, needs_position=False)


def test_the_nearest_mountpoint_is_the_first() -> None:
    """At 52 degrees north, a degree of latitude is 111.28 km, and one of longitude 68.68 km."""
    points = [
        point("network", 0.0, 0.0),
        point("north", 53.0, 5.0),
        point("unknown", None, None),
        point("east", 52.0, 6.0),
        point("here", 52.0, 5.0),
    ]
    found = nearest_first(points, Position(52.0, 5.0, 0.0))
    assert [each.name for each, _ in found] == ["here", "east", "north", "network", "unknown"]
    distances = [far for _, far in found]
    assert distances[:3] == pytest.approx([0, 68_677, 111_275], abs=1)
    assert distances[3:] == [None, None]


def test_without_a_position_the_order_is_that_of_the_caster() -> None:
    points = [point("b", 1.0, 1.0), point("a", 2.0, 2.0)]
    assert nearest_first(points, None) == [(points[0], None), (points[1], None)]
