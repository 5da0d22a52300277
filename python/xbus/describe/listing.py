"""Tables of which only some rows are kept, so that hostile logs need no more memory than others."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = ["MAX_LISTED", "FirstRows", "LargestRows"]

#: Maximum number of rows of each kind that are listed: gaps, places of damage, errors and warnings, runs.
MAX_LISTED = 100_000


class FirstRows:
    """The first rows of a table that is read part by part. Its length is the number of all rows.

    Args:
        dtype: The type of a row.
        most: Number of rows to keep.

    >>> import numpy as np
    >>> table = FirstRows(np.dtype("i8"), 3)
    >>> table.add(np.array([5, 7]))
    >>> table.add(np.array([8, 9]))
    >>> table.rows.tolist(), len(table)
    ([5, 7, 8], 4)
    """

    def __init__(self, dtype: np.dtype[Any], most: int = MAX_LISTED) -> None:
        self._parts = [np.empty(0, dtype)]
        self._most, self._kept, self._total = most, 0, 0

    def __len__(self) -> int:
        return self._total

    def add(self, rows: npt.NDArray[Any]) -> None:
        """Adds rows."""
        self._total += len(rows)
        if more := min(len(rows), self._most - self._kept):
            self._parts.append(rows[:more].copy())
            self._kept += more

    @property
    def rows(self) -> npt.NDArray[Any]:
        """The first rows, at most as many as are kept."""
        self._parts = [np.concatenate(self._parts)]
        return self._parts[0]


class LargestRows:
    """The rows of a table with the largest values, in the order of the table; of equal ones the first.

    Args:
        dtype: The type of a row.
        field: The field that is compared.
        most: Number of rows to keep.

    Attributes:
        rows: The rows.
    """

    def __init__(self, dtype: np.dtype[Any], field: str, most: int) -> None:
        self._field, self._most = field, most
        self.rows: npt.NDArray[Any] = np.empty(0, dtype)

    def add(self, rows: npt.NDArray[Any]) -> None:
        """Adds rows."""
        rows = np.concatenate((self.rows, rows))
        if len(rows) > self._most:
            largest = np.argsort(-rows[self._field], kind="stable")[: self._most]
            rows = rows[np.sort(largest)]
        self.rows = rows
