"""The strings that a virtual device sends, from the same trajectory as its samples."""

from __future__ import annotations

import datetime
from collections.abc import Callable
from fractions import Fraction
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from xbus.geometry import earth
from xbus.geometry.earth import FloatArray
from xbus.protocol.tables import QUANTITIES
from xbus.protocol.values import StringType
from xbus.sim.sensors import IntArray, Sensors, Ticks
from xbus.wire.strings import encode_string

__all__ = ["StringStream"]

#: How many instants are worked out at a time.
BLOCK = 32
#: Below this speed, in m/s, there is no course (section 5.3.5, note 12).
LEAST_SPEED = 0.2
#: A knot in m/s.
KNOT = 1852 / 3600
#: The fields of `gnss_pvt_data`, and its type of fix in three dimensions.
_PVT = [it.name for it in QUANTITIES["gnss_pvt_data"].fields]
FIX_3D = 3


class StringStream:
    """The string outputs of the Measurement State.

    Instant k is at ``k / rate`` seconds after power-up; all strings that are on are sent then, in the
    order of their bits. What a product does not compute, or has no fix for, is an empty field.

    Roll and pitch are positive where port and bow are up; bow is the x axis of the sensor, port is y. That
    is what the manual says for PHTRO and PRDID, and taken for the others; no published bytes of a device
    tell it. Magnetic north is true north here, so deviation and variation are zero.

    Args:
        types: Which.
        rate: Hz; None where they come only when they are asked for.
        sensors: What is measured.
        start: Seconds since power-up; the first instant after it is the first to send.

    Attributes:
        sensors: What is measured; may be replaced while measuring.
    """

    #: Hz of what is sent on demand: the default sampling period (Table 18).
    DEMAND_RATE = Fraction(100)

    def __init__(
        self, types: StringType, rate: Fraction | None, sensors: Sensors, start: float
    ) -> None:
        self.sensors = sensors
        self._types = [it for it in StringType if it in types]
        self._is_asked = rate is None
        self._rate = rate or self.DEMAND_RATE
        self._next = self._last(start) + 1
        self._cached: tuple[Sensors, int, list[bytes]] | None = None

    def take(self, until: float, status: int) -> list[tuple[float, bytes]]:  # noqa: ARG002 - samples have it
        """The strings sent since the last call, up to and at a time, and when."""
        if self._is_asked:
            return []
        first, self._next = self._next, max(self._next, self._last(until) + 1)
        return [(self._time(k), it) for k in range(first, self._next) for it in self._strings(k)]

    def latest(self, now: float, status: int) -> list[bytes]:  # noqa: ARG002
        """The strings of the newest instant."""
        return self._strings(self._last(now))

    def _time(self, k: int) -> float:
        return float(k / self._rate)

    def _last(self, time: float) -> int:
        """The last instant up to and at a time."""
        k = int(Fraction(time) * self._rate)
        # A time is a rounded one.
        while self._time(k + 1) <= time:
            k += 1
        while self._time(k) > time:
            k -= 1
        return k

    def _strings(self, k: int) -> list[bytes]:
        # Always the same instants together: then nothing depends on how calls cut time.
        block, many = k // BLOCK, len(self._types)
        if self._cached is None or self._cached[:2] != (self.sensors, block):
            self._cached = (
                self.sensors,
                block,
                self._encode(Ticks(block * BLOCK, BLOCK, self._rate)),
            )
        at = (k - block * BLOCK) * many
        return self._cached[2][at : at + many]

    def _encode(self, ticks: Ticks) -> list[bytes]:
        """The strings of these instants, one instant after the other."""
        readings = _Readings(self.sensors, ticks)
        columns = [
            {name: np.broadcast_to(it, ticks.count).tolist() for name, it in said(readings).items()}
            for said in (SAID[it] for it in self._types)
        ]
        return [
            encode_string(kind, {name: values[k] for name, values in column.items()})
            for k in range(ticks.count)
            for kind, column in zip(self._types, columns, strict=True)
        ]


class _Readings:
    """What is known at some instants: arrays of a row each, NaN where a device knows nothing."""

    def __init__(self, sensors: Sensors, ticks: Ticks) -> None:
        self._sensors, self._ticks = sensors, ticks

    def _read(self, name: str, columns: int) -> FloatArray:
        if self._sensors.product.number in QUANTITIES[name].products:
            return np.asarray(self._sensors.read(name, self._ticks), np.float64)
        return np.full((self._ticks.count, columns), np.nan)

    @cached_property
    def quaternion(self) -> FloatArray:
        return self._read("quaternion", 4)

    @cached_property
    def _euler(self) -> FloatArray:
        return self._read("euler_angles", 3)

    @property
    def roll(self) -> FloatArray:
        return self._euler[:, 0]

    @property
    def pitch(self) -> FloatArray:
        # A turn about y, which points to port, takes the bow down.
        return -self._euler[:, 1]

    def heading(self, decimals: int) -> FloatArray:
        """Degrees from north, clockwise; yaw goes from east to north. There is no 360.00."""
        return np.asarray(np.round(90.0 - self._euler[:, 2], decimals) % 360.0)

    @cached_property
    def acceleration(self) -> FloatArray:
        return self._read("acceleration", 3)

    @cached_property
    def rate_of_turn(self) -> FloatArray:
        return self._read("rate_of_turn", 3)

    @cached_property
    def magnetic_field(self) -> FloatArray:
        return self._read("magnetic_field", 3)

    @cached_property
    def temperature(self) -> FloatArray:
        return np.asarray(self._sensors.read("temperature", self._ticks), np.float64)

    @cached_property
    def fix(self) -> npt.NDArray[np.bool_]:
        return np.asarray(self._pvt("fixtype") == FIX_3D)

    def where_fixed(self, values: FloatArray) -> FloatArray:
        return np.asarray(np.where(self.fix, values, np.nan))

    @property
    def lat_lon(self) -> FloatArray:
        return self._read("lat_lon", 2)

    @property
    def height_msl(self) -> FloatArray:
        return self._read("altitude_ellipsoid", 1).reshape(-1) - earth.GEOID_SEPARATION

    @cached_property
    def velocity(self) -> FloatArray:
        return self._read("velocity_xyz", 3)

    def _pvt(self, name: str) -> FloatArray:
        return self._pvt_data[:, _PVT.index(name)]

    @cached_property
    def _pvt_data(self) -> FloatArray:
        return self._read("gnss_pvt_data", len(_PVT))

    @property
    def quality(self) -> IntArray:
        # The manual knows 0 invalid, 1 GPS and 2 differential, and nothing for carrier phases.
        return np.where(self.fix, 1 + (self._sensors.rtk > 0), 0)

    @property
    def satellites(self) -> IntArray:
        return np.where(self.fix, np.nan_to_num(self._pvt("numSV")), 0).astype(np.int64)

    @property
    def hdop(self) -> FloatArray:
        return self.where_fixed(self._pvt("hdop") / 100)

    @property
    def time(self) -> list[datetime.time]:
        return [datetime.time(it[4], it[5], it[6], it[0] // 1000) for it in self._utc]

    @property
    def date(self) -> list[datetime.date]:
        return [datetime.date(it[1], it[2], it[3]) for it in self._utc]

    @cached_property
    def _utc(self) -> list[list[int]]:
        """The fields of `utc_time`: nanosecond, year, month, day, hour, minute, second, validity."""
        rows: list[list[int]] = self._sensors.utc_time(self._ticks.nanoseconds).tolist()
        return rows


def _vector(stem: str, values: FloatArray, names: str = "xyz") -> dict[str, Any]:
    return {stem + name: it for name, it in zip(names, values.T, strict=True)}


def _attitude(it: _Readings, decimals: int = 2) -> dict[str, Any]:
    return {"heading": it.heading(decimals), "roll": it.roll, "pitch": it.pitch}


def _psoncms(it: _Readings) -> dict[str, Any]:
    return {
        **_vector("quaternion_q", it.quaternion, "0123"),
        **_vector("acceleration_", it.acceleration),
        **_vector("rate_of_turn_", it.rate_of_turn),
        **_vector("magnetic_field_", it.magnetic_field),
        "temperature": it.temperature,
    }


def _gpgga(it: _Readings) -> dict[str, Any]:
    lat, lon = it.lat_lon.T
    return {
        "time": it.time,
        "lat": it.where_fixed(lat),
        "lon": it.where_fixed(lon),
        "quality": it.quality,
        "satellites": it.satellites,
        "hdop": it.hdop,
        "height_msl": it.where_fixed(it.height_msl),
        "geoid_separation": it.where_fixed(np.full(len(lat), earth.GEOID_SEPARATION)),
    }


def _ptcf(it: _Readings) -> dict[str, Any]:
    rates = np.degrees(it.rate_of_turn)
    return {**_attitude(it, 1), "roll_rate": rates[:, 0], "pitch_rate": -rates[:, 1]}


def _gprmc(it: _Readings) -> dict[str, Any]:
    (lat, lon), (east, north, _) = it.lat_lon.T, it.velocity.T
    speed = np.hypot(east, north)
    course = np.round(np.degrees(np.arctan2(east, north)), 1) % 360.0
    return {
        "time": it.time,
        "status": np.where(it.fix, "A", "V"),
        "lat": it.where_fixed(lat),
        "lon": it.where_fixed(lon),
        "speed": it.where_fixed(speed / KNOT),
        "course": it.where_fixed(np.where(speed >= LEAST_SPEED, course, np.nan)),
        "date": it.date,
        "variation": it.where_fixed(np.zeros(len(lat))),
    }


#: What each string says.
SAID: dict[StringType, Callable[[_Readings], dict[str, Any]]] = {
    StringType.HCHDM: lambda it: {"heading": it.heading(2)},
    StringType.HCHDG: lambda it: {"heading": it.heading(1), "deviation": 0.0, "variation": 0.0},
    StringType.TSS2: _attitude,
    StringType.PHTRO: lambda it: {"pitch": it.pitch, "roll": it.roll},
    StringType.PRDID: _attitude,
    StringType.EM1000: _attitude,
    StringType.PSONCMS: _psoncms,
    StringType.HCMTW: lambda it: {"temperature": it.temperature},
    StringType.HEHDT: lambda it: {"heading": it.heading(2)},
    # Upwards is the z axis, about which a positive turn takes the bow to port.
    StringType.HEROT: lambda it: {"rate_of_turn": -60 * np.degrees(it.rate_of_turn[:, 2])},
    StringType.GPGGA: _gpgga,
    StringType.PTCF: _ptcf,
    StringType.XSVEL: lambda it: _vector("velocity_", it.velocity),
    StringType.GPZDA: lambda it: {
        "time": it.time,
        "date": it.date,
        "zone_hours": 0.0,
        "zone_minutes": 0.0,
    },
    StringType.GPRMC: _gprmc,
}
