"""Devices that commands talk to."""

from __future__ import annotations

import contextlib
import errno
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import click

from xbus.cli.failure import Failure
from xbus.errors import XbusError

if TYPE_CHECKING:
    from xbus.device import Device
    from xbus.wire.link import Link

__all__ = ["baudrate_option", "connect_device", "open_port", "port_lost"]

#: How commands are told the rate of a port.
baudrate_option = click.option(
    "--baudrate",
    type=click.IntRange(1, 4_000_000),
    metavar="RATE",
    help="Bits per second; without it, the usual ones are tried.",
)

#: What to do about a port that cannot be opened.
ADVICE = {
    errno.ENOENT: "xbus ports lists those that are there",
    errno.EACCES: "ask for the permission: mostly it is a group, dialout or uucp, that may use it",
    errno.EAGAIN: "another program uses it",
    errno.EBUSY: "another program uses it",
    errno.ECONNREFUSED: "does anything listen there?",
}


def connect_device(
    port: str, baudrate: int | None = None, *, bid: int = 0xFF, strings: Sequence[str] = ()
) -> Device:
    """The device behind a port, as `xbus.connect` finds it.

    Raises:
        Failure: The port cannot be opened.
        UsageError: It cannot be a port at all.
        XbusError: Nothing was heard.
    """
    from xbus.device import connect

    with _opening(port):
        return connect(port, baudrate, bid=bid, strings=strings)


def open_port(port: str, baudrate: int) -> Link:
    """What carries the bytes of a port, to listen to: nothing is sent.

    Raises:
        Failure: The port cannot be opened.
        UsageError: It cannot be a port at all.
    """
    from xbus.device.link import open_link

    with _opening(port):
        return open_link(port, baudrate)


@contextlib.contextmanager
def _opening(port: str) -> Iterator[None]:
    try:
        yield
    except XbusError:
        raise
    except OSError as error:
        number, words = _cause(error)
        advice = ADVICE.get(number, "xbus ports lists the serial ports")
        raise Failure(f"cannot open {port}: {words}; {advice}") from error
    except ValueError as error:
        raise click.UsageError(f"{port} is no port: {error}") from None


def port_lost(port: str, error: OSError) -> Failure:
    """The port went away while it was used."""
    words = _cause(error)[1].removeprefix("the port is gone: ")
    return Failure(f"{port} is gone: {words}; check the cable")


def _cause(error: OSError) -> tuple[int, str]:
    """Number and words of what the system said; pyserial wraps it in a sentence of its own."""
    match (error.__context__ or error).args:
        case (int(number), str(words), *_):
            return number, words
    return 0, str(error)
