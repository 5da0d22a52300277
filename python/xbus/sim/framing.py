"""Finds requests in the bytes that a host sends.

`xbus.Scanner` serves the other direction: its rules of plausibility are those of messages from a device.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

__all__ = ["Framer", "Request"]

PREAMBLE = 0xFA
#: A length of 255 means that the next two bytes hold the length (section 5.1).
EXTENDED = 0xFF
#: Bytes up to and including the length, without and with the extended length.
HEADER, EXTENDED_HEADER = 4, 6
#: The longest payload (Table 3). A header that announces more does not belong to a frame.
LONGEST = 2048


class Request(NamedTuple):
    """A message to the device: bus identifier, message identifier and payload."""

    bid: int
    mid: int
    payload: bytes


class Framer:
    """Finds frames in bytes that arrive in pieces, and skips everything else.

    All candidates of a piece are checked together in numpy: the cost is linear in the number of bytes,
    whatever they are.

    >>> framer = Framer()
    >>> framer.feed(bytes.fromhex("00 FA FF 30")), framer.feed(bytes.fromhex("00 D1"))
    ([], [Request(bid=255, mid=48, payload=b'')])
    """

    def __init__(self) -> None:
        self._bytes = bytearray()
        #: No frame is complete before this number of bytes has arrived.
        self._needed = 0

    @property
    def is_waiting(self) -> bool:
        """Whether a frame has begun that is not complete."""
        return bool(self._bytes)

    def feed(self, data: bytes) -> list[Request]:
        """Returns the requests that these bytes complete.

        Args:
            data: The next bytes from the host.
        """
        self._bytes += data
        return [] if len(self._bytes) < self._needed else self._scan(is_last=False)

    def flush(self) -> list[Request]:
        """Drops every incomplete frame, and returns the requests behind their headers."""
        return self._scan(is_last=True)

    def _scan(self, *, is_last: bool) -> list[Request]:
        data = bytes(self._bytes)
        size = len(data)
        # Zeros behind the end, so that a header that is cut off can be read.
        padded = np.frombuffer(data + bytes(EXTENDED_HEADER), np.uint8)
        starts = np.flatnonzero(padded == PREAMBLE).astype(np.int32)
        if not len(starts):
            self._keep(b"", 0)
            return []

        bodies = starts + HEADER
        lengths = padded[bodies - 1].astype(np.int32)
        extended = np.flatnonzero((lengths == EXTENDED) & (bodies <= size))
        first = bodies[extended]
        lengths[extended] = padded[first].astype(np.int32) << 8 | padded[first + 1]
        bodies[extended] += EXTENDED_HEADER - HEADER
        is_possible = lengths <= LONGEST
        # The last byte is the checksum. While a length is missing, only its header is known to be needed.
        is_cut = bodies > size
        ends = np.where(is_cut, bodies, bodies + lengths + 1)
        is_open = is_cut | (ends > size) & is_possible
        # The bytes behind the preamble of a frame add up to a multiple of 256.
        sums = np.zeros(size + 1, np.uint8)
        np.cumsum(padded[:size], dtype=np.uint8, out=sums[1:])
        is_sound = sums[np.minimum(ends, size)] == sums[starts + 1]
        chosen = is_sound & is_possible & ~is_open
        if not is_last:
            chosen |= is_open

        found: list[Request] = []
        starts, bodies, ends, is_open = (it[chosen] for it in (starts, bodies, ends, is_open))
        i = 0
        while i < len(starts):
            start, body, end = int(starts[i]), int(bodies[i]), int(ends[i])
            if is_open[i]:
                self._keep(data[start:], end - start)
                return found
            found.append(Request(data[start + 1], data[start + 2], data[body : end - 1]))
            # Candidates inside the frame are part of its payload.
            i = int(np.searchsorted(starts, np.int32(end)))
        self._keep(b"", 0)
        return found

    def _keep(self, data: bytes, needed: int) -> None:
        self._bytes[:] = data
        self._needed = needed
