"""A device, or a recording that is replayed, as input of commands that pass samples on."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Protocol

import click

from xbus.cli.connection import address_of, connect_device, port_lost
from xbus.cli.inputs import check_port_options, is_recording
from xbus.cli.recordings import show_unread_piece
from xbus.errors import Disconnected
from xbus.formatting import describe_losses, format_count
from xbus.watch.model import Model

if TYPE_CHECKING:
    from xbus.cli.monitor.replay_source import ReplaySource
    from xbus.device import Device
    from xbus.log.log import Log
    from xbus.watch.device_source import DeviceSource

__all__ = ["LiveInput", "Sink", "live_input"]

#: Longest wait before the next check for Ctrl-C, in s.
CHECK_INTERVAL = 0.1


class Sink(Protocol):
    """Where samples go."""

    def write(self, block: Log) -> None:
        """Passes on samples."""
        ...

    def note(self, text: str, *, is_bad: bool) -> None:
        """Passes on an event."""
        ...


@dataclass
class _SinkModel(Model):
    """A model of the monitor that passes blocks and events on.

    Attributes:
        sink: Where they go.
        has_counter: Whether there was a packet counter, without which losses are not detected.
    """

    sink: Sink | None = field(default=None, repr=False)
    has_counter: bool = False

    @classmethod
    def of(cls, model: Model, sink: Sink) -> _SinkModel:
        return cls(**{each.name: getattr(model, each.name) for each in fields(model)}, sink=sink)

    def add_block(self, block: Log, now: float) -> None:
        """Passes on samples."""
        self.now = now
        self.has_counter = self.has_counter or "packet_counter" in block
        if self.sink is not None and (len(block) or block.strings):
            self.sink.write(block)

    def add_event(self, text: str, *, is_bad: bool = True) -> None:
        """Passes on an event."""
        if self.sink is not None:
            self.sink.note(text, is_bad=is_bad)


class LiveInput:
    """A device, or a recording that is replayed.

    Args:
        source: The source, as for the monitor.
        device: The device; None for a recording.
    """

    def __init__(self, source: DeviceSource | ReplaySource, device: Device | None) -> None:
        self._source, self.device = source, device
        self._model: Model = source.model()

    @property
    def device_id(self) -> int | None:
        """Identifier of the device, if it is known before the first sample."""
        return None if self.device is None else self.device.device_id

    @property
    def elapsed(self) -> float:
        """Seconds since the start."""
        return self._model.elapsed

    def run(
        self,
        sink: Sink,
        is_stopping: Callable[[], bool],
        *,
        duration: float | None = None,
        progress: Callable[[], None] = lambda: None,
    ) -> None:
        """Passes samples on until the end of the recording, or until the command is stopped.

        Args:
            sink: Where they go.
            is_stopping: Returns whether the command is stopped.
            duration: Seconds after which it ends.
            progress: Called now and then.

        Raises:
            Failure: The port is gone.
        """
        model = self._model = _SinkModel.of(self._model, sink)
        source = self._source
        try:
            while not is_stopping() and not (duration is not None and model.elapsed >= duration):
                progress()
                if getattr(source, "is_over", False):
                    return
                if (wait := source.wait()) > 0:
                    time.sleep(min(wait, CHECK_INTERVAL))
                else:
                    source.advance(model)
        except Disconnected as error:
            cause = error.__cause__
            raise port_lost(model.name, cause if isinstance(cause, OSError) else error) from error

    def losses(self) -> str:
        """Returns what was lost before the samples were passed on."""
        model, counts = self._model, self._model.counts
        has_counter = isinstance(model, _SinkModel) and model.has_counter
        parts = [describe_losses(counts.lost_samples, counts.gaps, has_counter=has_counter)]
        if counts.dropped_samples:
            parts.append(f"{format_count(counts.dropped_samples, 'sample')} dropped unread")
        if counts.skipped_bytes:
            parts.append(f"{format_count(counts.skipped_bytes, 'byte')} damaged")
        return ", ".join(parts)


@contextlib.contextmanager
def live_input(
    name: str,
    *,
    bid: int | None = None,
    baudrate: int | None = None,
    listen: bool = False,
    speed: float | None = None,
) -> Iterator[LiveInput]:
    """Opens a device or a recording.

    Args:
        name: A port, ``sim:PRODUCT``, or a file.
        bid: The only device to read, or None.
        baudrate: Bits per second of a port.
        listen: Whether to send nothing to a port.
        speed: Replay speed of a recording.

    Raises:
        Failure: It cannot be opened.
        UsageError: An option does not apply.
    """
    if is_recording(name):
        check_port_options(name, baudrate=baudrate, listen=listen)
        from xbus.cli.monitor.replay_source import ReplaySource

        show_unread_piece(name)
        yield LiveInput(ReplaySource(name, speed or 1.0, bid=bid), None)
        return
    if speed is not None:
        raise click.UsageError("--speed is for a recording; a device sends at its own rate")
    from xbus.protocol.values import State
    from xbus.watch.device_source import DeviceSource

    with connect_device(name, baudrate, bid=address_of(bid), listen=listen) as device:
        source = DeviceSource(device, reconnect=False)
        if not listen and device.state == State.CONFIG:
            device.go_to_measurement()
        try:
            yield LiveInput(source, device)
        finally:
            # Restores the state in which the device was found.
            source.close(source.model())
