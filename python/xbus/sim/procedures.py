"""Procedures of the Measurement State, as functions of the motion. Times are in ns."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np

from xbus.geometry import quaternion
from xbus.geometry.earth import FloatArray
from xbus.protocol.values import IccResult, IccStatus, ResetCode
from xbus.sim.clock import SECOND
from xbus.sim.memory import NO_ROTATION
from xbus.sim.motion import Motion, Trajectory

__all__ = ["Rotation", "icc_result", "is_still", "reset"]

#: A quaternion, q0 first.
Rotation: TypeAlias = tuple[float, float, float, float]

#: Rate of turn in rad/s from which a device counts as moving.
MOVING = np.radians(0.5)
#: Seconds between two evaluations of the motion, and the most evaluations of an interval.
INTERVAL, MOST_INTERVALS = 0.02, 100_000
#: A representative motion has at least a full turn (rad). With this much tilt it covers all three axes.
ENOUGH_TURN = 2 * np.pi
TILT_3D = np.radians(30.0)
#: The ddt (ratio of disturbance and noise) of an endless motion.
HIGHEST_DDT = 8.0


def reset(
    code: ResetCode, orientation: FloatArray, rot_sensor: Rotation, rot_local: Rotation
) -> tuple[Rotation, Rotation]:
    """Returns the alignment rotations after an orientation reset (Table 33).

    Args:
        code: The reset.
        orientation: Orientation of the housing, a unit quaternion ``(4,)``, q0 first.
        rot_sensor: RotSensor before.
        rot_local: RotLocal before.

    Returns:
        RotSensor and RotLocal. The output is ``rot_local * orientation * rot_sensor``. An inclination reset
        makes it level and keeps the heading. A heading reset makes the heading zero.
    """
    match code:
        case ResetCode.DEFAULT_HEADING:
            return rot_sensor, NO_ROTATION
        case ResetCode.DEFAULT_INCLINATION:
            return NO_ROTATION, rot_local
        case ResetCode.DEFAULT_ALIGNMENT:
            return NO_ROTATION, NO_ROTATION
    sensor, local = _unit(rot_sensor), _unit(rot_local)
    if code == ResetCode.GLOBAL:
        # The present axes of the sensor become the local ones.
        seen = quaternion.multiply(orientation, sensor)
        return rot_sensor, _rotation(quaternion.conjugate(seen))
    output = quaternion.multiply(local, quaternion.multiply(orientation, sensor))
    yaw = quaternion.to_euler(output)[2]
    heading = quaternion.from_euler([0.0, 0.0, yaw])
    if code != ResetCode.HEADING:
        level = quaternion.multiply(quaternion.conjugate(output), heading)
        rot_sensor = _rotation(quaternion.multiply(sensor, level))
    if code != ResetCode.INCLINATION:
        rot_local = _rotation(quaternion.multiply(quaternion.conjugate(heading), local))
    return rot_sensor, rot_local


def _unit(rotation: Rotation) -> FloatArray:
    return np.array(rotation) / float(np.linalg.norm(rotation))


def _rotation(q: FloatArray) -> Rotation:
    q0, q1, q2, q3 = q.tolist()
    return q0, q1, q2, q3


def _motion(trajectory: Trajectory, start: int, end: int) -> Motion:
    """Returns the motion between two times in ns."""
    intervals = min(round((end - start) / SECOND / INTERVAL), MOST_INTERVALS)
    return trajectory.at(np.linspace(start / SECOND, end / SECOND, intervals + 2))


def is_still(trajectory: Trajectory, start: int, end: int) -> bool:
    """Returns whether the trajectory does not turn between two times in ns."""
    rates = np.linalg.norm(_motion(trajectory, start, end).rate_of_turn, axis=1)
    return bool(rates.max() < MOVING)


def icc_result(trajectory: Trajectory, start: int, end: int) -> IccResult:
    """Returns the result of in-run compass calibration with the motion between two times in ns (Table 39).

    The magnetic field is undisturbed, so the only possible failure is too little motion.
    """
    motion = _motion(trajectory, start, end)
    turn = np.linalg.norm(motion.rate_of_turn, axis=1).mean() * (end - start) / SECOND
    down = quaternion.rotate(quaternion.conjugate(motion.orientation), np.array([0.0, 0.0, -1.0]))
    tilt = np.arccos(np.clip(down @ down[0], -1.0, 1.0)).max()
    return IccResult(
        ddt=float(HIGHEST_DDT * turn / (turn + ENOUGH_TURN)),
        dimension=3 if tilt >= TILT_3D else 2,
        status=IccStatus(0) if turn >= ENOUGH_TURN else IccStatus.NOT_ENOUGH_DATA,
    )
