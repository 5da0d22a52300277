"""The line between a virtual device and its host."""

from __future__ import annotations

import math
import random
from collections import deque

from xbus.sim.faults import Faults, FaultyLine

__all__ = ["Line"]

#: Bytes that wait in the device for a line that is too slow. A frame that does not fit is dropped.
BUFFER = 2048
#: Start bit, eight data bits and stop bit.
BITS_PER_BYTE = 10


class Line:
    """Carries bytes: as a serial line, at a rate that both sides must have set; or as USB, all and at once.

    Times are in nanoseconds on the clock of the device, and must not fall.

    Args:
        rate: Bits per second; None for USB.
        faults: What is wrong with it.
        seed: Of what a port hears at another rate.

    Attributes:
        rate: Bits per second; None for USB.
        idle_at: When the last byte has left the device.
    """

    def __init__(self, rate: int | None, faults: Faults | None, seed: int) -> None:
        self.rate = rate
        self.idle_at = 0
        self._waiting: deque[tuple[int, bytes]] = deque()
        self._faulty = FaultyLine(faults) if faults is not None else None
        #: What the host has not read, with the rate at which it came.
        self._come: list[tuple[int | None, bytes]] = []
        self._noise = random.Random(seed)  # noqa: S311 - to repeat

    @property
    def is_simple(self) -> bool:
        """Whether all that is sent arrives at once."""
        return self.rate is None and self._faulty is None

    @property
    def faults(self) -> Faults | None:
        """What is wrong with it."""
        return None if self._faulty is None else self._faulty.faults

    def change_faults(self, faults: Faults | None, now: int) -> None:
        """Replaces the faults; bytes that the old ones held back arrive now."""
        self.collect(now)
        if self._faulty is not None and (held := self._faulty.take(math.inf)):
            self._come.append((self.rate, held))
        self._faulty = None if faults is None else FaultyLine(faults)

    def has_room(self, size: int, now: int) -> bool:
        """Whether a frame of this size can wait to be sent."""
        if self.rate is None:
            return True
        return (self.idle_at - now) * self.rate + size * BITS_PER_BYTE * 10**9 <= (
            BUFFER * BITS_PER_BYTE * 10**9
        )

    def send(self, data: bytes, now: int) -> None:
        """Sends to the host."""
        if self.is_simple:
            self._come.append((None, data))
            return
        self.idle_at = max(self.idle_at, now)
        if self.rate is not None:
            self.idle_at += len(data) * BITS_PER_BYTE * 10**9 // self.rate
        self._waiting.append((self.idle_at, data))

    def collect(self, now: int) -> None:
        """Moves on what has left the device by now."""
        while self._waiting and self._waiting[0][0] <= now:
            time, data = self._waiting.popleft()
            if self._faulty is None:
                self._come.append((self.rate, data))
            else:
                self._faulty.feed(data, time / 1e9)
        if self._faulty is not None and (data := self._faulty.take(now / 1e9)):
            self._come.append((self.rate, data))

    def restart(self, rate: int | None, now: int) -> None:
        """Goes on at another rate; what has not left the device is lost."""
        self.collect(now)
        self._waiting.clear()
        self.rate, self.idle_at = rate, now

    def lose(self) -> None:
        """Forgets what the host has not read."""
        self._come.clear()

    def read(self, rate: int | None) -> bytes:
        """What has come to the host, whose port is set to this rate (None: the right one)."""
        data = b"".join(self.heard(piece, sent, rate) for sent, piece in self._come)
        self._come.clear()
        return data

    def is_plugged(self, now: int) -> bool:
        """Whether the plug is in."""
        return self._faulty is None or self._faulty.plugged(now / 1e9)

    def heard(self, data: bytes, sent: int | None, set_to: int | None) -> bytes:
        """Bytes sent at one rate as a port hears them that is set to another."""
        if sent is None or set_to is None or sent == set_to:
            return data
        return self._noise.randbytes(len(data))
