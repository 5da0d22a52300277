"""What the Python benches share: a recording, and times taken in turns."""

from __future__ import annotations

import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))

from streams import ahrs

__all__ = ["ahrs_stream", "medians", "ratio"]


def ahrs_stream(mebibytes: float) -> bytes:
    """Counter, time, orientation, inertial and magnetic vectors, status: 88-byte frames, Float32."""
    return ahrs(max(1, round(mebibytes * 2**20 / 88)))


def medians(rounds: int, *works: Callable[[], object]) -> list[float]:
    """The median seconds of each work, run in turns after one round to warm up."""
    times: list[list[float]] = [[] for _ in works]
    for round_ in range(rounds + 1):
        for work, list_ in zip(works, times, strict=True):
            start = time.perf_counter()
            work()
            if round_:
                list_.append(time.perf_counter() - start)
    return [statistics.median(seconds) for seconds in times]


def ratio(rounds: int, work: Callable[[], object], yardstick: Callable[[], object]) -> float:
    """How long ``work`` takes, in times of ``yardstick``."""
    mine, other = medians(rounds, work, yardstick)
    return mine / other
