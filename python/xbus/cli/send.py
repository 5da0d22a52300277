"""``xbus send``: sends a message and shows the answer."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import click

from xbus.cli.connection import baudrate_option, connect_device
from xbus.cli.failure import Failure
from xbus.cli.number_type import NumberRange
from xbus.cli.printing import find_name
from xbus.errors import StateError, XbusError

if TYPE_CHECKING:
    from xbus.device import Device, Session

__all__ = ["send"]

#: Default time to listen after --hex, whose answer is unknown, in seconds.
HEX_WAIT = 0.5


@click.command(
    epilog="Example: xbus send sim:MTi-630 --config SetOutputConfiguration"
    " data_id=Acceleration,frequency=100"
)
@click.argument("port")
@click.argument("words", nargs=-1, required=True, metavar="MESSAGE [FIELD=VALUE]...")
@click.option(
    "--hex",
    "as_hex",
    is_flag=True,
    help="MESSAGE is in hex: a complete frame (FA FF 30 00 D1), or a MID and payload (30).",
)
@click.option(
    "--config", is_flag=True, help="Send the message in Config State, and restore the state."
)
@baudrate_option
@click.option(
    "--bid",
    type=int,
    default=0xFF,
    show_default=True,
    metavar="N",
    help="Bus identifier (BID) of the device; 255 and 1 are the connected device.",
)
@click.option(
    "--wait",
    type=NumberRange(0, 3600),
    metavar="S",
    help=f"Listen for S more seconds. Default: 0, or {HEX_WAIT} with --hex.",
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object per line.")
def send(
    port: str,
    words: tuple[str, ...],
    as_hex: bool,
    config: bool,
    baudrate: int | None,
    bid: int,
    wait: float | None,
    as_json: bool,
) -> None:
    """Sends a message and shows the answer.

    Sent messages are marked with >, received messages with <; samples are only counted.

    PORT is a serial port, a pyserial URL (socket://HOST:PORT), a bus (i2c:/dev/i2c-1, spi:/dev/spidev0.0), or
    sim:PRODUCT for a virtual device. MESSAGE is a name that xbus messages lists. Its fields follow as
    FIELD=VALUE; for a list, each entry is one argument (data_id=0x4020,frequency=100). Values are numbers, or
    names from the manual, joined by | for flags. Invalid messages are not sent. With --config, the message is
    also checked against the product.
    """
    from xbus.cli.exchange import show_exchange
    from xbus.device import Session
    from xbus.wire.hextext import frame_from_hex

    name, value, frame = None, None, b""
    with _usage_errors():
        session = Session(bid=bid)
        if as_hex:
            frame = frame_from_hex(" ".join(words), bid=bid)
        else:
            name, value = _message(words, session)
    if wait is None:
        wait = HEX_WAIT if as_hex else 0
    with (
        connect_device(port, baudrate, bid=bid) as device,
        device.configure() if config else contextlib.nullcontext(),
        show_exchange(device, as_json=as_json) as exchange,
    ):
        if name is not None:
            _command(device, name, value, config=config)
        if frame:
            device.send(frame)
        device.listen(wait)
        if as_hex and exchange.error is not None:
            raise Failure(f"the device sent Error {exchange.error}")


@contextlib.contextmanager
def _usage_errors() -> Iterator[None]:
    """Converts errors that are found before the port is opened to usage errors."""
    try:
        yield
    except ValueError as error:
        raise click.UsageError(str(error)) from None


def _message(words: Sequence[str], session: Session) -> tuple[str, Any]:
    """Returns the name and the value of the message in the arguments."""
    from xbus.protocol.messages import LAYOUTS
    from xbus.protocol.tables import MESSAGES

    names = [row.name for row in MESSAGES.values() if row.direction != "to host"]
    name = find_name(words[0], names, "message to a device", "messages")
    try:
        value = LAYOUTS[name].read(list(words[1:]))
        session.validate(name, value)
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from None
    return name, value


def _command(device: Device, name: str, value: Any, *, config: bool) -> None:
    """Sends a command and waits for the answer."""
    try:
        device.command(name, value)
    except StateError as error:
        raise Failure(_state_problem(error, config=config)) from None
    except XbusError:
        raise
    except ValueError as error:  # the product does not support the command
        raise Failure(f"{error}; nothing was sent") from None


def _state_problem(error: StateError, *, config: bool) -> str:
    """Returns the problem with a remedy for the command line; the error itself names Python functions."""
    from xbus.protocol.tables import MESSAGES

    states = MESSAGES[error.command].states
    if error.state in states:  # the product is the problem
        return str(error)
    if "config" in states:
        remedy = "add --config, or send GoToConfig first"
    elif "measurement" in states:
        remedy = "remove --config" if config else "send GoToMeasurement first"
    else:
        remedy = "send GoToConfig, which is valid in any state"
    where = " or ".join(f"{state.capitalize()} State" for state in states)
    return f"{error.command} is valid in {where}, but the state is {error.state}; nothing was sent; {remedy}"
