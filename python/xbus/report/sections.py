"""The sections of a report: first what decides whether a recording is good, last what is looked up."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np

from xbus._core import damage_reasons
from xbus.describe.log_summary import event_result
from xbus.describe.log_text import quantity_rows
from xbus.formatting import format_count
from xbus.protocol.configuration import Configuration
from xbus.protocol.undecoded import NO_ORIENTATION
from xbus.report import figures
from xbus.report.base_map import ATTRIBUTION, SERVER, base_map
from xbus.report.blocks import (
    Block,
    Heading,
    Paragraph,
    Plot,
    Section,
    Table,
    table_of_first,
)
from xbus.report.data import MAX_ROWS, ReportData, Series
from xbus.report.findings import percent
from xbus.report.magnetic import magnetic
from xbus.report.noise import noise

__all__ = ["sections"]

BASE_MAP = (
    f"Map: {ATTRIBUTION}. Your browser loads it from {SERVER}, which learns where the recording was "
    "made."
)
SPECTRUM = (
    "Spectral density by Welch's method: segments without a gap, Hann windows that overlap by half, without "
    "their mean. The spectrogram is the sum of the three axes."
)


def sections(data: ReportData) -> list[Section]:
    """Returns the sections of a recording; some have no content."""
    summary = data.summary
    candidates = (
        ("timeline", "Timeline", _timeline(data)),
        ("quantities", "Quantities", _quantities(data)),
        ("trackers", "Awinda trackers", _trackers(data) if summary.trackers else ()),
        ("status", "Status", _status(data) if data.status_rows else ()),
        ("track", "Track", _track(data)),
        ("plots", "Plots", _plots(data)),
        ("magnetic", "Magnetic field", magnetic(data)),
        ("noise", "Noise", noise(data)),
        ("spectrum", "Spectrum", _spectrum(data)),
        ("values", "Values", _values(data)),
        ("gaps", "Gaps", _gaps(data) if summary.gaps else ()),
        ("damage", "Damage", _damage(data) if summary.damage else ()),
        ("events", "Errors and warnings", _events(data) if summary.events else ()),
        ("messages", "Messages", _messages(data)),
        ("settings", "Device and settings", _settings(data)),
        ("unknown", "Unknown data identifiers", _unknown(data) if summary.unknown else ()),
    )
    return [Section(anchor, title, list(blocks)) for anchor, title, blocks in candidates]


def _timeline(data: ReportData) -> Iterator[Block]:
    if (figure := figures.events(data)) is not None:
        yield Plot(figure)
    else:
        is_capture = data.summary.capture_findings is not None
        more = "" if is_capture else ", no damage, no errors and no warnings"
        yield Paragraph(f"No gaps by the packet counter{more}.")
    if any(curves.rows for curves in data.steps.values()):
        yield Plot(figures.steps(data))
        text = (
            "Time between samples. Samples of the GNSS receiver arrive late and are left out. "
            "A long time is a gap, even if the packet counter shows none."
        )
        yield Paragraph(text, is_note=True)


def _quantities(data: ReportData) -> Iterator[Block]:
    head, *rows = quantity_rows(data.summary)
    gaps, links = [], {}
    for at, quantity in enumerate(data.summary.quantities):
        key = quantity.name, quantity.coordinates
        found = [series for series in data.series if (series.name, series.coordinates) == key]
        regular = all(map(_is_regular, found))
        gaps.append(f"{sum(series.steps.gaps for series in found):,}" if regular else "")
        if found and (anchor := data.anchor(found[0])):
            links[at] = anchor
    yield Table(
        [*head, "gaps by time"],
        [[*row, gap] for row, gap in zip(rows, gaps, strict=True)],
        numeric=(2, 3, 6),
        links=links,
    )


def _trackers(data: ReportData) -> Iterator[Block]:
    rows = [
        (tracker.device_id, f"{tracker.rows:,}", f"{tracker.lost_samples:,}", f"{tracker.gaps:,}")
        for tracker in data.summary.trackers
    ]
    yield Table(("tracker", "rows", "samples lost", "gaps"), rows, numeric=(1, 2, 3))
    yield Paragraph(f"{NO_ORIENTATION}.", is_note=True)


def _is_regular(series: Series) -> bool:
    """Returns whether a quantity has plots and one rate."""
    return bool(series.panels) and series.steps.gaps < max(series.steps.rows / 10, 1)


def _status(data: ReportData) -> Iterator[Block]:
    yield Paragraph(f"{data.status_rows:,} status words. Fields that were never set are not shown.")
    if (figure := figures.flags(data)) is None:
        return
    rows = [
        (flag.label, percent(flag.rows, data.status_rows), f"{flag.rows:,}", flag.meaning)
        for flag in data.flags.values()
    ]
    yield Plot(figure)
    yield Table(("field", "share of time", "rows", "meaning"), rows, numeric=(1, 2))


def _track(data: ReportData) -> Iterator[Block]:
    if (figure := figures.track(data)) is None:
        return
    names = figures.tracks(data)
    origin = data.tracks[names[0]].origin
    text = (
        f"Metres east and north of {origin.lat:.7f}°, {origin.lon:.7f}°, where {names[0]} begins."
    )
    precisions = {quantity.name: quantity.precision for quantity in data.summary.quantities}
    if precisions.get("lat_lon") == "Float32" and any(name.startswith("lat_lon") for name in names):
        text += " lat_lon has Float32 precision, which resolves about half a metre."
    yield Plot(figure)
    yield Paragraph(text, is_note=True)
    if data.options.base_map:
        yield Plot(base_map({name: data.tracks[name] for name in names}))
        yield Paragraph(BASE_MAP, is_note=True)
    yield from map(Plot, figures.profiles(data))


def _plots(data: ReportData) -> Iterator[Block]:
    plotted = {series: found for series in data.series if (found := data.panels(series))}
    widths = (panel.curves.width for found in plotted.values() for panel in found)
    if width := max(widths, default=0):
        unit = "s" if data.axis.kind == "time" else "steps"
        text = (
            f"The plots show the minimum and the maximum of every {width:.3g} {unit} or less, so no spike is "
            "lost. A line ends where rows are missing."
        )
        yield Paragraph(text, is_note=True)
    for series, found in plotted.items():
        yield Heading(series.anchor, series.title)
        for panel in found:
            yield Plot(figures.panel(data, series, panel))


def _spectrum(data: ReportData) -> Iterator[Block]:
    wanted = [series for series in data.series if series.spectrum is not None]
    if wanted:
        yield Paragraph(SPECTRUM)
    for series in wanted:
        spectrum = series.spectrum
        assert spectrum is not None  # noqa: S101 - see above
        yield Heading(f"spectrum-{series.anchor}", series.title)
        if not spectrum.segments:
            yield Paragraph("Too short: there is no segment without a gap and of one rate.")
            continue
        text = (
            f"{format_count(spectrum.segments, 'segment')} of {spectrum.size:,} rows at "
            f"{spectrum.rate:,.2f} Hz."
        )
        if spectrum.left_out:
            text += f" {format_count(spectrum.left_out, 'segment')} of another rate left out."
        yield Paragraph(text)
        if data.options.spectrum:
            yield Plot(figures.spectrum(series))
        if data.options.spectrogram:
            yield Plot(figures.spectrogram(data, series))


def _values(data: ReportData) -> Iterator[Block]:
    rows = [row for series in data.series for row in _value_rows(series)]
    head = ("quantity", "component", "unit", "minimum", "mean", "maximum", "std. dev.", "NaN")
    if rows:
        yield Table(head, rows, numeric=(3, 4, 5, 6, 7))


def _value_rows(series: Series) -> Iterator[tuple[str, ...]]:
    coordinates = None if series.coordinates == "ENU" else series.coordinates
    name = " ".join(filter(None, (series.name, coordinates, series.device)))
    for panel in series.panels.values():
        curves = panel.curves
        statistics = (curves.minimum, curves.mean, curves.maximum, curves.deviation)
        for at, component in enumerate(curves.names):
            # Enough digits to distinguish the minimum from the maximum.
            span = float(curves.maximum[at] - curves.minimum[at])
            cells = [
                _format_number(float(numbers[at]), span) if curves.count[at] else ""
                for numbers in statistics
            ]
            missing = f"{curves.rows - curves.count[at]:,.0f}" if curves.missing else ""
            yield (name, component if component != series.name else "", panel.unit, *cells, missing)
            name = ""


def _format_number(number: float, span: float) -> str:
    if span <= 0 or not np.isfinite(span):
        return f"{number:.6g}" if abs(number) > 1e-12 else "0"
    decimals = int(np.clip(3 - np.floor(np.log10(span)), 0, 12))
    # Adding 0.0 turns -0 to 0.
    return f"{round(number, decimals) + 0.0:,.{decimals}f}" if decimals < 8 else f"{number:.9g}"


def _gaps(data: ReportData) -> Iterator[Block]:
    rows = [
        (_format_time(data, position), f"{lost:,}", f"{sample:,}")
        for sample, lost, position in data.gaps.rows.tolist()
    ]
    head = ("before, s", "samples lost", "next sample")
    total = len(data.summary.gaps)
    yield from table_of_first(head, rows, (0, 1, 2), total, "gaps, smaller")


def _damage(data: ReportData) -> Iterator[Block]:
    damage, reasons = data.summary.damage, damage_reasons()
    rows = [
        (f"{at:,}", f"{size:,}", reasons[reason])
        for at, size, reason in damage.rows[:MAX_ROWS].tolist()
    ]
    yield from table_of_first(("byte", "bytes", "reason"), rows, (0, 1), len(damage), "places")


def _events(data: ReportData) -> Iterator[Block]:
    events = data.summary.events
    rows = []
    for event, position in zip(events.rows, data.events.rows, strict=False):
        name, result = event_result(int(event["mid"]), event["payload"])
        rows.append((_format_time(data, position), f"{event['offset']:,}", name, str(result)))
    head = ("after, s", "byte", "", "text")
    yield from table_of_first(head, rows, (0, 1), len(events), "events")


def _messages(data: ReportData) -> Iterator[Block]:
    summary = data.summary
    rows = [("MTData2 (samples)", f"{summary.stats.samples:,}")]
    rows += [(name, f"{count:,}") for name, count in summary.messages.most_common()]
    rows += [(f"{name} (string)", f"{count:,}") for name, count in summary.strings.most_common()]
    yield Table(("message", "count"), rows, numeric=(1,))


def _settings(data: ReportData) -> Iterator[Block]:
    configuration = data.summary.identity.configuration
    if configuration is not None:
        yield Table(("Configuration", ""), list(_configuration_rows(configuration)))
    if data.settings:
        rows = [(f"{setting.time:,.2f}", setting.name, setting.text) for setting in data.settings]
        time = "after, s" if data.axis.kind == "time" else data.axis.kind
        yield Table((time, "message", "text"), rows, numeric=(0,))
    if not data.is_examining:
        yield Paragraph("There may be more; xbus dump lists all.", is_note=True)
    if configuration is None and not data.settings:
        yield Paragraph("The recording contains no message about settings.")


def _configuration_rows(configuration: Configuration) -> Iterator[tuple[str, str]]:
    version = configuration.filter_version
    values = {
        "filter profile": configuration.filter_profile,
        "filter type": configuration.filter_type,
        "filter version": ".".join(map(str, version)) if any(version) else None,
        "devices on the bus": configuration.devices,
        "sampling period, 1/115200 s": configuration.sampling_period,
        "output skip factor": configuration.output_skip_factor,
        "output mode (legacy MTData)": configuration.output_mode,
        "output settings (legacy MTData)": configuration.output_settings,
    }
    for name, value in values.items():
        if value is not None:
            yield name, str(value)


def _unknown(data: ReportData) -> Iterator[Block]:
    unknown = data.summary.unknown
    rows = [
        (f"0x{key:04X}", f"{n:,}", f"{size:,}")
        for key, (n, size) in itertools.islice(unknown.items(), MAX_ROWS)
    ]
    head = ("identifier", "packets", "bytes")
    yield from table_of_first(head, rows, (1, 2), len(unknown), "identifiers")


def _format_time(data: ReportData, x: float) -> str:
    return f"{x:,.2f}" if data.axis.kind == "time" else ""
