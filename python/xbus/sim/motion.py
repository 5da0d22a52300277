"""How a virtual device moves: one trajectory, from which everything that it measures follows.

A trajectory answers for any time with pose and derivatives that belong together exactly: velocity is
the derivative of position, acceleration that of velocity, rate of turn that of orientation.
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

#: Seconds in which a sampled trajectory comes to rest after its last row, and starts before its first.
COASTING = 1.0
#: Seconds at least between the positions of a log that are used. A filter's estimate steps by centimetres
#: when a fix arrives; taken within one sample at 100 Hz, such a step would be hundreds of m/s2.
FIX_PERIOD = 0.2
#: Turns what is given in other local frames into ENU: NED = (y, x, -z), NWU = (y, -x, z).
TO_ENU = {
    "ENU": np.array([1.0, 0.0, 0.0, 0.0]),
    "NED": np.array([0.0, np.sqrt(0.5), np.sqrt(0.5), 0.0]),
    "NWU": np.array([np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)]),
}


@dataclass(frozen=True, eq=False)
class Motion:
    """A trajectory at n instants. All arrays are float64.

    Attributes:
        time: Seconds, (n,).
        orientation: Unit quaternions (n, 4), q0 first, from the sensor to ENU; their sign is continuous.
        rate_of_turn: rad/s in the sensor frame, (n, 3).
        acceleration: m/s2 in ENU, (n, 3): the derivative of velocity, so without gravity.
        velocity: m/s in ENU, (n, 3).
        position: Metres east, north and up of the trajectory's origin, (n, 3).
    """

    time: FloatArray
    orientation: FloatArray
    rate_of_turn: FloatArray
    acceleration: FloatArray
    velocity: FloatArray
    position: FloatArray


@runtime_checkable
class Trajectory(Protocol):
    """A motion that can be asked for at any time.

    Attributes:
        origin: Where position is zero: degrees, and metres above the ellipsoid. Its axes are the local frame.
    """

    @property
    def origin(self) -> LatLonAlt: ...  # noqa: D102 - above

    def at(self, time: FloatArray) -> Motion:
        """The motion at each of these times, in seconds, (n,)."""
        ...


class _Spline:
    """A natural cubic spline through rows (n, k) at given times, that comes to rest beyond its ends.

    With its second derivative zero at the ends it can go on smoothly: its speed there fades within
    `COASTING` seconds, after which it holds. All of it has two continuous derivatives.
    """

    def __init__(self, time: FloatArray, rows: FloatArray) -> None:
        self.time, self.rows = time, rows
        step = np.diff(time)[:, np.newaxis]
        slope = np.diff(rows, axis=0) / step
        self.bend = np.zeros_like(rows)
        left, right = step[:-1], step[1:]
        # The diagonal is twice the sum of its neighbours, so each sweep (Jacobi's) halves the error at least:
        # 60 of them leave nothing that float64 can hold.
        for _ in range(60):
            rest = 6 * np.diff(slope, axis=0) - left * self.bend[:-2] - right * self.bend[2:]
            self.bend[1:-1] = rest / (2 * (left + right))

    def at(self, time: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Value, first and second derivative, each (n, k)."""
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
    """A trajectory through the user's own rows.

    Between the rows position follows a cubic spline, and orientation one through the components of the
    quaternions, normalised; so velocity, acceleration and rate of turn are their exact derivatives and
    have no steps. Rows of noise make noisy derivatives. After the last time the motion comes to rest
    within a second and stays; before the first it starts in the same way.

    Args:
        time: Seconds, strictly increasing, (n,), at least two; zero is when the device is made.
        orientation: Quaternions (n, 4), q0 first, from the sensor to ENU, of any length but zero and
            either sign; between two rows the shorter way round is taken.
        position: Metres east, north and up of `origin`, (n, 3); at rest there if None.
        origin: Degrees, and metres above the ellipsoid.

    Raises:
        ValueError: Arrays of other shapes, times that do not increase, a number that is not finite, or
            a quaternion of zeros.

    >>> import numpy as np
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
            raise ValueError(f"time must be (n,) with at least 2 rows, not {times.shape}")
        if not np.isfinite(times).all() or not (np.diff(times) > 0).all():
            raise ValueError("time must be finite and strictly increasing")
        q = _rows("orientation", orientation, (len(times), 4))
        norm = np.linalg.norm(q, axis=1, keepdims=True)
        if not norm.all():
            raise ValueError(f"orientation is zero in row {int(np.argmin(norm))}")
        self._orientation = _Spline(times, quaternion.continuous(q / norm))
        self._position = None
        if position is not None:
            self._position = _Spline(times, _rows("position", position, (len(times), 3)))

    def at(self, time: FloatArray) -> Motion:
        """The motion at each of these times, in seconds, (n,)."""
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
        """The motion in a recording, its first orientation at time zero.

        Orientation is its `quaternion`, `rotation_matrix` or `euler_angles`, the first of these that it
        has, in any coordinates. Position is its `lat_lon` with `altitude_ellipsoid`, or `position_ecef`,
        thinned to five rows a second, as a filter's position steps when a fix arrives: what is quicker
        than that shows in orientation alone. Where the log has neither, it is at rest. Rows without a
        time, out of order, or not finite are left out.

        Raises:
            ValueError: The log has no orientation, or fewer than two rows of it with times.

        >>> import numpy as np, xbus
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
        raise ValueError(f"{name} must be {shape}, one row for each time, not {rows.shape}")
    if not np.isfinite(rows).all():
        raise ValueError(
            f"{name} is not finite in row {int(np.argmin(np.isfinite(rows).all(axis=1)))}"
        )
    return rows


def _usable(column: Column, values: npt.NDArray[Any]) -> tuple[FloatArray, FloatArray]:
    """Times and rows, finite, each later than all before."""
    time, rows = column.time, np.asarray(values, np.float64)
    finite = np.isfinite(time) & np.isfinite(rows).all(axis=1)
    time, rows = time[finite], rows[finite]
    latest = np.maximum.accumulate(np.concatenate([[-np.inf], time]))[:-1]
    return time[time > latest], rows[time > latest]


def _orientations(log: Log) -> tuple[FloatArray, FloatArray]:
    columns = {log[key].name: log[key] for key in reversed(log.keys())}
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
            raise ValueError(f"the log has {len(time)} rows of {name} with times; two are needed")
        return time, rows
    raise ValueError("the log has no quaternion, rotation_matrix or euler_angles to move by")


def _positions(log: Log) -> tuple[FloatArray, FloatArray] | None:
    """Times and ECEF metres, `FIX_PERIOD` apart at least; None for fewer than two."""
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
    kept[-1] = len(time) - 1  # the motion is known up to the last row
    return time[kept], ecef[kept]
