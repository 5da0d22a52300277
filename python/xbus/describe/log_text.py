"""A log in rows of words: what ``xbus info`` prints, and what a report begins with."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from xbus.describe.formatting import format_count
from xbus.describe.log_summary import LogSummary
from xbus.describe.text import device_name, finite, printable, recording_date

__all__ = ["format_utc", "log_rows", "quantity_rows"]


def log_rows(facts: LogSummary) -> Iterator[tuple[str, str]]:
    """What is said of a log as a whole: titles of a word, and what there is to say."""
    stats, told = facts.stats, facts.identity
    yield "size", f"{stats.bytes:,} bytes"
    yield "device", ", ".join(_device(facts))
    if told.configuration is not None and (when := recording_date(told.configuration)):
        yield "recorded", f"{when} by the clock of the recording computer"
    if facts.utc:
        yield "UTC", " to ".join(format_utc(it) for it in facts.utc)
    elif facts.utc_rows:
        yield "UTC", "sent, but never marked as valid"
    if finite(facts.duration) is not None:
        yield "duration", f"{facts.duration:,.2f} s"
    yield "samples", f"{stats.samples:,}"
    lost = f"{stats.lost_samples:,} in {format_count(stats.gaps, 'gap')}, by the packet counter"
    if stats.lost_samples:
        yield "lost", lost
    else:
        yield "lost", "none" if "packet_counter" in _names(facts) else "no counter to tell"
    share = f", {100 * stats.skipped_bytes / max(stats.bytes, 1):.2g} % of the file"
    damage = f"{stats.skipped_bytes:,} bytes in {format_count(len(facts.damage), 'place')}"
    yield "damage", damage + share if facts.damage else "none"
    if stats.malformed:
        yield "malformed", f"{stats.malformed:,}, by packets that do not fill their message"
    counts = ", ".join(f"{name} {count:,}" for name, count in facts.messages.items())
    yield "messages", counts or "none but samples"
    if facts.strings:
        yield "strings", ", ".join(f"{name} {count:,}" for name, count in facts.strings.items())


def _names(facts: LogSummary) -> set[str]:
    return {it.name for it in facts.quantities}


def _device(facts: LogSummary) -> Iterator[str]:
    told = facts.identity
    if told.product_code is None and told.device_id is None:
        yield "not named in this log"
    if told.product_code is not None:
        yield printable(told.product_code.encode())
    if told.device_id is not None:
        yield f"id {device_name(told.device_id)}"
    if told.firmware is not None:
        build = told.firmware.build
        yield f"firmware {told.firmware}" + ("" if build is None else f" build {build}")


def quantity_rows(facts: LogSummary) -> Iterator[tuple[str, ...]]:
    """The table of quantities: its head, then a row each."""
    yield "quantity", "coord.", "rows", "rate/Hz", "precision", "unit"
    for it in facts.quantities:
        rate = "" if finite(it.rate) is None else f"{it.rate:,.1f}"
        yield it.name, it.coordinates or "", f"{it.rows:,}", rate, it.precision or "", it.unit


def format_utc(time: np.datetime64) -> str:
    """UTC to the millisecond."""
    return str(time.astype("datetime64[ms]")).replace("T", " ")
