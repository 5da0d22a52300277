"""Messages of a device that are events of a stream."""

from __future__ import annotations

from xbus.describe.text import describe_message
from xbus.wire.message import Message

__all__ = ["EVENT_MESSAGES", "describe_event"]

EVENT_MESSAGES = ("Error", "Warning", "WakeUp")


def describe_event(message: Message) -> str:
    """Returns the text of an event."""
    if message.name == "WakeUp":
        return "WakeUp: the device has just started"
    return f"{message.name} {describe_message(message)}"
