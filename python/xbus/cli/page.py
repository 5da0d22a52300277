"""The page that ``xbus info`` prints: 80 columns."""

from __future__ import annotations

import textwrap
from collections import Counter
from collections.abc import Iterable, Iterator

import numpy as np

from xbus.cli.facts import Event, Facts
from xbus.cli.output import aligned, bold, count
from xbus.cli.words import Notice, device_name, finite, printable, recorded

__all__ = ["head", "moment", "page", "quantities"]

WIDTH = 80
#: How many gaps, stretches of damage and events are shown; the rest is counted.
SHOWN = 5


def page(name: str, facts: Facts) -> str:
    """All that a person wants to know about a log."""
    lines = [bold(name), *(_line(*it) for it in head(facts)), "", *_quantities(facts)]
    for title, section in (
        ("gaps", _gaps(facts)),
        ("damage", _damage(facts)),
        ("errors and warnings", _events(facts)),
        ("unknown data identifiers", _unknown(facts)),
    ):
        if rows := list(section):
            lines += ["", bold(title), *rows]
    return "\n".join(lines)


def head(facts: Facts) -> Iterator[tuple[str, str]]:
    """What is said of a log as a whole: titles of a word, and what there is to say."""
    stats, told = facts.stats, facts.identity
    yield "size", f"{stats.bytes:,} bytes"
    yield "device", ", ".join(_device(facts))
    if told.configuration is not None and (when := recorded(told.configuration)):
        yield "recorded", f"{when} by the clock of the recording computer"
    if facts.utc:
        yield "UTC", " to ".join(moment(it) for it in facts.utc)
    elif facts.utc_rows:
        yield "UTC", "sent, but never marked as valid"
    if finite(facts.duration) is not None:
        yield "duration", f"{facts.duration:,.2f} s"
    yield "samples", f"{stats.samples:,}"
    lost = f"{stats.lost_samples:,} in {count(stats.gaps, 'gap')}, by the packet counter"
    if stats.lost_samples:
        yield "lost", lost
    else:
        yield "lost", "none" if "packet_counter" in _names(facts) else "no counter to tell"
    share = f", {100 * stats.skipped_bytes / max(stats.bytes, 1):.2g} % of the file"
    damage = f"{stats.skipped_bytes:,} bytes in {count(len(facts.damage), 'place')}"
    yield "damage", damage + share if facts.damage else "none"
    if stats.malformed:
        yield "malformed", f"{stats.malformed:,}, by packets that do not fill their message"
    counts = ", ".join(f"{name} {count:,}" for name, count in facts.messages.items())
    yield "messages", counts or "none but samples"
    if facts.strings:
        yield "strings", ", ".join(f"{name} {count:,}" for name, count in facts.strings.items())


def _names(facts: Facts) -> set[str]:
    return {it.name for it in facts.quantities}


def _device(facts: Facts) -> Iterator[str]:
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


def quantities(facts: Facts) -> Iterator[tuple[str, ...]]:
    """The table of quantities: its head, then a row each."""
    yield "quantity", "coord.", "rows", "rate/Hz", "precision", "unit"
    for it in facts.quantities:
        rate = "" if finite(it.rate) is None else f"{it.rate:,.1f}"
        yield it.name, it.coordinates or "", f"{it.rows:,}", rate, it.precision or "", it.unit


def _quantities(facts: Facts) -> Iterator[str]:
    if not facts.quantities:
        return
    first, *rest = aligned(list(quantities(facts)), right=(2, 3))
    yield bold(first)
    yield from rest


def _gaps(facts: Facts) -> Iterator[str]:
    largest = sorted(facts.gaps, key=lambda it: -it.lost)[:SHOWN]
    if not largest:
        return
    rows = [("after/s", "lost", "next sample")]
    rows += [
        (_after(facts, it.time), f"{it.lost:,}", f"{it.sample:,}")
        for it in sorted(largest, key=lambda it: it.sample)
    ]
    yield from aligned(rows, right=(0, 1, 2))
    yield from _more(len(facts.gaps), "smaller")


def _damage(facts: Facts) -> Iterator[str]:
    if not facts.damage:
        return
    reasons = Counter(reason for _, _, reason in facts.damage)
    yield from textwrap.wrap(", ".join(f"{it} {n:,}" for it, n in reasons.most_common()), WIDTH)
    rows = [("offset", "bytes", "reason")]
    rows += [(f"{at:,}", f"{length:,}", reason) for at, length, reason in facts.damage[:SHOWN]]
    yield from aligned(rows, right=(0, 1))
    yield from _more(len(facts.damage), "more")


def _events(facts: Facts) -> Iterator[str]:
    """Each kind of event once: when it was first sent, and how often."""
    kinds: dict[tuple[str, Notice], list[Event]] = {}
    for it in facts.events:
        kinds.setdefault((it.name, it.notice), []).append(it)
    for (name, notice), events in list(kinds.items())[:SHOWN]:
        time = events[0].time
        when = "at the start" if time is None else f"after {_after(facts, time)} s"
        times = f", {len(events):,} times" if len(events) > 1 else ""
        yield from textwrap.wrap(f"{when}{times}: {name} {notice}", WIDTH, subsequent_indent="  ")
    yield from _more(len(kinds), "more kinds")


def _unknown(facts: Facts) -> Iterable[str]:
    rows = [("id", "packets", "bytes")]
    rows += [(f"0x{it:04X}", f"{n:,}", f"{size:,}") for it, (n, size) in facts.unknown.items()]
    return aligned(rows, right=(1, 2)) if facts.unknown else []


def _line(title: str, text: str) -> str:
    indent = f"{title:<10}"
    return textwrap.fill(text, WIDTH, initial_indent=indent, subsequent_indent=" " * len(indent))


def _after(facts: Facts, time: float | None) -> str:
    """Seconds since the first time stamp."""
    return "" if time is None else f"{time - facts.start:,.2f}"


def _more(number: int, which: str) -> Iterator[str]:
    if number > SHOWN:
        yield f"... and {number - SHOWN:,} {which}; --json lists all"


def moment(time: np.datetime64) -> str:
    """UTC to the millisecond."""
    return str(time.astype("datetime64[ms]")).replace("T", " ")
