"""The health of a device in one line: what is always in view."""

from __future__ import annotations

import html

from xbus.formatting import format_count
from xbus.protocol.tables import STATUS_FLAGS
from xbus.protocol.values import EVERY, State
from xbus.studio.replaying import Replaying
from xbus.studio.station import Station
from xbus.watch.model import Model
from xbus.watch.rows import (
    BAD,
    DIM,
    GOOD,
    PLAIN,
    UNICODE,
    WARNING,
    Span,
    device_state,
    has_receiver,
    losses,
    status_rows,
)

__all__ = ["ages", "clipping", "devices", "filter_state", "health", "rates"]

#: Classes of the style sheet by style of a row.
CLASSES = {GOOD: "xbus-ok", DIM: "xbus-quiet", WARNING: "xbus-caution", BAD: "xbus-fault"}
#: What each fact means.
MEANINGS = {
    "state": "Measurement State: the device sends data. Config State: it takes settings.",
    "replay": "A recording is replayed. Rates, ages and times are those of the recording, at any speed.",
    "devices": "Devices on one line, by bus identifier (BID). Rates and numbers mix them; plots do not.",
    "rate": "Of the fastest output, as measured, and outputs that are not at their configured rates.",
    "age": "Outputs whose latest value is overdue.",
    "filter": "Whether orientation is valid, and how the filter uses the receiver, by the status word.",
    "clipping": "Axes that were out of the range of the sensor, by the status word, since the device was "
    "opened or the counts were cleared.",
    "GNSS": "Fix, RTK, satellites in use (SV), and the horizontal and vertical accuracy by the receiver.",
    "losses": "Samples that are missing by the packet counter, and bytes that are no frame, since the device "
    "was opened or the counts were cleared.",
    "recording": "Time since the recording began.",
}
#: Share by which a measured rate may differ from the configured one.
TOLERANCE = 0.03
#: Quantities that are named at most because they are overdue, or not at their rates.
NAMED = 3
#: Seconds for which a value out of range stays striking.
RECENT = 60.0


def health(station: Station) -> str:
    """Returns the health of a device as HTML; all of its text is escaped."""
    model, replaying = station.model, station.replaying
    facts = [
        ("state", [(device_state(model), BAD if model.is_lost else PLAIN)])
        if replaying is None
        else ("replay", [(_progress(replaying), PLAIN)]),
        ("devices", devices(model)),
        ("rate", rates(station)),
        ("age", [] if replaying is not None and replaying.is_over else ages(station)),
        ("filter", filter_state(model)),
        ("clipping", clipping(model)),
    ]
    # Heading and flags are on the page Live.
    rows = [row for row in status_rows(model, UNICODE) if row.label not in ("heading", "status")]
    facts += [(row.label, losses(model) if row.label == "losses" else row.parts) for row in rows]
    if (recording := station.recording) is not None:
        text = f"{recording.seconds:.0f} s" if recording.error is None else "ended early"
        facts.append(("recording", [(text, BAD)]))
    return "".join(_fact(label, parts) for label, parts in facts if parts)


def devices(model: Model) -> list[Span]:
    """Returns the devices whose numbers are mixed; none if there is only one."""
    if len(model.devices) < 2:
        return []
    bids = ", ".join(map(str, sorted(model.devices)))
    return [(f"BID {bids}: the numbers mix them, plots do not", WARNING)]


def _progress(replaying: Replaying) -> str:
    if replaying.is_over:
        return "end of the recording"
    return "" if replaying.speed == 1 else f"at {replaying.speed:g}× speed"


def rates(station: Station) -> list[tuple[str, str]]:
    """Returns the measured rate of the fastest output, and the outputs whose rate is not as configured."""
    model = station.model
    if model.state == State.CONFIG and station.replaying is None:
        return []  # it sends nothing on purpose, as the state says
    outputs = station.outputs or ()
    configured = {each.quantity: each.frequency for each in outputs if 0 < each.frequency < EVERY}
    measured: dict[str, float | None] = {}
    for quantity in list(model.quantities.values()):
        measured[quantity.name] = quantity.rate(model.now)
    fastest = max(configured, key=lambda name: configured[name], default=None)
    fastest = fastest or next(iter(measured), None)
    if fastest is None:
        return [("nothing received", WARNING)]
    rate = measured.get(fastest, 0.0)
    parts = [
        (
            "stopped" if rate == 0 else "measuring" if rate is None else f"{rate:.1f} Hz",
            BAD if rate == 0 else "",
        )
    ]
    others = []
    for name, expected in configured.items():
        actual = measured.get(name or "", 0.0)
        if actual is not None and abs(actual - expected) > TOLERANCE * expected + 0.2:
            others.append((f"{name} {actual:.1f} of {expected} Hz", WARNING))
    return parts + _shortened(others)


def ages(station: Station) -> list[Span]:
    """Returns the outputs that are overdue, with the age of their latest values; the oldest first.

    Outputs that are no longer configured are left out, and all of them in Config State.
    """
    model, outputs = station.model, station.outputs
    if model.state == State.CONFIG and station.replaying is None:
        return []
    configured = None if outputs is None else {each.quantity for each in outputs}
    received = list(model.quantities.values())
    overdue = {
        quantity.name: model.now - quantity.updated_at
        for quantity in received
        if model.current(quantity.name) is None
        and (configured is None or quantity.name in configured)
    }
    if not overdue:
        return [("all values are current", GOOD)] if received else []
    if len(overdue) > NAMED and len(overdue) == len({each.name for each in received}):
        return [(f"nothing for {min(overdue.values()):.0f} s", WARNING)]
    oldest = sorted(overdue.items(), key=lambda item: -item[1])
    return _shortened([(f"{name} {age:.0f} s old", WARNING) for name, age in oldest])


def _shortened(parts: list[Span]) -> list[Span]:
    more = len(parts) - NAMED
    return parts[:NAMED] + ([(f"and {more} more", WARNING)] if more > 0 else [])


def filter_state(model: Model) -> list[Span]:
    """Returns whether the orientation filter is valid, and how it uses the GNSS receiver."""
    if (status := model.status) is None:
        return [] if model.attitude is None else [("no status word", DIM)]
    word = int(status.value)
    is_valid = STATUS_FLAGS["filter_valid"].of(word)
    if not is_valid and model.attitude is None:
        return []  # the device has none, or sends nothing of it
    parts = [("valid", GOOD) if is_valid else ("not valid", WARNING)]
    if status.name == "status_word" and has_receiver(model):
        mode = STATUS_FLAGS["filter_mode"]
        parts.append((mode.values.get(mode.of(word), f"mode {mode.of(word)}"), PLAIN))
    return parts


def clipping(model: Model) -> list[Span]:
    """Returns the axes that were out of range, the last ones first; also those of a single sample."""
    if model.current("status_word") is None and not model.clipped:
        return [("no status word", DIM)] if model.quantities else []
    parts = []
    for name, axis in sorted(model.clipped.items(), key=lambda item: -item[1].at):
        age = model.now - axis.at
        when = "now" if age < 1 else f"{age:.0f} s ago"
        style = BAD if age < 1 else WARNING if age < RECENT else DIM
        parts.append((f"{name} {when} ({format_count(axis.samples, 'sample')})", style))
    return parts or [("none", GOOD)]


def _fact(label: str, parts: list[tuple[str, str]]) -> str:
    texts = " ".join(
        f'<b class="{CLASSES.get(style, "")}">{html.escape(text)}</b>'
        for text, style in parts
        if text
    )
    meaning = html.escape(MEANINGS.get(label, ""))
    return (
        f'<span class="xbus-fact" title="{meaning}"><span class="xbus-quiet">{html.escape(label)}</span>'
        f"{texts}</span>"
    )
