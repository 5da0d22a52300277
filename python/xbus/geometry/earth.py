"""The Earth: the WGS84 ellipsoid, gravity, magnetic field and air pressure.

All functions work element by element on numpy arrays of any shape.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from xbus.protocol.values import LatLonAlt

__all__ = [
    "GEOID_SEPARATION",
    "MAGNETIC_INCLINATION",
    "ORIGIN",
    "ecef_to_enu",
    "ecef_to_geodetic",
    "enu_to_ecef",
    "enu_to_geodetic",
    "geodetic_to_ecef",
    "gravity",
    "magnetic_field",
    "pressure",
]

FloatArray: TypeAlias = npt.NDArray[np.float64]

#: WGS84: semi-major axis in metres, flattening, and derived constants.
A = 6378137.0
F = 1 / 298.257223563
B = A * (1 - F)
E2 = F * (2 - F)

#: Default start of a trajectory: Enschede, in degrees and metres above the ellipsoid.
ORIGIN = LatLonAlt(52.2405, 6.8382, 81.5)
#: Metres of the geoid above the ellipsoid at `ORIGIN`, used everywhere: to subtract for height above sea.
GEOID_SEPARATION = 42.8
#: Inclination of the magnetic field at `ORIGIN` in degrees, used everywhere.
MAGNETIC_INCLINATION = 67.0


def geodetic_to_ecef(lat: npt.ArrayLike, lon: npt.ArrayLike, alt: npt.ArrayLike) -> FloatArray:
    """Returns ECEF metres (..., 3) of latitude, longitude (degrees) and height (metres).

    >>> geodetic_to_ecef(0.0, 90.0, 100.0).round(3).tolist()
    [0.0, 6378237.0, 0.0]
    """
    phi, lam, height = np.radians(lat), np.radians(lon), np.asarray(alt, np.float64)
    radius = A / np.sqrt(1 - E2 * np.sin(phi) ** 2)
    across = (radius + height) * np.cos(phi)
    up = (radius * (1 - E2) + height) * np.sin(phi)
    return np.stack(np.broadcast_arrays(across * np.cos(lam), across * np.sin(lam), up), axis=-1)


def ecef_to_geodetic(ecef: npt.ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Returns latitude, longitude (degrees) and height above the ellipsoid (metres) of ECEF metres (..., 3).

    The error is less than 1e-9 degrees and 1e-6 m from 1 km below the ellipsoid to 20 km above, also at
    the poles.

    >>> lat, lon, alt = ecef_to_geodetic([0.0, 6378237.0, 0.0])
    >>> float(lat), float(lon), float(alt)
    (0.0, 90.0, 100.0)
    """
    x, y, z = np.moveaxis(np.asarray(ecef, np.float64), -1, 0)
    across = np.hypot(x, y)
    # Bowring's formula; near the surface its second iteration reaches the precision of float64.
    beta = np.arctan2(A * z, B * across)
    for _ in range(2):
        phi = np.arctan2(
            z + E2 / (1 - E2) * B * np.sin(beta) ** 3, across - E2 * A * np.cos(beta) ** 3
        )
        beta = np.arctan2((1 - F) * np.sin(phi), np.cos(phi))
    height = across * np.cos(phi) + z * np.sin(phi) - A * np.sqrt(1 - E2 * np.sin(phi) ** 2)
    return np.degrees(phi), np.degrees(np.arctan2(y, x)), height


def _enu_axes(origin: LatLonAlt) -> FloatArray:
    """Returns the axes east, north and up at `origin`, as rows in ECEF, (3, 3)."""
    phi, lam = np.radians(origin.lat), np.radians(origin.lon)
    (sp, cp), (sl, cl) = (np.sin(phi), np.cos(phi)), (np.sin(lam), np.cos(lam))
    return np.array([[-sl, cl, 0], [-sp * cl, -sp * sl, cp], [cp * cl, cp * sl, sp]])


def enu_to_ecef(position: npt.ArrayLike, origin: LatLonAlt) -> FloatArray:
    """Returns ECEF metres (..., 3) of metres east, north and up of `origin` (..., 3).

    The axes are those at the origin: at 10 km, the plane is 8 m above the surface of the Earth.

    >>> enu_to_ecef([5.0, 0.0, 0.0], LatLonAlt(0.0, 90.0, 100.0)).round(3).tolist()
    [-5.0, 6378237.0, 0.0]
    """
    return geodetic_to_ecef(*origin) + np.asarray(position, np.float64) @ _enu_axes(origin)


def ecef_to_enu(ecef: npt.ArrayLike, origin: LatLonAlt) -> FloatArray:
    """Returns metres east, north and up of `origin` (..., 3), the inverse of `enu_to_ecef`."""
    return (np.asarray(ecef, np.float64) - geodetic_to_ecef(*origin)) @ _enu_axes(origin).T


def enu_to_geodetic(
    position: npt.ArrayLike, origin: LatLonAlt
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Returns latitude, longitude (degrees) and height (metres) of metres east, north and up of `origin`."""
    return ecef_to_geodetic(enu_to_ecef(position, origin))


def gravity(lat: npt.ArrayLike, alt: npt.ArrayLike) -> FloatArray:
    """Returns the acceleration of gravity in m/s2 at a latitude in degrees and a height in metres.

    Somigliana's formula of WGS84 with the correction for height to second order.

    >>> float(gravity(45.0, 0.0).round(5)), float(gravity(90.0, 1000.0).round(5))
    (9.8062, 9.8291)
    """
    sine2 = np.sin(np.radians(lat)) ** 2
    height = np.asarray(alt, np.float64) / A
    surface = 9.7803253359 * (1 + 0.00193185265241 * sine2) / np.sqrt(1 - E2 * sine2)
    # 0.00344978650684 is the ratio of centrifugal force to gravity at the equator.
    falloff = 1 + F + 0.00344978650684 - 2 * F * sine2
    return np.asarray(surface * (1 - 2 * falloff * height + 3 * height**2))


def magnetic_field() -> FloatArray:
    """Returns the magnetic field, east, north and up (3,), in units of its norm at calibration.

    This is the field at `ORIGIN`, used everywhere, with a declination of zero: magnetic north is true north.
    """
    dip = np.radians(MAGNETIC_INCLINATION)
    return np.array([0.0, np.cos(dip), -np.sin(dip)])


def pressure(alt: npt.ArrayLike) -> FloatArray:
    """Returns the air pressure in Pa of the standard atmosphere (ISA) at metres above sea, up to 20 km.

    >>> pressure([0.0, 1000.0, 11000.0, 20000.0]).round().tolist()
    [101325.0, 89875.0, 22632.0, 5475.0]
    """
    height = np.asarray(alt, np.float64)
    below = 101325.0 * (1 - 0.0065 / 288.15 * np.minimum(height, 11000.0)) ** 5.255880
    # Above 11 km the temperature stays at 216.65 K.
    return np.asarray(below * np.exp(-np.maximum(height - 11000.0, 0.0) / 6341.62))
