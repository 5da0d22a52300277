"""How fast something is counted."""

from __future__ import annotations

from collections import deque

__all__ = ["RATE_SPAN", "Rate"]

#: Time over which rates are measured, in seconds.
RATE_SPAN = 5.0


class Rate:
    """Measures a rate from totals over the last `RATE_SPAN` seconds."""

    def __init__(self) -> None:
        self._totals: deque[tuple[float, int]] = deque()

    def add(self, now: float, total: int) -> None:
        """Adds a measurement.

        Args:
            now: The time, in seconds.
            total: The number up to this time.
        """
        totals = self._totals
        # After a pause, or if the clock was set, earlier totals say nothing about the rate.
        if totals and not 0 <= now - totals[-1][0] <= RATE_SPAN:
            totals.clear()
        totals.append((now, total))
        while now - totals[0][0] > RATE_SPAN:
            totals.popleft()

    @property
    def value(self) -> float | None:
        """The number per second; None if it is not measured yet."""
        totals = list(self._totals)  # another thread may add
        if not totals:
            return None
        (begin, before), (end, total) = totals[0], totals[-1]
        return (total - before) / (end - begin) if end > begin else None
