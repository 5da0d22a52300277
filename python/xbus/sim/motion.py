"""Trajectories: the motion of a virtual device, from which all its measurements are computed.

A trajectory gives pose and derivatives at any time. They are exactly consistent: velocity is the derivative
of position, acceleration that of velocity, and rate of turn that of orientation.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

from xbus.geometry import earth, quaternion
from xbus.geometry.earth import ORIGIN, FloatArray
from xbus.protocol.values import LatLonAlt

if TYPE_CHECKING:
    from xbus.log.column import Column
    from xbus.log.log import Log

__all__ = ["Motion", "SampledTrajectory", "Trajectory"]

#: Seconds in which a sampled trajectory starts before its first row, and comes to rest after its last row.
COASTING = 1.0
#: Seconds between the positions of a log that are used, at least. A filter's estimate steps by centimetres
#: when a fix arrives. Within one sample at 100 Hz, such a step is an acceleration of hundreds of m/s2.
FIX_PERIOD = 0.2
#: Rotations from other local coordinates to ENU, q0 first: NED = (y, x, -z), NWU = (y, -x, z).
TO_ENU = {
    "ENU": np.array([1.0, 0.0, 0.0, 0.0]),
    "NED": np.array([0.0, np.sqrt(0.5), np.sqrt(0.5), 0.0]),
    "NWU": np.array([np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)]),
}


@dataclass(frozen=True, eq=False)
class Motion:
    """The motion at n instants. All arrays are float64.

    Args:
        time: Seconds since the device was created, ``(n,)``.
        orientation: Unit quaternions ``(n, 4)``, q0 first, from sensor coordinates to ENU, with a
            continuous sign.
        rate_of_turn: rad/s in sensor coordinates, ``(n, 3)``.
        acceleration: m/s2 in ENU, ``(n, 3)``: the derivative of velocity, without gravity.
        velocity: m/s in ENU, ``(n, 3)``.
        position: Metres east, north and up of the trajectory's origin, ``(n, 3)``.

    Example:
        >>> import numpy as np
        >>> from xbus.sim.trajectories import trajectory
        >>> motion = trajectory("turn").at(np.array([0.0, 3.0]))
        >>> motion.orientation.round(3).tolist()
        [[1.0, 0.0, 0.0, 0.0], [0.707, 0.0, 0.0, 0.707]]
    """

    time: FloatArray
    orientation: FloatArray
    rate_of_turn: FloatArray
    acceleration: FloatArray
    velocity: FloatArray
    position: FloatArray


@runtime_checkable
class Trajectory(Protocol):
    """The motion of a virtual device. Any object with these two members is a trajectory.

    Example:
        >>> import numpy as np
        >>> import xbus
        >>> from xbus.sim import Motion
        >>> from xbus.protocol import LatLonAlt
        >>> class Lift:
        ...     '''Goes up with 2 m/s, level, x to the east.'''
        ...     origin = LatLonAlt(52.24, 6.84, 40.0)
        ...     def at(self, time):
        ...         still = np.zeros((len(time), 3))
        ...         level, up = np.array([1.0, 0.0, 0.0, 0.0]), np.array([0.0, 0.0, 2.0])
        ...         return Motion(time, still[:, :1] + level, still, still, still + up, np.outer(time, up))
        >>> device = xbus.SimulatedDevice("MTi-680G", trajectory=Lift(), time_to_fix=0.0)
        >>> device.advance(10.0)
        >>> log = xbus.read_log(device.read())
        >>> log["altitude_ellipsoid"].values[-1].round(2).item()
        60.0
    """

    @property
    def origin(self) -> LatLonAlt:
        """The place at position zero: degrees, degrees, metres above the ellipsoid.

        Position and velocity are along the east, north and up axes of this place.
        """

    def at(self, time: FloatArray) -> Motion:
        """Returns the motion at times in seconds, ``(n,)`` float64."""
        ...


class _Spline:
    """A natural cubic spline through rows (n, k) at given times, which comes to rest beyond its ends.

    Its second derivative is zero at the ends. Beyond them the speed fades to zero within `COASTING` seconds,
    and then the value is constant. Two derivatives are continuous everywhere.
    """

    def __init__(self, time: FloatArray, rows: FloatArray) -> None:
        self.time, self.rows = time, rows
        step = np.diff(time)[:, np.newaxis]
        slope = np.diff(rows, axis=0) / step
        self.bend = np.zeros_like(rows)
        left, right = step[:-1], step[1:]
        # The diagonal is twice the sum of its neighbours, so each sweep of Jacobi's method halves the
        # error or better: after 60 sweeps it is below the precision of float64.
        for _ in range(60):
            rest = 6 * np.diff(slope, axis=0) - left * self.bend[:-2] - right * self.bend[2:]
            self.bend[1:-1] = rest / (2 * (left + right))

    def at(self, time: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Returns value, first and second derivative, each (n, k)."""
        inside = np.clip(time, self.time[0], self.time[-1])
        i = np.clip(np.searchsorted(self.time, inside, "right") - 1, 0, len(self.time) - 2)
        step = (self.time[i + 1] - self.time[i])[:, np.newaxis]
        b = (inside - self.time[i])[:, np.newaxis] / step
        a = 1 - b
        y0, y1, m0, m1 = self.rows[i], self.rows[i + 1], self.bend[i], self.bend[i + 1]
        value = a * y0 + b * y1 + ((a**3 - a) * m0 + (b**3 - b) * m1) * step**2 / 6
        first = (y1 - y0) / step + ((3 * b**2 - 1) * m1 - (3 * a**2 - 1) * m0) * step / 6
        second = a * m0 + b * m1
        # Beyond the ends the speed falls from 1 to 0 as 1 - 3 x^2 + 2 x^3.
        beyond = (time - inside)[:, np.newaxis] / COASTING
        x = np.minimum(np.abs(beyond), 1.0)
        value += first * np.sign(beyond) * COASTING * (x - x**3 + x**4 / 2)
        second += first * np.sign(beyond) * 6 * (x**2 - x) / COASTING
        first *= 1 - 3 * x**2 + 2 * x**3
        return value, first, second


class SampledTrajectory:
    """A trajectory through given orientations and positions.

    Positions are interpolated with a cubic spline. Orientations are interpolated with a cubic spline through
    the components of the quaternions, normalised. Velocity, acceleration and rate of turn are the exact
    derivatives, without steps; noisy rows have noisy derivatives. The motion starts from rest in the second
    before the first row, and comes to rest in the second after the last row.

    Args:
        time: Seconds since the device is created, strictly increasing, ``(n,)`` with n of at least 2.
        orientation: Quaternions ``(n, 4)``, q0 first, from sensor coordinates to ENU. Any norm except zero
            and either sign are valid; the interpolation turns the shorter way.
        position: Metres east, north and up of ``origin``, ``(n, 3)``; None for a position at the origin.
        origin: Latitude and longitude in degrees, altitude in metres above the ellipsoid.

    Raises:
        ValueError: An array has another shape, times do not increase, a number is not finite, or a
            quaternion is zero.

    Example:
        >>> import numpy as np
        >>> from xbus.sim import SampledTrajectory
        >>> path = SampledTrajectory([0, 1, 2], [[1, 0, 0, 0]] * 3, [[0, 0, 0], [3, 0, 0], [6, 0, 0]])
        >>> path.at(np.array([0.5, 60.0])).position.tolist()
        [[1.5, 0.0, 0.0], [7.5, 0.0, 0.0]]
    """

    def __init__(
        self,
        time: npt.ArrayLike,
        orientation: npt.ArrayLike,
        position: npt.ArrayLike | None = None,
        *,
        origin: LatLonAlt = ORIGIN,
    ) -> None:
        self.origin = origin
        times = np.asarray(time, np.float64)
        if times.ndim != 1 or len(times) < 2:
            raise ValueError(f"time must have the shape (n,) with n >= 2, not {times.shape}")
        if not np.isfinite(times).all() or not (np.diff(times) > 0).all():
            raise ValueError("time must be finite and strictly increasing")
        q = _rows("orientation", orientation, (len(times), 4))
        norm = np.linalg.norm(q, axis=1, keepdims=True)
        if not norm.all():
            raise ValueError(f"the quaternion in row {int(np.argmin(norm))} of orientation is zero")
        self._orientation = _Spline(times, quaternion.continuous(q / norm))
        self._position = None
        if position is not None:
            self._position = _Spline(times, _rows("position", position, (len(times), 3)))

    def at(self, time: FloatArray) -> Motion:
        """Returns the motion at times in seconds, ``(n,)``."""
        time = np.asarray(time, np.float64)
        q, derivative, _ = self._orientation.at(time)
        if self._position is None:
            position, velocity, acceleration = np.zeros((3, len(time), 3))
        else:
            position, velocity, acceleration = self._position.at(time)
        return Motion(
            time=time,
            orientation=q / np.linalg.norm(q, axis=1, keepdims=True),
            rate_of_turn=quaternion.body_rate(q, derivative),
            acceleration=acceleration,
            velocity=velocity,
            position=position,
        )

    @classmethod
    def from_log(cls, log: Log) -> SampledTrajectory:
        """Returns the motion of a recording, with its first orientation at time zero.

        Orientation is that of `quaternion`, `rotation_matrix` or `euler_angles`, the first that the log has,
        in any coordinates. Position is that of `lat_lon` and `altitude_ellipsoid`, or of `position_ecef`,
        and zero without either. Positions are thinned to five per second, because a filter's position steps
        when a fix arrives; faster motion is visible in the orientation only. Rows that have no time, are out
        of order, or are not finite are skipped.

        Args:
            log: The recording.

        Raises:
            ValueError: The log has no orientation, or fewer than two rows of it with times.

        Example:
            >>> import numpy as np, xbus
            >>> from xbus.sim import SampledTrajectory
            >>> path = SampledTrajectory.from_log(xbus.read_log("tests/captures/walk.mtb"))
            >>> path.at(np.array([5.0])).velocity.round(1).tolist()[0][:2]
            [0.3, 1.3]
        """
        time, orientation = _orientations(log)
        start = time[0]
        ecef = _positions(log)
        if ecef is None:
            return cls(time - start, orientation)
        lat, lon, alt = earth.ecef_to_geodetic(ecef[1][0])
        origin = LatLonAlt(float(lat), float(lon), float(alt))
        path = _Spline(ecef[0], earth.ecef_to_enu(ecef[1], origin))
        return cls(time - start, orientation, path.at(time)[0], origin=origin)


def _rows(name: str, values: npt.ArrayLike, shape: tuple[int, int]) -> FloatArray:
    rows = np.asarray(values, np.float64)
    if rows.shape != shape:
        raise ValueError(
            f"{name} must have the shape {shape}, one row for each time, not {rows.shape}"
        )
    if not np.isfinite(rows).all():
        row = int(np.argmin(np.isfinite(rows).all(axis=1)))
        raise ValueError(f"row {row} of {name} is not finite")
    return rows


def _usable(column: Column, values: npt.NDArray[Any]) -> tuple[FloatArray, FloatArray]:
    """Returns times and rows that are finite, each later than all before."""
    time, rows = column.time, np.asarray(values, np.float64)
    finite = np.isfinite(time) & np.isfinite(rows).all(axis=1)
    time, rows = time[finite], rows[finite]
    latest = np.maximum.accumulate(np.concatenate([[-np.inf], time]))[:-1]
    return time[time > latest], rows[time > latest]


def _orientations(log: Log) -> tuple[FloatArray, FloatArray]:
    columns = {column.name: column for column in reversed(list(log.values()))}
    for name in ("quaternion", "rotation_matrix", "euler_angles"):
        if name not in columns:
            continue
        column = columns[name]
        values = np.asarray(column.values, np.float64)
        if name == "rotation_matrix":
            values = quaternion.from_matrix(values)
        elif name == "euler_angles":
            values = quaternion.from_euler(values)
        values = quaternion.multiply(TO_ENU[column.coordinates or "ENU"], values)
        time, rows = _usable(column, values)
        if len(time) < 2:
            raise ValueError(
                f"the log has {len(time)} rows of {name} with times; a trajectory needs two or more"
            )
        return time, rows
    raise ValueError(
        "the log has no orientation: a trajectory needs quaternion, rotation_matrix or euler_angles"
    )


def _positions(log: Log) -> tuple[FloatArray, FloatArray] | None:
    """Returns times and ECEF metres, at least `FIX_PERIOD` apart; None for fewer than two."""
    if "lat_lon" in log and "altitude_ellipsoid" in log:
        time, lat_lon = _usable(log["lat_lon"], log["lat_lon"].values)
        height = log["altitude_ellipsoid"]
        at, alt = _usable(height, height.values[:, np.newaxis])
        if not len(at):
            return None
        heights = np.interp(time, at, alt[:, 0])
        ecef = earth.geodetic_to_ecef(lat_lon[:, 0], lat_lon[:, 1], heights)
    elif "position_ecef" in log:
        time, ecef = _usable(log["position_ecef"], log["position_ecef"].values)
    else:
        return None
    kept: list[int] = []
    following = 0
    while following < len(time):
        kept.append(following)
        following = int(np.searchsorted(time, time[following] + FIX_PERIOD))
    if len(kept) < 2:
        return None
    kept[-1] = len(time) - 1  # the motion ends at the last row
    return time[kept], ecef[kept]
