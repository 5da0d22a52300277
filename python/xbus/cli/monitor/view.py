"""The screen: what is known, drawn into lines of so many columns. Nothing here knows a terminal."""

from __future__ import annotations

import textwrap
from dataclasses import dataclass

from xbus.cli.monitor.attitude import Attitude, ground, tape
from xbus.cli.monitor.model import Model
from xbus.cli.monitor.rows import HEAD, Glyphs, Row, Span, Style, clock, rows, state, table
from xbus.cli.monitor.values import unit_text
from xbus.describe.formatting import format_size
from xbus.protocol.values import State

__all__ = ["Line", "Shown", "draw", "room"]

#: The keys, and what they do.
KEYS = (
    ("q", "quit (or Ctrl-C)"),
    ("p, space", "pause: of a device the display, counting goes on; of a recording its replay"),
    ("r", "of a device: begin or end a recording, in this folder, named by date and time"),
    ("/", "show only quantities with some text in their name: type it, Enter keeps it"),
    ("Esc", "show all quantities again"),
    ("up, down", "move through the quantities where there is no room for all"),
    ("m", "let a device in Config State measure, until the monitor ends"),
    ("?", "this page"),
)
#: Lines of the upper part at least, and of the picture in it: no more than these are of use.
LEAST, SMALLEST, LARGEST = 6, 3, 13
#: Columns that the words beside the picture need, and between them.
WORDS, GAP = 55, 2
#: Rows that lose their last lines where there is no room for all, one after the other.
SHORTER = ("status", "heading", "GNSS", "losses")
#: Columns of a label, and most columns of a quantity's name.
LABEL, NAME = 8, 26

Line = list[Span]


@dataclass
class Shown:
    """What the user wants to see.

    Attributes:
        wanted: Text in the names of the quantities that are shown.
        is_typing: Whether that text is being typed.
        is_paused: Whether the display stands still.
        is_help: Whether the page of help is shown.
        first: Index of the first quantity that is shown.
    """

    wanted: str = ""
    is_typing: bool = False
    is_paused: bool = False
    is_help: bool = False
    first: int = 0


def draw(model: Model, shown: Shown, columns: int, lines: int, glyphs: Glyphs) -> list[Line]:
    """The lines of the screen: ``lines`` of them, none longer than ``columns``."""
    if shown.is_help:
        body = _help(model, columns)
    else:
        found = table(model, shown.wanted)
        top = _height_of_top(columns, lines, len(found))
        body = _top(model, columns, top, glyphs)
        body += _table(model, found, shown, room(columns, lines, len(found)))
    body = [_title(model, shown, columns, glyphs), *body][: max(0, lines - 1)]
    body += [[] for _ in range(lines - 1 - len(body))]
    body.append(_bottom(model, shown))
    return [_clipped(it, columns, glyphs.more) for it in body]


def room(columns: int, lines: int, found: int) -> int:
    """How many quantities a screen of this size shows, of so many that there are."""
    return max(0, lines - 3 - _height_of_top(columns, lines, found))


def _height_of_top(columns: int, lines: int, found: int) -> int:
    """Lines of the upper part: the quantities come first, but the least of it is never missing for them."""
    spare = lines - 3 - found  # title, head of the table and keys have a line each
    if lines < LEAST + 7:
        return max(0, min(LEAST, lines - 7))
    return max(LEAST, min(spare, _sky(columns) + 1))


def _sky(columns: int) -> int:
    """Lines of the largest picture that fits beside the words, an odd number: it has one in the middle."""
    fitting = (columns - GAP - WORDS - 3) // 4
    return min(LARGEST, fitting - (fitting % 2 == 0))


# Title and keys


def _title(model: Model, shown: Shown, columns: int, glyphs: Glyphs) -> Line:
    # Of a long name the end tells more, and what follows tells most.
    longest = max(NAME, columns // 3)
    name = model.name
    parts = [name if len(name) <= longest else glyphs.more + name[1 - longest :]]
    if model.recorded is not None:
        parts.append(f"REC {format_size(model.recorded.bytes)}")
    if shown.is_paused:
        parts.append("PAUSED")
    if words := state(model):
        parts.append(words)
    if model.read is not None:
        parts.append("end of the recording" if model.read >= 1 else f"{model.read:.0%}")
    if model.baudrate is not None:
        parts.append(f"{model.baudrate} baud")
    if model.device is not None:
        parts.append(model.device)
    left, right = " " + "  ".join(parts), f" {clock(model.elapsed)} "
    middle = max(0, columns - len(right))
    return [(f"{left[:middle].ljust(middle)}{right}", Style.BAR)]


def _bottom(model: Model, shown: Shown) -> Line:
    if shown.is_typing:
        return [(f"names with: {shown.wanted}_   Enter keeps it, Esc shows all", Style.HEAD)]
    if shown.is_help:
        return [("any key: back", Style.DIM)]
    line: Line = []
    if model.state == State.CONFIG:
        line = [("m lets it measure  ", Style.WARN)]
    if shown.wanted:
        line = [(f"names with {shown.wanted!r}, Esc shows all  ", Style.HEAD)]
    record = "" if model.state is None else "  r record"
    return [*line, (f"q quit  p pause{record}  / filter  ? help", Style.DIM)]


def _help(model: Model, columns: int) -> list[Line]:
    lines: list[Line] = [[]]
    for key, words in KEYS:
        wrapped = textwrap.wrap(words, max(20, columns - 12))
        lines.append([(f"{key:<10}", Style.HEAD), (wrapped[0], Style.PLAIN)])
        lines += [[(" " * 10 + it, Style.PLAIN)] for it in wrapped[1:]]
    if model.events:
        lines += [[], [("What happened, the latest first", Style.HEAD)]]
    for event in reversed(model.events):
        style = Style.BAD if event.is_bad else Style.PLAIN
        wrapped = textwrap.wrap(event.text, max(20, columns - 12)) or [""]
        lines.append([(f"{clock(event.at):<10}", Style.PLAIN), (wrapped[0], style)])
        lines += [[(" " * 10 + it, style)] for it in wrapped[1:]]
    return lines


# The upper part


def _top(model: Model, columns: int, height: int, glyphs: Glyphs) -> list[Line]:
    # The compass below the picture needs a line, too.
    sky = min(_sky(columns), height - 1 - height % 2)
    if model.points is None or sky < SMALLEST:
        return _words(model, columns, height, glyphs)
    picture = _picture(model.points, sky, glyphs)
    width = sum(len(text) for text, _ in picture[0])
    picture += [[(" " * width, Style.PLAIN)]] * (height - len(picture))
    words = _words(model, columns - width - GAP, height, glyphs)
    words += [[] for _ in range(height - len(words))]
    gap = (" " * GAP, Style.PLAIN)
    return [[*left, gap, *right] for left, right in zip(picture, words, strict=True)]


def _picture(told: Attitude, height: int, glyphs: Glyphs) -> list[Line]:
    """An artificial horizon, two pixels a character, above a compass; both have a column in the middle."""
    width = 4 * height + 3
    pixels = ground(told, width, 2 * height)
    middle = width // 2
    symbol = {middle + it: "-" for it in (-4, -3, -2, 2, 3, 4)} | {middle: "+"}
    lines: list[Line] = []
    for at in range(height):
        upper, lower = pixels[2 * at : 2 * at + 2]
        line: Line = []
        for column, (above, below) in enumerate(zip(upper, lower, strict=True)):
            if 2 * at + 1 == height and column in symbol:
                line.append((symbol[column], Style.ON_GROUND if above else Style.ON_SKY))
            else:
                line.append((glyphs.cells[2 * above + below], Style.PICTURE))
        lines.append(line)
    compass = tape(told.heading, width, glyphs.mark)
    lines.append(
        [
            (compass[:middle], Style.PLAIN),
            (compass[middle], Style.BAR),
            (compass[middle + 1 :], Style.PLAIN),
        ]
    )
    return lines


def _words(model: Model, columns: int, height: int, glyphs: Glyphs) -> list[Line]:
    """The rows beside the picture, and under them as many events as there is room for."""
    wrapped = {it.label: _wrapped(it, columns - LABEL) for it in rows(model, glyphs)}
    least = min(1, len(model.events))  # the latest event has a line in any case
    for row in (wrapped[it] for it in SHORTER if it in wrapped):
        while len(row) > 1 and sum(map(len, wrapped.values())) > height - least:
            _, *rest = row.pop()
            row[-1] = [*row[-1], (" ", Style.PLAIN), *rest]
    lines = [line for row in wrapped.values() for line in row][: max(0, height - least)]
    for event in list(reversed(model.events))[: height - len(lines)]:
        style = Style.BAD if event.is_bad else Style.PLAIN
        lines.append([(f"{clock(event.at):<{LABEL}}", Style.DIM), (event.text, style)])
    return [_clipped(it, columns, glyphs.more) for it in lines]


def _wrapped(row: Row, columns: int) -> list[Line]:
    """The lines of a row, broken between its parts."""
    lines: list[Line] = []
    left = 0
    for text, style in row.parts:
        between = row.between
        if not lines or len(between) + len(text) > left:
            lines.append([(f"{'' if lines else row.label:<{LABEL}}", Style.DIM)])
            between, left = "", columns
        lines[-1] += [(between, Style.PLAIN), (text, style)]
        left -= len(between) + len(text)
    return lines


# The table


def _table(
    model: Model,
    found: list[tuple[str, str, str, str]],
    shown: Shown,
    room: int,
) -> list[Line]:
    if not found:
        return [[(_nothing(model, shown), Style.WARN)]]
    # As wide as it takes for all of them: a filter moves nothing.
    every = model.quantities.values()
    name = min(NAME, max(len(HEAD[0]), *(len(it.name) for it in every)))
    unit = max(len(HEAD[2]), *(len(unit_text(it)) for it in every))
    lines: list[Line] = [[(_cells(HEAD, name, unit), Style.HEAD)]]
    first = max(0, min(shown.first, len(found) - room))
    for row in found[first : first + room]:
        style = Style.DIM if row[1] == "stopped" else Style.PLAIN
        lines.append([(_cells(row, name, unit), style)])
    hidden = len(found) - first - room
    if hidden > 0 or first > 0:
        where = " and ".join(
            f"{number} {what}"
            for number, what in ((first, "above"), (hidden, "below"))
            if number > 0
        )
        lines[0].append((f"   {where}: arrow keys", Style.WARN))
    return lines


def _cells(row: tuple[str, str, str, str], name: int, unit: int) -> str:
    return f"{row[0][:name]:<{name}} {row[1]:>7} {row[2]:<{unit}}  {row[3]}"


def _nothing(model: Model, shown: Shown) -> str:
    if model.quantities:
        return f"no quantity has {shown.wanted!r} in its name"
    if model.is_lost:
        return "the port is gone; the monitor goes on when it is there again"
    if model.state == State.CONFIG:
        return "nothing comes in Config State"
    if model.state == State.MEASUREMENT and model.elapsed > 2:
        return (
            "nothing comes: has it outputs (xbus send PORT --config ReqOutputConfiguration), "
            "or does it wait for a trigger?"
        )
    return "no quantity has come yet"


def _clipped(line: Line, columns: int, more: str) -> Line:
    """The line, no longer than there is room; what says that there was more is its last character."""
    if sum(len(text) for text, _ in line) <= columns:
        return line
    clipped, left = [], columns
    for text, style in line:
        if len(text) >= left:
            clipped.append((text[: max(0, left - 1)] + more[:left], style))
            break
        clipped.append((text, style))
        left -= len(text)
    return clipped
