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
from xbus.cli.failure import Failure
from xbus.cli.printing import print_json_rows, print_line, print_table
from xbus.errors import XbusTimeout
from xbus.formatting import format_count

if TYPE_CHECKING:
    from xbus.device import Device
    from xbus.rtk import Caster, Fix, Forwarder

__all__ = ["ntrip"]

#: Columns of the list of mountpoints.
HEAD = ["mountpoint", "place", "country", "position", "format", "systems", "--gga"]
#: Time to wait for a sample before the next check for corrections, in seconds.
SAMPLE_TIMEOUT = 0.05
#: Maximum time to forward corrections, or to read samples, before the other continues, in seconds.
MAX_TURN = 0.2
#: Seconds between two lines of status, and between two updates of the line on a terminal.
STATUS_INTERVAL, TERMINAL_INTERVAL = 5.0, 0.2


@click.command(
    epilog="Example: xbus ntrip /dev/ttyUSB0 --caster rtk2go.com --mountpoint BASE --gga 10"
)
@click.argument("port", required=False)
@click.option(
    "--caster",
    "url",
    required=True,
    metavar="HOST[:PORT]",
    help="The caster. Default port: 2101, with https:// 443.",
)
@click.option("--mountpoint", metavar="NAME", help="A stream of the caster.")
@click.option(
    "--list",
    "as_list",
    is_flag=True,
    help="List the mountpoints of the caster and exit; needs no PORT.",
)
@click.option("--user", envvar="XBUS_NTRIP_USER", show_envvar=True, help="User name.")
@click.option(
    "--password",
    envvar="XBUS_NTRIP_PASSWORD",
    show_envvar=True,
    help="Password. Other users of this machine can see arguments, but not the environment.",
)
@click.option(
    "--gga",
    type=click.IntRange(min=1),
    metavar="S",
    help="Send the position of the device to the caster every S seconds, as network services require.",
)
@click.option(
    "--ntrip",
    "version",
    type=click.Choice(["1", "2"]),
    default="2",
    show_default=True,
    help="Version of the NTRIP protocol.",
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
    url: str,
    mountpoint: str | None,
    as_list: bool,
    user: str | None,
    password: str | None,
    gga: int | None,
    version: str,
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
        _print_mountpoints(url, user, password, as_json=as_json)
        return
    if port is None or mountpoint is None:
        missing = "PORT" if port is None else "--mountpoint"
        raise click.UsageError(f"{missing} is missing; xbus ntrip --list lists the mountpoints")

    from xbus.extras import require
    from xbus.rtk import Caster, Fix, Forwarder

    require("pygnssutils", "rtk", "to get corrections from a caster")
    fix = Fix()
    try:
        caster = Caster(
            url,
            mountpoint,
            user=user,
            password=password,
            gga=gga,
            position=lambda: fix.position,
            ntrip=int(version),
        )
    except ValueError as error:
        raise click.UsageError(str(error)) from None
    with contextlib.suppress(KeyboardInterrupt), connect_device(port, baudrate) as device, caster:
        _check(device, with_position=gga is not None)
        forwarder = Forwarder(device)
        with _StatusDisplay(caster, fix, forwarder, as_json=as_json) as display:
            while True:
                # Each turn has a limited time, so that a flood of corrections does not delay samples,
                # or the reverse.
                until = time.monotonic() + MAX_TURN
                while time.monotonic() < until and (frame := caster.read()):
                    forwarder.forward([frame])
                    display.correction_sent()
                until = time.monotonic() + MAX_TURN
                timeout = SAMPLE_TIMEOUT
                with contextlib.suppress(XbusTimeout):
                    while time.monotonic() < until:
                        fix.update(device.read_sample(timeout))
                        timeout = 0.0
                display.update()


def _print_mountpoints(url: str, user: str | None, password: str | None, *, as_json: bool) -> None:
    from xbus.describe.text import printable
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
    cells = [[printable(cell.encode()) for cell in row] for row in cells]
    print_table(HEAD, cells, optional=["systems", "place"])


def _check(device: Device, *, with_position: bool) -> None:
    """Checks that the device accepts corrections and outputs what is needed."""
    from xbus.protocol import State

    with device.configure():
        outputs = {output.quantity for output in device.commands.req_output_configuration()}
    if device.support is not None and "ForwardGnssData" not in device.support.messages:
        device.command(
            "ForwardGnssData", b""
        )  # raises an error that names the products, and sends nothing
    if device.state == State.CONFIG:
        raise Failure(
            "the device is in Config State and accepts no corrections; start it with xbus send"
            f" {device.link.name} GoToMeasurement"
        )
    if with_position and not outputs & {"gnss_pvt_data", "lat_lon"}:
        raise Failure("the device outputs no position for --gga; add gnss_pvt_data to its outputs")


class _StatusDisplay:
    """Shows the status: one line that is updated on a terminal, else a line from time to time."""

    def __init__(self, caster: Caster, fix: Fix, forwarder: Forwarder, *, as_json: bool) -> None:
        self._caster, self._fix, self._forwarder = caster, fix, forwarder
        self._json = as_json
        self._terminal = not as_json and sys.stderr is not None and sys.stderr.isatty()
        self._corrected_at: float | None = None
        # If the caster refuses the connection at once, the error is the only output.
        self._next_at = 0.0 if self._terminal else time.monotonic() + STATUS_INTERVAL
        self._state: tuple[Any, ...] = ()

    def __enter__(self) -> _StatusDisplay:
        return self

    def __exit__(self, *_: object) -> None:
        if self._terminal:
            click.echo(err=True)

    def correction_sent(self) -> None:
        """Records that a correction was forwarded."""
        self._corrected_at = time.monotonic()

    def update(self) -> None:
        """Shows the status if it has changed or the interval is over."""
        state = self._fix.type, self._fix.rtk, self._caster.state
        now = time.monotonic()
        has_changed = state != self._state and self._caster.state not in ("idle", "connecting")
        if now < self._next_at and (self._terminal or not has_changed):
            return
        self._state = state
        self._next_at = now + (TERMINAL_INTERVAL if self._terminal else STATUS_INTERVAL)
        age = None if self._corrected_at is None else now - self._corrected_at
        if self._json:
            print_line(json.dumps(self._json_status(age)), flush=True)
        elif self._terminal:
            width = shutil.get_terminal_size().columns - 1
            click.echo(f"\r{self._text(age)[:width]:<{width}}", nl=False, err=True)
        else:
            click.echo(self._text(age), err=True)

    def _json_status(self, age: float | None) -> dict[str, Any]:
        return {
            "fix": self._fix.type,
            "rtk": self._fix.rtk,
            "messages": self._forwarder.messages,
            "bytes": self._forwarder.bytes,
            "unanswered": self._forwarder.unanswered,
            "age_s": None if age is None else round(age, 3),
            "gga": self._caster.gga_sent,
            "caster": self._caster.state,
            "problem": self._caster.problem,
        }

    def _text(self, age: float | None) -> str:
        fix, forwarder, caster = self._fix, self._forwarder, self._caster
        parts = [
            f"fix {fix.type or 'unknown'}",
            f"RTK {fix.rtk or 'unknown'}",
            f"{format_count(forwarder.messages, 'message')}, {format_count(forwarder.bytes, 'byte')}",
        ]
        if age is not None:
            parts.append(f"last {age:.1f} s ago")
        if forwarder.unanswered:
            parts.append(f"{forwarder.unanswered} unanswered")
        if caster.gga_sent:
            parts.append(f"{caster.gga_sent} GGA")
        if caster.state != "streaming":
            parts.append(f"caster: {caster.problem or caster.state}")
        return ", ".join(parts)
