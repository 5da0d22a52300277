"""``xbus record``: records every byte of a device to a file."""

from __future__ import annotations

import contextlib
import shutil
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from xbus.cli.config import apply_settings, read_settings
from xbus.cli.connection import baudrate_option, connect_device, listen_option
from xbus.cli.corrections import caster_options, check_receiver, new_corrections
from xbus.cli.failure import Failure, cannot, stop_requested
from xbus.cli.inputs import label
from xbus.cli.number_type import NumberRange
from xbus.cli.recording_job import RecordingJob
from xbus.cli.rotation import rotation_limits
from xbus.errors import Disconnected, StateError, XbusError
from xbus.formatting import format_size

if TYPE_CHECKING:
    from xbus.device import Device

__all__ = ["record"]

#: Interval to check a recording, which runs in the background, in seconds.
CHECK_INTERVAL = 0.2


def _rotation(
    ctx: click.Context,  # noqa: ARG001 - click's signature
    param: click.Parameter,  # noqa: ARG001
    value: str | None,
) -> dict[str, Any]:
    """Returns the arguments of `Device.record` that rotate files."""
    return {} if value is None else rotation_limits(value)


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
    type=NumberRange(min=0, min_open=True),
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
@listen_option
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
@click.option(
    "--monitor",
    "with_monitor",
    is_flag=True,
    help="Show the screen of xbus monitor during the recording; q stops it.",
)
@caster_options(required=False)
def record(
    port: str,
    out: str,
    overwrite: bool,
    duration: float | None,
    rotate: dict[str, Any],
    outputs: dict[Any, int | None],
    config: str | None,
    baudrate: int | None,
    listen: bool,
    fsync: bool,
    reconnect: bool,
    no_times: bool,
    with_monitor: bool,
    **caster: Any,
) -> None:
    """Records every byte that a device sends.

    Stops on Ctrl-C, SIGTERM or after --duration. The file starts with the device's Configuration, as MT
    Manager's recordings do; the device stops measuring for a moment while it is read. Data is written twice
    per second, and an interrupted recording can be read. With --listen nothing is sent, and the file starts
    with what the device has sent of its identity by itself.

    --monitor shows the data on a full screen while it is recorded. --caster forwards RTK corrections to the
    device like xbus ntrip; if the caster is lost or the device refuses them, this is reported and the
    recording continues. Both work together.

    PORT is a serial port, a pyserial URL (socket://HOST:PORT), a bus (i2c:/dev/i2c-1, spi:/dev/spidev0.0), or
    sim:PRODUCT for a virtual device, which runs faster than real time without --monitor.
    can:INTERFACE:CHANNEL is a CAN bus with MTi-600 devices, such as can:socketcan:can0, which is recorded as
    .blf, .asc, .log, .trc, .csv or .mf4.
    """
    is_can = port.startswith("can:")
    _check_options(listen=listen, is_can=is_can, with_monitor=with_monitor)
    corrections = None
    if caster["caster"] is not None:
        corrections = new_corrections(**caster, persistent=True)
    settings = None if config is None else read_settings(config)
    path = Path(out)
    if not overwrite and path.is_file() and path.stat().st_size:
        raise Failure(f"{label(out)} exists; choose another name, or add --overwrite")
    if path.is_fifo():
        raise Failure(f"{label(out)} is a pipe; a recording needs a file")
    with (
        stop_requested() as is_stopping,
        connect_device(port, baudrate, listen=listen) as device,
        _initial_state_restored(device, listen=listen),
    ):
        listen = listen or is_can
        if config is not None and settings is not None:
            apply_settings(device, settings, config)
        with contextlib.nullcontext() if listen else _configured(device, outputs):
            if corrections is not None:
                check_receiver(device, with_position=caster["gga"] is not None)
            try:
                recording = device.record(
                    out, fsync=fsync, times=not no_times, overwrite=overwrite, **rotate
                )
            except OSError as error:
                raise cannot(f"write {label(error.filename or out)}", error) from error
            except ValueError as error:  # the suffix of a capture of CAN
                raise click.UsageError(str(error)) from error
            # No samples arrive in Config State; these counts are not part of the recording.
            before = device.stats
        if not listen:
            _start_measurement(device)
        job = RecordingJob(
            device,
            recording,
            before,
            duration=duration,
            reconnect=reconnect,
            is_listening=listen,
            corrections=corrections,
        )
        with contextlib.nullcontext() if corrections is None else corrections.forwarding(device):
            (_record_with_monitor if with_monitor else _record)(job, is_stopping)
        click.echo(job.finish(), err=True)


def _check_options(*, listen: bool, is_can: bool, with_monitor: bool) -> None:
    """Checks that the options fit each other."""
    from xbus.cli.monitor.keyboard import has_terminal

    ctx = click.get_current_context()
    given = {
        str(param.name): param.opts[-1]
        for param in ctx.command.params
        if ctx.get_parameter_source(str(param.name)) == ParameterSource.COMMANDLINE
    }
    if listen or is_can:
        why = "CAN is read only" if is_can else "--listen sends nothing"
        for name in ("outputs", "config", "caster"):
            if name in given:
                raise click.UsageError(f"{given[name]} sends messages to the device, and {why}")
    if "caster" not in given:
        for name in ("mountpoint", "user", "password", "gga", "ntrip"):
            if name in given:
                raise click.UsageError(f"{given[name]} needs --caster")
    elif "mountpoint" not in given:
        raise click.UsageError("--mountpoint is missing; xbus ntrip --list lists the mountpoints")
    if with_monitor and not has_terminal():
        raise click.UsageError("--monitor needs a terminal for input and output")


@contextlib.contextmanager
def _initial_state_restored(device: Device, *, listen: bool) -> Iterator[None]:
    """Puts a device back into Config State in which it was found."""
    from xbus.protocol import State

    initial_state = device.state
    try:
        yield
    finally:
        if initial_state == State.CONFIG and not listen:
            with contextlib.suppress(XbusError):
                device.go_to_config()


def _start_measurement(device: Device) -> None:
    from xbus.protocol import State

    if device.state != State.MEASUREMENT:
        device.go_to_measurement()


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


def _record(job: RecordingJob, is_stopping: Callable[[], bool]) -> None:
    """Records until the end, with one line of status that is updated on a terminal.

    Raises:
        Failure: The recording ended early, or the device sends nothing.
    """
    device, link, recording = job.device, job.device.link, job.recording
    with _StatusLine(job) as line:
        if link.trouble is not None:
            line.print_note(link.trouble)
        while not (is_stopping() or job.is_over):
            _discard_data(job)
            if (reason := job.lost_port) is not None:
                if not job.reconnect or not recording.is_active:
                    raise job.failure(recording.error or reason)
                line.print_note(f"{reason}; waiting for the port")
                is_back = False
                while not (is_back or is_stopping() or job.is_over):
                    is_back = device.try_reconnect()
                    line.update()
                if is_back:
                    line.print_note(f"{link.name} is back")
                job.resume()
            line.update()
            job.check(line.print_note)


def _discard_data(job: RecordingJob) -> None:
    """Waits a moment, and removes the samples and strings, which are recorded in the background."""
    seconds = min(CHECK_INTERVAL, max(job.left, 0.0))
    if job.corrections is None or seconds < CHECK_INTERVAL:
        job.device.link.pause(seconds)
    else:
        # The port may be gone.
        with contextlib.suppress(Disconnected):
            job.corrections.read(job.device, CHECK_INTERVAL)
    job.device.discard()


def _record_with_monitor(job: RecordingJob, is_stopping: Callable[[], bool]) -> None:
    """Records until the end, with the screen of the monitor.

    Raises:
        Failure: The recording ended early, or the device sends nothing.
    """
    from xbus.cli.monitor.loop import watch
    from xbus.cli.monitor.recording_source import RecordingSource

    source = RecordingSource(job)
    try:
        watch(source, source.model(), lambda: is_stopping() or job.is_over)
    except Disconnected as error:
        raise job.failure(job.recording.error or job.lost_port or str(error)) from error


class _StatusLine:
    """Shows a recording as one line that is updated on a terminal."""

    def __init__(self, job: RecordingJob) -> None:
        self._job = job
        self._terminal = sys.stderr is not None and sys.stderr.isatty()
        self._rate, self._measured = 0.0, (job.device.link.clock(), 0)

    def __enter__(self) -> _StatusLine:
        return self

    def __exit__(self, *_: object) -> None:
        if self._terminal:
            self._line("")

    def print_note(self, text: str, is_bad: bool = True) -> None:  # noqa: ARG002 - as `Report` requires
        """Prints a line above the status line."""
        if self._terminal:
            self._line("")
        click.echo(f"xbus: {text}", err=True)

    def update(self) -> None:
        """Updates the line."""
        job, stats, now = self._job, self._job.device.stats, self._job.device.link.clock()
        then, received = self._measured
        if now - then >= 1:
            self._rate = (job.received(stats) - received) / (now - then)
            self._measured = now, job.received(stats)
        if not self._terminal:
            return
        minutes, seconds = divmod(int(job.elapsed), 60)
        parts = [
            f"{minutes // 60}:{minutes % 60:02}:{seconds:02}",
            format_size(job.recording.bytes),
            f"{self._rate:,.0f} {job.received_noun(stats)}/s",
            job.losses(stats),
        ]
        if job.corrections is None:
            parts.append(f"{format_size(job.recording.queued_bytes)} queued")
        else:
            rtk = job.corrections.fix.rtk or "unknown"
            parts.append(f"RTK {rtk}, {job.corrections.describe_counts()}")
        self._line("  ".join(parts))

    def _line(self, text: str) -> None:
        width = shutil.get_terminal_size().columns - 1
        click.echo(f"\r{text[:width]:<{width}}\r", nl=False, err=True)
