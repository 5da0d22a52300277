"""``xbus send``: one message, and what comes back."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import click

from xbus.cli.connection import baudrate_option, connect_device, port_lost
from xbus.cli.failure import Failure
from xbus.cli.printing import find_name
from xbus.errors import StateError, XbusError

if TYPE_CHECKING:
    from xbus.device import Device, Session

__all__ = ["send"]

#: Seconds to listen after bytes of which nobody knows what answers them.
LISTEN = 0.5


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
    help="MESSAGE is in hex: a frame (FA FF 30 00 D1), sent as it is, or a MID and data (30).",
)
@click.option("--config", is_flag=True, help="Go to Config State for it, and back.")
@baudrate_option
@click.option(
    "--bid",
    type=int,
    default=0xFF,
    show_default=True,
    metavar="N",
    help="Bus identifier to address; 255 and 1 are the device itself.",
)
@click.option(
    "--wait",
    type=click.FloatRange(0, 3600),
    metavar="S",
    help=f"Listen so many seconds longer; {LISTEN} with --hex.",
)
@click.option("--json", "as_json", is_flag=True, help="One JSON object a line.")
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

    What goes out is shown behind >, what comes in behind <; samples are counted.

    PORT is a serial port, a URL of pyserial (socket://HOST:PORT) or sim:PRODUCT, a virtual device.
    MESSAGE is a name of `xbus messages`; its fields follow by name, for a list an entry each
    (data_id=0x4020,frequency=100). Values are numbers, or names as the manual has them, joined by | for
    flags. What cannot be right is not sent: with --config, what the product cannot do, too.
    """
    from xbus.cli.exchange import shown
    from xbus.device import Session

    name, value, frame = None, None, b""
    with _wrong_call():
        session = Session(bid=bid)
        if as_hex:
            frame = _frame(words, bid)
        else:
            name, value = _message(words, session)
    if wait is None:
        wait = LISTEN if as_hex else 0
    with (
        connect_device(port, baudrate, bid=bid) as device,
        device.configure() if config else contextlib.nullcontext(),
        shown(device, as_json=as_json) as exchange,
    ):
        if name is not None:
            _command(device, name, value, config=config)
        _listen(device, wait, frame)
        if as_hex and exchange.error is not None:
            raise Failure(f"the device sent Error {exchange.error}")


@contextlib.contextmanager
def _wrong_call() -> Iterator[None]:
    """What is found out before the port is opened is the fault of the call."""
    try:
        yield
    except ValueError as error:
        raise click.UsageError(str(error)) from None


def _frame(words: Sequence[str], bid: int) -> bytes:
    """A frame as it stands, or one for a MID and its data."""
    from xbus.protocol.tables import PREAMBLE
    from xbus.wire.codec import encode_frame

    text = " ".join(words)
    try:
        data = bytes.fromhex(text.lower().replace("0x", "").replace(",", " "))
    except ValueError:
        data = b""
    if not data:
        raise ValueError(f"{text!r} is no hex; write bytes, such as FA FF 30 00 D1")
    return data if data[0] == PREAMBLE else encode_frame(data[0], data[1:], bid=bid)


def _message(words: Sequence[str], session: Session) -> tuple[str, Any]:
    """Name and value of the message that the words describe."""
    from xbus.protocol.messages import LAYOUTS
    from xbus.protocol.tables import MESSAGES

    names = [it.name for it in MESSAGES.values() if it.direction != "to host"]
    name = find_name(words[0], names, "message to a device", "messages")
    try:
        value = LAYOUTS[name].read(list(words[1:]))
        session.validate(name, value)
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from None
    return name, value


def _command(device: Device, name: str, value: Any, *, config: bool) -> None:
    """Sends a command and waits for its answer."""
    try:
        device.command(name, value)
    except StateError as error:
        raise Failure(_not_now(error, config=config)) from None
    except XbusError:
        raise
    except ValueError as error:  # it is the product that cannot do it
        raise Failure(f"{error}; nothing was sent") from None


def _not_now(error: StateError, *, config: bool) -> str:
    """What the command line says of a state: the advice in the error is for programs."""
    from xbus.protocol.tables import MESSAGES

    states = MESSAGES[error.command].states
    if error.state in states:  # so it is the product
        return str(error)
    if "config" in states:
        advice = "add --config, or send GoToConfig first"
    elif "measurement" in states:
        advice = "leave out --config" if config else "send GoToMeasurement first"
    else:
        advice = "GoToConfig leads to Config State at any time"
    where = " or ".join(f"{it.capitalize()} State" for it in states)
    return f"{error.command} is valid in {where}, but the state is {error.state}; nothing was sent; {advice}"


def _listen(device: Device, wait: float, data: bytes) -> None:
    """Sends bytes as they are, if there are any, and takes in what comes for so many seconds."""
    link = device.link
    try:
        if data:
            link.write(data)
        until = link.clock() + wait
        while (left := until - link.clock()) > 0:
            # The session learns from it in which state the device is.
            device.session.receive(link.read(left).data)
    except OSError as error:
        raise port_lost(link.name, error) from error
