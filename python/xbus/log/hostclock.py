"""Device time on the clock of the computer that received it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeVar, overload

import numpy as np
import numpy.typing as npt

from xbus import _core

__all__ = ["HostClock", "Step"]

N = TypeVar("N", np.float64, np.int64, np.bool_)


@dataclass(frozen=True)
class Step:
    """A step of one of the clocks, at which a new fit began.

    Attributes:
        time: Device time of the first sample after the step, in seconds.
        host_time: When that sample arrived, in seconds since 1970.
        reason: ``"device time went back"`` (the device restarted), ``"arrivals became early"`` (the host's
            clock was set back or stood still, or the device's was set ahead) or ``"arrivals became late"``
            (the host's clock was set ahead, or the device's stood still; detected after ten seconds,
            because a delay looks the same).
    """

    time: float
    host_time: float
    reason: str


class HostClock:
    """Maps device time to host time, from the arrivals of samples.

    An arrival can only be late. Of all points (device time, arrival), only the lower convex hull is therefore
    evidence about the clocks. The line along the hull of the last ten minutes is the arrival of a sample that
    did not wait: the time of measurement plus the minimum delay of the connection, which cannot be measured
    from one side. The host time of a sample depends only on this and earlier samples, so it is the same live
    and in a log. It never runs backwards unless the host's clock is set back.

    >>> import numpy as np
    >>> clock = HostClock()
    >>> sent = np.arange(60_000) * 1_000_012  # ns: 1 kHz for a minute, on a clock that is 12 ppm slow
    >>> burst = 16_000_000 + np.random.default_rng(1).integers(0, 500_000, 4_000)
    >>> reads = np.cumsum(burst)
    >>> arrival = reads[np.searchsorted(reads, sent)] + 1_200_000  # the minimum delay is 1.2 ms
    >>> host_time = clock.update(np.arange(60_000) / 1000, arrival)
    >>> f"{clock.drift:.1f} ppm, {(host_time[-1] - sent[-1] / 1e9) * 1e3:.1f} ms"
    '12.0 ppm, 1.2 ms'
    >>> f"{clock.residual * 1e3:.1f} ms"
    '8.1 ms'
    """

    def __init__(self) -> None:
        self._core = _core.HostClock()

    @classmethod
    def of(cls, core: _core.HostClock) -> HostClock:
        """Returns a clock of the core."""
        clock = cls()
        clock._core = core
        return clock

    def copy(self) -> HostClock:
        """Returns an independent copy of the clock."""
        return HostClock.of(self._core.copy())

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
        self, device_time: Any, arrival_ns: Any, leads: Any = True
    ) -> float | npt.NDArray[np.float64]:
        """Adds samples in the order of their arrival, and returns their host times.

        Args:
            device_time: Seconds on the device clock, unwrapped, as `Log.time`; one or ``(n,)``.
            arrival_ns: When the last byte of each arrived, in ns since 1970 (``time.time_ns()``).
            leads: False for samples of a GNSS receiver (``gnss_pvt_data``, ``gnss_sat_info``) and of a
                trigger: their times lag or are arbitrary, so they do not move the clock.

        Returns:
            Host times in seconds since 1970, ``(n,)``. NaN if the device time is NaN, before the first
            leading sample, and for a sample that does not lead and is more than a second away from those
            that do.

        Raises:
            TypeError: A device time is not a number, an arrival is not an integer, or ``leads`` is not a
                bool.
        """
        if np.ndim(device_time) == 0:
            return self._core.update(device_time, arrival_ns, leads)
        time = _array(device_time, np.float64)
        arrival = _array(np.broadcast_to(arrival_ns, time.shape), np.int64)
        leading = _array(np.broadcast_to(leads, time.shape), np.bool_)
        return self._core.update_many(time, arrival, leading)

    @overload
    def host_time(self, device_time: float) -> float: ...
    @overload
    def host_time(self, device_time: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]: ...
    def host_time(self, device_time: Any) -> float | npt.NDArray[np.float64]:
        """Returns the host times of any device times by the current fit; NaN before the first sample.

        Within the last second these are the host times that `update` returned.
        """
        if np.ndim(device_time) == 0:
            # The sum is a float of any real number, and text has none.
            return float(self._core.host_time(_array([device_time + 0.0], np.float64))[0])
        return self._core.host_time(_array(device_time, np.float64))

    @property
    def offset(self) -> float:
        """Host time minus device time at the newest sample, in seconds; NaN before the first."""
        return self._core.offset

    @property
    def drift(self) -> float:
        """How much faster the host clock is than the device clock, in ppm; NaN before the first sample.

        During the first ten seconds of a fit, the drift of the previous fit, or 0.
        """
        return self._core.drift * 1e6

    @property
    def residual(self) -> float:
        """Mean delay of arrivals behind the line, in seconds, over about ten seconds."""
        return self._core.residual

    @property
    def since(self) -> float:
        """Device time at which the current fit began, in seconds; NaN before the first sample."""
        return self._core.since

    @property
    def fits(self) -> int:
        """Number of fits: one more than steps, or 0 before the first sample."""
        return self._core.fits

    @property
    def steps(self) -> list[Step]:
        """The last 100 steps."""
        return [Step(step.time, step.arrival / 1e9, step.reason) for step in self._core.steps]

    def __repr__(self) -> str:
        if not self.fits:
            return "<HostClock without a sample>"
        steps = f", {self.fits - 1} steps" if self.fits > 1 else ""
        return (
            f"<HostClock drift {self.drift:.2f} ppm, arrivals {self.residual * 1e3:.1f} ms late on average"
            f"{steps}>"
        )


def _array(values: npt.ArrayLike, dtype: type[N]) -> npt.NDArray[N]:
    """Returns a contiguous array; raises TypeError instead of parsing text or truncating numbers."""
    return np.ascontiguousarray(np.asarray(values).astype(dtype, casting="same_kind"))
