"""``xbus sim``: simulates a device on a virtual serial port."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

import click

from xbus.cli.failure import Failure, cannot, stop_requested
from xbus.cli.inputs import no_frame
from xbus.cli.number_type import NumberRange
from xbus.cli.printing import print_line
from xbus.cli.recordings import show_unread_piece
from xbus.errors import BusError

if TYPE_CHECKING:
    from xbus.sim.device import SimulatedDevice
    from xbus.sim.replay import Replay
    from xbus.sim.serve import Server

__all__ = ["sim"]


@click.command(epilog="Example: xbus sim --product MTi-680G --trajectory drive --link /tmp/mti")
@click.option("--product", metavar="NAME", help="Product: MTi-3, MTi-680G, ...")
@click.option(
    "--baudrate",
    metavar="RATE",
    help="Simulate a serial line at this baud rate, which the client must set. Default: any, as on USB.",
)
@click.option(
    "--trajectory",
    metavar="NAME",
    help="Motion: still, turn, tumble, walk, drive, fly or sail.  [default: walk]",
)
@click.option(
    "--noise",
    metavar="X",
    help="Sensor noise; 1 is about the noise in the data sheet.  [default: 0]",
)
@click.option("--seed", metavar="N", help="Seed of all random numbers.  [default: 0]")
@click.option("--device-id", metavar="ID", help="Device identifier, in hexadecimal.")
@click.option("--firmware", metavar="VERSION", help="Firmware revision, such as 1.8.0.")
@click.option("--utc", metavar="TIME", help="UTC at power-up, such as 2026-11-28T12:00:00.")
@click.option(
    "--time-to-fix", metavar="S", help="Seconds from power-up to the first GNSS fix.  [default: 3]"
)
@click.option(
    "--strict-outputs/--no-strict-outputs",
    default=None,
    help="Whether the device refuses an output configuration with an unsupported data identifier, or drops "
    "the identifier.  [default: strict-outputs]",
)
@click.option(
    "--can",
    metavar="BUS",
    help="Send CAN on this bus of python-can, once the device is configured for it: "
    "udp_multicast:239.74.163.2, socketcan:vcan0, or another interface. For MTi-600 devices.",
)
@click.option(
    "--replay",
    type=click.Path(readable=False),
    metavar="FILE",
    help="Send the samples of this recording at its pace, as the product in the recording.",
)
@click.option(
    "--fault",
    multiple=True,
    metavar="WHAT",
    help="Simulate a fault: flip=P and drop=P (probability per bit, byte), burst=S, stall=AT:S, unplug=AT:S "
    "or unplug=AT, in seconds, AT since power-up; repeatable.",
)
@click.option("--tcp", metavar="[HOST:]PORT", help="Serve on TCP; port 0 selects a free port.")
@click.option("--link", metavar="PATH", help="Create a symbolic link to the port.")
@click.option(
    "--idle-timeout",
    type=NumberRange(min=0, min_open=True),
    metavar="S",
    help="With --tcp: disconnect a client that has neither sent nor read a byte for S seconds.",
)
@click.option(
    "--speed",
    type=NumberRange(min=0, min_open=True),
    default=1,
    show_default=True,
    metavar="X",
    help="Seconds of device time per second.",
)
@click.option(
    "--duration",
    type=NumberRange(min=0),
    metavar="S",
    help="Exit after S seconds of device time.",
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
    """Simulates a device in real time until Ctrl-C.

    For development without hardware, and for tests: the virtual device answers every command of its product,
    and keeps its settings while it runs.

    Prints the line "port: PATH". Any program can open PATH like the serial port of a device. With --tcp, PATH
    is a pyserial URL, socket://HOST:PORT, for one client at a time. After a simulated unplug there is a new
    port, and a new line.
    """
    with stop_requested() as is_stopping:
        from xbus.sim.device import BOOT_TIME, WAKE_UP_TIME
        from xbus.sim.serve import serve

        device = _device(product, replay, options)
        # The device has started when the line is printed.
        device.advance(BOOT_TIME + WAKE_UP_TIME)
        device.read()
        end = math.inf if duration is None else device.time + duration

        def until() -> bool:
            return is_stopping() or device.time >= end

        with _server(device, tcp, link, idle_timeout, speed) as server:
            serve(server, until, lambda port: print_line(f"port: {port}", flush=True))


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
    except BusError as error:
        raise Failure(str(error)) from error


def _pairs(
    options: Mapping[str, str | bool | tuple[str, ...] | None],
) -> Iterator[tuple[str, str]]:
    """Yields the given options in the form of `parse_options`."""
    for name, value in options.items():
        for text in value if isinstance(value, tuple) else () if value is None else (value,):
            yield name, str(text)


def _replay(file: str) -> Replay:
    from xbus.sim.replay import Replay

    show_unread_piece(file)
    try:
        replay = Replay(file)
    except OSError as error:
        raise cannot(f"read {file}", error) from error
    if not len(replay):
        raise no_frame([file], os.path.getsize(file))  # noqa: PTH202 - the name as the user wrote it
    return replay


def _product_of(file: str | None, replay: Replay | None) -> str:
    """Returns the product in a recording."""
    from xbus.protocol.products import product_of_code
    from xbus.protocol.tables import LEGACY_PRODUCTS, PRODUCTS

    products = (*PRODUCTS.values(), *LEGACY_PRODUCTS.values())
    names = ", ".join(product.name for product in products)
    if replay is None:
        raise click.UsageError(f"--product is missing; choose from {names}")
    code = replay.identity.product_code
    product = None if code is None else product_of_code(code)
    if product is None:
        problem = "no product" if code is None else f"the unknown product {code}"
        raise click.UsageError(f"{file} has {problem}; choose a --product: {names}")
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
        raise click.UsageError("--link needs a pseudo-terminal and cannot be combined with --tcp")
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
