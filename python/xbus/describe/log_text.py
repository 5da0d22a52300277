"""A `LogSummary` as rows of text, for ``xbus info`` and reports."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from xbus.describe.log_summary import LogSummary
from xbus.describe.text import device_name, finite, printable, recording_date
from xbus.formatting import describe_damage, describe_losses, format_count
from xbus.protocol.undecoded import NO_ORIENTATION, describe_undecoded

__all__ = ["format_utc", "log_rows", "quantity_rows"]


def log_rows(summary: LogSummary) -> Iterator[tuple[str, str]]:
    """Yields title and text of each row about the log as a whole."""
    stats, configuration = summary.stats, summary.identity.configuration
    yield "size", f"{stats.bytes:,} bytes"
    yield "device", ", ".join(_device(summary))
    if configuration is not None and (date := recording_date(configuration)):
        yield "recorded", f"{date} by the clock of the recording computer"
    if summary.utc:
        yield "UTC", " to ".join(map(format_utc, summary.utc))
    elif summary.utc_rows:
        yield "UTC", "sent, but never marked as valid"
    if finite(summary.duration) is not None:
        yield "duration", f"{summary.duration:,.2f} s"
    yield "samples", f"{stats.samples:,}"
    if summary.has_counter or not summary.trackers:
        losses = describe_losses(stats.lost_samples, stats.gaps, has_counter=summary.has_counter)
        yield "losses", losses
    damage = describe_damage(stats.skipped_bytes, len(summary.damage))
    share = f", {100 * stats.skipped_bytes / max(stats.bytes, 1):.2g} % of the file"
    yield "damage", damage + share if summary.damage else damage
    if stats.malformed:
        yield "malformed", f"{stats.malformed:,}: the packets do not fill the message"
    messages = ", ".join(f"{name} {count:,}" for name, count in summary.messages.items())
    yield "messages", messages or "none but samples"
    if summary.undecoded:
        yield "undecoded", describe_undecoded(summary.undecoded)
    if summary.trackers:
        yield "trackers", "; ".join(_trackers(summary))
        yield "", NO_ORIENTATION
    if summary.strings:
        yield "strings", ", ".join(f"{name} {count:,}" for name, count in summary.strings.items())


def _trackers(summary: LogSummary) -> Iterator[str]:
    for tracker in summary.trackers:
        losses = describe_losses(tracker.lost_samples, tracker.gaps, has_counter=True)
        yield f"{tracker.device_id} {format_count(tracker.rows, 'row')}, {losses}"


def _device(summary: LogSummary) -> Iterator[str]:
    identity = summary.identity
    if identity.product_code is None and identity.device_id is None:
        yield "not named in this log"
    if identity.product_code is not None:
        yield printable(identity.product_code.encode())
    if identity.device_id is not None:
        yield f"id {device_name(identity.device_id)}"
    if identity.firmware is not None:
        build = identity.firmware.build
        yield f"firmware {identity.firmware}" + ("" if build is None else f" build {build}")


def quantity_rows(summary: LogSummary) -> Iterator[tuple[str, ...]]:
    """Yields the header of the table of quantities, then one row per quantity."""
    yield "quantity", "coord.", "rows", "rate/Hz", "precision", "unit"
    for quantity in summary.quantities:
        rate = "" if finite(quantity.rate) is None else f"{quantity.rate:,.1f}"
        coordinates, precision = quantity.coordinates or "", quantity.precision or ""
        yield quantity.name, coordinates, f"{quantity.rows:,}", rate, precision, quantity.unit


def format_utc(time: np.datetime64) -> str:
    """Returns a time to the millisecond: ``"2026-11-22 09:29:59.000"``."""
    return str(time.astype("datetime64[ms]")).replace("T", " ")
