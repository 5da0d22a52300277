"""The horizontal axis of plots: a position for each sample, even without a time stamp."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from xbus import _core
from xbus.log.runs import steady_time
from xbus.plots.thin import BoolArray, FloatArray
from xbus.protocol.tables import device_of

__all__ = ["Axis"]

#: Maximum plausible distance of a sample from its neighbours, in seconds.
MAX_DISTANCE = 1.0


class _Clock:
    """The present run of a device on the axis.

    Attributes:
        run: Number of the run.
        value: Last value of its clock; NaN before the first.
        offset: Position minus value.
        step: Last usual step of its clock; 0 before the second value.
    """

    def __init__(self) -> None:
        self.run = -1
        self.value = float("nan")
        self.offset = self.step = 0.0


class Axis:
    """Computes the positions of samples, part by part.

    The axis starts at the first time stamp. Each run of a device follows its own clock, from where it begins:
    one step after the last sample of the device, or later if another device was there meanwhile. How long a
    restart took is not known otherwise.

    Attributes:
        kind: ``"time"`` in s, else ``"packet counter"`` or ``"sample"``; empty before the first sample.
        last: Position of the last sample.
        origin: Value of the first clock at position 0.
        devices: BIDs of the devices that sent samples.

    >>> import xbus
    >>> from xbus.log.runs import Runs
    >>> log = xbus.read_log("tests/captures/walk.mtb")
    >>> Axis().positions(log.core, Runs().add(log.core).run)[:3].round(3).tolist()
    [0.0, 0.01, 0.02]
    """

    def __init__(self) -> None:
        self.kind = ""
        self.last = self.origin = 0.0
        self.devices: set[int] = set()
        #: Whether only samples of the GNSS receiver have a time.
        self._is_receiver = False
        self._clocks: dict[int, _Clock] = {}

    def positions(self, part: _core.Part, run: npt.NDArray[np.int64]) -> FloatArray:
        """Returns the position of each sample, ``(N,)``.

        A sample without a time stamp of the device is between its neighbours.

        Args:
            part: The next part of the log.
            run: The number of the run of each sample, ``(N,)``.
        """
        if not len(part):
            return np.empty(0)
        devices = device_of(part.bid)
        self.devices |= set(np.unique(devices).tolist())
        if not self.kind:
            self._start(part)
        if self.kind == "sample":
            x = (part.first + np.arange(len(part))).astype(np.float64)
        else:
            x = self._from_clocks(part, run, devices)
        self.last = float(x[-1])
        return x

    def _start(self, part: _core.Part) -> None:
        for kind, is_receiver in (("time", False), ("time", True), ("packet counter", False)):
            self.kind, self._is_receiver = kind, is_receiver
            if np.isfinite(self._stamps(part)).any():
                return
        self.kind = "sample"

    def _stamps(self, part: _core.Part) -> FloatArray:
        """Returns the clock value of each sample; NaN if there is none."""
        if self.kind == "time":
            return part.time if self._is_receiver else steady_time(part)
        return np.where(part.packet_counter != -1, part.packet_counter, np.nan)

    def _from_clocks(
        self, part: _core.Part, run: npt.NDArray[np.int64], devices: npt.NDArray[np.uint8]
    ) -> FloatArray:
        stamps = self._stamps(part)
        receiver = part.time if self.kind == "time" else np.full(len(part), np.nan)
        x = np.full(len(part), np.nan)
        # Runs are numbered in the order of their first samples, so the sample before a run has its position.
        order = np.argsort(run, kind="stable")
        is_known = np.ones(len(part), np.bool_)
        for rows in np.split(order, np.flatnonzero(np.diff(run[order])) + 1):
            before = float(x[rows[0] - 1]) if rows[0] else self.last
            clock = self._clocks.setdefault(int(devices[rows[0]]), _Clock())
            number = int(run[rows[0]])
            if (found := self._of_run(clock, number, stamps[rows], receiver[rows], before)) is None:
                is_known[rows], x[rows] = False, before
            else:
                x[rows] = found
        if is_known.any() and not is_known.all():
            others = np.flatnonzero(is_known)
            x[~is_known] = np.interp(np.flatnonzero(~is_known), others, x[others])
        return x

    def _of_run(
        self, clock: _Clock, run: int, stamps: FloatArray, receiver: FloatArray, before: float
    ) -> FloatArray | None:
        """Returns the positions of samples of one run; None without a time stamp."""
        known = np.isfinite(stamps)
        rows, values = np.flatnonzero(known), stamps[known]
        if self.kind == "time":
            is_plausible = ~_outliers(values)
            rows, values = rows[is_plausible], values[is_plausible]
        if not len(values):
            return None
        if self.kind == "time":
            steps = np.diff(values)
            usual = steps[(steps > 0) & (steps <= MAX_DISTANCE)]
            clock.step = float(np.median(usual)) if len(usual) else clock.step
        else:
            clock.step = 1.0
        if clock.run != run:
            if clock.run >= 0:
                before = max(before, clock.value + clock.offset + clock.step)
            if not any(known.run >= 0 for known in self._clocks.values()):
                self.origin = float(values[0]) - before
            clock.run, clock.offset = run, before - float(values[0])
        clock.value = float(values[-1])
        x: FloatArray = np.interp(np.arange(len(stamps)), rows, values + clock.offset)
        # Samples of the receiver use the same clock, if they have a valid time.
        own = receiver + clock.offset
        is_own = ~known & (np.abs(own - x) < MAX_DISTANCE)
        return np.where(is_own, own, x)


def _outliers(clock: FloatArray) -> BoolArray:
    """Returns which stamps are far from neighbours that agree: damage that passed the checksum."""
    found = np.zeros(len(clock), np.bool_)
    far = np.abs(np.diff(clock)) > MAX_DISTANCE
    found[1:-1] = far[:-1] & far[1:] & (np.abs(clock[2:] - clock[:-2]) < MAX_DISTANCE)
    return found
