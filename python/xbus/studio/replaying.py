"""A recording that a virtual device replays, at any speed and from any moment."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import numpy.typing as npt

from xbus.describe.names import file_label
from xbus.files import content_size, is_plain
from xbus.formatting import format_count, format_size
from xbus.log.identity import Identity
from xbus.log.log import Log
from xbus.log.pacing import ReplayPace
from xbus.log.pieces import pieces_of
from xbus.protocol.products import product_of_code
from xbus.sim import Replay, SimulatedDevice

__all__ = ["REPLAY", "SPEEDS", "Replaying", "replay_source", "source_label"]

#: Prefix of the name of a recording that a virtual device replays.
REPLAY = "replay:"
#: Between the pieces of a recording in such a name.
PIECES = "|"
#: Seconds of the recording per second.
SPEEDS = (0.5, 1, 2, 10)
#: Bytes of the largest recording: a replay needs up to five times as much memory.
LARGEST = 500_000_000
#: Seconds by which samples arrive at most after they are replayed.
DELAY = 1.0


def replay_source(files: Iterable[Path]) -> str:
    """Returns the name under which a recording is replayed."""
    return REPLAY + PIECES.join(map(str, files))


def source_label(source: str) -> str:
    """Returns the name of a device for people: the file instead of the name under which it is replayed.

    >>> source_label("replay:/tmp/walk.mtb|/tmp/walk-0001.mtb"), source_label("/dev/ttyUSB0")
    ('walk.mtb and 1 more file', '/dev/ttyUSB0')
    """
    if not source.startswith(REPLAY):
        return source
    first, *more = _files_of(source)
    name = file_label(Path(first).name)
    return f"{name} and {format_count(len(more), 'more file')}" if more else name


def _files_of(source: str) -> list[str]:
    """Returns the files of a recording that is replayed under a name."""
    text = source.removeprefix(REPLAY)
    return [text] if Path(text).exists() else text.split(PIECES)


class Replaying:
    """A recording that is being replayed.

    Args:
        source: The name, as `replay_source` returns it.

    Attributes:
        files: The files of the recording.
        name: Name of the first file.
        device: The virtual device that sends it.
        speed: Seconds of the recording per second. Another thread may change it.

    Raises:
        OSError: A file cannot be read.
        ValueError: There is nothing to replay, or too much, or the files are not those of one recording.
    """

    def __init__(self, source: str) -> None:
        names = _files_of(source)
        size = sum(content_size(name, LARGEST + 1) for name in names)
        if size > LARGEST:
            most = format_size(LARGEST)
            found = format_size(size) if all(map(is_plain, names)) else f"more than {most}"
            raise ValueError(
                f"it has {found}, and a replay at most {most}; cut a part of it first, with Cut on the page "
                "Recordings or xbus cut"
            )
        if len(names) > 1:
            pieces_of(names)  # of compressed pieces, only the names were compared
        self._replay = Replay(names)
        if not len(self._replay):
            raise ValueError("the recording has no frame of a device")
        code = self.identity.product_code
        product = None if code is None else product_of_code(code)
        self.files = tuple(names)
        self.name = Path(names[0]).name
        self.device = SimulatedDevice(product or "MTi-630", replay=self._replay)
        self.speed = 1.0
        self._pace, self._begin, self._received = ReplayPace(), 0.0, 0.0
        #: Whether a moment was chosen, and samples from there on have not arrived yet.
        self._is_chosen = False

    @property
    def identity(self) -> Identity:
        """The device that was recorded, as far as the recording identifies it."""
        return self._replay.identity

    @property
    def duration(self) -> float:
        """Seconds of the whole recording."""
        return self._replay.duration

    @property
    def position(self) -> float:
        """Seconds from the beginning of the recording to what is replayed now."""
        return self._replay.position

    @property
    def is_over(self) -> bool:
        """Whether the whole recording was sent."""
        return self.position >= self.duration

    @property
    def now(self) -> float:
        """Seconds from the beginning of the recording to what has arrived; it stands still at the end."""
        return max(self._received, self.position - self._delay)

    @property
    def _delay(self) -> float:
        return DELAY * max(self.speed, 1.0)

    def start_at(self, seconds: float) -> None:
        """Begins there when the device next begins to measure."""
        self._replay.start = min(max(seconds, 0.0), self.duration)
        self._is_chosen = True

    def times(self, block: Log) -> npt.NDArray[np.float64]:
        """Returns when the samples of a block were recorded, whatever the speed of the replay.

        Args:
            block: The samples that follow those of the previous call.

        Returns:
            Seconds since the beginning of the recording, ``(N,)``; NaN for samples that were replayed before
            the device began to measure again.
        """
        if not len(block):
            return np.empty(0)
        times = self._begin + self._pace.times(block)
        position = self.position
        # A device that begins to measure begins at the chosen moment. A recorded restart looks the same in a
        # block, so without a choice the position decides.
        for first in (block.restarts - block.first_sample)[-1:].tolist():
            pace = ReplayPace()
            fresh = pace.times(block)
            begin = self._replay.start - float(fresh[first])
            is_nearer = abs(begin + fresh[-1] - position) < abs(times[-1] - position)
            if self._is_chosen or is_nearer:
                times = begin + fresh
                times[:first] = np.nan
                self._pace, self._begin, self._is_chosen = pace, begin, False
        late = position - float(times[-1])
        if abs(late) > self._delay:
            self._begin += late
            times += late
        self._received = float(times[-1])
        return times
