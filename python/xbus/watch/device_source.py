"""A device whose stream is watched."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import fields
from datetime import datetime
from itertools import count, takewhile
from pathlib import Path
from typing import TYPE_CHECKING

from xbus.describe.failures import file_failure
from xbus.describe.names import file_label
from xbus.errors import Disconnected, StateError, XbusError, XbusTimeout
from xbus.files import RECORDING_SUFFIX
from xbus.protocol.ids import MessageId
from xbus.protocol.values import State
from xbus.watch.events import EVENT_MESSAGES, describe_event
from xbus.watch.model import Counts, Model, RecordingState
from xbus.wire.link import line_rate
from xbus.wire.message import Message

if TYPE_CHECKING:
    from xbus.device import Device
    from xbus.device.events import Notice
    from xbus.device.recording import Recording
    from xbus.device.stats import LiveStats

__all__ = ["DeviceSource", "new_file"]

#: Duration of a block of samples, in seconds.
STEP = 0.1
#: Counts of what waits now; the others are totals.
WAITING = ("queued_bytes", "unread_samples")


class DeviceSource:
    """A device.

    The source only listens, unless a command is asked for, or the device is silent after it was lost.

    Args:
        device: The device; `close` restores its present state.
        reconnect: Whether to wait for a lost port instead of raising `Disconnected`.
        restore: Whether to restore the state of a device whose port was lost, which sends commands.
        step: Duration of a block of samples, in seconds.
        clock: Returns the time of the model, in seconds; by default, that of the link.
    """

    def __init__(
        self,
        device: Device,
        *,
        reconnect: bool,
        restore: bool = False,
        step: float = STEP,
        clock: Callable[[], float] | None = None,
    ) -> None:
        self._device = device
        self._clock = clock or device.link.clock
        self._reconnect = reconnect
        # A device that was only listened to has no state to restore; its port is opened again.
        self._restores = restore or device.is_listening
        self._initial_state = device.state
        # The samples of a block have arrived when the loop asks for it, so the timeout is short.
        self._step = step
        self._blocks = device.blocks(seconds=step, timeout=step / 100)
        #: The counts of the stream at the last block.
        self.stats = device.stats
        self._initial_counts = _counts(self.stats)
        self._starts = _starts(self.stats)
        self._last_notice: Notice | None = None
        self._lost_at: float | None = None
        self._recording: Recording | None = None
        self._began = (time.monotonic(), device.link.clock())
        #: The finished recordings.
        self.recordings: list[RecordingState] = []

    def model(self) -> Model:
        """Returns the model before the first block."""
        link = self._device.link
        now = self._clock()
        model = Model(link.name, baudrate=line_rate(link), now=now, begin=now)
        self._update(model)
        return model

    def wait(self) -> float:
        """Returns the seconds until the next block.

        A real device needs no wait. The clock of a simulated device runs ahead.
        """
        began, clock = self._began
        return began + (self._device.link.clock() - clock) - time.monotonic()

    def advance(self, model: Model) -> None:
        """Waits for the next block and adds it to the model."""
        device = self._device
        try:
            if self._lost_at is not None and not self._is_back(model):
                self._update(model)
                return
            model.add_block(next(self._blocks), self._clock())
        except (StateError, XbusTimeout):
            pass  # in Config State, or silent
        except Disconnected:
            if not self._reconnect:
                raise
            if self._lost_at is None:
                self._lost_at = device.link.clock()
                model.add_event("the port is gone; check the cable")
            device.link.pause(self._step)
        self._update(model)

    def _is_back(self, model: Model) -> bool:
        """Tries to reach a device whose port was lost, and returns whether it is back."""
        device = self._device
        if not self._restores:
            device.find_baudrate((device.link.baudrate,))
        elif not device.try_reconnect():
            return False
        away = device.link.clock() - (self._lost_at or 0.0)
        self._lost_at = None
        model.add_event(f"the port is back after {away:.0f} s", is_bad=False)
        return True

    def clear_counts(self, model: Model) -> None:
        """Counts from now on: losses, damage, and samples that are out of range."""
        self._initial_counts = _counts(self._device.stats)
        model.clipped = {}
        self._update_counts(model)

    def start_measurement(self, model: Model) -> None:
        """Makes a device in Config State measure."""
        if self._device.is_listening:
            model.add_event("no command is sent: --listen only listens")
            return
        if self._device.state != State.CONFIG:
            model.add_event("the device is not in Config State", is_bad=False)
            return
        try:
            self._device.go_to_measurement()
        except XbusError as error:
            model.add_event(str(error))
        self._update(model)

    def toggle_recording(self, model: Model) -> None:
        """Starts a recording, or stops the current one."""
        if self._recording is not None:
            self._stop_recording(model)
            return
        path = None
        try:
            path = _new_file()
            self._recording = self._device.record(path)
        except XbusError as error:
            self._recording_failed(model, path, str(error))
        except OSError as error:
            failure = file_failure(f"write {error.filename or path}", error)
            self._recording_failed(model, path, failure)
        else:
            model.add_event(f"recording to {path}", is_bad=False)
        self._update(model)

    @staticmethod
    def _recording_failed(model: Model, path: Path | None, reason: str) -> None:
        model.add_event(f"no recording: {reason}")
        if path is not None:
            path.unlink(missing_ok=True)

    def _stop_recording(self, model: Model) -> None:
        recording = self._recording
        if recording is None:
            return
        self._recording = None
        with suppress(OSError):
            recording.stop()  # the state below has the reason for an early end
        files = ", ".join(map(file_label, recording.files))
        self.recordings.append(RecordingState(files, recording.bytes, recording.error))
        model.add_event(str(self.recordings[-1]), is_bad=recording.error is not None)
        model.recording = None

    def close(self, model: Model) -> None:
        """Stops the recording and restores the initial state of the device."""
        self._stop_recording(model)
        if self._initial_state == State.CONFIG and self._device.state == State.MEASUREMENT:
            with suppress(XbusError):
                self._device.go_to_config()

    def _update(self, model: Model) -> None:
        """Copies the state of the device, its totals and its new notices to the model."""
        device = self._device
        model.now = self._clock()
        model.state = device.state
        model.is_lost = self._lost_at is not None
        model.name = device.link.name
        model.is_listening = device.is_listening
        model.device = device.product_code and device.product_code.strip()
        self._update_counts(model)
        self._add_notices(model)
        if self._recording is not None:
            if not self._recording.is_active:
                self._stop_recording(model)
            else:
                model.recording = RecordingState(self._recording.files[-1], self._recording.bytes)

    def _update_counts(self, model: Model) -> None:
        stats = self.stats = self._device.stats
        now = _counts(stats)
        totals = {name: n - self._initial_counts[name] for name, n in now.items()}
        model.counts = Counts(**totals | {name: now[name] for name in WAITING})
        model.add_undecoded(stats.message_counts)
        if (starts := _starts(stats)) != self._starts:
            # The pause before would make rates low, also one that was too short to be seen.
            self._starts = starts
            model.restart_rates()

    def _add_notices(self, model: Model) -> None:
        # The device keeps a limited number of notices, the latest last: the last one seen may be gone.
        notices = reversed(self._device.notices)
        new = list(takewhile(lambda notice: notice is not self._last_notice, notices))
        self._last_notice = new[0] if new else self._last_notice
        for notice in reversed(new):
            if notice.name == "Reconnected":
                continue  # an event already
            if notice.mid is None:
                model.add_event(str(notice.value))
            elif notice.name in EVENT_MESSAGES:
                message = Message(notice.mid, notice.name, notice.bid, notice.payload, 0, 0)
                model.add_event(describe_event(message), is_bad=notice.name != "WakeUp")


def _starts(stats: LiveStats) -> int:
    """Returns how often the device has begun to measure."""
    return stats.message_counts.get(MessageId.GoToMeasurementAck, 0)


def _counts(stats: LiveStats) -> dict[str, int]:
    return {field.name: getattr(stats, field.name) or 0 for field in fields(Counts)}


def _new_file() -> Path:
    """Creates an empty file named by date and time, and returns its path."""
    return new_file(Path(), datetime.now().strftime("xbus-%Y%m%d-%H%M%S"))


def new_file(folder: Path, stem: str) -> Path:
    """Creates an empty file for a recording, whose name no file has, and returns its path.

    Args:
        folder: The folder, which exists.
        stem: The name without the suffix; ``-2``, ``-3`` and so on follow if that file exists.

    Raises:
        OSError: It cannot be created.
    """
    for number in count(1):
        path = folder / ((stem if number == 1 else f"{stem}-{number}") + RECORDING_SUFFIX)
        with suppress(FileExistsError):
            path.touch(exist_ok=False)
            return path
    raise AssertionError
