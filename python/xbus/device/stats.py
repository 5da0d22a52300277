"""Counts of a live stream."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from xbus.protocol.tables import QUANTITIES

__all__ = ["LiveStats", "live_stats"]

_NAMES = {row.id: row.name for row in QUANTITIES.values()}


@dataclass(frozen=True)
class LiveStats:
    """Counts since the port was opened. Counting does not depend on reading.

    Attributes:
        bytes: Received bytes.
        frames: Frames in them.
        samples: MTData2 messages.
        messages: Other messages.
        malformed: MTData2 messages whose packets do not fill them.
        lost_samples: Samples missing by the packet counter.
        gaps: Places where samples are missing.
        checksum_errors: Candidates with a wrong checksum where a frame was expected.
        skipped_bytes: Bytes that belong to neither frame nor string.
        quantities: Number of packets by name of the quantity.
        strings: Number of strings by name; the name is empty for strings that are not in the manual.
        rates: Rates in Hz of quantities and strings by name, between the last two reads of the stats that are
            at least 0.5 s apart.
        unread_samples: Samples that wait to be read.
        dropped_samples: Samples dropped because a million newer ones were unread.
        queued_bytes: Bytes that wait to be decoded.
        dropped_bytes: Bytes dropped because the queue was full.
        overruns: Overruns of the driver or chip; None if the system does not count them.
        errors: Error messages.
        warnings: Warning messages.
        last_error: The latest error or warning in words, or None.
    """

    bytes: int
    frames: int
    samples: int
    messages: int
    malformed: int
    lost_samples: int
    gaps: int
    checksum_errors: int
    skipped_bytes: int
    quantities: dict[str, int]
    strings: dict[str, int]
    rates: dict[str, float]
    unread_samples: int
    dropped_samples: int
    queued_bytes: int
    dropped_bytes: int
    overruns: int | None
    errors: int
    warnings: int
    last_error: str | None


def live_stats(
    counted: dict[str, Any], rates: dict[str, float], unread: int, dropped: int, waiting: int
) -> LiveStats:
    """Returns the stats from the counts of `_core.Acquisition.stats` and of the queues."""
    names = LiveStats.__dataclass_fields__
    known = {key: value for key, value in counted.items() if key in names}
    known["queued_bytes"] += waiting
    known["quantities"] = by_name(counted["quantities"])
    return LiveStats(**known, rates=rates, unread_samples=unread, dropped_samples=dropped)


def by_name(quantities: dict[int, int]) -> dict[str, int]:
    """Returns counts by name; an identifier without a name is written in hex."""
    return {_NAMES.get(key, f"0x{key:04X}"): count for key, count in quantities.items()}
