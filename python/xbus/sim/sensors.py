"""The sensors of a virtual device: measurements at any time, computed from one trajectory.

Nothing is estimated: the quantities of the orientation and position filters are the true values plus noise.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from xbus.geometry import earth, quaternion
from xbus.geometry.earth import FloatArray
from xbus.protocol.products import LEGACY
from xbus.protocol.tables import QUANTITIES, UTC_VALID, Product
from xbus.protocol.values import (
    GNSS_CARRIER_BIT,
    GNSS_CORRECTED,
    GNSS_FIX_OK,
    SATELLITE_USED_BIT,
    GnssFixType,
    GnssSystem,
)
from xbus.sim.clock import SECOND
from xbus.sim.motion import TO_ENU, Motion, Trajectory

__all__ = ["Sensors", "Ticks", "nanoseconds"]

IntArray: TypeAlias = npt.NDArray[np.int64]

#: Noise at strength 1. The inertial sensors have the noise densities of data sheets, in (m/s2)/√Hz and
#: (rad/s)/√Hz. The others have standard deviations per sample.
NOISE_DENSITY = {"acceleration": 60e-6 * 9.81, "rate_of_turn": np.radians(0.007)}
NOISE = {
    "magnetic_field": 1e-3,  # a.u.
    "orientation": np.radians(0.2),  # about each axis
    "position": 0.3,  # m, after the filter
    "velocity": 0.02,  # m/s
    "baro_pressure": 3.0,  # Pa
    "temperature": 0.02,  # degC
}
#: Number of ticks that share a noise generator.
NOISE_BLOCK = 256

#: Raw counts per m/s2, rad/s and a.u., and the raw value of zero.
RAW_GAINS = np.repeat([300.0, 1800.0, 8000.0], 3)
RAW_ZERO = 32768

#: Origin of GPS time in ns since 1970; GPS time minus UTC in s; and milliseconds in a week.
GPS_EPOCH = np.datetime64("1980-01-06", "ns").astype(np.int64)
LEAP_SECONDS = 18
WEEK_MS = 7 * 86_400_000

#: UTC of the device's calendar at power-up, by default.
UTC = np.datetime64("2020-01-01", "ns")

#: Accuracies that the receiver reports, by RTK status: horizontal and vertical in mm, speed in mm/s.
ACCURACIES = ((1200, 1900, 120), (250, 400, 80), (14, 20, 40))
#: Accuracy of time with a fix, in ns.
TIME_ACCURACY = 20
#: Dilutions of precision with a fix, in hundredths; and the value of all of them without a fix.
DOPS = {"gdop": 165, "pdop": 144, "tdop": 80, "vdop": 120, "hdop": 79, "ndop": 60, "edop": 52}
NO_DOP = 9999
#: The fields of `gnss_pvt_data`, and counts per unit of each field.
PVT_FIELDS = {field.name: field for field in QUANTITIES["gnss_pvt_data"].fields}
PVT_COUNTS = {name: field.per_unit for name, field in PVT_FIELDS.items()}
#: Satellites in view by system, each with the number of satellite numbers.
SATELLITES = {GnssSystem.GPS: (9, 32), GnssSystem.GALILEO: (6, 36), GnssSystem.GLONASS: (5, 24)}
#: Carrier-to-noise ratio in dBHz from which a satellite is used.
USED_FROM = 28
#: Signal quality and flag bits of a satellite (Table 26).
SEARCHING, UNUSABLE, LOCKED = 1, 3, 7
HEALTHY_BIT, CORRECTED_BIT = 4, 6
#: Fields of `gnss_sat_info` before its satellites.
SAT_INFO_HEAD = [field.name for field in QUANTITIES["gnss_sat_info"].fields]
#: A tick of the phases, in ns and per second: the resolution of SampleTimeFine.
PHASE_TICK = SECOND // 10_000
PHASE_RATE = 10_000


def nanoseconds(numbers: IntArray, rate: int | Fraction, phase: int) -> IntArray:
    """Returns the times of ticks in ns since power-up, rounded down, ``(n,)`` int64; see `Ticks`."""
    # Whole seconds and the rest are computed apart: the product would overflow.
    ticks, per_second = numbers * rate.denominator, rate.numerator
    seconds, rest = ticks // per_second, ticks % per_second
    return seconds * SECOND + rest * SECOND // per_second + phase * PHASE_TICK


@dataclass(frozen=True)
class Ticks:
    """Evenly spaced instants on the clock of a device.

    Attributes:
        first: Number of the first tick; tick 0 is at power-up.
        count: Number of ticks.
        rate: Hz.
        phase: Delay of all ticks, in 0.1 ms.
    """

    first: int
    count: int
    rate: int | Fraction
    phase: int = 0

    @property
    def nanoseconds(self) -> IntArray:
        """Nanoseconds since power-up, rounded down, ``(n,)`` int64."""
        return nanoseconds(self._numbers, self.rate, self.phase)

    @property
    def time(self) -> FloatArray:
        """Seconds since power-up, ``(n,)`` float64."""
        numbers = self._numbers * self.rate.denominator
        return np.asarray(numbers / self.rate.numerator + self.phase / PHASE_RATE)

    @property
    def _numbers(self) -> IntArray:
        return np.arange(self.first, self.first + self.count, dtype=np.int64)


@dataclass(frozen=True, eq=False)
class Sensors:
    """The sensors of one virtual device.

    Attributes:
        trajectory: Motion of the housing.
        product: The product.
        rot_sensor: RotSensor of SetAlignmentRotation, q0 first: the rotation from sensor coordinates, in
            which vectors are reported, to the housing.
        rot_local: RotLocal, q0 first: rotates orientation and `free_acceleration` in local coordinates.
        noise: Strength of the white noise: 0 is none, 1 is about that of a data sheet.
        seed: Seed of the noise and of the satellites in view, from 0 to 2**64 - 1.
        utc: UTC of the device's calendar at power-up.
        time_to_fix: Seconds from power-up to the first GNSS fix.
        rtk: RTK status of the receiver: 0 none, 1 float, 2 fixed.

    >>> from xbus.sim.trajectories import trajectory
    >>> from xbus.protocol.tables import PRODUCTS
    >>> sensors = Sensors(trajectory("still"), PRODUCTS[630])
    >>> sensors.read("acceleration", Ticks(0, 2, 100)).round(2).tolist()
    [[0.0, 0.0, 9.81], [0.0, 0.0, 9.81]]
    """

    trajectory: Trajectory
    product: Product
    rot_sensor: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    rot_local: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    noise: float = 0.0
    seed: int = 0
    utc: np.datetime64 = UTC
    time_to_fix: float = 0.0
    rtk: int = 0
    #: Cache of the last motions: the quantities of one message share them.
    _motions: dict[Ticks, Motion] = field(default_factory=dict, init=False, repr=False)

    def read(self, name: str, ticks: Ticks, coordinates: str = "ENU") -> npt.NDArray[Any]:
        """Returns the numbers of a quantity in the order of the wire, one row per tick.

        Vectors are in the sensor coordinates that RotSensor defines. Orientation is
        ``rot_local * q * rot_sensor``. `delta_q` and `delta_v` are increments since the previous tick:
        ``conj(q(t - dt)) * q(t)`` with q0 >= 0, and ``v(t) - v(t - dt) + g dt`` with g pointing up, in sensor
        coordinates at the start of the interval. Velocity and position are geographic and do not depend on
        RotLocal. Raw values are in the coordinates of the housing.

        Args:
            name: Name of a measured quantity of Table 16, not one of group Timestamp or Status.
            ticks: The times.
            coordinates: Coordinate system of orientation and velocity.

        Returns:
            float64 for reals, int64 for integers and records, ``(n,)`` for scalars, otherwise ``(n, k)``.

        Raises:
            ValueError: The product does not measure the quantity.
        """
        is_legacy = self.product.series == LEGACY
        if not is_legacy and self.product.number not in QUANTITIES[name].products:
            raise ValueError(f"{self.product.name} does not measure {name}")
        local = quaternion.conjugate(TO_ENU[coordinates])
        match name:
            case "temperature":
                return self._temperature(ticks)
            case "quaternion":
                return quaternion.multiply(local, self._orientation(ticks))
            case "rotation_matrix":
                matrix = quaternion.to_matrix(quaternion.multiply(local, self._orientation(ticks)))
                return matrix.transpose(0, 2, 1).reshape(-1, 9)  # column by column
            case "euler_angles":
                return quaternion.to_euler(quaternion.multiply(local, self._orientation(ticks)))
            case "baro_pressure":
                return np.rint(self.pressure(ticks)).astype(np.int64)
            case "acceleration" | "acceleration_hr":
                return self._aligned(self._specific_force(ticks))
            case "rate_of_turn" | "rate_of_turn_hr":
                return self._aligned(self._rate_of_turn(ticks))
            case "magnetic_field":
                return self._aligned(self._magnetic_field(ticks))
            case "delta_q":
                return self._delta_q(ticks)
            case "delta_v":
                return self._delta_v(ticks)
            case "free_acceleration":
                motion = self._motion(ticks)
                noise = quaternion.rotate(
                    motion.orientation[1:], self._noise("acceleration", ticks)
                )
                return quaternion.rotate(self._rot_local, motion.acceleration[1:] + noise)
            case "lat_lon":
                return self._geodetic(ticks)[:, :2]
            case "altitude_ellipsoid":
                return self._geodetic(ticks)[:, 2]
            case "position_ecef":
                return earth.enu_to_ecef(self._position(ticks), self.trajectory.origin)
            case "velocity_xyz":
                return quaternion.rotate(local, self._velocity(ticks))
            case "gnss_pvt_data":
                return self._pvt(ticks)
            case "gnss_sat_info":
                return self._sat_info(ticks)
            case "raw_acc_gyr_mag_temp":
                return self._raw(ticks)
            case "raw_gyro_temp":
                return np.repeat(self._raw(ticks)[:, 9:], 3, axis=1)
        raise ValueError(f"{name} is not measured")

    def pressure(self, ticks: Ticks) -> FloatArray:
        """Returns the pressure in Pa, ``(n,)``; Xbus sends whole pascals, CAN fractions."""
        height = self._geodetic(ticks)[:, 2] - earth.GEOID_SEPARATION
        noise = self._noise("baro_pressure", ticks, 1)[:, 0]
        return np.asarray(earth.pressure(height) + noise)

    @property
    def satellites(self) -> int:
        """Number of satellites in view."""
        return len(self._constellation["system"])

    def utc_time(self, nanoseconds: IntArray) -> IntArray:
        """Returns the fields of `utc_time`, ``(n, 8)`` int64, valid from the first fix on.

        Args:
            nanoseconds: Times in ns since power-up, ``(n,)`` int64.
        """
        utc = self.utc.astype("M8[ns]").astype(np.int64) + nanoseconds
        valid = np.zeros_like(utc)
        if self._has_gnss:
            valid[nanoseconds >= self.time_to_fix * SECOND] = UTC_VALID
        return np.column_stack([utc % SECOND, *_calendar(utc), valid])

    @property
    def _has_gnss(self) -> bool:
        return self.product.kind == "GNSS/INS"

    @cached_property
    def _rot_sensor(self) -> FloatArray:
        return _unit(self.rot_sensor)

    @cached_property
    def _rot_local(self) -> FloatArray:
        return _unit(self.rot_local)

    @cached_property
    def _gravity(self) -> FloatArray:
        """The acceleration that an accelerometer at rest measures, in ENU."""
        origin = self.trajectory.origin
        return np.array([0.0, 0.0, float(earth.gravity(origin.lat, origin.alt))])

    def _motion(self, ticks: Ticks) -> Motion:
        """Returns the motion at the tick before the first and at all ticks: n + 1 rows."""
        if (motion := self._motions.get(ticks)) is None:
            longer = replace(ticks, first=ticks.first - 1, count=ticks.count + 1)
            motion = self.trajectory.at(longer.time)
            if len(self._motions) >= 8:
                del self._motions[next(iter(self._motions))]
            self._motions[ticks] = motion
        return motion

    def _noise(self, sensor: str, ticks: Ticks, columns: int = 3) -> FloatArray:
        """Returns white noise of a sensor, (n, columns): a function of seed, sensor, rate and tick only."""
        if not self.noise:
            return np.zeros((ticks.count, columns))
        first, last = ticks.first // NOISE_BLOCK, (ticks.first + ticks.count - 1) // NOISE_BLOCK
        key = np.array([self.seed, zlib.crc32(sensor.encode())], np.uint64)
        blocks = []
        for block in range(first, last + 1):
            # The generator counts in the first word. The other words separate blocks and rates.
            rate = ticks.rate.numerator
            counter = np.array([0, block % 2**64, rate, ticks.phase], np.uint64)
            generator = np.random.Philox(key=key, counter=counter)
            blocks.append(np.random.Generator(generator).standard_normal((NOISE_BLOCK, columns)))
        start = ticks.first - first * NOISE_BLOCK
        rows = np.concatenate(blocks)[start : start + ticks.count]
        # The bandwidth of a sampled signal is half its rate.
        density = NOISE_DENSITY.get(sensor)
        sigma = NOISE[sensor] if density is None else density * np.sqrt(float(ticks.rate / 2))
        return np.asarray(self.noise * sigma * rows)

    def _aligned(self, vectors: FloatArray) -> FloatArray:
        return quaternion.rotate(quaternion.conjugate(self._rot_sensor), vectors)

    def _orientation(self, ticks: Ticks) -> FloatArray:
        error = quaternion.from_rotation_vector(self._noise("orientation", ticks))
        housing = quaternion.multiply(self._motion(ticks).orientation[1:], error)
        return quaternion.multiply(self._rot_local, quaternion.multiply(housing, self._rot_sensor))

    def _specific_force(self, ticks: Ticks) -> FloatArray:
        motion = self._motion(ticks)
        force = motion.acceleration[1:] + self._gravity
        seen = quaternion.rotate(quaternion.conjugate(motion.orientation[1:]), force)
        return seen + self._noise("acceleration", ticks)

    def _rate_of_turn(self, ticks: Ticks) -> FloatArray:
        return self._motion(ticks).rate_of_turn[1:] + self._noise("rate_of_turn", ticks)

    def _magnetic_field(self, ticks: Ticks) -> FloatArray:
        housing = self._motion(ticks).orientation[1:]
        seen = quaternion.rotate(quaternion.conjugate(housing), earth.magnetic_field())
        return seen + self._noise("magnetic_field", ticks)

    def _delta_q(self, ticks: Ticks) -> FloatArray:
        q = self._motion(ticks).orientation
        delta = quaternion.delta(q[:-1], q[1:])
        delta *= np.where(delta[:, :1] < 0, -1.0, 1.0)
        error = quaternion.from_rotation_vector(
            self._noise("rate_of_turn", ticks) / float(ticks.rate)
        )
        turned = quaternion.multiply(quaternion.multiply(delta, error), self._rot_sensor)
        return quaternion.multiply(quaternion.conjugate(self._rot_sensor), turned)

    def _delta_v(self, ticks: Ticks) -> FloatArray:
        motion = self._motion(ticks)
        gain = np.diff(motion.velocity, axis=0) + self._gravity / float(ticks.rate)
        seen = quaternion.rotate(quaternion.conjugate(motion.orientation[:-1]), gain)
        return self._aligned(seen + self._noise("acceleration", ticks) / float(ticks.rate))

    def _position(self, ticks: Ticks) -> FloatArray:
        error = self._noise("position", ticks) * (ACCURACIES[self.rtk][0] / ACCURACIES[0][0])
        return self._motion(ticks).position[1:] + error

    def _velocity(self, ticks: Ticks) -> FloatArray:
        return self._motion(ticks).velocity[1:] + self._noise("velocity", ticks)

    def _geodetic(self, ticks: Ticks) -> FloatArray:
        """Latitude, longitude and height, (n, 3)."""
        place = earth.enu_to_geodetic(self._position(ticks), self.trajectory.origin)
        return np.stack(place, axis=1)

    def _temperature(self, ticks: Ticks) -> FloatArray:
        """Returns the temperature: the electronics warm up by 12 degrees, with a time constant of 600 s."""
        warm = 25.0 + 12.0 * -np.expm1(-np.maximum(ticks.time, 0.0) / 600.0)
        return np.asarray(warm + self._noise("temperature", ticks, 1)[:, 0])

    def _raw(self, ticks: Ticks) -> IntArray:
        vectors = [
            self._specific_force(ticks),
            self._rate_of_turn(ticks),
            self._magnetic_field(ticks),
        ]
        counts = RAW_ZERO + RAW_GAINS * np.concatenate(vectors, axis=1)
        temperature = 256 * self._temperature(ticks)[:, np.newaxis]
        rows = np.hstack([counts.clip(0, 0xFFFF), temperature])
        return np.asarray(np.rint(rows), np.int64)

    def _epochs(self, ticks: Ticks) -> tuple[IntArray, IntArray, npt.NDArray[np.bool_]]:
        """Returns UTC in ns, GPS time of week in ms, and whether there is a fix, each (n,)."""
        utc = self.utc.astype("M8[ns]").astype(np.int64) + ticks.nanoseconds
        itow = ((utc - GPS_EPOCH) // 10**6 + LEAP_SECONDS * 1000) % WEEK_MS
        return utc, itow, ticks.time >= self.time_to_fix

    def _pvt(self, ticks: Ticks) -> IntArray:
        """Returns the fields of Table 25, (n, 35)."""
        utc, itow, has_fix = self._epochs(ticks)
        horizontal, vertical, speed_accuracy = ACCURACIES[self.rtk]
        east, north, up = (PVT_COUNTS["gSpeed"] * self._velocity(ticks)).T
        speed = np.hypot(east, north)
        course = PVT_COUNTS["headMot"] * (np.degrees(np.arctan2(east, north)) % 360)
        lat, lon, height = self._geodetic(ticks).T
        corrections = (GNSS_CORRECTED if self.rtk else 0) | self.rtk << GNSS_CARRIER_BIT
        values: dict[str, npt.ArrayLike] = {
            "valid": UTC_VALID,
            "tAcc": TIME_ACCURACY,
            "fixtype": GnssFixType.FIX_3D,
            "flags": GNSS_FIX_OK | corrections,
            "numSV": self._sky(ticks)[1].sum(axis=1),
            "Reserved1": 0,
            "lon": lon * PVT_COUNTS["lon"],
            "lat": lat * PVT_COUNTS["lat"],
            "height": height * PVT_COUNTS["height"],
            "hMSL": (height - earth.GEOID_SEPARATION) * PVT_COUNTS["hMSL"],
            "hAcc": horizontal,
            "vAcc": vertical,
            "velN": north,
            "velE": east,
            "velD": -up,
            "gSpeed": speed,
            "headMot": course,
            "sAcc": speed_accuracy,
            "headAcc": np.degrees(np.arctan2(speed_accuracy, speed)) * PVT_COUNTS["headAcc"],
            # The receiver does not know the heading of the vehicle: it repeats the course, without the flag.
            "headVeh": course,
            **DOPS,
        }
        columns = dict(
            zip(("year", "month", "day", "hour", "min", "sec"), _calendar(utc), strict=True)
        )
        columns |= {"itow": itow, "nano": utc % SECOND}
        for name, value in values.items():
            without_fix = NO_DOP if name in DOPS else PVT_FIELDS[name].missing or 0
            counts = np.where(has_fix, np.rint(value), without_fix)
            columns[name] = np.asarray(counts, np.int64)
        return np.column_stack([columns[name] for name in PVT_FIELDS])

    @cached_property
    def _constellation(self) -> dict[str, npt.NDArray[Any]]:
        """The satellites in view: system, number, and the amplitude, period and phase of their signals."""
        random = np.random.default_rng([self.seed, zlib.crc32(b"satellites")])
        systems = np.repeat(list(SATELLITES), [count for count, _ in SATELLITES.values()])
        numbers = [random.choice(of, count, replace=False) + 1 for count, of in SATELLITES.values()]
        total = len(systems)
        return {
            "system": systems,
            "number": np.concatenate(numbers),
            "strength": random.permutation(np.linspace(20.0, 47.0, total)),
            "period": random.uniform(600.0, 1800.0, total),
            "phase": random.uniform(0.0, 2 * np.pi, total),
        }

    def _sky(self, ticks: Ticks) -> tuple[IntArray, npt.NDArray[np.bool_]]:
        """Returns carrier to noise ratio in dBHz and use, each (n, satellites): zero before the fix."""
        sky = self._constellation
        angle = 2 * np.pi * ticks.time[:, np.newaxis] / sky["period"] + sky["phase"]
        strength = np.rint(sky["strength"] + 3.0 * np.sin(angle)).astype(np.int64)
        strength *= (ticks.time >= self.time_to_fix)[:, np.newaxis]
        return strength, strength >= USED_FROM

    def channels(self, ticks: Ticks) -> IntArray:
        """Returns the numbers of `GnssChannel` for each channel, (n, channels, 5)."""
        strength, used = self._sky(ticks)
        number = self._constellation["number"]
        rows = np.broadcast_arrays(
            np.arange(len(number)),
            number,
            used.astype(np.int64),
            np.where(used, LOCKED, SEARCHING),
            strength,
        )
        return np.stack(rows, axis=2)

    def _sat_info(self, ticks: Ticks) -> IntArray:
        """Returns the head of Table 26 and its satellites, (n, 5 + 4 * satellites)."""
        _, itow, _ = self._epochs(ticks)
        strength, used = self._sky(ticks)
        system, number = self._constellation["system"], self._constellation["number"]
        is_received = strength > 0
        quality = np.where(used, LOCKED, np.where(is_received, UNUSABLE, SEARCHING))
        flags = quality | used << SATELLITE_USED_BIT | is_received << HEALTHY_BIT
        if self.rtk:
            flags |= used << CORRECTED_BIT
        entries = np.broadcast_arrays(system, number, strength, flags)
        head = np.zeros((ticks.count, len(SAT_INFO_HEAD)), np.int64)
        head[:, SAT_INFO_HEAD.index("itow")] = itow
        head[:, SAT_INFO_HEAD.index("numSvs")] = len(system)
        return np.hstack([head, np.stack(entries, axis=2).reshape(ticks.count, -1)])


def _unit(q: npt.ArrayLike) -> FloatArray:
    return np.asarray(np.asarray(q, np.float64) / np.linalg.norm(q))


def _calendar(utc: IntArray) -> list[IntArray]:
    """Returns year, month, day, hour, minute and second of ns since 1970."""
    stamp = utc.view("M8[ns]")
    year, month, day = (stamp.astype(f"M8[{unit}]") for unit in "YMD")
    second = utc // SECOND
    return [
        year.astype(np.int64) + 1970,
        (month - year.astype(month.dtype)).astype(np.int64) + 1,
        (day - month.astype(day.dtype)).astype(np.int64) + 1,
        second // 3600 % 24,
        second // 60 % 60,
        second % 60,
    ]
