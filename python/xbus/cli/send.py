"""``xbus send``: one message, and what comes back."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import click

from xbus.cli.output import hint, put

if TYPE_CHECKING:
    from xbus.device import Device, Link
    from xbus.log import Message

__all__ = ["send"]


@click.command(
    epilog="Examples: xbus send /dev/ttyUSB0 GoToConfig. xbus send sim:MTi-630 --config"
    " SetOutputConfiguration data_id=0x4020,frequency=100 data_id=0x1020. xbus send sim:MTi-300 --hex"
    " FA FF 30 00 D1"
)
@click.argument("port")
@click.argument("words", nargs=-1, required=True, metavar="MESSAGE [FIELD=VALUE]...")
@click.option(
    "--hex",
    "as_hex",
    is_flag=True,
    help="MESSAGE is a frame in hex, or a MID and its data; not checked.",
)
@click.option("--config", is_flag=True, help="Go to Config State for it, and back.")
@click.option("--baudrate", type=int, help="Bits per second; without it, the usual ones are tried.")
@click.option("--bid", type=click.IntRange(1, 255), default=0xFF, help="Bus identifier.")
@click.option(
    "--wait", type=click.FloatRange(0, 3600), default=0.5, help="Seconds to listen after --hex."
)
@click.option("--json", "as_json", is_flag=True, help="One JSON object a line.")
def send(
    port: str,
    words: tuple[str, ...],
    as_hex: bool,
    config: bool,
    baudrate: int | None,
    bid: int,
    wait: float,
    as_json: bool,
) -> None:
    """Sends a message and shows the exchange: > what went out, < what came back.

    PORT is a serial port, a URL of pyserial (socket://host:port) or sim:PRODUCT, a virtual device. MESSAGE is
    a name of `xbus messages`; its fields follow by name, for a list an entry each
    (data_id=0x4020,frequency=100). Values are numbers, or names as `xbus messages` and the manual have them,
    joined by | for flags. Samples are counted, not shown.

    A message is checked before it is sent: against the state of the device, and with --config against its
    product, too.
    """
    from xbus.device import connect

    name, value, frame = None, None, b""
    if as_hex:
        frame = _frame(words, bid)
    else:
        name, value = _message(words)
    with connect(port, baudrate, bid=bid) as device:
        shown = _Exchange(device.link, as_json=as_json)
        with device.configure() if config else contextlib.nullcontext():
            device.link = shown
            try:
                if name is not None:
                    device.command(name, value)
                else:
                    _listen(device, frame, wait)
            finally:
                shown.end()
                device.link = shown.link


def _listen(device: Device, frame: bytes, seconds: float) -> None:
    link = device.link
    link.write(frame)
    until = link.clock() + seconds
    while (left := until - link.clock()) > 0:
        link.read(left)


def _frame(words: Sequence[str], bid: int) -> bytes:
    """A frame as it stands, or one for a MID and its data."""
    from xbus.codec import encode_frame

    try:
        data = bytes.fromhex("".join(words).replace("0x", "").replace(",", ""))
    except ValueError:
        raise click.BadParameter("that is no hex; write bytes such as FA FF 30 00 D1") from None
    return data if data[:1] == b"\xfa" else encode_frame(data[0], data[1:], bid=bid)


def _message(words: Sequence[str]) -> tuple[str, Any]:
    """Name and value of the message that the words describe."""
    from xbus.protocol.messages import LAYOUTS, ROWS

    names = {it.name.lower(): it.name for it in ROWS.values() if it.direction != "to host"}
    name = names.get(words[0].lower())
    if name is None:
        advice = hint(words[0], names.values(), "messages")
        raise click.BadParameter(f"no message to a device is called {words[0]!r}; {advice}")
    try:
        return name, LAYOUTS[name].read(list(words[1:]))
    except ValueError as error:
        raise click.BadParameter(f"{name}: {error}") from None


class _Exchange:
    """A link that shows what goes through it."""

    def __init__(self, link: Link, *, as_json: bool) -> None:
        from xbus.codec import Scanner

        self.link = link
        self.name, self.is_line = link.name, link.is_line
        self._json = as_json
        self._scanner = Scanner()
        self._samples = 0

    @property
    def baudrate(self) -> int:
        return self.link.baudrate

    @baudrate.setter
    def baudrate(self, rate: int) -> None:
        self.link.baudrate = rate

    def write(self, data: bytes) -> None:
        from xbus.codec import Scanner

        scanner = Scanner()
        for it in [*scanner.feed(data), *scanner.close()]:
            self._show(">", it)
        self.link.write(data)

    def read(self, timeout: float) -> bytes:
        data = self.link.read(timeout)
        for it in self._scanner.feed(data):
            self._show("<", it)
        return data

    def clock(self) -> float:
        return self.link.clock()

    def reopen(self) -> None:
        self.link.reopen()

    def close(self) -> None:
        self.link.close()

    def end(self) -> None:
        """Shows what has been held back."""
        for it in self._scanner.close():
            self._show("<", it)
        if self._samples:
            click.echo(f"{self._samples} samples meanwhile", err=True)

    def _show(self, way: str, it: Any) -> None:
        from xbus.codec import Damage, encode_frame
        from xbus.ids import MessageId

        if isinstance(it, Damage):
            self._put(way, b"", f"{it.length} bytes that are no frame: {it.reason}", "")
        elif it.mid == MessageId.MTData2:
            self._samples += 1
        else:
            self._put(way, encode_frame(it.mid, it.payload, bid=it.bid), it.name, _said(it))

    def _put(self, way: str, frame: bytes, name: str, text: str) -> None:
        hexed = frame.hex(" ").upper()
        if self._json:
            direction = "to device" if way == ">" else "to host"
            put(
                json.dumps({"direction": direction, "frame": hexed, "name": name, "text": text}),
                now=True,
            )
        else:
            put(f"{way} {hexed:<24}  {name}  {text}".rstrip(), now=True)


def _said(message: Message) -> str:
    from xbus.cli.words import said

    return said(message)
