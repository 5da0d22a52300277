"""The ellipsoid on which the measurements of a magnetometer lie, by linear least squares."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from xbus.plots.thin import FloatArray

__all__ = ["Ellipsoid", "coverage", "fit_ellipsoid"]

#: Directions, evenly spaced on a sphere, that are seen or not.
DIRECTIONS = 200


class Ellipsoid(NamedTuple):
    """An ellipsoid of any position and orientation.

    Attributes:
        center: Its centre, ``(3,)``. Of magnetic fields, this is the hard iron.
        shape: Symmetric matrix of determinant 1 that turns it into a sphere, ``(3, 3)``: the inverse of the
            soft iron, up to scale and rotation.
        radius: Radius of this sphere.
        condition: Condition number of the equations; a number above 20 means that the points determine the
            ellipsoid badly.
    """

    center: FloatArray
    shape: FloatArray
    radius: float
    condition: float

    @property
    def axes(self) -> FloatArray:
        """Lengths of the semi-axes, ascending, ``(3,)``."""
        return np.asarray(self.radius / np.linalg.eigvalsh(self.shape)[::-1], np.float64)

    def corrected(self, points: FloatArray) -> FloatArray:
        """Returns points on the ellipsoid as points on a sphere around the origin, ``(N, 3)``."""
        return np.asarray((points - self.center) @ self.shape)


def fit_ellipsoid(points: FloatArray) -> Ellipsoid | None:
    """Returns the ellipsoid that fits points best; None if a surface of another kind fits better.

    The algebraic fit: the sum of squared residuals of the equation of a quadric, whose quadratic part has a
    constant trace. This makes the fit independent of position and scale.

    Args:
        points: ``(N, 3)`` finite numbers; at least nine that are not equal.

    >>> import numpy as np
    >>> sphere = np.random.default_rng(1).normal(size=(100, 3))
    >>> sphere /= np.linalg.norm(sphere, axis=1)[:, None]
    >>> found = fit_ellipsoid(sphere * [1, 2, 4] + [5, 6, 7])
    >>> found.center.round(6).tolist(), found.axes.round(6).tolist(), round(found.radius, 6)
    ([5.0, 6.0, 7.0], [1.0, 2.0, 4.0], 2.0)
    """
    mean = points.mean(axis=0)
    scale = float(np.sqrt(np.square(points - mean).sum(axis=1).mean()))
    if not scale > 0:
        return None
    x, y, z = (points - mean).T / scale
    xx, yy, zz = x * x, y * y, z * z
    one = np.ones_like(x)
    equations = np.stack(
        [
            xx + yy - 2 * zz,
            xx + zz - 2 * yy,
            *(2 * x * y, 2 * x * z, 2 * y * z, 2 * x, 2 * y, 2 * z),
            one,
        ],
        axis=1,
    )
    size = np.sqrt(np.square(equations).mean(axis=0))
    if not size.all():
        return None  # in a plane of the axes
    found, _, rank, singular = np.linalg.lstsq(equations / size, xx + yy + zz, rcond=None)
    if rank < equations.shape[1]:
        return None
    u = found / size
    quadric = np.array(
        [
            [u[0] + u[1] - 1, u[2], u[3]],
            [u[2], u[0] - 2 * u[1] - 1, u[4]],
            [u[3], u[4], u[1] - 2 * u[0] - 1],
        ]
    )
    values, vectors = np.linalg.eigh(quadric)
    if not values.all():
        return None  # a paraboloid or a cylinder
    center = vectors @ ((vectors.T @ -u[5:8]) / values)
    values = values / (center @ quadric @ center - u[8])
    if not (np.isfinite(values).all() and (values > 0).all()):
        return None  # a hyperboloid
    radius = float(np.prod(values) ** (-1 / 6))
    shape = (vectors * (np.sqrt(values) * radius)) @ vectors.T
    return Ellipsoid(
        mean + scale * center, shape, scale * radius, float(singular[0] / singular[-1])
    )


def coverage(vectors: FloatArray) -> float:
    """Returns the share of the directions of a sphere, 0 to 1, to which a vector is close.

    Args:
        vectors: ``(N, 3)``, none of them zero.

    >>> import numpy as np
    >>> coverage(np.random.default_rng(1).normal(size=(10_000, 3))), coverage(np.array([[0, 0, 1.0]]))
    (1.0, 0.005)
    """
    # Fibonacci's lattice: equal areas of 13 degrees.
    number = np.arange(DIRECTIONS)
    height = 1 - (2 * number + 1) / DIRECTIONS
    angle = np.pi * (1 + np.sqrt(5)) * number
    width = np.sqrt(1 - height**2)
    lattice = np.stack([width * np.cos(angle), width * np.sin(angle), height])
    return len(np.unique(np.argmax(vectors @ lattice, axis=1))) / DIRECTIONS
