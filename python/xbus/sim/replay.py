"""A recording as the output of a virtual device."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterable, Sequence

import numpy as np

from xbus.captures import check_no_capture
from xbus.files import open_file
from xbus.log.log import Log
from xbus.log.pacing import UNSTAMPED_RATE, ReplayPace
from xbus.log.read import read_log
from xbus.protocol.ids import MessageId
from xbus.protocol.tables import MESSAGES, RECEIVER
from xbus.protocol.values import StringType
from xbus.sim.sensors import IntArray

__all__ = ["Playback", "Replay"]

#: Messages that a device sends only as a reply, or at its start.
REPLIES = [row.reply for row in MESSAGES.values() if row.reply is not None] + [MessageId.WakeUp]
#: A sum of seconds can be off by rounding; a nanosecond is more than that.
ROUNDING = 1e-9


class Replay:
    """A recording that virtual devices send in Measurement, frame by frame and string by string.

    Samples, strings, errors, warnings and unknown messages are sent unchanged. Damaged bytes, replies to
    requests, and the messages that MT Manager writes at the beginning of a log are skipped.

    Time stamps set the pace. Samples without a stamp, samples of the GNSS receiver and of a second device,
    other messages and strings are sent between their neighbours. Without stamps, 100 samples are sent per
    second, and without samples, 100 strings. A pause of more than 10 s lasts 10 s, and a step back of the
    clock takes no time.

    Args:
        source: Path of the recording, its bytes, or the paths of its pieces in order; files may be
            compressed.
        strings: String types without a checksum to look for, as in `xbus.read_log`.

    Attributes:
        identity: Identity of the recorded device: ``device_id``, ``product_code``, ``firmware``.
        duration: Seconds from the first frame to the last.
        start: Seconds into the recording at which the next `play` begins; 0 at first. A virtual device plays
            each time it begins to measure.
        position: Seconds into the recording until which it was sent.

    Raises:
        ImportError: The library for a compression is not installed.
        OSError: The file cannot be read.

    Example:
        >>> import xbus
        >>> from xbus.sim import Replay
        >>> replay = Replay("tests/captures/walk.mtb")
        >>> replay.identity.product_code, round(replay.duration, 2)
        ('MTi-680G-8A1G6', 9.99)
        >>> device = xbus.SimulatedDevice("MTi-680G", replay=replay)
        >>> device.advance(5.0)
        >>> len(xbus.read_log(device.read())) > 400
        True
    """

    def __init__(
        self,
        source: str | os.PathLike[str] | bytes | Sequence[str | os.PathLike[str]],
        *,
        strings: Iterable[StringType | str] = (),
    ) -> None:
        if isinstance(source, str | os.PathLike):
            source = [source]
        if not isinstance(source, bytes):
            source = b"".join(map(_content, source))
        self._data = source
        log = read_log(self._data, quantities=RECEIVER, strings=strings)
        times = ReplayPace().times(log)
        is_sent = ~np.isin(log.messages.mid, REPLIES)
        # Messages and strings are sent with the next sample; after the last sample, at its time.
        sample_times = np.append(times, times[-1:] if len(times) else [0.0])
        message_times = sample_times[log.messages.sample[is_sent]]
        string_times = np.arange(len(log.strings)) / UNSTAMPED_RATE
        if len(log):
            string_times = sample_times[log.strings.sample]
        offsets = np.concatenate([log.offset, log.messages.offset[is_sent], log.strings.offset])
        order = np.argsort(offsets)
        self._offsets = offsets[order]
        self._ends = _ends(log, self._offsets, len(self._data))
        self._times = np.concatenate([times, message_times, string_times])[order]
        self._is_sample = order < len(log)
        self.identity = log.identity
        self.duration = float(self._times[-1]) if len(self._times) else 0.0
        self.start = self.position = 0.0

    def __len__(self) -> int:
        """Number of frames and strings."""
        return len(self._offsets)

    def play(self, start: float) -> Playback:
        """Returns a playback from `start` on.

        Args:
            start: When it begins, in seconds on any clock.
        """
        return Playback(self, start)


class Playback:
    """A recording that is being played: a source of samples, like `Stream`.

    >>> playback = Replay("tests/captures/walk.mtb").play(100.0)
    >>> [round(time, 3) for time, frame in playback.take(100.02)]
    [100.0, 100.01, 100.02]
    """

    def __init__(self, replay: Replay, start: float) -> None:
        self._replay = replay
        #: When the recording would have begun.
        self._start = start - replay.start
        self._next = int(np.searchsorted(replay._times, replay.start - ROUNDING))
        replay.position = replay.start

    def take(self, until: float, status: int = 0) -> list[tuple[float, bytes]]:  # noqa: ARG002
        """Returns the frames sent since the last call, up to and including a time, each with its time.

        Args:
            until: Seconds on the clock of ``start``.
            status: Ignored: the recorded samples have their own status.
        """
        first, self._next = self._next, max(self._next, self._count(until))
        times = self._start + self._replay._times[first : self._next]
        position = min(until - self._start, self._replay.duration)
        self._replay.position = max(position, self._replay.position)
        return [
            (time, self._frame(index))
            for index, time in zip(range(first, self._next), times.tolist(), strict=True)
        ]

    def latest(self, now: float, status: int = 0) -> list[bytes]:  # noqa: ARG002
        """Returns the newest sample at a time, the reply to ReqData; none before the first sample."""
        samples = np.flatnonzero(self._replay._is_sample[: self._count(now)])
        return [self._frame(index) for index in samples[-1:].tolist()]

    def _count(self, until: float) -> int:
        """Returns the number of frames sent by a time."""
        latest = until - self._start + ROUNDING
        return int(np.searchsorted(self._replay._times, latest, side="right"))

    def _frame(self, index: int) -> bytes:
        return self._replay._data[self._replay._offsets[index] : self._replay._ends[index]]


def _content(path: str | os.PathLike[str]) -> bytes:
    with contextlib.closing(open_file(os.fspath(path))) as file:
        data = file.read()
    check_no_capture(data, os.fsdecode(path))
    return data


def _ends(log: Log, offsets: IntArray, size: int) -> IntArray:
    """Returns where the frames and strings at these offsets end: frames, strings and damage leave no gaps."""
    parts = (log.offset, log.messages.offset, log.strings.offset, log.damage["offset"])
    bounds = np.sort(np.concatenate([*parts, [size]]))
    return bounds[np.searchsorted(bounds, offsets, side="right")]
