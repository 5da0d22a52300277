"""The messages on the link of a device, one line each."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator, Sequence
from typing import Any

import click

from xbus.cli.printing import print_line
from xbus.describe.json_value import payload_value
from xbus.describe.text import ResultCode, describe_message, message_dict, read_result_code
from xbus.device import Device
from xbus.formatting import format_count
from xbus.protocol.ids import MessageId
from xbus.protocol.tables import MESSAGES
from xbus.protocol.values import State
from xbus.wire.codec import Damage, Scanner, encode_frame
from xbus.wire.link import Received
from xbus.wire.message import Message
from xbus.wire.strings import String

__all__ = ["Exchange", "show_exchange"]


@contextlib.contextmanager
def show_exchange(device: Device, *, as_json: bool) -> Iterator[Exchange]:
    """Shows the messages on the link of a device, even if an exception ends the exchange."""
    link = device.link
    exchange = Exchange(device, as_json=as_json)
    device.link = exchange
    try:
        yield exchange
    finally:
        device.link = link
        exchange.end()


class Exchange:
    """A link that shows the messages on another link.

    Args:
        device: The device with the other link.
        as_json: Whether to print JSON instead of text.

    Attributes:
        error: The last Error message; None if there was none.
    """

    def __init__(self, device: Device, *, as_json: bool) -> None:
        self._link, self._session = device.link, device.session
        self.name, self.is_line = self._link.name, self._link.is_line
        self.acquisition = self._link.acquisition
        self.error: ResultCode | None = None
        self._json = as_json
        self._scanner = Scanner()
        self._command = ""
        self._samples = self._strings = 0
        # In a stream of samples the first and the last bytes can be parts of a frame.
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
        """Offset in ns from arrival times to the time since 1970."""
        return self._link.epoch

    @property
    def trouble(self) -> str | None:
        """The problem of the port, or None."""
        return self._link.trouble

    def write(self, data: bytes) -> None:
        """Sends bytes."""
        scanner = Scanner()
        found = [*scanner.feed(data), *scanner.close()]
        ends = [*(item.offset for item in found[1:]), len(data)]
        for item, end in zip(found, ends, strict=True):
            self._print(">", item, data[item.offset : end])
            self._command = item.name if isinstance(item, Message) else ""
        self._link.write(data)

    def read(self, timeout: float) -> Received:
        """Returns the received bytes."""
        received = self._link.read(timeout)
        self._received(self._scanner.feed(received.data))
        return received

    def clock(self) -> float:
        """Returns the time in seconds."""
        return self._link.clock()

    def pause(self, seconds: float) -> None:
        """Waits."""
        self._link.pause(seconds)

    def reopen(self) -> None:
        """Reopens the link."""
        self._link.reopen()

    def close(self) -> None:
        """Closes the link."""
        self._link.close()

    def end(self) -> None:
        """Prints the last messages, and the number of samples and strings."""
        found = self._scanner.close()
        if self._streams and found and isinstance(found[-1], Damage):
            found.pop()
        self._received(found)
        for number, kind in ((self._samples, "sample"), (self._strings, "string")):
            if number:
                click.echo(f"xbus: {format_count(number, kind)} not shown", err=True)

    def _received(self, found: Sequence[Message | String | Damage]) -> None:
        for item in found:
            if isinstance(item, Damage):
                if item.offset or not self._streams:
                    self._print("<", item, b"")
            elif isinstance(item, String):
                self._strings += 1
                self._streams = True
            elif item.mid == MessageId.MTData2:
                self._samples += 1
                self._streams = True
            else:
                if item.mid == MessageId.Error:
                    self.error = read_result_code(item)
                frame = encode_frame(item.mid, item.payload, bid=item.bid)
                self._print("<", item._replace(name=self._name(item)), frame)

    def _name(self, message: Message) -> str:
        """Returns the name of a message; replies to several commands can have the same MID."""
        row = MESSAGES.get(self._command)
        if row is not None and message.mid == row.reply:
            with contextlib.suppress(ValueError):
                return self._session.read_reply(row.name, message.payload)[0]
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
