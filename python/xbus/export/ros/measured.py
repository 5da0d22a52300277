"""What the samples of a part measured, one row for each sample, in the coordinates of the file."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from functools import cached_property
from typing import Any, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from xbus.export.part import Part, PartColumn
from xbus.export.valid import has_filter_fix, is_place
from xbus.geometry import quaternion
from xbus.protocol.formats import COORDINATE_BITS
from xbus.protocol.ids import Coordinates
from xbus.protocol.tables import QUANTITIES

__all__ = [
    "ENU",
    "ORIENTED",
    "Measured",
    "Rows",
    "columns_of",
    "euler_of",
    "inner",
    "outer",
    "system_of",
    "xyzw",
]

FloatArray = npt.NDArray[np.float64]

ENU = "ENU"
#: Quantities whose identifiers name a coordinate system.
ORIENTED = tuple(name for name, row in QUANTITIES.items() if row.coordinates)
#: The rotation from each coordinate system to ENU, q0 first.
TO_ENU = {
    "ENU": np.array([1.0, 0, 0, 0]),
    "NED": np.array([0, np.sqrt(0.5), np.sqrt(0.5), 0]),
    "NWU": np.array([np.sqrt(0.5), 0, 0, np.sqrt(0.5)]),
}
#: The components of a vector in ENU, of one in each coordinate system: their places and signs.
AXES_TO_ENU = {
    "ENU": ([0, 1, 2], [1.0, 1.0, 1.0]),
    "NED": ([1, 0, 2], [1.0, 1.0, -1.0]),
    "NWU": ([1, 0, 2], [-1.0, 1.0, 1.0]),
}
#: Coordinate systems by the bits of a data identifier (Table 17).
SYSTEMS = {int(system): system.name for system in Coordinates}
#: 4 q0 q0 whose square is below this is zero for the vendor's code.
TINY = 1e-16


class Rows(NamedTuple):
    """Values of samples.

    Attributes:
        sample: Index of the sample from the first one of the part, ``(n,)`` int64, rising.
        values: One row for each.
    """

    sample: npt.NDArray[np.int64]
    values: npt.NDArray[Any]

    def at(self, sample: npt.NDArray[np.int64]) -> npt.NDArray[Any]:
        """Returns the values of some samples, which all have one."""
        if len(sample) == len(self.sample):
            return self.values
        return np.asarray(self.values[np.searchsorted(self.sample, sample)])

    def has(self, sample: npt.NDArray[np.int64]) -> npt.NDArray[np.bool_]:
        """Returns whether samples, which rise and are a superset of these, have a value."""
        if len(sample) == len(self.sample):
            return np.ones(len(sample), np.bool_)
        found = np.zeros(len(sample), np.bool_)
        found[np.searchsorted(sample, self.sample)] = True
        return found


def inner(*several: Rows) -> npt.NDArray[np.int64]:
    """Returns the samples that have all of these."""
    sample = several[0].sample
    for rows in several[1:]:
        if not np.array_equal(sample, rows.sample):
            sample = np.intersect1d(sample, rows.sample, assume_unique=True)
    return sample


def outer(*several: Rows) -> npt.NDArray[np.int64]:
    """Returns the samples that have any of these."""
    sample = several[0].sample
    for rows in several[1:]:
        if not len(sample):
            sample = rows.sample
        elif len(rows.sample) and not np.array_equal(sample, rows.sample):
            sample = np.union1d(sample, rows.sample)
    return sample


def columns_of(part: Part, name: str) -> list[PartColumn]:
    """Returns the columns of a quantity: several if it occurs in several coordinate systems."""
    return [part[key] for key in part if key == name or (isinstance(key, tuple) and key[0] == name)]


def xyzw(q: FloatArray) -> FloatArray:
    """Returns quaternions, q0 first, in the order of ROS."""
    return np.concatenate([q[:, 1:], q[:, :1]], axis=1)


def euler_of(q: FloatArray) -> FloatArray:
    """Returns roll, pitch and yaw in degrees ``(n, 3)`` as the vendor's code does.

    For a quaternion that float32 rounds, the result differs from that of `quaternion.to_euler`.
    """
    w, x, y, z = np.moveaxis(q, -1, 0)
    roll = np.arctan2(2 * (y * z + w * x), 2 * (w * w + z * z) - 1)
    pitch = -np.arcsin(np.clip(2 * (x * z - w * y), -1, 1))
    yaw = np.arctan2(2 * (x * y + w * z), 2 * (w * w + x * x) - 1)
    return np.asarray(np.degrees(np.stack([roll, pitch, yaw], axis=-1)))


def _from_matrix(values: npt.NDArray[Any]) -> FloatArray:
    q = quaternion.from_matrix(values)
    return np.where(q[:, :1] < 0, -q, q)


def _from_matrix_of_driver(values: npt.NDArray[Any]) -> FloatArray:
    """Returns quaternions as the vendor's code does: from q0 where its square is not tiny, not normalised.

    For a matrix that float32 rounds, the result differs from that of `quaternion.from_matrix`.
    """
    rows = quaternion.products_of_matrix(values)
    squares, (xx, yy, zz) = np.einsum("nii->in", rows), np.einsum("nii->in", values)
    conditions = [squares[0] ** 2 >= TINY, (xx > yy) & (xx > zz), yy > zz]
    row = np.select(conditions, [0, 1, 2], 3)
    q = np.take_along_axis(rows, row[:, np.newaxis, np.newaxis], 1)[:, 0]
    length = 2 * np.sqrt(np.take_along_axis(squares, row[np.newaxis], 0)[0])
    return np.asarray(q / np.where(row == 0, length, -length)[:, np.newaxis])


Quaternions = dict[str, Callable[[npt.NDArray[Any]], FloatArray]]
#: Orientation as quaternions, q0 first, from each quantity that has it, the preferred one last.
QUATERNIONS: Quaternions = {
    "euler_angles": quaternion.from_euler,
    "rotation_matrix": _from_matrix,
    "quaternion": lambda values: values.astype(np.float64),
}
#: The same as the vendor's code computes them.
QUATERNIONS_OF_DRIVER: Quaternions = QUATERNIONS | {"rotation_matrix": _from_matrix_of_driver}


class Measured:
    """What the samples of a part measured.

    If a packet occurs twice in a sample, the last one counts.

    Args:
        part: The part.
        converts: Whether to convert coordinates to ENU.
        is_driver: Whether to compute orientation as the vendor's code does.
        samples: Indices of samples from the first one of the part; None for all.
        only: Which of these samples count, ``(n,)``; None for all.
    """

    def __init__(
        self,
        part: Part,
        *,
        converts: bool,
        is_driver: bool,
        samples: range | None = None,
        only: npt.NDArray[np.bool_] | None = None,
    ) -> None:
        self._part, self._converts, self._only = part, converts, only
        self._samples = range(len(part)) if samples is None else samples
        self._quaternions = QUATERNIONS_OF_DRIVER if is_driver else QUATERNIONS

    def _columns(
        self, name: str, field: Literal["values", "datetime"] = "values"
    ) -> Iterator[tuple[PartColumn, Rows]]:
        """Yields the columns of a quantity with what they have of the samples."""
        begin = self._part.first_sample
        edges = np.array([self._samples.start, self._samples.stop]) + begin
        for column in columns_of(self._part, name):
            first, last = np.searchsorted(column.sample, edges)
            sample, values = column.sample[first:last] - begin, getattr(column, field)[first:last]
            if self._only is not None:
                keep = self._only[sample - self._samples.start]
                sample, values = sample[keep], values[keep]
            yield column, Rows(sample, values)

    def rows(self, name: str) -> Rows:
        """Returns a quantity as it was received; structs as raw integers."""
        return _joined(rows for _, rows in self._columns(name))

    def times(self, name: str) -> npt.NDArray[np.int64]:
        """Returns the UTC of each of `rows` in ns since 1970; the lowest integer for an impossible date."""
        _, values = _joined(rows for _, rows in self._columns(name, "datetime"))
        return values.astype(np.int64)

    def numbers(self, name: str) -> Rows:
        """Returns a quantity as float64."""
        sample, values = self.rows(name)
        return Rows(sample, values.astype(np.float64))

    @cached_property
    def positions(self) -> Rows:
        """Latitude and longitude in degrees, where the filter has a fix; without one they are zero."""
        sample, values = found = self.numbers("lat_lon")
        if not len(sample):
            return found
        is_fixed = is_place("lat_lon", values)
        is_fixed &= has_filter_fix(self._part, sample + self._part.first_sample, values)
        return Rows(sample[is_fixed], values[is_fixed])

    @cached_property
    def orientation(self) -> Rows:
        """Quaternions, q0 first: from the quaternion, otherwise the matrix, otherwise the Euler angles."""
        return self._orientation(converts=self._converts)

    @cached_property
    def enu_orientation(self) -> Rows:
        """The same in ENU."""
        return self.orientation if self._converts else self._orientation(converts=True)

    def _orientation(self, *, converts: bool) -> Rows:
        return _joined(
            Rows(rows.sample, _turned(column, of(rows.values), converts=converts))
            for name, of in self._quaternions.items()
            for column, rows in self._columns(name)
        )

    @cached_property
    def euler(self) -> Rows:
        """Roll, pitch and yaw in degrees: from the angles, otherwise the matrix, otherwise the quaternion."""
        return _joined(
            Rows(rows.sample, self._angles(column, rows.values))
            for name in ("quaternion", "rotation_matrix", "euler_angles")
            for column, rows in self._columns(name)
        )

    def _angles(self, column: PartColumn, values: npt.NDArray[Any]) -> FloatArray:
        is_kept = not self._converts or system_of(column) == ENU
        if column.name == "euler_angles" and is_kept:
            return values.astype(np.float64)
        q = self._quaternions[column.name](values)
        return euler_of(_turned(column, q, converts=self._converts))

    def vectors(self, name: str) -> Rows:
        """Returns vectors of the local frame."""
        return _joined(
            Rows(rows.sample, self._vectors(column, rows.values))
            for column, rows in self._columns(name)
        )

    def _vectors(self, column: PartColumn, values: npt.NDArray[Any]) -> FloatArray:
        vectors = values.astype(np.float64)
        if not self._converts or system_of(column) == ENU:
            return vectors
        places, signs = AXES_TO_ENU[system_of(column)]
        return np.asarray(vectors[:, places] * np.array(signs))


def _joined(several: Iterable[Rows]) -> Rows:
    """Returns one row for each sample: the last of several."""
    found = list(several)
    if not found:
        return Rows(np.empty(0, np.int64), np.empty((0, 0)))
    sample, values = found[0]
    if len(found) > 1:
        sample = np.concatenate([rows.sample for rows in found])
        values = np.concatenate([rows.values for rows in found])
        order = np.argsort(sample, kind="stable")
        sample, values = sample[order], values[order]
    last = np.append(sample[1:] != sample[:-1], True)[: len(sample)]
    if not last.all():
        sample, values = sample[last], values[last]
    return Rows(sample, values)


def _turned(column: PartColumn, q: FloatArray, *, converts: bool) -> FloatArray:
    """Returns the orientations of a column, in ENU if they are converted."""
    system = system_of(column)
    return quaternion.multiply(TO_ENU[system], q) if converts and system != ENU else q


def system_of(column: PartColumn) -> str:
    """Returns the coordinate system of a column.

    The manual defines none for free acceleration: it is ENU, unless its identifier has other bits.
    """
    return column.coordinates or SYSTEMS.get(column.data_id & COORDINATE_BITS, ENU)
