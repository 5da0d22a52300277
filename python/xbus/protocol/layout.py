"""Layouts of payloads: values to bytes, bytes to values, and words of a command line to values.

Layouts are made from the rows of the table of messages, which give names, types and lengths of the fields.
All numbers are big-endian (section 5.1.1).
"""

from __future__ import annotations

import contextlib
import inspect
import math
import struct
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from dataclasses import field as attribute
from enum import IntEnum, IntFlag
from functools import reduce
from operator import or_
from typing import Any, get_args, get_type_hints

from xbus.protocol.tables import MessageField, MessageRow
from xbus.protocol.values import known

__all__ = [
    "NOTHING",
    "RAW",
    "FieldLayout",
    "Form",
    "Layout",
    "kinds_of",
    "layout_of",
    "mapped",
    "record",
    "repeated",
]


@dataclass(frozen=True)
class Layout:
    """One way to lay out a payload.

    Attributes:
        encode: Value to bytes; raises ValueError with the name of the field that does not fit.
        decode: Bytes to value; raises ValueError for a wrong length.
        fields: The fields by name, each with the function that reads its value from a word.
        kinds: The types of their values by name: `int`, `float`, `str`, `bytes`, `bool`, or a class of
            enumerations or flags, whose names a word may have.
        aliases: Other names that a word may have, each with the field and the function that reads its value.
        make: Makes the value from the values of its fields.
        several: Whether the value is a list, and ``fields`` are those of one entry.
    """

    encode: Callable[[Any], bytes]
    decode: Callable[[bytes], Any]
    fields: Mapping[str, Callable[[str], Any]] = attribute(default_factory=dict)
    make: Callable[..., Any] = lambda: None
    several: bool = False
    kinds: Mapping[str, Any] = attribute(default_factory=dict)
    aliases: Mapping[str, tuple[str, Callable[[str], Any]]] = attribute(default_factory=dict)

    def read(self, words: list[str]) -> Any:
        """Returns the value of words: ``name=value`` each, or ``name=value,name=value`` for a list entry.

        The name of an only field may be left out.

        Raises:
            ValueError: A name is unknown, missing or given twice, or a value cannot be read.
        """
        if self.several:
            return tuple(self._one(entry.split(",")) for entry in words)
        return self._one(words)

    def _one(self, words: list[str]) -> Any:
        given: dict[str, Any] = {}
        for word in words:
            name, equals, value = word.partition("=")
            if not equals and len(self.fields) == 1:
                (name,), value = self.fields, word
            field, read = self.aliases.get(name) or (name, self.fields.get(name))
            if read is None:
                names = ", ".join((*self.fields, *self.aliases)) or "none"
                raise ValueError(f"no field is called {name!r}; there are: {names}")
            if field in given:
                raise ValueError(f"{field} is given twice")
            try:
                given[field] = read(value)
            except ValueError as error:
                raise ValueError(f"{name}: {error}") from None
        needed = [name for name in self.fields if self._is_needed(name)]
        if missing := [name for name in needed if name not in given]:
            raise ValueError(f"fields are missing: {', '.join(missing)}")
        return self.make(**given)

    def _is_needed(self, name: str) -> bool:
        parameter = inspect.signature(self.make).parameters.get(name)
        return parameter is None or parameter.default is inspect.Parameter.empty


def _no_value(value: None) -> bytes:
    if value is not None:
        raise ValueError(f"this message has no payload, so its value must be None, not {value!r}")
    return b""


def _no_bytes(payload: bytes) -> None:
    if payload:
        raise ValueError(f"the payload has {len(payload)} bytes, not none")


def _raw(value: bytes) -> bytes:
    # bytes(5) would be five zeros.
    if not isinstance(value, (bytes, bytearray, memoryview)):
        raise ValueError(f"data cannot be {value!r}: it must be bytes")  # noqa: TRY004 - every misfit is a ValueError
    return bytes(value)


def _hex(text: str) -> bytes:
    try:
        return bytes.fromhex(text)
    except ValueError:
        raise ValueError(f"{text!r} is not hex; write bytes, such as 0A 1B") from None


#: A payload of no bytes; its value is None.
NOTHING = Layout(_no_value, _no_bytes)
#: A payload that is passed on unchanged; its value is bytes.
RAW = Layout(_raw, bytes, {"data": _hex}, lambda data: data, kinds={"data": bytes})

#: Format characters of `struct`.
_CODES = {
    "u1": "B", "u2": "H", "u4": "I", "u8": "Q", "i1": "b", "i2": "h", "i4": "i", "f4": "f", "f8": "d",
}  # fmt: skip
#: The Python type of each type on the wire, unless the class of the value names another.
_TYPES: dict[str, type] = {"text": str, "bytes": bytes, "f4": float, "f8": float}


class FieldLayout:
    """One field of a record.

    Args:
        field: Its row in the table.
        kind: The type of its value, for an integer: `int`, `bool`, or an enumeration.

    Attributes:
        name: Its name.
        size: Bytes on the wire; the fewest if the field takes the rest of the payload.
    """

    def __init__(self, field: MessageField, kind: type = int) -> None:
        self.field, self.name = field, field.name
        self.kind: Any = _TYPES.get(field.type, kind)
        self._is_text = field.type in ("text", "bytes")
        code = "s" if self._is_text else _CODES[field.type]
        self._wire = struct.Struct(f">{field.repeat}{code}")
        self.size = 0 if field.rest else self._wire.size

    def encode(self, value: Any) -> bytes:
        """Returns the bytes of a value. Raises ValueError, with the name of the field, if it does not fit."""
        with contextlib.suppress(
            struct.error, OverflowError, TypeError, AttributeError, ValueError
        ):
            if self._is_text:
                data = value.encode("ascii") if self.kind is str else value
                if len(data) <= self.field.repeat and self.field.rest:
                    return bytes(data)
                if len(data) <= self.field.repeat:
                    return self._wire.pack(data.ljust(self.size) if self.kind is str else data)
            else:
                numbers = value if self.field.repeat > 1 else (value,)
                if all(map(self._is_valid, numbers)):
                    return self._wire.pack(*numbers)
        raise ValueError(f"{self.name} cannot be {value!r}: it must be {self._range()}")

    def _is_valid(self, number: Any) -> bool:
        """Returns whether a number has the type of the field; `struct` takes NaN, and bools as numbers."""
        if self.kind is bool:
            return number in (0, 1)
        is_finite = self.kind is not float or math.isfinite(number)
        return is_finite and not isinstance(number, bool)

    def decode(self, data: bytes) -> Any:
        """Returns the value of as many bytes as the field has."""
        if self._is_text:
            return data.decode("ascii", "replace").rstrip(" \0") if self.kind is str else data
        numbers = tuple(map(self._value, self._wire.unpack(data)))
        return numbers if self.field.repeat > 1 else numbers[0]

    def _value(self, number: Any) -> Any:
        return known(self.kind, number) if issubclass(self.kind, IntEnum) else self.kind(number)

    def read(self, word: str) -> Any:
        """Returns the value of a word: a number, a name, names joined with ``|``, or several numbers."""
        if self.field.repeat > 1 and not self._is_text:
            numbers = tuple(map(self._read, word.split(",")))
            if len(numbers) != self.field.repeat:
                repeat = self.field.repeat
                raise ValueError(f"{word!r} is not {repeat} numbers separated by commas")
            return numbers
        return self._read(word)

    def _read(self, word: str) -> Any:
        if self.kind is bool:
            if word.lower() not in ("0", "1", "false", "true"):
                raise ValueError(f"{word!r} is neither true nor false")
            return word.lower() in ("1", "true")
        if self.kind in (str, float):
            return self.kind(word)
        parts = [self._number(part) for part in word.split("|")]
        if len(parts) > 1 and not issubclass(self.kind, IntFlag):
            raise ValueError(f"{word!r}: the field takes one name, not several")
        return self._value(reduce(or_, parts))

    def _number(self, word: str) -> int:
        names = getattr(self.kind, "__members__", {})
        members = {name.upper(): member for name, member in names.items()}
        if (member := members.get(word.strip().upper())) is not None:
            return int(member)
        try:
            return int(word, 0)
        except ValueError:
            wanted = f"not one of {', '.join(members)}" if members else "not a number"
            raise ValueError(f"{word!r} is {wanted}") from None

    def _range(self) -> str:
        if self.kind is bytes:
            return f"at most {self.field.repeat} bytes"
        if self.kind is str:
            return f"ASCII of at most {self.field.repeat} characters"
        if self.kind is bool:
            return "true or false"
        if self.field.repeat > 1:
            return f"{self.field.repeat} finite numbers that its format holds"
        if self.kind is float:
            return "a finite number that its format holds"
        bits = 8 * self.size
        least = -(1 << bits - 1) if self.field.type.startswith("i") else 0
        return f"an integer from {least} to {least + (1 << bits) - 1}"


class Form:
    """A record: fields in the order of the wire."""

    def __init__(self, fields: Sequence[FieldLayout]) -> None:
        self.fields = fields
        self.size = sum(field.size for field in fields)
        self.has_rest = fields[-1].field.rest

    def encode(self, values: Mapping[str, Any]) -> bytes:
        """Returns the bytes of the values by name."""
        return b"".join(field.encode(values[field.name]) for field in self.fields)

    def fits(self, length: int) -> bool:
        """Returns whether a payload of this length can be the record; its last field may be too long."""
        return length >= self.size if self.has_rest else length == self.size

    def decode(self, payload: bytes) -> dict[str, Any]:
        """Returns the values by name."""
        values, at = {}, 0
        for field in self.fields:
            end = len(payload) if field.field.rest else at + field.size
            values[field.name] = field.decode(payload[at:end])
            at = end
        return values


def layout_of(row: MessageRow, kind: Any = int) -> Layout:
    """Returns the layout of a message, by its row in the table.

    Args:
        row: The row.
        kind: The type of its value: of a single number `int` or an enumeration, of a record or of the
            entries of a list a class with the fields as attributes. Annotations of that class name the
            enumerations of its fields.
    """
    match row.kind:
        case "empty":
            return NOTHING
        case "bytes":
            return RAW
        case "text":
            return _text(row.most, row.most if row.filled else 0)
        case "list":
            return repeated(record(row.forms, kind), row)
    return record(row.forms, kind)


def record(
    forms: Sequence[Sequence[MessageField]], kind: Any, kinds: Mapping[str, type] | None = None
) -> Layout:
    """Returns the layout of a record, or of several that differ in length.

    Args:
        forms: The fields of each record, the longest first. Fields that a payload lacks have the value None.
        kind: As in `layout_of`.
        kinds: Enumerations of the fields by name, instead of those that annotations of ``kind`` name.
    """
    names = tuple(dict.fromkeys(field.name for form in forms for field in form))
    is_number = issubclass(kind, int)
    if kinds is None:
        kinds = {names[0]: kind} if is_number else kinds_of(kind)
    parts = [
        Form([FieldLayout(field, kinds.get(field.name, int)) for field in form]) for form in forms
    ]

    def encode(value: Any) -> bytes:
        if is_number:
            return parts[0].encode({names[0]: value})
        # A value of another class may lack some fields.
        values = {name: getattr(value, name, None) for name in names}
        held = {name for name, item in values.items() if item is not None}
        whole = (form for form in parts if held.issuperset(field.name for field in form.fields))
        return next(whole, parts[0]).encode(values)

    def decode(payload: bytes) -> Any:
        form = next((form for form in parts if form.fits(len(payload))), None)
        if form is None:
            sizes = " or ".join(str(size) for size in sorted(form.size for form in parts))
            least = "at least " if parts[0].has_rest else ""
            raise ValueError(f"the payload has {len(payload)} bytes, not {least}{sizes}")
        return make(**{**dict.fromkeys(names), **form.decode(payload)})

    make = (lambda **given: given[names[0]]) if is_number else kind
    found = {field.name: field for form in reversed(parts) for field in form.fields}
    readers = {name: found[name].read for name in names}
    return Layout(encode, decode, readers, make, kinds={name: found[name].kind for name in names})


def kinds_of(record: type) -> dict[str, type]:
    """Returns the enumerations and bools among the annotations of a class, by field."""
    kinds: dict[str, type] = {}
    for name, hint in get_type_hints(record).items():
        for option in get_args(hint) or (hint,):
            if isinstance(option, type) and issubclass(option, IntEnum | IntFlag | bool):
                kinds[name] = option
    return kinds


def repeated(entry: Layout, row: MessageRow) -> Layout:
    """Returns the layout of a list: entries of one size, up to the number in the row. The value is a tuple.

    An empty payload is a request, so a message to the device writes an empty list as one entry of zeros, and
    so do some answers. One entry of zeros is read as an empty list in any case.
    """
    size = sum(FieldLayout(field).size for field in row.forms[0])

    def encode(values: Any) -> bytes:
        if not isinstance(values, Iterable):
            raise ValueError(f"{values!r} is not a list")  # noqa: TRY004 - every misfit is a ValueError
        values = tuple(values)
        if len(values) > row.most:
            raise ValueError(f"there are {len(values)} entries, and the message holds {row.most}")
        if not values and row.zeros:
            return bytes(size)
        return b"".join(map(entry.encode, values))

    def decode(payload: bytes) -> Any:
        if len(payload) % size:
            raise ValueError(f"the payload has {len(payload)} bytes, not entries of {size}")
        if payload == bytes(size):
            return ()
        return tuple(entry.decode(payload[at : at + size]) for at in range(0, len(payload), size))

    return replace(entry, encode=encode, decode=decode, several=True)


def mapped(layout: Layout, to: Callable[[Any], Any], back: Callable[[Any], Any]) -> Layout:
    """Returns a layout whose values go through ``to`` after decoding, and through ``back`` before encoding.

    Words are read as before. If ``back`` does not accept the value that `make` returns, replace `fields` and
    `make` too.
    """
    return replace(
        layout,
        encode=lambda value: layout.encode(back(value)),
        decode=lambda payload: to(layout.decode(payload)),
    )


def _text(most: int, filled: int) -> Layout:
    """Returns the layout of ASCII text without a terminator, padded with spaces to ``filled`` bytes.

    Decoded text ends at the first space or NUL, as in the vendor's software: some firmware pads text that
    needs no padding.
    """

    def encode(value: str) -> bytes:
        is_plain = isinstance(value, str) and value.isascii() and value.isprintable()
        if not is_plain or " " in value or not 1 <= len(value) <= most:
            raise ValueError(
                f"text cannot be {value!r}: it must be 1 to {most} ASCII letters, no space"
            )
        return value.encode("ascii").ljust(filled)

    def decode(payload: bytes) -> str:
        return payload.decode("ascii", "replace").replace("\0", " ").split(" ", 1)[0]

    return Layout(encode, decode, {"text": str}, lambda text: text, kinds={"text": str})
