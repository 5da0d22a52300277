"""Cells of the protocol tables as text, for the command line and the documentation."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence

from xbus.protocol.tables import PRODUCTS, Field, Quantity

__all__ = ["describe_layout", "describe_lengths", "describe_products", "describe_raw_unit"]


def describe_layout(row: Quantity) -> str:
    """Returns the content of a packet.

    >>> from xbus.protocol.tables import QUANTITIES
    >>> describe_layout(QUANTITIES["acceleration"]), describe_layout(QUANTITIES["utc_time"])
    ('3 real', '8 fields, 12 bytes')
    """
    match row.kind:
        case "struct":
            return f"{len(row.fields)} fields, {row.size} bytes"
        case "list":
            return f"{_size(row.fields)} bytes and {_size(row.entry)} each"
        case "id":
            return "u4 or u8"
    return f"{row.numbers} {row.kind}" if row.numbers > 1 else row.kind


def describe_raw_unit(field: Field) -> str:
    """Returns the value of one count of the raw integer; empty for counts, dates and bits.

    >>> from xbus.protocol.tables import QUANTITIES
    >>> fields = {field.name: field for field in QUANTITIES["gnss_pvt_data"].fields}
    >>> [describe_raw_unit(fields[name]) for name in ("lat", "hAcc", "pdop", "numSV")]
    ['1e-7 deg', '0.001 m', '0.01', '']
    """
    if field.scale == 1:
        return field.unit
    digits = f"{field.scale:g}".replace("e-0", "e-")
    scale = digits if len(digits) <= len("0.001") else f"1/{field.per_unit}"
    return f"{scale} {field.unit}".strip()


def describe_lengths(lengths: Sequence[int] | None) -> str:
    """Returns the lengths of a payload in bytes; None means any length.

    >>> describe_lengths((2, 4)), describe_lengths((0, 4, 8, 12)), describe_lengths(None)
    ('2, 4', '0 to 12 by 4', 'any')
    """
    if lengths is None:
        return "any"
    if len(lengths) < 4:
        return ", ".join(map(str, lengths))
    step = lengths[1] - lengths[0]
    steps = f" by {step}" if step > 1 else ""
    return f"{lengths[0]} to {lengths[-1]}{steps}"


def describe_products(numbers: Collection[int]) -> str:
    """Returns the products with these numbers; a complete series is shown by its name.

    >>> describe_products([1, 2, 3, 7, 8, 630])
    '1-series 630'
    """
    if len(numbers) == len(PRODUCTS):
        return "all"
    series: dict[str, list[int]] = {}
    for product in PRODUCTS.values():
        series.setdefault(product.series, []).append(product.number)
    parts: list[str] = []
    for name, members in series.items():
        found = [member for member in members if member in numbers]
        parts += [name] if found == members else [str(member) for member in found]
    return " ".join(parts)


def _size(fields: Iterable[Field]) -> int:
    return sum(int(field.type[1:]) for field in fields)
