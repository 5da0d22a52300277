"""The horizontal axis of a report: where each sample stands, also those that have no time of their own."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from xbus.log.log import Log, steady_time
from xbus.protocol.tables import MASTER, STANDALONE
from xbus.report.thin import BoolArray, FloatArray

__all__ = ["Axis"]

#: By how many seconds a clock that begins anew steps back at least; samples of trigger lines do by less.
BACK = 1.0
#: Seconds between a sample and its neighbours, beyond which its time is wrong, or arbitrary.
AWAY = 1.0


class Axis:
    """Where samples stand, part by part.

    It begins at the first stamp of a device. Where that device has begun anew, its clock falls, and the axis
    goes on a step behind the last sample: nobody knows how long it was away.

    Attributes:
        kind: ``"time"``, in s; ``"packet counter"`` or ``"sample"`` where a log has no better; empty before
            the first sample.
        last: Where the last sample is.
        restarts: How often the clock has begun anew.
        devices: Bus identifiers of those that have sent samples.

    >>> import xbus
    >>> axis = Axis()
    >>> axis.places(xbus.read_log("tests/captures/walk.mtb"))[:3].round(3).tolist()
    [0.0, 0.01, 0.02]
    """

    def __init__(self) -> None:
        self.kind = ""
        self.last = 0.0
        self.restarts = 0
        self.devices: set[int] = set()
        #: The device whose clock it is, and whether only samples of the GNSS receiver have a time.
        self._device = STANDALONE
        self._is_receiver = False
        #: The clock's last value and last step, and what is to be added to it.
        self._clock = np.nan
        self._step = 0.0
        self._offset = 0.0

    def places(self, part: Log) -> FloatArray:
        """Where each sample is; one that has no stamp of the device is between those around it."""
        if not len(part):
            return np.empty(0)
        devices = np.where(part.bid == MASTER, STANDALONE, part.bid)
        self.devices |= set(np.unique(devices).tolist())
        if not self.kind:
            self._begin(part, devices.astype(np.int64))
        if self.kind == "sample":
            x = (part.first_sample + np.arange(len(part))).astype(np.float64)
        else:
            x = self._clocked(part, devices == self._device)
        self.last = float(x[-1])
        return x

    def _begin(self, part: Log, devices: npt.NDArray[np.int64]) -> None:
        for kind, is_receiver in (("time", False), ("time", True), ("packet counter", False)):
            self.kind, self._is_receiver = kind, is_receiver
            stamps = self._stamps(part)
            if len(known := np.flatnonzero(np.isfinite(stamps))):
                self._device = int(devices[known[0]])
                self._offset = -float(stamps[known[0]])
                return
        self.kind = "sample"

    def _stamps(self, part: Log) -> FloatArray:
        """What the axis is made of; NaN where a sample has none."""
        if self.kind == "time":
            return part.time if self._is_receiver else steady_time(part)
        return np.where(part.packet_counter != -1, part.packet_counter, np.nan)

    def _clocked(self, part: Log, is_device: BoolArray) -> FloatArray:
        stamps = self._stamps(part)
        known = np.isfinite(stamps) & is_device
        rows, clock = np.flatnonzero(known), stamps[known]
        if self.kind == "time":
            fine = ~_astray(clock)
            rows, clock = rows[fine], clock[fine]
        if not len(clock):
            return np.full(len(part), self.last)
        before = self._clock if np.isfinite(self._clock) else clock[0]
        steps = np.diff(clock, prepend=before)
        falls = steps < (-BACK if self.kind == "time" else 0.0)
        offsets = np.full(len(clock), self._offset)
        if falls.any():
            rising = steps[steps > 0]
            usual = float(np.median(rising)) if len(rising) else self._step
            offsets += np.cumsum(np.where(falls, usual - steps, 0.0))
            self.restarts += int(np.count_nonzero(falls))
        self._clock, self._offset = float(clock[-1]), float(offsets[-1])
        self._step = float(steps[-1]) if 0 < steps[-1] <= AWAY else self._step
        x: FloatArray = np.interp(np.arange(len(part)), rows, clock + offsets)
        if self.kind == "time":
            # Samples of the receiver have a time of the same clock, if they have one.
            others = np.flatnonzero(np.isfinite(part.time) & is_device & ~known)
            latest = np.maximum(np.searchsorted(rows, others, "right") - 1, 0)
            own = part.time[others] + offsets[latest]
            x[others] = np.where(np.abs(own - x[others]) < AWAY, own, x[others])
        return x


def _astray(clock: FloatArray) -> BoolArray:
    """Which stamps are far from neighbours that are near each other: damage that passed the checksum."""
    found = np.zeros(len(clock), np.bool_)
    far = np.abs(np.diff(clock)) > AWAY
    found[1:-1] = far[:-1] & far[1:] & (np.abs(clock[2:] - clock[:-2]) < AWAY)
    return found
