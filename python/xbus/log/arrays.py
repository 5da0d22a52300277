"""Arrays that cannot be written to, and whether two arrays are the same."""

from __future__ import annotations

from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

__all__ = ["identical", "read_only"]

S = TypeVar("S", bound=np.generic)


def read_only(array: npt.NDArray[S]) -> npt.NDArray[S]:
    """Makes an array read-only and returns it."""
    array.flags.writeable = False
    return array


def identical(one: npt.NDArray[Any], other: npt.NDArray[Any]) -> bool:
    """Returns whether two arrays have the same type, shape and bits: NaN equals NaN, and 0.0 is not -0.0."""
    if one is other:
        return True
    if one.dtype != other.dtype or one.shape != other.shape:
        return False
    return np.array_equal(_bytes(one), _bytes(other))


def _bytes(array: npt.NDArray[Any]) -> npt.NDArray[np.uint8]:
    return np.ascontiguousarray(array).reshape(-1).view(np.uint8)
