"""How a payload is laid out: values to bytes, bytes to values, and words of a command line to values.

A layout is made of the few kinds below. All numbers are big-endian (section 5.1.1).
"""

from __future__ import annotations

import inspect
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from dataclasses import field as attribute
from enum import IntEnum, IntFlag
from functools import partial, reduce
from operator import or_
from typing import Any

from xbus.protocol.values import known

__all__ = [
    "NOTHING",
    "RAW",
    "Field",
    "Layout",
    "by_length",
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
    fields: Mapping[str, Callable[[str], Any]] = attribute(default_factory=dict)
    make: Callable[..., Any] = lambda: None
    several: bool = False

    def read(self, words: list[str]) -> Any:
        """The value that words describe: ``name=value`` each, or ``name=value,name=value`` for an entry.

        Where there is one field only, its name may be left out.

        Raises:
            ValueError: A name is unknown, missing or there twice, or a value cannot be read.
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
            if name in given:
                raise ValueError(f"{name} is there twice")
            try:
                given[name] = self.fields[name](value)
            except ValueError as error:
                raise ValueError(f"{name}: {error}") from None
        if missing := [it for it in self.fields if it not in given and self._is_needed(it)]:
            raise ValueError(f"fields are missing: {', '.join(missing)}")
        return self.make(**given)

    def _is_needed(self, name: str) -> bool:
        parameter = inspect.signature(self.make).parameters.get(name)
        return parameter is None or parameter.default is inspect.Parameter.empty


def _no_value(value: None) -> bytes:
    if value is not None:
        raise ValueError(f"this message carries nothing, not {value!r}")
    return b""


def _no_bytes(payload: bytes) -> None:
    if payload:
        raise ValueError(f"it carries {len(payload)} bytes, not none")


def _raw(value: bytes) -> bytes:
    # bytes(5) would be five zeros.
    if not isinstance(value, (bytes, bytearray, memoryview)):
        raise ValueError(f"data cannot be {value!r}: it must be bytes")  # noqa: TRY004 - as all of them
    return bytes(value)


#: A payload of no bytes; its value is None.
NOTHING = Layout(_no_value, _no_bytes)
#: A payload that is taken as it is; its value is bytes.
RAW = Layout(_raw, bytes, {"data": bytes.fromhex}, lambda data: data)


@dataclass(frozen=True)
class Field:
    """One number of a record, or text of a fixed length.

    Attributes:
        code: Its letter in `struct`; ``20s`` for text.
        kind: The type of its value. Text (`str`) is filled with spaces, `bytes` with zeros.
    """

    code: str
    kind: Any = int

    def to_wire(self, name: str, value: Any) -> bytes:
        """Its bytes; raises ValueError, saying ``name``, for a value that they cannot hold."""
        try:
            if self.kind not in (str, bytes):
                return struct.pack(f">{self.code}", value)
            data = value.encode("ascii").ljust(self.size) if self.kind is str else value
            if len(data) <= self.size:
                return struct.pack(f">{self.code}", data)
        except (struct.error, OverflowError, TypeError, AttributeError, UnicodeError):
            pass
        raise ValueError(f"{name} cannot be {value!r}: it must be {self._range()}")

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
        if self.kind is float:
            return float(word)
        parts = [self._number(it) for it in word.split("|")]
        if len(parts) > 1 and not issubclass(self.kind, IntFlag):
            raise ValueError(f"{word!r}: only one of them can be")
        return self.from_wire(reduce(or_, parts))

    def _number(self, word: str) -> int:
        members = {name.upper(): it for name, it in getattr(self.kind, "__members__", {}).items()}
        if (member := members.get(word.strip().upper())) is not None:
            return int(member)
        try:
            return int(word, 0)
        except ValueError:
            wanted = f"none of {', '.join(members)}" if members else "no number"
            raise ValueError(f"{word!r} is {wanted}") from None

    @property
    def size(self) -> int:
        """How many bytes it has."""
        return struct.calcsize(f">{self.code}")

    def _range(self) -> str:
        if self.kind is float:
            return "a number that its format holds"
        if self.kind in (str, bytes):
            return f"ASCII of at most {self.size} characters"
        bits = 8 * self.size
        least = -(1 << bits - 1) if self.code.islower() else 0
        return f"an integer from {least} to {least + (1 << bits) - 1}"


def record(make: Callable[..., Any], /, **fields: Field) -> Layout:
    """Fields in the order of the wire, which values have as attributes."""
    wire = struct.Struct(">" + "".join(it.code for it in fields.values()))

    def encode(value: Any) -> bytes:
        # A value of another type lacks them.
        items = ((name, it, getattr(value, name, None)) for name, it in fields.items())
        return b"".join(it.to_wire(name, item) for name, it, item in items)

    def decode(payload: bytes) -> Any:
        if len(payload) != wire.size:
            raise ValueError(f"it has {len(payload)} bytes, not {wire.size}")
        pairs = zip(fields.items(), wire.unpack(payload), strict=True)
        return make(**{name: it.from_wire(number) for (name, it), number in pairs})

    return Layout(encode, decode, {name: it.read for name, it in fields.items()}, make)


def number(name: str, code: str, kind: Any = int) -> Layout:
    """A single number; ``name`` is what it is called on the command line."""
    it = Field(code, kind)
    one = record(lambda **given: given[name], **{name: it})
    return replace(one, encode=partial(it.to_wire, name))


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
    """A layout whose values go through ``to`` when they were read, and ``back`` before they are written.

    Words are read as before; where ``back`` does not take what they make, give `fields` and `make` anew.
    """
    return replace(
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
        is_plain = isinstance(value, str) and value.isascii() and value.isprintable()
        if not is_plain or " " in value or not 1 <= len(value) <= most:
            raise ValueError(
                f"text cannot be {value!r}: it must be 1 to {most} ASCII letters, no space"
            )
        return value.encode("ascii").ljust(filled)

    def decode(payload: bytes) -> str:
        return payload.decode("ascii", "replace").replace("\0", " ").split(" ", 1)[0]

    return Layout(encode, decode, {"text": str}, lambda text: text)
