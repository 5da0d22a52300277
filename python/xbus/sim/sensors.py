"""What the sensors of a virtual device read, for any time and exactly, from one trajectory.

Nothing is estimated: where a device has a filter, the virtual one says the truth.
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
from xbus.protocol.tables import QUANTITIES, Product
from xbus.sim.motion import TO_ENU, Motion, Trajectory

__all__ = ["Sensors", "Ticks", "nanoseconds"]

IntArray: TypeAlias = npt.NDArray[np.int64]

#: Of noise at full strength. The densities of the inertial sensors are those of data sheets: (m/s2)/√Hz and
#: (rad/s)/√Hz. The others are standard deviations of each sample.
NOISE_DENSITY = {"acceleration": 60e-6 * 9.81, "rate_of_turn": np.radians(0.007)}
NOISE = {
    "magnetic_field": 1e-3,  # a.u.
    "orientation": np.radians(0.2),  # about each axis
    "position": 0.3,  # m, of what the filter says
    "velocity": 0.02,  # m/s
    "baro_pressure": 3.0,  # Pa
    "temperature": 0.02,  # degC
}
#: Noise is drawn for so many ticks at a time, each time from a generator of its own.
NOISE_BLOCK = 256

#: Counts of the converters for one m/s2, rad/s and a.u.; zero is half their range.
RAW_GAINS = np.repeat([300.0, 1800.0, 8000.0], 3)
RAW_ZERO = 32768

#: GPS time began here, and is ahead of UTC by the leap seconds since.
GPS_EPOCH = np.datetime64("1980-01-06", "ns").astype(np.int64)
LEAP_SECONDS = 18
WEEK_MS = 7 * 86_400_000

#: What the calendar says at power-up, unless told otherwise.
UTC = np.datetime64("2020-01-01", "ns")

#: Accuracies that the receiver states, by RTK status: horizontal and vertical in mm, speed in mm/s.
ACCURACIES = ((1200, 1900, 120), (250, 400, 80), (14, 20, 40))
NOT_PROVIDED = 0xFFFF_FFFF
#: Geometric, position, time, vertical, horizontal, northing, easting, in hundredths; and without a fix.
DOPS = (165, 144, 80, 120, 79, 60, 52)
NO_DOP = 9999
#: Satellites in view by their system: GPS, Galileo, GLONASS; and how many numbers each system has.
SATELLITES = {0: (9, 32), 2: (6, 36), 6: (5, 24)}
#: dBHz from which a satellite is used.
USED_FROM = 28


def nanoseconds(numbers: IntArray, rate: int | Fraction, phase: int) -> IntArray:
    """When these ticks are, in ns since power-up, rounded down, (n,) int64; see `Ticks`."""
    # In two parts, which do not overflow.
    ticks, a_second = numbers * rate.denominator, rate.numerator
    return ticks // a_second * 10**9 + ticks % a_second * 10**9 // a_second + phase * 10**5


@dataclass(frozen=True)
class Ticks:
    """Evenly spaced instants on the clock of a device.

    Attributes:
        first: Number of the first; 0 is at power-up.
        count: How many.
        rate: Hz.
        phase: By how much each is later than its number says, in 0.1 ms.
    """

    first: int
    count: int
    rate: int | Fraction
    phase: int = 0

    @property
    def nanoseconds(self) -> IntArray:
        """Since power-up, rounded down, (n,) int64."""
        return nanoseconds(self._numbers, self.rate, self.phase)

    @property
    def time(self) -> FloatArray:
        """Seconds since power-up, (n,) float64."""
        numbers = self._numbers * self.rate.denominator
        return np.asarray(numbers / self.rate.numerator + self.phase / 10_000)

    @property
    def _numbers(self) -> IntArray:
        return np.arange(self.first, self.first + self.count, dtype=np.int64)


@dataclass(frozen=True, eq=False)
class Sensors:
    """The sensors of one virtual device.

    Attributes:
        trajectory: How it moves.
        product: Which product it is.
        rot_sensor: RotSensor of SetAlignmentRotation, q0 first: from the frame in which vectors are given to
            that of the housing, whose orientation the trajectory names.
        rot_local: RotLocal, q0 first: turns orientation and `free_acceleration` in the local frame.
        noise: Strength of white noise: 0 none, 1 about that of a data sheet.
        seed: Of noise and of the satellites in view, from 0 to 2**64 - 1.
        utc: What the device's calendar says at power-up.
        time_to_fix: Seconds from power-up to the first GNSS fix.
        rtk: Carrier phases of the receiver: 0 none, 1 floating, 2 fixed.

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
    #: What was asked for last, by ticks: the quantities of one message share it.
    _motions: dict[Ticks, Motion] = field(default_factory=dict, init=False, repr=False)

    def read(self, name: str, ticks: Ticks, coordinates: str = "ENU") -> npt.NDArray[Any]:
        """The numbers of a quantity in the order of the wire, a row for each tick.

        Vectors of the sensors are given in the frame after RotSensor, orientation as
        ``rot_local * q * rot_sensor``. `delta_q` and `delta_v` are of the interval since the tick before:
        ``conj(q(t - dt)) * q(t)`` with q0 not negative, and ``v(t) - v(t - dt) + g dt``, g pointing up, in
        the sensor frame as it was when the interval began. Velocity and position are geographic whatever
        RotLocal. Raw values are in the frame of the housing.

        Args:
            name: Name of a quantity of Table 16 that is measured: neither of group Timestamp nor Status.
            ticks: When.
            coordinates: Of orientation and velocity.

        Returns:
            float64 for reals, int64 for integers and for records, ``(n,)`` for scalars, else ``(n, k)``.

        Raises:
            ValueError: The product does not measure it.
        """
        if self.product.number not in QUANTITIES[name].products:
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
                height = self._geodetic(ticks)[:, 2] - earth.GEOID_SEPARATION
                noise = self._noise("baro_pressure", ticks, 1)[:, 0]
                return np.rint(earth.pressure(height) + noise).astype(np.int64)
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

    def utc_time(self, nanoseconds: IntArray) -> IntArray:
        """The fields of `utc_time`, (n, 8) int64, at times since power-up: valid from the first fix on."""
        utc = self.utc.astype("M8[ns]").astype(np.int64) + nanoseconds
        valid = np.zeros_like(utc)
        if self._has_gnss:
            valid[nanoseconds >= self.time_to_fix * 1e9] = 0x07
        return np.column_stack([utc % 10**9, *_calendar(utc), valid])

    @property
    def _has_gnss(self) -> bool:
        return self.product.number in QUANTITIES["gnss_pvt_data"].products

    @cached_property
    def _rot_sensor(self) -> FloatArray:
        return _unit(self.rot_sensor)

    @cached_property
    def _rot_local(self) -> FloatArray:
        return _unit(self.rot_local)

    @cached_property
    def _gravity(self) -> FloatArray:
        """What an accelerometer at rest measures, in ENU."""
        origin = self.trajectory.origin
        return np.array([0.0, 0.0, float(earth.gravity(origin.lat, origin.alt))])

    def _motion(self, ticks: Ticks) -> Motion:
        """The motion at the tick before the first and at all ticks: (n + 1)."""
        if (motion := self._motions.get(ticks)) is None:
            longer = replace(ticks, first=ticks.first - 1, count=ticks.count + 1)
            motion = self.trajectory.at(longer.time)
            if len(self._motions) >= 8:
                del self._motions[next(iter(self._motions))]
            self._motions[ticks] = motion
        return motion

    def _noise(self, sensor: str, ticks: Ticks, columns: int = 3) -> FloatArray:
        """White noise of a sensor, (n, columns): a function of seed, sensor, rate and tick alone."""
        if not self.noise:
            return np.zeros((ticks.count, columns))
        first, last = ticks.first // NOISE_BLOCK, (ticks.first + ticks.count - 1) // NOISE_BLOCK
        key = np.array([self.seed, zlib.crc32(sensor.encode())], np.uint64)
        blocks = []
        for block in range(first, last + 1):
            # The generator counts in the first word; the others keep blocks and rates apart.
            rate = ticks.rate.numerator
            counter = np.array([0, block % 2**64, rate, ticks.phase], np.uint64)
            generator = np.random.Philox(key=key, counter=counter)
            blocks.append(np.random.Generator(generator).standard_normal((NOISE_BLOCK, columns)))
        at = ticks.first - first * NOISE_BLOCK
        rows = np.concatenate(blocks)[at : at + ticks.count]
        # The band of a sampled signal ends at half its rate.
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
        """The electronics warm themselves by 12 degrees, most of it in ten minutes."""
        warm = 25.0 + 12.0 * -np.expm1(-np.maximum(ticks.time, 0.0) / 600.0)
        return np.asarray(warm + self._noise("temperature", ticks, 1)[:, 0])

    def _raw(self, ticks: Ticks) -> IntArray:
        readings = (self._specific_force, self._rate_of_turn, self._magnetic_field)
        counts = RAW_ZERO + RAW_GAINS * np.concatenate([it(ticks) for it in readings], axis=1)
        temperature = 256 * self._temperature(ticks)[:, np.newaxis]
        rows = np.hstack([counts.clip(0, 0xFFFF), temperature])
        return np.asarray(np.rint(rows), np.int64)

    def _epochs(self, ticks: Ticks) -> tuple[IntArray, IntArray, npt.NDArray[np.bool_]]:
        """UTC in ns, GPS time of week in ms, and whether there is a fix."""
        utc = self.utc.astype("M8[ns]").astype(np.int64) + ticks.nanoseconds
        itow = ((utc - GPS_EPOCH) // 10**6 + LEAP_SECONDS * 1000) % WEEK_MS
        return utc, itow, ticks.time >= self.time_to_fix

    def _pvt(self, ticks: Ticks) -> IntArray:
        """The fields of Table 25, (n, 35)."""
        utc, itow, fix = self._epochs(ticks)
        accuracy = ACCURACIES[self.rtk]
        east, north, up = (1000 * self._velocity(ticks)).T
        speed = np.hypot(east, north)
        course = np.degrees(np.arctan2(east, north)) % 360
        lat, lon, height = self._geodetic(ticks).T
        doubt = np.degrees(np.arctan2(accuracy[2], speed))

        def fixed(value: npt.ArrayLike, otherwise: int = 0) -> IntArray:
            return np.asarray(np.where(fix, np.rint(value), otherwise), np.int64)

        columns = [itow, *_calendar(utc), fixed(0x07), fixed(20, NOT_PROVIDED), utc % 10**9]
        # Fix type 3D; flags: fix, and for RTK differential corrections and the state of the carrier phases.
        flags = 0x01 | (self.rtk > 0) << 1 | self.rtk << 6
        columns += [fixed(3), fixed(flags), fixed(self._sky(ticks)[1].sum(axis=1)), fixed(0)]
        columns += [fixed(lon * 1e7), fixed(lat * 1e7), fixed(height * 1e3)]
        columns += [fixed((height - earth.GEOID_SEPARATION) * 1e3)]
        columns += [fixed(it, NOT_PROVIDED) for it in accuracy[:2]]
        columns += [fixed(north), fixed(east), fixed(-up), fixed(speed), fixed(course * 1e5)]
        # The heading of the vehicle is not the receiver's to know: it repeats the course and sets no flag.
        columns += [fixed(accuracy[2], NOT_PROVIDED), fixed(doubt * 1e5, NOT_PROVIDED)]
        columns += [fixed(course * 1e5), *(fixed(it, NO_DOP) for it in DOPS)]
        return np.column_stack(columns)

    @cached_property
    def _constellation(self) -> dict[str, npt.NDArray[Any]]:
        """What is in view: system, number, and how strong it is, when."""
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
        """Carrier to noise in dBHz and whether it is used, each (n, satellites): nothing before the fix."""
        sky = self._constellation
        angle = 2 * np.pi * ticks.time[:, np.newaxis] / sky["period"] + sky["phase"]
        strength = np.rint(sky["strength"] + 3.0 * np.sin(angle)).astype(np.int64)
        strength *= (ticks.time >= self.time_to_fix)[:, np.newaxis]
        return strength, strength >= USED_FROM

    def _sat_info(self, ticks: Ticks) -> IntArray:
        """The head of Table 26 and its satellites, (n, 5 + 4 * satellites)."""
        _, itow, _ = self._epochs(ticks)
        strength, used = self._sky(ticks)
        system, number = self._constellation["system"], self._constellation["number"]
        # Searching, detected but unusable, or locked and synchronised; then used for navigation, and healthy.
        quality = np.where(used, 7, np.where(strength > 0, 3, 1))
        flags = quality | used << 3 | (strength > 0) << 4
        if self.rtk:
            flags |= used << 6  # differential corrections
        blocks = np.broadcast_arrays(system, number, strength, flags)
        head = np.zeros((ticks.count, 5), np.int64)
        head[:, 0], head[:, 1] = itow, len(system)
        return np.hstack([head, np.stack(blocks, axis=2).reshape(ticks.count, -1)])


def _unit(q: npt.ArrayLike) -> FloatArray:
    return np.asarray(np.asarray(q, np.float64) / np.linalg.norm(q))


def _calendar(utc: IntArray) -> list[IntArray]:
    """Year, month, day, hour, minute and second of ns since 1970."""
    stamp = utc.view("M8[ns]")
    year, month, day = (stamp.astype(f"M8[{it}]") for it in "YMD")
    second = utc // 10**9
    return [
        year.astype(np.int64) + 1970,
        (month - year.astype(month.dtype)).astype(np.int64) + 1,
        (day - month.astype(day.dtype)).astype(np.int64) + 1,
        second // 3600 % 24,
        second // 60 % 60,
        second % 60,
    ]
