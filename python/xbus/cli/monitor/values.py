"""Latest values in words that stay in their columns while the numbers change."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from xbus.cli.monitor.model import Known
from xbus.describe.text import device_name, finite
from xbus.protocol.tables import QUANTITIES, STATUS_FLAGS, UTC_VALID

__all__ = ["flags", "rate_text", "unit_text", "value_facts", "value_text"]

#: Decimals of a number, by its quantity or else by its unit.
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
OTHERS = 4
#: Columns of a number before its decimals: sign, three digits, point.
BEFORE = 5
#: From here on a number is written with an exponent.
LARGE = 1e7
#: Status words have so many hexadecimal digits.
DIGITS = {"status_word": 8, "status_byte": 2}


def unit_text(known: Known) -> str:
    """Unit and coordinates."""
    return " ".join(it for it in (known.unit, known.coordinates) if it)


def rate_text(rate: float | None) -> str:
    """A rate in Hz; empty where it is not known yet."""
    if rate is None:
        return ""
    return "stopped" if rate == 0 else f"{rate:.1f}"


def value_text(known: Known) -> str:
    """The latest value in one line."""
    name, value = known.name, known.value
    if isinstance(value, str):
        return value
    if isinstance(value, bytes):
        return value.hex(" ").upper() or "empty"
    if name in DIGITS:
        return f"0x{int(value):0{DIGITS[name]}X}"
    if name in _OTHERWISE:
        return _OTHERWISE[name](value)
    if value.dtype.names:
        pairs = zip(value.dtype.names, value.item(), strict=True)
        return " ".join(f"{it}={_short(number)}{known.units[it]}" for it, number in pairs)
    if QUANTITIES[name].kind == "id":
        return device_name(int(value))
    decimals = DECIMALS.get(name, DECIMALS.get(known.unit, OTHERS))
    width = BEFORE + decimals
    if name == "rotation_matrix":  # row by row, and as narrow as nine numbers must be
        width = 5
    return " ".join(f"{_number(it, decimals):>{width}}" for it in np.ravel(value).tolist())


def flags(word: int, bits: int) -> list[tuple[str, int]]:
    """The fields of a status word that are not zero, with their values."""
    values = (
        (it.name, word >> it.bit & ((1 << it.width) - 1))
        for it in STATUS_FLAGS
        if it.bit + it.width <= bits
    )
    return [(name, value) for name, value in values if value]


def value_facts(known: Known) -> Any:
    """The latest value for programs: numbers by the names of components and fields, null for NaN."""
    value = known.value
    if isinstance(value, str):
        return value
    if isinstance(value, bytes):
        return value.hex().upper()
    if known.name == "gnss_sat_info":
        return [dict(zip(value.dtype.names, it, strict=True)) for it in value.tolist()]
    numbers = [
        finite(it) for it in (value.item() if value.dtype.names else np.ravel(value).tolist())
    ]
    return dict(zip(known.fields, numbers, strict=True)) if known.fields else numbers[0]


def _number(value: float, decimals: int) -> str:
    if isinstance(value, int):
        return str(value)
    return f"{value:.{decimals}f}" if abs(value) < LARGE else f"{value:.{decimals}g}"


def _short(value: float) -> str:
    """A field of a struct, whose scale says how many digits there can be."""
    return "none" if math.isnan(value) else f"{value:.10g}"


def _utc(it: Any) -> str:
    valid = int(it["valid"]) & UTC_VALID == UTC_VALID
    date = f"{it['year']:04}-{it['month']:02}-{it['day']:02}"
    time = f"{it['hour']:02}:{it['minute']:02}:{it['second'] + it['ns']:06.3f}"
    return f"{date} {time}{'' if valid else ' not valid'}"


def _pvt(it: Any) -> str:
    return f"{it['lat']:.7f} {it['lon']:.7f} deg, hMSL {it['hMSL']:.3f} m"


def _satellites(rows: Any) -> str:
    used = rows["cno"][rows["cno"] > 0]
    best = f", {used.min()} to {used.max()} dBHz" if len(used) else ""
    return f"{len(rows)} satellites{best}"


_OTHERWISE = {"utc_time": _utc, "gnss_pvt_data": _pvt, "gnss_sat_info": _satellites}
