"""The clock of a virtual device, and its scheduled actions."""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Callable

__all__ = ["SECOND", "Clock"]

#: Nanoseconds in a second.
SECOND = 10**9


class Clock:
    """Counts nanoseconds and runs scheduled actions.

    Time is an integer, so the size of the steps in which it advances has no effect.

    Attributes:
        now: Nanoseconds since the device was created.
    """

    def __init__(self) -> None:
        self.now = 0
        self._order = itertools.count()
        self._schedule: list[tuple[int, int, Callable[[], None]]] = []

    def after(self, seconds: float, action: Callable[[], None]) -> None:
        """Schedules an action after a delay in seconds."""
        self.at(self.now + round(seconds * SECOND), action)

    def at(self, time: int, action: Callable[[], None]) -> None:
        """Schedules an action at a time in nanoseconds."""
        heapq.heappush(self._schedule, (time, next(self._order), action))

    def next_time(self) -> int | None:
        """Returns the time of the next action in nanoseconds, or None if nothing is scheduled."""
        return self._schedule[0][0] if self._schedule else None

    def run_next(self) -> None:
        """Runs the next action."""
        _, _, action = heapq.heappop(self._schedule)
        action()

    def clear(self) -> None:
        """Cancels all scheduled actions."""
        self._schedule.clear()
