"""The page of a report: HTML that needs nothing else, with tables that need no JavaScript."""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from html import escape
from importlib import resources

import numpy as np

from xbus._core import __version__
from xbus.describe.formatting import format_count
from xbus.describe.log_text import format_utc, log_rows, quantity_rows
from xbus.protocol.configuration import Configuration
from xbus.report import figures
from xbus.report.allan import PARTS, Stretch, at_one_second, flicker_floor
from xbus.report.figures import Figure
from xbus.report.findings import Finding, findings, percent
from xbus.report.gather import SETTINGS, STATUS, Gathered, Series
from xbus.report.thin import FloatArray

__all__ = ["page"]

#: How many gaps, stretches of damage and events are listed; ``xbus info --json`` lists all.
SHOWN = 100
#: A device at rest: no more than noise about the mean, in rad/s and m/s2.
AT_REST = {"rate_of_turn": 0.02, "acceleration": 0.2}
#: What noise is read in: units of the random walk and of the bias, and how many there are in the log's unit.
READ_IN = {
    "rate_of_turn": ("deg/√h", np.degrees(60), "deg/h", np.degrees(3600)),
    "acceleration": ("m/s/√h", 60.0, "µg", 1e6 / 9.80665),
}
#: Slopes on log-log paper between which a curve is that of white noise, -1/2.
WHITE = (-0.65, -0.35)


def page(title: str, it: Gathered, plotly: str) -> str:
    """The HTML.

    Args:
        title: What stands above it.
        it: What it says.
        plotly: plotly's JavaScript.
    """
    drawn: list[Figure] = []
    with np.errstate(over="ignore", invalid="ignore"):  # as in `gather`
        body = "".join(_body(title, it, drawn))
    scripts = [plotly, resources.files("xbus.report").joinpath("page.js").read_text("utf-8")]
    hashes = " ".join(f"'sha256-{_hash(script)}'" for script in scripts)
    # Nothing is fetched, and no other script runs, whatever a file name or a device may say.
    policy = (
        f"default-src 'none'; script-src {hashes}; style-src 'unsafe-inline'; img-src data: blob:"
    )
    style = resources.files("xbus.report").joinpath("page.css").read_text("utf-8")
    return "".join(
        [
            '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n',
            f'<meta http-equiv="Content-Security-Policy" content="{policy}">\n',
            '<meta name="viewport" content="width=device-width, initial-scale=1">\n',
            f'<link rel="icon" href="data:,">\n<title>{_text(title)}</title>\n',
            f"<style>\n{style}</style>\n</head>\n<body>\n{body}",
            f'<script type="application/json" id="figures">{_json(drawn)}</script>\n',
            *(f"<script>{script}</script>\n" for script in scripts),
            "</body>\n</html>\n",
        ]
    )


def _hash(script: str) -> str:
    return base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()


def _json(drawn: list[Figure]) -> str:
    """JSON that cannot end the script it stands in."""
    return json.dumps(drawn, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")


def _text(text: str) -> str:
    """Text from a file or a device: nothing in it is HTML, nor turns the line around."""
    return escape(
        "".join(it if it.isprintable() else it.encode("unicode_escape").decode() for it in text)
    )


# Pieces


def _section(anchor: str, title: str, *, level: int = 2) -> str:
    href = _text(anchor)
    return f'<h{level} id="{href}"><a href="#{href}">{_text(title)}</a></h{level}>\n'


def _plot(figure: Figure, drawn: list[Figure]) -> str:
    """A place for a plot."""
    drawn.append(figure)
    height = figure["layout"]["height"]
    return f'<figure><div class="plot" style="height:{height}px"></div></figure>\n'


def _table(
    top: Sequence[str],
    rows: Iterable[Sequence[str]],
    *,
    right: Sequence[int] = (),
    links: Mapping[int, str] | None = None,
) -> str:
    """A table; columns in ``right`` hold numbers, ``links`` lead from the first cells of rows to sections."""

    def line(cells: Sequence[str], tag: str, link: str | None = None) -> str:
        inner = [_text(cell) for cell in cells]
        if link is not None:
            inner[0] = f'<a href="#{_text(link)}">{inner[0]}</a>'
        kinds = [" class=n" if at in right else "" for at in range(len(inner))]
        both = zip(kinds, inner, strict=True)
        return "<tr>" + "".join(f"<{tag}{kind}>{cell}</{tag}>" for kind, cell in both) + "</tr>\n"

    body = "".join(line(row, "td", (links or {}).get(at)) for at, row in enumerate(rows))
    return f'<div class="wide"><table>\n{line(top, "th")}{body}</table></div>\n'


def _soft(text: str) -> str:
    return f'<p class="soft">{_text(text)}</p>\n'


def _more(number: int, what: str) -> str:
    rest = number - SHOWN
    return _soft(f"… and {rest:,} more {what}; xbus info --json lists all.") if rest > 0 else ""


# The page, from what decides to what is looked up


def _body(title: str, it: Gathered, drawn: list[Figure]) -> Iterator[str]:
    found = findings(it)
    sections = list(_sections(it, drawn))
    yield f"<header>\n<h1>{_text(title)}</h1>\n{_verdict(it, found)}"
    pairs = list(log_rows(it.facts))
    if it.utc is not None:
        at = [name for name, _ in pairs].index("UTC") + 1 if it.facts.utc else len(pairs)
        pairs.insert(at, ("0 s is", f"{format_utc(it.utc)} UTC"))
    rows = "".join(f"<dt>{_text(name)}</dt><dd>{_text(text)}</dd>\n" for name, text in pairs)
    links = "".join(f'<a href="#{name}">{_text(what)}</a>\n' for name, what, _ in sections)
    yield f"<dl>\n{rows}</dl>\n<nav>{links}</nav>\n</header>\n<main>\n"
    yield "<noscript><p>The plots need JavaScript, the tables do not.</p></noscript>\n"
    for name, what, text in sections:
        yield f"<section>\n{_section(name, what)}{text}</section>\n"
    yield "</main>\n"
    yield f"<footer>{_soft(f'Made by xbus {__version__}. All of it is in this file.')}</footer>\n"


def _verdict(it: Gathered, found: list[Finding]) -> str:
    bad = sum(finding.is_bad for finding in found)
    counted = "packet_counter" in {known.name for known in it.facts.quantities}
    if bad:
        kind, sentence = (
            "bad",
            f"{format_count(bad, 'thing')} to look at before this recording is used",
        )
    elif counted:
        kind, sentence = "good", "No sample lost, no damage, no errors"
    else:
        kind, sentence = "note", "No damage, no errors"
    rows = "".join(
        f'<li><a href="#{_text(finding.section)}">{_text(finding.text)}</a></li>\n'
        for finding in found
    )
    inner = f"<ul>\n{rows}</ul>\n" if rows else ""
    return f'<div class="verdict {kind}"><strong>{sentence}</strong>\n{inner}</div>\n'


def _sections(it: Gathered, drawn: list[Figure]) -> Iterator[tuple[str, str, str]]:
    """Anchor, title and contents of each."""
    yield "timeline", "Timeline", _timeline(it, drawn)
    yield "quantities", "Quantities", _quantities(it)
    if it.status_rows:
        yield "status", "Status", _status(it, drawn)
    if (figure := figures.track(it)) is not None:
        yield "track", "Track", _track(it, figure, drawn)
    if plots := "".join(_plots(it, drawn)):
        yield "plots", "Plots", plots
    if noisy := [series for series in it.series if series.longest is not None]:
        yield "noise", "Noise", "".join(_noise(noisy, drawn))
    if plots:
        yield "values", "Values", _values(it)
    if it.facts.gaps:
        yield "gaps", "Gaps", _gaps(it)
    if it.facts.damage:
        yield "damage", "Damage", _damage(it)
    if it.facts.events:
        yield "events", "Errors and warnings", _events(it)
    yield "messages", "Messages", _messages(it)
    yield "settings", "Device and settings", _settings(it)
    if it.facts.unknown:
        yield "unknown", "Unknown data identifiers", _unknown(it)


def _timeline(it: Gathered, drawn: list[Figure]) -> str:
    text = ""
    if (figure := figures.events(it)) is not None:
        text += _plot(figure, drawn)
    else:
        text += "<p>No gap by the packet counter, no damage, no error and no warning.</p>\n"
    if it.steps.rows:
        text += _plot(figures.steps(it), drawn)
        text += _soft(
            "Time from one sample to the next; without those of the GNSS receiver, which come late. A long "
            "one is a gap, whatever the packet counter says."
        )
    return text


def _quantities(it: Gathered) -> str:
    top, *rows = quantity_rows(it.facts)
    gaps = [f"{series.steps.gaps:,}" if _is_regular(series) else "" for series in it.series]
    places = {at: _place(series) for at, series in enumerate(it.series)}
    return _table(
        [*top, "gaps by time"],
        [[*row, gap] for row, gap in zip(rows, gaps, strict=True)],
        right=(2, 3, 6),
        links={at: place for at, place in places.items() if place},
    )


def _place(series: Series) -> str:
    """The section that shows a quantity."""
    if series.panels:
        return series.anchor
    return "status" if series.name in STATUS else ""


def _is_regular(series: Series) -> bool:
    """Whether a quantity has plots and comes at one rate: a counter comes with whatever sample."""
    return bool(series.panels) and series.steps.gaps < max(series.steps.rows / 10, 1)


def _values(it: Gathered) -> str:
    rows = [row for series in it.series for row in _value_rows(series)]
    top = ("quantity", "component", "unit", "least", "mean", "greatest", "std. dev.", "NaN")
    return _table(top, rows, right=(3, 4, 5, 6, 7))


def _value_rows(series: Series) -> Iterator[tuple[str, ...]]:
    name = (
        series.name
        if series.coordinates in (None, "ENU")
        else f"{series.name} {series.coordinates}"
    )
    for shown in series.panels.values():
        curves = shown.curves
        numbers = (curves.least, curves.mean, curves.greatest, curves.deviation)
        # Digits enough to tell the least from the greatest.
        for at, component in enumerate(curves.names):
            span = float(curves.greatest[at] - curves.least[at])
            cells = [_number(float(it[at]), span) if curves.count[at] else "" for it in numbers]
            missing = f"{curves.rows - curves.count[at]:,.0f}" if curves.missing else ""
            yield (name, component if component != series.name else "", shown.unit, *cells, missing)
            name = ""


def _number(number: float, span: float) -> str:
    if span <= 0 or not np.isfinite(span):
        return f"{number:.6g}" if abs(number) > 1e-12 else "0"
    decimals = int(np.clip(3 - np.floor(np.log10(span)), 0, 12))
    # No minus before a zero.
    return f"{round(number, decimals) + 0.0:,.{decimals}f}" if decimals < 8 else f"{number:.9g}"


def _status(it: Gathered, drawn: list[Figure]) -> str:
    text = f"<p>{it.status_rows:,} status words. Fields that were never set are not shown.</p>\n"
    if (figure := figures.flags(it)) is None:
        return text
    rows = [
        (
            flag.label,
            percent(flag.rows, it.status_rows),
            f"{flag.rows:,}",
            flag.meaning,
        )
        for flag in it.flags.values()
    ]
    return (
        text
        + _plot(figure, drawn)
        + _table(("field", "of the time", "rows", "meaning"), rows, right=(1, 2))
    )


def _track(it: Gathered, figure: Figure, drawn: list[Figure]) -> str:
    names = figures.tracks(it)
    origin = it.tracks[names[0]].origin
    text = (
        f"Metres east and north of {origin.lat:.7f}°, {origin.lon:.7f}°, where {names[0]} begins."
    )
    precisions = {known.name: known.precision for known in it.facts.quantities}
    if precisions.get("lat_lon") == "Float32" and "lat_lon" in names:
        text += " lat_lon came as Float32, which tells places up to half a metre apart as one."
    return _plot(figure, drawn) + _soft(text)


def _plots(it: Gathered, drawn: list[Figure]) -> Iterator[str]:
    widest = max((panel.curves.width for s in it.series for panel in s.panels.values()), default=0)
    if widest:
        yield _soft(
            f"Of each {widest:.3g} {'s' if it.axis.kind == 'time' else 'steps'} or less the least and the "
            "greatest value are drawn, so that no spike is lost. A line ends where rows are missing."
        )
    for series in it.series:
        shown = list(series.panels.values())
        if not shown:
            continue
        name = series.name if series.coordinates is None else f"{series.name}, {series.coordinates}"
        yield _section(series.anchor, name, level=3)
        for panel in shown:
            yield _plot(figures.panel(it, series, panel), drawn)


# Noise


def _noise(noisy: list[Series], drawn: list[Figure]) -> Iterator[str]:
    yield (
        "<p>Overlapping Allan deviation. It tells the noise of a sensor only where the device lay still and "
        "was warm: motion, vibration and a change of temperature look the same to it. Only the longest "
        "stretch without a gap is used, up to averaging times of a ninth of it, where a deviation is "
        "uncertain by a quarter. Random walk is read at 1 s, and means something where the slope is near "
        "-1/2; bias instability is the least deviation over 0.664, and takes hours.</p>\n"
    )
    for series in noisy:
        assert series.longest is not None  # noqa: S101 - see `_sections`
        best = series.longest.best
        yield _section(f"noise-{series.name}", series.name, level=3)
        result = figures.noise(series)
        if result is None:
            rows = format_count(best.rows, "row")
            yield f"<p>Too little: {rows} without a gap; it takes {2 * PARTS} at least.</p>\n"
            continue
        figure, curves = result
        yield "".join(f"<p>{_text(text)}</p>\n" for text in _on_stretch(series, best))
        yield _plot(figure, drawn)
        yield _figures_of(series, curves)


def _on_stretch(series: Series, best: Stretch) -> Iterator[str]:
    """What the data are, and what makes them no good."""
    assert series.longest is not None  # noqa: S101 - see `_sections`
    gaps = series.longest.stretches - 1
    whole = (
        "all of it, without a gap"
        if not gaps
        else f"the longest without any of {format_count(gaps, 'gap')}"
    )
    means = "" if best.size == 1 else f", averaged over {best.size}"
    rate = best.rate * best.size
    where = f"{best.seconds:,.2f} s from {best.start:,.2f} s on"
    yield f"{best.rows:,} rows at {rate:,.2f} Hz{means}: {where}, {whole}."
    if series.steps.irregular:
        share = percent(series.steps.irregular, series.steps.rows)
        yield (
            f"The rate is not uniform: {share} of the steps differ from those around them by more than a "
            "tenth. The figures take it to be."
        )
    limit = AT_REST[series.name.removesuffix("_hr")]
    spread = float(best.values.std(axis=0).max())
    if spread > limit:
        unit = next(iter(series.panels.values())).unit
        yield (
            f"The device moved (standard deviation {spread:.3g} {unit}): what follows is its motion, not its "
            "noise."
        )


def _figures_of(series: Series, curves: list[tuple[FloatArray, FloatArray]]) -> str:
    walk_unit, walk_factor, bias_unit, bias_factor = READ_IN[series.name.removesuffix("_hr")]
    rows = []
    for axis, (tau, deviation) in zip("xyz", curves, strict=True):
        if not np.all(deviation > 0):
            rows.append((axis, "constant or too large", "", "", "", ""))
            continue
        read = at_one_second(tau, deviation)
        walk = slope = "not reached"
        if read is not None:
            walk, slope = f"{read[0] * walk_factor:.4g}", f"{read[1]:.2f}"
            if not WHITE[0] <= read[1] <= WHITE[1]:
                walk = f"({walk})"
        floor = flicker_floor(tau, deviation)
        bias = f"{floor.bias * bias_factor:.4g}"
        bias = bias if floor.is_reached else f"less than {bias}"
        rows.append((axis, walk, slope, bias, f"{floor.tau:.3g}", f"{deviation[0]:.4g}"))
    kind = "angle" if series.name.startswith("rate") else "velocity"
    unit = next(iter(series.panels.values())).unit
    top = (
        "axis",
        f"{kind} random walk, {walk_unit}",
        "slope at 1 s",
        f"bias instability, {bias_unit}",
        "at, s",
        f"at {curves[0][0][0]:.3g} s, {unit}",
    )
    text = _table(top, rows, right=(1, 2, 3, 4, 5))
    if any(row[1].startswith("(") for row in rows):
        text += _soft("In brackets: no random walk, since the slope is not near -1/2.")
    return text


# What is looked up


def _gaps(it: Gathered) -> str:
    gaps = zip(it.facts.gaps, it.gaps, strict=True)
    largest = sorted(gaps, key=lambda gap: -gap[0].lost)[:SHOWN]
    rows = [
        (_since(it, x), f"{gap.lost:,}", f"{gap.sample:,}")
        for gap, x in sorted(largest, key=lambda gap: gap[0].sample)
    ]
    text = _table(("before, s", "samples lost", "next sample"), rows, right=(0, 1, 2))
    return text + _more(len(it.facts.gaps), "gaps, smaller")


def _damage(it: Gathered) -> str:
    rows = [(f"{at:,}", f"{n:,}", why) for at, n, why in it.facts.damage[:SHOWN]]
    text = _table(("byte", "bytes", "reason"), rows, right=(0, 1))
    return text + _more(len(it.facts.damage), "stretches")


def _events(it: Gathered) -> str:
    rows = [
        (_since(it, x), f"{event.offset:,}", event.name, str(event.notice))
        for event, x in list(zip(it.facts.events, it.events, strict=True))[:SHOWN]
    ]
    text = _table(("after, s", "byte", "", "what it says"), rows, right=(0, 1))
    return text + _more(len(it.facts.events), "events")


def _messages(it: Gathered) -> str:
    rows = [("MTData2 (samples)", f"{it.facts.stats.samples:,}")]
    rows += [(name, f"{n:,}") for name, n in it.facts.messages.most_common()]
    rows += [(f"{name} (string)", f"{n:,}") for name, n in it.facts.strings.most_common()]
    return _table(("message", "how many"), rows, right=(1,))


def _settings(it: Gathered) -> str:
    text = ""
    if (configuration := it.facts.identity.configuration) is not None:
        text += _table(("Configuration", ""), _configured(configuration))
    if it.settings:
        rows = [(f"{said.time:,.2f}", said.name, said.words) for said in it.settings]
        at = "after, s" if it.axis.kind == "time" else it.axis.kind
        text += _table((at, "message", "what it says"), rows, right=(0,))
        if len(it.settings) == SETTINGS:
            text += _soft("There may be more; xbus dump lists all.")
    return text or "<p>The recording holds no message that tells any.</p>\n"


def _configured(it: Configuration) -> Iterator[tuple[str, str]]:
    named = {
        "filter profile": it.filter_profile,
        "filter type": it.filter_type,
        "filter version": ".".join(map(str, it.filter_version)) if any(it.filter_version) else None,
        "devices on the bus": it.devices,
        "sampling period, 1/115200 s": it.sampling_period,
        "output skip factor": it.output_skip_factor,
        "output mode (older MTData)": it.output_mode,
        "output settings (older MTData)": it.output_settings,
    }
    for name, value in named.items():
        if value is not None:
            yield name, str(value)


def _unknown(it: Gathered) -> str:
    rows = [(f"0x{key:04X}", f"{n:,}", f"{size:,}") for key, (n, size) in it.facts.unknown.items()]
    text = _table(("identifier", "packets", "bytes"), rows[:SHOWN], right=(1, 2))
    return text + _more(len(rows), "identifiers")


def _since(it: Gathered, x: float) -> str:
    return f"{x:,.2f}" if it.axis.kind == "time" else ""
