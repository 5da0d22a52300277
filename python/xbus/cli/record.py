"""``xbus record``: every byte of a device into a file."""

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

from xbus.cli.config import applied, read_file
from xbus.cli.connection import baudrate_option, connect_device
from xbus.cli.failure import Failure, cannot, stop_requested
from xbus.cli.inputs import label
from xbus.describe.formatting import describe_losses, format_count, format_size
from xbus.errors import StateError, XbusError

if TYPE_CHECKING:
    from xbus.device import Device
    from xbus.device.recording import Recording
    from xbus.device.stats import LiveStats

__all__ = ["record"]

#: Seconds between two looks at a recording, which goes on by itself.
LOOK = 0.2
#: Silence that is told, in seconds: the slowest rate is 1 Hz.
SILENCE = 5.0
#: What --rotate counts, by its unit.
BYTES = {"kb": 1_000, "mb": 1_000_000, "gb": 1_000_000_000}
SECONDS = {"s": 1, "min": 60, "h": 3600}


def _rotation(
    ctx: click.Context,  # noqa: ARG001 - click's signature
    param: click.Parameter,  # noqa: ARG001
    value: str | None,
) -> dict[str, Any]:
    """When another file begins, as `Device.record` takes it."""
    if value is None:
        return {}
    if found := re.fullmatch(r"([0-9]+(?:\.[0-9]+)?) *([a-z]+)", value.lower()):
        number, unit = float(found[1]), found[2]
        if unit in BYTES and number > 0:
            return {"rotate_bytes": math.ceil(number * BYTES[unit])}
        if unit in SECONDS and number > 0:
            return {"rotate_seconds": number * SECONDS[unit]}
    raise click.BadParameter(f"{value!r} is no size (100MB, 2GB) and no time (90s, 30min, 1h)")


def _outputs(
    ctx: click.Context,  # noqa: ARG001 - click's signature
    param: click.Parameter,  # noqa: ARG001
    values: Sequence[str],
) -> dict[Any, int | None]:
    """Rates by quantity, as `Device.configure` takes them."""
    outputs: dict[Any, int | None] = {}
    for it in values:
        words, equals, rate = it.partition("=")
        if equals and not (rate.isascii() and rate.isdecimal()):
            raise click.BadParameter(f"{it!r}: a rate is a whole number of Hz")
        name, *more = words.split(":")
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
    help="What to write.",
)
@click.option("--overwrite", is_flag=True, help="Replace FILE if it is there.")
@click.option(
    "--duration", type=click.FloatRange(min=0, min_open=True), metavar="S", help="How many seconds."
)
@click.option(
    "--rotate",
    callback=_rotation,
    metavar="SIZE|TIME",
    help="Begin another file after so much: 100MB, 2GB, 30min, 1h. FILE walk.mtb is followed by "
    "walk-0001.mtb.",
)
@click.option(
    "--output",
    "outputs",
    callback=_outputs,
    multiple=True,
    metavar="QUANTITY[=RATE]",
    help="Set the output configuration first: acceleration=100, quaternion:NED=50; repeatable. "
    "Without a rate, the highest.",
)
@click.option(
    "--config",
    "config",
    type=click.Path(),
    metavar="FILE",
    help="Apply these settings first, as xbus config apply does.",
)
@baudrate_option
@click.option(
    "--fsync", is_flag=True, help="Twice a second, make sure that a power cut loses nothing."
)
@click.option(
    "--reconnect",
    is_flag=True,
    help="Wait for a device that is unplugged, and go on in the same file.",
)
@click.option("--no-times", is_flag=True, help="Do not write FILE.times, when the bytes came.")
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

    Until Ctrl-C, SIGTERM or --duration. The file begins like those of MT Manager with what the
    device is and how it is set, for which the device stops measuring for a moment. It is written twice a
    second, and whatever happens, what was written can be read.

    PORT is a serial port, a URL of pyserial (socket://HOST:PORT) or sim:PRODUCT, a virtual device, whose
    time flies.
    """
    from xbus.protocol import State

    settings = None if config is None else read_file(config)
    there = Path(out)
    if not overwrite and there.is_file() and there.stat().st_size:
        raise Failure(f"{label(out)} is there; name another file, or add --overwrite")
    if there.is_fifo():
        raise Failure(f"{label(out)} is a pipe, and a recording goes to a file; name one")
    with stop_requested() as is_stopped, connect_device(port, baudrate) as device:
        found = device.state
        if config is not None and settings is not None:
            applied(device, settings, config)
        with _configured(device, outputs):
            try:
                recording = device.record(
                    out, fsync=fsync, times=not no_times, overwrite=overwrite, **rotate
                )
            except OSError as error:
                raise cannot(f"write {label(error.filename or out)}", error) from error
            before = device.stats  # nothing comes in this state: it is what is not in the file
        try:
            if device.state != State.MEASUREMENT:
                device.go_to_measurement()
            with _Shown(device, recording, before) as shown:
                if device.link.trouble is not None:
                    shown.say(device.link.trouble)
                _wait(shown, is_stopped, duration or math.inf, reconnect=reconnect)
        finally:
            if found == State.CONFIG:
                with contextlib.suppress(XbusError):
                    device.go_to_config()


@contextlib.contextmanager
def _configured(device: Device, outputs: dict[Any, int | None]) -> Iterator[None]:
    """Config State, with these outputs set."""
    with device.configure():
        try:
            if outputs:
                device.set_output_configuration(outputs)
        except StateError:
            raise
        except ValueError as error:  # it is the product, or the line, that cannot do it
            raise Failure(f"{error}; nothing was recorded") from None
        yield


def _wait(
    shown: _Shown, is_stopped: Callable[[], bool], duration: float, *, reconnect: bool
) -> None:
    """Looks at the recording now and then until it is to end.

    Raises:
        Failure: It ended by itself, or there is nothing to record.
    """
    from xbus.protocol import State

    device, link, recording = shown.device, shown.device.link, shown.recording
    heard_at, size, is_silent = link.clock(), 0, False
    while not is_stopped() and (left := duration - shown.elapsed) > 0:
        link.pause(min(LOOK, left))
        try:
            link.read(0)  # nobody wants them: they are counted, and on their way to the disk
        except OSError as error:
            if not reconnect or not recording.is_active:
                raise shown.ended(f"{link.name}: {error}") from error
            shown.say(f"{link.name}: {error}; waiting for it")
            while not (is_stopped() or device.try_reconnect() or shown.elapsed >= duration):
                shown.update()
            heard_at = link.clock()
            if device.state != State.UNKNOWN:
                shown.say(f"{link.name} is there again")
        stats = shown.update()
        if recording.error is not None:
            raise shown.ended(recording.error)
        if stats.bytes > size:
            heard_at, size, is_silent = link.clock(), stats.bytes, False
        elif link.clock() - heard_at >= SILENCE and not is_silent:
            is_silent = True
            if _heard(stats) == _heard(shown.before):
                raise Failure(
                    f"nothing comes from {link.name}: has it outputs (xbus send {link.name} --config"
                    " ReqOutputConfiguration), or does it wait for a trigger?"
                )
            shown.say(f"nothing has come for {SILENCE:g} s; the recording goes on")


class _Shown:
    """Stops a recording in the end, and shows how it goes: one line that changes on a terminal."""

    def __init__(self, device: Device, recording: Recording, before: LiveStats) -> None:
        self.device, self.recording, self.before = device, recording, before
        self._began = device.link.clock()
        self._terminal = sys.stderr is not None and sys.stderr.isatty()
        self._rate, self._rated = 0.0, (self._began, _heard(before))

    def __enter__(self) -> _Shown:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if self._terminal:
            self._line("")
        try:
            self.recording.stop()
        except OSError as error:
            if kind is None:
                raise self.ended(str(self.recording.error)) from error
        if kind is None:
            click.echo(self.summary(), err=True)

    def ended(self, why: str) -> Failure:
        """The failure that ended it, and what was written until then."""
        with contextlib.suppress(OSError):
            self.recording.stop()
        return Failure(f"{why}; {self.summary()}")

    @property
    def elapsed(self) -> float:
        """Seconds since it began, on the device's side of the link."""
        return self.device.link.clock() - self._began

    def say(self, text: str) -> None:
        """Prints a line that stays."""
        if self._terminal:
            self._line("")
        click.echo(f"xbus: {text}", err=True)

    def update(self) -> LiveStats:
        """Shows how it goes; what was counted."""
        stats, now = self.device.stats, self.device.link.clock()
        then, heard = self._rated
        if now - then >= 1:
            self._rate = (_heard(stats) - heard) / (now - then)
            self._rated = now, _heard(stats)
        if self._terminal:
            minutes, seconds = divmod(int(self.elapsed), 60)
            what = "samples" if stats.samples > self.before.samples else "strings"
            self._line(
                f"{minutes // 60}:{minutes % 60:02}:{seconds:02}"
                f"  {format_size(self.recording.bytes)}  {self._rate:,.0f} {what}/s"
                f"  {self._lost(stats)}  {format_size(self.recording.queued_bytes)} queued"
            )
        return stats

    def summary(self) -> str:
        """What was written, and what was lost."""
        stats, files = self.device.stats, self.recording.files
        names = label(files[0]) + (f" to {label(files[-1])}" if len(files) > 1 else "")
        # The stats go on when the recording has ended.
        others = stats.messages - self.before.messages
        samples = format_count(self.recording.frames - others, "sample")
        if strings := sum(stats.strings.values()) - sum(self.before.strings.values()):
            samples += f", {format_count(strings, 'string')}"
        written = format_size(self.recording.bytes)
        return f"{names}: {self.elapsed:,.1f} s, {samples}, {written}; {self._lost(stats)}"

    def _lost(self, stats: LiveStats) -> str:
        """What is missing or damaged, by all that can tell."""
        before = self.before
        said = []
        lost, gaps = stats.lost_samples - before.lost_samples, stats.gaps - before.gaps
        if lost:
            said.append(describe_losses(lost, gaps, has_counter=True))
        if skipped := stats.skipped_bytes - before.skipped_bytes:
            said.append(f"{format_count(skipped, 'byte')} damaged")
        if overruns := (stats.overruns or 0) - (before.overruns or 0):
            said.append(f"{format_count(overruns, 'overrun')} in the driver")
        if errors := stats.errors - before.errors:
            said.append(
                f"{format_count(errors, 'error')} of the device, the last: {stats.last_error}"
            )
        if said:
            return ", ".join(said)
        counted = [it.quantities.get("packet_counter", 0) for it in (before, stats)]
        return describe_losses(0, 0, has_counter=counted[0] < counted[1])

    def _line(self, text: str) -> None:
        width = shutil.get_terminal_size().columns - 1
        click.echo(f"\r{text[:width]:<{width}}\r", nl=False, err=True)


def _heard(stats: LiveStats) -> int:
    """Samples and strings."""
    return stats.samples + sum(stats.strings.values())
