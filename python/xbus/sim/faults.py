"""What can go wrong on the way from a device to its host, on demand and always in the same way."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

__all__ = ["BUFFER", "Faults", "FaultyLine"]

#: Bytes that wait during a stall; what comes while they do not fit is lost.
BUFFER = 1 << 16
#: How many accidents are drawn at a time.
BATCH = 256
#: No gap between two accidents is longer than this many bits, so that sums of gaps stay integers.
LONGEST_GAP = 1 << 48


@dataclass(frozen=True)
class Faults:
    """What is wrong with a line. Times are in seconds on the clock of the virtual device.

    Attributes:
        flip: Probability that a bit is turned over.
        drop: Probability that a byte is lost.
        burst: Bytes come only at multiples of so many seconds, all at once; 0.016 is what a
            USB-serial adapter does with its timer as delivered. 0 is at once.
        stall: From when on and for how long nothing comes. It comes late, the first 64 KiB of it: the
            rest is lost.
        unplug: From when on and for how long the plug is pulled (None: for good). What is sent
            meanwhile or was still on its way is lost.
        seed: Of what happens by chance.

    Raises:
        ValueError: A probability outside 0 to 1, a time or duration that is none.

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
        """Faults as the command line names them.

        Args:
            texts: ``flip=P``, ``drop=P``, ``burst=SECONDS``, ``stall=AT:SECONDS``, ``unplug=AT:SECONDS``
                or ``unplug=AT``, each at most once.
            seed: Of what happens by chance.

        Raises:
            ValueError: A text that is none of these.

        >>> Faults.parse(["burst=0.016", "unplug=10:3"])
        Faults(flip=0.0, drop=0.0, burst=0.016, stall=None, unplug=(10.0, 3.0), seed=0)
        """
        found: dict[str, object] = {}
        for text in texts:
            name, _, value = text.partition("=")
            if name in found:
                raise ValueError(f"{name} is there twice")
            try:
                numbers = [float(it) for it in value.split(":")]
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
                        f"{text!r} is none of flip=P, drop=P, burst=SECONDS, stall=AT:SECONDS, "
                        "unplug=AT:SECONDS, unplug=AT"
                    )
        return cls(**found, seed=seed)  # type: ignore[arg-type]


def _check_seconds(what: str, value: float) -> None:
    if not 0 <= value < math.inf:
        raise ValueError(f"{what} is in seconds, 0 or more, not {value}")


class FaultyLine:
    """A line with faults: bytes go in when the device sends them, and come out when the host has them.

    What happens to a byte depends on the seed, on how many bytes went before it and on when it was
    sent; not on how calls cut the bytes. Times must not fall.

    Args:
        faults: What is wrong with it.

    >>> line = FaultyLine(Faults(burst=0.016))
    >>> line.feed(b"abc", 0.010)
    >>> line.take(0.015), line.take(0.016)
    (b'', b'abc')
    """

    def __init__(self, faults: Faults) -> None:
        self.faults = faults
        self._sent = 0
        self._flips = _Accidents(faults.flip, [faults.seed, 0])
        self._drops = _Accidents(faults.drop, [faults.seed, 1])
        self._waiting: deque[tuple[float, bytes]] = deque()
        self._stalled = 0

    def feed(self, data: bytes, time: float) -> None:
        """Bytes that the device sends, and when."""
        start = self._sent
        self._sent += len(data)
        damaged = self._damaged(data, start)
        due = time
        if self.faults.stall is not None:
            at, seconds = self.faults.stall
            if at <= time < at + seconds:
                damaged = damaged[: BUFFER - self._stalled]
                self._stalled += len(damaged)
                due = at + seconds
        if self.faults.burst:
            due = math.ceil(due / self.faults.burst) * self.faults.burst
        if damaged and self._arrives(time, due):
            self._waiting.append((due, damaged))

    def take(self, time: float) -> bytes:
        """The bytes that have come by this time and were not taken yet."""
        pieces = []
        while self._waiting and self._waiting[0][0] <= time:
            pieces.append(self._waiting.popleft()[1])
        return b"".join(pieces)

    def plugged(self, time: float) -> bool:
        """Whether the plug is in at this time."""
        if self.faults.unplug is None:
            return True
        at, seconds = self.faults.unplug
        return time < at or (seconds is not None and time >= at + seconds)

    def _arrives(self, time: float, due: float) -> bool:
        """Whether the plug is in at one time, and stays in until the other."""
        is_pulled = self.faults.unplug is not None and time < self.faults.unplug[0] <= due
        return self.plugged(time) and not is_pulled

    def _damaged(self, data: bytes, start: int) -> bytes:
        """The bytes from position ``start`` of all that was sent, after flips and drops."""
        end = start + len(data)
        bits, bytes_ = self._flips.before(8 * end), self._drops.before(end)
        if not len(bits) and not len(bytes_):
            return data
        values = np.frombuffer(data, np.uint8).copy()
        np.bitwise_xor.at(values, bits // 8 - start, (1 << bits % 8).astype(np.uint8))
        return np.delete(values, bytes_ - start).tobytes()


class _Accidents:
    """Where something happens that has the same probability at every position, in rising order."""

    def __init__(self, probability: float, seed: list[int]) -> None:
        self._probability = probability
        self._rng = np.random.default_rng(seed)
        self._ahead = np.empty(0, np.int64)
        self._next: float = math.inf
        if probability:
            self._draw(-1)

    def _draw(self, last: int) -> None:
        """Draws more of them, after ``last``."""
        # Between two accidents lies a geometric number of positions: the work is in proportion to them.
        gaps = np.minimum(self._rng.geometric(self._probability, BATCH), LONGEST_GAP)
        self._ahead = np.concatenate([self._ahead, last + np.cumsum(gaps)])
        self._next = int(self._ahead[0])

    def before(self, end: int) -> npt.NDArray[np.int64]:
        """The next ones, as far as they lie before ``end``."""
        if self._next >= end:
            return np.empty(0, np.int64)
        while self._ahead[-1] < end:
            self._draw(int(self._ahead[-1]))
        count = int(np.searchsorted(self._ahead, end))
        found, self._ahead = self._ahead[:count], self._ahead[count:]
        self._next = int(self._ahead[0])
        return found
