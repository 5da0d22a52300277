"""Describes messages and packets: one line of text each, or plain values for JSON."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import is_dataclass
from enum import IntEnum, IntFlag
from functools import cache
from inspect import signature
from typing import Any

import numpy as np

from xbus import _core
from xbus.formatting import device_name, printable
from xbus.log.identity import Identity
from xbus.protocol.configuration import Configuration
from xbus.protocol.ids import Coordinates, Precision
from xbus.protocol.messages import LAYOUTS
from xbus.protocol.tables import COLUMN_QUANTITIES, QUANTITIES, Field, Quantity
from xbus.protocol.values import BAUD_CODES, CAN_BAUD_CODES, CanConfig, Output, usual_rate
from xbus.wire.message import Message
from xbus.wire.result_code import read_result_code

__all__ = [
    "describe_message",
    "describe_packet",
    "finite",
    "message_dict",
    "packet_dict",
    "recording_date",
    "value_text",
]

#: Messages whose value is a code of Table 7.
BAUD_CODE_MESSAGES = ("SetBaudrate", "ReqBaudrateAck")
#: Formats with all significant digits of each precision.
DIGITS = {"Float32": "%.7g", "Fp1220": "%.9g", "Fp1632": "%.12g", "Float64": "%.15g"}


# Messages


def describe_message(message: Message) -> str:
    """Returns the content of a message in one line; empty if the message has no known content."""
    if message.name in ("Error", "Warning"):
        return str(read_result_code(message))
    identity = Identity().updated([message])
    parts = []
    if identity.configuration is not None:
        parts = [f"recorded {recording_date(identity.configuration) or 'on no date'}"]
        parts += [f"filter profile {identity.configuration.filter_profile}"]
    if identity.firmware is not None:
        parts.insert(0, f"firmware {identity.firmware}")
        if identity.firmware.build is not None:
            parts[0] += f" build {identity.firmware.build} source {identity.firmware.scm}"
    if identity.device_id is not None:
        parts.insert(0, device_name(identity.device_id))
    if identity.product_code is not None:
        parts.insert(0, printable(identity.product_code))
    return ", ".join(parts) or _payload(message)


def message_dict(message: Message) -> dict[str, Any]:
    """Returns a message as plain values for JSON."""
    head = {"bid": message.bid, "mid": message.mid, "name": message.name}
    if message.name in ("Error", "Warning"):
        return head | read_result_code(message)._asdict()
    return head | {"text": describe_message(message)}


def _payload(message: Message) -> str:
    name, payload = message.name, message.payload
    # An acknowledgement may be empty even if its row describes a value.
    if name not in LAYOUTS or not payload:
        return ""
    try:
        value = LAYOUTS[name].decode(payload)
    except ValueError as error:
        return f"malformed: {error}"
    if name == "InitBusResults":
        return " ".join(map(device_name, value))
    if name in BAUD_CODE_MESSAGES and (rate := usual_rate(value, BAUD_CODES)) is not None:
        return f"baudrate={rate}"
    return value_text(value)


def value_text(value: Any) -> str:
    """Returns the value of a message as its layout parses it: ``name=value``; for a list, its entries."""
    if isinstance(value, bytes):
        return f"{len(value)} bytes"
    if isinstance(value, tuple) and not hasattr(value, "_fields"):
        return " ".join(",".join(_pairs(entry)) for entry in value) or "none"
    return " ".join(_pairs(value))


def _pairs(value: Any) -> list[str]:
    """Returns ``name=value`` for each field of a record that is not its zero default; otherwise one word."""
    if not is_dataclass(value) and not hasattr(value, "_fields"):
        return [_word(value)]
    pairs = []
    for name, parameter in signature(type(value)).parameters.items():
        field = getattr(value, name)
        if field is None or (not field and field == parameter.default):
            continue
        if hasattr(field, "_fields"):
            pairs += _pairs(field)
        elif name == "baud_code" and (rate := _rate(value)) is not None:
            pairs.append(f"baudrate={rate}")
        elif isinstance(value, Output) and name == "data_id":
            pairs.append(f"{name}={_data_id(value)}")
        else:
            pairs.append(f"{name}={_word(field)}")
    return pairs


def _rate(value: Any) -> int | None:
    rates = CAN_BAUD_CODES if isinstance(value, CanConfig) else BAUD_CODES
    return usual_rate(value.baud_code, rates)


def _data_id(output: Output) -> str:
    """Returns the manual's name and the format, or the identifier in hex if they do not determine it."""
    row = QUANTITIES.get(output.quantity or "")
    both = (output.precision, output.coordinates)
    formats = [form for form in both if form and isinstance(form, Precision | Coordinates)]
    if row is None or row.id + sum(formats) != output.data_id:
        return f"0x{output.data_id:04X}"
    return "|".join([row.manual, *(form.name for form in formats)])


def _word(value: Any) -> str:
    if isinstance(value, IntFlag):
        names = [str(flag.name).lower() for flag in value]
        rest = int(value) & ~sum(value)
        return "|".join([*names, hex(rest)] if rest else names) or "0"
    if isinstance(value, IntEnum):
        return value.name.lower()
    if isinstance(value, float):
        # The fewest digits that identify the number, as a float32 if it is one.
        with np.errstate(over="ignore"):
            single = np.float32(value)
        return str(single if float(single) == value else np.float64(value)).removesuffix(".0")
    if isinstance(value, tuple):
        return ",".join(map(_word, value))
    return printable(value) if isinstance(value, str) else str(value).lower()


def recording_date(configuration: Configuration) -> str | None:
    """Returns the date of a recording by the clock of its host: ``"2026-11-22 09:29:59.00"``."""
    date, time = configuration.date, configuration.time
    if date is None or not date.strip("0"):
        return None
    day = f"{date[:4]}-{date[4:6]}-{date[6:]}"
    return day if time is None else f"{day} {time[:2]}:{time[2:4]}:{time[4:6]}.{time[6:]}"


# Packets


def describe_packet(packet: _core.Packet) -> str:
    """Returns name, values and unit of a packet, with format and coordinates if they are not the default."""
    if packet.name is None:
        return f"0x{packet.data_id:04X} unknown, {len(packet.numbers)} bytes"
    return _writer(packet.name, packet.precision, packet.coordinates)(packet.numbers)


@cache
def _writer(
    name: str, precision: str | None, coordinates: str | None
) -> Callable[[Sequence[Any]], str]:
    """Returns a function that formats the numbers of packets of one kind."""
    row = COLUMN_QUANTITIES[name]
    formats = [form for form in (coordinates, precision) if form not in (None, "ENU", "Float32")]
    label = f"{name} ({', '.join(map(str, formats))})" if formats else name
    unit = f" {row.unit}" if row.unit else ""
    if name == "utc_time":
        return lambda numbers: f"{label} {_date(numbers)} valid={numbers[7]}"
    if row.has_flags:
        return lambda numbers: f"{label} {_status(row, numbers[0])}"
    if row.kind == "list":
        return lambda numbers: f"{label} {_satellites(row.fields, row.entry, numbers)}"
    if row.kind == "struct":
        return lambda numbers: f"{label} {_record(row.fields, numbers)}"
    if row.kind == "id":
        return lambda numbers: f"{label} {device_name(numbers[0])}"
    digits = "%d" if row.kind[0] in "iu" else DIGITS[precision or "Float32"]
    values = " ".join(f"{name}={digits}" for name in row.components) or digits
    template = f"{label} {values}{unit}".replace("%d 0.1 ms", "%d (0.1 ms)")
    # "nan" reads like a mistake of the program, and the device did send NaN. No name contains it.
    return lambda numbers: (template % tuple(numbers)).replace("nan", "NaN")


def _date(numbers: Sequence[int]) -> str:
    ns, year, month, day, hour, minute, second = numbers[:7]
    return f"{year:04}-{month:02}-{day:02} {hour:02}:{minute:02}:{second:02}.{ns:09}"


def _status(row: Quantity, word: int) -> str:
    """Returns the names of the bits that are set, and the values of fields of several bits."""
    values = ((flag, flag.of(word)) for flag in row.flags)
    names = (
        flag.name if flag.width == 1 else f"{flag.name}={value}" for flag, value in values if value
    )
    return " ".join([f"0x{word:0{2 * (row.size or 1)}X}", *names])


def _record(fields: Sequence[Field], values: Sequence[int]) -> str:
    return " ".join(
        f"{field.name}={_scaled(field, raw)}" for field, raw in zip(fields, values, strict=True)
    )


def _scaled(field: Field, raw: int) -> str:
    if raw == field.missing:
        return "none"
    value = field.scaled(raw)
    return f"{value} {field.unit}" if field.unit else f"{value}"


def _satellites(head: Sequence[Field], entry: Sequence[Field], values: Sequence[int]) -> str:
    """Returns the head, and each satellite in brackets."""
    size = len(entry)
    rows = [values[at : at + size] for at in range(len(head), len(values), size)]
    return " ".join(
        [_record(head, values[: len(head)]), *(f"[{_record(entry, row)}]" for row in rows)]
    )


def packet_dict(packet: _core.Packet) -> dict[str, Any]:
    """Returns a packet as plain values for JSON: structs as raw integers, None for NaN and infinities."""
    numbers = packet.numbers
    head: dict[str, Any] = {"data_id": f"0x{packet.data_id:04X}", "name": packet.name}
    if packet.name is None:
        return {**head, "data": bytes(numbers).hex().upper()}
    row = COLUMN_QUANTITIES[packet.name]
    values = [finite(number) for number in numbers]
    names = row.components or tuple(field.name for field in row.fields)
    named: Any = dict(zip(names, values, strict=False)) if names else values[0]
    if row.kind == "list":
        size, entries = len(row.entry), values[len(row.fields) :]
        keys = [field.name for field in row.entry]
        rows = [entries[at : at + size] for at in range(0, len(entries), size)]
        named["satellites"] = [dict(zip(keys, entry, strict=True)) for entry in rows]
    return {
        **head,
        "precision": packet.precision,
        "coordinates": packet.coordinates,
        "unit": row.unit,
        "values": named,
    }


def finite(number: float) -> float | None:
    """Returns the number, or None for NaN and infinities, which JSON does not have."""
    return number if math.isfinite(number) else None


def known_digits(number: float | None) -> float | None:
    """Returns seconds or Hz to the digits that are known, or None for NaN, infinities and None.

    Time stamps have a resolution of 0.1 ms, those of triggers of 1 us.

    >>> known_digits(9.989999999990687), known_digits(math.nan)
    (9.99, None)
    """
    return round(number, 6) if number is not None and math.isfinite(number) else None
