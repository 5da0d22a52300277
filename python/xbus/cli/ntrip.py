"""``xbus ntrip``: corrections from a caster to a device."""

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
from xbus.describe.formatting import format_count
from xbus.errors import XbusTimeout

if TYPE_CHECKING:
    from xbus.device import Device
    from xbus.rtk import Caster, Fix, Forwarder

__all__ = ["ntrip"]

HEAD = ["mountpoint", "place", "country", "position", "format", "systems", "--gga"]
#: Seconds to wait for a sample before looking for corrections again.
LOOK = 0.05
#: Seconds for which corrections are forwarded, or samples read, before it is the other's turn.
LONGEST_TURN = 0.2
#: Seconds between two lines, and between two looks of the line on a terminal.
PAUSE, PAUSE_ON_TERMINAL = 5.0, 0.2


@click.command(
    epilog="Example: xbus ntrip /dev/ttyUSB0 --caster rtk2go.com --mountpoint BASE --gga 10"
)
@click.argument("port", required=False)
@click.option(
    "--caster",
    "url",
    required=True,
    metavar="HOST[:PORT]",
    help="Who has the corrections; port 2101 if none is given, and with https:// before it 443.",
)
@click.option("--mountpoint", metavar="NAME", help="Which of the caster's streams.")
@click.option(
    "--list",
    "as_list",
    is_flag=True,
    help="Print the mountpoints of the caster, and end. Needs no PORT.",
)
@click.option("--user", envvar="XBUS_NTRIP_USER", show_envvar=True, help="Name of your account.")
@click.option(
    "--password",
    envvar="XBUS_NTRIP_PASSWORD",
    show_envvar=True,
    help="Its password. Others on this machine can see arguments, but not the environment.",
)
@click.option(
    "--gga",
    type=click.IntRange(min=1),
    metavar="S",
    help="Send the caster the position of the device every so many seconds. Network services need it.",
)
@click.option(
    "--ntrip",
    "version",
    type=click.Choice(["1", "2"]),
    default="2",
    show_default=True,
    help="Version of the protocol to ask for.",
)
@baudrate_option
@click.option(
    "--json",
    "as_json",
    is_flag=True,
    help="The status as one JSON object a line; with --list, a JSON list.",
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
    """Corrections from an NTRIP caster to a device, for RTK.

    Until Ctrl-C, RTCM 3 messages go to the device, and nothing else does; its status is shown as it changes,
    and every few seconds. A lost connection to the caster is made again. The extra rtk must be installed.

    PORT is a serial port or a URL of pyserial (socket://HOST:PORT). The device must be measuring, and its
    outputs should have status_word or gnss_pvt_data, from which the status is read; --gga also needs
    gnss_pvt_data or lat_lon. At the beginning it stops for a moment, to say what it is.
    """
    if as_list:
        _print_mountpoints(url, user, password, as_json=as_json)
        return
    if port is None or mountpoint is None:
        missing = "PORT" if port is None else "--mountpoint"
        raise click.UsageError(f"{missing} is missing; xbus ntrip --list prints the mountpoints")

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
        with _Shown(caster, fix, forwarder, as_json=as_json) as shown:
            while True:
                # By turns, each for a limited time: neither a flood of corrections nor one of samples keeps
                # the others waiting.
                until = time.monotonic() + LONGEST_TURN
                while time.monotonic() < until and (frame := caster.read()):
                    forwarder.forward([frame])
                    shown.corrected()
                until = time.monotonic() + LONGEST_TURN
                timeout = LOOK
                with contextlib.suppress(XbusTimeout):
                    while time.monotonic() < until:
                        fix.update(device.read_sample(timeout))
                        timeout = 0.0
                shown.update()


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
    """Whether the device takes corrections, and tells what is wanted of it."""
    from xbus.protocol import State

    with device.configure():
        outputs = {it.quantity for it in device.commands.req_output_configuration()}
    if device.support is not None and "ForwardGnssData" not in device.support.messages:
        device.command("ForwardGnssData", b"")  # says which products know it, and sends nothing
    if device.state == State.CONFIG:
        raise Failure(
            "the device is in Config State and takes no corrections; xbus send"
            f" {device.link.name} GoToMeasurement changes that"
        )
    if with_position and not outputs & {"gnss_pvt_data", "lat_lon"}:
        raise Failure("the device tells no position for --gga; add gnss_pvt_data to its outputs")


class _Shown:
    """Shows how it goes: one line that changes on a terminal, else a line now and then."""

    def __init__(self, caster: Caster, fix: Fix, forwarder: Forwarder, *, as_json: bool) -> None:
        self._caster, self._fix, self._forwarder = caster, fix, forwarder
        self._json = as_json
        self._terminal = not as_json and sys.stderr is not None and sys.stderr.isatty()
        self._corrected_at: float | None = None
        # A caster that refuses does so at once, and that is all there is to tell.
        self._next_at = 0.0 if self._terminal else time.monotonic() + PAUSE
        self._state: tuple[Any, ...] = ()

    def __enter__(self) -> _Shown:
        return self

    def __exit__(self, *_: object) -> None:
        if self._terminal:
            click.echo(err=True)

    def corrected(self) -> None:
        """A correction was forwarded."""
        self._corrected_at = time.monotonic()

    def update(self) -> None:
        """Shows how it goes if it has changed, or it is time."""
        state = self._fix.type, self._fix.rtk, self._caster.state
        now = time.monotonic()
        is_news = state != self._state and self._caster.state not in ("idle", "connecting")
        if now < self._next_at and (self._terminal or not is_news):
            return
        self._state = state
        self._next_at = now + (PAUSE_ON_TERMINAL if self._terminal else PAUSE)
        age = None if self._corrected_at is None else now - self._corrected_at
        if self._json:
            print_line(json.dumps(self._facts(age)), now=True)
        elif self._terminal:
            width = shutil.get_terminal_size().columns - 1
            click.echo(f"\r{self._words(age)[:width]:<{width}}", nl=False, err=True)
        else:
            click.echo(self._words(age), err=True)

    def _facts(self, age: float | None) -> dict[str, Any]:
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

    def _words(self, age: float | None) -> str:
        fix, forwarder, caster = self._fix, self._forwarder, self._caster
        words = [
            f"fix {fix.type or 'not told'}",
            f"RTK {fix.rtk or 'not told'}",
            f"{format_count(forwarder.messages, 'message')}, {format_count(forwarder.bytes, 'byte')}",
        ]
        if age is not None:
            words.append(f"the last {age:.1f} s ago")
        if forwarder.unanswered:
            words.append(f"{forwarder.unanswered} unanswered")
        if caster.gga_sent:
            words.append(f"{caster.gga_sent} GGA")
        if caster.state != "streaming":
            words.append(f"caster: {caster.problem or caster.state}")
        return ", ".join(words)
