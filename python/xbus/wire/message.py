"""A message: the content of a frame."""

from __future__ import annotations

from typing import NamedTuple

__all__ = ["Message"]


class Message(NamedTuple):
    """A message, such as the reply to a command.

    Attributes:
        mid: Message identifier.
        name: The manual's name, or the MID in hex if the manual has none.
        bid: Bus identifier.
        payload: Its data.
        offset: Byte offset in the input at which its frame begins.
        sample: Index of the next sample.

    >>> import xbus
    >>> [message] = xbus.read_log("tests/captures/field.mtb").messages.named("Error")
    >>> message.mid, message.offset, message.payload
    (66, 81068, b')')
    """

    mid: int
    name: str
    bid: int
    payload: bytes
    offset: int
    sample: int
