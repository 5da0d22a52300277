"""The text that ``xbus info`` prints, 80 columns wide."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

from xbus._core import damage_reasons
from xbus.cli.argument_options import with_argument_options
from xbus.cli.printing import align, bold
from xbus.describe.listing import MAX_LISTED, LargestRows
from xbus.describe.log_summary import GAP, MAX_KINDS, LogSummary
from xbus.describe.log_text import log_rows, quantity_rows

if TYPE_CHECKING:
    import numpy.typing as npt

__all__ = ["info_text"]

WIDTH = 80
#: Maximum number of gaps, places of damage and events; the rest is counted.
MAX_ROWS = 5
#: Maximum number of unknown data identifiers.
MAX_UNKNOWN = 50


def info_text(name: str, summary: LogSummary) -> str:
    """Returns the description of a log."""
    lines = [
        bold(name),
        *(_line(title, with_argument_options(text)) for title, text in log_rows(summary)),
        "",
        *_quantities(summary),
    ]
    for title, section in (
        ("gaps", _gaps(summary)),
        ("damage", _damage(summary)),
        ("errors and warnings", _events(summary)),
        ("unknown data identifiers", _unknown(summary)),
        ("findings", _wrapped(summary.capture_findings or ())),
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
    if not len(summary.gaps):
        return
    largest = LargestRows(GAP, "lost", MAX_ROWS)
    largest.add(summary.largest_gaps.rows)
    after = _format_times(summary, largest.rows["before"])  # of the last sample before the gap
    rows: list[tuple[str, ...]] = [("BID", "after/s", "lost", "next sample")]
    rows += [
        (f"{gap['bid']}", time, f"{gap['lost']:,}", f"{gap['sample']:,}")
        for gap, time in zip(largest.rows, after, strict=True)
    ]
    if len(summary.devices) < 2:
        rows = [row[1:] for row in rows]
    yield from align(rows, right=range(len(rows[0])))
    yield from _rest(len(summary.gaps), "smaller")


def _damage(summary: LogSummary) -> Iterator[str]:
    if not len(summary.damage):
        return
    counts = ", ".join(f"{reason} {n:,}" for reason, n in summary.reasons.most_common())
    yield from textwrap.wrap(counts, WIDTH)
    rows = [("offset", "bytes", "reason")]
    names = damage_reasons()
    for offset, length, reason in summary.damage.rows[:MAX_ROWS].tolist():
        rows.append((f"{offset:,}", f"{length:,}", names[reason]))
    yield from align(rows, right=(0, 1))
    yield from _rest(len(summary.damage), "more")


def _events(summary: LogSummary) -> Iterator[str]:
    """Yields each kind of event once, with its first time and its number."""
    for kind in list(summary.kinds.values())[:MAX_ROWS]:
        (after,) = _format_times(summary, kind.before)
        when = f"after {after} s" if after else "at the start"
        times = f", {kind.number:,} times" if kind.number > 1 else ""
        text = f"{when}{times}: {kind.name} {kind.result}"
        yield from textwrap.wrap(text, WIDTH, subsequent_indent="  ")
    more = "more kinds" if len(summary.kinds) < MAX_KINDS else "more kinds, or more"
    yield from _rest(len(summary.kinds), more)


def _unknown(summary: LogSummary) -> Iterator[str]:
    if not summary.unknown:
        return
    rows = [("id", "packets", "bytes")]
    for key, (number, size) in list(summary.unknown.items())[:MAX_UNKNOWN]:
        rows.append((f"0x{key:04X}", f"{number:,}", f"{size:,}"))
    yield from align(rows, right=(1, 2))
    yield from _rest(len(summary.unknown), "more", MAX_UNKNOWN)


def _wrapped(sentences: Sequence[str]) -> Iterator[str]:
    for sentence in sentences:
        yield from textwrap.wrap(sentence, WIDTH, subsequent_indent="  ")


def _line(title: str, text: str) -> str:
    indent = f"{title:<10}"
    return textwrap.fill(text, WIDTH, initial_indent=indent, subsequent_indent=" " * len(indent))


def _format_times(summary: LogSummary, stamps: npt.NDArray[Any]) -> list[str]:
    """Returns the seconds recorded up to time stamps."""
    seconds = summary.seconds_before(stamps).tolist()
    return ["" if math.isnan(time) else f"{time:,.2f}" for time in seconds]


def _rest(number: int, which: str, shown: int = MAX_ROWS) -> Iterator[str]:
    if number > shown:
        listed = "all" if number <= MAX_LISTED else f"the first {MAX_LISTED:,}"
        yield f"... and {number - shown:,} {which}; --json lists {listed}"
