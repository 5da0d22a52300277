"""The text that ``xbus info`` prints, 80 columns wide."""

from __future__ import annotations

import textwrap
from collections import Counter
from collections.abc import Iterable, Iterator

from xbus.cli.printing import align, bold
from xbus.describe.log_summary import Event, LogSummary, Stamp
from xbus.describe.log_text import log_rows, quantity_rows
from xbus.describe.text import ResultCode

__all__ = ["info_text"]

WIDTH = 80
#: Maximum number of gaps, places of damage and events; the rest is counted.
MAX_ROWS = 5


def info_text(name: str, summary: LogSummary) -> str:
    """Returns the description of a log."""
    lines = [bold(name), *(_line(*row) for row in log_rows(summary)), "", *_quantities(summary)]
    for title, section in (
        ("gaps", _gaps(summary)),
        ("damage", _damage(summary)),
        ("errors and warnings", _events(summary)),
        ("unknown data identifiers", _unknown(summary)),
    ):
        if rows := list(section):
            lines += ["", bold(title), *rows]
    return "\n".join(lines)


def _quantities(summary: LogSummary) -> Iterator[str]:
    if not summary.quantities:
        return
    first, *rest = align(list(quantity_rows(summary)), right=(2, 3))
    yield bold(first)
    yield from rest


def _gaps(summary: LogSummary) -> Iterator[str]:
    largest = sorted(summary.gaps, key=lambda gap: -gap.lost)[:MAX_ROWS]
    if not largest:
        return
    # The time of the last sample before the gap.
    rows: list[tuple[str, ...]] = [("BID", "after/s", "lost", "next sample")]
    rows += [
        (f"{gap.bid}", _format_time(summary, gap.before), f"{gap.lost:,}", f"{gap.sample:,}")
        for gap in sorted(largest, key=lambda gap: gap.sample)
    ]
    if len(summary.devices) < 2:
        rows = [row[1:] for row in rows]
    yield from align(rows, right=range(len(rows[0])))
    yield from _rest(len(summary.gaps), "smaller")


def _damage(summary: LogSummary) -> Iterator[str]:
    if not summary.damage:
        return
    reasons = Counter(reason for _, _, reason in summary.damage)
    counts = ", ".join(f"{reason} {n:,}" for reason, n in reasons.most_common())
    yield from textwrap.wrap(counts, WIDTH)
    rows = [("offset", "bytes", "reason")]
    rows += [(f"{at:,}", f"{length:,}", why) for at, length, why in summary.damage[:MAX_ROWS]]
    yield from align(rows, right=(0, 1))
    yield from _rest(len(summary.damage), "more")


def _events(summary: LogSummary) -> Iterator[str]:
    """Yields each kind of event once, with its first time and its number."""
    kinds: dict[tuple[str, ResultCode], list[Event]] = {}
    for event in summary.events:
        kinds.setdefault((event.name, event.result), []).append(event)
    for (name, result), events in list(kinds.items())[:MAX_ROWS]:
        after = _format_time(summary, events[0].before)
        when = f"after {after} s" if after else "at the start"
        times = f", {len(events):,} times" if len(events) > 1 else ""
        yield from textwrap.wrap(f"{when}{times}: {name} {result}", WIDTH, subsequent_indent="  ")
    yield from _rest(len(kinds), "more kinds")


def _unknown(summary: LogSummary) -> Iterable[str]:
    rows = [("id", "packets", "bytes")]
    rows += [(f"0x{key:04X}", f"{n:,}", f"{size:,}") for key, (n, size) in summary.unknown.items()]
    return align(rows, right=(1, 2)) if summary.unknown else []


def _line(title: str, text: str) -> str:
    indent = f"{title:<10}"
    return textwrap.fill(text, WIDTH, initial_indent=indent, subsequent_indent=" " * len(indent))


def _format_time(summary: LogSummary, stamp: Stamp | None) -> str:
    """Returns the seconds recorded up to a time stamp."""
    seconds = summary.seconds_before(stamp)
    return "" if seconds is None else f"{seconds:,.2f}"


def _rest(number: int, which: str) -> Iterator[str]:
    if number > MAX_ROWS:
        yield f"... and {number - MAX_ROWS:,} {which}; --json lists all"
