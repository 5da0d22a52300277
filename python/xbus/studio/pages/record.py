"""Record: one button for all devices, with disk space, notes and markers."""

from __future__ import annotations

import html

from nicegui import ui

from xbus.formatting import format_count, format_size
from xbus.studio.shell import Session
from xbus.studio.station import Station

__all__ = ["record_page"]


def record_page(session: Session) -> None:
    """Records the open devices."""
    hub = session.hub
    if not hub.stations:
        session.require_station()
        return
    stations = list(hub.stations.values())
    session.show_command(
        f"xbus record {stations[0].source} {hub.folder}/walk.mtb",
        'with device.record("walk.mtb"): ...',
    )
    with ui.element("div").classes("xbus-card w-full"):
        with ui.row().classes("items-center gap-4 w-full"):
            button = (
                ui.button("Record", icon="fiber_manual_record")
                .props("no-caps size=lg")
                .mark("record")
            )
            chosen = {
                each.source: ui.checkbox(each.title, value=True).mark(f"use-{each.key}")
                for each in stations
            }
        note = ui.input("note", placeholder="what is recorded").classes("w-full").props("dense")
        ui.label(f"Files go to {hub.folder.resolve()}").classes("xbus-quiet text-sm")
    with ui.element("div").classes("xbus-card w-full mt-3"):
        table = ui.html("", sanitize=False).classes("w-full overflow-x-auto")
        with ui.row().classes("items-center w-full no-wrap mt-2"):
            text = ui.input("note during the recording").classes("grow").props("dense")
            mark = ui.button("Add note", icon="add_comment").props("flat no-caps").mark("add-note")
            mark.tooltip("an empty note is a marker")

    def active() -> list[Station]:
        return [each for each in hub.stations.values() if each.recording is not None]

    async def toggle() -> None:
        if recording := active():
            for station in recording:
                done = await session.attempt(station.stop_recording)
                if done is not None and done.problem:
                    ui.notify(done.problem, type="negative", timeout=10_000)
        else:
            for station in stations:
                if chosen[station.source].value:
                    await session.attempt(station.start_recording, hub.folder, note.value.strip())
        refresh()

    async def add_note() -> None:
        for station in active():
            if station.recording is not None:
                await session.attempt(station.recording.add_note, text.value.strip())
        text.set_value("")

    def refresh() -> None:
        is_recording = bool(active())
        button.set_text("Stop" if is_recording else "Record")
        button.props(f"icon={'stop' if is_recording else 'fiber_manual_record'}")
        button.props(f"color={'negative' if is_recording else 'primary'}")
        mark.set_enabled(is_recording)
        table.set_content(_table(active()))

    button.on_click(toggle)
    mark.on_click(add_note)
    text.on("keydown.enter", add_note)
    refresh()
    ui.timer(0.5, refresh)


def _table(stations: list[Station]) -> str:
    if not stations:
        return '<span class="xbus-quiet">nothing is being recorded</span>'
    names = ("device", "file", "time", "size", "samples", "disk is full in", "notes")
    head = "<tr>" + "".join(f"<th>{name}</th>" for name in names) + "</tr>"
    rows = ""
    for station in stations:
        recording = station.recording
        if recording is None:
            continue
        left = recording.seconds_left
        cells = [
            station.title,
            recording.path.name,
            f"{recording.seconds:.0f} s",
            format_size(recording.bytes),
            f"{recording.samples:,}",
            "not known yet" if left is None else _duration(left),
            format_count(len(recording.notes), "note"),
        ]
        error = (
            f'<td class="xbus-fault">ended early: {html.escape(recording.error)}</td>'
            if recording.error
            else ""
        )
        rows += (
            "<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in cells) + error + "</tr>"
        )
    return f'<table class="xbus-table">{head}{rows}</table>'


def _duration(seconds: float) -> str:
    hours = seconds / 3600
    return f"{hours / 24:,.0f} days" if hours > 72 else f"{hours:,.1f} h"
