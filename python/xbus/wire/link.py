"""The protocol of links, which carry bytes to a device and back."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple, Protocol

from xbus import _core

__all__ = ["NOTHING_RECEIVED", "Link", "Received"]


class Received(NamedTuple):
    """Bytes that have arrived, and the pieces in which they did.

    Attributes:
        data: The bytes.
        ends: Index into `data` at which each piece ends.
        arrivals: When each piece arrived, in seconds on the clock of the link.
    """

    data: bytes
    ends: Sequence[int]
    arrivals: Sequence[float]

    @classmethod
    def at(cls, data: bytes, arrival: float) -> Received:
        """Returns bytes that arrived in one piece."""
        return cls(data, (len(data),), (arrival,)) if data else NOTHING_RECEIVED

    def pieces(self) -> Iterator[tuple[bytes, float]]:
        """Yields each piece, and when it arrived."""
        start = 0
        for end, arrival in zip(self.ends, self.arrivals, strict=True):
            yield self.data[start:end], arrival
            start = end


#: The result of a read without data.
NOTHING_RECEIVED = Received(b"", (), ())


class Link(Protocol):
    """Carries bytes in both directions.

    Attributes:
        name: Name for messages to users: the port.
        baudrate: Bits per second. Setting it changes the rate of this side.
        is_line: Whether the baud rate limits the throughput, as on a serial line.
        acquisition: Receives, counts, queues and records the bytes that arrive.
    """

    name: str
    baudrate: int
    is_line: bool
    acquisition: _core.Acquisition

    @property
    def epoch(self) -> int:
        """Nanoseconds to add to an arrival for the time since 1970."""

    @property
    def trouble(self) -> str | None:
        """What is wrong with the port, and the remedy; None if no problem is known."""

    def read(self, timeout: float) -> Received:
        """Returns what has arrived. Waits up to ``timeout`` seconds for the first byte.

        Raises:
            OSError: The port is gone.
        """

    def write(self, data: bytes) -> None:
        """Sends bytes.

        Raises:
            OSError: The port is gone.
        """

    def clock(self) -> float:
        """Returns the time that timeouts and arrivals use, in seconds from an arbitrary start."""

    def pause(self, seconds: float) -> None:
        """Waits."""

    def reopen(self) -> None:
        """Opens the port again after it was lost.

        Raises:
            OSError: The port cannot be opened.
        """

    def close(self) -> None:
        """Closes the port, if this link opened it."""
