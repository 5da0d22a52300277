"""String outputs, which a device sends instead of MTData2 or between its frames (section 5.3.5)."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from xbus import _core
from xbus.errors import DecodeError
from xbus.protocol.strings import STARTS, STRING_FIELDS, StringField, join, split
from xbus.protocol.values import StringType

__all__ = [
    "String",
    "encode_string",
    "mask_of",
    "one_type",
    "parse_string",
    "string_types",
    "type_at",
]

#: Longest string that is accepted, in bytes; the longest of the manual, PSONCMS, has up to 130.
LONGEST = 255
#: The place that the core gives to a string that the manual does not list.
UNLISTED = 255


@dataclass(frozen=True)
class String:
    """A string output.

    Attributes:
        type: Its type; None for a sentence with a good checksum that the manual does not list.
        data: Its bytes as received, including the end of its line.
        offset: Byte offset at which it begins, from the start of the input or from when the port was opened.
        sample: Index of the next sample in a log; None for a live string.
        arrival: When its last byte arrived, in seconds on the clock of the link; None in a log.

    >>> string = parse_string("$PHTRO,10.37,P,177.62,T*65")
    >>> string.type.name, string.values
    ('PHTRO', {'pitch': -10.37, 'roll': 177.62})
    """

    type: StringType | None
    data: bytes
    offset: int = 0
    sample: int | None = None
    arrival: float | None = None

    @property
    def name(self) -> str:
        """The manual's name; for a sentence that it does not list, the text before the first comma."""
        if self.type is not None:
            return str(self.type.name)
        return self.text[1:].partition("*")[0].partition(",")[0]

    @property
    def text(self) -> str:
        """The string without the end of its line; a binary one in hex."""
        if self.type is StringType.EM1000:
            return self.data.hex(" ").upper()
        return self.data.decode("ascii").rstrip("\r\n")

    @cached_property
    def values(self) -> dict[str, Any]:
        """Values by field name: numbers in their `units`, letters, times and dates.

        None for a value that is not available: an empty field, or a date or time that does not exist. Roll
        and pitch are positive with port and bow up, deviation and variation to the east. Empty for a string
        of an unknown type.

        Raises:
            ValueError: The fields do not fit the type.
        """
        if self.type is None:
            return {}
        parts = split(self.type, self._body)
        values: dict[str, Any] = {}
        at = 0
        for field in STRING_FIELDS[self.type].fields:
            taken, at = parts[at : at + field.form.parts], at + field.form.parts
            if len(taken) < field.form.parts:
                if field.is_optional and not taken:
                    values[field.name] = None
                    continue
                raise ValueError(f"{self.type.name} ends before {_field_name(field)}")
            try:
                value = field.form.read(taken)
            except ValueError as error:
                raise ValueError(f"{self.type.name}, {_field_name(field)}: {error}") from None
            if field.name:
                values[field.name] = value
        if len(parts) > at:
            raise ValueError(f"{self.type.name} has {at} fields, not {len(parts)}")
        return values

    @property
    def units(self) -> dict[str, str]:
        """Unit of each value; empty for letters, counts, times and dates."""
        fields = STRING_FIELDS[self.type].fields if self.type is not None else ()
        return {field.name: field.unit for field in fields if field.name}

    @property
    def valid(self) -> bool | None:
        """Whether the string marks its values as valid; None if it has no field for that."""
        validity = STRING_FIELDS[self.type].validity if self.type is not None else None
        return None if validity is None else self.values[validity[0]] in validity[1]

    @property
    def _body(self) -> bytes:
        assert self.type is not None  # noqa: S101 - called only for strings with a type
        start = len(STARTS[self.type])
        if self.type is StringType.EM1000:
            return self.data[start:]
        body = self.data.rstrip(b"\r\n")[start:]
        return body[:-3] if body[-3:-2] == b"*" else body

    def __str__(self) -> str:
        return self.text

    def __repr__(self) -> str:
        return f"<String {self.text}>"


def _field_name(field: StringField) -> str:
    return field.name or "the letter after it"


def parse_string(data: bytes | str) -> String:
    """Parses one string, with or without the end of its line.

    Raises:
        DecodeError: The string is cut or too long, its checksum is wrong, or its fields do not fit its type.
            `DecodeError.offset` is the place in the string.

    >>> parse_string("$HCHDM,093.8,M*2B").values["heading"]
    93.8
    >>> parse_string(bytes.fromhex("00 90 7B 00 38 FE 00 00 39 30")).values["pitch"]
    -4.56
    """
    data = data.encode("utf-8") if isinstance(data, str) else bytes(data)
    if data.startswith(STARTS[StringType.EM1000]):
        if len(data) != 10:
            raise DecodeError(f"EM1000 has 10 bytes, not {len(data)}", min(len(data), 10))
        string = String(StringType.EM1000, data)
    else:
        string = String(_type(data), data)
    try:
        _ = string.values
    except ValueError as error:
        raise DecodeError(str(error), 0) from None
    if not _is_found(string):
        raise DecodeError(f"{string.name}: {_SHAPES[string.name]}", 0)
    return string


#: What is wrong with a string whose fields can be parsed but which the scanner does not accept.
_SHAPES = {
    "TSS2": "the characters do not match :DDDDD SMHHHHQMRRRRSMPPPPE",
    "PRDID": "the string must have exactly three numbers",
    "EM1000": "roll is at most 180, pitch 90 and heading 360 degrees",
}


def _is_found(string: String) -> bool:
    """Returns whether the scanner finds a string; it recognizes one without a checksum by its characters."""
    if string.name not in _SHAPES:
        return True
    data = string.data.rstrip(b"\r\n") + b"\r\n"
    if string.type is StringType.EM1000:
        data = string.data
    found = _core.Scanner(0, int(StringType.EM1000)).feed(data, last=True)
    strings = [item.data for item in found if isinstance(item, _core.ScannedString)]
    return strings == [data]


def _type(data: bytes) -> StringType | None:
    """Returns the type of a complete text string."""
    text = data.removesuffix(b"\n").removesuffix(b"\r")
    if not data.startswith((b"$", b":")):
        raise DecodeError(
            f"a string begins with $, : or 00 90, not with {data[:4].hex(' ').upper() or 'nothing'}",
            0,
        )
    if len(data) > LONGEST:
        raise DecodeError(
            f"a string has at most {LONGEST} bytes, not {len(data)}; pass a single line",
            LONGEST,
        )
    for at, byte in enumerate(text):
        if not 0x20 <= byte < 0x7F or (byte == 0x24 and at):
            raise DecodeError(
                f"byte {at} is 0x{byte:02X}; a string has printable characters only, with one $ in front",
                at,
            )
    kind = next((kind for kind, start in STARTS.items() if text.startswith(start)), None)
    body, star, checksum = text[1:].rpartition(b"*")
    if kind is StringType.TSS2:
        if len(text) != 25:
            raise DecodeError(f"TSS2 has 25 characters, not {len(text)}", min(len(text), 25))
        return kind
    if not star and kind is StringType.PRDID:
        return kind
    if not star or len(checksum) < 2:
        raise DecodeError(
            f"the end is missing: a sentence ends with * and two hex digits, not {text[-8:].decode()!r}",
            len(text),
        )
    expected = _checksum(body)
    if checksum.upper() != expected:
        raise DecodeError(
            f"the checksum is {checksum.decode()}, but the characters give {expected.decode()}",
            len(text) - len(checksum),
        )
    return kind


def _checksum(body: bytes) -> bytes:
    total = 0
    for byte in body:
        total ^= byte
    return b"%02X" % total


def encode_string(kind: StringType | str, values: Mapping[str, Any] | None = None) -> bytes:
    r"""Returns the bytes of a string output, as a device sends it.

    Args:
        kind: The type or its name.
        values: Values by field name: see `String.values`. A value that is missing, None or NaN gives an empty
            field; in TSS2 and EM1000, which have no empty fields, zero.

    Raises:
        ValueError: No such type or field, or a value that does not fit its field.

    >>> encode_string("HEHDT", {"heading": 123.45})
    b'$HEHDT,123.45,T*1E\r\n'
    """
    kind = one_type(kind)
    layout, values = STRING_FIELDS[kind], values or {}
    names = [field.name for field in layout.fields if field.name]
    if unknown := set(values) - set(names):
        raise ValueError(
            f"{kind.name} has no {sorted(unknown)[0]}; it has {', '.join(names)}"
        ) from None
    parts: list[str] = []
    for field in layout.fields:
        value = values.get(field.name)
        if value != value:
            value = None
        try:
            written = list(field.form.write(value))
            field.form.read(written)  # refuses what cannot be parsed, such as infinity
        except (ValueError, TypeError, AttributeError, OverflowError) as error:
            raise ValueError(
                f"{kind.name}, {field.name}: cannot encode {value!r}: {error}"
            ) from None
        parts += written
    try:
        body = STARTS[kind] + join(kind, parts)
    except (struct.error, UnicodeEncodeError) as error:
        raise ValueError(f"{kind.name}: a value does not fit: {error}") from None
    if not _is_found(String(kind, body)):
        raise ValueError(f"{kind.name}: a value does not fit: {_SHAPES[str(kind.name)]}")
    if kind is StringType.EM1000:
        return body
    if kind not in (StringType.TSS2, StringType.PRDID):
        body += b"*" + _checksum(body[1:])
    if len(body) + 2 > LONGEST:
        raise ValueError(f"{kind.name} would have {len(body) + 2} bytes; the limit is {LONGEST}")
    return body + b"\r\n"


def string_types(kinds: Iterable[StringType | str] | StringType) -> list[StringType]:
    """Returns string types that are given as flags or as names.

    Raises:
        TypeError: One name instead of a list, or an element that is neither name nor flag.
        ValueError: No string type has a given name.
    """
    if isinstance(kinds, str):
        raise TypeError(f"strings must be a list of names, such as [{kinds!r}]")
    if isinstance(kinds, StringType):
        if int(kinds) & ~sum(StringType):
            raise ValueError(f"0x{int(kinds):X} has bits that are not string types")
        return [kind for kind in StringType if kind in kinds]
    return [one for kind in kinds for one in string_types(_flags(kind))]


def _flags(kind: StringType | str) -> StringType:
    if isinstance(kind, StringType):
        return kind
    if not isinstance(kind, str):
        raise TypeError(f"a string type is a StringType or its name, not {kind!r}")
    if kind not in StringType.__members__:
        names = ", ".join(StringType.__members__)
        raise ValueError(f"no string is called {kind!r}; there are {names}")
    return StringType[kind]


def one_type(kind: StringType | str) -> StringType:
    """Returns one string type. Raises as `string_types`, and ValueError for several types."""
    kinds = string_types([kind])
    if len(kinds) != 1:
        raise ValueError(f"expected one string type, not {len(kinds)}")
    return kinds[0]


def mask_of(kinds: Iterable[StringType | str]) -> int:
    """Returns string types as the bits of `StringType`. Raises as `string_types`."""
    return sum(set(string_types(kinds)))


def type_at(place: int | None) -> StringType | None:
    """Returns the string type at a place in the table of the core; None if the manual does not list it."""
    return None if place is None or place == UNLISTED else StringType(1 << place)
