"""A recording as a source of the monitor, replayed at the pace of its time stamps."""

from __future__ import annotations

import math
import os
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict

from xbus.cli.failure import Failure, cannot
from xbus.cli.inputs import label, no_frame
from xbus.log.log import Log, MissingDeviceError
from xbus.log.pacing import UNSTAMPED_RATE, ReplayPace
from xbus.log.read import iter_log
from xbus.watch.events import EVENT_MESSAGES, describe_event
from xbus.watch.model import Counts, Model

__all__ = ["ReplaySource"]

#: Duration of a part of the recording, in seconds.
STEP = 0.1
#: Bytes at the start of a recording that determine the size of a part, and the minimum size.
HEAD_BYTES, MIN_PART_BYTES = 1 << 18, 64


class ReplaySource:
    """A recording, at the pace that `ReplayPace` computes.

    Args:
        file: Path of the recording.
        speed: Replay speed; 2 is twice as fast as recorded.
        strings: As in `read_log`.
        bid: The only device to show, or None.
        legacy: As in `read_log`.

    Raises:
        Failure: The file cannot be read, or contains no frame, or no sample of the device.
    """

    def __init__(
        self,
        file: str,
        speed: float = 1.0,
        strings: Sequence[str] = (),
        bid: int | None = None,
        legacy: Sequence[tuple[int, int]] = (),
    ) -> None:
        self._file, self._speed, self._bid = file, speed, bid
        self._strings, self._legacy = strings, legacy
        self._size, block_bytes = self._measure()
        self._parts = self._read(block_bytes)
        self._pace = ReplayPace()
        #: Number of messages by message identifier.
        self._mids: Counter[int] = Counter()
        #: When the next part ends, in seconds since the first sample.
        self._due = 0.0
        self._began = time.monotonic()
        self._paused_at: float | None = None
        self._read_next()

    @property
    def is_over(self) -> bool:
        """Whether all parts were replayed."""
        return self._part is None

    def model(self) -> Model:
        """Returns the model before the first part."""
        return Model(self._file, progress=0.0)

    def wait(self) -> float:
        """Returns the seconds until the next part is due."""
        if self.is_over or self._paused_at is not None:
            return math.inf
        return self._began + self._due / self._speed - time.monotonic()

    def pause(self) -> None:
        """Pauses the replay, or resumes it."""
        now = time.monotonic()
        if self._paused_at is None:
            self._paused_at = now
        else:
            self._began += now - self._paused_at
            self._paused_at = None

    def advance(self, model: Model) -> None:
        """Adds the next part to the model."""
        if (part := self._part) is None:
            return
        model.add_block(part, self._due)
        added, counts = asdict(part.stats), asdict(model.counts)
        model.counts = Counts(**{name: n + added.get(name, 0) for name, n in counts.items()})
        model.progress = min(1.0, model.counts.bytes / self._size)
        model.device = part.product_code
        for message in part.messages.named(*EVENT_MESSAGES):
            model.counts.errors += message.name == "Error"
            model.counts.warnings += message.name == "Warning"
            model.add_event(describe_event(message), is_bad=message.name != "WakeUp")
        self._mids.update(part.messages.mid.tolist())
        model.add_undecoded(self._mids)
        self._read_next()
        if self.is_over:
            model.progress = 1.0

    def _read_next(self) -> None:
        self._part = next(self._parts, None)
        if self._part is not None and len(self._part):
            self._due = float(self._pace.times(self._part)[-1])

    def _measure(self) -> tuple[int, int]:
        """Returns the size of the file and the approximate size of a part, in bytes."""
        with self._reading():
            size = os.stat(self._file).st_size  # noqa: PTH116 - the name as the user wrote it
            parts = self._parts_of(HEAD_BYTES)
            if not any(part.stats.frames + part.stats.strings for part in parts):
                raise no_frame([self._file], size)
            if self._bid is not None:
                # Reads up to the first sample of the device; raises if there is none.
                any(map(len, self._parts_of(HEAD_BYTES, self._bid)))
            head = next(self._parts_of(HEAD_BYTES))
        seconds = head.duration if head.duration > 0 else max(1, len(head)) / UNSTAMPED_RATE
        return size, max(MIN_PART_BYTES, int(head.stats.bytes / max(seconds, STEP) * STEP))

    def _read(self, block_bytes: int) -> Iterator[Log]:
        with self._reading():
            yield from self._parts_of(block_bytes, self._bid)

    def _parts_of(self, block_bytes: int, bid: int | None = None) -> Iterator[Log]:
        return iter_log(
            self._file,
            block_bytes=block_bytes,
            strings=self._strings,
            legacy=self._legacy,
            bid=bid,
        )

    @contextmanager
    def _reading(self) -> Iterator[None]:
        try:
            yield
        except MissingDeviceError as error:
            raise Failure(f"{label(self._file)}: {error}") from error
        except OSError as error:
            raise cannot(f"read {label(self._file)}", error) from error
