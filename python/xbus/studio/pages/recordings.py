"""Recordings: a folder as a library, with replay, export, report and notes."""

from __future__ import annotations

import asyncio
import contextlib
import html
import itertools
import os
from datetime import datetime
from pathlib import Path
from typing import Any

from nicegui import ui

from xbus.formatting import describe_damage, describe_losses, format_size
from xbus.studio.commands import CommandError, command_line, describe, run_command
from xbus.studio.recording import read_notes
from xbus.studio.shell import Session
from xbus.studio.station import REPLAY

__all__ = ["recordings_page"]

#: Formats to export to: suffix, and what reads it.
FORMATS = {
    ".parquet": "Parquet: pandas, polars, DuckDB",
    ".csv": "CSV: spreadsheets",
    ".mat": "MATLAB",
    ".h5": "HDF5",
    ".xlsx": "Excel",
    ".mcap": "MCAP: ROS 2, Foxglove",
    ".gpx": "GPX: maps",
    ".kml": "KML: Google Earth",
    ".geojson": "GeoJSON: maps",
    ".txt": "text of MT Manager",
    ".sto": "OpenSim",
    ".nmea": "NMEA sentences",
    ".rrd": "rerun",
}
#: Recordings that are listed, the latest first.
MAX_FILES = 200
#: Commands that describe recordings at the same time.
JOBS = 2


def recordings_page(session: Session) -> None:
    """Lists the recordings of the folder."""
    folder = session.hub.folder
    session.show_command(command_line("info", f"{folder}/*.mtb"), 'log = xbus.read_log("walk.mtb")')
    with ui.row().classes("items-center w-full"):
        ui.label(f"Recordings in {folder.resolve()}").classes("text-lg")
        ui.space()
        ui.button(icon="refresh", on_click=lambda: _list.refresh()).props(
            "flat dense round aria-label='read the folder again'"
        )
    _list(session)


@ui.refreshable
def _list(session: Session) -> None:
    files = _files(session.hub.folder)
    if not files:
        ui.label("There is no recording yet.").classes("xbus-quiet")
    if len(files) > MAX_FILES:
        ui.label(f"The latest {MAX_FILES} of {len(files):,} recordings.").classes(
            "xbus-quiet text-sm"
        )
    gate = asyncio.Semaphore(JOBS)
    for path, state in itertools.islice(files, MAX_FILES):
        _recording(session, path, state, gate)


def _files(folder: Path) -> list[tuple[Path, os.stat_result]]:
    """Returns the recordings of a folder, the latest first; a file that disappears meanwhile is left out."""
    found = []
    for path in folder.glob("*.mtb"):
        with contextlib.suppress(OSError):
            found.append((path, path.stat()))
    return sorted(found, key=lambda each: each[1].st_mtime, reverse=True)


def _recording(
    session: Session, path: Path, state: os.stat_result, gate: asyncio.Semaphore
) -> None:
    with ui.element("div").classes("xbus-card w-full mb-2"):
        with ui.row().classes("items-center w-full"):
            ui.label(path.name).classes("font-semibold")
            when = datetime.fromtimestamp(state.st_mtime)
            ui.label(f"{format_size(state.st_size)}, {when:%Y-%m-%d %H:%M}").classes(
                "xbus-quiet text-sm"
            )
            ui.space()
            ui.button("Replay", icon="play_arrow", on_click=lambda: _replay(session, path)).props(
                "flat dense no-caps"
            )
            ui.button("Report", icon="summarize", on_click=lambda: _report(session, path)).props(
                "flat dense no-caps"
            )
            with ui.button("Export", icon="download").props("flat dense no-caps"), ui.menu():
                for suffix, what in FORMATS.items():
                    ui.menu_item(
                        f"{suffix}  {what}",
                        on_click=lambda suffix=suffix: _export(session, path, suffix),
                    )
        summary = ui.html('<span class="xbus-quiet">reading</span>', sanitize=False).classes(
            "text-sm"
        )
        if notes := read_notes(path):
            lines = "".join(
                f"<div>{datetime.fromtimestamp(note.time):%H:%M:%S} "
                f"{html.escape(note.text or 'marker')}</div>"
                for note in notes
            )
            ui.html(lines, sanitize=False).classes("xbus-quiet text-sm")

    async def read() -> None:
        async with gate:
            try:
                summary.set_content(_summary(await describe(path)))
            except (CommandError, OSError) as error:
                summary.set_content(f'<span class="xbus-fault">{html.escape(str(error))}</span>')

    ui.timer(0, read, once=True)


def _summary(info: dict[str, Any]) -> str:
    """Returns the facts about a recording, as ``xbus info --json`` gives them."""
    devices, lost, skipped = info["devices"], info["lost_samples"], info["skipped_bytes"]
    names = ", ".join(
        (device["product_code"] or f"BID {device['bid']}").strip() for device in devices
    )
    has_counter = any(row["name"] == "packet_counter" for row in info["quantities"])
    losses = describe_losses(lost, len(info["gaps"]), has_counter=has_counter)
    facts = [
        (names or "no device", ""),
        (f"{info['duration_s'] or 0:,.1f} s", ""),
        (f"{info['samples']:,} samples", ""),
        (losses, "xbus-fault" if lost else "xbus-ok" if has_counter else "xbus-quiet"),
        (describe_damage(skipped, len(info["damage"])), "xbus-fault" if skipped else "xbus-ok"),
    ]
    return " · ".join(f'<span class="{level}">{html.escape(text)}</span>' for text, level in facts)


async def _replay(session: Session, path: Path) -> None:
    source = f"{REPLAY}{path}"
    session.show_command(command_line("sim", "--replay", str(path)), "xbus.sim.Replay(path)")
    station = await session.attempt(session.hub.open, source)
    if station is not None:
        await session.attempt(station.measure)
        session.key = station.key
        ui.navigate.to(f"/live/{station.key}")


async def _report(session: Session, path: Path) -> None:
    out = path.with_suffix(".html")
    if await _run(session, "report", str(path), "-o", str(out), "-q"):
        ui.navigate.to(f"/recordings/file/{out.name}", new_tab=True)


async def _export(session: Session, path: Path, suffix: str) -> None:
    out = path.with_suffix(suffix)
    if await _run(session, "decode", str(path), "-o", str(out), "-q"):
        with ui.notification(f"wrote {out.name}", type="positive", timeout=15, close_button=True):
            ui.button("Download", on_click=lambda: ui.download.file(out)).props(
                "flat no-caps color=white"
            )


async def _run(session: Session, *words: str) -> bool:
    """Runs a command, and shows it and its failure; returns whether it succeeded."""
    session.show_command(
        command_line(*words), "log.to_parquet(path)" if words[0] == "decode" else ""
    )
    waiting = ui.notification(command_line(*words[:2]), spinner=True, timeout=None)
    try:
        await run_command(*words)
    except CommandError as error:
        ui.notify(str(error), type="negative", multi_line=True, timeout=15_000, close_button=True)
        return False
    finally:
        waiting.dismiss()
    return True
