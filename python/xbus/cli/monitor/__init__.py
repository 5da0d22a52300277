"""``xbus monitor``: a full-screen view of the data that a device sends."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import click

from xbus.cli.connection import (
    address_of,
    baudrate_option,
    bid_option,
    connect_device,
    listen_option,
    port_lost,
    speed_option,
)
from xbus.cli.failure import stop_requested
from xbus.cli.inputs import check_port_options, is_recording, legacy_option, strings_option
from xbus.cli.number_type import NumberRange
from xbus.cli.printing import print_json, print_line
from xbus.cli.recordings import show_unread_piece
from xbus.errors import Disconnected

if TYPE_CHECKING:
    from xbus.cli.monitor.replay_source import ReplaySource
    from xbus.watch.device_source import DeviceSource
    from xbus.watch.model import Model

__all__ = ["monitor"]

#: What to do if values and rates are those of several devices.
BID_REMEDY = "--bid N shows one of them"


@click.command(epilog="Example: xbus monitor /dev/ttyUSB0")
@click.argument("source", metavar="PORT|FILE")
@bid_option
@baudrate_option
@listen_option
@speed_option
@click.option(
    "--once",
    type=NumberRange(min=0, min_open=True),
    metavar="S",
    help="Print the state after S seconds and exit, for scripts.",
)
@strings_option
@legacy_option
@click.option("--json", "as_json", is_flag=True, help="With --once: print JSON.")
def monitor(
    source: str,
    bid: int | None,
    baudrate: int | None,
    listen: bool,
    speed: float | None,
    once: float | None,
    strings: tuple[str, ...],
    legacy: Sequence[tuple[int, int]],
    as_json: bool,
) -> None:
    """Shows live data from a device on a full screen.

    The screen shows rates, latest values, attitude, status flags, GNSS fix, losses and damage. Press ? for
    the keys: p pauses, r records, / filters the quantities, q quits. The monitor only listens to a device
    that sends data, unless a key needs a command, and leaves the device in its initial state; with --listen
    it never sends a byte. If the port is lost, the monitor waits for it.

    PORT is a serial port, a pyserial URL (socket://HOST:PORT), a bus (i2c:/dev/i2c-1, spi:/dev/spidev0.0,
    can:socketcan:can0), or sim:PRODUCT for a virtual device. FILE is a recording, which is replayed at the
    pace of its time stamps; the screen stays open at the end.
    """
    from xbus.cli.monitor.keyboard import has_terminal

    if as_json and once is None:
        raise click.UsageError("--json requires --once")
    if once is None and not has_terminal():
        raise click.UsageError(
            "the screen needs a terminal for input and output; --once 2 prints the state after 2 seconds"
        )
    is_file = is_recording(source)
    if is_file:
        check_port_options(source, baudrate=baudrate, listen=listen)
    if not is_file and legacy:
        raise click.UsageError("--legacy is for a recording; a device is asked for its settings")
    if not is_file and speed is not None:
        raise click.UsageError("--speed is for a recording; a device sends at its own rate")
    if is_file:
        _monitor_file(source, bid, speed or 1.0, strings, legacy, once, as_json=as_json)
    else:
        _monitor_port(source, bid, baudrate, strings, once, listen=listen, as_json=as_json)


def _monitor_file(
    file: str,
    bid: int | None,
    speed: float,
    strings: Sequence[str],
    legacy: Sequence[tuple[int, int]],
    once: float | None,
    *,
    as_json: bool,
) -> None:
    from xbus.cli.monitor.replay_source import ReplaySource

    show_unread_piece(file)
    source = ReplaySource(file, speed, strings, bid, legacy)
    model = source.model()
    model.on_several_devices = BID_REMEDY
    if once is None:
        _watch(source, model)
        return
    while not source.is_over and model.elapsed < once:
        source.advance(model)
    _print(model, as_json=as_json)


def _monitor_port(
    port: str,
    bid: int | None,
    baudrate: int | None,
    strings: Sequence[str],
    once: float | None,
    *,
    listen: bool,
    as_json: bool,
) -> None:
    from xbus.watch.device_source import DeviceSource

    with connect_device(
        port, baudrate, bid=address_of(bid), listen=listen, strings=strings
    ) as device:
        source = DeviceSource(device, reconnect=once is None)
        model = source.model()
        model.on_several_devices = BID_REMEDY
        if once is None:
            try:
                _watch(source, model)
            finally:
                source.close(model)
            for recording in source.recordings:
                click.echo(f"xbus: {recording}", err=True)
            return
        try:
            while model.elapsed < once:
                source.advance(model)
        except Disconnected as error:
            cause = error.__cause__
            raise port_lost(port, cause if isinstance(cause, OSError) else error) from error
        _print(model, as_json=as_json)


def _watch(source: DeviceSource | ReplaySource, model: Model) -> None:
    from xbus.cli.monitor.loop import watch

    with stop_requested() as is_stopping:
        watch(source, model, is_stopping)


def _print(model: Model, *, as_json: bool) -> None:
    from xbus.cli.monitor.snapshot import snapshot_dict, snapshot_text

    if as_json:
        print_json(snapshot_dict(model))
    else:
        print_line(snapshot_text(model))
