"""The positions of a stream, in metres east and north of the first one."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import numpy as np
import numpy.typing as npt

from xbus.export.positions import positions_of
from xbus.geometry.earth import ecef_to_enu, geodetic_to_ecef
from xbus.log.log import Log
from xbus.protocol.tables import device_of
from xbus.protocol.values import LatLonAlt

__all__ = ["Track"]


class Track:
    """The positions of a stream; which ones these are, and which of them have a fix, is as in exported maps.

    Attributes:
        origin: The first position with a fix; None before it.
        latest: The last position with a fix, a row of `xbus.export.positions.POINT`; None before the first.
        source: ``"filter"`` or ``"gnss"``; None while the device sends no positions.
        quantity: The quantity of the last position; None before the first.
        is_fixed: Whether the last position has a fix.
    """

    def __init__(self) -> None:
        self.origin: LatLonAlt | None = None
        self.latest: Any = None
        self.source: str | None = None
        self.quantity: str | None = None
        self.is_fixed = False
        self._bid: int | None = None

    def add(
        self, block: Log, sent: Collection[str]
    ) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.float64]]:
        """Adds the positions of a block.

        Args:
            block: The block.
            sent: Names of the quantities that the device sends at present; not all are in every block.

        Returns:
            The sample of each position in the block, ``(n,)``, and metres east and north, ``(n, 2)``; NaN
            without a fix.
        """
        positions = positions_of(sent, None)
        self.source = None if positions is None else positions.name
        name = None if positions is None else positions.position(block)
        if positions is None or name is None:
            return np.empty(0, np.int64), np.empty((0, 2))
        rows = positions.rows(block)
        sample = rows.sample - block.first_sample
        bids = device_of(block.bid[sample])
        if self._bid is None:
            self._bid = int(bids[0])
        own = bids == self._bid  # a line between two devices has no meaning
        sample, points, is_fixed = (
            sample[own],
            rows.points[own],
            (rows.is_fixed & rows.is_place)[own],
        )
        metres = np.full((len(sample), 2), np.nan)
        if is_fixed.any():
            self.latest = points[is_fixed][-1]
            metres[is_fixed] = self.metres(points[is_fixed])
        if len(is_fixed):
            self.quantity, self.is_fixed = name, bool(is_fixed[-1])
        return sample, metres

    def metres(self, points: npt.NDArray[Any]) -> npt.NDArray[np.float64]:
        """Returns metres east and north of the first position, ``(n, 2)``."""
        if self.origin is None:
            self.origin = LatLonAlt(float(points["lat"][0]), float(points["lon"][0]), 0.0)
        return ecef_to_enu(geodetic_to_ecef(points["lat"], points["lon"], 0.0), self.origin)[:, :2]
