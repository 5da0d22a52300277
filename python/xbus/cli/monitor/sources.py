"""Where a stream comes from: a device, or a recording that is replayed at its own pace."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, fields
from datetime import datetime
from itertools import count as numbers
from itertools import takewhile
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from xbus.cli.failure import cannot
from xbus.cli.inputs import label, no_frame
from xbus.cli.monitor.model import Counts, Model, Recorded
from xbus.describe.text import describe_message
from xbus.errors import Disconnected, StateError, XbusError, XbusTimeout
from xbus.log.log import Log, steady_time
from xbus.log.read import iter_log
from xbus.protocol.values import State
from xbus.wire.message import Message

if TYPE_CHECKING:
    from xbus.device import Device
    from xbus.device.recording import Recording
    from xbus.device.session import Notice

__all__ = ["Live", "Replay"]

#: Seconds of a stream that are taken in at a time.
STEP = 0.1
#: Messages that are told as events.
TOLD = ("Error", "Warning", "WakeUp")
#: Bytes of a recording that tell how many a step has, and how many it has at least.
LOOKED_AT, LEAST = 1 << 18, 64
#: Samples a second of a recording without time stamps, and the longest pause of one with them.
RATE, LONGEST_PAUSE = 100, 10.0


class Live:
    """A device: only listened to, unless the user asks for more, or it is back and silent.

    Args:
        device: As it was found; the state is restored by `leave`.
        waits: Whether to wait for the port when it is gone; else `Disconnected` is raised.
    """

    def __init__(self, device: Device, *, waits: bool) -> None:
        self._device = device
        self._waits = waits
        self._found = device.state
        # What a block is made of has been waited for when it is asked for.
        self._blocks = device.blocks(seconds=STEP, timeout=STEP / 100)
        self._before = _counted(device)
        self._notice: Notice | None = None
        self._lost_at: float | None = None
        self._recording: Recording | None = None
        self._began = (time.monotonic(), device.link.clock())
        #: The recordings that have ended.
        self.recorded: list[Recorded] = []

    def model(self) -> Model:
        """What is known in the beginning."""
        link = self._device.link
        now = link.clock()
        baudrate = link.baudrate if link.is_line else None
        model = Model(link.name, baudrate=baudrate, now=now, begin=now)
        self._tell(model)
        return model

    def wait(self) -> float:
        """Seconds until there is something to take in: none, but for a virtual device, whose time flies."""
        began, clock = self._began
        return began + (self._device.link.clock() - clock) - time.monotonic()

    def advance(self, model: Model) -> None:
        """Takes in what comes in a tenth of a second."""
        device = self._device
        try:
            if self._lost_at is not None:
                device.find((device.link.baudrate,))
                away = device.link.clock() - self._lost_at
                self._lost_at = None
                model.happened(f"the port is there again, after {away:.0f} s", is_bad=False)
            model.take(next(self._blocks), device.link.clock())
        except (StateError, XbusTimeout):
            pass  # in Config State, or silent
        except Disconnected:
            if not self._waits:
                raise
            if self._lost_at is None:
                self._lost_at = device.link.clock()
                model.happened("the port is gone; is it plugged in?")
            device.link.pause(STEP)
        self._tell(model)

    def measure(self, model: Model) -> None:
        """Lets a device in Config State measure."""
        if self._device.state != State.CONFIG:
            model.happened("the device is not in Config State", is_bad=False)
            return
        try:
            self._device.go_to_measurement()
        except XbusError as error:
            model.happened(str(error))
        self._tell(model)

    def record(self, model: Model) -> None:
        """Begins a recording, or ends the one that is under way."""
        if self._recording is not None:
            self._stop(model)
            return
        path = None
        try:
            path = _new_file()
            self._recording = self._device.record(path)
        except XbusError as error:
            self._not_recorded(model, path, str(error))
        except OSError as error:
            self._not_recorded(model, path, str(cannot(f"write {error.filename or path}", error)))
        else:
            model.happened(f"recording to {path}", is_bad=False)
        self._tell(model)

    @staticmethod
    def _not_recorded(model: Model, path: Path | None, why: str) -> None:
        model.happened(f"no recording: {why}")
        if path is not None:
            path.unlink(missing_ok=True)

    def _stop(self, model: Model) -> None:
        recording = self._recording
        if recording is None:
            return
        self._recording = None
        with suppress(OSError):
            recording.stop()  # why it ended by itself is told below
        files = ", ".join(map(label, recording.files))
        self.recorded.append(Recorded(files, recording.bytes, recording.error))
        model.happened(str(self.recorded[-1]), is_bad=recording.error is not None)
        model.recorded = None

    def leave(self, model: Model) -> None:
        """Ends the recording, and leaves the device in the state in which it was found."""
        self._stop(model)
        if self._found == State.CONFIG and self._device.state == State.MEASUREMENT:
            with suppress(XbusError):
                self._device.go_to_config()

    def _tell(self, model: Model) -> None:
        """What the device says of itself, and what was counted."""
        device = self._device
        model.now = device.link.clock()
        model.state = device.state
        model.is_lost = self._lost_at is not None
        model.name = device.link.name
        model.device = device.product_code and device.product_code.strip()
        self._count(model)
        # The latest come last, and of a hundred the oldest have gone.
        fresh = list(takewhile(lambda it: it is not self._notice, reversed(device.notices)))
        self._notice = fresh[0] if fresh else self._notice
        for it in reversed(fresh):
            if it.mid is None:
                model.happened(str(it.value))
            elif it.name in TOLD:
                message = Message(it.mid, it.name, it.bid, it.payload, 0, 0)
                model.happened(_words(message), is_bad=it.name != "WakeUp")
        if self._recording is not None:
            if not self._recording.is_active:
                self._stop(model)
            else:
                model.recorded = Recorded(self._recording.files[-1], self._recording.bytes)

    def _count(self, model: Model) -> None:
        now = _counted(self._device)
        counts = {key: it - self._before[key] for key, it in now.items()}
        model.counts = Counts(**counts | {it: now[it] for it in WAITING})


#: What does not grow.
WAITING = ("queued_bytes", "unread_samples")


def _counted(device: Device) -> dict[str, int]:
    stats = device.stats
    return {it.name: getattr(stats, it.name) or 0 for it in fields(Counts)}


def _new_file() -> Path:
    """An empty file named by date and time, which was not there."""
    stem = datetime.now().strftime("xbus-%Y%m%d-%H%M%S")
    for number in numbers(1):
        path = Path(stem + (".mtb" if number == 1 else f"-{number}.mtb"))
        try:
            path.touch(exist_ok=False)
        except FileExistsError:
            continue
        return path
    raise AssertionError


def _words(message: Message) -> str:
    """An event of a device."""
    if message.name == "WakeUp":
        return "WakeUp: the device has just started"
    return f"{message.name} {describe_message(message)}"


class Replay:
    """A recording, at the pace of its time stamps.

    Samples of the GNSS receiver and of a second device have times of their own and set no pace. A pause of
    more than 10 s lasts 10 s, and a step back of the clock no time; without any stamp 100 samples come a
    second.

    Args:
        file: Path of the recording.
        speed: How many times as fast as it was recorded.
        strings: As in `read_log`.

    Attributes:
        is_over: Whether all of it was taken in.

    Raises:
        Failure: The file cannot be read, or holds no frame.
    """

    def __init__(self, file: str, speed: float = 1.0, strings: Sequence[str] = ()) -> None:
        self._file, self._speed, self._strings = file, speed, strings
        self._size, step = self._looked_at()
        self._parts = self._read(step)
        self._stamp = math.nan
        self._device: int | None = None
        #: Seconds of the recording until the end of the part that is taken in next.
        self._due = 0.0
        self._began = time.monotonic()
        self._paused_at: float | None = None
        self._next()

    @property
    def is_over(self) -> bool:
        """Whether all of it was taken in."""
        return self._part is None

    def model(self) -> Model:
        """What is known in the beginning."""
        return Model(self._file, read=0.0)

    def wait(self) -> float:
        """Seconds until there is something to take in."""
        if self.is_over or self._paused_at is not None:
            return math.inf
        return self._began + self._due / self._speed - time.monotonic()

    def pause(self) -> None:
        """Stands still, or goes on."""
        now = time.monotonic()
        if self._paused_at is None:
            self._paused_at = now
        else:
            self._began += now - self._paused_at
            self._paused_at = None

    def advance(self, model: Model) -> None:
        """Takes in the next part."""
        if (part := self._part) is None:
            return
        model.take(part, self._due)
        counted, counts = asdict(part.stats), asdict(model.counts)
        model.counts = Counts(**{key: it + counted.get(key, 0) for key, it in counts.items()})
        model.read = min(1.0, model.counts.bytes / self._size)
        model.device = part.product_code
        for message in part.messages.named(*TOLD):
            model.counts.errors += message.name == "Error"
            model.counts.warnings += message.name == "Warning"
            model.happened(_words(message), is_bad=message.name != "WakeUp")
        self._next()
        if self.is_over:
            model.read = 1.0

    def _next(self) -> None:
        self._part = next(self._parts, None)
        if self._part is not None:
            self._due += self._lasts(self._part)

    def _lasts(self, part: Log) -> float:
        """Seconds from the end of the part before to that of this one."""
        if self._device is None and len(part):
            self._device = int(part.bid[0])
        # Devices on one bus have clocks of their own.
        stamps = steady_time(part)[part.bid == self._device]
        stamps = stamps[np.isfinite(stamps)]
        if not len(stamps):
            return len(part) / RATE if math.isnan(self._stamp) else 0.0
        before = stamps[0] if math.isnan(self._stamp) else self._stamp
        self._stamp = float(stamps[-1])
        return float(np.diff(stamps, prepend=before).clip(0.0, LONGEST_PAUSE).sum())

    def _looked_at(self) -> tuple[int, int]:
        """How many bytes the file has, and in how many a step of it is, about."""
        with self._reading():
            size = os.stat(self._file).st_size  # noqa: PTH116 - the name as it was given
            parts = iter_log(self._file, block_bytes=LOOKED_AT, strings=self._strings)
            if not any(it.stats.frames + it.stats.strings for it in parts):
                raise no_frame([self._file], size)
            head = next(iter_log(self._file, block_bytes=LOOKED_AT))
        seconds = head.duration if head.duration > 0 else max(1, len(head)) / RATE
        return size, max(LEAST, int(head.stats.bytes / max(seconds, STEP) * STEP))

    def _read(self, step: int) -> Iterator[Log]:
        with self._reading():
            yield from iter_log(self._file, block_bytes=step, strings=self._strings)

    @contextmanager
    def _reading(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise cannot(f"read {label(self._file)}", error) from error
