"""What carries bytes to a device and back."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple, Protocol

from xbus import _core

__all__ = ["NOTHING_RECEIVED", "Link", "Received"]


class Received(NamedTuple):
    """Bytes that have come, in the pieces in which they did.

    Attributes:
        data: The bytes.
        ends: Where each piece ends in them.
        arrivals: When each piece came, seconds on the clock of the link.
    """

    data: bytes
    ends: Sequence[int]
    arrivals: Sequence[float]

    @classmethod
    def at(cls, data: bytes, arrival: float) -> Received:
        """Bytes that came in one piece."""
        return cls(data, (len(data),), (arrival,)) if data else NOTHING_RECEIVED

    def pieces(self) -> Iterator[tuple[bytes, float]]:
        """Each piece, and when it came."""
        start = 0
        for end, arrival in zip(self.ends, self.arrivals, strict=True):
            yield self.data[start:end], arrival
            start = end


#: What is received when nothing came.
NOTHING_RECEIVED = Received(b"", (), ())


class Link(Protocol):
    """Carries bytes both ways.

    Attributes:
        name: What the user calls it.
        baudrate: Bits per second; setting it changes the rate of this side.
        is_line: Whether the baud rate limits what can be carried, as on a serial line.
        acquisition: What takes in, counts, queues and records the bytes that come.
    """

    name: str
    baudrate: int
    is_line: bool
    acquisition: _core.Acquisition

    @property
    def epoch(self) -> int:
        """What to add to an arrival, in ns, for the time since 1970."""

    @property
    def trouble(self) -> str | None:
        """What is wrong with the port, and the cure; None if nothing is known to be."""

    def read(self, timeout: float) -> Received:
        """What has come; waits for the first byte, but no longer than ``timeout`` seconds. Raises OSError."""

    def write(self, data: bytes) -> None:
        """Sends. Raises OSError."""

    def clock(self) -> float:
        """Seconds, from any beginning, as time-outs count them."""

    def pause(self, seconds: float) -> None:
        """Lets time pass."""

    def reopen(self) -> None:
        """Opens it again after it was lost. Raises OSError."""

    def close(self) -> None:
        """Closes it, if it was opened here."""
