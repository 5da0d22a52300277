"""The strings that a device sends in the place of MTData2, or between its frames (section 5.3.5)."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from xbus import _core
from xbus.errors import DecodeError
from xbus.protocol.strings import LAYOUTS, STARTS, StringField, join, split
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

#: Bytes of the longest string that is believed in; the longest of the manual, PSONCMS, has up to 130.
LONGEST = 255
#: How a core names a string that the manual does not list.
UNLISTED = 255


@dataclass(frozen=True)
class String:
    """A string output.

    Attributes:
        type: Which one; None for a sentence with a good checksum that the manual does not list.
        data: Its bytes as they came, the end of the line included.
        offset: Where it begins, in bytes from the start of the input, or since the port was opened.
        sample: Index of the next sample, in a log.
        arrival: When its last byte came, seconds on the clock of the link, live; see `Sample.arrival`.

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
        """The manual's name; of a sentence that it does not list what stands before the first comma."""
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
        """What it says by the names of its fields: numbers in their `units`, letters, times, dates.

        None is what is not available: an empty field, or a date or time that does not exist. Angles of
        roll and pitch are positive where port and bow are up, deviations and variations to the east. Empty
        for a string of no known type.

        Raises:
            ValueError: Its fields are not those of its type.
        """
        if self.type is None:
            return {}
        parts = split(self.type, self._body)
        values: dict[str, Any] = {}
        at = 0
        for field in LAYOUTS[self.type].fields:
            taken, at = parts[at : at + field.form.parts], at + field.form.parts
            if len(taken) < field.form.parts:
                if field.is_optional and not taken:
                    values[field.name] = None
                    continue
                raise ValueError(f"{self.type.name}: it ends in front of {_called(field)}")
            try:
                value = field.form.read(taken)
            except ValueError as error:
                raise ValueError(f"{self.type.name}, {_called(field)}: {error}") from None
            if field.name:
                values[field.name] = value
        if len(parts) > at:
            raise ValueError(f"{self.type.name} has {at} fields, not {len(parts)}")
        return values

    @property
    def units(self) -> dict[str, str]:
        """The unit of each of its values; empty for letters, counts, times and dates."""
        fields = LAYOUTS[self.type].fields if self.type is not None else ()
        return {it.name: it.unit for it in fields if it.name}

    @property
    def valid(self) -> bool | None:
        """Whether it says that its values are valid; None where it has no field for that."""
        validity = LAYOUTS[self.type].validity if self.type is not None else None
        return None if validity is None else self.values[validity[0]] in validity[1]

    @property
    def _body(self) -> bytes:
        assert self.type is not None  # noqa: S101 - asked only of those that have one
        start = len(STARTS[self.type])
        if self.type is StringType.EM1000:
            return self.data[start:]
        body = self.data.rstrip(b"\r\n")[start:]
        return body[:-3] if body[-3:-2] == b"*" else body

    def __str__(self) -> str:
        return self.text

    def __repr__(self) -> str:
        return f"<String {self.text}>"


def _called(field: StringField) -> str:
    return field.name or "the letter behind it"


def parse_string(data: bytes | str) -> String:
    """Reads one string, with or without the end of its line.

    Raises:
        DecodeError: It is cut or too long, its checksum does not hold, or its fields are not those of its
            type; `DecodeError.offset` says where in it.

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


#: What is wrong with a string whose fields can be read, and that is none all the same.
_SHAPES = {
    "TSS2": "its characters are not those of :DDDDD SMHHHHQMRRRRSMPPPPE",
    "PRDID": "it has three numbers and nothing else",
    "EM1000": "roll goes to 180, pitch to 90 and heading to 360 degrees",
}


def _is_found(string: String) -> bool:
    """Whether the scanner finds a string that has no checksum, only characters in their places."""
    if string.name not in _SHAPES:
        return True
    data = string.data.rstrip(b"\r\n") + b"\r\n"
    if string.type is StringType.EM1000:
        data = string.data
    found = _core.Scanner(0, int(StringType.EM1000)).feed(data, last=True)
    strings = [item.data for item in found if isinstance(item, _core.ScannedString)]
    return strings == [data]


def _type(data: bytes) -> StringType | None:
    """The type of a string that is text, which is whole."""
    text = data.removesuffix(b"\n").removesuffix(b"\r")
    if not data.startswith((b"$", b":")):
        raise DecodeError(
            f"a string begins with $ or :, or with 00 90, not with {data[:4].hex(' ').upper() or 'nothing'}",
            0,
        )
    if len(data) > LONGEST:
        raise DecodeError(
            f"a string has at most {LONGEST} bytes, not {len(data)}: where is the end of its line?",
            LONGEST,
        )
    for at, byte in enumerate(text):
        if not 0x20 <= byte < 0x7F or (byte == 0x24 and at):
            raise DecodeError(
                f"byte {at} is 0x{byte:02X}, and strings are of printable characters, with one $ in front",
                at,
            )
    kind = next((it for it, start in STARTS.items() if text.startswith(start)), None)
    body, star, checksum = text[1:].rpartition(b"*")
    if kind is StringType.TSS2:
        if len(text) != 25:
            raise DecodeError(f"TSS2 has 25 characters, not {len(text)}", min(len(text), 25))
        return kind
    if not star and kind is StringType.PRDID:
        return kind
    if not star or len(checksum) < 2:
        raise DecodeError(
            f"it is cut: a sentence ends with * and two digits of checksum, not with {text[-8:].decode()!r}",
            len(text),
        )
    expected = _checksum(body)
    if checksum.upper() != expected:
        raise DecodeError(
            f"its checksum is {checksum.decode()}, and its characters make {expected.decode()}",
            len(text) - len(checksum),
        )
    return kind


def _checksum(body: bytes) -> bytes:
    total = 0
    for byte in body:
        total ^= byte
    return b"%02X" % total


def encode_string(kind: StringType | str, values: Mapping[str, Any] | None = None) -> bytes:
    r"""The bytes of a string output, as a device would send it.

    Args:
        kind: Which one, or its name.
        values: What it says: see `String.values`. What is left out, None or NaN is not available, and
            its field is empty; in TSS2 and EM1000, which have no empty fields, it is zero.

    Raises:
        ValueError: No such string or field, or a value that the field cannot say.

    >>> encode_string("HEHDT", {"heading": 123.45})
    b'$HEHDT,123.45,T*1E\r\n'
    """
    kind = one_type(kind)
    layout, values = LAYOUTS[kind], values or {}
    names = [it.name for it in layout.fields if it.name]
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
            field.form.read(written)  # what cannot be read, infinity for one, is not to be written
        except (ValueError, TypeError, AttributeError, OverflowError) as error:
            raise ValueError(
                f"{kind.name}, {field.name}: it cannot be {value!r}: {error}"
            ) from None
        parts += written
    try:
        body = STARTS[kind] + join(kind, parts)
    except (struct.error, UnicodeEncodeError) as error:
        raise ValueError(f"{kind.name} cannot say that: {error}") from None
    if not _is_found(String(kind, body)):
        raise ValueError(f"{kind.name} cannot say that: {_SHAPES[str(kind.name)]}")
    if kind is StringType.EM1000:
        return body
    if kind not in (StringType.TSS2, StringType.PRDID):
        body += b"*" + _checksum(body[1:])
    if len(body) + 2 > LONGEST:
        raise ValueError(f"{kind.name} would have {len(body) + 2} bytes; {LONGEST} is the most")
    return body + b"\r\n"


def string_types(kinds: Iterable[StringType | str] | StringType) -> list[StringType]:
    """The types of strings that are named: by flags, or by their names.

    Raises:
        ValueError: No string is called like that.
        TypeError: One name where names are expected, or what is neither name nor flag.
    """
    if isinstance(kinds, str):
        raise TypeError(f"strings must be a list of names, such as [{kinds!r}]")
    if isinstance(kinds, StringType):
        if int(kinds) & ~sum(StringType):
            raise ValueError(f"0x{int(kinds):X} has bits that are no strings")
        return [it for it in StringType if it in kinds]
    return [one for it in kinds for one in string_types(_flags(it))]


def _flags(kind: StringType | str) -> StringType:
    if isinstance(kind, StringType):
        return kind
    if not isinstance(kind, str):
        raise TypeError(f"a string is named by a StringType or a name, not by {kind!r}")
    if kind not in StringType.__members__:
        names = ", ".join(StringType.__members__)
        raise ValueError(f"no string is called {kind!r}; there are {names}")
    return StringType[kind]


def one_type(kind: StringType | str) -> StringType:
    """The one type that ``kind`` names. Raises as `string_types`, and ValueError for several types."""
    kinds = string_types([kind])
    if len(kinds) != 1:
        raise ValueError(f"one string is to be named, not {len(kinds)}")
    return kinds[0]


def mask_of(kinds: Iterable[StringType | str]) -> int:
    """The types of strings that are named, as the bits of `StringType`. Raises as `string_types`."""
    return sum(set(string_types(kinds)))


def type_at(place: int | None) -> StringType | None:
    """The type at a place in the core's table; None for what the manual does not list."""
    return None if place is None or place == UNLISTED else StringType(1 << place)
