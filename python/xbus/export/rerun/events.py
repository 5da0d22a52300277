"""Events of a log: restarts, gaps, damage, messages of the device, and changes of its status."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from xbus.export.part import Part, PartColumn
from xbus.formatting import describe_losses, format_count
from xbus.protocol.ids import MessageId
from xbus.protocol.tables import COLUMN_QUANTITIES, STATUS_FLAGS
from xbus.wire.result_code import read_result_code

__all__ = ["Event", "StatusChanges", "events_of"]

#: Messages of a device that are events, and their levels.
MESSAGES = {MessageId.Error: "ERROR", MessageId.Warning: "WARN", MessageId.WakeUp: "INFO"}
#: Bits of the status that change all the time. Their events would hide the others.
MARKERS = ("sync_in_marker", "sync_out_marker", "have_gnss_time_pulse")
HIDDEN = sum(1 << STATUS_FLAGS[name].bit for name in MARKERS)
#: The bits that say that a sensor is out of its range.
CLIPPING = sum(1 << flag.bit for name, flag in STATUS_FLAGS.items() if name.startswith("clip"))


class Event(NamedTuple):
    """An event.

    Attributes:
        sample: Index of the sample that it belongs to, or else of the one that follows it.
        bid: Bus identifier of the device; None if it is not known.
        level: ``"INFO"``, ``"WARN"`` or ``"ERROR"``.
        text: What happened.
    """

    sample: int
    bid: int | None
    level: str
    text: str


def events_of(part: Part) -> Iterator[Event]:
    """Yields restarts, gaps, damage and messages."""
    for sample in part.restarts.tolist():
        bid = int(part.bid[sample - part.first_sample])
        yield Event(sample, bid, "WARN", "the device restarted")
    for sample, lost, bid in part.gaps.tolist():
        yield Event(sample, bid, "WARN", describe_losses(lost, 1, has_counter=True))
    damage = part.damage
    after = part.first_sample + np.searchsorted(part.offset, damage["offset"])
    for sample, (offset, length, reason) in zip(after.tolist(), damage.tolist(), strict=True):
        size = format_count(length, "byte")
        yield Event(sample, None, "WARN", f"{size} of damage at byte {offset:,}: {reason}")
    for message in part.messages.with_mids(*MESSAGES):
        text = message.name
        if message.mid != MessageId.WakeUp:
            text = f"{text} {read_result_code(message)}"
        yield Event(message.sample, message.bid, MESSAGES[MessageId(message.mid)], text)


class StatusChanges:
    """The status of a device and its changes, part by part."""

    def __init__(self) -> None:
        self._last = -1

    def of(self, column: PartColumn, rows: npt.NDArray[np.intp], bid: int) -> Iterator[Event]:
        """Yields an event for each change.

        Args:
            column: ``status_word`` or ``status_byte``.
            rows: The rows of the device.
            bid: Bus identifier of the device.
        """
        flags = COLUMN_QUANTITIES[column.name].flags
        words = column.values[rows].astype(np.int64) & ~HIDDEN
        before = np.concatenate(([self._last], words[:-1]))
        self._last = int(words[-1]) if len(words) else self._last
        for row in np.flatnonzero(words != before).tolist():
            word = int(words[row])
            names = (
                flag.name if flag.width == 1 else f"{flag.name}={flag.of(word)}"
                for flag in flags
                if flag.of(word)
            )
            level = "WARN" if word & CLIPPING else "INFO"
            sample = int(column.sample[rows[row]])
            yield Event(sample, bid, level, f"status: {', '.join(names) or 'no flag'}")
