"""The screen: a `rich` renderable that fits any size."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from rich.console import (
    Console,
    ConsoleOptions,
    Group,
    OverflowMethod,
    RenderableType,
    RenderResult,
)
from rich.layout import Layout
from rich.table import Table
from rich.text import Text

from xbus.cli.monitor.horizon import compass, horizon
from xbus.formatting import format_size, printable
from xbus.protocol.values import State
from xbus.watch.attitude import Attitude
from xbus.watch.model import Model, MonitorEvent
from xbus.watch.rows import (
    ASCII,
    BAD,
    DIM,
    HEAD,
    PLAIN,
    UNICODE,
    WARNING,
    Glyphs,
    Span,
    StatusRow,
    ValueRow,
    device_state,
    format_elapsed,
    status_rows,
    value_rows,
)
from xbus.watch.values import format_unit

__all__ = ["Screen", "ViewState", "visible_rows"]

KEYS = (
    ("q", "quit (or Ctrl-C)"),
    (
        "p, space",
        "pause: the display of a device, which is still counted, or the replay of a recording",
    ),
    ("r", "start or stop recording a device to this folder; the date and time are the file name"),
    ("/", "show only quantities with a text in their name; Enter keeps the filter"),
    ("Esc", "show all quantities"),
    ("up, down", "scroll the quantities"),
    ("m", "make a device in Config State measure until the monitor ends"),
    ("?", "this page"),
)
#: Minimum height of the status, and limits of the height of the horizon in it.
STATUS_LINES, MIN_HORIZON, MAX_HORIZON = 6, 3, 13
#: Columns that the status needs beside the horizon, and columns between them.
STATUS_COLUMNS, GAP = 55, 2
#: Status rows that are shortened to one line if space is short, in this order.
SHORTENED = ("status", "heading", "GNSS", "losses")
#: Columns of a label, and maximum columns of a quantity name.
LABEL, NAME = 8, 26
#: Styles of rich.
HEADING, BAR, PICTURE, ON_SKY, ON_GROUND = (
    "bold",
    "reverse",
    "yellow on blue",
    "bold white on blue",
    "bold white on yellow",
)


@dataclass
class ViewState:
    """What the user has chosen to see.

    Attributes:
        filter_text: Text in the names of the visible quantities.
        is_typing: Whether the user types the filter.
        is_paused: Whether the display is paused.
        shows_help: Whether the help page is shown.
        first_row: Index of the first visible quantity.
    """

    filter_text: str = ""
    is_typing: bool = False
    is_paused: bool = False
    shows_help: bool = False
    first_row: int = 0


@dataclass
class Screen:
    """Renders a model on a full screen."""

    model: Model
    view: ViewState

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Renders a title, the status, the values and the keys, or the help page."""
        columns, lines = options.max_width, options.height or console.height
        glyphs = ASCII if options.ascii_only else UNICODE
        layout = Layout()
        keys = Layout(_keys(self.model, self.view), size=1)
        title = Layout(_title(self.model, self.view, columns, glyphs), size=1)
        if self.view.shows_help:
            layout.split_column(title, Layout(_help(self.model)), keys)
        else:
            rows = value_rows(self.model, self.view.filter_text)
            top = _status_height(columns, lines, len(rows))
            count = visible_rows(columns, lines, len(rows))
            status = Layout(_status(self.model, columns, top, glyphs), size=top, visible=top > 0)
            values = Layout(_values(self.model, self.view, rows, count))
            layout.split_column(title, status, values, keys)
        # rich marks cropped text with a character that ASCII does not have.
        overflow: OverflowMethod = "crop" if options.ascii_only else "ellipsis"
        yield from console.render(layout, options.update(no_wrap=True, overflow=overflow))


def visible_rows(columns: int, lines: int, rows: int) -> int:
    """Returns how many of the rows a screen of this size shows."""
    return max(0, lines - 3 - _status_height(columns, lines, rows))


def _status_height(columns: int, lines: int, rows: int) -> int:
    """Returns the lines of the status; the values come first, but the status keeps its minimum."""
    if lines < STATUS_LINES + 7:
        return max(0, min(STATUS_LINES, lines - 7))
    spare = lines - 3 - rows  # title, head of the table and keys have a line each
    return max(STATUS_LINES, min(spare, _max_horizon(columns) + 1))


def _max_horizon(columns: int) -> int:
    """Returns the lines of the largest horizon beside the status: an odd number, for a middle line."""
    lines = (columns - GAP - STATUS_COLUMNS - 3) // 4
    return min(MAX_HORIZON, lines - (lines % 2 == 0))


def _text(*spans: Span) -> Text:
    """Returns text without characters that control the terminal."""
    return Text.assemble(*((printable(text), style) for text, style in spans))


# Title and keys


def _title(model: Model, view: ViewState, columns: int, glyphs: Glyphs) -> Text:
    # The end of a long name says more than its start, and the parts after it say most.
    longest = max(NAME, columns // 3)
    name = model.name
    parts = [name if len(name) <= longest else glyphs.more + name[1 - longest :]]
    if model.recording is not None:
        parts.append(f"REC {format_size(model.recording.bytes)}")
    if view.is_paused:
        parts.append("PAUSED")
    parts.append(device_state(model))
    if model.progress is not None:
        is_over = model.progress >= 1
        parts.append("end of the recording" if is_over else f"{model.progress:.0%}")
    if model.baudrate is not None:
        parts.append(f"{model.baudrate} baud")
    parts.append(model.device or "")
    left, right = " " + "  ".join(filter(None, parts)), f" {format_elapsed(model.elapsed)} "
    middle = max(0, columns - len(right))
    return _text((f"{left[:middle]:<{middle}}{right}", BAR))


def _keys(model: Model, view: ViewState) -> Text:
    if view.is_typing:
        return _text((f"filter: {view.filter_text}_   Enter keeps it, Esc shows all", HEADING))
    if view.shows_help:
        return _text(("any key: back", DIM))
    spans: list[Span] = []
    if model.state == State.CONFIG and not model.is_listening:
        spans.append(("m starts measurement  ", WARNING))
    if view.filter_text:
        spans.append((f"filter {view.filter_text!r}, Esc shows all  ", HEADING))
    record = "" if model.state is None else "  r record"
    return _text(*spans, (f"q quit  p pause{record}  / filter  ? help", DIM))


def _help(model: Model) -> RenderableType:
    keys, events = (Table.grid(padding=(0, 1)) for _ in range(2))
    for table in (keys, events):
        table.add_column(width=9, no_wrap=True)
        table.add_column(no_wrap=False, overflow="fold")
    for key, text in KEYS:
        keys.add_row(_text((key, HEADING)), text)
    for event in reversed(model.events):
        events.add_row(format_elapsed(event.at), _text((event.text, _event_style(event))))
    if not model.events:
        return Group("", keys)
    return Group("", keys, "", _text(("Events, the latest first", HEADING)), events)


def _event_style(event: MonitorEvent) -> str:
    return BAD if event.is_bad else PLAIN


# Status


def _status(model: Model, columns: int, height: int, glyphs: Glyphs) -> RenderableType:
    # The compass below the horizon needs a line.
    lines = min(_max_horizon(columns), height - 1 - height % 2)
    if model.attitude is None or lines < MIN_HORIZON:
        return Group(*_status_lines(model, columns, height, glyphs))
    width = 4 * lines + 3
    layout = Layout()
    text = _status_lines(model, columns - width - GAP, height, glyphs)
    layout.split_row(
        Layout(_horizon(model.attitude, width, lines, glyphs), size=width + GAP),
        Layout(Group(*text)),
    )
    return layout


def _horizon(attitude: Attitude, width: int, height: int, glyphs: Glyphs) -> Group:
    """Returns an artificial horizon, two pixels per character, above a compass; both have a middle column."""
    pixels = horizon(attitude, width, 2 * height)
    middle = width // 2
    symbol = {middle + offset: "-" for offset in (-4, -3, -2, 2, 3, 4)} | {middle: "+"}
    lines: list[Text] = []
    for upper, lower in zip(pixels[::2], pixels[1::2], strict=True):
        cells = [glyphs.cells[2 * above + below] for above, below in zip(upper, lower, strict=True)]
        line = Text("".join(cells), PICTURE)
        if len(lines) == height // 2:
            for column, char in symbol.items():
                cells[column] = char
            line = Text("".join(cells), PICTURE)
            for column in symbol:
                line.stylize(ON_GROUND if upper[column] else ON_SKY, column, column + 1)
        lines.append(line)
    strip = Text(compass(attitude.heading, width, glyphs.mark))
    strip.stylize(BAR, middle, middle + 1)
    return Group(*lines, strip)


def _status_lines(model: Model, columns: int, height: int, glyphs: Glyphs) -> list[Text]:
    """Returns the status rows, and as many events below them as fit."""
    wrapped = {row.label: _wrap(row, columns - LABEL) for row in status_rows(model, glyphs)}
    events = list(reversed(model.events))
    available = height - min(1, len(events))  # the latest event always has a line
    for label in SHORTENED:
        lines = wrapped.get(label, [])
        while len(lines) > 1 and sum(map(len, wrapped.values())) > available:
            lines[-2:] = [Text(" ").join([lines[-2], lines[-1][LABEL:]])]
    found = [line for lines in wrapped.values() for line in lines][: max(0, available)]
    for event in events[: height - len(found)]:
        label = f"{format_elapsed(event.at):<{LABEL}}"
        found.append(_text((label, DIM), (event.text, _event_style(event))))
    return found


def _wrap(row: StatusRow, columns: int) -> list[Text]:
    """Returns the lines of a row; a line ends only between two parts."""
    lines: list[Text] = []
    for span in row.parts:
        if lines and len(lines[-1]) + len(row.separator) + len(span[0]) <= LABEL + columns:
            lines[-1].append(row.separator)
        else:
            lines.append(_text((f"{'' if lines else row.label:<{LABEL}}", DIM)))
        lines[-1].append_text(_text(span))
    return lines


# Values


def _values(model: Model, view: ViewState, rows: list[ValueRow], count: int) -> RenderableType:
    if not rows:
        return _text((_no_values(model, view), WARNING))
    # Wide enough for all quantities, so that a filter does not move the columns.
    quantities = model.quantities.values()
    name = min(NAME, max(len(HEAD[0]), *(len(quantity.name) for quantity in quantities)))
    unit = max(len(HEAD[2]), *(len(format_unit(quantity)) for quantity in quantities))
    first = max(0, min(view.first_row, len(rows) - count))
    numbers = {"above": first, "below": max(0, len(rows) - first - count)}
    hidden = " and ".join(f"{number} {where}" for where, number in numbers.items() if number)
    head = _text((_columns(HEAD, name, unit), HEADING))
    if hidden:
        head.append(f"   {hidden}: arrow keys", WARNING)
    return Group(head, *_value_lines(rows[first : first + count], name, unit))


def _value_lines(rows: Iterable[ValueRow], name: int, unit: int) -> Iterable[Text]:
    for row in rows:
        yield _text((_columns(row, name, unit), DIM if row[1] == "stopped" else PLAIN))


def _columns(row: ValueRow, name: int, unit: int) -> str:
    return f"{row[0][:name]:<{name}} {row[1]:>7} {row[2]:<{unit}}  {row[3]}"


def _no_values(model: Model, view: ViewState) -> str:
    if model.quantities:
        return f"no quantity has {view.filter_text!r} in its name"
    if model.is_lost:
        return "the port is gone; the monitor continues when it is back"
    if model.state == State.CONFIG:
        return "a device sends no samples in Config State"
    if model.state == State.MEASUREMENT and model.elapsed > 2:
        return "no samples: the device has no outputs (see xbus config dump PORT) or waits for a trigger"
    return "no samples yet"
