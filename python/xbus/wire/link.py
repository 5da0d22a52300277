"""The protocol of links, which send bytes to a device and receive its bytes."""

from __future__ import annotations

from typing import Protocol, TypedDict, Unpack

from xbus import _core

__all__ = ["Link", "Need", "line_rate"]


class Need(TypedDict, total=False):
    """What a wait is for: the keyword arguments of `_core.Acquisition.wait`."""

    samples: int | None
    strings: bool
    events: int | None
    cancel: _core.Cancel | None


class Link(Protocol):
    """Sends bytes to a device, and receives those that it sends.

    Attributes:
        name: Name for messages to users: the port.
        baudrate: Bits per second; None for a port without a baud rate, such as an I²C bus. Setting it changes
            the rate of this side.
        is_line: Whether the baud rate limits the throughput, as on a serial line.
        acquisition: Scans, counts and records the bytes that arrive, and queues what is in them. Its clock is
            that of the link.
    """

    name: str
    baudrate: int | None
    is_line: bool
    acquisition: _core.Acquisition

    @property
    def trouble(self) -> str | None:
        """What is wrong with the port, and the remedy; None if no problem is known."""

    @property
    def refusal(self) -> str | None:
        """Why nothing can be sent, and what to do instead; None if it can."""

    def wait(self, timeout: float, **need: Unpack[Need]) -> bool:
        """Waits up to ``timeout`` seconds for one of what is needed: see `_core.Acquisition.wait`."""

    def write(self, data: bytes) -> None:
        """Sends bytes.

        Raises:
            OSError: The port is gone.
        """

    def clock(self) -> float:
        """Returns the time that timeouts and arrivals use, in seconds from an arbitrary start."""

    def pause(self, seconds: float) -> None:
        """Waits."""

    def restart(self) -> None:
        """Begins a new acquisition. Only for a link on which nothing but noise was received."""

    def reopen(self) -> None:
        """Opens the port again after it was lost.

        Raises:
            OSError: The port cannot be opened.
        """

    def close(self) -> None:
        """Closes the port, if this link opened it."""

    def abandon(self) -> None:
        """Gives up the port without a trace, in a forked process: it belongs to the parent."""


def line_rate(link: Link) -> int | None:
    """Returns the bits per second that limit what a device can send; None if no baud rate does."""
    return link.baudrate if link.is_line else None
