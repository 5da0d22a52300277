"""A recording that a virtual device replays, at any speed and from any moment."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from xbus.formatting import format_size
from xbus.protocol.products import product_of_code
from xbus.sim import Replay, SimulatedDevice

__all__ = ["REPLAY", "SPEEDS", "Replaying", "replay_source"]

#: Prefix of the name of a recording that a virtual device replays.
REPLAY = "replay:"
#: Between the pieces of a recording in such a name.
PIECES = "|"
#: Seconds of the recording per second.
SPEEDS = (0.5, 1, 2, 10)
#: Bytes of the largest recording: a replay needs up to five times as much memory.
LARGEST = 500_000_000


def replay_source(files: Iterable[Path]) -> str:
    """Returns the name under which a recording is replayed."""
    return REPLAY + PIECES.join(map(str, files))


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
        ValueError: There is nothing to replay, or too much.
    """

    def __init__(self, source: str) -> None:
        text = source.removeprefix(REPLAY)
        names = [text] if Path(text).exists() else text.split(PIECES)
        size = sum(Path(name).stat().st_size for name in names)
        if size > LARGEST:
            raise ValueError(
                f"it has {format_size(size)}, and a replay at most {format_size(LARGEST)}; cut a part of it "
                "first, with Cut on the page Recordings or xbus cut"
            )
        self._replay = Replay(names)
        if not len(self._replay):
            raise ValueError("the recording has no frame of a device")
        code = self._replay.identity.product_code
        product = None if code is None else product_of_code(code)
        self.files = tuple(names)
        self.name = Path(names[0]).name
        self.device = SimulatedDevice(product or "MTi-630", replay=self._replay)
        self.speed = 1.0

    @property
    def duration(self) -> float:
        """Seconds of the whole recording."""
        return self._replay.duration

    @property
    def position(self) -> float:
        """Seconds from the beginning of the recording to what is replayed now."""
        return self._replay.position

    def start_at(self, seconds: float) -> None:
        """Begins there when the device next begins to measure."""
        self._replay.start = min(max(seconds, 0.0), self.duration)
