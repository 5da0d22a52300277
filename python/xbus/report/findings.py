"""What somebody must know before trusting a recording."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from xbus.describe.formatting import format_count
from xbus.protocol.tables import QUANTITIES
from xbus.report.gather import Gathered, Series

__all__ = ["Finding", "findings"]

#: Rows of a quantity from which on its times tell something.
ENOUGH = 20


class Finding(NamedTuple):
    """One thing to know.

    Attributes:
        is_bad: Whether data are missing or wrong, or it is only good to know.
        text: It, in words.
        section: Where the report says more.
    """

    is_bad: bool
    text: str
    section: str


def findings(it: Gathered) -> list[Finding]:
    """What there is to know, the worst first."""
    found = [*_losses(it), *_events(it), *_status(it), *_values(it), *_unsaid(it)]
    return sorted(found, key=lambda finding: not finding.is_bad)


def _losses(it: Gathered) -> Iterator[Finding]:
    facts, stats = it.facts, it.facts.stats
    if stats.lost_samples:
        worst = max(
            zip(facts.gaps, it.gaps, strict=True), key=lambda gap: gap[0].lost, default=None
        )
        share = percent(stats.lost_samples, stats.lost_samples + stats.samples)
        samples, gaps = format_count(stats.lost_samples, "sample"), format_count(stats.gaps, "gap")
        text = f"{samples} lost in {gaps}, {share}"
        if worst is not None and len(facts.gaps) > 1:
            gap, x = worst
            where = f", before {x:,.2f} s" if it.axis.kind == "time" else ""
            text += f"; the most at once {gap.lost:,}{where}"
        yield Finding(True, text, "gaps")
    if stats.skipped_bytes:
        share = percent(stats.skipped_bytes, stats.bytes)
        places = format_count(len(facts.damage), "place")
        text = f"{format_count(stats.skipped_bytes, 'byte')} of damage in {places}, {share} of the file"
        yield Finding(True, text, "damage")
    if stats.malformed:
        text = (
            f"{format_count(stats.malformed, 'sample')} malformed: their packets do not fill them"
        )
        yield Finding(True, text, "messages")
    pausing = [series for series in it.series if _pauses(series, it)]
    if pausing and not stats.lost_samples:
        worst_one = max(pausing, key=lambda series: series.steps.gaps)
        counted = "packet_counter" in {known.name for known in facts.quantities}
        why = "although the packet counter misses none" if counted else "and no counter tells why"
        pauses = format_count(worst_one.steps.gaps, "pause")
        text = f"{pauses} in {worst_one.name}, by its times, {why}"
        yield Finding(not counted, text, "timeline")


def _pauses(series: Series, it: Gathered) -> bool:
    """Whether times of a quantity that comes regularly have gaps."""
    group = QUANTITIES[series.name].group
    regular = group not in ("Timestamp", "Indication") and series.steps.rows >= ENOUGH
    return it.axis.kind == "time" and regular and 0 < series.steps.gaps < series.steps.rows / 10


def _events(it: Gathered) -> Iterator[Finding]:
    for name, things in (("Error", "error"), ("Warning", "warning")):
        events = [event for event in it.facts.events if event.name == name]
        if events:
            first = f"; the first: {events[0].notice}"
            yield Finding(
                True, f"{format_count(len(events), things)} from the device{first}", "events"
            )
    if it.restarts or it.axis.restarts:
        times = format_count(max(it.restarts, it.axis.restarts), "time")
        away = "; how long it was away is not known, and not drawn" if it.axis.restarts else ""
        yield Finding(True, f"the device started anew, {times}{away}", "messages")
    if len(it.axis.devices) > 1:
        devices = ", ".join(map(str, sorted(it.axis.devices)))
        text = f"samples of several devices (bus identifiers {devices}) are drawn as those of one"
        yield Finding(True, text, "quantities")


def _status(it: Gathered) -> Iterator[Finding]:
    if it.status_rows:
        rows = {(flag.name, flag.value): flag.rows for flag in it.flags.values()}
        clips = [name for name, _ in rows if name.startswith("clip_")]
        for name in clips or [name for name, _ in rows if name == "clipping"]:
            share = percent(rows[name, 1], it.status_rows)
            first = it.flags[name, 1].bands.start[0]
            when = f", first at {first:,.2f} s" if it.axis.kind == "time" else ""
            meaning = it.flags[name, 1].meaning
            yield Finding(True, f"{meaning} in {share} of the time{when}", "status")
        yield from _without(it, "filter_valid", "the orientation filter is not valid")
        if it.tracks:
            yield from _without(it, "gnss_fix", "no GNSS fix")
    fixes, positions = it.positions
    if fixes < positions and not it.status_rows:
        text = f"no GNSS fix in {percent(positions - fixes, positions)} of the time"
        yield Finding(True, text, "gnss_pvt_data")


def _without(it: Gathered, name: str, what: str) -> Iterator[Finding]:
    """A flag that should be set, and is not."""
    flag = it.flags.get((name, 1))
    missing = it.status_rows - (flag.rows if flag else 0)
    if missing:
        last = f", last at {it.without[name]:,.2f} s" if flag and it.axis.kind == "time" else ""
        yield Finding(
            True, f"{what} in {percent(missing, it.status_rows)} of the time{last}", "status"
        )


def _values(it: Gathered) -> Iterator[Finding]:
    for series in it.series:
        for panel in series.panels.values():
            # What a receiver does not provide is no fault.
            if panel.curves.missing and not QUANTITIES[series.name].fields:
                text = f"{format_count(panel.curves.missing, 'value')} of {series.name} NaN or infinite"
                yield Finding(True, text, series.anchor)


def _unsaid(it: Gathered) -> Iterator[Finding]:
    facts = it.facts
    names = {known.name for known in facts.quantities}
    if not facts.stats.samples:
        what = "strings" if facts.strings else "messages"
        yield Finding(True, f"not one sample: {what} only", "messages")
        return
    if "packet_counter" not in names:
        text = "no packet counter was recorded: nobody can tell whether samples are missing"
        yield Finding(False, text, "quantities")
    if it.axis.kind != "time":
        text = f"no time stamp was recorded: the plots are over the {it.axis.kind}"
        yield Finding(False, text, "quantities")
    if facts.utc_rows and not facts.utc_valid:
        yield Finding(False, "UTC was sent, but never marked as valid", "quantities")
    if facts.identity.product_code is None and facts.identity.device_id is None:
        yield Finding(False, "the recording does not say which device it is of", "settings")
    if facts.unknown:
        text = f"{format_count(len(facts.unknown), 'data identifier')} that xbus does not know"
        yield Finding(False, text, "unknown")


def percent(part: float, whole: float) -> str:
    """A share that is neither none nor all of it does not look so."""
    share = 100 * part / max(whole, 1)
    if 0 < share < 0.01:
        return "less than 0.01 %"
    return f"{share:.4g} %" if share > 99 else f"{share:.2g} %"
