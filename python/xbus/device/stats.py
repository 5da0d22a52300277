"""What was counted of a device's stream."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from xbus.protocol.tables import QUANTITIES

__all__ = ["LiveStats", "live_stats"]

_NAMES = {it.id: it.name for it in QUANTITIES.values()}


@dataclass(frozen=True)
class LiveStats:
    """What was counted since the port was opened. Counting goes on whether anybody reads or not.

    Attributes:
        bytes: Bytes that came.
        frames: Frames in them.
        samples: MTData2 messages.
        messages: Other messages.
        malformed: MTData2 messages whose packets do not fill them.
        lost_samples: Samples that the packet counter says are missing.
        gaps: In how many places.
        checksum_errors: Candidates refused by their checksum where a frame was due.
        skipped_bytes: Bytes that belong to neither frame nor string.
        quantities: How many packets of each quantity came, by name.
        strings: How many strings came, by name; the name of those that the manual does not list is empty.
        rates: Both in Hz, since the stats were last asked for (over half a second at least).
        unread_samples: Samples that have been taken in and that nobody has read.
        dropped_samples: Samples that were dropped because a million later ones were not read either.
        queued_bytes: Bytes that wait to be taken in.
        dropped_bytes: Bytes that were dropped because the queue was full.
        overruns: How often driver or chip had no room for what came; None where nobody counts.
        errors: Error messages that came.
        warnings: Warning messages that came.
        last_error: The latest of both, in words, or None.
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
    """The stats of what `_core.Acquisition.stats` has counted."""
    names = LiveStats.__dataclass_fields__
    known = {key: value for key, value in counted.items() if key in names}
    known["queued_bytes"] += waiting
    known["quantities"] = by_name(counted["quantities"])
    return LiveStats(**known, rates=rates, unread_samples=unread, dropped_samples=dropped)


def by_name(quantities: dict[int, int]) -> dict[str, int]:
    """Counts by name; an identifier that the tables do not have stays a number, in hex."""
    return {_NAMES.get(key, f"0x{key:04X}"): count for key, count in quantities.items()}
