"""A message: the content of a frame."""

from __future__ import annotations

from typing import NamedTuple

__all__ = ["Message"]


class Message(NamedTuple):
    """A message that is no sample.

    Attributes:
        mid: Message identifier.
        name: The manual's name, or the MID in hex where it has none.
        bid: Bus identifier.
        payload: Its data.
        offset: Where its frame begins, in bytes from the start of the input.
        sample: Index of the next sample.
    """

    mid: int
    name: str
    bid: int
    payload: bytes
    offset: int
    sample: int
