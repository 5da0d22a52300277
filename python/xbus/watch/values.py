"""Latest values as text that keeps its columns while the numbers change."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from xbus.describe.text import finite
from xbus.formatting import device_name
from xbus.protocol.tables import QUANTITIES, UTC_VALID
from xbus.watch.model import QuantityState

__all__ = ["format_rate", "format_unit", "format_value", "set_flags", "value_json"]

#: Decimals of a number, by quantity or else by unit.
DECIMALS = {
    "lat_lon": 7,
    "delta_q": 6,
    "delta_v": 6,
    "rotation_matrix": 2,
    "quaternion": 4,
    "deg": 2,
    "m": 3,
    "degC": 2,
}
DEFAULT_DECIMALS = 4
#: Columns of a number in front of its decimals: sign, three digits, point.
INTEGER_COLUMNS = 5
#: Numbers of this size and above have an exponent.
LARGE = 1e7


def format_unit(quantity: QuantityState) -> str:
    """Returns unit and coordinates."""
    return " ".join(part for part in (quantity.unit, quantity.coordinates) if part)


def format_rate(rate: float | None) -> str:
    """Returns a rate in Hz; an empty string if it is None."""
    if rate is None:
        return ""
    return "stopped" if rate == 0 else f"{rate:.1f}"


def format_value(quantity: QuantityState) -> str:
    """Returns the latest value as one line."""
    name, value = quantity.name, quantity.value
    if isinstance(value, str):
        return value
    if isinstance(value, bytes):
        return value.hex(" ").upper() or "empty"
    row = QUANTITIES[name]
    if row.has_flags:
        return f"0x{int(value):0{2 * (row.size or 1)}X}"
    if name in _FORMATTERS:
        return _FORMATTERS[name](value)
    if value.dtype.names:
        pairs = zip(value.dtype.names, value.item(), strict=True)
        return " ".join(
            f"{field}={_format_field(number)}{quantity.units[field]}" for field, number in pairs
        )
    if row.kind == "id":
        return device_name(int(value))
    decimals = DECIMALS.get(name, DECIMALS.get(quantity.unit, DEFAULT_DECIMALS))
    # Nine numbers need narrow columns.
    width = 5 if row.is_matrix else INTEGER_COLUMNS + decimals
    numbers = np.ravel(value).tolist()
    return " ".join(f"{_format_number(number, decimals):>{width}}" for number in numbers)


def set_flags(quantity: str, word: int) -> list[tuple[str, int]]:
    """Returns the fields of a status word or byte that are not zero, with their values."""
    fields = QUANTITIES[quantity].fields_of(word)
    return [(name, value) for name, value in fields.items() if value]


def value_json(quantity: QuantityState) -> Any:
    """Returns the latest value for JSON: numbers by component or field, null for NaN."""
    value = quantity.value
    if isinstance(value, str):
        return value
    if isinstance(value, bytes):
        return value.hex().upper()
    if quantity.name == "gnss_sat_info":
        return [dict(zip(value.dtype.names, row, strict=True)) for row in value.tolist()]
    row = value.item() if value.dtype.names else np.ravel(value).tolist()
    numbers = [finite(number) for number in row]
    return dict(zip(quantity.fields, numbers, strict=True)) if quantity.fields else numbers[0]


def _format_number(value: float, decimals: int) -> str:
    if isinstance(value, int):
        return str(value)
    if math.isnan(value):
        return "NaN"
    return f"{value:.{decimals}f}" if abs(value) < LARGE else f"{value:.{decimals}g}"


def _format_field(value: float) -> str:
    """Returns a field of a struct; its scale limits the number of digits."""
    return "none" if math.isnan(value) else f"{value:.10g}"


def _format_utc(row: Any) -> str:
    is_valid = int(row["valid"]) & UTC_VALID == UTC_VALID
    date = f"{row['year']:04}-{row['month']:02}-{row['day']:02}"
    time = f"{row['hour']:02}:{row['minute']:02}:{row['second'] + row['ns']:06.3f}"
    return f"{date} {time}{'' if is_valid else ' not valid'}"


def _format_pvt(row: Any) -> str:
    return f"{row['lat']:.7f} {row['lon']:.7f} deg, hMSL {row['hMSL']:.3f} m"


def _format_satellites(rows: Any) -> str:
    signals = rows["cno"][rows["cno"] > 0]
    span = f", {signals.min()} to {signals.max()} dBHz" if len(signals) else ""
    return f"{len(rows)} satellites{span}"


_FORMATTERS = {
    "utc_time": _format_utc,
    "gnss_pvt_data": _format_pvt,
    "gnss_sat_info": _format_satellites,
}
