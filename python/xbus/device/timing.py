"""Times of samples as they come."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from xbus.log.hostclock import HostClock
from xbus.protocol.tables import LATE

if TYPE_CHECKING:
    from xbus.device.sample import Sample

__all__ = ["Timing"]

#: Ticks of SampleTimeFine in a second.
TICKS = 10_000
#: When it starts again at zero, where the product is not known.
WRAP = 1 << 32


class Timing:
    """The device's clock, unwrapped, and the host's, for samples in the order in which they came.

    Args:
        epoch: What to add to an arrival, in ns, for the time since 1970.
    """

    def __init__(self, epoch: int) -> None:
        self.wrap = WRAP
        self._epoch = epoch
        self._clock = HostClock()
        self._ticks: int | None = None

    def of(self, sample: Sample) -> tuple[float, float]:
        """Device time in seconds, and host time in seconds since 1970; NaN for what is not known."""
        fine = sample.get("sample_time_fine")
        if fine is None:
            return math.nan, math.nan
        follows = any(it in sample for it in LATE)
        ticks = fine if self._ticks is None else self._nearest(fine)
        if not follows:
            self._ticks = ticks
        time = ticks / TICKS
        if sample.arrival is None:
            return time, math.nan
        arrival = round(sample.arrival * 1e9) + self._epoch
        return time, self._clock.update(time, arrival, not follows)

    def _nearest(self, fine: int) -> int:
        """The unwrapped count next to the one before; a device that begins anew goes back."""
        assert self._ticks is not None  # noqa: S101 - asked behind a first one
        step = (fine - self._ticks) % self.wrap
        return self._ticks + (step - self.wrap if step >= self.wrap // 2 else step)
