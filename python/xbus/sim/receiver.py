"""The GNSS receiver of a virtual device: when it has a fix, and its RTK status."""

from __future__ import annotations

from collections.abc import Callable

from xbus.sim.clock import SECOND, Clock

__all__ = ["Receiver", "Rtcm"]

#: Duration of corrections in ns after which the RTK status is float, and after which it is fixed.
FLOAT_AFTER, FIXED_AFTER = 2 * SECOND, 8 * SECOND
#: Duration without corrections in ns after which there is no RTK.
CORRECTIONS_LAST = 10 * SECOND
#: How long the filter coasts after the loss of the fix, in ns (Table 27).
COASTING_LASTS = 60 * SECOND
#: A time in ns that is never reached.
NEVER = 1 << 62
#: RTK status in the status word (Table 27).
NO_RTK, RTK_FLOAT, RTK_FIXED = 0, 1, 2

#: An RTCM 3 frame: preamble, six zero bits and ten of length, data, CRC-24Q.
RTCM_PREAMBLE, RTCM_HEADER, RTCM_CRC = 0xD3, 3, 3
MOST_RTCM_DATA = (1 << 10) - 1
CRC24Q = 0x1864CFB


class Rtcm:
    """Counts RTCM 3 frames in bytes that arrive in pieces.

    >>> Rtcm().feed(bytes.fromhex("D300133ED7D30202980EDEEF34B4BD62AC0941986F33360B98"))
    1
    """

    def __init__(self) -> None:
        self._bytes = bytearray()

    def feed(self, data: bytes) -> int:
        """Returns the number of frames that these bytes complete."""
        self._bytes += data
        frames = 0
        while (start := self._bytes.find(RTCM_PREAMBLE)) >= 0:
            del self._bytes[:start]
            if len(self._bytes) < RTCM_HEADER:
                return frames
            length = int.from_bytes(self._bytes[1:RTCM_HEADER], "big")
            end = RTCM_HEADER + length + RTCM_CRC
            if length <= MOST_RTCM_DATA and end > len(self._bytes):
                return frames
            is_frame = length <= MOST_RTCM_DATA and _crc24q(self._bytes[:end]) == 0
            frames += is_frame
            del self._bytes[: end if is_frame else 1]
        self._bytes.clear()
        return frames


def _crc24q(data: bytes | bytearray) -> int:
    """Returns the CRC-24Q of bytes: zero for a whole frame with its checksum."""
    crc = 0
    for byte in data:
        crc ^= byte << 16
        for _ in range(8):
            crc <<= 1
            if crc & 1 << 24:
                crc ^= CRC24Q
    return crc


class Receiver:
    """A receiver with a fix some time after `start`, and RTK while it gets corrections.

    Args:
        clock: The device's clock.
        time_to_fix: Seconds from `start` or from the connection of the antenna to the fix.
        changed: Called whenever fix, coasting or RTK status may change.

    Attributes:
        fix_at: Time of the fix, in ns on the clock.
    """

    def __init__(self, clock: Clock, time_to_fix: float, changed: Callable[[], None]) -> None:
        self._clock, self._time_to_fix, self._changed = clock, round(time_to_fix * SECOND), changed
        self._has_antenna = True

    def start(self) -> None:
        """Powers up."""
        self._lost_at: int | None = None
        self.fix_at = self._clock.now + self._time_to_fix if self._has_antenna else NEVER
        self._rtcm = Rtcm()
        #: First and last of the corrections without a pause between them, in ns.
        self._corrections: tuple[int, int] | None = None
        self._clock.at(self.fix_at, self._changed)

    @property
    def has_fix(self) -> bool:
        """Whether it has a position."""
        return self._clock.now >= self.fix_at

    @property
    def is_coasting(self) -> bool:
        """Whether it lost its fix less than a minute ago."""
        return self._lost_at is not None and self._clock.now - self._lost_at < COASTING_LASTS

    def connect_antenna(self, connected: bool) -> None:
        """Connects or disconnects the antenna."""
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
        """RTK status: 0 none, 1 float, 2 fixed."""
        now = self._clock.now
        if self._corrections is None or not self.has_fix:
            return NO_RTK
        first, last = self._corrections
        if now - last >= CORRECTIONS_LAST:
            return NO_RTK
        since = now - max(first, self.fix_at)
        return RTK_FIXED if since >= FIXED_AFTER else RTK_FLOAT if since >= FLOAT_AFTER else NO_RTK

    def correct(self, data: bytes) -> None:
        """Accepts correction data. Only RTCM 3 frames have an effect."""
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
