"""Time of a virtual device, and what is to happen when."""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Callable

__all__ = ["SECOND", "Clock"]

#: Nanoseconds.
SECOND = 10**9


class Clock:
    """Counts nanoseconds, as integers so that it does not matter how time is cut.

    Attributes:
        now: Nanoseconds since the device was made.
    """

    def __init__(self) -> None:
        self.now = 0
        self._order = itertools.count()
        self._plans: list[tuple[int, int, Callable[[], None]]] = []

    def after(self, seconds: float, action: Callable[[], None]) -> None:
        """Plans what is to happen so many seconds from now."""
        self.at(self.now + round(seconds * SECOND), action)

    def at(self, time: int, action: Callable[[], None]) -> None:
        """Plans what is to happen at a time."""
        heapq.heappush(self._plans, (time, next(self._order), action))

    def next(self) -> int | None:
        """When the next thing happens."""
        return self._plans[0][0] if self._plans else None

    def run(self) -> None:
        """Does what is next."""
        _, _, action = heapq.heappop(self._plans)
        action()

    def forget(self) -> None:
        """Gives all plans up."""
        self._plans.clear()
