"""MTData, the output of older devices: its items, which OutputMode and OutputSettings select."""

from __future__ import annotations

from typing import NamedTuple

from xbus import _core

__all__ = ["MTDATA_ITEMS", "MtDataItem"]


class MtDataItem(NamedTuple):
    """An item of an MTData message. It has no identifier: the settings decide whether and where it is.

    Attributes:
        mode: The bit of OutputMode that it needs; 0 if OutputSettings alone decides.
        mask: Bits of OutputSettings.
        value: The value that these bits must have.
        quantity: Name of the quantity that a log has of it.
        step: If it is a U2 that counts steps of the quantity's unit: the size of one. Otherwise None.
    """

    mode: int
    mask: int
    value: int
    quantity: str
    step: int | None


#: The items in the order of the wire.
MTDATA_ITEMS = tuple(MtDataItem(**row) for row in _core.mtdata_items())
