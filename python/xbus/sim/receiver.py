"""The GNSS receiver of a virtual device: when it has a fix, and how good."""

from __future__ import annotations

from collections.abc import Callable

from xbus.sim.clock import SECOND, Clock

__all__ = ["Receiver", "Rtcm"]

#: How long there must be corrections, in ns, until the carrier phases are floating, and until they are fixed.
FLOAT_AFTER, FIXED_AFTER = 2 * SECOND, 8 * SECOND
#: How long without corrections until there is neither.
CORRECTIONS_LAST = 10 * SECOND
#: How long the filter goes on without a fix that it had (Table 27).
COASTING_LASTS = 60 * SECOND
#: Later than anything.
NEVER = 1 << 62
NO_RTK, RTK_FLOAT, RTK_FIXED = 0, 1, 2

RTCM_PREAMBLE = 0xD3
CRC24Q = 0x1864CFB


class Rtcm:
    """Counts RTCM 3 frames in bytes that come in pieces.

    A frame is D3, six bits of zero, ten of length, so many bytes, and CRC-24Q.

    >>> Rtcm().feed(bytes.fromhex("D300133ED7D30202980EDEEF34B4BD62AC0941986F33360B98"))
    1
    """

    def __init__(self) -> None:
        self._bytes = bytearray()

    def feed(self, data: bytes) -> int:
        """How many frames are complete with these bytes."""
        self._bytes += data
        frames = 0
        while (start := self._bytes.find(RTCM_PREAMBLE)) >= 0:
            del self._bytes[:start]
            if len(self._bytes) < 3:
                return frames
            length = int.from_bytes(self._bytes[1:3], "big")
            end = 3 + length + 3
            if length < 1 << 10 and end > len(self._bytes):
                return frames
            is_frame = length < 1 << 10 and _crc24q(self._bytes[:end]) == 0
            frames += is_frame
            del self._bytes[: end if is_frame else 1]
        self._bytes.clear()
        return frames


def _crc24q(data: bytes | bytearray) -> int:
    """CRC-24Q; zero over a whole frame, its checksum included."""
    crc = 0
    for byte in data:
        crc ^= byte << 16
        for _ in range(8):
            crc <<= 1
            if crc & 1 << 24:
                crc ^= CRC24Q
    return crc


class Receiver:
    """Has a fix some time after `start`; corrections make it a better one.

    Args:
        clock: The device's clock.
        time_to_fix: Seconds that it takes to a fix.
        changed: Called whenever it may have a fix, or another state of the carrier phases.

    Attributes:
        fix_at: When it has a fix, in ns on the clock.
    """

    def __init__(self, clock: Clock, time_to_fix: float, changed: Callable[[], None]) -> None:
        self._clock, self._time_to_fix, self._changed = clock, round(time_to_fix * SECOND), changed
        self._has_antenna = True

    def start(self) -> None:
        """Power-up."""
        self._lost_at: int | None = None
        self.fix_at = self._clock.now + self._time_to_fix if self._has_antenna else NEVER
        self._rtcm = Rtcm()
        #: When the corrections began that have come without a pause, and when the last one came.
        self._corrections: tuple[int, int] | None = None
        self._clock.at(self.fix_at, self._changed)

    @property
    def has_fix(self) -> bool:
        """Whether it knows where it is."""
        return self._clock.now >= self.fix_at

    @property
    def is_coasting(self) -> bool:
        """Whether it has lost its fix not long ago."""
        return self._lost_at is not None and self._clock.now - self._lost_at < COASTING_LASTS

    def connect_antenna(self, connected: bool) -> None:
        """Puts the antenna on, or takes it off."""
        if connected == self._has_antenna:
            return
        self._has_antenna, had_fix = connected, self.has_fix
        now = self._clock.now
        self.fix_at = now + self._time_to_fix if connected else NEVER
        if had_fix:
            self._lost_at = now
            self._clock.at(now + COASTING_LASTS, self._changed)
        self._clock.at(now, self._changed)
        self._clock.at(self.fix_at, self._changed)

    @property
    def rtk(self) -> int:
        """The carrier phases: 0 none, 1 floating, 2 fixed."""
        now = self._clock.now
        if self._corrections is None or not self.has_fix:
            return NO_RTK
        first, last = self._corrections
        if now - last >= CORRECTIONS_LAST:
            return NO_RTK
        since = now - max(first, self.fix_at)
        return RTK_FIXED if since >= FIXED_AFTER else RTK_FLOAT if since >= FLOAT_AFTER else NO_RTK

    def correct(self, data: bytes) -> None:
        """Takes correction data; what is not RTCM 3 changes nothing."""
        if not self._rtcm.feed(data):
            return
        now = self._clock.now
        if self._corrections is None or now - self._corrections[1] >= CORRECTIONS_LAST:
            begin = max(now, self.fix_at)
            self._clock.at(begin + FLOAT_AFTER, self._changed)
            self._clock.at(begin + FIXED_AFTER, self._changed)
            self._corrections = now, now
        self._corrections = self._corrections[0], now
        self._clock.at(now + CORRECTIONS_LAST, self._changed)
