"""How a payload is laid out: values to bytes, bytes to values, and words of a command line to values.

A layout is made of the few kinds below. All numbers are big-endian (section 5.1.1).
"""

from __future__ import annotations

import dataclasses
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import IntEnum, IntFlag
from types import SimpleNamespace
from typing import Any

from xbus.protocol.values import known

__all__ = [
    "NOTHING",
    "RAW",
    "Layout",
    "by_length",
    "field",
    "mapped",
    "number",
    "record",
    "repeated",
    "text",
]


@dataclass(frozen=True)
class Layout:
    """One way to lay out a payload.

    Attributes:
        encode: Value to bytes; raises ValueError for what does not fit, saying which field.
        decode: Bytes to value; raises ValueError where the length is wrong.
        fields: What it is made of: a reader of words for each name.
        make: The value, from what the readers gave.
        several: Whether the value is a list, and ``fields`` are those of one entry.
    """

    encode: Callable[[Any], bytes]
    decode: Callable[[bytes], Any]
    fields: Mapping[str, Callable[[str], Any]] = dataclasses.field(default_factory=dict)
    make: Callable[..., Any] = lambda: None
    several: bool = False

    def read(self, words: list[str]) -> Any:
        """The value that words describe: ``name=value`` each, or ``name=value,name=value`` for an entry.

        Raises:
            ValueError: A name is unknown or missing, or a value cannot be read.
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
            if name not in self.fields:
                names = ", ".join(self.fields) or "none"
                raise ValueError(f"no field is called {name!r}; there are: {names}")
            try:
                given[name] = self.fields[name](value)
            except ValueError as error:
                raise ValueError(f"{name}: {error}") from None
        try:
            return self.make(**given)
        except TypeError:
            missing = ", ".join(it for it in self.fields if it not in given)
            raise ValueError(f"fields are missing: {missing}") from None


def _no_value(value: None) -> bytes:
    if value is not None:
        raise ValueError(f"this message carries nothing, not {value!r}")
    return b""


def _no_bytes(payload: bytes) -> None:
    if payload:
        raise ValueError(f"it carries {len(payload)} bytes, not none")


#: A payload of no bytes; its value is None.
NOTHING = Layout(_no_value, _no_bytes)
#: A payload that is taken as it is; its value is bytes.
RAW = Layout(bytes, bytes, {"data": bytes.fromhex}, lambda data: data)


@dataclass(frozen=True)
class Field:
    """One number: its letter in `struct`, and the type of its value."""

    code: str
    kind: Any = int

    def to_wire(self, value: Any) -> Any:
        """The number to write."""
        if self.code in "fd":
            return float(value)
        if self.code.endswith("s"):
            return value.encode("ascii").ljust(int(self.code[:-1]))
        return int(value)

    def from_wire(self, number: Any) -> Any:
        """The value of a number that was read."""
        if self.kind is str:
            return number.decode("ascii", "replace").rstrip(" \0")
        return known(self.kind, number) if issubclass(self.kind, IntEnum) else self.kind(number)

    def read(self, word: str) -> Any:
        """The value that a word names: a number, a name, or names joined with ``|``."""
        if self.kind is bool:
            if word.lower() not in ("0", "1", "false", "true"):
                raise ValueError(f"{word!r} is neither true nor false")
            return word.lower() in ("1", "true")
        if self.kind is str:
            return word
        if self.code in "fd":
            return float(word)
        members = getattr(self.kind, "__members__", {})
        try:
            return self.from_wire(int(word, 0))
        except ValueError:
            if not members:
                raise ValueError(f"{word!r} is no number") from None
        try:
            found = [members[it.strip().upper()] for it in word.split("|")]
        except KeyError as error:
            raise ValueError(f"{error.args[0]!r} is none of {', '.join(members)}") from None
        if issubclass(self.kind, IntFlag):
            return self.kind(sum(set(map(int, found))))
        if len(found) > 1:
            raise ValueError(f"{word!r}: only one of them can be")
        return found[0]


def field(code: str, kind: Any = int) -> Field:
    """One number of a record: its letter in `struct` (``20s``: text filled with spaces), and its type."""
    return Field(code, kind)


def record(make: Callable[..., Any], /, **fields: Field) -> Layout:
    """Fields in the order of the wire, which values have as attributes."""
    wire = struct.Struct(">" + "".join(it.code for it in fields.values()))

    def encode(value: Any) -> bytes:
        numbers = []
        for name, it in fields.items():
            item = getattr(value, name)
            try:
                numbers.append(it.to_wire(item))
                struct.pack(">" + it.code, numbers[-1])
            except (struct.error, OverflowError, TypeError, ValueError, UnicodeError):
                raise ValueError(f"{name} cannot be {item!r}: {_range(it)}") from None
        return wire.pack(*numbers)

    def decode(payload: bytes) -> Any:
        if len(payload) != wire.size:
            raise ValueError(f"it has {len(payload)} bytes, not {wire.size}")
        pairs = zip(fields.items(), wire.unpack(payload), strict=True)
        return make(**{name: it.from_wire(number) for (name, it), number in pairs})

    return Layout(encode, decode, {name: it.read for name, it in fields.items()}, make)


def number(name: str, code: str, kind: Any = int) -> Layout:
    """A single number; ``name`` is what it is called on the command line."""

    def value(**given: Any) -> Any:
        if name not in given:
            raise TypeError
        return given[name]

    one = record(value, **{name: field(code, kind)})
    return mapped(one, lambda it: it, lambda it: SimpleNamespace(**{name: it}))


def _range(it: Field) -> str:
    if it.code in "fd":
        return "it must be a number"
    if it.code.endswith("s"):
        return f"it must be ASCII of at most {it.code[:-1]} characters"
    bits = 8 * struct.calcsize(">" + it.code)
    least, most = (
        (-(1 << bits - 1), (1 << bits - 1) - 1) if it.code.islower() else (0, (1 << bits) - 1)
    )
    return f"it must be an integer from {least} to {most}"


def repeated(entry: Layout, size: int, most: int) -> Layout:
    """Any number of entries of ``size`` bytes, at most ``most``; the value is a tuple.

    An empty payload would be a request, so an empty list is written as one entry of zeros; and read as such.
    """

    def encode(values: Any) -> bytes:
        values = tuple(values)
        if len(values) > most:
            raise ValueError(f"there are {len(values)} entries, and the message holds {most}")
        return b"".join(map(entry.encode, values)) or bytes(size)

    def decode(payload: bytes) -> Any:
        if len(payload) % size:
            raise ValueError(f"its {len(payload)} bytes are no entries of {size}")
        if payload == bytes(size):
            return ()
        return tuple(entry.decode(payload[at : at + size]) for at in range(0, len(payload), size))

    return Layout(encode, decode, entry.fields, entry.make, several=True)


def mapped(layout: Layout, to: Callable[[Any], Any], back: Callable[[Any], Any]) -> Layout:
    """A layout whose values go through ``to`` when they were read, and ``back`` before they are written."""
    return dataclasses.replace(
        layout,
        encode=lambda value: layout.encode(back(value)),
        decode=lambda payload: to(layout.decode(payload)),
    )


def by_length(layouts: Mapping[int, Layout], choose: Callable[[Any], int]) -> Layout:
    """Layouts that differ in length; ``choose`` says for a value which to write. The first reads words."""

    def decode(payload: bytes) -> Any:
        if len(payload) not in layouts:
            raise ValueError(f"it has {len(payload)} bytes, not {' or '.join(map(str, layouts))}")
        return layouts[len(payload)].decode(payload)

    def encode(value: Any) -> bytes:
        return layouts[choose(value)].encode(value)

    first = next(iter(layouts.values()))
    return Layout(encode, decode, first.fields, first.make)


def text(most: int, filled: int = 0) -> Layout:
    """ASCII without an end mark, filled with spaces to ``filled`` bytes.

    What is read is cut at the first space or NUL, as the vendor's software does it: some firmware fills what
    need not be filled.
    """

    def encode(value: str) -> bytes:
        if not value or not value.isascii() or len(value) > most:
            raise ValueError(f"{value!r} is not 1 to {most} ASCII characters")
        return value.encode("ascii").ljust(filled)

    def decode(payload: bytes) -> str:
        return payload.decode("ascii", "replace").replace("\0", " ").split(" ", 1)[0]

    return Layout(encode, decode, {"text": str}, lambda text: text)
