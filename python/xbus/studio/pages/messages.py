"""Messages: compose any message by name, and see what goes out and comes in."""

from __future__ import annotations

import contextlib
import html
import time
from enum import IntEnum
from typing import Any

from nicegui import ui

from xbus.errors import StateError
from xbus.protocol.messages import LAYOUTS
from xbus.protocol.tables import MESSAGES, MessageRow
from xbus.studio.commands import command_line
from xbus.studio.exchange import Entry
from xbus.studio.pages.message_form import MessageForm
from xbus.studio.setting_fields import command_help
from xbus.studio.shell import Session
from xbus.studio.station import Station
from xbus.wire.hextext import frame_from_hex

__all__ = ["messages_page"]

#: Messages that are shown.
SHOWN = 200
#: Bytes of a message that are shown.
SHOWN_BYTES = 64
#: What differs for a recording.
REPLAYED = (
    "A virtual device replays this recording, and replies to messages: its settings are not those of the"
    " recorded device. Config State interrupts the replay, which then starts again at the moment that you"
    " chose last."
)


def messages_page(session: Session) -> None:
    """Shows the messages of the selected device."""
    if (station := session.require_station()) is None:
        return
    if station.replaying is not None:
        ui.label(REPLAYED).classes("xbus-card xbus-caution w-full mb-3")
    with ui.element("div").classes("xbus-card w-full"):
        _Composer(session, station)
        _hex_input(session, station)
    with ui.element("div").classes("xbus-card w-full mt-3"):
        with ui.row().classes("items-center w-full"):
            search = ui.input("filter: name, content or bytes").props("dense clearable")
            search.classes("w-80")
            ui.space()
            ui.button("Save", icon="save", on_click=lambda: _save(station)).props(
                "flat dense no-caps"
            )
            ui.button("Clear", on_click=lambda: station.exchange.entries.clear()).props(
                "flat dense no-caps"
            )
        table = ui.html("", sanitize=False).classes("w-full")
        shown: list[Any] = []

        def refresh() -> None:
            state = [station.exchange.count, len(station.exchange.entries), search.value]
            if state != shown:
                shown[:] = state
                table.set_content(_table(list(station.exchange.entries), search.value or ""))

        refresh()
        ui.timer(0.3, refresh)


class _Composer:
    """Name and fields of a message to send."""

    def __init__(self, session: Session, station: Station) -> None:
        self._session, self._station = session, station
        self._form: MessageForm | None = None
        names = [name for name in LAYOUTS if MESSAGES[name].direction != "to host"]
        with ui.row().classes("items-start w-full no-wrap max-lg:flex-wrap gap-4"):
            self._message = (
                ui.select(names, value="ReqDID", label="message", with_input=True)
                .classes("w-72 shrink-0")
                .props("dense")
            )
            self._body = ui.row().classes("grow items-start gap-x-4 gap-y-0")
            self._in_config = ui.checkbox("in Config State", value=True)
            self._in_config.on_value_change(self._show_command).classes("shrink-0").tooltip(
                "enters Config State for the message, and restores the state"
            )
            ui.button("Send", icon="send", on_click=self._send).props("no-caps").classes("shrink-0")
        self._hint = ui.label().classes("xbus-quiet text-sm")
        self._message.on_value_change(self._choose)
        self._choose()

    @property
    def _row(self) -> MessageRow:
        return MESSAGES[self._message.value]

    def _choose(self) -> None:
        """Shows the fields of another message."""
        states, support = self._row.states, self._station.device.support
        self._form = None  # it shows the command once it is complete
        self._in_config.set_value(states == ("config",))
        valid = " or ".join(f"{state.capitalize()} State" for state in states)
        parts = [command_help(self._row.name), f"MID 0x{self._row.mid:02X}, valid in {valid}."]
        if support is not None and self._row.name not in support.messages:
            parts.append(f"The {support.product.name} does not have it.")
        self._hint.set_text(" ".join(part for part in parts if part))
        self._body.clear()
        with self._body:
            self._form = MessageForm(self._row.name, support, self._show_command, self._send)
        self._show_command()

    def _show_command(self) -> None:
        if self._form is None or self._station.replaying is not None:
            return
        name, config = self._row.name, ["--config"] if self._in_config.value else []
        value = f", {self._literal()}" if LAYOUTS[name].fields else ""
        device = "with device.configure() as cfg: cfg" if config else "device"
        self._session.show_command(
            command_line("send", self._station.source, *config, name, *self._form.words),
            f'{device}.command("{name}"{value})',
        )

    def _literal(self) -> str:
        """Returns the value in Python; only its name if it is not complete, or a record."""
        with contextlib.suppress(ValueError):
            value = self._form.read() if self._form is not None else None
            if isinstance(value, IntEnum):
                return f"xbus.protocol.{type(value).__name__}.{value.name}"
            if type(value) in (int, float, str, bytes):
                return repr(value)
        return "value"

    async def _send(self) -> None:
        name, form, device = self._row.name, self._form, self._station.device
        in_config = self._in_config.value
        if form is None or (in_config and not await self._session.may_interrupt(self._station)):
            return

        def command() -> None:
            value = form.read()
            with device.configure() if in_config else contextlib.nullcontext():
                try:
                    device.command(name, value)
                except StateError as error:
                    raise _state_problem(error) from None

        self._show_command()
        await self._session.attempt(command)


def _state_problem(error: StateError) -> Exception:
    """Returns the problem with a remedy of this page; the error itself names Python functions."""
    states = MESSAGES[error.command].states
    if error.state in states:  # the product is the problem
        return error
    valid = " or ".join(f"{state.capitalize()} State" for state in states)
    remedy = (
        "tick in Config State"
        if "config" in states
        else "untick in Config State, or send GoToMeasurement"
    )
    return ValueError(f"{error.command} is valid in {valid} only; nothing was sent; {remedy}")


def _hex_input(session: Session, station: Station) -> None:
    with ui.row().classes("items-center w-full no-wrap"):
        raw = ui.input("or in hex", placeholder="FA FF 30 00 D1, or MID and payload: 30")
        raw.classes("grow").props("dense")
        send = ui.button("Send hex").props("flat no-caps")

    async def run() -> None:
        def command() -> None:
            station.device.send(frame_from_hex(raw.value))

        if station.replaying is None:
            session.show_command(
                command_line("send", station.source, "--hex", raw.value), "device.send(data)"
            )
        await session.attempt(command)

    send.on_click(run)
    raw.on("keydown.enter", run)


def _table(entries: list[Entry], search: str) -> str:
    """Returns the latest messages that contain a text as HTML, the last one first."""
    wanted = search.lower().strip()
    found = [
        entry
        for entry in entries
        if wanted in entry.name.lower()
        or wanted in entry.text.lower()
        or wanted in entry.frame.hex(" ")
    ][-SHOWN:]
    if not found:
        return '<span class="xbus-quiet">no messages; samples are not shown here</span>'
    rows = "".join(
        f'<tr class="{"xbus-fault" if entry.name in ("Error", "damage") else ""}">'
        f"<td>{_clock(entry.time)}</td><td>{'→' if entry.is_sent else '←'}</td>"
        f'<td>{html.escape(entry.name)}</td><td class="xbus-wrap">{html.escape(entry.text)}'
        f'<div class="xbus-quiet">{_hex(entry.frame)}</div></td></tr>'
        for entry in reversed(found)
    )
    head = "<tr><th>time</th><th></th><th>message</th><th>content, bytes</th></tr>"
    return f'<table class="xbus-table xbus-mono">{head}{rows}</table>'


def _hex(frame: bytes) -> str:
    more = f" … {len(frame):,} bytes" if len(frame) > SHOWN_BYTES else ""
    return frame[:SHOWN_BYTES].hex(" ").upper() + more


def _clock(seconds: float) -> str:
    return time.strftime("%H:%M:%S", time.localtime(seconds)) + f".{int(seconds % 1 * 1000):03}"


def _save(station: Station) -> None:
    lines = [
        f"{_clock(entry.time)} {'>' if entry.is_sent else '<'} {entry.frame.hex(' ').upper()}  "
        f"{entry.name}  {entry.text}".rstrip()
        for entry in list(station.exchange.entries)
    ]
    ui.download.content("\n".join(lines) + "\n", f"{station.key}-messages.txt")
