"""Device time on the clock of the computer that received it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import overload

import numpy as np
import numpy.typing as npt

from xbus import _core

__all__ = ["HostClock", "Step"]


@dataclass(frozen=True)
class Step:
    """Where one of the clocks made a step, so that a new fit began.

    Attributes:
        time: Device time of the first sample behind it, in seconds.
        host_time: When that sample arrived, in seconds since 1970.
        reason: ``"device time went back"`` (the device began anew), ``"arrivals became early"`` (the host's
            clock was set back or stood still, or the device's was set ahead) or ``"arrivals became late"``
            (the host's clock was set ahead, or the device's stood still; it takes ten seconds to tell that
            from a delay).
    """

    time: float
    host_time: float
    reason: str


class HostClock:
    """Maps device time to host time, from the arrivals of samples.

    An arrival can only be late. So of all points (device time, arrival) only the lower convex hull tells
    about the clocks, and the line along the hull of the last ten minutes is when a sample arrives that did
    not have to wait: later than it was measured by the least delay of the connection, which nobody can see
    from here. What is said of a sample is decided by it and those before it, so it is the same live and in a
    log, and never runs backwards, unless the host's clock was set back.

    >>> import numpy as np
    >>> clock = HostClock()
    >>> sent = np.arange(60_000) * 1_000_012  # ns: 1 kHz for a minute, on a clock that loses 12 ppm
    >>> burst = 16_000_000 + np.random.default_rng(1).integers(0, 500_000, 4_000)
    >>> reads = np.cumsum(burst)
    >>> arrival = reads[np.searchsorted(reads, sent)] + 1_200_000  # 1.2 ms is the least delay
    >>> host_time = clock.update(np.arange(60_000) / 1000, arrival)
    >>> f"{clock.drift:.1f} ppm, {(host_time[-1] - sent[-1] / 1e9) * 1e3:.1f} ms"
    '12.0 ppm, 1.2 ms'
    >>> f"{clock.residual * 1e3:.1f} ms"
    '8.1 ms'
    """

    def __init__(self) -> None:
        self._core = _core.HostClock()

    def copy(self) -> HostClock:
        """The clock as it is now; the two go on separately."""
        other = HostClock()
        other._core = self._core.copy()
        return other

    __copy__ = copy

    @overload
    def update(self, device_time: float, arrival_ns: int, leads: bool = ...) -> float: ...
    @overload
    def update(
        self,
        device_time: npt.NDArray[np.float64],
        arrival_ns: npt.NDArray[np.int64],
        leads: bool | npt.NDArray[np.bool_] = ...,
    ) -> npt.NDArray[np.float64]: ...
    def update(
        self,
        device_time: float | npt.NDArray[np.float64],
        arrival_ns: int | npt.NDArray[np.int64],
        leads: bool | npt.NDArray[np.bool_] = True,
    ) -> float | npt.NDArray[np.float64]:
        """Takes in samples in the order in which they came, and says their host times.

        Args:
            device_time: Seconds on the device clock, unwrapped, as `Log.time`; one or ``(n,)``.
            arrival_ns: When the last byte of each arrived, in ns since 1970 (``time.time_ns()``).
            leads: False for samples of a receiver (``gnss_pvt_data``, ``gnss_sat_info``) and of a trigger:
                these run behind or carry an arbitrary time, so they do not move the clock.

        Returns:
            Host times in seconds since 1970. NaN where the device time is, before the first sample that
            leads, and for those that do not lead and are more than a second away from those that do.
        """
        if np.ndim(device_time) == 0:
            return self._core.update(float(device_time), int(arrival_ns), bool(leads))
        time = np.ascontiguousarray(device_time, np.float64)
        arrival = np.ascontiguousarray(np.broadcast_to(arrival_ns, time.shape), np.int64)
        leading = np.ascontiguousarray(np.broadcast_to(leads, time.shape), np.bool_)
        return self._core.update_many(time, arrival, leading)

    @overload
    def host_time(self, device_time: float) -> float: ...
    @overload
    def host_time(self, device_time: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]: ...
    def host_time(
        self, device_time: float | npt.NDArray[np.float64]
    ) -> float | npt.NDArray[np.float64]:
        """Host times of any device times, as far as is known by now; NaN before the first sample.

        Of the last second this is what was said of the samples then; of everything else, what the line of
        the present says.
        """
        time = np.atleast_1d(np.asarray(device_time, np.float64))
        host = self._core.host_time(np.ascontiguousarray(time))
        return float(host[0]) if np.ndim(device_time) == 0 else host

    @property
    def offset(self) -> float:
        """Host time less device time at the newest sample, in seconds; NaN before the first."""
        return self._core.offset

    @property
    def drift(self) -> float:
        """What the host's clock gains on the device's, in ppm; NaN before the first sample.

        For the first ten seconds of a fit that of the fit before, or 0.
        """
        return self._core.drift * 1e6

    @property
    def residual(self) -> float:
        """How much later than the line samples arrive, in seconds: a mean over about ten seconds."""
        return self._core.residual

    @property
    def since(self) -> float:
        """Device time at which the fit began, in seconds; NaN before the first sample."""
        return self._core.since

    @property
    def fits(self) -> int:
        """How many fits there were: one more than steps, or none before the first sample."""
        return self._core.fits

    @property
    def steps(self) -> list[Step]:
        """The last hundred steps."""
        return [Step(step.time, step.arrival / 1e9, step.reason) for step in self._core.steps]

    def __repr__(self) -> str:
        if not self.fits:
            return "<HostClock without a sample>"
        steps = f", {self.fits - 1} steps" if self.fits > 1 else ""
        return (
            f"<HostClock drift {self.drift:.2f} ppm, arrivals {self.residual * 1e3:.1f} ms late in the mean"
            f"{steps}>"
        )
