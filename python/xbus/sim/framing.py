"""Requests out of the bytes that a host sends.

`xbus.Scanner` is for the other way: it believes in what devices send.
"""

from __future__ import annotations

from typing import NamedTuple

__all__ = ["Framer", "Request"]

PREAMBLE = 0xFA
#: A length of 255 says that two more bytes hold it (section 5.1).
EXTENDED = 0xFF
#: The longest payload (Table 3); a header that says more is none.
LONGEST = 2048


class Request(NamedTuple):
    """A message to the device: bus identifier, message identifier and payload."""

    bid: int
    mid: int
    payload: bytes


class Framer:
    """Finds frames in bytes that come in pieces; what is no frame is passed by.

    >>> framer = Framer()
    >>> framer.feed(bytes.fromhex("00 FA FF 30")), framer.feed(bytes.fromhex("00 D1"))
    ([], [Request(bid=255, mid=48, payload=b'')])
    """

    def __init__(self) -> None:
        self._bytes = bytearray()

    @property
    def is_waiting(self) -> bool:
        """Whether a frame has begun."""
        return bool(self._bytes)

    def feed(self, data: bytes) -> list[Request]:
        """The requests that are complete with these bytes."""
        self._bytes += data
        found: list[Request] = []
        while (start := self._bytes.find(PREAMBLE)) >= 0:
            del self._bytes[:start]
            end = self._end()
            if end is None or end > len(self._bytes):
                return found
            if end and sum(self._bytes[1:end]) % 256 == 0:
                found.append(self._request(end))
                del self._bytes[:end]
            else:
                del self._bytes[:1]
        self._bytes.clear()
        return found

    def give_up(self) -> list[Request]:
        """The requests behind a header whose frame will not come."""
        del self._bytes[:1]
        return self.feed(b"")

    def _end(self) -> int | None:
        """Where the frame at the front ends: None for not known yet, 0 for never."""
        if len(self._bytes) < 4:
            return None
        if (length := self._bytes[3]) != EXTENDED:
            return 4 + length + 1
        if len(self._bytes) < 6:
            return None
        length = int.from_bytes(self._bytes[4:6], "big")
        return 6 + length + 1 if length <= LONGEST else 0

    def _request(self, end: int) -> Request:
        _, bid, mid, length = self._bytes[:4]
        return Request(bid, mid, bytes(self._bytes[6 if length == EXTENDED else 4 : end - 1]))
