"""The fields of a struct quantity in a single packet."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from xbus.protocol.tables import Field, Quantity

__all__ = ["Struct", "struct_of"]


class Struct(dict[str, int]):
    """The raw integers of a struct by the manual's field names; `scaled` has them in their units.

    The same integers, names and units as in a row of a `Column`.

    Attributes:
        satellites: The satellites of ``gnss_sat_info``, a struct each; empty for other quantities.

    >>> from xbus.protocol.tables import QUANTITIES
    >>> stamp = struct_of(QUANTITIES["trigger_in1"], [1, 1, 2_500_000, 7])
    >>> stamp["timestamp"], stamp.scaled["timestamp"], stamp.units["timestamp"]
    (2500000, 2.5, 's')
    """

    def __init__(
        self, fields: Sequence[Field], numbers: Iterable[int], satellites: Sequence[Struct] = ()
    ) -> None:
        super().__init__(zip((field.name for field in fields), numbers, strict=True))
        self._fields = tuple(fields)
        self.satellites = tuple(satellites)

    @property
    def scaled(self) -> dict[str, float]:
        """The fields in SI units and degrees; NaN for a value that means "not provided".

        Counts, dates and bits are integers.
        """
        return {field.name: field.scaled(self[field.name]) for field in self._fields}

    @property
    def units(self) -> dict[str, str]:
        """Unit of each field of `scaled`; empty for counts, dates and bits."""
        return {field.name: field.unit for field in self._fields}

    def __eq__(self, other: object) -> bool:
        is_same = dict.__eq__(self, other)
        return is_same and (not isinstance(other, Struct) or self.satellites == other.satellites)

    def __ne__(self, other: object) -> bool:
        return not self == other

    __hash__ = None

    def __reduce__(self) -> tuple[Any, ...]:
        return Struct, (self._fields, tuple(self.values()), self.satellites)


def struct_of(row: Quantity, numbers: Sequence[int]) -> Struct:
    """Returns the struct of a packet's numbers, which are in the order of the wire."""
    head, size = len(row.fields), len(row.entry)
    starts = range(head, len(numbers), size) if size else ()
    satellites = [Struct(row.entry, numbers[start : start + size]) for start in starts]
    return Struct(row.fields, numbers[:head], satellites)
