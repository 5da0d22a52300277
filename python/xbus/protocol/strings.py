"""The fields of the string outputs (section 5.3.5, under SetStringOutputType).

One table, used to parse and to encode. The extension declares how a string begins and ends; this table
has the fields in between. Formats are the manual's masks or, where a mask is misprinted, those of strings
that devices send.
"""

from __future__ import annotations

import datetime
import re
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from xbus import _core
from xbus.protocol.values import StringType

__all__ = ["STARTS", "STRING_FIELDS", "StringField", "StringLayout", "join", "split"]

#: How each string begins, by type.
STARTS = {StringType[name]: start for name, start in _core.strings()}

_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)")


@dataclass(frozen=True)
class Form:
    """How a value is written.

    Attributes:
        parts: How many parts of the string it takes.
        read: Returns the value of these parts; None if they are empty. Raises ValueError.
        write: Returns the parts of a value, or of None.
        dtype: numpy's type of a column of values; NaN, NaT or the empty text stand for None.
    """

    parts: int
    read: Callable[[Sequence[str]], Any]
    write: Callable[[Any], Sequence[str]]
    dtype: str = "f8"


@dataclass(frozen=True)
class StringField:
    """A field of a string output.

    Attributes:
        name: Its name; empty for a letter that is always the same.
        unit: Its unit; empty for letters, counts, times and dates.
        form: How it is written.
        is_optional: Whether it may be left out at the end.
    """

    name: str
    unit: str
    form: Form
    is_optional: bool = False


@dataclass(frozen=True)
class StringLayout:
    """The fields of a string output.

    Attributes:
        length: Maximum number of bytes, for values in the range of the sensors.
        fields: The fields, in order.
        validity: The field with the validity of the others, and its values for valid; None if no field has
            it.
    """

    length: int
    fields: tuple[StringField, ...]
    validity: tuple[str, tuple[Any, ...]] | None = None


# Parts of text


def _float(text: str) -> float:
    if not _NUMBER.fullmatch(text):
        raise ValueError(f"{text!r} is not a number")
    return float(text)


def _number(spec: str, *, blank: bool = False) -> Form:
    """Returns the form of a number in a Python format; with ``blank``, a space replaces the plus sign."""

    def read(parts: Sequence[str]) -> float | None:
        # PTCF has a space in place of the sign, and only spaces for a value that is not available.
        return _float(text) if (text := parts[0].strip()) else None

    def write(value: float | None) -> list[str]:
        if value is None:
            return [""]
        text = format(abs(value), spec)
        is_negative = value < 0 and float(text) > 0
        if blank:
            return [("-" if is_negative else " ") + text]
        return [format(value, spec) if is_negative else text]

    return Form(1, read, write)


def _count(spec: str) -> Form:
    def read(parts: Sequence[str]) -> int | None:
        if parts[0] and not parts[0].isdecimal():
            raise ValueError(f"{parts[0]!r} is not a whole number")
        return int(parts[0]) if parts[0] else None

    return Form(1, read, lambda value: ["" if value is None else format(value, spec)])


def _scaled(counts: int) -> Form:
    """Returns the form of a number that counts fractions of its unit, without a decimal point."""

    def read(parts: Sequence[str]) -> float | None:
        return _float(text) / counts if (text := parts[0].strip()) else None

    return Form(1, read, lambda value: ["" if value is None else str(round(value * counts))])


def _lettered(spec: str, positive: str, negative: str) -> Form:
    """Returns the form of a number with a letter for its sign."""
    number = _number(spec)

    def read(parts: Sequence[str]) -> float | None:
        value: float | None = number.read(parts)
        if value is None:
            return None
        if parts[1] not in (positive, negative):
            raise ValueError(f"{parts[1]!r} is neither {positive} nor {negative}")
        return value if parts[1] == positive else 0.0 - value

    def write(value: float | None) -> list[str]:
        if value is None:
            return ["", ""]
        (text,) = number.write(abs(value))
        return [text, negative if value < 0 and float(text) else positive]

    return Form(2, read, write)


def _degrees(digits: int, decimals: int, letters: str) -> Form:
    """Returns the form of degrees, minutes, and a letter for the hemisphere."""
    limit = {2: 90, 3: 180}[digits]
    width = 3 + decimals

    def read(parts: Sequence[str]) -> float | None:
        text, letter = parts
        if not text:
            return None
        point = text.find(".") if "." in text else len(text)
        whole, minutes = text[: point - 2], _float(text[max(point - 2, 0) :])
        if not whole.isdecimal() or minutes >= 60 or letter not in letters or not letter:
            raise ValueError(f"{text},{letter} is not an angle")
        degrees = int(whole) + minutes / 60
        if degrees > limit:
            raise ValueError(f"{text} is beyond {limit} degrees")
        return degrees if letter == letters[0] else -degrees

    def write(value: float | None) -> list[str]:
        if value is None:
            return ["", ""]
        # Rounded as a whole, so that 59.99999 minutes become a degree.
        minutes = round(abs(value) * 60 * 10**decimals)
        whole, rest = divmod(minutes, 60 * 10**decimals)
        return [
            f"{whole:0{digits}d}{rest / 10**decimals:0{width}.{decimals}f}",
            letters[1] if value < 0 and minutes else letters[0],
        ]

    return Form(2, read, write)


def _text(default: str = "") -> Form:
    """Returns the form of one or more letters."""

    def write(value: str | None) -> list[str]:
        if value and not re.fullmatch(r"[ -#%-)+\-./0-9:-~]*", value):
            raise ValueError("a field has printable characters only, without comma, $ and *")
        return [value or default]

    return Form(1, lambda parts: parts[0] or None, write, "U")


def _time(decimals: int) -> Form:
    """Returns the form of a time of day, hhmmss; None for a time that does not exist."""

    def read(parts: Sequence[str]) -> datetime.time | None:
        text = parts[0]
        if not text:
            return None
        if not re.fullmatch(r"\d{6}(\.\d*)?", text):
            raise ValueError(f"{text!r} is not a time of day")
        micros = int(f"{text[7:]:0<6}"[:6])
        try:
            return datetime.time(int(text[:2]), int(text[2:4]), int(text[4:6]), micros)
        except ValueError:
            return None

    def write(value: datetime.time | None) -> list[str]:
        if value is None:
            return [""]
        fraction = f".{value.microsecond:06d}"[: decimals + 1] if decimals else ""
        return [f"{value:%H%M%S}{fraction}"]

    return Form(1, read, write, "m8[us]")


def _date(year: Callable[[str], int], write: Callable[[datetime.date], Sequence[str]]) -> Form:
    lengths = [len(part) for part in write(datetime.date(2000, 1, 1))]
    parts = len(lengths)

    def read(texts: Sequence[str]) -> datetime.date | None:
        text = "".join(texts)
        if not text:
            return None
        if not text.isdecimal() or [len(text) for text in texts] != lengths:
            raise ValueError(f"{','.join(texts)!r} is not a date")
        try:
            return datetime.date(year(text[4:]), int(text[2:4]), int(text[:2]))
        except ValueError:
            return None

    return Form(
        parts, read, lambda value: [""] * parts if value is None else list(write(value)), "M8[D]"
    )


def _short_year(text: str) -> int:
    """Returns the year of two digits; GPS began in 1980."""
    return (1900 if int(text) >= 80 else 2000) + int(text)


# The table


def _f(name: str, unit: str, form: Form) -> StringField:
    return StringField(name, unit, form)


def _named(names: str, unit: str, form: Form) -> list[StringField]:
    return [_f(name, unit, form) for name in names.split()]


def _always(letter: str) -> StringField:
    def read(parts: Sequence[str]) -> None:
        if parts[0] not in (letter, ""):
            raise ValueError(f"{parts[0]!r} stands where {letter} does")

    return StringField("", "", Form(1, read, lambda _: [letter]))


def _layout(
    length: int,
    *fields: StringField | list[StringField],
    validity: tuple[str, tuple[Any, ...]] | None = None,
) -> StringLayout:
    flat = [field for group in fields for field in (group if isinstance(group, list) else [group])]
    return StringLayout(length, tuple(flat), validity)


_LAT = _f("lat", "deg", _degrees(2, 4, "NS"))
_LON = _f("lon", "deg", _degrees(3, 4, "EW"))
_HUNDREDTHS = _scaled(100)
#: The angle is positive if the bow or the port side is up, even if letters name the side.
_BOW_UP, _PORT_UP = _lettered(".2f", "M", "P"), _lettered(".2f", "T", "B")

#: The fields of each string.
STRING_FIELDS: dict[StringType, StringLayout] = {
    StringType.HCHDM: _layout(20, _f("heading", "deg", _number("06.2f")), _always("M")),
    StringType.HCHDG: _layout(
        33,
        _f("heading", "deg", _number(".1f")),
        _f("deviation", "deg", _lettered(".1f", "E", "W")),
        _f("variation", "deg", _lettered(".1f", "E", "W")),
    ),
    StringType.TSS2: _layout(
        27,
        _f("heading", "deg", _HUNDREDTHS),
        _f("heave", "cm", _scaled(1)),
        _always("H"),
        _named("roll pitch", "deg", _HUNDREDTHS),
        _always("F"),
    ),
    StringType.PHTRO: _layout(28, _f("pitch", "deg", _BOW_UP), _f("roll", "deg", _PORT_UP)),
    StringType.PRDID: _layout(30, _named("pitch roll heading", "deg", _number("06.2f"))),
    StringType.EM1000: _layout(
        10,
        _named("roll pitch", "deg", _HUNDREDTHS),
        _f("heave", "cm", _scaled(1)),
        _f("heading", "deg", _HUNDREDTHS),
    ),
    StringType.PSONCMS: _layout(
        132,
        _named("quaternion_q0 quaternion_q1 quaternion_q2 quaternion_q3", "", _number(".4f")),
        _named("acceleration_x acceleration_y acceleration_z", "m/s2", _number(".4f")),
        _named("rate_of_turn_x rate_of_turn_y rate_of_turn_z", "rad/s", _number(".4f")),
        _named("magnetic_field_x magnetic_field_y magnetic_field_z", "a.u.", _number(".4f")),
        _f("temperature", "degC", _number(".1f")),
    ),
    StringType.HCMTW: _layout(19, _f("temperature", "degC", _number(".1f")), _always("C")),
    # True, Grid or Magnetic.
    StringType.HEHDT: _layout(
        20, _f("heading", "deg", _number("06.2f")), _f("heading_type", "", _text("T"))
    ),
    # Valid is A in the manual; the vendor's own parser expects T.
    StringType.HEROT: _layout(
        22,
        _f("rate_of_turn", "deg/min", _number(".1f")),
        _f("status", "", _text("A")),
        validity=("status", ("A", "T")),
    ),
    StringType.GPGGA: _layout(
        82,
        _f("time", "", _time(2)),
        _LAT,
        _LON,
        _f("quality", "", _count("d")),
        _f("satellites", "", _count("02d")),
        _f("hdop", "", _number(".1f")),
        _f("height_msl", "m", _number(".1f")),
        _always("M"),
        _f("geoid_separation", "m", _number(".1f")),
        _always("M"),
        _f("dgps_age", "s", _number(".1f")),
        _f("dgps_station", "", _text()),
        validity=("quality", tuple(range(1, 10))),
    ),
    StringType.PTCF: _layout(
        45,
        _f("heading", "deg", _number("05.1f")),
        _always("T"),
        _f("roll", "deg", _number("05.1f", blank=True)),
        _f("pitch", "deg", _number("04.1f", blank=True)),
        _named("roll_rate pitch_rate", "deg/s", _number("05.1f", blank=True)),
    ),
    StringType.XSVEL: _layout(
        41, _named("velocity_x velocity_y velocity_z", "m/s", _number("08.4f", blank=True))
    ),
    StringType.GPZDA: _layout(
        38,
        _f("time", "", _time(2)),
        _f("date", "", _date(int, lambda date: (f"{date:%d}", f"{date:%m}", f"{date.year:04d}"))),
        _named("zone_hours zone_minutes", "", _number("02.0f")),
    ),
    StringType.GPRMC: _layout(
        74,
        _f("time", "", _time(0)),
        _f("status", "", _text("V")),
        _f("lat", "deg", _degrees(2, 2, "NS")),
        _f("lon", "deg", _degrees(3, 2, "EW")),
        _f("speed", "knots", _number("05.1f")),
        _f("course", "deg", _number("05.1f")),
        _f("date", "", _date(_short_year, lambda date: (f"{date:%d%m%y}",))),
        _f("variation", "deg", _lettered("05.1f", "E", "W")),
        StringField("mode", "", _text(), is_optional=True),
        validity=("status", ("A",)),
    ),
}

#: Roll, pitch and heave, then heading. Nothing else in the protocol is little-endian.
_EM1000 = struct.Struct("<hhhH")
#: Where the parts of TSS2 are: heading, heave, status, roll, pitch, status.
_TSS2 = (slice(0, 5), slice(6, 11), slice(11, 12), slice(12, 17), slice(18, 23), slice(23, 24))


def split(kind: StringType, body: bytes) -> list[str]:
    """Returns the parts of a string, from between its start and its checksum or end of line."""
    if kind is StringType.EM1000:
        return [str(number) for number in _EM1000.unpack(body)]
    text = body.decode("ascii")
    if kind is StringType.TSS2:
        return [text[place].strip() for place in _TSS2]
    return text.split(",")


def join(kind: StringType, parts: Sequence[str]) -> bytes:
    """Returns the bytes of parts, the inverse of `split`. A number too long for its mask is clipped."""
    if kind is StringType.EM1000:
        return _EM1000.pack(*(int(part or 0) for part in parts))
    if kind is StringType.TSS2:
        heading, heave, status, roll, pitch, flag = parts
        signed = [_masked(number) for number in (heave, roll, pitch)]
        return f"{heading:>05} {signed[0]}{status}{signed[1]} {signed[2]}{flag}".encode("ascii")
    return ",".join(parts).encode("ascii")


def _masked(text: str) -> str:
    number = int(text or 0)
    return f"{'-' if number < 0 else ' '}{min(abs(number), 9999):04d}"
