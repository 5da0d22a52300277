"""What is known of a stream in words, by rows: for the screen, and for a snapshot."""

from __future__ import annotations

from enum import Enum
from typing import NamedTuple

from xbus.cli.monitor.attitude import Attitude
from xbus.cli.monitor.model import Model
from xbus.cli.monitor.values import flags, rate_text, unit_text, value_text
from xbus.describe.formatting import format_count, format_size
from xbus.protocol.values import State

__all__ = [
    "ASCII",
    "HEAD",
    "UNICODE",
    "Glyphs",
    "Row",
    "Span",
    "Style",
    "clock",
    "rows",
    "safe",
    "state",
    "table",
]

#: What the table has.
HEAD = ("quantity", "rate/Hz", "unit", "latest")
#: Quantities of products with a GNSS receiver.
POSITION = ("gnss_pvt_data", "gnss_sat_info", "lat_lon", "altitude_ellipsoid", "velocity_xyz")
#: Bytes of damage from which on it is strange that nothing was found.
UNHEARD = 500
#: Fields of the status word in which 1 is one value among others.
NUMBERS = ("no_rotation_update_status", "filter_mode", "rtk_status")


class Style(Enum):
    """How text looks; what that is on a terminal stands in `xbus.cli.monitor.terminal`."""

    PLAIN = "plain"
    HEAD = "head"
    DIM = "dim"
    BAR = "bar"
    GOOD = "good"
    WARN = "warn"
    BAD = "bad"
    PICTURE = "picture"
    ON_SKY = "on sky"
    ON_GROUND = "on ground"


#: Text, and how it looks.
Span = tuple[str, Style]


class Glyphs(NamedTuple):
    """Characters that not every terminal has.

    Attributes:
        cells: Parts of the picture: sky, ground below, ground above, ground.
        mark: A mark on the compass.
        degree: Behind an angle.
        more: What stands for what there is no room for.
    """

    cells: str = " ▄▀█"
    mark: str = "·"
    degree: str = "°"
    more: str = "…"


UNICODE, ASCII = Glyphs(), Glyphs(" .'#", ".", "", "~")


class Row(NamedTuple):
    """A row: what it is about, its parts, and what stands between them where they share a line."""

    label: str
    parts: list[Span]
    between: str = "  "

    @property
    def text(self) -> str:
        """All of it in one line."""
        return self.between.join(text for text, _ in self.parts)


def rows(model: Model, glyphs: Glyphs) -> list[Row]:
    """What is known, but for the quantities and events, in the order of a glance."""
    found = []
    if model.points is not None:
        found.append(Row("heading", _pointing(model.points, glyphs.degree)))
    elif model.attitude is not None:
        age = model.now - model.attitude[1]
        found.append(Row("heading", [(f"not told for {age:.0f} s", Style.WARN)]))
    if model.fix.type is not None and _has_receiver(model):
        found.append(Row("GNSS", _gnss(model)))
    if (known := model.status) is not None:
        bits = 8 * known.value.dtype.itemsize
        parts = _status(int(known.value), bits, is_filtered=model.points is not None)
        found.append(Row("status", parts, " "))
    found.append(Row("losses", _losses(model)))
    return found


def table(model: Model, wanted: str = "") -> list[tuple[str, str, str, str]]:
    """A row for each quantity whose name has ``wanted`` in it: name, rate, unit and latest value."""
    return [
        (it.name, rate_text(it.rate(model.now)), unit_text(it), value_text(it))
        for it in model.quantities.values()
        if wanted.lower() in it.name.lower()
    ]


def state(model: Model) -> str:
    """The state of the device in words; empty for a recording."""
    if model.is_lost:
        return "port lost, waiting for it"
    if model.state is None:
        return ""
    if model.state == State.UNKNOWN:
        return "state unknown"
    return f"{model.state.capitalize()} State"


def clock(seconds: float) -> str:
    """Seconds as hours, minutes and seconds."""
    minutes, seconds = divmod(int(seconds), 60)
    return f"{minutes // 60}:{minutes % 60:02}:{seconds:02}"


def safe(text: str) -> str:
    """The text with nothing that a terminal would obey."""
    return text if text.isprintable() else "".join(it if it.isprintable() else "?" for it in text)


def _pointing(it: Attitude, degree: str) -> list[Span]:
    pitch, roll = _angle(it.pitch), _angle(it.roll)
    return [
        (f"{round(it.heading) % 360:03}{degree} {it.point}", Style.PLAIN),
        (f"pitch {pitch}{degree} {'up' if it.pitch >= 0 else 'down'}", Style.PLAIN),
        (f"roll {roll}{degree} {'right' if it.roll >= 0 else 'left'}", Style.PLAIN),
    ]


def _angle(degrees: float) -> str:
    return f"{abs(degrees):.1f}" if abs(degrees) < 99.95 else f"{abs(degrees):.0f}"


def _has_receiver(model: Model) -> bool:
    """Whether anything but zeros of the status word speaks of a GNSS receiver."""
    names = {name for name, _ in model.quantities}
    return model.fix.type != "none" or not names.isdisjoint(POSITION)


def _gnss(model: Model) -> list[Span]:
    fix = model.fix
    kind = {"none": "no fix", "yes": "fix"}.get(fix.type or "", fix.type or "")
    rtk = "no RTK" if fix.rtk == "none" else f"RTK {fix.rtk}"
    parts = [(kind, Style.BAD if fix.type == "none" else Style.GOOD)]
    if fix.rtk is not None:
        parts.append((rtk, {"fixed": Style.GOOD, "float": Style.WARN}.get(fix.rtk, Style.PLAIN)))
    pvt = model.latest("gnss_pvt_data")
    if pvt is not None:
        accuracies = [(it, float(pvt.value[it])) for it in ("hAcc", "vAcc")]
        parts.append((f"{pvt.value['numSV']} SV", Style.PLAIN))
        parts += [(f"{name} {_length(it)}", Style.PLAIN) for name, it in accuracies]
    if pvt is None and model.latest("status_word") is None:
        parts.append(("stopped", Style.WARN))
    return parts


def _length(metres: float) -> str:
    return f"{1000 * metres:.0f} mm" if metres < 1 else f"{metres:.1f} m"


def _status(word: int, bits: int, *, is_filtered: bool) -> list[Span]:
    """The flags by name; what says that something is wrong stands first."""
    found = flags(word, bits)
    parts = []
    if is_filtered and "filter_valid" not in dict(found):
        parts.append(("filter not valid", Style.WARN))
    bad = [it for it in found if it[0].startswith("clip")]
    for name, value in bad + [it for it in found if it not in bad]:
        is_number = value > 1 or name in NUMBERS
        style = Style.BAD if (name, value) in bad else Style.PLAIN
        parts.append((f"{name}={value}" if is_number else name, style))
    return parts


def _losses(model: Model) -> list[Span]:
    counts = model.counts
    parts: list[Span] = []
    if not model.quantities and counts.skipped_bytes > UNHEARD:
        nothing = f"nothing in {format_size(counts.skipped_bytes)}: another baud rate, or --string EM1000?"
        return [(nothing, Style.WARN)]
    if counts.lost_samples:
        where = format_count(counts.gaps, "gap")
        parts.append((f"{format_count(counts.lost_samples, 'sample')} lost in {where}", Style.BAD))
    elif ("packet_counter", None) not in model.quantities:
        parts.append(("no packet_counter tells losses", Style.DIM))
    else:
        parts.append(("nothing lost", Style.GOOD))
    damage = [
        (f"{format_count(counts.skipped_bytes, 'byte')} damaged", counts.skipped_bytes),
        (format_count(counts.checksum_errors, "checksum error"), counts.checksum_errors),
        (format_count(counts.malformed, "malformed sample"), counts.malformed),
    ]
    said = [(text, Style.BAD) for text, number in damage if number]
    parts += said or [("no damage", Style.GOOD)]
    if counts.overruns:
        parts.append((f"{format_count(counts.overruns, 'overrun')} in the driver", Style.BAD))
    if counts.dropped_bytes or counts.dropped_samples:
        dropped = (
            f"{format_size(counts.dropped_bytes)}, {format_count(counts.dropped_samples, 'sample')}"
        )
        parts.append((f"dropped: {dropped}", Style.BAD))
    if model.read is None:
        waiting = f"{format_size(counts.queued_bytes)}, {format_count(counts.unread_samples, 'sample')} wait"
        is_empty = not counts.queued_bytes and not counts.unread_samples
        parts.append(("queue empty", Style.PLAIN) if is_empty else (waiting, Style.PLAIN))
    return parts
