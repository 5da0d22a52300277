"""Precision and coordinate system of a data identifier (Table 17)."""

from __future__ import annotations

from typing import NamedTuple

from xbus.protocol.ids import Coordinates, Precision
from xbus.protocol.tables import Quantity

__all__ = ["COORDINATE_BITS", "Format", "format_of"]

#: The bits of a data identifier for each of them.
PRECISION_BITS, COORDINATE_BITS = 0x3, 0xC
_KNOWN = {int(system): system for system in Coordinates}


class Format(NamedTuple):
    """A data identifier, taken apart.

    Attributes:
        quantity: Its row in the table; None for an unknown identifier.
        precision: Format of its real numbers; None for a quantity that has none.
        coordinates: Coordinate system; its bits where Table 17 has none for them; None for a quantity that
            has none.
    """

    quantity: Quantity | None
    precision: Precision | None
    coordinates: Coordinates | int | None


def format_of(data_id: int) -> Format:
    """Takes a data identifier apart.

    >>> format_of(0x2016)[1:]
    (<Precision.Fp1632: 2>, <Coordinates.NED: 4>)
    >>> format_of(0x3013)[1:]  # format bits of integers mean nothing
    (None, None)
    """
    quantity = Quantity.of(data_id)
    is_real = quantity is not None and quantity.kind == "real"
    rotates = quantity is not None and quantity.coordinates
    system = data_id & COORDINATE_BITS
    return Format(
        quantity,
        Precision(data_id & PRECISION_BITS) if is_real else None,
        _KNOWN.get(system, system) if rotates else None,
    )
