"""Finds requests in the bytes that a host sends.

`xbus.Scanner` serves the other direction: its rules of plausibility are those of messages from a device.
"""

from __future__ import annotations

from typing import NamedTuple

from xbus import _core
from xbus.protocol.values import MAX_REQUEST_PAYLOAD

__all__ = ["Framer", "Request"]


class Request(NamedTuple):
    """A message to the device: bus identifier, message identifier and payload."""

    bid: int
    mid: int
    payload: bytes


class Framer:
    """Finds frames in bytes that arrive in pieces, and skips everything else.

    >>> framer = Framer()
    >>> framer.feed(bytes.fromhex("00 FA FF 30")), framer.feed(bytes.fromhex("00 D1"))
    ([], [Request(bid=255, mid=48, payload=b'')])
    """

    def __init__(self) -> None:
        # A header that announces more does not belong to a frame.
        self._scanner = _core.RequestScanner(MAX_REQUEST_PAYLOAD)

    @property
    def is_waiting(self) -> bool:
        """Whether a frame has begun that is not complete."""
        return self._scanner.is_waiting

    def feed(self, data: bytes) -> list[Request]:
        """Returns the requests that the next bytes of the host complete."""
        return self._scan(data, last=False)

    def flush(self) -> list[Request]:
        """Drops every incomplete frame, and returns the requests found after its header."""
        return self._scan(b"", last=True)

    def _scan(self, data: bytes, *, last: bool) -> list[Request]:
        frames = self._scanner.feed(data, last)
        return [Request(frame.bid, frame.mid, frame.payload) for frame in frames]
