"""A recording of the library: what is known about it, and what can be done with it."""

from __future__ import annotations

import asyncio
import contextlib
import html
import os
from collections.abc import Awaitable, Callable, Sequence
from datetime import datetime
from urllib.parse import quote

from nicegui import ui

from xbus.describe.names import file_label
from xbus.formatting import describe_damage, describe_losses, format_size
from xbus.plots.panels import MAGNETIC
from xbus.studio.commands import CommandError, Facts, command_line, describe, run_command
from xbus.studio.dialogs import is_confirmed
from xbus.studio.library import Entry, FileCache, unused_path
from xbus.studio.pages.cut import choose_part
from xbus.studio.pages.field import show_field
from xbus.studio.recording import Note, read_notes
from xbus.studio.replaying import replay_source
from xbus.studio.shell import Session, failure_text
from xbus.studio.thumbnail import thumbnail

__all__ = ["RecordingCard"]

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
#: Notes that are shown of a recording.
MAX_NOTES = 20
#: Pictures of recordings, which are drawn one after the other: pages stay responsive. Those of compressed
#: recordings take longer, and others do not wait for them.
_thumbnails: FileCache[str] = FileCache()
_drawing = {False: asyncio.Semaphore(1), True: asyncio.Semaphore(1)}


class RecordingCard:
    """The card.

    Args:
        session: The page.
        entry: The recording.
        on_new: Called when there is another recording beside it.
    """

    def __init__(self, session: Session, entry: Entry, on_new: Callable[[], object]) -> None:
        self._session, self._entry, self._on_new = session, entry, on_new
        self._facts: Facts | None = None
        with ui.element("div").classes("xbus-card xbus-recording w-full"):
            self._picture = ui.html("", sanitize=False).classes("xbus-picture")
            with ui.column().classes("gap-0 grow min-w-0"):
                with ui.row().classes("items-baseline gap-x-3 gap-y-0 w-full"):
                    ui.label(entry.name_in(session.hub.folder)).classes("font-semibold break-all")
                    ui.label(file_facts(entry)).classes("xbus-quiet text-sm")
                    if self._is_being_recorded:
                        ui.label("is being recorded").classes("xbus-caution text-sm")
                self._summary = ui.html(
                    '<span class="xbus-quiet">reading</span>', sanitize=False
                ).classes("text-sm")
                self._notes = ui.html("", sanitize=False).classes("xbus-quiet text-sm")
                with ui.row().classes("gap-1 -ml-2") as self._actions:
                    self._button("Replay", "play_arrow", self._replay)
                    self._button("Report", "summarize", self._report)
                    with (
                        ui.button("Export", icon="download").props("flat dense no-caps"),
                        ui.menu(),
                    ):
                        for suffix, what in FORMATS.items():
                            ui.menu_item(
                                f"{suffix}  {what}",
                                on_click=lambda suffix=suffix: session.stay(self._export(suffix)),
                            )
                    self._button("Cut", "content_cut", self._cut).tooltip(
                        "writes a part of the recording to another file"
                    )
                    self._field = self._button("Magnetic field", "explore", self._magnetic)
                    self._field.tooltip("hard and soft iron, and whether the field is disturbed")
                    self._field.set_visibility(False)
        ui.timer(0, self._read, once=True)

    @property
    def _is_being_recorded(self) -> bool:
        recordings = [station.recording for station in self._session.hub.stations.values()]
        paths = [each.path.resolve() for each in recordings if each is not None]
        return self._entry.path.resolve() in paths

    def _button(self, text: str, icon: str, action: Callable[[], Awaitable[None]]) -> ui.button:
        button = ui.button(text, icon=icon, on_click=lambda: self._session.stay(action()))
        return button.props("flat dense no-caps")

    async def _read(self) -> None:
        entry = self._entry
        try:
            async with _drawing[entry.is_compressed]:
                if self._picture.is_deleted:
                    return  # the page is closed
                notes, picture = await asyncio.to_thread(_look_at, entry)
            if self._picture.is_deleted:
                return
            self._notes.set_content(notes_of(notes))
            self._picture.set_content(picture)
            self._facts = await describe(entry)
        except FileNotFoundError:
            self._show_problem(f"{entry.heading} is gone; read the folder again")
        except (CommandError, ImportError, OSError) as error:
            self._show_problem(file_label(failure_text(error)))
        else:
            if not self._summary.is_deleted:
                self._summary.set_content(summary_of(self._facts))
                is_magnetic = any(name in MAGNETIC for name in self._facts.quantities)
                self._field.set_visibility(is_magnetic)

    def _show_problem(self, text: str) -> None:
        if not self._summary.is_deleted:
            self._summary.set_content(f'<span class="xbus-fault">{html.escape(text)}</span>')
            self._actions.set_visibility(False)

    async def _replay(self) -> None:
        session, entry = self._session, self._entry
        session.show_command(command_line("studio", *entry.arguments), "xbus.sim.Replay(path)")
        station = await session.open(replay_source(entry.files))
        if station is not None:
            ui.navigate.to(f"/live/{station.key}")

    async def _report(self) -> None:
        out = self._entry.plain_path.with_suffix(".html")
        if await self._run("report", *self._entry.arguments, "-o", str(out), "-q"):
            name = os.path.relpath(out, self._session.hub.folder).replace(os.sep, "/")
            ui.navigate.to(f"/recordings/file/{quote(name)}", new_tab=True)

    async def _export(self, suffix: str) -> None:
        out = self._entry.plain_path.with_suffix(suffix)
        name = file_label(out.name)
        sentences = ("The folder has a file of this name already.",)
        if out.exists() and not await is_confirmed(f"Replace {name}?", sentences, "Replace"):
            return
        if await self._run("decode", *self._entry.arguments, "-o", str(out), "-q"):
            with ui.notification(f"wrote {name}", type="positive", timeout=15, close_button=True):
                ui.button("Download", on_click=lambda: ui.download.file(out)).props(
                    "flat no-caps color=white"
                )

    async def _cut(self) -> None:
        if self._facts is None or not self._facts.duration:
            ui.notify("It is not known how long the recording is.", type="warning")
            return
        out = unused_path(self._entry.plain_path, "-cut")
        words = await choose_part(self._entry, self._facts.duration, self._picture.content, out)
        if words is not None and await self._run(*words):
            ui.notify(f"wrote {file_label(out.name)}", type="positive")
            self._on_new()

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


def file_facts(entry: Entry) -> str:
    """Returns what is known about the files without reading them."""
    facts = [f"{len(entry.files)} files"] if len(entry.files) > 1 else []
    facts.append(format_size(entry.size) + (" compressed" if entry.is_compressed else ""))
    with contextlib.suppress(ValueError, OverflowError, OSError):  # no date has this time
        facts.append(f"{datetime.fromtimestamp(entry.modified):%Y-%m-%d %H:%M}")
    return ", ".join(facts)


def _look_at(entry: Entry) -> tuple[list[Note], str]:
    """Returns the notes and the picture of a recording.

    Raises:
        ImportError: The library for the compression is not installed.
        OSError: A file cannot be read.
    """
    key = FileCache.key(entry.files)
    if (picture := _thumbnails.get(key)) is None:
        picture = thumbnail(entry.files)
        _thumbnails.put(key, picture)
    return read_notes(entry.plain_path), picture


def notes_of(notes: Sequence[Note]) -> str:
    """Returns the first notes as HTML."""
    lines = [
        f"{datetime.fromtimestamp(note.time):%H:%M:%S} {note.text or 'marker'}"
        for note in notes[:MAX_NOTES]
    ]
    if len(notes) > MAX_NOTES:
        lines.append(f"and {len(notes) - MAX_NOTES:,} more")
    return "".join(f"<div>{html.escape(line)}</div>" for line in lines)


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
