"""The built-in trajectories, smooth for all time and without growth: they go round and round."""

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
    """A function of time with its first and second derivative, carried through sums and products."""

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
TURN = 2 * np.pi
DEGREES = 180 / np.pi


class _Path:
    """A trajectory by formula."""

    origin = ORIGIN

    def __init__(self, pose: Callable[[_Smooth], Pose]) -> None:
        self._pose = pose

    def at(self, time: FloatArray) -> Motion:
        time = np.asarray(time, np.float64)
        clock = _Smooth(time, np.ones_like(time), np.zeros_like(time))
        east, north, up, *angles = self._pose(clock)
        place = (east, north, up)
        euler = np.stack([it.value for it in angles], axis=1)
        return Motion(
            time=time,
            orientation=quaternion.from_euler(euler),
            rate_of_turn=_euler_to_body_rate(euler, *(np.radians(it.first) for it in angles)),
            acceleration=np.stack([it.second for it in place], axis=1),
            velocity=np.stack([it.first for it in place], axis=1),
            position=np.stack([it.value for it in place], axis=1),
        )


def _euler_to_body_rate(
    euler: FloatArray, roll_rate: FloatArray, pitch_rate: FloatArray, yaw_rate: FloatArray
) -> FloatArray:
    """Rate of turn in the sensor frame, of Euler angles in degrees and their rates in rad/s."""
    roll, pitch, _ = np.radians(euler.T)
    level = yaw_rate * np.cos(pitch)
    x = roll_rate - yaw_rate * np.sin(pitch)
    y = pitch_rate * np.cos(roll) + level * np.sin(roll)
    z = level * np.cos(roll) - pitch_rate * np.sin(roll)
    return np.stack([x, y, z], axis=1)


def _wave(clock: _Smooth, amplitude: float, period: float, phase: float = 0.0) -> _Smooth:
    """A sine of time, with its phase as a part of the period."""
    return amplitude * (clock * (TURN / period) + TURN * phase).sin()


def _course(
    clock: _Smooth, radius: float, lap: float, sway: _Smooth | float = 0.0
) -> tuple[_Smooth, _Smooth, _Smooth]:
    """East, north and heading (degrees) on a circle to the left that starts at the origin, to the north."""
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
    """On somebody's belt, 1.4 m/s round a circle of 50 m: a step every 0.55 s, swaying with every second."""
    step = 0.55
    east, north, heading = _course(clock, 25.0, 112.0, sway=_wave(clock, 0.02, 2 * step))
    up = _wave(clock, 0.03, step)
    roll, pitch = _wave(clock, 3.0, 2 * step, 0.2), _wave(clock, 2.0, step, 0.1)
    return east, north, up, roll, pitch, heading + _wave(clock, 4.0, 2 * step)


def _drive(clock: _Smooth) -> Pose:
    """In a car, on a figure of eight, 300 m long, in 80 s: slower and faster, x along the velocity."""
    surge = 23.0
    along = clock * (TURN / 80.0) + _wave(clock, 0.1, surge)
    east, north = 150.0 * along.sin(), 75.0 * (along * 2.0).sin()
    # The direction of travel: never due north, so the angle from due south has no seam.
    heading = _arctan2(along.cos(), -1.0 * (along * 2.0).cos()) * DEGREES + -90.0
    # The body leans out of curves, and noses down where it slows.
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
    # Banked as the turn asks for, but for gusts; the nose follows the climb (up is negative pitch).
    bank = np.degrees(np.arctan(radius * (TURN / lap) ** 2 / 9.81))
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


#: The built-in trajectories by name: call one to get it.
TRAJECTORIES: dict[str, Callable[[], Trajectory]] = {
    "still": lambda: _Path(_still),
    "turn": lambda: _Path(_turn),
    "tumble": lambda: _Path(_tumble),
    "walk": lambda: _Path(_walk),
    "drive": lambda: _Path(_drive),
    "fly": lambda: _Path(_fly),
    "sail": lambda: _Path(_sail),
}


def trajectory(which: str | Trajectory) -> Trajectory:
    """The built-in trajectory of this name, or what is one already.

    Raises:
        ValueError: No trajectory has this name.
        TypeError: Neither a name nor a trajectory.

    >>> import numpy as np
    >>> trajectory("turn").at(np.array([0.0, 1.0])).rate_of_turn.round(3).tolist()
    [[0.0, 0.0, 0.524], [0.0, 0.0, 0.524]]
    """
    if isinstance(which, str):
        if which not in TRAJECTORIES:
            raise ValueError(f"no trajectory {which!r}; there are {', '.join(TRAJECTORIES)}")
        return TRAJECTORIES[which]()
    if not isinstance(which, Trajectory):
        raise TypeError(
            f"a trajectory is a name or has origin and at(time); {type(which).__name__} is neither"
        )
    return which
