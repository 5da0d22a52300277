"""The positions of samples on the axis of plots."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import numpy.typing as npt
import pytest

import xbus
from conftest import counter, fine
from streams import frame, mtdata2, packet
from xbus.log.axis import Axis
from xbus.log.runs import Runs

PVT = packet(0x7010, bytes(94))
WAKEUP = frame(0x3E)


def at(ticks: int, *more: bytes, bid: int = 0xFF) -> bytes:
    return mtdata2(fine(ticks), *more, bid=bid)


def places(*parts: bytes) -> tuple[Axis, npt.NDArray[np.float64]]:
    return place(map(xbus.read_log, parts))


def place(logs: Iterable[xbus.Log]) -> tuple[Axis, npt.NDArray[np.float64]]:
    axis, runs = Axis(), Runs()
    return axis, np.concatenate([axis.positions(log.core, runs.add(log.core).run) for log in logs])


#: Samples, the kind of axis, and the expected positions.
TABLE = {
    "time": (at(70_000) + at(70_100) + at(70_200), "time", [0, 0.01, 0.02]),
    "a sample without a stamp": (
        at(0) + mtdata2(counter(1)) + at(200),
        "time",
        [0, 0.01, 0.02],
    ),
    "a device that begins anew": (
        at(70_000) + at(70_100) + at(5_000) + at(5_100),
        "time",
        [0, 0.01, 0.02, 0.03],
    ),
    "twice": (
        b"".join(map(at, (90_000, 90_100, 50_000, 50_100, 10_000, 10_100))),
        "time",
        [0, 0.01, 0.02, 0.03, 0.04, 0.05],
    ),
    "a sample that runs behind": (at(5_000) + at(5_200) + at(5_150), "time", [0, 0.02, 0.015]),
    "a wrong stamp": (
        b"".join(
            at(ticks, counter(number))
            for number, ticks in enumerate((50_000, 50_100, 900_000, 50_300, 100, 50_500))
        ),
        "time",
        [0, 0.01, 0.02, 0.03, 0.04, 0.05],
    ),
    "a receiver with a time": (
        at(5_000) + at(5_100) + at(4_900, PVT) + at(5_200),
        "time",
        [0, 0.01, -0.01, 0.02],
    ),
    "a receiver with an arbitrary time": (
        at(900_000, PVT) + at(5_000) + at(900_000, PVT) + at(5_200),
        "time",
        [0, 0, 0.01, 0.02],
    ),
    "a receiver behind a new beginning": (
        at(70_000) + at(70_100) + at(5_000) + at(4_950, PVT) + at(5_100),
        "time",
        [0, 0.01, 0.02, 0.015, 0.03],
    ),
    "a receiver only": (at(5_000, PVT) + at(7_500, PVT), "time", [0, 0.25]),
    "two devices": (
        at(0, bid=1) + at(900_000, bid=2) + at(200, bid=1) + at(900_100, bid=2),
        "time",
        [0, 0, 0.02, 0.01],
    ),
    "a device that ends before the other": (
        at(0, bid=1) + at(900_000, bid=2) + at(950_000, bid=2) + at(999_900, bid=2),
        "time",
        [0, 0, 5, 9.99],
    ),
    "a device that restarts while the other goes on": (
        at(90_000, bid=1)
        + at(90_100, bid=1)
        + at(0, bid=2)
        + at(20_000, bid=2)
        + at(100, bid=1)
        + at(200, bid=1),
        "time",
        [0, 0.01, 0.01, 2.01, 2.01, 2.02],
    ),
    "a device without a stamp": (
        at(0, bid=1) + mtdata2(counter(1), bid=2) + at(200, bid=1) + mtdata2(counter(2), bid=2),
        "time",
        [0, 0.01, 0.02, 0.02],
    ),
    "a restart with a clock that goes on": (
        at(0) + at(100) + WAKEUP + at(50_000) + at(50_100),
        "time",
        [0, 0.01, 0.02, 0.03],
    ),
    "a sample without a stamp first in a run": (
        at(90_000) + at(90_100) + WAKEUP + mtdata2(counter(1)) + at(0, counter(2)) + at(100),
        "time",
        [0, 0.01, 0.02, 0.02, 0.03],
    ),
    "master and standalone are one": (at(0, bid=1) + at(100, bid=0xFF), "time", [0, 0.01]),
    "counter": (
        b"".join(mtdata2(counter(value)) for value in (7, 8, 11)),
        "packet counter",
        [0, 1, 4],
    ),
    "neither": (mtdata2(packet(0xE010, b"\0")) * 3, "sample", [0, 1, 2]),
}


@pytest.mark.parametrize("name", TABLE)
def test_places(name: str) -> None:
    data, kind, expected = TABLE[name]
    axis, x = places(data)
    assert axis.kind == kind
    assert x == pytest.approx(np.array(expected))
    assert axis.last == x[-1]


def test_a_restart_in_the_next_part() -> None:
    """The axis continues when the restart is in another part."""
    before, after = at(70_000) + at(70_100), at(5_000) + at(5_100) + at(5_200)
    parts = list(xbus.iter_log(before + after, block_bytes=len(before)))
    assert len(parts) > 1
    _, x = place(parts)
    assert x == pytest.approx(np.array([0, 0.01, 0.02, 0.03, 0.04]))


def test_a_part_without_any_stamp() -> None:
    _, x = places(at(100) + at(200), mtdata2(counter(5)), b"", at(300))
    assert x == pytest.approx(np.array([0, 0.01, 0.01, 0.02]))


def test_devices() -> None:
    axis, _ = places(at(0, bid=1) + at(100, bid=3) + at(100, bid=0xFF))
    assert axis.devices == {1, 3}
