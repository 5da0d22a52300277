"""Record: one button for all devices, with rotation, time limit, disk space, notes and markers."""

from __future__ import annotations

import html
import shutil
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

from nicegui import ui

from xbus.device.rotation import parse_rotation
from xbus.formatting import format_count, format_size
from xbus.studio.commands import record_commands
from xbus.studio.entered import problem_of
from xbus.studio.recording import StudioRecording
from xbus.studio.shell import Session
from xbus.studio.station import Station

__all__ = ["record_page"]


def record_page(session: Session) -> None:
    """Records the open devices."""
    hub, form = session.hub, session.hub.record_form
    titled = {source: each for source, each in hub.titled().items() if each[0].replaying is None}
    if not titled:
        session.require_device(
            "This recording is a file already; Cut on the page Recordings writes a part of it."
        )
        return
    stations = [station for station, _ in titled.values()]
    with ui.element("div").classes("xbus-card w-full"):
        with ui.row().classes("items-center gap-4 w-full"):
            button = (
                ui.button("Record", icon="fiber_manual_record")
                .props("no-caps size=lg")
                .mark("record")
            )
            chosen = {
                source: ui.checkbox(title, value=form.chosen.get(source, True)).mark(
                    f"use-{station.key}"
                )
                for source, (station, title) in titled.items()
            }
        note = ui.input("note", value=form.note, placeholder="what is recorded")
        note.classes("w-full").props("dense")
        with ui.row().classes("items-start gap-4 w-full mt-2"):
            limit = ui.number("stop after, s", value=form.duration, min=0, step=1)
            limit.classes("w-40").props("dense clearable")
            limit.tooltip("the recording stops by itself; empty: when you stop it")
            rotate = ui.input(
                "new file after",
                value=form.rotation,
                placeholder="100MB, 2GB, 30min, 1h",
                validation=_rotation_problem,
            )
            rotate.classes("w-64").props("dense clearable hide-bottom-space").tooltip(
                "a size or a time, after which the recording continues in the next file; empty: one file"
            )
        ui.label(f"Files go to {hub.folder.resolve()}").classes("xbus-quiet text-sm mt-2")
        space = ui.label().classes("text-sm")
    with ui.element("div").classes("xbus-card w-full mt-3"):
        table = ui.html("", sanitize=False).classes("w-full overflow-x-auto")
        with ui.row().classes("items-center w-full no-wrap mt-2"):
            text = ui.input("note during the recording").classes("grow").props("dense")
            mark = ui.button("Add note", icon="add_comment").props("flat no-caps").mark("add-note")
            mark.tooltip("an empty note is a marker")

    def is_chosen(station: Station) -> bool:
        return bool(chosen[station.source].value)

    def active() -> list[Station]:
        return [each for each in hub.stations.values() if each.recording is not None]

    def options() -> dict[str, Any]:
        """Returns duration and rotation, as entered."""
        rotation = (rotate.value or "").strip()
        limits = {} if not limit.value else {"duration": float(limit.value)}
        return limits | (parse_rotation(rotation) if rotation else {})

    def show_command() -> None:
        ports = [each.source for each in stations if is_chosen(each)]
        rotation = (rotate.value or "").strip()
        if not ports or (rotation and _rotation_problem(rotation)):
            session.show_command("", "")
        else:
            duration = float(limit.value) if limit.value else None
            session.show_command(*record_commands(ports, hub.folder, duration, rotation))

    async def start() -> None:
        def record(station: Station) -> StudioRecording:
            return station.start_recording(hub.folder, note.value.strip(), **options())

        for station in stations:
            if is_chosen(station):
                await session.attempt(record, station)

    async def stop() -> None:
        for station in active():
            done = await session.attempt(station.stop_recording)
            if done is not None and done.problem:
                ui.notify(done.problem, type="negative", multi_line=True, timeout=10_000)

    async def toggle() -> None:
        await (stop() if active() else start())
        refresh()

    async def add_note() -> None:
        # One note has one time in the files of all devices.
        words, now = text.value.strip(), time.time()
        recordings = [each.recording for each in active() if each.recording is not None]
        saved = [await session.attempt(each.add_note, words, now) for each in recordings]
        if None not in saved:
            text.set_value("")

    def refresh() -> None:
        is_recording = bool(active())
        button.set_text("Stop" if is_recording else "Record")
        button.props(f"icon={'stop' if is_recording else 'fiber_manual_record'}")
        button.props(f"color={'negative' if is_recording else 'primary'}")
        mark.set_enabled(is_recording)
        used = active() or [each for each in stations if is_chosen(each)]
        space.set_text(_space(hub.folder, sum(each.byte_rate.value or 0.0 for each in used)))
        table.set_content(_table(list(hub.stations.values())))

    button.on_click(toggle)
    mark.on_click(add_note)
    text.on("keydown.enter", add_note)
    note.bind_value_to(form, "note")
    limit.bind_value_to(form, "duration")
    rotate.bind_value_to(form, "rotation")
    limit.on_value_change(show_command)
    rotate.on_value_change(show_command)
    for source, box in chosen.items():
        box.bind_value_to(form.chosen, source)
        box.on_value_change(show_command)
    show_command()
    refresh()
    ui.timer(0.5, refresh)


#: Returns what is wrong with a rotation, or None.
_rotation_problem = partial(problem_of, parse_rotation)


def _space(folder: Path, rate: float) -> str:
    """Returns the free space of a disk, and how long it lasts at a rate in bytes per second."""
    try:
        place = next(
            each for each in (folder.resolve(), *folder.resolve().parents) if each.exists()
        )
        free = shutil.disk_usage(place).free
    except OSError as error:
        return f"{folder}: {error.strerror}"
    text = f"{format_size(free)} free"
    return (
        f"{text}, enough for {_duration(free / rate)} at {format_size(int(rate))}/s"
        if rate
        else text
    )


def _table(stations: Sequence[Station]) -> str:
    """Returns the recordings in progress and the last ones as HTML."""
    names = ("device", "file", "time", "size", "samples", "notes", "")
    head = "<tr>" + "".join(f"<th>{name}</th>" for name in names) + "</tr>"
    rows = ""
    for station in stations:
        for recording, state in (
            (station.recording, "recording"),
            (station.last_recording, "done"),
        ):
            if recording is not None:
                rows += _row(station, recording, state)
    if not any(station.recording for station in stations):
        rows += (
            f'<tr><td class="xbus-quiet" colspan="{len(names)}">nothing is being recorded</td></tr>'
        )
    return f'<table class="xbus-table">{head}{rows}</table>'


def _row(station: Station, recording: StudioRecording, state: str) -> str:
    file = recording.path.name
    if recording.files > 1:
        file += f" and {format_count(recording.files - 1, 'more file')}"
    cells = [
        station.title,
        file,
        f"{recording.seconds:.0f} s",
        format_size(recording.bytes),
        f"{recording.samples:,}",
        format_count(len(recording.notes), "note"),
    ]
    problem = recording.problem
    level = "xbus-fault" if problem else "xbus-ok" if state == "done" else ""
    last = f'<td class="{level} xbus-wrap">{html.escape(problem or state)}</td>'
    return "<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in cells) + last + "</tr>"


def _duration(seconds: float) -> str:
    hours = seconds / 3600
    if hours > 72:
        return f"{hours / 24:,.0f} days"
    return f"{hours:,.1f} h" if hours >= 1 else f"{seconds / 60:,.0f} min"
