"""The page that ``xbus info`` prints: 80 columns."""

from __future__ import annotations

import textwrap
from collections import Counter
from collections.abc import Iterable, Iterator

from xbus.cli.printing import align, bold
from xbus.describe.log_summary import Event, LogSummary
from xbus.describe.log_text import log_rows, quantity_rows
from xbus.describe.text import Notice

__all__ = ["page"]

WIDTH = 80
#: How many gaps, stretches of damage and events are shown; the rest is counted.
SHOWN = 5


def page(name: str, facts: LogSummary) -> str:
    """All that a person wants to know about a log."""
    lines = [bold(name), *(_line(*it) for it in log_rows(facts)), "", *_quantities(facts)]
    for title, section in (
        ("gaps", _gaps(facts)),
        ("damage", _damage(facts)),
        ("errors and warnings", _events(facts)),
        ("unknown data identifiers", _unknown(facts)),
    ):
        if rows := list(section):
            lines += ["", bold(title), *rows]
    return "\n".join(lines)


def _quantities(facts: LogSummary) -> Iterator[str]:
    if not facts.quantities:
        return
    first, *rest = align(list(quantity_rows(facts)), right=(2, 3))
    yield bold(first)
    yield from rest


def _gaps(facts: LogSummary) -> Iterator[str]:
    largest = sorted(facts.gaps, key=lambda it: -it.lost)[:SHOWN]
    if not largest:
        return
    rows = [("after/s", "lost", "next sample")]
    rows += [
        (_after(facts, it.time), f"{it.lost:,}", f"{it.sample:,}")
        for it in sorted(largest, key=lambda it: it.sample)
    ]
    yield from align(rows, right=(0, 1, 2))
    yield from _more(len(facts.gaps), "smaller")


def _damage(facts: LogSummary) -> Iterator[str]:
    if not facts.damage:
        return
    reasons = Counter(reason for _, _, reason in facts.damage)
    yield from textwrap.wrap(", ".join(f"{it} {n:,}" for it, n in reasons.most_common()), WIDTH)
    rows = [("offset", "bytes", "reason")]
    rows += [(f"{at:,}", f"{length:,}", reason) for at, length, reason in facts.damage[:SHOWN]]
    yield from align(rows, right=(0, 1))
    yield from _more(len(facts.damage), "more")


def _events(facts: LogSummary) -> Iterator[str]:
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


def _unknown(facts: LogSummary) -> Iterable[str]:
    rows = [("id", "packets", "bytes")]
    rows += [(f"0x{it:04X}", f"{n:,}", f"{size:,}") for it, (n, size) in facts.unknown.items()]
    return align(rows, right=(1, 2)) if facts.unknown else []


def _line(title: str, text: str) -> str:
    indent = f"{title:<10}"
    return textwrap.fill(text, WIDTH, initial_indent=indent, subsequent_indent=" " * len(indent))


def _after(facts: LogSummary, time: float | None) -> str:
    """Seconds since the first time stamp."""
    return "" if time is None else f"{time - facts.start:,.2f}"


def _more(number: int, which: str) -> Iterator[str]:
    if number > SHOWN:
        yield f"... and {number - SHOWN:,} {which}; --json lists all"
