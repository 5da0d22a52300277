"""``xbus stream``: passes samples on to other programs."""

from __future__ import annotations

import contextlib
import sys
import time
from typing import TYPE_CHECKING, Literal

import click

from xbus.cli.connection import (
    baudrate_option,
    bid_option,
    duration_option,
    listen_option,
    speed_option,
)
from xbus.cli.failure import Failure, cannot, stop_requested
from xbus.cli.inputs import is_recording, label

if TYPE_CHECKING:
    from xbus.cli.live_input import LiveInput
    from xbus.cli.lsl_sink import LslSink
    from xbus.cli.nmea_stream import NmeaStream
    from xbus.cli.udp_sink import UdpSink

__all__ = ["stream"]

#: Seconds between two lines of progress.
PROGRESS = 10.0
#: Bytes of a recording that are surveyed at once.
PART = 4 << 20


@click.command(epilog="Example: xbus stream /dev/ttyUSB0 --to udp://127.0.0.1:5005")
@click.argument("source", metavar="PORT|FILE")
@click.option(
    "--to",
    "target",
    required=True,
    metavar="udp://HOST:PORT|lsl",
    help="Where samples go: UDP datagrams, or a stream of the Lab Streaming Layer for each quantity.",
)
@click.option(
    "--format",
    "form",
    type=click.Choice(["json", "nmea"]),
    help="Content of datagrams: a line of JSON for each sample, or NMEA sentences: those of the device, or"
    " made from its samples if it sends none.  [default: json]",
)
@bid_option
@baudrate_option
@listen_option
@speed_option
@duration_option
@click.option("-q", "--quiet", is_flag=True, help="Show no progress and no summary on stderr.")
def stream(
    source: str,
    target: str,
    form: Literal["json", "nmea"] | None,
    bid: int | None,
    baudrate: int | None,
    listen: bool,
    speed: float | None,
    duration: float | None,
    quiet: bool,
) -> None:
    """Passes what a device sends on to other programs.

    A datagram has one sample as a line of JSON: sample, time in seconds on the device clock, utc, host_time,
    bid, and the quantities; null is not known, or not a number. Nothing waits for a receiver: what the system
    does not take is lost, and the summary counts it. Receivers count what they lose themselves by the sample
    of JSON, or the channel counter of a stream of LSL.

    Stops on Ctrl-C, SIGTERM or after --duration.

    PORT is a serial port, a pyserial URL (socket://HOST:PORT), a bus (i2c:/dev/i2c-1, spi:/dev/spidev0.0,
    can:socketcan:can0), or sim:PRODUCT for a virtual device. FILE is a recording, which is replayed at the
    pace of its time stamps.
    """
    from xbus.cli.live_input import live_input
    from xbus.cli.udp_sink import udp_address

    if target != "lsl":
        udp_address(target)
    elif form is not None:
        raise click.UsageError("--format is for udp://; LSL has numbers")
    with (
        stop_requested() as is_stopping,
        live_input(source, bid=bid, baudrate=baudrate, listen=listen, speed=speed) as live,
    ):
        sink = _sink(target, form or "json", source, bid, live)
        with contextlib.closing(sink):
            progress = _Progress(live, sink, shown=not quiet)
            live.run(sink, is_stopping, duration=duration, progress=progress.update)
        summary = f"{label(source)}: {live.elapsed:,.1f} s, {sink}; {live.losses()}"
    if form == "nmea" and not sink.offered:
        raise Failure(
            f"{summary}; there are no NMEA strings, and no position or orientation to make sentences from; "
            "--format json sends every sample"
        )
    if not quiet:
        click.echo(summary, err=True)


def _sink(
    target: str, form: Literal["json", "nmea"], source: str, bid: int | None, live: LiveInput
) -> UdpSink | LslSink:
    if target == "lsl":
        from xbus.cli.lsl_sink import ALONE, LslSink

        return LslSink(source, live.device_id, ALONE if bid is None else bid)
    from xbus.cli.udp_sink import UdpSink

    if form == "json":
        return UdpSink(target)
    return UdpSink(target, "sentence", _nmea_of(source, bid).of)


def _nmea_of(source: str, bid: int | None) -> NmeaStream:
    from xbus.cli.nmea_stream import NmeaStream
    from xbus.describe.log_summary import LogSummary
    from xbus.log.read import iter_log

    if not is_recording(source):
        return NmeaStream()
    try:
        return NmeaStream(LogSummary(iter_log(source, block_bytes=PART, bid=bid)))
    except OSError as error:
        raise cannot(f"read {label(source)}", error) from error


class _Progress:
    """Prints what was sent so far, on a terminal."""

    def __init__(self, live: LiveInput, sink: UdpSink | LslSink, *, shown: bool) -> None:
        self._live, self._sink = live, sink
        self._is_shown = shown and sys.stderr is not None and sys.stderr.isatty()
        self._due = time.monotonic() + PROGRESS

    def update(self) -> None:
        """Prints a line if one is due."""
        if self._is_shown and time.monotonic() >= self._due:
            self._due += PROGRESS
            click.echo(
                f"{self._live.elapsed:,.0f} s, {self._sink}; {self._live.losses()}", err=True
            )
