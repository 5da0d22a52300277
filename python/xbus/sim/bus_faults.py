"""Faults of I²C and SPI buses, reproducible by their seed."""

from __future__ import annotations

import math
import random
from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum

__all__ = ["BusFaults", "Fate", "Fates"]

PROBABILITIES = ("nack", "timeout", "short", "garbage", "flip", "drop")


@dataclass(frozen=True)
class BusFaults:
    """The faults of an I²C or SPI bus with a virtual device.

    Args:
        nack: Probability that a transfer is not acknowledged, 0 to 1. On SPI, which has no acknowledge, the
            host reads FF.
        timeout: Probability that a transfer times out because the device holds the clock; I²C only.
        short: Probability that a read ends early: the host reads FF for the rest, and the message stays.
        garbage: Probability that the status of the pipes reads FF FF FF FF.
        flip: Probability that a bit that the host reads is inverted.
        drop: Probability that a message is lost before it reaches its pipe.
        absent: When the device leaves the bus, and for how long (None: until the end), in seconds.
        stuck: The value of every byte that the host reads, as on SPI in the wrong mode: 0x00 or 0xFF.
        seed: Seed of everything random.

    Raises:
        ValueError: A probability outside 0 to 1, or a time that is negative or not finite.

    Example:
        >>> BusFaults(nack=0.01, absent=(5.0, 2.0)).absent
        (5.0, 2.0)
    """

    nack: float = 0.0
    timeout: float = 0.0
    short: float = 0.0
    garbage: float = 0.0
    flip: float = 0.0
    drop: float = 0.0
    absent: tuple[float, float | None] | None = None
    stuck: int | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        for name in PROBABILITIES:
            if not 0 <= (value := getattr(self, name)) <= 1:
                raise ValueError(f"{name} is a probability, from 0 to 1, not {value}")
        for seconds in self.absent or ():
            if seconds is not None and not 0 <= seconds < math.inf:
                raise ValueError(f"the times of absent must be 0 seconds or more, not {seconds}")
        if self.stuck is not None and not 0 <= self.stuck <= 0xFF:
            raise ValueError(f"stuck is a byte, not {self.stuck}")

    @classmethod
    def parse(cls, texts: Iterable[str], seed: int = 0) -> BusFaults:
        """Parses faults as text.

        Args:
            texts: ``nack=P``, ``timeout=P``, ``short=P``, ``garbage=P``, ``flip=P``, ``drop=P``,
                ``absent=AT:SECONDS``, ``absent=AT`` or ``stuck=BYTE`` in hexadecimal, each at most once.
            seed: Seed of everything random.

        Raises:
            ValueError: A text with another form, or the same fault twice.

        Example:
            >>> BusFaults.parse(["nack=0.01", "stuck=FF"]).stuck
            255
        """
        found: dict[str, object] = {}
        for text in texts:
            name, _, value = text.partition("=")
            if name in found:
                raise ValueError(f"{name} is given twice")
            try:
                found[name] = _parse(name, value)
            except ValueError:
                names = ", ".join(f"{name}=P" for name in PROBABILITIES)
                raise ValueError(
                    f"{text!r} is not a fault of a bus: use {names}, absent=AT:SECONDS, absent=AT or"
                    " stuck=BYTE"
                ) from None
        return cls(**found, seed=seed)  # type: ignore[arg-type]


def _parse(name: str, value: str) -> object:
    if name in PROBABILITIES:
        return float(value)
    if name == "stuck":
        return int(value, 16)
    if name != "absent":
        raise ValueError(name)
    at, _, seconds = value.partition(":")
    return float(at), float(seconds) if seconds else None


class Fate(Enum):
    """What becomes of a transfer."""

    DONE = "done"
    NACK = "nack"
    TIMEOUT = "timeout"
    SHORT = "short"
    GARBAGE = "garbage"


class Fates:
    """Draws what becomes of transfers and messages, in their order.

    Args:
        faults: The faults.
    """

    def __init__(self, faults: BusFaults) -> None:
        self._faults = faults
        self._random = random.Random(faults.seed)  # noqa: S311 - reproducible

    def next(self, time: float) -> Fate:
        """Returns what becomes of a transfer at a time in seconds."""
        if self._is_absent(time):
            return Fate.NACK
        for fate in (Fate.NACK, Fate.TIMEOUT, Fate.SHORT, Fate.GARBAGE):
            if self._happens(getattr(self._faults, fate.value)):
                return fate
        return Fate.DONE

    def _is_absent(self, time: float) -> bool:
        if self._faults.absent is None:
            return False
        at, seconds = self._faults.absent
        return time >= at and (seconds is None or time < at + seconds)

    def is_dropped(self) -> bool:
        """Returns whether the next message is lost."""
        return self._happens(self._faults.drop)

    def seen(self, data: bytes) -> bytes:
        """Returns what the host reads of data."""
        if self._faults.stuck is not None:
            return bytes([self._faults.stuck]) * len(data)
        if not self._faults.flip:
            return data
        flips = (self._happens(self._faults.flip) for _ in range(8 * len(data)))
        mask = sum(1 << bit for bit, flip in enumerate(flips) if flip)
        return (int.from_bytes(data, "little") ^ mask).to_bytes(len(data), "little")

    def cut(self, data: bytes) -> bytes:
        """Returns what the host reads of data that end early."""
        kept = self._random.randrange(len(data)) if data else 0
        return data[:kept] + b"\xff" * (len(data) - kept)

    def _happens(self, probability: float) -> bool:
        # Nothing is drawn for a fault that is off, so the others do not depend on it.
        return probability > 0 and self._random.random() < probability
