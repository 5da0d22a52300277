"""The messages between the studio and a device, sent and received, in the order in which they came."""

from __future__ import annotations

import time
from collections import deque
from typing import NamedTuple

from xbus import _core
from xbus.describe.text import describe_message
from xbus.device.session import changes_settings
from xbus.formatting import format_count
from xbus.wire.codec import Damage, Scanner, encode_frame, named_item
from xbus.wire.message import Message
from xbus.wire.strings import String

__all__ = ["Entry", "Exchange"]

#: Entries to keep.
MAX_ENTRIES = 2000


class Entry(NamedTuple):
    """A message.

    Attributes:
        time: When it was seen, in seconds since 1970.
        is_sent: Whether it went to the device.
        name: Its name.
        text: Its content.
        frame: Its bytes; empty for damage.
    """

    time: float
    is_sent: bool
    name: str
    text: str
    frame: bytes


class Exchange:
    """Keeps the latest messages: a `xbus.device.channel.Trace`. Samples and strings are not among them."""

    def __init__(self) -> None:
        self.entries: deque[Entry] = deque(maxlen=MAX_ENTRIES)
        #: Number of entries so far, those that are gone included.
        self.count = 0
        #: Number of messages so far that may have changed a setting.
        self.settings_sent = 0

    def sent(self, data: bytes) -> None:
        """Adds bytes that were sent."""
        scanner = Scanner()
        for item in [*scanner.feed(data), *scanner.close()]:
            self._add(item, is_sent=True)
            if isinstance(item, Message) and changes_settings(item.name):
                self.settings_sent += 1

    def received(self, item: _core.ScannedFrame | _core.ScannedDamage) -> None:
        """Adds a message or damaged bytes."""
        self._add(named_item(item), is_sent=False)

    def _add(self, item: Message | String | Damage, *, is_sent: bool) -> None:
        frame = b""
        if isinstance(item, Message):
            name, text = item.name, describe_message(item)
            frame = encode_frame(item.mid, item.payload, bid=item.bid)
        elif isinstance(item, Damage):
            name, text = (
                "damage",
                f"{format_count(item.length, 'byte')} without a frame: {item.reason}",
            )
        else:
            name, text = "string", item.text
        self.entries.append(Entry(time.time(), is_sent, name, text, frame))
        self.count += 1
