"""The MTData messages of a virtual device: a legacy product, or the 10- and 100-series in legacy mode."""

from __future__ import annotations

import math
from fractions import Fraction
from itertools import pairwise
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from xbus import _core
from xbus.protocol.ids import MessageId
from xbus.protocol.tables import MTDATA_QUANTITIES
from xbus.protocol.values import OutputMode, OutputSettings
from xbus.sim.sensors import PHASE_RATE, PVT_FIELDS, IntArray, Sensors, Ticks
from xbus.sim.stream import GNSS_DELAY, GNSS_RATE, STATUS_BYTE

__all__ = ["MtDataStream", "mtdata_size"]

_Rows: TypeAlias = npt.NDArray[Any]

#: Number of messages whose values are computed at a time.
BLOCK_MESSAGES = 256
#: Hz of the barometer.
BARO_RATE = 50
NO_DELAY = Fraction(0)
#: The age of a value that was never measured, and the highest other one (MTi-G).
NO_VALUE, OLDEST = 255, 254
#: Mid-scale and amplitude of the signals at the analog inputs, in counts: sine and cosine of 1 Hz.
ANALOG_ZERO, ANALOG_AMPLITUDE = 1 << 15, 20_000
#: The values of position and velocity before the first fix are zero: the layout has no place for "missing".
NEEDS_FIX = ("lat_lon", "altitude_ellipsoid", "velocity_xyz", "gps_pvt_data")


def mtdata_size(mode: OutputMode, settings: OutputSettings) -> int:
    """Returns the bytes of an MTData payload with these settings."""
    return sum(item.size for item in _core.mtdata_layout(int(mode), int(settings)))


class MtDataStream:
    """The MTData messages of the Measurement State: one for each instant of a rate.

    The packet counter counts the messages. (Whether that of a real device also counts skipped samples is not
    known.)

    Args:
        mode: The items.
        settings: Their form.
        rate: Rate in Hz.
        sensors: The sensors.
        fine_wrap: Value at which `sample_time_fine` wraps to zero.
        fine_start: `sample_time_fine` at power-up, not wrapped.
        start: Seconds since power-up; the first instant after this time is the first to be sent.
        bid: Bus identifier of the frames.

    Attributes:
        sensors: The sensors. They can be replaced during the measurement, except for the time of the fix.

    >>> from xbus.protocol.tables import LEGACY_PRODUCTS
    >>> from xbus.sim.trajectories import trajectory
    >>> sensors = Sensors(trajectory("still"), LEGACY_PRODUCTS["MTi"])
    >>> stream = MtDataStream(OutputMode.TEMPERATURE, OutputSettings(), Fraction(100), sensors)
    >>> for time, frame in stream.take(0.02, status=0):
    ...     print(time, frame.hex(" ").upper())
    0.01 FA FF 32 06 41 C8 00 69 00 00 57
    0.02 FA FF 32 06 41 C8 00 D2 00 01 ED
    """

    def __init__(
        self,
        mode: OutputMode,
        settings: OutputSettings,
        rate: Fraction,
        sensors: Sensors,
        *,
        fine_wrap: int = 1 << 32,
        fine_start: int = 0,
        start: float = 0.0,
        bid: int = 0xFF,
    ) -> None:
        self.sensors = sensors
        self._mode, self._settings, self._rate, self._bid = int(mode), int(settings), rate, bid
        self._items = _core.mtdata_layout(self._mode, self._settings)
        self._fine_wrap, self._fine_start = fine_wrap, fine_start
        self._counter = 0
        self._next = self._last(start) + 1
        self._cached: tuple[Sensors, int, list[_Rows]] | None = None

    def take(self, until: float, status: int) -> list[tuple[float, bytes]]:
        """Returns the frames sent since the last call, up to and including a time: see `Stream.take`."""
        first, self._next = self._next, max(self._next, self._last(until) + 1)
        frames: list[tuple[float, bytes]] = []
        while first < self._next:
            # Blocks are fixed, so results do not depend on the times of the calls.
            end = min(self._next, (first // BLOCK_MESSAGES + 1) * BLOCK_MESSAGES)
            times = (float(k / self._rate) for k in range(first, end))
            frames += zip(times, self._encode(first, end, status), strict=True)
            first = end
        return frames

    def latest(self, now: float, status: int) -> list[bytes]:
        """Returns the reply to ReqData: the newest message."""
        newest = self._last(now)
        return self._encode(newest, newest + 1, status)

    def _last(self, time: float) -> int:
        """Returns the last instant up to and including a time."""
        k = int(Fraction(time) * self._rate)
        # Times are rounded, so the instant can be one off.
        while float((k + 1) / self._rate) <= time:
            k += 1
        while float(k / self._rate) > time:
            k -= 1
        return k

    def _encode(self, first: int, end: int, status: int) -> list[bytes]:
        """Returns the frames of instants of one block."""
        if not self._items:
            return [_core.encode_frame(self._bid, MessageId.MTData, b"")] * (end - first)
        count, start = end - first, first // BLOCK_MESSAGES * BLOCK_MESSAGES
        now = {
            "packet_counter": (self._counter + np.arange(count, dtype=np.int64)) % 2**16,
            "status_byte": np.full(count, status & STATUS_BYTE, np.int64),
            "status_word": np.full(count, status, np.int64),
        }
        self._counter = (self._counter + count) % 2**16
        rows = [
            now[item.name] if item.name in now else values[first - start : end - start]
            for item, values in zip(self._items, self._block(start), strict=True)
        ]
        found = _core.encode_mtdata(self._mode, self._settings, rows, self._bid)
        return [found.data[a:b] for a, b in pairwise([0, *found.ends.tolist()])]

    def _block(self, start: int) -> list[_Rows]:
        if self._cached is None or self._cached[:2] != (self.sensors, start):
            ticks = Ticks(start, BLOCK_MESSAGES, self._rate)
            values = [self._values(item.name, item.coordinates, ticks) for item in self._items]
            self._cached = self.sensors, start, values
        return self._cached[2]

    def _values(self, name: str, coordinates: str | None, ticks: Ticks) -> _Rows:
        """Returns the values of an item at some instants, ``(n,)`` or ``(n, k)``."""
        sensors = self.sensors
        match name:
            case "packet_counter" | "status_byte" | "status_word":
                return np.empty(0)  # known when a message is sent
            case "utc_time":
                return sensors.utc_time(ticks.nanoseconds)
            case "sample_time_fine":
                fine = ticks.nanoseconds * PHASE_RATE // 10**9 + self._fine_start
                return np.asarray(fine % self._fine_wrap)
            case "gyro_temperature":
                return np.repeat(sensors.read("temperature", ticks)[:, np.newaxis], 3, axis=1)
            case "analog_in1":
                return _analog(np.sin(2 * np.pi * ticks.time))
            case "analog_in2":
                return _analog(np.cos(2 * np.pi * ticks.time))
            case "baro_pressure" | "pressure_age":
                values, ages = self._measured("baro_pressure", ticks, BARO_RATE)
                return ages if name == "pressure_age" else values
            case "gps_pvt_data" | "gnss_age":
                values, ages = self._measured(
                    "gnss_pvt_data", ticks, GNSS_RATE, Fraction(GNSS_DELAY)
                )
                if name == "gps_pvt_data":
                    return self._before_fix(_gps_pvt(values), ticks)
                return np.where(ticks.time < sensors.time_to_fix, NO_VALUE, ages)
        values = sensors.read(name, ticks, coordinates or "ENU")
        return self._before_fix(values, ticks) if name in NEEDS_FIX else values

    def _before_fix(self, values: _Rows, ticks: Ticks) -> _Rows:
        """Returns the values with zeros before the first fix."""
        has_fix = ticks.time >= self.sensors.time_to_fix
        return np.where(has_fix.reshape(-1, *[1] * (values.ndim - 1)), values, 0)

    def _measured(
        self, name: str, ticks: Ticks, rate: int, delay: Fraction = NO_DELAY
    ) -> tuple[_Rows, IntArray]:
        """Returns the newest value of a sensor with its own rate, and its age in messages, each (n, ...)."""
        instants = range(ticks.first, ticks.first + ticks.count)
        epochs = [math.floor((k / self._rate - delay) * rate) for k in instants]
        # The first message that has the value of an epoch.
        since = (math.ceil((Fraction(epoch, rate) + delay) * self._rate) for epoch in epochs)
        ages = [min(k - first, OLDEST) for k, first in zip(instants, since, strict=True)]
        values = self.sensors.read(name, Ticks(epochs[0], epochs[-1] - epochs[0] + 1, rate))
        return values[np.array(epochs) - epochs[0]], np.array(ages, np.int64)


def _analog(signal: npt.NDArray[np.float64]) -> IntArray:
    return np.asarray(np.rint(ANALOG_ZERO + ANALOG_AMPLITUDE * signal), np.int64)


def _gps_pvt(pvt: _Rows) -> _Rows:
    """Returns the fields of `gps_pvt_data`, from those of `gnss_pvt_data`."""
    columns = dict(zip(PVT_FIELDS, pvt.T, strict=True))
    return np.column_stack(
        [
            np.rint(columns[field.name] * field.per_unit / PVT_FIELDS[field.name].per_unit)
            for field in MTDATA_QUANTITIES["gps_pvt_data"].fields
        ]
    ).astype(np.int64)
