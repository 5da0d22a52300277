"""The horizontal axis of a report: a position for each sample, even without a time stamp."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from xbus.log.log import Log, steady_time
from xbus.protocol.tables import MASTER, device_of
from xbus.report.thin import BoolArray, FloatArray

__all__ = ["Axis"]

#: Minimum step back of a clock that restarted, in seconds; samples of trigger inputs step back by less.
RESTART_STEP = 1.0
#: Maximum plausible distance of a sample from its neighbours, in seconds.
MAX_DISTANCE = 1.0


class Axis:
    """Computes the positions of samples, part by part.

    The axis starts at the first time stamp of a device. If the device restarts, its clock steps back, and the
    axis continues one step after the last sample: the duration of the restart is unknown.

    Attributes:
        kind: ``"time"`` in s, else ``"packet counter"`` or ``"sample"``; empty before the first sample.
        last: Position of the last sample.
        restarts: Number of restarts.
        devices: BIDs of the devices that sent samples.

    >>> import xbus
    >>> axis = Axis()
    >>> axis.positions(xbus.read_log("tests/captures/walk.mtb"))[:3].round(3).tolist()
    [0.0, 0.01, 0.02]
    """

    def __init__(self) -> None:
        self.kind = ""
        self.last = 0.0
        self.restarts = 0
        self.devices: set[int] = set()
        #: The device that defines the axis, and whether only samples of its GNSS receiver have a time.
        self._device = device_of(MASTER)
        self._is_receiver = False
        #: Last value and last step of the clock, and its offset on the axis.
        self._clock = np.nan
        self._step = 0.0
        self._offset = 0.0

    def positions(self, part: Log) -> FloatArray:
        """Returns the position of each sample, ``(N,)``.

        A sample without a time stamp of the device is between its neighbours.
        """
        if not len(part):
            return np.empty(0)
        devices = device_of(part.bid)
        self.devices |= set(np.unique(devices).tolist())
        if not self.kind:
            self._start(part, devices)
        if self.kind == "sample":
            x = (part.first_sample + np.arange(len(part))).astype(np.float64)
        else:
            x = self._from_clock(part, devices == self._device)
        self.last = float(x[-1])
        return x

    def _start(self, part: Log, devices: npt.NDArray[np.uint8]) -> None:
        for kind, is_receiver in (("time", False), ("time", True), ("packet counter", False)):
            self.kind, self._is_receiver = kind, is_receiver
            stamps = self._stamps(part)
            if len(known := np.flatnonzero(np.isfinite(stamps))):
                self._device = int(devices[known[0]])
                self._offset = -float(stamps[known[0]])
                return
        self.kind = "sample"

    def _stamps(self, part: Log) -> FloatArray:
        """Returns the clock value of each sample; NaN if there is none."""
        if self.kind == "time":
            return part.time if self._is_receiver else steady_time(part)
        return np.where(part.packet_counter != -1, part.packet_counter, np.nan)

    def _from_clock(self, part: Log, is_device: BoolArray) -> FloatArray:
        stamps = self._stamps(part)
        known = np.isfinite(stamps) & is_device
        rows, clock = np.flatnonzero(known), stamps[known]
        if self.kind == "time":
            is_plausible = ~_outliers(clock)
            rows, clock = rows[is_plausible], clock[is_plausible]
        if not len(clock):
            return np.full(len(part), self.last)
        before = self._clock if np.isfinite(self._clock) else clock[0]
        steps = np.diff(clock, prepend=before)
        falls = steps < (-RESTART_STEP if self.kind == "time" else 0.0)
        offsets = np.full(len(clock), self._offset)
        if falls.any():
            rising = steps[steps > 0]
            usual = float(np.median(rising)) if len(rising) else self._step
            offsets += np.cumsum(np.where(falls, usual - steps, 0.0))
            self.restarts += int(np.count_nonzero(falls))
        self._clock, self._offset = float(clock[-1]), float(offsets[-1])
        self._step = float(steps[-1]) if 0 < steps[-1] <= MAX_DISTANCE else self._step
        x: FloatArray = np.interp(np.arange(len(part)), rows, clock + offsets)
        if self.kind == "time":
            # Samples of the receiver use the same clock, if they have a valid time.
            others = np.flatnonzero(np.isfinite(part.time) & is_device & ~known)
            latest = np.maximum(np.searchsorted(rows, others, "right") - 1, 0)
            own = part.time[others] + offsets[latest]
            x[others] = np.where(np.abs(own - x[others]) < MAX_DISTANCE, own, x[others])
        return x


def _outliers(clock: FloatArray) -> BoolArray:
    """Returns which stamps are far from neighbours that agree: damage that passed the checksum."""
    found = np.zeros(len(clock), np.bool_)
    far = np.abs(np.diff(clock)) > MAX_DISTANCE
    found[1:-1] = far[:-1] & far[1:] & (np.abs(clock[2:] - clock[:-2]) < MAX_DISTANCE)
    return found
