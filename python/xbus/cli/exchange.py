"""What goes over the link of a device, line by line."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator, Sequence
from typing import Any

import click

from xbus.cli.printing import print_line
from xbus.describe.formatting import format_count
from xbus.describe.json_value import payload_value
from xbus.describe.text import Notice, describe_message, message_dict, read_notice
from xbus.device import Device
from xbus.protocol.ids import MessageId
from xbus.protocol.tables import MESSAGES
from xbus.protocol.values import State
from xbus.wire.codec import Damage, Scanner, encode_frame
from xbus.wire.link import Received
from xbus.wire.message import Message
from xbus.wire.strings import String

__all__ = ["Exchange", "shown"]


@contextlib.contextmanager
def shown(device: Device, *, as_json: bool) -> Iterator[Exchange]:
    """Shows what goes over the link of a device, also if that ends badly."""
    link = device.link
    exchange = Exchange(device, as_json=as_json)
    device.link = exchange
    try:
        yield exchange
    finally:
        device.link = link
        exchange.end()


class Exchange:
    """A link that shows what goes over it.

    Args:
        device: Whose link it takes the place of.
        as_json: JSON instead of words.

    Attributes:
        error: What the last Error says that came; None if there was none.
    """

    def __init__(self, device: Device, *, as_json: bool) -> None:
        self._link, self._session = device.link, device.session
        self.name, self.is_line = self._link.name, self._link.is_line
        self.acquisition = self._link.acquisition
        self.error: Notice | None = None
        self._json = as_json
        self._scanner = Scanner()
        self._command = ""
        self._samples = self._strings = 0
        # Where samples come, the first bytes and the last ones may be a piece of one.
        self._streams = device.state != State.CONFIG

    @property
    def baudrate(self) -> int:
        """Bits per second."""
        return self._link.baudrate

    @baudrate.setter
    def baudrate(self, rate: int) -> None:
        self._link.baudrate = rate

    @property
    def epoch(self) -> int:
        """What to add to an arrival, in ns, for the time since 1970."""
        return self._link.epoch

    @property
    def trouble(self) -> str | None:
        """What is wrong with the port."""
        return self._link.trouble

    def write(self, data: bytes) -> None:
        """Sends."""
        scanner = Scanner()
        found = [*scanner.feed(data), *scanner.close()]
        ends = [*(it.offset for it in found[1:]), len(data)]
        for it, end in zip(found, ends, strict=True):
            self._show(">", it, data[it.offset : end])
            self._command = it.name if isinstance(it, Message) else ""
        self._link.write(data)

    def read(self, timeout: float) -> Received:
        """What has come."""
        received = self._link.read(timeout)
        self._hear(self._scanner.feed(received.data))
        return received

    def clock(self) -> float:
        """Seconds."""
        return self._link.clock()

    def pause(self, seconds: float) -> None:
        """Lets time pass."""
        self._link.pause(seconds)

    def reopen(self) -> None:
        """Opens it again."""
        self._link.reopen()

    def close(self) -> None:
        """Closes it."""
        self._link.close()

    def end(self) -> None:
        """Shows what has been held back."""
        found = self._scanner.close()
        if self._streams and found and isinstance(found[-1], Damage):
            found.pop()
        self._hear(found)
        for number, what in ((self._samples, "sample"), (self._strings, "string")):
            if number:
                click.echo(f"xbus: {format_count(number, what)} meanwhile", err=True)

    def _hear(self, found: Sequence[Message | String | Damage]) -> None:
        for it in found:
            if isinstance(it, Damage):
                if it.offset or not self._streams:
                    self._show("<", it, b"")
            elif isinstance(it, String):
                self._strings += 1
                self._streams = True
            elif it.mid == MessageId.MTData2:
                self._samples += 1
                self._streams = True
            else:
                if it.mid == MessageId.Error:
                    self.error = read_notice(it)
                frame = encode_frame(it.mid, it.payload, bid=it.bid)
                self._show("<", it._replace(name=self._name(it)), frame)

    def _name(self, message: Message) -> str:
        """The name of a message: under one MID come the replies to several commands."""
        row = MESSAGES.get(self._command)
        if row is not None and message.mid == row.reply:
            with contextlib.suppress(ValueError):
                return self._session.read_reply(row.name, message.payload)[0]
        return message.name

    def _show(self, way: str, it: Message | String | Damage, frame: bytes) -> None:
        hexed = frame.hex(" ").upper()
        if isinstance(it, Damage):
            facts: dict[str, Any] = {"length": it.length, "reason": it.reason}
            text = f"{format_count(it.length, 'byte')} that are no frame: {it.reason}"
        elif isinstance(it, String):
            facts = {"string": it.text}
            text = repr(it)
        else:
            facts = message_dict(it) | {"value": payload_value(it)}
            text = f"{it.name}  {describe_message(it)}"
        if self._json:
            direction = "to device" if way == ">" else "to host"
            facts = {"direction": direction, **facts, "frame": frame.hex().upper() or None}
            print_line(json.dumps(facts), now=True)
        else:
            print_line(f"{way} {hexed:<24}  {text}".rstrip(), now=True)
