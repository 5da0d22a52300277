"""Messages: compose any message by name, and see what goes out and comes in."""

from __future__ import annotations

import html
import time
from typing import Any

from nicegui import ui

from xbus.protocol.messages import LAYOUTS
from xbus.protocol.tables import MESSAGES, PREAMBLE
from xbus.studio.commands import command_line
from xbus.studio.exchange import Entry
from xbus.studio.shell import Session
from xbus.studio.station import Station
from xbus.wire.codec import encode_frame

__all__ = ["messages_page"]

#: Messages that are shown.
SHOWN = 200


def messages_page(session: Session) -> None:
    """Shows the messages of the selected device."""
    if (station := session.require_station()) is None:
        return
    session.show_command(f"xbus send {station.source} ReqDID", 'device.command("ReqDID")')
    _compose(session, station)
    with ui.element("div").classes("xbus-card w-full mt-3"):
        with ui.row().classes("items-center w-full"):
            search = ui.input("filter by name").props("dense clearable")
            ui.space()
            ui.button("Save", icon="save", on_click=lambda: _save(station)).props(
                "flat dense no-caps"
            )
            ui.button("Clear", on_click=lambda: station.exchange.entries.clear()).props(
                "flat dense no-caps"
            )
        table = ui.html("", sanitize=False).classes("w-full overflow-x-auto")
        shown: list[Any] = []

        def refresh() -> None:
            state = [station.exchange.count, len(station.exchange.entries), search.value]
            if state != shown:
                shown[:] = state
                table.set_content(_table(list(station.exchange.entries), search.value or ""))

        refresh()
        ui.timer(0.3, refresh)


def _compose(session: Session, station: Station) -> None:
    names = [row.name for row in MESSAGES.values() if row.direction != "to host"]
    with ui.element("div").classes("xbus-card w-full"):
        with ui.row().classes("items-center w-full no-wrap"):
            message = (
                ui.select(names, value="ReqDID", label="message", with_input=True)
                .classes("w-80")
                .props("dense")
            )
            content = ui.input("fields", placeholder="field=value; one entry of a list per word")
            content.classes("grow").props("dense")
            in_config = ui.checkbox("in Config State", value=True).tooltip(
                "enters Config State for the message, and restores the state"
            )
            send = ui.button("Send", icon="send").props("no-caps").mark("send")
        hint = ui.label().classes("xbus-quiet text-sm")
        with ui.row().classes("items-center w-full no-wrap"):
            raw = ui.input(
                "or in hex", placeholder="FA FF 30 00 D1, or MID and payload: 30"
            ).classes("grow")
            raw.props("dense")
            send_raw = ui.button("Send hex").props("flat no-caps")

    def describe() -> None:
        row = MESSAGES[message.value]
        states = " or ".join(f"{state.capitalize()} State" for state in row.states)
        hint.set_text(f"MID 0x{row.mid:02X}, valid in {states}")

    async def run() -> None:
        name, words = message.value, content.value.split()
        config = ["--config"] if in_config.value else []
        session.show_command(
            command_line("send", station.source, *config, name, *words),
            f'device.command("{name}", ...)',
        )

        def command() -> None:
            value = LAYOUTS[name].read(words)
            if in_config.value:
                with station.device.configure() as device:
                    device.command(name, value)
            else:
                station.device.command(name, value)

        await session.attempt(command)

    async def run_raw() -> None:
        def command() -> None:
            data = bytes.fromhex(raw.value.lower().replace("0x", "").replace(",", " "))
            if not data:
                raise ValueError("write bytes in hex, such as FA FF 30 00 D1")
            station.device.send(data if data[0] == PREAMBLE else encode_frame(data[0], data[1:]))

        session.show_command(
            command_line("send", station.source, "--hex", raw.value), "device.send(data)"
        )
        await session.attempt(command)

    message.on_value_change(describe)
    send.on_click(run)
    content.on("keydown.enter", run)
    send_raw.on_click(run_raw)
    describe()


def _table(entries: list[Entry], search: str) -> str:
    found = [entry for entry in entries if search.lower() in entry.name.lower()][-SHOWN:]
    if not found:
        return '<span class="xbus-quiet">no messages; samples are not shown here</span>'
    rows = "".join(
        f'<tr class="{"xbus-fault" if entry.name in ("Error", "damage") else ""}">'
        f"<td>{_clock(entry.time)}</td><td>{'→' if entry.is_sent else '←'}</td>"
        f"<td>{html.escape(entry.name)}</td><td>{html.escape(entry.text)}</td>"
        f'<td class="xbus-quiet">{_hex(entry.frame)}</td></tr>'
        for entry in reversed(found)
    )
    head = "<tr><th>time</th><th></th><th>message</th><th>content</th><th>bytes</th></tr>"
    return f'<table class="xbus-table xbus-mono">{head}{rows}</table>'


def _hex(frame: bytes) -> str:
    return frame[:64].hex(" ").upper() + (" …" if len(frame) > 64 else "")


def _clock(seconds: float) -> str:
    return time.strftime("%H:%M:%S", time.localtime(seconds)) + f".{int(seconds % 1 * 1000):03}"


def _save(station: Station) -> None:
    lines = [
        f"{_clock(entry.time)} {'>' if entry.is_sent else '<'} {entry.frame.hex(' ').upper()}  "
        f"{entry.name}  {entry.text}".rstrip()
        for entry in list(station.exchange.entries)
    ]
    ui.download.content("\n".join(lines) + "\n", f"{station.key}-messages.txt")
