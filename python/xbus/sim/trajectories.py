"""The built-in trajectories: smooth, periodic or nearly so, and bounded for all time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from xbus.geometry import quaternion
from xbus.geometry.earth import ORIGIN, FloatArray
from xbus.sim.motion import Motion, Trajectory

__all__ = ["TRAJECTORIES", "trajectory"]


@dataclass(frozen=True)
class _Smooth:
    """A function of time with its first and second derivative, which sums and products propagate."""

    value: FloatArray
    first: FloatArray
    second: FloatArray

    def __add__(self, other: _Smooth | float) -> _Smooth:
        if not isinstance(other, _Smooth):
            return _Smooth(self.value + other, self.first, self.second)
        return _Smooth(
            self.value + other.value, self.first + other.first, self.second + other.second
        )

    def __mul__(self, other: _Smooth | float) -> _Smooth:
        if not isinstance(other, _Smooth):
            return _Smooth(self.value * other, self.first * other, self.second * other)
        return _Smooth(
            self.value * other.value,
            self.first * other.value + self.value * other.first,
            self.second * other.value + 2 * self.first * other.first + self.value * other.second,
        )

    __radd__ = __add__
    __rmul__ = __mul__

    def sin(self) -> _Smooth:
        sine, cosine = np.sin(self.value), np.cos(self.value)
        return _Smooth(sine, cosine * self.first, cosine * self.second - sine * self.first**2)

    def cos(self) -> _Smooth:
        return (self + np.pi / 2).sin()


#: East, north and up in metres, then roll, pitch and yaw in degrees.
Pose: TypeAlias = tuple[_Smooth, _Smooth, _Smooth, _Smooth, _Smooth, _Smooth]
#: A full turn in rad, and a radian in degrees.
TURN, DEGREES = 2 * np.pi, 180 / np.pi
#: Gravity in m/s2, close enough for a bank angle.
G = 9.81


class _Formula:
    """A trajectory that a formula gives."""

    origin = ORIGIN

    def __init__(self, pose: Callable[[_Smooth], Pose]) -> None:
        self._pose = pose

    def at(self, time: FloatArray) -> Motion:
        time = np.asarray(time, np.float64)
        clock = _Smooth(time, np.ones_like(time), np.zeros_like(time))
        east, north, up, *angles = self._pose(clock)
        place = (east, north, up)
        euler = np.stack([angle.value for angle in angles], axis=1)
        rates = [np.radians(angle.first) for angle in angles]
        return Motion(
            time=time,
            orientation=quaternion.from_euler(euler),
            rate_of_turn=_euler_to_body_rate(euler, *rates),
            acceleration=np.stack([axis.second for axis in place], axis=1),
            velocity=np.stack([axis.first for axis in place], axis=1),
            position=np.stack([axis.value for axis in place], axis=1),
        )


def _euler_to_body_rate(
    euler: FloatArray, roll_rate: FloatArray, pitch_rate: FloatArray, yaw_rate: FloatArray
) -> FloatArray:
    """Returns the rate of turn in sensor coordinates, of Euler angles in degrees and their rates in rad/s."""
    roll, pitch, _ = np.radians(euler.T)
    level = yaw_rate * np.cos(pitch)
    x = roll_rate - yaw_rate * np.sin(pitch)
    y = pitch_rate * np.cos(roll) + level * np.sin(roll)
    z = level * np.cos(roll) - pitch_rate * np.sin(roll)
    return np.stack([x, y, z], axis=1)


def _wave(clock: _Smooth, amplitude: float, period: float, phase: float = 0.0) -> _Smooth:
    """Returns a sine of time; the phase is a fraction of the period."""
    return amplitude * (clock * (TURN / period) + TURN * phase).sin()


def _course(
    clock: _Smooth, radius: float, lap: float, sway: _Smooth | float = 0.0
) -> tuple[_Smooth, _Smooth, _Smooth]:
    """Returns east, north and heading (degrees) on a circle to the left, from the origin to the north."""
    angle = clock * (TURN / lap)
    outward = clock * 0.0 + sway + radius
    return outward * angle.cos() + -radius, outward * angle.sin(), angle * DEGREES + 90.0


def _still(clock: _Smooth) -> Pose:
    """Level on a table, x to the east."""
    zero = clock * 0.0
    return zero, zero, zero, zero, zero, zero


def _turn(clock: _Smooth) -> Pose:
    """On a turntable: 30 degrees a second to the left."""
    zero = clock * 0.0
    return zero, zero, zero, zero, zero, clock * 30.0


def _tumble(clock: _Smooth) -> Pose:
    """In a gimbal: through all orientations, pitch beyond 90 degrees, at up to 2 rad/s."""
    zero = clock * 0.0
    roll = clock * 50.0 + _wave(clock, 40.0, 9.0)
    pitch = _wave(clock, 100.0, 11.0)
    yaw = clock * 20.0 + _wave(clock, 30.0, 7.0)
    return zero, zero, zero, roll, pitch, yaw


def _walk(clock: _Smooth) -> Pose:
    """On a walker's belt, 1.4 m/s round a circle of 50 m: a step every 0.55 s, swaying every two steps."""
    step = 0.55
    east, north, heading = _course(clock, 25.0, 112.0, sway=_wave(clock, 0.02, 2 * step))
    up = _wave(clock, 0.03, step)
    roll, pitch = _wave(clock, 3.0, 2 * step, 0.2), _wave(clock, 2.0, step, 0.1)
    return east, north, up, roll, pitch, heading + _wave(clock, 4.0, 2 * step)


def _drive(clock: _Smooth) -> Pose:
    """In a car, on a figure of eight, 300 m long, in 80 s, with changing speed, x along the velocity."""
    surge = 23.0
    along = clock * (TURN / 80.0) + _wave(clock, 0.1, surge)
    east, north = 150.0 * along.sin(), 75.0 * (along * 2.0).sin()
    # The direction of travel: never due north, so the angle from due south has no seam.
    heading = _arctan2(along.cos(), -1.0 * (along * 2.0).cos()) * DEGREES + -90.0
    # The body leans out of curves, and pitches down when it brakes.
    roll, pitch = -3.0 * along.sin(), _wave(clock, 1.0, surge)
    return east, north, clock * 0.0, roll, pitch, heading


def _arctan2(y: _Smooth, x: _Smooth) -> _Smooth:
    square = x.value**2 + y.value**2
    first = (x.value * y.first - y.value * x.first) / square
    growth = 2 * (x.value * x.first + y.value * y.first)
    second = (x.value * y.second - y.value * x.second - first * growth) / square
    return _Smooth(np.arctan2(y.value, x.value), first, second)


def _fly(clock: _Smooth) -> Pose:
    """In a small aeroplane, 40 m/s round a circle of 800 m, banked, climbing and sinking by 100 m."""
    radius, lap, climb = 400.0, 62.8, 90.0
    east, north, heading = _course(clock, radius, lap)
    up = 50.0 + _wave(clock, 50.0, climb, -0.25)
    # A coordinated turn with gusts; the nose follows the climb (up is negative pitch).
    bank = np.degrees(np.arctan(radius * (TURN / lap) ** 2 / G))
    nose = np.degrees(50.0 * TURN / climb) / 40.0
    roll = _wave(clock, 1.0, 3.1) + -bank
    return east, north, up, roll, _wave(clock, -nose, climb), heading


def _sail(clock: _Smooth) -> Pose:
    """On a boat, 3 m/s round a circle of 400 m, heeling, in waves every 6 s."""
    swell = 6.0
    east, north, heading = _course(clock, 200.0, 420.0)
    up = _wave(clock, 0.4, swell)
    roll, pitch = _wave(clock, 8.0, 5.0) + 10.0, _wave(clock, 4.0, swell, 0.25)
    return east, north, up, roll, pitch, heading + _wave(clock, 3.0, 9.0)


#: The built-in trajectories: a factory by name.
TRAJECTORIES: dict[str, Callable[[], Trajectory]] = {
    "still": lambda: _Formula(_still),
    "turn": lambda: _Formula(_turn),
    "tumble": lambda: _Formula(_tumble),
    "walk": lambda: _Formula(_walk),
    "drive": lambda: _Formula(_drive),
    "fly": lambda: _Formula(_fly),
    "sail": lambda: _Formula(_sail),
}


def trajectory(which: str | Trajectory) -> Trajectory:
    """Returns the built-in trajectory of a name; returns a trajectory unchanged.

    Raises:
        ValueError: No trajectory has this name.
        TypeError: The argument is neither a name nor a trajectory.

    >>> import numpy as np
    >>> trajectory("turn").at(np.array([0.0, 1.0])).rate_of_turn.round(3).tolist()
    [[0.0, 0.0, 0.524], [0.0, 0.0, 0.524]]
    """
    if isinstance(which, str):
        if which not in TRAJECTORIES:
            raise ValueError(
                f"no trajectory is called {which!r}; use one of {', '.join(TRAJECTORIES)}"
            )
        return TRAJECTORIES[which]()
    if not isinstance(which, Trajectory):
        raise TypeError(
            f"a trajectory is a name, or an object with origin and at(time), not {type(which).__name__}"
        )
    return which
