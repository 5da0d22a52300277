"""A recording as the output of a virtual device."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from xbus.log.pacing import UNSTAMPED_RATE, ReplayPace
from xbus.log.read import read_log
from xbus.protocol.ids import MessageId
from xbus.protocol.tables import MESSAGES, RECEIVER
from xbus.protocol.values import StringType
from xbus.sim.sensors import IntArray

__all__ = ["Playback", "Replay"]

#: What a device says only when it is asked, or when it starts.
ANSWERS = [it.reply for it in MESSAGES.values() if it.reply is not None] + [MessageId.WakeUp]


class Replay:
    """A recording that virtual devices send, frame by frame and string by string as it was received.

    Sent is what devices send unasked in Measurement: samples, strings, errors, warnings and unknown
    messages, none of it changed, and not what lies between as damage. Answers to requests are left out, and
    so is what MT Manager writes at the beginning of a log.

    The pace is that of the time stamps. Samples without one, those of the GNSS receiver and of a second
    device, and other messages come between their neighbours, and so do strings; without any stamp 100
    samples come a second, and without any sample 100 strings. A pause of more than 10 s lasts 10 s, and a
    step back of the clock no time.

    Args:
        source: Path of the recording, or its bytes.
        strings: As in `xbus.read_log`.

    Attributes:
        identity: What the recording says about its device: `device_id`, `product_code`, `firmware`.
        duration: Seconds from the first frame to the last.

    Raises:
        OSError: The file cannot be read.

    >>> replay = Replay("tests/captures/walk.mtb")
    >>> replay.identity.product_code, round(replay.duration, 2)
    ('MTi-680G-8A1G6', 9.99)
    """

    def __init__(
        self,
        source: str | os.PathLike[str] | bytes,
        *,
        strings: Iterable[StringType | str] = (),
    ) -> None:
        self._data = source if isinstance(source, bytes) else Path(source).read_bytes()
        log = read_log(self._data, quantities=RECEIVER, strings=strings)
        times = ReplayPace().times(log)
        unasked = ~np.isin(log.messages.mid, ANSWERS)
        # One more instant, for messages and strings after the last sample.
        neighbours = np.append(times, times[-1:] if len(times) else [0.0])
        spoken = (
            neighbours[log.strings.sample]
            if len(log)
            else np.arange(len(log.strings)) / UNSTAMPED_RATE
        )
        offsets = [log.offset, log.messages.offset[unasked], log.strings.offset]
        frames = np.concatenate(offsets[:2])
        ends = [frames + _frame_sizes(self._data, frames), log.strings.end]
        order = np.argsort(np.concatenate(offsets))
        self._offsets = np.concatenate(offsets)[order]
        self._times = np.concatenate([times, neighbours[log.messages.sample[unasked]], spoken])[
            order
        ]
        self._ends = np.concatenate(ends)[order]
        self._is_sample = order < len(log)
        self.identity = log.identity
        self.duration = float(self._times[-1]) if len(self._times) else 0.0

    def __len__(self) -> int:
        """How many frames and strings there are."""
        return len(self._offsets)

    def play(self, start: float) -> Playback:
        """Plays from the beginning.

        Args:
            start: When the first frame is sent, in seconds on any clock.
        """
        return Playback(self, start)


class Playback:
    """A recording on its way: to a virtual device the same as a `Stream`.

    >>> playback = Replay("tests/captures/walk.mtb").play(100.0)
    >>> [round(time, 3) for time, frame in playback.take(100.02)]
    [100.0, 100.01, 100.02]
    """

    def __init__(self, replay: Replay, start: float) -> None:
        self._replay = replay
        self._start = start
        self._next = 0

    def take(self, until: float, status: int = 0) -> list[tuple[float, bytes]]:  # noqa: ARG002
        """The frames sent since the last call, or since the start, up to and at a time.

        Args:
            until: Seconds on the clock of `start`.
            status: Of a `Stream`; the recording has its own.

        Returns:
            When each was sent, and the frame. Nothing comes after the end.
        """
        first, self._next = self._next, self._count(until)
        times = self._start + self._replay._times[first : self._next]
        return [
            (time, self._frame(at))
            for at, time in zip(range(first, self._next), times.tolist(), strict=True)
        ]

    def latest(self, now: float, status: int = 0) -> list[bytes]:  # noqa: ARG002
        """The newest sample at a time, the answer to ReqData; none before the first."""
        samples = np.flatnonzero(self._replay._is_sample[: self._count(now)])
        return [self._frame(it) for it in samples[-1:].tolist()]

    def _count(self, until: float) -> int:
        """How many frames are sent by this time."""
        # A nanosecond is what a sum of seconds may be off.
        return int(np.searchsorted(self._replay._times, until - self._start + 1e-9, side="right"))

    def _frame(self, at: int) -> bytes:
        return self._replay._data[self._replay._offsets[at] : self._replay._ends[at]]


def _frame_sizes(data: bytes, offsets: IntArray) -> IntArray:
    """Bytes of the frames that begin at these offsets, preamble and checksum included."""
    octets = np.frombuffer(data, np.uint8)
    payloads = octets[offsets + 3].astype(np.int64)
    is_extended = payloads == 0xFF
    high, low = (octets[offsets[is_extended] + it].astype(np.int64) for it in (4, 5))
    sizes = payloads + 5
    sizes[is_extended] = high * 256 + low + 7
    return sizes
