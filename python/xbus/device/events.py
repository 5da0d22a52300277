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
        value: What it says, of the type of its layout; None where it carries nothing.
        payload: Its bytes. Some firmware answers a setting with the new value, some with nothing.
    """

    command: str
    value: Any
    payload: bytes


@dataclass(frozen=True)
class Refusal:
    """A command that failed: the device answered Error, or something that cannot be read.

    Attributes:
        command: Name of the command.
        error: The exception to raise.
    """

    command: str
    error: DeviceError | DecodeError


@dataclass(frozen=True)
class Notice:
    """A message that nobody asked for: WakeUp, Configuration, Error, Warning, ...

    Attributes:
        name: The manual's name, or the MID in hex where it has none.
        value: What it says; its bytes where that cannot be told.
        payload: Its bytes.
        bid: Its bus identifier.
        mid: Its message identifier. None for what is no message: "Reconnected", the device was lost and is
            there again, ``value`` seconds later; "Port", ``value`` says what is wrong with it, and the cure.
    """

    name: str
    value: Any
    payload: bytes
    bid: int
    mid: int | None


SessionEvent = Sample | String | Reply | Refusal | Notice
