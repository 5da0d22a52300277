"""The state of a stream as rows of text: for a screen, a snapshot and a page."""

from __future__ import annotations

import math
from typing import NamedTuple

from xbus.formatting import describe_losses, format_count, format_size
from xbus.protocol.values import State
from xbus.watch.attitude import Attitude
from xbus.watch.model import Model, QuantityState
from xbus.watch.values import format_rate, format_unit, format_value, set_flags

__all__ = [
    "ASCII",
    "HEAD",
    "UNICODE",
    "Glyphs",
    "Span",
    "StatusRow",
    "ValueRow",
    "device_state",
    "format_elapsed",
    "format_length",
    "glyphs_for",
    "has_receiver",
    "losses",
    "status_rows",
    "value_rows",
]

#: Column names of the table of values.
HEAD = ("quantity", "rate/Hz", "unit", "latest")
#: Quantities of products with a GNSS receiver.
POSITION = ("gnss_pvt_data", "gnss_sat_info", "lat_lon", "altitude_ellipsoid", "velocity_xyz")
#: Bytes without a frame after which the baud rate is probably wrong.
UNDECODED_BYTES = 500
#: Fields of the status word where 1 is one value among others.
NUMBERS = ("no_rotation_update_status", "filter_mode", "rtk_status")
#: Styles of rich.
PLAIN, DIM, GOOD, WARNING, BAD = "", "dim", "green", "bold yellow", "bold red"

#: Text and its style.
Span = tuple[str, str]
#: Name, rate, unit and latest value of a quantity.
ValueRow = tuple[str, str, str, str]


class Glyphs(NamedTuple):
    """Characters that not every terminal has.

    Attributes:
        cells: Parts of the horizon: sky, ground below, ground above, ground.
        mark: A mark on the compass.
        degree: The unit of an angle.
        more: Replaces text that does not fit.
    """

    cells: str = " ▄▀█"
    mark: str = "·"
    degree: str = "°"
    more: str = "…"


UNICODE, ASCII = Glyphs(), Glyphs(" .'#", ".", "", "~")


def glyphs_for(encoding: str | None) -> Glyphs:
    """Returns the characters for an encoding, as `rich` chooses them."""
    return UNICODE if (encoding or "").lower().startswith("utf") else ASCII


class StatusRow(NamedTuple):
    """A row of the status: label, parts, and the separator between parts on one line."""

    label: str
    parts: list[Span]
    separator: str = "  "

    @property
    def text(self) -> str:
        """All parts on one line."""
        return self.separator.join(text for text, _ in self.parts)


def status_rows(model: Model, glyphs: Glyphs) -> list[StatusRow]:
    """Returns the rows above the table of values, the most important first."""
    rows = []
    if model.attitude is not None:
        rows.append(StatusRow("heading", _attitude(model.attitude, glyphs.degree)))
    elif model.last_attitude is not None:
        age = model.now - model.last_attitude[1]
        rows.append(StatusRow("heading", [(f"no attitude for {age:.0f} s", WARNING)]))
    if model.fix.type is not None and has_receiver(model):
        rows.append(StatusRow("GNSS", _gnss(model)))
    if model.corrections is not None:
        rows.append(StatusRow("caster", [(model.corrections, PLAIN)]))
    if (status := model.status) is not None:
        parts = _flags(status, has_filter=model.attitude is not None)
        rows.append(StatusRow("status", parts, " "))
    queue = [] if model.progress is not None else [(_queue(model), PLAIN)]
    rows.append(StatusRow("losses", losses(model) + queue))
    return rows


def value_rows(model: Model, filter_text: str = "") -> list[ValueRow]:
    """Returns a row for each quantity with ``filter_text`` in its name."""
    return [
        (
            quantity.name,
            format_rate(quantity.rate(model.now)),
            format_unit(quantity),
            format_value(quantity),
        )
        for quantity in model.quantities.values()
        if filter_text.lower() in quantity.name.lower()
    ]


def device_state(model: Model) -> str:
    """Returns the state of the device as text; an empty string for a recording."""
    if model.is_lost:
        return "port lost, waiting for it"
    if model.state is None:
        return ""
    if model.state == State.UNKNOWN:
        return "state unknown" + (", only listening" if model.is_listening else "")
    return f"{model.state.capitalize()} State" + (", only listening" if model.is_listening else "")


def format_elapsed(seconds: float) -> str:
    """Returns seconds as hours, minutes and seconds."""
    minutes, seconds = divmod(int(seconds), 60)
    return f"{minutes // 60}:{minutes % 60:02}:{seconds:02}"


def _attitude(attitude: Attitude, degree: str) -> list[Span]:
    pitch, roll = _format_angle(attitude.pitch), _format_angle(attitude.roll)
    return [
        (f"{round(attitude.heading) % 360:03}{degree} {attitude.point}", PLAIN),
        (f"pitch {pitch}{degree} {'up' if attitude.pitch >= 0 else 'down'}", PLAIN),
        (f"roll {roll}{degree} {'right' if attitude.roll >= 0 else 'left'}", PLAIN),
    ]


def _format_angle(degrees: float) -> str:
    return f"{abs(degrees):.1f}" if abs(degrees) < 99.95 else f"{abs(degrees):.0f}"


def has_receiver(model: Model) -> bool:
    """Returns whether the device has a GNSS receiver; a status word without a fix does not prove one."""
    names = {name for name, _ in model.quantities}
    return model.fix.type != "none" or not names.isdisjoint(POSITION)


def _gnss(model: Model) -> list[Span]:
    fix = model.fix
    kind = {"none": "no fix", "yes": "fix"}.get(fix.type or "", fix.type or "")
    if fix.type == "none":
        parts = [(kind, BAD)]
    elif fix.is_valid:
        parts = [(kind, GOOD)]
    else:
        parts = [(f"{kind}, no valid position", WARNING)]
    if fix.rtk is not None:
        rtk = "no RTK" if fix.rtk == "none" else f"RTK {fix.rtk}"
        parts.append((rtk, {"fixed": GOOD, "float": WARNING}.get(fix.rtk, PLAIN)))
    pvt = model.current("gnss_pvt_data")
    if pvt is not None:
        parts.append((f"{pvt.value['numSV']} SV", PLAIN))
        accuracies = [(name, float(pvt.value[name])) for name in ("hAcc", "vAcc")]
        parts += [(f"{name} {format_length(metres)}", PLAIN) for name, metres in accuracies]
    elif model.current("status_word") is None:
        parts.append(("stopped", WARNING))
    return parts


def format_length(metres: float) -> str:
    """Returns a length in m, or in mm if it is short."""
    if math.isnan(metres):
        return "unknown"
    return f"{1000 * metres:.0f} mm" if metres < 1 else f"{metres:.1f} m"


def _flags(status: QuantityState, *, has_filter: bool) -> list[Span]:
    """Returns the flags by name; problems come first."""
    flags = set_flags(status.name, int(status.value))
    parts = []
    if has_filter and "filter_valid" not in dict(flags):
        parts.append(("filter not valid", WARNING))
    bad = [flag for flag in flags if flag[0].startswith("clip")]
    for name, value in bad + [flag for flag in flags if flag not in bad]:
        is_number = value > 1 or name in NUMBERS
        style = BAD if (name, value) in bad else PLAIN
        parts.append((f"{name}={value}" if is_number else name, style))
    return parts


def losses(model: Model) -> list[Span]:
    """Returns what is missing or damaged."""
    counts = model.counts
    parts: list[Span] = []
    if not model.quantities and counts.skipped_bytes > UNDECODED_BYTES:
        size = format_size(counts.skipped_bytes)
        return [(f"no frame in {size}: try another baud rate, or look for EM1000 strings", WARNING)]
    has_counter = ("packet_counter", None) in model.quantities
    text = describe_losses(counts.lost_samples, counts.gaps, has_counter=has_counter)
    parts.append((text, BAD if counts.lost_samples else GOOD if has_counter else DIM))
    damage = [
        (f"{format_count(counts.skipped_bytes, 'byte')} damaged", counts.skipped_bytes),
        (format_count(counts.checksum_errors, "checksum error"), counts.checksum_errors),
        (format_count(counts.malformed, "malformed sample"), counts.malformed),
    ]
    parts += [(text, BAD) for text, number in damage if number] or [("no damage", GOOD)]
    if counts.overruns:
        parts.append((f"{format_count(counts.overruns, 'overrun')} in the driver or device", BAD))
    if counts.dropped_samples:
        parts.append((f"dropped: {format_count(counts.dropped_samples, 'sample')}", BAD))
    return parts


def _queue(model: Model) -> str:
    counts = model.counts
    if not counts.queued_bytes and not counts.unread_samples:
        return "queue empty"
    samples = format_count(counts.unread_samples, "sample")
    return f"queue: {format_size(counts.queued_bytes)}, {samples}"
