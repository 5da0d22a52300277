"""The problems of a recording, and what else to know before using it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from xbus.formatting import describe_damage, describe_losses, format_count
from xbus.protocol.tables import COLUMN_QUANTITIES
from xbus.protocol.undecoded import NO_ORIENTATION, describe_undecoded
from xbus.report.data import ReportData, Series
from xbus.report.field_quality import Quality

__all__ = ["Finding", "findings", "percent"]

#: Minimum number of rows of a quantity for a finding about its times.
MIN_ROWS = 20


class Finding(NamedTuple):
    """A finding.

    Attributes:
        is_bad: Whether data are missing or wrong; else the finding is only a note.
        text: A sentence without its full stop.
        section: Anchor of the section with details.
    """

    is_bad: bool
    text: str
    section: str


def findings(data: ReportData) -> list[Finding]:
    """Returns all findings, the problems first."""
    found = [
        *_losses(data),
        *_capture(data),
        *_events(data),
        *_status(data),
        *_values(data),
        *_magnetic(data),
        *_missing(data),
    ]
    return sorted(found, key=lambda finding: not finding.is_bad)


def _losses(data: ReportData) -> Iterator[Finding]:
    summary, stats = data.summary, data.summary.stats
    if stats.lost_samples:
        share = percent(stats.lost_samples, stats.lost_samples + stats.samples)
        text = describe_losses(stats.lost_samples, stats.gaps, has_counter=data.has_counter)
        text += f", {share}"
        if len(summary.gaps) > 1:
            gap = data.gaps.rows[data.gaps.rows["lost"].argmax()]
            where = f" before {gap['position']:,.2f} s" if data.axis.kind == "time" else ""
            text += f"; largest gap: {format_count(int(gap['lost']), 'sample')}{where}"
        yield Finding(True, text, "gaps")
    for tracker in summary.trackers:
        if tracker.lost_samples:
            text = describe_losses(tracker.lost_samples, tracker.gaps, has_counter=True)
            share = percent(tracker.lost_samples, tracker.lost_samples + tracker.rows)
            yield Finding(True, f"tracker {tracker.device_id}: {text}, {share}", "trackers")
    if stats.skipped_bytes:
        share = percent(stats.skipped_bytes, stats.bytes)
        text = describe_damage(stats.skipped_bytes, len(summary.damage))
        yield Finding(True, f"{text}, {share} of the bytes", "damage")
    if stats.malformed:
        samples = format_count(stats.malformed, "malformed sample")
        yield Finding(True, f"{samples}: the packets do not fill the message", "messages")
    pausing = [series for series in data.series if _pauses(series, data)]
    if pausing and not stats.lost_samples:
        worst = max(pausing, key=lambda series: series.steps.gaps)
        pauses = format_count(worst.steps.gaps, "pause")
        why = "without a gap in the packet counter" if data.has_counter else "and no packet counter"
        text = f"{pauses} in the time stamps of {worst.label}, {why}"
        yield Finding(not data.has_counter, text, "timeline")


def _pauses(series: Series, data: ReportData) -> bool:
    """Returns whether a quantity with a regular rate has gaps in its times."""
    group = COLUMN_QUANTITIES[series.name].group
    regular = group not in ("Timestamp", "Indication") and series.steps.rows >= MIN_ROWS
    return data.axis.kind == "time" and regular and 0 < series.steps.gaps < series.steps.rows / 10


def _capture(data: ReportData) -> Iterator[Finding]:
    """What is unusual in a CAN capture. Often it is that other nodes send, too."""
    for sentence in data.summary.capture_findings or ():
        yield Finding(False, sentence, "timeline")


def _events(data: ReportData) -> Iterator[Finding]:
    for name in ("Error", "Warning"):
        if number := data.summary.messages[name]:
            kinds = (kind for kind in data.summary.kinds.values() if kind.name == name)
            text = f"{format_count(number, name.lower())} from the device"
            if (first := next(kinds, None)) is not None:
                text += f"; the first: {first.result}"
            yield Finding(True, text, "events")
    is_one = len(data.axis.devices) < 2
    if data.restarts:
        times = format_count(data.restarts, "time")
        who = "the device" if is_one else "devices"
        away = (
            ""
            if data.axis.kind == "sample"
            else "; the time until it was back is unknown and not drawn"
        )
        yield Finding(True, f"{who} restarted {times}{away if is_one else ''}", "messages")
    if not is_one:
        devices = ", ".join(map(str, sorted(data.axis.devices)))
        text = (
            f"samples of several devices (BID {devices}), each drawn by its own clock from where it begins; "
            "status shows all of them together"
        )
        yield Finding(False, text, "quantities")


def _status(data: ReportData) -> Iterator[Finding]:
    if data.status_rows:
        rows = {(flag.name, flag.value): flag.rows for flag in data.flags.values()}
        clips = [name for name, _ in rows if name.startswith("clip_")]
        for name in clips or [name for name, _ in rows if name == "clipping"]:
            share = percent(rows[name, 1], data.status_rows)
            first = data.flags[name, 1].bands.start[0]
            when = f", first at {first:,.2f} s" if data.axis.kind == "time" else ""
            meaning = data.flags[name, 1].meaning
            yield Finding(True, f"{meaning} in {share} of the time{when}", "status")
        yield from _unset(data, "filter_valid", "the orientation filter is not valid")
        if data.tracks:
            yield from _unset(data, "gnss_fix", "no GNSS fix")
    fixes, positions = data.positions
    if fixes < positions and not data.status_rows:
        text = f"no GNSS fix in {percent(positions - fixes, positions)} of the time"
        series = next(series for series in data.series if series.name == "gnss_pvt_data")
        yield Finding(True, text, data.anchor(series))


def _unset(data: ReportData, name: str, problem: str) -> Iterator[Finding]:
    """Yields a finding about a flag that should be set and is not."""
    flag = data.flags.get((name, 1))
    missing = data.status_rows - (flag.rows if flag else 0)
    if missing:
        is_timed = flag and data.axis.kind == "time"
        last = f", last at {data.last_unset[name]:,.2f} s" if is_timed else ""
        share = percent(missing, data.status_rows)
        yield Finding(True, f"{problem} in {share} of the time{last}", "status")


def _values(data: ReportData) -> Iterator[Finding]:
    for series in data.series:
        for panel in series.panels.values():
            # Fields that a receiver does not provide are not a problem.
            if panel.curves.missing and not COLUMN_QUANTITIES[series.name].fields:
                values = format_count(panel.curves.missing, "value")
                yield Finding(
                    True, f"{values} of {series.label} NaN or infinite", data.anchor(series)
                )


def _magnetic(data: ReportData) -> Iterator[Finding]:
    for series in data.series:
        if series.field is not None:
            quality = series.field.quality()
            if quality.quality == Quality.DISTURBED:
                yield Finding(False, f"{series.label} is {quality.verdict}", "magnetic")


def _missing(data: ReportData) -> Iterator[Finding]:
    """Yields findings about information that the recording lacks."""
    summary = data.summary
    for kind, section in (("message", "messages"), ("packet", "unknown")):
        items = [item for item in summary.undecoded if item.kind == kind]
        if items:
            text = f"not decoded: {describe_undecoded(items)}"
            yield Finding(kind == "message", text, section)
    if summary.trackers:
        yield Finding(False, NO_ORIENTATION, "trackers")
    if not summary.stats.samples:
        things = "strings" if summary.strings else "messages"
        yield Finding(True, f"no samples, only {things}", "messages")
        return
    if not data.has_counter and not summary.trackers:
        yield Finding(False, describe_losses(0, 0, has_counter=False), "quantities")
    if data.axis.kind != "time":
        axis = "sample number" if data.axis.kind == "sample" else data.axis.kind
        text = f"no time stamps: the horizontal axis is the {axis}"
        yield Finding(False, text, "quantities")
    if summary.utc_rows and not summary.utc_valid:
        yield Finding(False, "UTC was never marked as valid", "quantities")
    if summary.identity.product_code is None and summary.identity.device_id is None:
        yield Finding(False, "the recording does not identify its device", "settings")


def percent(part: float, whole: float) -> str:
    """Returns a share in percent; only 0 and 1 are rounded to 0 % and 100 %."""
    share = 100 * part / max(whole, 1)
    if 0 < share < 0.01:
        return "less than 0.01 %"
    return f"{share:.4g} %" if share > 99 else f"{share:.2g} %"
