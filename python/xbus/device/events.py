"""What a device sends, as the session reports it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from xbus.device.sample import Sample
from xbus.errors import DecodeError, DeviceError
from xbus.wire.strings import String

__all__ = ["Notice", "Refusal", "Reply", "SessionEvent"]


@dataclass(frozen=True)
class Reply:
    """The answer to a command.

    Attributes:
        command: Name of the command.
        value: The decoded payload, as `xbus.protocol.decode` returns it; None if the payload is empty.
        payload: The bytes. Some firmware acknowledges a setting with the new value, some with an empty
            payload.
    """

    command: str
    value: Any
    payload: bytes


@dataclass(frozen=True)
class Refusal:
    """A command that failed: the device answered Error, or the answer cannot be decoded.

    Attributes:
        command: Name of the command.
        error: The exception to raise.
    """

    command: str
    error: DeviceError | DecodeError


@dataclass(frozen=True)
class Notice:
    """A message that answers no command: WakeUp, Configuration, Error, Warning, ...

    Two notices are not messages of the device: "Reconnected", after the device was lost for ``value``
    seconds, and "Port", with a problem of the port and its remedy as ``value``.

    Attributes:
        name: The manual's name, or the MID in hex if it has none.
        value: The decoded payload; the payload itself if it cannot be decoded.
        payload: The bytes.
        bid: Bus identifier.
        mid: Message identifier; None if the notice is not a message.
    """

    name: str
    value: Any
    payload: bytes
    bid: int
    mid: int | None


#: What `Session.receive` returns a list of.
SessionEvent = Sample | String | Reply | Refusal | Notice
