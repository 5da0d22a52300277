"""The messages on the link of a device, one line each."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator
from typing import Any

import click

from xbus import _core
from xbus.cli.printing import print_line
from xbus.describe.json_value import payload_value
from xbus.describe.text import describe_message, message_dict
from xbus.device import Device
from xbus.formatting import format_count
from xbus.protocol.ids import MessageId
from xbus.protocol.tables import MESSAGES
from xbus.protocol.values import State
from xbus.wire.codec import Damage, Scanner, encode_frame, named_item
from xbus.wire.message import Message
from xbus.wire.result_code import ResultCode, read_result_code
from xbus.wire.strings import String

__all__ = ["Exchange", "show_exchange"]


@contextlib.contextmanager
def show_exchange(device: Device, *, as_json: bool) -> Iterator[Exchange]:
    """Shows the messages between host and device, even if an exception ends the exchange."""
    exchange = Exchange(device, as_json=as_json)
    device.trace(exchange)
    try:
        yield exchange
    finally:
        exchange.end()
        device.trace(None)


class Exchange:
    """Shows the messages between host and device: a `xbus.device.channel.Trace`.

    Args:
        device: The device.
        as_json: Whether to print JSON instead of text.

    Attributes:
        error: The last Error message; None if there was none.
    """

    def __init__(self, device: Device, *, as_json: bool) -> None:
        self._device = device
        self.error: ResultCode | None = None
        self._json = as_json
        self._command = ""
        # In a stream of samples the first and the last bytes can be parts of a frame.
        self._streams = device.state != State.CONFIG
        self._before = device.stats

    def sent(self, data: bytes) -> None:
        """Prints the frames in bytes that were sent."""
        scanner = Scanner()
        found = [*scanner.feed(data), *scanner.close()]
        ends = [*(item.offset for item in found[1:]), len(data)]
        for item, end in zip(found, ends, strict=True):
            self._print(">", item, data[item.offset : end])
            self._command = item.name if isinstance(item, Message) else ""

    def received(self, item: _core.ScannedFrame | _core.ScannedDamage) -> None:
        """Prints a message or damage."""
        found = named_item(item)
        if isinstance(found, Message):
            if found.mid == MessageId.Error:
                self.error = read_result_code(found)
            frame = encode_frame(found.mid, found.payload, bid=found.bid)
            self._print("<", found._replace(name=self._name(found)), frame)
        elif found.offset or not self._streams:
            self._print("<", found, b"")

    def end(self) -> None:
        """Prints the last messages, and the number of samples and strings."""
        before, stats = self._before, self._device.stats
        samples = stats.samples - before.samples
        strings = sum(stats.strings.values()) - sum(before.strings.values())
        if not (self._streams or samples or strings):
            self._device.link.acquisition.interrupt()
        self._device.listen(0)
        for number, kind in ((samples, "sample"), (strings, "string")):
            if number:
                click.echo(f"xbus: {format_count(number, kind)} not shown", err=True)

    def _name(self, message: Message) -> str:
        """Returns the name of a message; replies to several commands can have the same MID."""
        row = MESSAGES.get(self._command)
        if row is not None and message.mid == row.reply:
            with contextlib.suppress(ValueError):
                return self._device.session.read_reply(row.name, message.payload)[0]
        return message.name

    def _print(self, direction: str, item: Message | String | Damage, frame: bytes) -> None:
        fields: dict[str, Any]
        if isinstance(item, Damage):
            fields = {"length": item.length, "reason": item.reason}
            text = f"{format_count(item.length, 'byte')} without a frame: {item.reason}"
        elif isinstance(item, String):
            fields = {"string": item.text}
            text = repr(item)
        else:
            fields = message_dict(item) | {"value": payload_value(item)}
            text = f"{item.name}  {describe_message(item)}"
        if self._json:
            where = "to device" if direction == ">" else "to host"
            fields = {"direction": where, **fields, "frame": frame.hex().upper() or None}
            print_line(json.dumps(fields), flush=True)
        else:
            print_line(f"{direction} {frame.hex(' ').upper():<24}  {text}".rstrip(), flush=True)
