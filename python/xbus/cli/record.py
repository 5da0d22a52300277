"""``xbus record``: records every byte of a device to a file."""

from __future__ import annotations

import contextlib
import math
import re
import shutil
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from xbus.cli.config import apply_settings, read_settings
from xbus.cli.connection import baudrate_option, connect_device
from xbus.cli.failure import Failure, cannot, stop_requested
from xbus.cli.inputs import label
from xbus.errors import StateError, XbusError
from xbus.formatting import describe_losses, format_count, format_size

if TYPE_CHECKING:
    from xbus.device import Device
    from xbus.device.recording import Recording
    from xbus.device.stats import LiveStats

__all__ = ["record"]

#: Interval to check a recording, which runs in the background, in seconds.
CHECK_INTERVAL = 0.2
#: Silence to report, in seconds; the lowest rate is 1 Hz.
MAX_SILENCE = 5.0
#: Units of --rotate.
BYTES = {"kb": 1_000, "mb": 1_000_000, "gb": 1_000_000_000}
SECONDS = {"s": 1, "min": 60, "h": 3600}


def _rotation(
    ctx: click.Context,  # noqa: ARG001 - click's signature
    param: click.Parameter,  # noqa: ARG001
    value: str | None,
) -> dict[str, Any]:
    """Returns the arguments of `Device.record` that rotate files."""
    if value is None:
        return {}
    if found := re.fullmatch(r"([0-9]+(?:\.[0-9]+)?) *([a-z]+)", value.lower()):
        number, unit = float(found[1]), found[2]
        if unit in BYTES and number > 0:
            return {"rotate_bytes": math.ceil(number * BYTES[unit])}
        if unit in SECONDS and number > 0:
            return {"rotate_seconds": number * SECONDS[unit]}
    raise click.BadParameter(
        f"{value!r} is neither a size (100MB, 2GB) nor a time (90s, 30min, 1h)"
    )


def _outputs(
    ctx: click.Context,  # noqa: ARG001 - click's signature
    param: click.Parameter,  # noqa: ARG001
    values: Sequence[str],
) -> dict[Any, int | None]:
    """Returns rates by quantity, as in `Device.configure`."""
    outputs: dict[Any, int | None] = {}
    for value in values:
        key, equals, rate = value.partition("=")
        if equals and not (rate.isascii() and rate.isdecimal()):
            raise click.BadParameter(f"{value!r}: a rate is a whole number of Hz")
        name, *more = key.split(":")
        outputs[(name, *more) if more else name] = int(rate) if equals else None
    if outputs:
        from xbus.device.output_configuration import parse_output_configuration

        try:
            parse_output_configuration(outputs)
        except (KeyError, ValueError) as error:
            raise click.BadParameter(f"{error.args[0]}") from None
    return outputs


@click.command(epilog="Example: xbus record /dev/ttyUSB0 -o walk.mtb --duration 60")
@click.argument("port")
@click.option(
    "-o",
    "out",
    type=click.Path(),
    metavar="FILE",
    required=True,
    help="File to write.",
)
@click.option("--overwrite", is_flag=True, help="Replace an existing FILE.")
@click.option(
    "--duration",
    type=click.FloatRange(min=0, min_open=True),
    metavar="S",
    help="Stop after S seconds.",
)
@click.option(
    "--rotate",
    callback=_rotation,
    metavar="SIZE|TIME",
    help="Start a new file after this size or time: 100MB, 2GB, 30min, 1h. walk.mtb is followed by "
    "walk-0001.mtb.",
)
@click.option(
    "--output",
    "outputs",
    callback=_outputs,
    multiple=True,
    metavar="QUANTITY[=RATE]",
    help="Set the output configuration first: acceleration=100, quaternion:NED=50; repeatable. "
    "Default rate: the highest.",
)
@click.option(
    "--config",
    "config",
    type=click.Path(),
    metavar="FILE",
    help="Apply this settings file first, like xbus config apply.",
)
@baudrate_option
@click.option(
    "--fsync",
    is_flag=True,
    help="Force data to the disk twice per second, in case of a power cut.",
)
@click.option(
    "--reconnect",
    is_flag=True,
    help="Wait for an unplugged device and continue in the same file.",
)
@click.option(
    "--no-times", is_flag=True, help="Do not write FILE.times, the arrival times of the bytes."
)
def record(
    port: str,
    out: str,
    overwrite: bool,
    duration: float | None,
    rotate: dict[str, Any],
    outputs: dict[Any, int | None],
    config: str | None,
    baudrate: int | None,
    fsync: bool,
    reconnect: bool,
    no_times: bool,
) -> None:
    """Records every byte that a device sends.

    Stops on Ctrl-C, SIGTERM or after --duration. The file starts with the device's Configuration, as MT
    Manager's recordings do; the device stops measuring for a moment while it is read. Data is written twice
    per second, and an interrupted recording can be read.

    PORT is a serial port, a pyserial URL (socket://HOST:PORT), or sim:PRODUCT for a virtual device, which
    runs faster than real time.
    """
    from xbus.protocol import State

    settings = None if config is None else read_settings(config)
    path = Path(out)
    if not overwrite and path.is_file() and path.stat().st_size:
        raise Failure(f"{label(out)} exists; choose another name, or add --overwrite")
    if path.is_fifo():
        raise Failure(f"{label(out)} is a pipe; a recording needs a file")
    with stop_requested() as is_stopping, connect_device(port, baudrate) as device:
        initial_state = device.state
        if config is not None and settings is not None:
            apply_settings(device, settings, config)
        with _configured(device, outputs):
            try:
                recording = device.record(
                    out, fsync=fsync, times=not no_times, overwrite=overwrite, **rotate
                )
            except OSError as error:
                raise cannot(f"write {label(error.filename or out)}", error) from error
            before = (
                device.stats
            )  # no samples arrive in Config State; these counts are not part of the recording
        try:
            if device.state != State.MEASUREMENT:
                device.go_to_measurement()
            with _RecordingDisplay(device, recording, before) as display:
                if device.link.trouble is not None:
                    display.print_note(device.link.trouble)
                _wait(display, is_stopping, duration or math.inf, reconnect=reconnect)
        finally:
            if initial_state == State.CONFIG:
                with contextlib.suppress(XbusError):
                    device.go_to_config()


@contextlib.contextmanager
def _configured(device: Device, outputs: dict[Any, int | None]) -> Iterator[None]:
    """Enters Config State and sets the output configuration."""
    with device.configure():
        try:
            if outputs:
                device.set_output_configuration(outputs)
        except StateError:
            raise
        except ValueError as error:  # not possible with this product or baud rate
            raise Failure(f"{error}; nothing was recorded") from None
        yield


def _wait(
    display: _RecordingDisplay, is_stopping: Callable[[], bool], duration: float, *, reconnect: bool
) -> None:
    """Checks the recording regularly until it must stop.

    Raises:
        Failure: The recording ended early, or the device sends nothing.
    """
    from xbus.protocol import State

    device, link, recording = display.device, display.device.link, display.recording
    received_at, size, is_silent = link.clock(), 0, False
    while not is_stopping() and (left := duration - display.elapsed) > 0:
        link.pause(min(CHECK_INTERVAL, left))
        device.discard()  # what is recorded in the background
        if (reason := link.acquisition.ended) is not None:
            if not reconnect or not recording.is_active:
                raise display.failure(f"{link.name}: {reason}")
            display.print_note(f"{link.name}: {reason}; waiting for the port")
            while not (is_stopping() or device.try_reconnect() or display.elapsed >= duration):
                display.update()
            received_at = link.clock()
            if device.state != State.UNKNOWN:
                display.print_note(f"{link.name} is back")
        stats = display.update()
        if recording.error is not None:
            raise display.failure(recording.error)
        if stats.bytes > size:
            received_at, size, is_silent = link.clock(), stats.bytes, False
        elif link.clock() - received_at >= MAX_SILENCE and not is_silent:
            is_silent = True
            if _received(stats) == _received(display.before):
                raise Failure(
                    f"{link.name} sends nothing: it waits for a trigger, or has no outputs; xbus config dump"
                    f" {link.name} shows the output configuration"
                )
            display.print_note(f"no data for {MAX_SILENCE:g} s; the recording continues")


class _RecordingDisplay:
    """Shows a recording, as one line that is updated on a terminal, and stops it at the end."""

    def __init__(self, device: Device, recording: Recording, before: LiveStats) -> None:
        self.device, self.recording, self.before = device, recording, before
        self._began = device.link.clock()
        self._terminal = sys.stderr is not None and sys.stderr.isatty()
        self._rate, self._measured = 0.0, (self._began, _received(before))

    def __enter__(self) -> _RecordingDisplay:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if self._terminal:
            self._line("")
        try:
            self.recording.stop()
        except OSError as error:
            if kind is None:
                raise self.failure(str(self.recording.error)) from error
        if kind is None:
            click.echo(self.summary(), err=True)

    def failure(self, reason: str) -> Failure:
        """Returns the failure that ended the recording, with a summary of what was written."""
        with contextlib.suppress(OSError):
            self.recording.stop()
        return Failure(f"{reason}; {self.summary()}")

    @property
    def elapsed(self) -> float:
        """Seconds since the start, on the clock of the link."""
        return self.device.link.clock() - self._began

    def print_note(self, text: str) -> None:
        """Prints a line above the status line."""
        if self._terminal:
            self._line("")
        click.echo(f"xbus: {text}", err=True)

    def update(self) -> LiveStats:
        """Updates the status line and returns the totals."""
        stats, now = self.device.stats, self.device.link.clock()
        then, received = self._measured
        if now - then >= 1:
            self._rate = (_received(stats) - received) / (now - then)
            self._measured = now, _received(stats)
        if self._terminal:
            minutes, seconds = divmod(int(self.elapsed), 60)
            things = "samples" if stats.samples > self.before.samples else "strings"
            self._line(
                f"{minutes // 60}:{minutes % 60:02}:{seconds:02}"
                f"  {format_size(self.recording.bytes)}  {self._rate:,.0f} {things}/s"
                f"  {self._lost(stats)}  {format_size(self.recording.queued_bytes)} queued"
            )
        return stats

    def summary(self) -> str:
        """Returns a line about the recording: files, duration, counts and losses."""
        stats, files = self.device.stats, self.recording.files
        names = label(files[0]) + (f" to {label(files[-1])}" if len(files) > 1 else "")
        # The totals of the device continue after the recording has ended.
        messages = stats.messages - self.before.messages
        samples = format_count(self.recording.frames - messages, "sample")
        if strings := sum(stats.strings.values()) - sum(self.before.strings.values()):
            samples += f", {format_count(strings, 'string')}"
        written = format_size(self.recording.bytes)
        return f"{names}: {self.elapsed:,.1f} s, {samples}, {written}; {self._lost(stats)}"

    def _lost(self, stats: LiveStats) -> str:
        """Returns losses and damage."""
        before = self.before
        parts = []
        lost, gaps = stats.lost_samples - before.lost_samples, stats.gaps - before.gaps
        if lost:
            parts.append(describe_losses(lost, gaps, has_counter=True))
        if skipped := stats.skipped_bytes - before.skipped_bytes:
            parts.append(f"{format_count(skipped, 'byte')} damaged")
        if overruns := (stats.overruns or 0) - (before.overruns or 0):
            parts.append(f"{format_count(overruns, 'overrun')} in the driver")
        if errors := stats.errors - before.errors:
            parts.append(
                f"{format_count(errors, 'error')} from the device, the last: {stats.last_error}"
            )
        if parts:
            return ", ".join(parts)
        counters = [totals.quantities.get("packet_counter", 0) for totals in (before, stats)]
        return describe_losses(0, 0, has_counter=counters[0] < counters[1])

    def _line(self, text: str) -> None:
        width = shutil.get_terminal_size().columns - 1
        click.echo(f"\r{text[:width]:<{width}}\r", nl=False, err=True)


def _received(stats: LiveStats) -> int:
    """Returns the number of samples and strings."""
    return stats.samples + sum(stats.strings.values())
