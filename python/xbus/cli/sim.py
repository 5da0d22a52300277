"""``xbus sim``: a virtual device."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

import click

from xbus.cli.failure import Failure, cannot, stop_requested
from xbus.cli.inputs import no_frame
from xbus.cli.printing import print_line

if TYPE_CHECKING:
    from xbus.sim.device import SimulatedDevice
    from xbus.sim.replay import Replay
    from xbus.sim.serve import Server

__all__ = ["sim"]


@click.command(epilog="Example: xbus sim --product MTi-680G --trajectory drive --link /tmp/mti")
@click.option("--product", metavar="NAME", help="Which one: MTi-3, MTi-680G, ...")
@click.option(
    "--baudrate",
    metavar="RATE",
    help="Talk like a serial port, at this rate: a client must set the same. Without it any will do, "
    "as on USB.",
)
@click.option(
    "--trajectory",
    metavar="NAME",
    help="How it moves: still, turn, tumble, walk, drive, fly or sail.  [default: walk]",
)
@click.option(
    "--noise",
    metavar="X",
    help="Noise of the sensors: 1 is about that of a data sheet.  [default: 0]",
)
@click.option("--seed", metavar="N", help="Of all that is left to chance.  [default: 0]")
@click.option("--device-id", metavar="ID", help="Device identifier, in hexadecimal.")
@click.option("--firmware", metavar="VERSION", help="Firmware revision, such as 1.8.0.")
@click.option(
    "--utc", metavar="TIME", help="UTC at power-up, such as 2026-11-28T12:00:00, by its calendar."
)
@click.option(
    "--time-to-fix", metavar="S", help="Seconds from power-up to the first GNSS fix.  [default: 3]"
)
@click.option(
    "--strict-outputs/--no-strict-outputs",
    default=None,
    help="Whether one unsupported data identifier makes it refuse a whole output configuration, or is "
    "dropped from it.  [default: strict-outputs]",
)
@click.option(
    "--replay",
    type=click.Path(readable=False),
    metavar="FILE",
    help="Send the samples of this recording, at its pace, and be the product that it names.",
)
@click.option(
    "--fault",
    multiple=True,
    metavar="WHAT",
    help="flip=P, drop=P (probabilities of each bit, byte), burst=S, stall=AT:S, unplug=AT:S or "
    "unplug=AT, in seconds, AT since power-up; repeatable.",
)
@click.option("--tcp", metavar="[HOST:]PORT", help="Serve on TCP; port 0 picks a free one.")
@click.option("--link", metavar="PATH", help="A symbolic link that leads to the port.")
@click.option(
    "--idle-timeout",
    type=click.FloatRange(min=0, min_open=True),
    metavar="S",
    help="With --tcp: disconnect a client that has neither sent nor taken a byte for S seconds.",
)
@click.option(
    "--speed",
    type=click.FloatRange(min=0, min_open=True),
    default=1,
    show_default=True,
    metavar="X",
    help="Seconds of device time per second.",
)
@click.option(
    "--duration",
    type=click.FloatRange(min=0),
    metavar="S",
    help="End after S seconds of device time.",
)
def sim(
    product: str | None,
    replay: str | None,
    tcp: str | None,
    link: str | None,
    idle_timeout: float | None,
    speed: float,
    duration: float | None,
    **options: str | bool | tuple[str, ...] | None,
) -> None:
    """A virtual device, in real time, until Ctrl-C.

    For work away from the hardware, and for tests of your own program: it answers every command that
    its product knows, and keeps its settings while it runs.

    It prints the line "port: PATH". Open PATH like the serial port of a device, with any program; with
    --tcp it is a URL for pyserial, socket://HOST:PORT, and one client at a time gets in. After a pulled
    plug there is a new port, and a new line.
    """
    with stop_requested() as is_stopped:
        from xbus.sim.device import BOOT_TIME, WAKE_UP_TIME
        from xbus.sim.serve import serve

        device = _device(product, replay, options)
        # Who has read the line may talk to it: it has started up.
        device.advance(BOOT_TIME + WAKE_UP_TIME)
        device.read()
        end = math.inf if duration is None else device.time + duration

        def until() -> bool:
            return is_stopped() or device.time >= end

        with _server(device, tcp, link, idle_timeout, speed) as server:
            serve(server, until, lambda port: print_line(f"port: {port}", now=True))


def _device(
    product: str | None,
    file: str | None,
    options: Mapping[str, str | bool | tuple[str, ...] | None],
) -> SimulatedDevice:
    from xbus.sim.device import SimulatedDevice
    from xbus.sim.options import parse_options

    replay = None if file is None else _replay(file)
    if product is None:
        product = _product_of(file, replay)
    try:
        return SimulatedDevice(product, replay=replay, **parse_options(_pairs(options)))
    except ValueError as error:
        raise click.UsageError(str(error)) from None


def _pairs(
    options: Mapping[str, str | bool | tuple[str, ...] | None],
) -> Iterator[tuple[str, str]]:
    """The options that were given, as `parse_options` takes them."""
    for name, value in options.items():
        for text in value if isinstance(value, tuple) else () if value is None else (value,):
            yield name, str(text)


def _replay(file: str) -> Replay:
    from xbus.sim.replay import Replay

    try:
        replay = Replay(file)
    except OSError as error:
        raise cannot(f"read {file}", error) from error
    if not len(replay):
        raise no_frame([file], os.path.getsize(file))  # noqa: PTH202 - the name as it was given
    return replay


def _product_of(file: str | None, replay: Replay | None) -> str:
    """The name of the product that a recording names."""
    from xbus.protocol.products import product_of_code
    from xbus.protocol.tables import PRODUCTS

    names = ", ".join(it.name for it in PRODUCTS.values())
    if replay is None:
        raise click.UsageError(f"--product is missing; there are {names}")
    code = replay.identity.product_code
    product = None if code is None else product_of_code(code)
    if product is None:
        named = "no product" if code is None else f"{code}, which is not known here"
        raise click.UsageError(f"{file} names {named}; choose a --product: {names}")
    return product.name


def _server(
    device: SimulatedDevice,
    tcp: str | None,
    link: str | None,
    idle_timeout: float | None,
    speed: float,
) -> Server:
    from xbus.sim.serve import PtyServer, TcpServer

    if tcp is None:
        if idle_timeout is not None:
            raise click.UsageError(
                "--idle-timeout is for --tcp: a pseudo-terminal has no clients to drop"
            )
        try:
            return PtyServer(device, link=link, speed=speed)
        except NotImplementedError as error:
            raise Failure(str(error)) from None
        except OSError as error:
            raise cannot(f"make {link or 'a pseudo-terminal'}", error) from error
    if link is not None:
        raise click.UsageError("--link leads to a pseudo-terminal; with --tcp there is none")
    host, _, number = tcp.rpartition(":")
    if not (number.isascii() and number.isdecimal() and int(number) < 1 << 16):
        raise click.UsageError(
            f"--tcp takes [HOST:]PORT, such as 5000 or 0.0.0.0:5000, not {tcp!r}"
        )
    try:
        return TcpServer(
            device,
            host.strip("[]") or "127.0.0.1",
            int(number),
            speed=speed,
            idle_timeout=idle_timeout,
        )
    except OSError as error:
        raise Failure(
            f"cannot listen on {tcp}: {error.strerror or error}; choose another port or address"
        ) from error
