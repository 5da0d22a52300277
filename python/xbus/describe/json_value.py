"""Values of messages as JSON has them: numbers, texts, lists and objects."""

from __future__ import annotations

import math
from dataclasses import fields, is_dataclass
from enum import Enum, IntFlag
from typing import Any

from xbus.protocol.messages import LAYOUTS
from xbus.wire.message import Message

__all__ = ["json_value", "payload_value"]


def payload_value(message: Message) -> Any:
    """Returns the value of a message for `json.dumps`; None for no payload or a malformed one.

    >>> import xbus
    >>> payload = bytes.fromhex("40200064")
    >>> payload_value(xbus.Message(0xC1, "SetOutputConfigurationAck", 255, payload, 0, 0))
    [{'data_id': 16416, 'frequency': 100}]
    """
    if message.name not in LAYOUTS or not message.payload:
        return None
    try:
        return json_value(LAYOUTS[message.name].decode(message.payload))
    except ValueError:
        return None


def json_value(value: Any) -> Any:
    """Returns a value of `xbus.protocol` for `json.dumps`.

    Records are objects by the names of their fields. Enumerations are their names in lower case and flags
    are lists of names, as in the arguments of ``xbus send``; bytes are in hex. Numbers that JSON does not
    have, such as NaN, are None.

    >>> from xbus.protocol.values import Selftest, State
    >>> json_value((State.CONFIG, Selftest(3), 1.5, b"AB", float("nan")))
    ['config', ['acc_x', 'acc_y'], 1.5, '4142', None]
    """
    if isinstance(value, IntFlag):
        names = [member.name for member in type(value) if member in value and member.value]
        known = sum(member.value for member in type(value) if member in value)
        unknown = int(value) & ~known
        return [str(name).lower() for name in names] + ([unknown] if unknown else [])
    if isinstance(value, Enum):
        return value.name.lower()
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, bytes):
        return value.hex().upper()
    if is_dataclass(value) and not isinstance(value, type):
        return {field.name: json_value(getattr(value, field.name)) for field in fields(value)}
    if hasattr(value, "_asdict"):
        return {name: json_value(item) for name, item in value._asdict().items()}
    if isinstance(value, (tuple, list)):
        return [json_value(item) for item in value]
    return value
