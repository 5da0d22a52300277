"""The string outputs of a virtual device, computed from the same trajectory as its samples."""

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
from xbus.protocol.values import GnssFixType, StringType
from xbus.sim.sensors import IntArray, Sensors, Ticks
from xbus.wire.strings import encode_string

__all__ = ["StringStream"]

#: Number of instants that are computed at a time.
BLOCK_INSTANTS = 32
#: Speed in m/s below which the course is unknown (section 5.3.5, note 12).
LEAST_SPEED = 0.2
#: A knot in m/s.
KNOT = 1852 / 3600
#: The columns of `gnss_pvt_data`.
_PVT_COLUMN = {field.name: i for i, field in enumerate(QUANTITIES["gnss_pvt_data"].fields)}
#: The columns of `utc_time`.
_UTC_COLUMNS = [field.name for field in QUANTITIES["utc_time"].fields]


class StringStream:
    """The string outputs of the Measurement State.

    Instant k is at ``k / rate`` seconds after power-up. At each instant all enabled strings are sent, in the
    order of their bits. A field is empty if the product does not compute it, or if it needs a fix and there
    is none.

    Roll is positive with port up, pitch with bow up; bow is the x axis of the sensor, port is y. This is the
    manual's definition for PHTRO and PRDID. It is assumed for the other strings: no published bytes of a
    device confirm it. Magnetic north is true north here, so deviation and variation are zero.

    Args:
        types: The enabled strings.
        rate: Hz; None if strings are sent on request only.
        sensors: The sensors.
        start: Seconds since power-up; the first instant after this time is the first to be sent.

    Attributes:
        sensors: The sensors; they can be replaced during the measurement.
    """

    #: Hz of the instants of strings on request: the default sampling period (Table 18).
    REQUEST_RATE = Fraction(100)

    def __init__(
        self, types: StringType, rate: Fraction | None, sensors: Sensors, start: float
    ) -> None:
        self.sensors = sensors
        self._types = [kind for kind in StringType if kind in types]
        self._on_request = rate is None
        self._rate = rate or self.REQUEST_RATE
        self._next = self._last(start) + 1
        self._cached: tuple[Sensors, int, list[bytes]] | None = None

    def take(self, until: float, status: int) -> list[tuple[float, bytes]]:  # noqa: ARG002 - for samples only
        """Returns the strings sent since the last call, up to and including a time, each with its time."""
        if self._on_request:
            return []
        first, self._next = self._next, max(self._next, self._last(until) + 1)
        instants = range(first, self._next)
        return [(self._time(k), string) for k in instants for string in self._strings(k)]

    def latest(self, now: float, status: int) -> list[bytes]:  # noqa: ARG002
        """Returns the strings of the newest instant."""
        return self._strings(self._last(now))

    def _time(self, k: int) -> float:
        return float(k / self._rate)

    def _last(self, time: float) -> int:
        """Returns the last instant up to and including a time."""
        k = int(Fraction(time) * self._rate)
        # Times are rounded, so the instant can be one off.
        while self._time(k + 1) <= time:
            k += 1
        while self._time(k) > time:
            k -= 1
        return k

    def _strings(self, k: int) -> list[bytes]:
        # Blocks are fixed, so results do not depend on the times of the calls.
        block, count = k // BLOCK_INSTANTS, len(self._types)
        if self._cached is None or self._cached[:2] != (self.sensors, block):
            ticks = Ticks(block * BLOCK_INSTANTS, BLOCK_INSTANTS, self._rate)
            self._cached = self.sensors, block, self._encode(ticks)
        first = (k - block * BLOCK_INSTANTS) * count
        return self._cached[2][first : first + count]

    def _encode(self, ticks: Ticks) -> list[bytes]:
        """Returns the strings of these instants, one instant after another."""
        readings = _Readings(self.sensors, ticks)
        tables = [
            {
                name: np.broadcast_to(values, ticks.count).tolist()
                for name, values in STRING_FIELDS[kind](readings).items()
            }
            for kind in self._types
        ]
        return [
            encode_string(kind, {name: values[k] for name, values in table.items()})
            for k in range(ticks.count)
            for kind, table in zip(self._types, tables, strict=True)
        ]


class _Readings:
    """Measurements at several instants: arrays with one row each, NaN if the device has no value."""

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
        # A positive turn about y, which points to port, lowers the bow.
        return -self._euler[:, 1]

    def heading(self, decimals: int) -> FloatArray:
        """Returns degrees clockwise from north, below 360 after rounding. Yaw is from east to north."""
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
        return np.asarray(self._pvt("fixtype") == GnssFixType.FIX_3D)

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
        return self._pvt_data[:, _PVT_COLUMN[name]]

    @cached_property
    def _pvt_data(self) -> FloatArray:
        return self._read("gnss_pvt_data", len(_PVT_COLUMN))

    @property
    def quality(self) -> IntArray:
        # The manual lists 0 invalid, 1 GPS and 2 differential, and no value for RTK.
        return np.where(self.fix, 1 + (self._sensors.rtk > 0), 0)

    @property
    def satellites(self) -> IntArray:
        return np.where(self.fix, np.nan_to_num(self._pvt("numSV")), 0).astype(np.int64)

    @property
    def hdop(self) -> FloatArray:
        return self.where_fixed(self._pvt("hdop") / 100)

    @property
    def time(self) -> list[datetime.time]:
        return [
            datetime.time(utc["hour"], utc["minute"], utc["second"], utc["ns"] // 1000)
            for utc in self._utc
        ]

    @property
    def date(self) -> list[datetime.date]:
        return [datetime.date(utc["year"], utc["month"], utc["day"]) for utc in self._utc]

    @cached_property
    def _utc(self) -> list[dict[str, int]]:
        """The fields of `utc_time` at each instant."""
        rows = self._sensors.utc_time(self._ticks.nanoseconds).tolist()
        return [dict(zip(_UTC_COLUMNS, row, strict=True)) for row in rows]


def _vector(stem: str, values: FloatArray, names: str = "xyz") -> dict[str, Any]:
    return {stem + name: column for name, column in zip(names, values.T, strict=True)}


def _heading(readings: _Readings) -> dict[str, Any]:
    return {"heading": readings.heading(2)}


def _hchdg(readings: _Readings) -> dict[str, Any]:
    return {"heading": readings.heading(1), "deviation": 0.0, "variation": 0.0}


def _attitude(readings: _Readings, decimals: int = 2) -> dict[str, Any]:
    return {
        "heading": readings.heading(decimals),
        "roll": readings.roll,
        "pitch": readings.pitch,
    }


def _phtro(readings: _Readings) -> dict[str, Any]:
    return {"pitch": readings.pitch, "roll": readings.roll}


def _psoncms(readings: _Readings) -> dict[str, Any]:
    return {
        **_vector("quaternion_q", readings.quaternion, "0123"),
        **_vector("acceleration_", readings.acceleration),
        **_vector("rate_of_turn_", readings.rate_of_turn),
        **_vector("magnetic_field_", readings.magnetic_field),
        "temperature": readings.temperature,
    }


def _hcmtw(readings: _Readings) -> dict[str, Any]:
    return {"temperature": readings.temperature}


def _herot(readings: _Readings) -> dict[str, Any]:
    # The z axis points up. A positive turn about it takes the bow to port, which the string counts negative.
    return {"rate_of_turn": -60 * np.degrees(readings.rate_of_turn[:, 2])}


def _gpgga(readings: _Readings) -> dict[str, Any]:
    lat, lon = readings.lat_lon.T
    return {
        "time": readings.time,
        "lat": readings.where_fixed(lat),
        "lon": readings.where_fixed(lon),
        "quality": readings.quality,
        "satellites": readings.satellites,
        "hdop": readings.hdop,
        "height_msl": readings.where_fixed(readings.height_msl),
        "geoid_separation": readings.where_fixed(np.full(len(lat), earth.GEOID_SEPARATION)),
    }


def _ptcf(readings: _Readings) -> dict[str, Any]:
    rates = np.degrees(readings.rate_of_turn)
    return {**_attitude(readings, 1), "roll_rate": rates[:, 0], "pitch_rate": -rates[:, 1]}


def _xsvel(readings: _Readings) -> dict[str, Any]:
    return _vector("velocity_", readings.velocity)


def _gpzda(readings: _Readings) -> dict[str, Any]:
    return {
        "time": readings.time,
        "date": readings.date,
        "zone_hours": 0.0,
        "zone_minutes": 0.0,
    }


def _gprmc(readings: _Readings) -> dict[str, Any]:
    (lat, lon), (east, north, _) = readings.lat_lon.T, readings.velocity.T
    speed = np.hypot(east, north)
    course = np.round(np.degrees(np.arctan2(east, north)), 1) % 360.0
    return {
        "time": readings.time,
        "status": np.where(readings.fix, "A", "V"),
        "lat": readings.where_fixed(lat),
        "lon": readings.where_fixed(lon),
        "speed": readings.where_fixed(speed / KNOT),
        "course": readings.where_fixed(np.where(speed >= LEAST_SPEED, course, np.nan)),
        "date": readings.date,
        "variation": readings.where_fixed(np.zeros(len(lat))),
    }


#: The fields of each string, by the names of `xbus.protocol.strings`.
STRING_FIELDS: dict[StringType, Callable[[_Readings], dict[str, Any]]] = {
    StringType.HCHDM: _heading,
    StringType.HCHDG: _hchdg,
    StringType.TSS2: _attitude,
    StringType.PHTRO: _phtro,
    StringType.PRDID: _attitude,
    StringType.EM1000: _attitude,
    StringType.PSONCMS: _psoncms,
    StringType.HCMTW: _hcmtw,
    StringType.HEHDT: _heading,
    StringType.HEROT: _herot,
    StringType.GPGGA: _gpgga,
    StringType.PTCF: _ptcf,
    StringType.XSVEL: _xsvel,
    StringType.GPZDA: _gpzda,
    StringType.GPRMC: _gprmc,
}
