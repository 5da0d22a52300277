"""``xbus ntrip``: forwards corrections from a caster to a device."""

from __future__ import annotations

import contextlib
import json
import shutil
import sys
import time
from typing import TYPE_CHECKING, Any

import click

from xbus.cli.connection import baudrate_option, connect_device
from xbus.cli.corrections import caster_options, check_receiver, new_corrections
from xbus.cli.failure import Failure
from xbus.cli.printing import print_json_rows, print_line, print_table
from xbus.formatting import printable
from xbus.watch.corrections import Corrections

if TYPE_CHECKING:
    from xbus.device import Device

__all__ = ["ntrip"]

#: Columns of the list of mountpoints.
HEAD = ["mountpoint", "place", "country", "position", "format", "systems", "--gga"]
#: Seconds between two lines of status, and between two updates of the line on a terminal.
STATUS_INTERVAL, TERMINAL_INTERVAL = 5.0, 0.2


@click.command(
    epilog="Example: xbus ntrip /dev/ttyUSB0 --caster rtk2go.com --mountpoint BASE --gga 10"
)
@click.argument("port", required=False)
@caster_options(required=True)
@click.option(
    "--list",
    "as_list",
    is_flag=True,
    help="List the mountpoints of the caster and exit; needs no PORT.",
)
@baudrate_option
@click.option(
    "--json",
    "as_json",
    is_flag=True,
    help="Print the status as one JSON object per line; with --list, a JSON list.",
)
def ntrip(
    port: str | None,
    caster: str,
    mountpoint: str | None,
    user: str | None,
    password: str | None,
    gga: int | None,
    ntrip: str,
    as_list: bool,
    baudrate: int | None,
    as_json: bool,
) -> None:
    """Forwards RTK corrections from an NTRIP caster to a device.

    Runs until Ctrl-C and reconnects to the caster. Only RTCM 3 messages are forwarded. The status is shown
    when it changes and every few seconds. Requires the extra: pip install "xbus-mti[rtk]".

    PORT is a serial port or a pyserial URL (socket://HOST:PORT). The device must measure and should output
    status_word or gnss_pvt_data for the status; --gga also needs gnss_pvt_data or lat_lon. At the start, the
    device stops for a moment while its settings are read.
    """
    if as_list:
        _print_mountpoints(caster, user, password, as_json=as_json)
        return
    if port is None or mountpoint is None:
        missing = "PORT" if port is None else "--mountpoint"
        raise click.UsageError(f"{missing} is missing; xbus ntrip --list lists the mountpoints")

    corrections = new_corrections(caster, mountpoint, user, password, gga, ntrip)
    with contextlib.suppress(KeyboardInterrupt), connect_device(port, baudrate) as device:
        _check(device, with_position=gga is not None)
        with (
            corrections.forwarding(device),
            _StatusDisplay(corrections, as_json=as_json) as display,
        ):
            while True:
                corrections.read(device, TERMINAL_INTERVAL)
                display.update()


def _print_mountpoints(url: str, user: str | None, password: str | None, *, as_json: bool) -> None:
    from xbus.rtk import read_source_table

    try:
        table = read_source_table(url, user=user, password=password)
    except ValueError as error:
        raise click.UsageError(str(error)) from None
    if as_json:
        print_json_rows([row._asdict() for row in table])
        return
    if not table:
        raise Failure(f"{url} has no mountpoints")
    cells = [
        [
            row.name,
            row.place,
            row.country,
            "" if row.lat is None or row.lon is None else f"{row.lat:.2f}, {row.lon:.2f}",
            row.format,
            row.systems,
            "yes" if row.needs_position else "",
        ]
        for row in table
    ]
    cells = [[printable(cell) for cell in row] for row in cells]
    print_table(HEAD, cells, optional=["systems", "place"])


def _check(device: Device, *, with_position: bool) -> None:
    """Checks that the device accepts corrections and outputs what is needed."""
    from xbus.protocol import State

    with device.configure():
        check_receiver(device, with_position=with_position)
    if device.state == State.CONFIG:
        raise Failure(
            "the device is in Config State and accepts no corrections; start it with xbus send"
            f" {device.link.name} GoToMeasurement"
        )


class _StatusDisplay:
    """Shows the status: one line that is updated on a terminal, else a line from time to time."""

    def __init__(self, corrections: Corrections, *, as_json: bool) -> None:
        self._corrections = corrections
        self._json = as_json
        self._terminal = not as_json and sys.stderr is not None and sys.stderr.isatty()
        # If the caster refuses the connection at once, the error is the only output.
        self._next_at = 0.0 if self._terminal else time.monotonic() + STATUS_INTERVAL
        self._state: tuple[Any, ...] = ()

    def __enter__(self) -> _StatusDisplay:
        return self

    def __exit__(self, *_: object) -> None:
        if self._terminal:
            click.echo(err=True)

    def update(self) -> None:
        """Shows the status if it has changed or the interval is over."""
        fix, caster = self._corrections.fix, self._corrections.caster
        state = fix.type, fix.rtk, caster.state
        now = time.monotonic()
        has_changed = state != self._state and caster.state not in ("idle", "connecting")
        if now < self._next_at and (self._terminal or not has_changed):
            return
        self._state = state
        self._next_at = now + (TERMINAL_INTERVAL if self._terminal else STATUS_INTERVAL)
        if self._json:
            print_line(json.dumps(self._json_status()), flush=True)
            return
        text = f"{self._corrections.describe_fix()}, {self._corrections.describe_counts()}"
        if self._terminal:
            width = shutil.get_terminal_size().columns - 1
            click.echo(f"\r{text[:width]:<{width}}", nl=False, err=True)
        else:
            click.echo(text, err=True)

    def _json_status(self) -> dict[str, Any]:
        corrections = self._corrections
        fix, caster, forwarder = corrections.fix, corrections.caster, corrections.forwarder
        return {
            "fix": fix.type,
            "rtk": fix.rtk,
            "messages": forwarder.messages,
            "bytes": forwarder.bytes,
            "unanswered": forwarder.unanswered,
            "age_s": None if corrections.age is None else round(corrections.age, 3),
            "gga": caster.gga_sent,
            "caster": caster.state,
            "problem": caster.problem,
        }
