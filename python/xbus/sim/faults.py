"""Faults of the line from a device to its host, reproducible by their seed."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

__all__ = ["STALL_BUFFER", "Faults", "FaultyLine"]

#: Bytes that are buffered during a stall; further bytes are lost.
STALL_BUFFER = 1 << 16
#: Number of random positions that are drawn at a time.
BATCH = 256
#: Upper limit of the gap between two random positions, so that sums of gaps fit into int64.
MOST_GAP = 1 << 48


@dataclass(frozen=True)
class Faults:
    """The faults of a line from a virtual device to its host.

    Times are in seconds on the clock of the virtual device.

    Args:
        flip: Probability that a bit is inverted, 0 to 1.
        drop: Probability that a byte is lost, 0 to 1.
        burst: Bytes arrive together at multiples of this period in seconds. A USB-serial adapter with
            default settings has 0.016. 0 delivers bytes at once.
        stall: Start and duration of a stall. Bytes sent during a stall arrive at its end: the first 64 KiB
            of them, the rest is lost.
        unplug: When the plug is pulled, and for how long (None: until the end). Bytes that are sent or in
            transit meanwhile are lost.
        seed: Seed of everything random.

    Raises:
        ValueError: A probability outside 0 to 1, or a time or duration that is negative or not finite.

    Example:
        >>> Faults(flip=1e-4, stall=(5.0, 2.0))
        Faults(flip=0.0001, drop=0.0, burst=0.0, stall=(5.0, 2.0), unplug=None, seed=0)
    """

    flip: float = 0.0
    drop: float = 0.0
    burst: float = 0.0
    stall: tuple[float, float] | None = None
    unplug: tuple[float, float | None] | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("flip", "drop"):
            if not 0 <= (value := getattr(self, name)) <= 1:
                raise ValueError(f"{name} is a probability, from 0 to 1, not {value}")
        for name in ("stall", "unplug"):
            at, seconds = getattr(self, name) or (0.0, None)
            _check_seconds(f"the time of {name}", at)
            _check_seconds(f"the duration of {name}", seconds or 0.0)
        _check_seconds("burst", self.burst)

    @classmethod
    def parse(cls, texts: Iterable[str], seed: int = 0) -> Faults:
        """Parses faults as the command line names them.

        Args:
            texts: ``flip=P``, ``drop=P``, ``burst=SECONDS``, ``stall=AT:SECONDS``, ``unplug=AT:SECONDS``
                or ``unplug=AT``, each at most once.
            seed: Seed of everything random.

        Raises:
            ValueError: A text with another form, or the same fault twice.

        Example:
            >>> Faults.parse(["burst=0.016", "unplug=10:3"])
            Faults(flip=0.0, drop=0.0, burst=0.016, stall=None, unplug=(10.0, 3.0), seed=0)
        """
        found: dict[str, object] = {}
        for text in texts:
            name, _, value = text.partition("=")
            if name in found:
                raise ValueError(f"{name} is given twice")
            try:
                numbers = [float(number) for number in value.split(":")]
            except ValueError:
                numbers = []
            match name, numbers:
                case (("flip" | "drop" | "burst"), [number]):
                    found[name] = number
                case (("stall" | "unplug"), [at, seconds]):
                    found[name] = at, seconds
                case "unplug", [at]:
                    found[name] = at, None
                case _:
                    raise ValueError(
                        f"{text!r} is not a fault: use flip=P, drop=P, burst=SECONDS, "
                        "stall=AT:SECONDS, unplug=AT:SECONDS or unplug=AT"
                    )
        return cls(**found, seed=seed)  # type: ignore[arg-type]


def _check_seconds(name: str, value: float) -> None:
    if not 0 <= value < math.inf:
        raise ValueError(f"{name} must be 0 seconds or more, not {value}")


class FaultyLine:
    """A line with faults: `feed` takes bytes when the device sends them, `take` returns what has arrived.

    The fate of a byte depends on the seed, its position and the time at which it is sent; not on the calls
    that it is passed in. Times must not decrease.

    Args:
        faults: The faults.

    >>> line = FaultyLine(Faults(burst=0.016))
    >>> line.feed(b"abc", 0.010)
    >>> line.take(0.015), line.take(0.016)
    (b'', b'abc')
    """

    def __init__(self, faults: Faults) -> None:
        self.faults = faults
        self._sent = 0
        self._flips = _RandomPositions(faults.flip, [faults.seed, 0])
        self._drops = _RandomPositions(faults.drop, [faults.seed, 1])
        self._in_transit: deque[tuple[float, bytes]] = deque()
        self._stalled = 0

    def feed(self, data: bytes, time: float) -> None:
        """Adds bytes that the device sends at a time in seconds."""
        start = self._sent
        self._sent += len(data)
        damaged = self._damaged(data, start)
        due = time
        if self.faults.stall is not None:
            at, seconds = self.faults.stall
            if at <= time < at + seconds:
                damaged = damaged[: STALL_BUFFER - self._stalled]
                self._stalled += len(damaged)
                due = at + seconds
        if self.faults.burst:
            due = math.ceil(due / self.faults.burst) * self.faults.burst
        if damaged and self._arrives(time, due):
            self._in_transit.append((due, damaged))

    def take(self, time: float) -> bytes:
        """Returns the bytes that have arrived by a time, once."""
        pieces = []
        while self._in_transit and self._in_transit[0][0] <= time:
            pieces.append(self._in_transit.popleft()[1])
        return b"".join(pieces)

    def is_plugged(self, time: float) -> bool:
        """Returns whether the plug is in at a time."""
        if self.faults.unplug is None:
            return True
        at, seconds = self.faults.unplug
        return time < at or (seconds is not None and time >= at + seconds)

    def _arrives(self, time: float, due: float) -> bool:
        """Returns whether the plug is in from one time to another."""
        is_pulled = self.faults.unplug is not None and time < self.faults.unplug[0] <= due
        return self.is_plugged(time) and not is_pulled

    def _damaged(self, data: bytes, start: int) -> bytes:
        """Returns the bytes after flips and drops; ``start`` is their position among all bytes sent."""
        end = start + len(data)
        bits, bytes_ = self._flips.before(8 * end), self._drops.before(end)
        if not len(bits) and not len(bytes_):
            return data
        values = np.frombuffer(data, np.uint8).copy()
        np.bitwise_xor.at(values, bits // 8 - start, (1 << bits % 8).astype(np.uint8))
        return np.delete(values, bytes_ - start).tobytes()


class _RandomPositions:
    """Random positions in rising order; every position has the same probability."""

    def __init__(self, probability: float, seed: list[int]) -> None:
        self._probability = probability
        self._rng = np.random.default_rng(seed)
        self._ahead = np.empty(0, np.int64)
        self._next: float = math.inf
        if probability:
            self._draw(-1)

    def _draw(self, last: int) -> None:
        """Draws more positions after ``last``."""
        # Gaps have a geometric distribution: drawing them costs time per hit, not per position.
        gaps = np.minimum(self._rng.geometric(self._probability, BATCH), MOST_GAP)
        self._ahead = np.concatenate([self._ahead, last + np.cumsum(gaps)])
        self._next = int(self._ahead[0])

    def before(self, end: int) -> npt.NDArray[np.int64]:
        """Returns the next positions before ``end``, once."""
        if self._next >= end:
            return np.empty(0, np.int64)
        while self._ahead[-1] < end:
            self._draw(int(self._ahead[-1]))
        count = int(np.searchsorted(self._ahead, end))
        found, self._ahead = self._ahead[:count], self._ahead[count:]
        self._next = int(self._ahead[0])
        return found
