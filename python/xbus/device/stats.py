"""Counts of a live stream."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeVar

from xbus.protocol.tables import COLUMN_QUANTITIES

__all__ = ["LiveStats", "live_stats"]

T = TypeVar("T", int, float)

_NAMES = {row.id: row.name for row in COLUMN_QUANTITIES.values()}


@dataclass(frozen=True)
class LiveStats:
    """Counts since the port was opened. They never decrease, and do not depend on reading.

    A loss is in one count: the device did not send it, or the line lost it without a trace (`lost_samples`);
    it arrived damaged (`skipped_bytes`, and a gap if it was a sample); the driver had no room
    (`overruns`); the program did not read it (``dropped_...``).

    Attributes:
        bytes: Received bytes.
        frames: Frames in them.
        samples: MTData2 messages, and MTData messages whose settings are known.
        messages: Other messages.
        message_counts: Number of these by message identifier.
        malformed: MTData2 messages whose packets do not fill them.
        unfit: MTData messages whose settings are not known or do not fit, and those of an Xbus Master.
        lost_samples: Samples missing by the packet counter.
        gaps: Places where samples are missing.
        checksum_errors: Candidates with a wrong checksum where a frame was expected.
        skipped_bytes: Bytes that belong to neither frame nor string.
        quantities: Number of packets by name of the quantity.
        strings: Number of strings by name; the name is empty for strings that are not in the manual.
        rates: Rates in Hz of quantities and strings by name, over the last two seconds; empty in the first
            half second.
        message_rates: Rates in Hz of other messages by message identifier, likewise.
        unread_samples: Samples that wait to be read.
        dropped_samples: Samples dropped unread because newer ones filled the queue.
        dropped_strings: Strings dropped unread, likewise.
        dropped_messages: Messages dropped because the program handled none for long.
        outdated: Samples and strings removed unread because new settings took effect.
        queued_bytes: Bytes of samples, strings and messages that wait to be read.
        overruns: Overruns of the driver or chip; on I²C and SPI, reports of the device that a pipe was full.
            None if the system does not count them.
        transfer_errors: Transfers on I²C or SPI that failed, or that returned what no MTi sends. They are
            repeated. None for other ports.
        errors: Error messages.
        warnings: Warning messages.
        last_error: The latest error or warning in words, or None.
    """

    bytes: int
    frames: int
    samples: int
    messages: int
    message_counts: dict[int, int]
    malformed: int
    unfit: int
    lost_samples: int
    gaps: int
    checksum_errors: int
    skipped_bytes: int
    quantities: dict[str, int]
    strings: dict[str, int]
    rates: dict[str, float]
    message_rates: dict[int, float]
    unread_samples: int
    dropped_samples: int
    dropped_strings: int
    dropped_messages: int
    outdated: int
    queued_bytes: int
    overruns: int | None
    transfer_errors: int | None
    errors: int
    warnings: int
    last_error: str | None


def live_stats(stats: dict[str, Any], outdated: int) -> LiveStats:
    """Returns the stats from those of `_core.Acquisition.stats`, and the number of outdated samples."""
    counts, rates, dropped = stats["counts"], stats["rates"], stats["dropped"]
    losses, message_counts = counts.pop("losses"), counts.pop("mids")
    return LiveStats(
        **counts | {"quantities": by_name(counts["quantities"])},
        message_counts=message_counts,
        lost_samples=losses["samples"],
        gaps=losses["gaps"],
        rates=by_name(rates["quantities"]) | rates["strings"],
        message_rates=rates["mids"],
        unread_samples=stats["unread"],
        dropped_samples=dropped["samples"],
        dropped_strings=dropped["strings"],
        dropped_messages=dropped["messages"],
        outdated=outdated,
        queued_bytes=stats["queued"],
        overruns=stats["overruns"],
        transfer_errors=stats["transfer_errors"],
    )


def by_name(quantities: dict[int, T]) -> dict[str, T]:
    """Returns counts or rates by name; an identifier without a name is written in hex."""
    return {_NAMES.get(key, f"0x{key:04X}"): value for key, value in quantities.items()}
