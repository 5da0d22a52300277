"""Procedures that a device does while it measures, as functions of its motion. Times are in ns."""

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

#: rad/s from which on a device does not stand still.
MOVING = np.radians(0.5)
#: Seconds between two looks at the motion, and how many looks at most.
LOOK, MOST_LOOKS = 0.02, 100_000
#: A representative motion takes at least a full turn (rad); with so much tilt it says something of all axes.
ENOUGH_TURN = 2 * np.pi
TILT_3D = np.radians(30.0)
#: Ratio of disturbance and noise that a motion without end comes to.
HIGHEST_DDT = 8.0


def reset(
    code: ResetCode, orientation: FloatArray, rot_sensor: Rotation, rot_local: Rotation
) -> tuple[Rotation, Rotation]:
    """What an orientation reset (Table 33) makes of the alignment rotations.

    Args:
        code: Which one.
        orientation: Of the housing, (4,).
        rot_sensor: RotSensor before.
        rot_local: RotLocal before.

    Returns:
        RotSensor and RotLocal. The output, ``rot_local * orientation * rot_sensor``, is level after a reset
        of the inclination, with the heading that it had, and has a heading of zero after one of the heading.
    """
    match code:
        case ResetCode.DEFAULT_HEADING:
            return rot_sensor, NO_ROTATION
        case ResetCode.DEFAULT_INCLINATION:
            return NO_ROTATION, rot_local
        case ResetCode.DEFAULT_ALIGNMENT:
            return NO_ROTATION, NO_ROTATION
    sensor, local = _unit(rot_sensor), _unit(rot_local)
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
    """How it moved between two times in ns."""
    looks = min(round((end - start) / SECOND / LOOK), MOST_LOOKS) + 2
    return trajectory.at(np.linspace(start / SECOND, end / SECOND, looks))


def is_still(trajectory: Trajectory, start: int, end: int) -> bool:
    """Whether it did not turn between two times in ns."""
    rates = np.linalg.norm(_motion(trajectory, start, end).rate_of_turn, axis=1)
    return bool(rates.max() < MOVING)


def icc_result(trajectory: Trajectory, start: int, end: int) -> IccResult:
    """What a representative motion between two times in ns gives (Table 39).

    The field is undisturbed, so the worst that can happen is that it was too little of a motion.
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
