"""Messages and packets in words, one line each, and the same for programs."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import is_dataclass
from enum import IntEnum, IntFlag
from functools import cache
from inspect import signature
from typing import Any, NamedTuple

import numpy as np

from xbus import _core
from xbus.log.identity import Identity
from xbus.protocol.configuration import Configuration
from xbus.protocol.ids import Coordinates, Precision
from xbus.protocol.messages import LAYOUTS
from xbus.protocol.tables import QUANTITIES, RESULT_CODES, Field, Quantity
from xbus.protocol.values import Output
from xbus.wire.message import Message

__all__ = [
    "Notice",
    "describe_message",
    "describe_packet",
    "device_name",
    "finite",
    "message_dict",
    "packet_dict",
    "read_notice",
    "recording_date",
    "value_text",
]

#: Digits that show all that a number of this precision says.
DIGITS = {"Float32": "%.7g", "Fp1220": "%.9g", "Fp1632": "%.12g", "Float64": "%.15g"}


# Messages


class Notice(NamedTuple):
    """An Error or Warning message.

    Attributes:
        code: Its number, None where the payload is too short for one.
        text: What the number means, and what the device adds in words.
        detail: The bytes behind an error's code, in hex.
    """

    code: int | None
    text: str
    detail: str | None

    def __str__(self) -> str:
        code = "" if self.code is None else f"{self.code}: "
        return f"{code}{self.text}" + (f" (detail {self.detail})" if self.detail else "")


def read_notice(message: Message) -> Notice:
    """What an Error or a Warning says."""
    wide = 4 if message.name == "Warning" else 1
    if len(message.payload) < wide:
        return Notice(None, "without a code", None)
    code, rest = int.from_bytes(message.payload[:wide], "big"), message.payload[wide:]
    text = RESULT_CODES.get(code, "a code that xbus does not know")
    if message.name == "Warning":
        words = printable(rest)
        return Notice(code, f"{text} ({words})" if words else text, None)
    return Notice(code, text, rest.hex(" ").upper() or None)


def describe_message(message: Message) -> str:
    """What a message that is no sample says, in words; empty where nothing is known of it."""
    if message.name in ("Error", "Warning"):
        return str(read_notice(message))
    told = Identity().updated([message])
    parts = []
    if told.configuration is not None:
        parts = [f"recorded {recording_date(told.configuration) or 'on no date'}"]
        parts += [f"filter profile {told.configuration.filter_profile}"]
    if told.firmware is not None:
        parts.insert(0, f"firmware {told.firmware}")
        if told.firmware.build is not None:
            parts[0] += f" build {told.firmware.build} source {told.firmware.scm}"
    if told.device_id is not None:
        parts.insert(0, device_name(told.device_id))
    if told.product_code is not None:
        parts.insert(0, printable(told.product_code.encode()))
    return ", ".join(parts) or _payload(message)


def message_dict(message: Message) -> dict[str, Any]:
    """A message that is no sample, for programs."""
    facts = {"bid": message.bid, "mid": message.mid, "name": message.name}
    if message.name in ("Error", "Warning"):
        return facts | read_notice(message)._asdict()
    return facts | {"text": describe_message(message)}


def _payload(message: Message) -> str:
    name, payload = message.name, message.payload
    # Nothing is what an acknowledgement may carry, also where a value has the same row.
    if name not in LAYOUTS or not payload:
        return ""
    try:
        value = LAYOUTS[name].decode(payload)
    except ValueError as error:
        return f"malformed: {error}"
    return " ".join(map(device_name, value)) if name == "InitBusResults" else value_text(value)


def value_text(value: Any) -> str:
    """The value of a message in the words that its layout reads: ``name=value``; a list by its entries."""
    if isinstance(value, bytes):
        return f"{len(value)} bytes"
    if isinstance(value, tuple) and not hasattr(value, "_fields"):
        return " ".join(",".join(_pairs(it)) for it in value) or "none"
    return " ".join(_pairs(value))


def _pairs(value: Any) -> list[str]:
    """The words of a record, without what is zero and need not be said; of anything else its only word."""
    if not is_dataclass(value) and not hasattr(value, "_fields"):
        return [_word(value)]
    pairs = []
    for name, parameter in signature(type(value)).parameters.items():
        it = getattr(value, name)
        if it is None or (not it and it == parameter.default):
            continue
        if hasattr(it, "_fields"):
            pairs += _pairs(it)
        elif isinstance(value, Output) and name == "data_id":
            pairs.append(f"{name}={_data_id(value)}")
        else:
            pairs.append(f"{name}={_word(it)}")
    return pairs


def _data_id(output: Output) -> str:
    """The manual's name and the format; in hex where they do not say it all."""
    row = QUANTITIES.get(output.quantity or "")
    both = (output.precision, output.coordinates)
    formats = [it for it in both if it and isinstance(it, Precision | Coordinates)]
    if row is None or row.id + sum(formats) != output.data_id:
        return f"0x{output.data_id:04X}"
    return "|".join([row.manual, *(it.name for it in formats)])


def _word(value: Any) -> str:
    if isinstance(value, IntFlag):
        names = [str(it.name).lower() for it in value]
        rest = int(value) & ~sum(value)
        return "|".join([*names, hex(rest)] if rest else names) or "0"
    if isinstance(value, IntEnum):
        return value.name.lower()
    if isinstance(value, float):
        # No more digits than it takes; for a single these are fewer.
        with np.errstate(over="ignore"):
            single = np.float32(value)
        return str(single if float(single) == value else np.float64(value)).removesuffix(".0")
    if isinstance(value, tuple):
        return ",".join(map(_word, value))
    return printable(value.encode()) if isinstance(value, str) else str(value).lower()


def device_name(number: int) -> str:
    """A device identifier as it stands on the device: 8 digits, 10 from the 600-series on."""
    return f"{number:010X}" if number >> 31 else f"{number:08X}"


def recording_date(configuration: Configuration) -> str | None:
    """When a recording was made, by the clock of its host: ``2026-11-22 09:29:59.00``."""
    date, time = configuration.date, configuration.time
    if date is None or not date.strip("0"):
        return None
    day = f"{date[:4]}-{date[4:6]}-{date[6:]}"
    return day if time is None else f"{day} {time[:2]}:{time[2:4]}:{time[4:6]}.{time[6:]}"


def printable(data: bytes) -> str:
    """Text of a device, with nothing that a terminal would obey."""
    text = data.decode("ascii", "backslashreplace").strip("\0 \r\n")
    return "".join(it if it.isprintable() else f"\\x{ord(it):02x}" for it in text)


# Packets


def describe_packet(packet: _core.Packet) -> str:
    """A packet in words: name, values and unit; format and coordinates where they are not the default."""
    if packet.name is None:
        return f"0x{packet.data_id:04X} unknown, {len(packet.numbers)} bytes"
    return _writer(packet.name, packet.precision, packet.coordinates)(packet.numbers)


@cache
def _writer(
    name: str, precision: str | None, coordinates: str | None
) -> Callable[[Sequence[Any]], str]:
    """Writes packets of one kind: what can be said once about the kind is said here."""
    row = QUANTITIES[name]
    formats = [it for it in (coordinates, precision) if it not in (None, "ENU", "Float32")]
    label = f"{name} ({', '.join(map(str, formats))})" if formats else name
    unit = f" {row.unit}" if row.unit else ""
    if name == "utc_time":
        return lambda it: f"{label} {_date(it)} valid={it[7]}"
    if row.has_flags:
        return lambda it: f"{label} {_status(row, it[0])}"
    if row.kind == "list":
        return lambda it: f"{label} {_satellites(row.fields, row.entry, it)}"
    if row.kind == "struct":
        return lambda it: f"{label} {_record(row.fields, it)}"
    if row.kind == "id":
        return lambda it: f"{label} {device_name(it[0])}"
    digits = "%d" if row.kind[0] in "iu" else DIGITS[precision or "Float32"]
    values = " ".join(f"{it}={digits}" for it in row.components) or digits
    template = f"{label} {values}{unit}".replace("%d 0.1 ms", "%d (0.1 ms)")
    return lambda it: template % tuple(it)


def _date(it: Sequence[int]) -> str:
    ns, year, month, day, hour, minute, second = it[:7]
    return f"{year:04}-{month:02}-{day:02} {hour:02}:{minute:02}:{second:02}.{ns:09}"


def _status(row: Quantity, word: int) -> str:
    """The names of the bits that are set, with their value where they have several."""
    values = ((flag, flag.of(word)) for flag in row.flags)
    names = (
        flag.name if flag.width == 1 else f"{flag.name}={value}" for flag, value in values if value
    )
    return " ".join([f"0x{word:0{2 * (row.size or 1)}X}", *names])


def _record(fields: Sequence[Field], values: Sequence[int]) -> str:
    return " ".join(f"{it.name}={_scaled(it, raw)}" for it, raw in zip(fields, values, strict=True))


def _scaled(field: Field, raw: int) -> str:
    if raw == field.missing:
        return "none"
    value = field.scaled(raw)
    return f"{value} {field.unit}" if field.unit else f"{value}"


def _satellites(head: Sequence[Field], entry: Sequence[Field], values: Sequence[int]) -> str:
    """The head, and each satellite in brackets."""
    size = len(entry)
    rows = [values[at : at + size] for at in range(len(head), len(values), size)]
    return " ".join(
        [_record(head, values[: len(head)]), *(f"[{_record(entry, it)}]" for it in rows)]
    )


def packet_dict(packet: _core.Packet) -> dict[str, Any]:
    """A packet for programs: reals exact, structs as raw integers, null for NaN and infinities."""
    numbers = packet.numbers
    facts: dict[str, Any] = {"data_id": f"0x{packet.data_id:04X}", "name": packet.name}
    if packet.name is None:
        return {**facts, "data": bytes(numbers).hex().upper()}
    row = QUANTITIES[packet.name]
    values = [finite(it) for it in numbers]
    names = row.components or tuple(it.name for it in row.fields)
    named: Any = dict(zip(names, values, strict=False)) if names else values[0]
    if row.kind == "list":
        size, entries = len(row.entry), values[len(row.fields) :]
        keys = [it.name for it in row.entry]
        rows = [entries[at : at + size] for at in range(0, len(entries), size)]
        named["satellites"] = [dict(zip(keys, it, strict=True)) for it in rows]
    return {
        **facts,
        "precision": packet.precision,
        "coordinates": packet.coordinates,
        "unit": row.unit,
        "values": named,
    }


def finite(number: float) -> float | None:
    """The number, or None where JSON has no word for it."""
    return number if math.isfinite(number) else None
