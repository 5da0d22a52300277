"""``xbus serve``: a server for Foxglove."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import TYPE_CHECKING

import click

from xbus.cli.connection import (
    baudrate_option,
    bid_option,
    duration_option,
    listen_option,
    speed_option,
)
from xbus.cli.failure import cannot, stop_requested
from xbus.cli.inputs import check_port_options, is_recording, label
from xbus.formatting import format_count
from xbus.network import is_loopback, url_host

if TYPE_CHECKING:
    from xbus.cli.live_input import LiveInput
    from xbus.export.ros.live import LiveMessages

__all__ = ["serve"]

#: Bytes of a recording that are surveyed at once.
PART = 4 << 20


@click.command(epilog="Example: xbus serve /dev/ttyUSB0")
@click.argument("source", metavar="PORT|FILE")
@click.option(
    "--host",
    default="127.0.0.1",
    show_default=True,
    metavar="ADDRESS",
    help="Address to listen on. With another one than the default, other computers can read the data.",
)
@click.option(
    "--port",
    "tcp_port",
    type=click.IntRange(0, 65535),
    default=8765,
    show_default=True,
    metavar="N",
    help="TCP port to listen on; 0 for any free one.",
)
@click.option(
    "--ros-style",
    type=click.Choice(["rep", "driver"]),
    default="rep",
    show_default=True,
    help="Messages that follow REP-103, 105 and 145, or those of the vendor's ROS 2 driver.",
)
@click.option(
    "--record",
    "record",
    type=click.Path(),
    metavar="FILE",
    help="Record every byte of the device to this file, too.",
)
@bid_option
@baudrate_option
@listen_option
@speed_option
@duration_option
def serve(
    source: str,
    host: str,
    tcp_port: int,
    ros_style: str,
    record: str | None,
    bid: int | None,
    baudrate: int | None,
    listen: bool,
    speed: float | None,
    duration: float | None,
) -> None:
    """Serves what a device sends to Foxglove, as messages of ROS 2.

    The topics are those of xbus decode -o FILE.mcap. In Foxglove, open a connection "Foxglove WebSocket" to
    the printed address. A client that is slow loses only its own messages, and the summary counts them.
    Messages of a device have the time of the measurement on the clock of this computer.

    Stops on Ctrl-C, SIGTERM or after --duration.

    PORT is a serial port, a pyserial URL (socket://HOST:PORT), a bus (i2c:/dev/i2c-1, spi:/dev/spidev0.0,
    can:socketcan:can0), or sim:PRODUCT for a virtual device. FILE is a recording, which is replayed at the
    pace of its time stamps.
    """
    from xbus.cli.foxglove_sink import FoxgloveSink
    from xbus.cli.live_input import live_input

    if is_recording(source):
        check_port_options(source, record=record)
    with (
        stop_requested() as is_stopping,
        live_input(source, bid=bid, baudrate=baudrate, listen=listen, speed=speed) as live,
    ):
        sink = FoxgloveSink(_messages(source, ros_style, bid), host, tcp_port, source)
        with contextlib.closing(sink), _recording(live, record) as recorded:
            if not is_loopback(host):
                click.echo(
                    f"xbus: every computer that reaches {host} can read the data; --host 127.0.0.1 serves "
                    "only this one",
                    err=True,
                )
            click.echo(f"serving ws://{url_host(host)}:{sink.port}", err=True)
            live.run(sink, is_stopping, duration=duration)
        summary = f"{label(source)}: {live.elapsed:,.1f} s, {sink}; {live.losses()}"
    click.echo(summary + (f"; {recorded[0]}" if recorded else ""), err=True)


def _messages(source: str, ros_style: str, bid: int | None) -> LiveMessages:
    """Returns what makes the messages; the times of a recording are found first."""
    from xbus.export.ros.live import LiveMessages
    from xbus.export.ros.mcap import Mcap
    from xbus.export.ros.stamps import TIME_QUANTITIES, TimeBase
    from xbus.log.read import iter_log

    style = Mcap("driver" if ros_style == "driver" else "rep")
    if not is_recording(source):
        return LiveMessages(style)
    times = TimeBase()
    try:
        for part in iter_log(source, block_bytes=PART, quantities=TIME_QUANTITIES, bid=bid):
            times.add(part)
    except OSError as error:
        raise cannot(f"read {label(source)}", error) from error
    return LiveMessages(style, times)


@contextlib.contextmanager
def _recording(live: LiveInput, path: str | None) -> Iterator[list[str]]:
    """Records meanwhile; the list has what was recorded at the end."""
    summary: list[str] = []
    if path is None or live.device is None:
        yield summary
        return
    try:
        recording = live.device.record(path)
    except OSError as error:
        raise cannot(f"write {label(error.filename or path)}", error) from error
    try:
        yield summary
    finally:
        try:
            recording.stop()
        except OSError as error:
            raise cannot(f"write {label(path)}", error) from error
        samples = format_count(recording.samples, "sample")
        summary.append(f"{samples} recorded in {label(path)}")
