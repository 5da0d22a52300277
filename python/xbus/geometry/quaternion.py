"""Quaternions: q0 first, Hamilton's product, rotating from the sensor to the local frame.

As on the wire (section 5.3.6). Quaternions are (..., 4), vectors (..., 3), all float64; leading axes
broadcast. Functions do not normalise unless they say so.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from xbus.geometry.earth import FloatArray

__all__ = [
    "body_rate",
    "conjugate",
    "continuous",
    "delta",
    "from_euler",
    "from_matrix",
    "from_rotation_vector",
    "multiply",
    "products_of_matrix",
    "rotate",
    "slerp",
    "to_euler",
    "to_matrix",
]


def multiply(p: FloatArray, q: FloatArray) -> FloatArray:
    """Returns the product of quaternions: as a rotation, first `q`, then `p`."""
    p0, p1, p2, p3 = np.moveaxis(p, -1, 0)
    q0, q1, q2, q3 = np.moveaxis(q, -1, 0)
    return np.stack(
        [
            p0 * q0 - p1 * q1 - p2 * q2 - p3 * q3,
            p0 * q1 + p1 * q0 + p2 * q3 - p3 * q2,
            p0 * q2 - p1 * q3 + p2 * q0 + p3 * q1,
            p0 * q3 + p1 * q2 - p2 * q1 + p3 * q0,
        ],
        axis=-1,
    )


def conjugate(q: FloatArray) -> FloatArray:
    """Returns the conjugate: for a unit quaternion, the inverse rotation."""
    return np.asarray(q * np.array([1.0, -1.0, -1.0, -1.0]))


def delta(before: FloatArray, after: FloatArray) -> FloatArray:
    """Returns the rotation from `before` to `after`, as in `delta_q`: ``multiply(before, delta) == after``.

    >>> import numpy as np
    >>> q = np.array([[1.0, 0, 0, 0], [0.8, 0, 0, 0.6]])
    >>> delta(q[:1], q[1:]).tolist()
    [[0.8, 0.0, 0.0, 0.6]]
    """
    return multiply(conjugate(before), after)


def rotate(q: FloatArray, vector: FloatArray) -> FloatArray:
    """Returns a vector of the sensor frame in the local frame; with `conjugate`, the inverse."""
    u = q[..., 1:]
    t = 2 * np.cross(u, vector)
    return np.asarray(vector + q[..., :1] * t + np.cross(u, t))


def body_rate(q: FloatArray, derivative: FloatArray) -> FloatArray:
    """Returns the rate of turn in rad/s in the sensor frame, of a quaternion and its derivative."""
    turning = 2 * multiply(conjugate(q), derivative)[..., 1:]
    return np.asarray(turning / np.sum(q * q, axis=-1, keepdims=True))


def continuous(q: FloatArray) -> FloatArray:
    """Returns the same rotations (n, 4), each with the sign nearer to the previous one."""
    flips = np.sum(q[1:] * q[:-1], axis=-1) < 0
    signs = np.cumprod(np.where(np.concatenate([[False], flips]), -1.0, 1.0))
    return np.asarray(q * signs[:, np.newaxis])


def slerp(before: FloatArray, after: FloatArray, weight: npt.ArrayLike) -> FloatArray:
    """Returns unit quaternions between two: the shorter rotation, about a fixed axis at a constant rate.

    Args:
        before: Quaternions (..., 4) of any norm; the result of one of zeros is NaN.
        after: The same.
        weight: Place between the two, from 0 to 1, ``(...)``.

    >>> import numpy as np
    >>> slerp(np.array([1.0, 0, 0, 0]), np.array([0.0, 0, 0, 1]), 0.5).round(4).tolist()
    [0.7071, 0.0, 0.0, 0.7071]
    """
    with np.errstate(invalid="ignore"):
        p, q = (r / np.linalg.norm(r, axis=-1, keepdims=True) for r in (before, after))
    q = np.where(np.sum(p * q, axis=-1, keepdims=True) < 0, -q, q)
    # Half of the rotation, from 0 to 90 degrees; precise for small angles, as the arc cosine is not.
    chord = np.linalg.norm(q - p, axis=-1, keepdims=True)
    angle = 2 * np.arctan2(chord, np.linalg.norm(q + p, axis=-1, keepdims=True)) / np.pi
    u = np.asarray(weight, np.float64)[..., np.newaxis]
    mixed = (1 - u) * np.sinc((1 - u) * angle) * p + u * np.sinc(u * angle) * q
    return np.asarray(mixed / np.sinc(angle))


def from_rotation_vector(vector: FloatArray) -> FloatArray:
    """Returns the rotation about `vector` by its norm in radians.

    >>> import numpy as np
    >>> from_rotation_vector(np.array([0, 0, np.pi / 2])).round(4).tolist()
    [0.7071, 0.0, 0.0, 0.7071]
    """
    angle = np.linalg.norm(vector, axis=-1, keepdims=True)
    # numpy's sinc is sin(pi x) / (pi x), and 1 at zero.
    return np.concatenate([np.cos(angle / 2), vector / 2 * np.sinc(angle / (2 * np.pi))], axis=-1)


def from_euler(euler: npt.ArrayLike) -> FloatArray:
    """Returns the rotation of roll, pitch and yaw in degrees (..., 3): first yaw, then pitch, then roll.

    The sign is continuous: angles that pass 180 degrees smoothly give quaternions that do.

    >>> from_euler([0.0, 0.0, 90.0]).round(4).tolist()
    [0.7071, 0.0, 0.0, 0.7071]
    """
    half = np.radians(np.asarray(euler, np.float64)) / 2
    (cr, cp, cy), (sr, sp, sy) = np.moveaxis(np.cos(half), -1, 0), np.moveaxis(np.sin(half), -1, 0)
    return np.stack(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ],
        axis=-1,
    )


def to_euler(q: FloatArray) -> FloatArray:
    """Returns roll, pitch and yaw of unit quaternions, in degrees (..., 3); pitch from -90 to 90.

    >>> import numpy as np
    >>> to_euler(from_euler([10.0, 20.0, -170.0])).round(9).tolist()
    [10.0, 20.0, -170.0]
    """
    q0, q1, q2, q3 = np.moveaxis(q, -1, 0)
    roll = np.arctan2(2 * (q0 * q1 + q2 * q3), 1 - 2 * (q1 * q1 + q2 * q2))
    pitch = np.arcsin(np.clip(2 * (q0 * q2 - q1 * q3), -1, 1))
    yaw = np.arctan2(2 * (q0 * q3 + q1 * q2), 1 - 2 * (q2 * q2 + q3 * q3))
    return np.asarray(np.degrees(np.stack([roll, pitch, yaw], axis=-1)))


def to_matrix(q: FloatArray) -> FloatArray:
    """Returns the rotation matrices (..., 3, 3) of unit quaternions: ``matrix @ sensor == local``."""
    # The columns are the axes of the sensor, seen from the local frame.
    return np.asarray(np.swapaxes(rotate(q[..., np.newaxis, :], np.eye(3)), -1, -2))


def from_matrix(matrix: npt.ArrayLike) -> FloatArray:
    """Returns the unit quaternions of rotation matrices (..., 3, 3), with q0 of either sign."""
    rows = products_of_matrix(matrix)
    # The longest row is the most precise.
    best = np.argmax(np.einsum("...ii->...i", rows), axis=-1)
    q = np.take_along_axis(rows, best[..., None, None], -2)[..., 0, :]
    return np.asarray(q / np.linalg.norm(q, axis=-1, keepdims=True))


def products_of_matrix(matrix: npt.ArrayLike) -> FloatArray:
    """Returns the products 4 qi qj of rotation matrices (..., 3, 3), as (..., 4, 4).

    Each row is a multiple of the quaternion.

    >>> products_of_matrix([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])[0].tolist()  # yaw 90 degrees
    [2.0, 0.0, 0.0, 2.0]
    """
    m = np.moveaxis(np.asarray(matrix, np.float64), (-2, -1), (0, 1))
    trace = np.trace(m)
    rows = np.array(
        [
            [1 + trace, m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]],
            [m[2, 1] - m[1, 2], 1 + 2 * m[0, 0] - trace, m[0, 1] + m[1, 0], m[0, 2] + m[2, 0]],
            [m[0, 2] - m[2, 0], m[0, 1] + m[1, 0], 1 + 2 * m[1, 1] - trace, m[1, 2] + m[2, 1]],
            [m[1, 0] - m[0, 1], m[0, 2] + m[2, 0], m[1, 2] + m[2, 1], 1 + 2 * m[2, 2] - trace],
        ]
    )
    return np.moveaxis(rows, (0, 1), (-2, -1))
