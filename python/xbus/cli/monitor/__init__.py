"""``xbus monitor``: what a device sends, as it comes."""

from __future__ import annotations

import os
import stat
from collections.abc import Sequence
from typing import TYPE_CHECKING

import click

from xbus.cli.connection import baudrate_option, connected, gone
from xbus.cli.failure import told_to_stop
from xbus.cli.inputs import label, strings_option
from xbus.cli.printing import put, put_json
from xbus.errors import Disconnected

if TYPE_CHECKING:
    from xbus.cli.monitor.model import Model
    from xbus.cli.monitor.sources import Live, Replay

__all__ = ["monitor"]


@click.command(epilog="Example: xbus monitor /dev/ttyUSB0")
@click.argument("source", metavar="PORT|FILE")
@baudrate_option
@click.option(
    "--speed",
    type=click.FloatRange(min=0, min_open=True),
    metavar="X",
    help="Replay FILE so many times as fast as it was recorded.",
)
@click.option(
    "--once",
    type=click.FloatRange(min=0, min_open=True),
    metavar="S",
    help="Print what is known after so many seconds, and end; for scripts.",
)
@strings_option
@click.option("--json", "as_json", is_flag=True, help="With --once: JSON.")
def monitor(
    source: str,
    baudrate: int | None,
    speed: float | None,
    once: float | None,
    strings: tuple[str, ...],
    as_json: bool,
) -> None:
    """Shows what a device sends, as it comes, on the whole terminal.

    Rates and latest values, where it points, status flags by name, the GNSS fix, what was lost or damaged.
    ? shows the keys: p pauses, r records, / shows some quantities only, q ends. A device that is heard is
    only listened to, but for keys that need more, and is left in the state in which it was found. A port
    that is lost is waited for.

    PORT is a serial port, a URL of pyserial (socket://HOST:PORT) or sim:PRODUCT, a virtual device. FILE, a
    recording, is replayed by its time stamps; its end stays on the screen.
    """
    from xbus.cli.monitor.terminal import is_there

    if as_json and once is None:
        raise click.UsageError("--json is for --once: the screen is no JSON")
    if once is None and not is_there():
        raise click.UsageError(
            "the screen needs a terminal for input and output; --once 2 prints what is known after 2 seconds"
        )
    is_file = _is_file(source)
    if is_file and baudrate is not None:
        raise click.UsageError(f"{label(source)} is a recording and has no --baudrate")
    if not is_file and speed is not None:
        raise click.UsageError(
            "--speed is for a recording; what a device sends comes when it comes"
        )
    if is_file:
        _replay(source, speed or 1.0, strings, once, as_json=as_json)
    else:
        _live(source, baudrate, strings, once, as_json=as_json)


def _is_file(name: str) -> bool:
    try:
        return stat.S_ISREG(os.stat(name).st_mode)  # noqa: PTH116 - pathlib is slow to import
    except (OSError, ValueError):
        return False


def _replay(
    file: str, speed: float, strings: Sequence[str], once: float | None, *, as_json: bool
) -> None:
    from xbus.cli.monitor.sources import Replay

    source = Replay(file, speed, strings)
    model = source.model()
    if once is None:
        _watch(source, model)
        return
    while not source.is_over and model.elapsed < once:
        source.advance(model)
    _print(model, as_json=as_json)


def _live(
    port: str, baudrate: int | None, strings: Sequence[str], once: float | None, *, as_json: bool
) -> None:
    from xbus.cli.monitor.sources import Live

    with connected(port, baudrate, strings=strings) as device:
        source = Live(device, waits=once is None)
        model = source.model()
        if once is None:
            try:
                _watch(source, model)
            finally:
                source.leave(model)
            for it in source.recorded:
                click.echo(f"xbus: {it}", err=True)
            return
        try:
            while model.elapsed < once:
                source.advance(model)
        except Disconnected as error:
            cause = error.__cause__
            raise gone(port, cause if isinstance(cause, OSError) else error) from error
        _print(model, as_json=as_json)


def _watch(source: Live | Replay, model: Model) -> None:
    from xbus.cli.monitor.loop import watch
    from xbus.cli.monitor.terminal import Terminal

    with told_to_stop() as is_stopped, Terminal() as terminal:
        watch(source, model, terminal, is_stopped)


def _print(model: Model, *, as_json: bool) -> None:
    from xbus.cli.monitor.snapshot import facts, text

    if as_json:
        put_json(facts(model))
    else:
        put(text(model))
