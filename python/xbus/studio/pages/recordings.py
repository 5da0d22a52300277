"""Recordings: a folder as a library, with replay, report, export, cut, magnetic field and notes."""

from __future__ import annotations

import asyncio
import html
import os
from collections.abc import Awaitable, Callable
from datetime import datetime
from pathlib import Path
from urllib.parse import quote

from nicegui import ui

from xbus.formatting import describe_damage, describe_losses, format_size
from xbus.plots.panels import MAGNETIC
from xbus.studio.commands import CommandError, Facts, command_line, describe, run_command
from xbus.studio.library import Entry, FileCache, find_recordings, unused_path
from xbus.studio.pages.cut import choose_part
from xbus.studio.pages.field import show_field
from xbus.studio.recording import read_notes
from xbus.studio.replaying import replay_source
from xbus.studio.shell import Session
from xbus.studio.thumbnail import thumbnail

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
#: Pictures of recordings.
_thumbnails: FileCache[str] = FileCache()


def recordings_page(session: Session) -> None:
    """Lists the recordings of the folder."""
    folder = session.hub.folder
    session.show_command(command_line("info", str(folder)), 'log = xbus.read_log("walk.mtb")')
    with ui.row().classes("items-center w-full"):
        ui.label(f"Recordings in {folder.resolve()}").classes("text-lg")
        ui.space()
        ui.button(icon="refresh", on_click=lambda: _list.refresh()).props(
            "flat dense round aria-label='read the folder again'"
        )
    _list(session)


@ui.refreshable
def _list(session: Session) -> None:
    folder = session.hub.folder
    with ui.column().classes("w-full gap-2") as column:
        ui.label(f"reading {folder}").classes("xbus-quiet")

    async def fill() -> None:
        found = await asyncio.to_thread(find_recordings, folder)
        if column.is_deleted:
            return  # the page is closed
        column.clear()
        with column:
            if not found.entries:
                ui.label("There is no recording yet.").classes("xbus-quiet")
            if not found.is_complete:
                ui.label(
                    "The folder has too many files to look at all of them; start xbus studio with a smaller "
                    "one: --folder DIR"
                ).classes("xbus-caution text-sm")
            if found.total > len(found.entries):
                ui.label(f"The latest {len(found.entries)} of {found.total:,} recordings.").classes(
                    "xbus-quiet text-sm"
                )
            for entry in found.entries:
                _Card(session, entry)

    ui.timer(0, fill, once=True)


class _Card:
    """A recording of the list."""

    def __init__(self, session: Session, entry: Entry) -> None:
        self._session, self._entry = session, entry
        self._facts: Facts | None = None
        with ui.element("div").classes("xbus-card xbus-recording w-full"):
            self._picture = ui.html("", sanitize=False).classes("xbus-picture")
            with ui.column().classes("gap-0 grow min-w-0"):
                with ui.row().classes("items-baseline gap-x-3 gap-y-0 w-full"):
                    ui.label(_name(session.hub.folder, entry)).classes("font-semibold break-all")
                    when = datetime.fromtimestamp(entry.modified)
                    pieces = f"{len(entry.files)} files, " if len(entry.files) > 1 else ""
                    ui.label(f"{pieces}{format_size(entry.size)}, {when:%Y-%m-%d %H:%M}").classes(
                        "xbus-quiet text-sm"
                    )
                self._summary = ui.html(
                    '<span class="xbus-quiet">reading</span>', sanitize=False
                ).classes("text-sm")
                if notes := read_notes(entry.path):
                    lines = "".join(
                        f"<div>{datetime.fromtimestamp(note.time):%H:%M:%S} "
                        f"{html.escape(note.text or 'marker')}</div>"
                        for note in notes
                    )
                    ui.html(lines, sanitize=False).classes("xbus-quiet text-sm")
                with ui.row().classes("gap-1 -ml-2"):
                    self._button("Replay", "play_arrow", self._replay)
                    self._button("Report", "summarize", self._report)
                    with (
                        ui.button("Export", icon="download").props("flat dense no-caps"),
                        ui.menu(),
                    ):
                        for suffix, what in FORMATS.items():
                            ui.menu_item(
                                f"{suffix}  {what}",
                                on_click=lambda suffix=suffix: self._export(suffix),
                            )
                    self._button("Cut", "content_cut", self._cut).tooltip(
                        "writes a part of the recording to another file"
                    )
                    self._field = self._button("Magnetic field", "explore", self._magnetic)
                    self._field.tooltip("hard and soft iron, and whether the field is disturbed")
                    self._field.set_visibility(False)
        ui.timer(0, self._read, once=True)

    @staticmethod
    def _button(text: str, icon: str, action: Callable[[], Awaitable[None]]) -> ui.button:
        return ui.button(text, icon=icon, on_click=action).props("flat dense no-caps")

    async def _read(self) -> None:
        entry = self._entry
        try:
            key = FileCache.key(entry.files)
            if (picture := _thumbnails.get(key)) is None:
                picture = await asyncio.to_thread(thumbnail, entry.files)
                _thumbnails.put(key, picture)
            if self._picture.is_deleted:
                return
            self._picture.set_content(picture)
            self._facts = await describe(entry)
        except (CommandError, OSError) as error:
            if self._summary.is_deleted:
                return
            self._summary.set_content(f'<span class="xbus-fault">{html.escape(str(error))}</span>')
            return
        if self._summary.is_deleted:
            return
        self._summary.set_content(summary_of(self._facts))
        self._field.set_visibility(any(name in MAGNETIC for name in self._facts.quantities))

    async def _replay(self) -> None:
        session, entry = self._session, self._entry
        session.show_command(command_line("studio", *entry.arguments[:1]), "xbus.sim.Replay(path)")
        station = await session.open(replay_source(entry.files))
        if station is not None:
            ui.navigate.to(f"/live/{station.key}")

    async def _report(self) -> None:
        out = self._entry.path.with_suffix(".html")
        if await self._run("report", *self._entry.arguments, "-o", str(out), "-q"):
            name = os.path.relpath(out, self._session.hub.folder).replace(os.sep, "/")
            ui.navigate.to(f"/recordings/file/{quote(name)}", new_tab=True)

    async def _export(self, suffix: str) -> None:
        out = self._entry.path.with_suffix(suffix)
        if await self._run("decode", *self._entry.arguments, "-o", str(out), "-q"):
            with ui.notification(
                f"wrote {out.name}", type="positive", timeout=15, close_button=True
            ):
                ui.button("Download", on_click=lambda: ui.download.file(out)).props(
                    "flat no-caps color=white"
                )

    async def _cut(self) -> None:
        if self._facts is None or not self._facts.duration:
            ui.notify("It is not known how long the recording is.", type="warning")
            return
        out = unused_path(self._entry.path, "-cut")
        words = await choose_part(self._entry, self._facts.duration, self._picture.content, out)
        if words is not None and await self._run(*words):
            ui.notify(f"wrote {out.name}", type="positive")
            _list.refresh()

    async def _magnetic(self) -> None:
        await show_field(self._session, self._entry)

    async def _run(self, *words: str) -> bool:
        """Runs a command, and shows it and its failure; returns whether it succeeded."""
        self._session.show_command(
            command_line(*words), "log.to_parquet(path)" if words[0] == "decode" else ""
        )
        waiting = ui.notification(command_line(*words[:2]), spinner=True, timeout=None)
        try:
            await run_command(*words)
        except CommandError as error:
            ui.notify(
                str(error), type="negative", multi_line=True, timeout=15_000, close_button=True
            )
            return False
        finally:
            waiting.dismiss()
        return True


def _name(folder: Path, entry: Entry) -> str:
    """Returns the name of a recording, with the folder below the library."""
    below = os.path.relpath(entry.path.parent, folder)
    return entry.heading if below == "." else f"{below}{os.sep}{entry.heading}"


def summary_of(facts: Facts) -> str:
    """Returns the facts about a recording as HTML."""
    losses = describe_losses(facts.lost_samples, facts.gaps, has_counter=facts.has_counter)
    is_lossless = "xbus-ok" if facts.has_counter else "xbus-quiet"
    texts = [
        (", ".join(facts.devices) or "no device", ""),
        ("duration not known" if facts.duration is None else f"{facts.duration:,.1f} s", ""),
        (f"{facts.samples:,} samples", ""),
        (losses, "xbus-fault" if facts.lost_samples else is_lossless),
        (
            describe_damage(facts.skipped_bytes, facts.places),
            "xbus-fault" if facts.skipped_bytes else "xbus-ok",
        ),
    ]
    return " · ".join(f'<span class="{level}">{html.escape(text)}</span>' for text, level in texts)
