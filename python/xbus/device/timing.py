"""Host times of samples, as they are read."""

from __future__ import annotations

import math

from xbus import _core
from xbus.device.sample import Sample

__all__ = ["HostClocks"]


class HostClocks:
    """The host clocks of the devices that send samples: see `xbus.HostClock`.

    Args:
        epoch: Nanoseconds to add to an arrival for nanoseconds since 1970.
    """

    def __init__(self, epoch: int) -> None:
        self._epoch = epoch
        self._clocks: dict[int, _core.HostClock] = {}

    def host_time(self, sample: Sample) -> float:
        """Returns the host time of the next sample, in seconds since 1970; NaN if it is unknown."""
        if math.isnan(sample.time) or sample.arrival is None:
            return math.nan
        device = _core.device_of(sample.bid)
        clock = self._clocks.get(device)
        if clock is None:
            clock = self._clocks[device] = _core.HostClock()
        arrival = round(sample.arrival * 1e9) + self._epoch
        return clock.update(sample.time, arrival, sample.leads)
