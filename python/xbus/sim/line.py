"""The line between a virtual device and its host."""

from __future__ import annotations

import math
import random
from collections import deque

from xbus.protocol.values import BITS_PER_BYTE
from xbus.sim.clock import SECOND
from xbus.sim.faults import Faults, FaultyLine

__all__ = ["Line"]

#: Bytes that the device can buffer while the line is busy. A frame that does not fit is dropped.
SEND_BUFFER = 2048


class Line:
    """Transfers bytes: as a serial line, at a rate that both sides must set; or as USB, without delay.

    Times are in nanoseconds on the clock of the device, and must not decrease.

    Args:
        rate: Bits per second; None for USB.
        faults: Faults of the line, if any.
        seed: Seed of the noise that a port receives at a wrong rate.

    Attributes:
        rate: Bits per second; None for USB.
        idle_at: When the last byte leaves the device.
    """

    def __init__(self, rate: int | None, faults: Faults | None, seed: int) -> None:
        self.rate = rate
        self.idle_at = 0
        self._sending: deque[tuple[int, bytes]] = deque()
        self._faulty = FaultyLine(faults) if faults is not None else None
        #: Bytes that the host has not read, each piece with the rate at which it was sent.
        self._arrived: list[tuple[int | None, bytes]] = []
        self._noise = random.Random(seed)  # noqa: S311 - reproducible

    @property
    def is_immediate(self) -> bool:
        """Whether everything arrives unchanged and without delay."""
        return self.rate is None and self._faulty is None

    @property
    def faults(self) -> Faults | None:
        """The faults of the line, or None."""
        return None if self._faulty is None else self._faulty.faults

    def change_faults(self, faults: Faults | None, now: int) -> None:
        """Replaces the faults; bytes that the old faults held back arrive now."""
        self.collect(now)
        if self._faulty is not None and (held := self._faulty.take(math.inf)):
            self._arrived.append((self.rate, held))
        self._faulty = None if faults is None else FaultyLine(faults)

    def has_room(self, size: int, now: int) -> bool:
        """Returns whether the send buffer has room for a frame of ``size`` bytes."""
        if self.rate is None:
            return True
        return (self.idle_at - now) * self.rate + size * BITS_PER_BYTE * SECOND <= (
            SEND_BUFFER * BITS_PER_BYTE * SECOND
        )

    def send(self, data: bytes, now: int) -> None:
        """Sends bytes to the host."""
        if self.is_immediate:
            self._arrived.append((None, data))
            return
        self.idle_at = max(self.idle_at, now)
        if self.rate is not None:
            self.idle_at += len(data) * BITS_PER_BYTE * SECOND // self.rate
        self._sending.append((self.idle_at, data))

    def collect(self, now: int) -> None:
        """Delivers what has left the device by now."""
        while self._sending and self._sending[0][0] <= now:
            time, data = self._sending.popleft()
            if self._faulty is None:
                self._arrived.append((self.rate, data))
            else:
                self._faulty.feed(data, time / SECOND)
        if self._faulty is not None and (data := self._faulty.take(now / SECOND)):
            self._arrived.append((self.rate, data))

    def restart(self, rate: int | None, now: int) -> None:
        """Changes the rate; bytes that have not left the device are lost."""
        self.collect(now)
        self._sending.clear()
        self.rate, self.idle_at = rate, now

    def discard(self) -> None:
        """Discards what the host has not read."""
        self._arrived.clear()

    def read(self, rate: int | None) -> bytes:
        """Returns what has arrived at the host, whose port is set to ``rate`` (None: the right rate)."""
        data = b"".join(self.receive(piece, sent, rate) for sent, piece in self._arrived)
        self._arrived.clear()
        return data

    def is_plugged(self, now: int) -> bool:
        """Returns whether the plug is in."""
        return self._faulty is None or self._faulty.is_plugged(now / SECOND)

    def receive(self, data: bytes, sent: int | None, port_rate: int | None) -> bytes:
        """Returns the bytes that a port receives: noise if its rate differs from that of the sender."""
        if sent is None or port_rate is None or sent == port_rate:
            return data
        return self._noise.randbytes(len(data))
