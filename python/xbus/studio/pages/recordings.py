"""Recordings: a folder as a library, with replay, report, export, cut, magnetic field and notes."""

from __future__ import annotations

import asyncio
from itertools import islice

from nicegui import ui

from xbus.studio.commands import command_line
from xbus.studio.library import Library, find_recordings
from xbus.studio.pages.recording_card import RecordingCard
from xbus.studio.shell import Session, failure_text

__all__ = ["recordings_page"]

#: Recordings that are shown at first, and with each *Show more*.
SHOWN = 30


def recordings_page(session: Session) -> None:
    """Lists the recordings of the folder."""
    folder = session.hub.folder
    session.show_command(command_line("info", str(folder)), 'log = xbus.read_log("walk.mtb")')
    with ui.row().classes("items-center w-full"):
        ui.label(f"Recordings in {folder.resolve()}").classes("text-lg break-all")
        ui.space()
        ui.button(icon="refresh", on_click=lambda: _list.refresh()).props(
            "flat dense round aria-label='read the folder again'"
        ).tooltip("read the folder again")
    _list(session, {"name": ""})


@ui.refreshable
def _list(session: Session, wanted: dict[str, str]) -> None:
    """Draws the recordings; ``wanted`` has the filter, which stays when they are read again."""
    folder = session.hub.folder
    with ui.column().classes("w-full gap-2") as column:
        ui.label(f"reading {folder}").classes("xbus-quiet")

    async def fill() -> None:
        problem, found = "", Library([], 0, True)
        try:
            found = await asyncio.to_thread(find_recordings, folder)
        except OSError as error:
            problem = failure_text(error)
        if column.is_deleted:
            return  # the page is closed
        column.clear()
        with column:
            if problem:
                ui.label(problem).classes("xbus-fault")
            elif not found.entries:
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
            _Shelf(session, found, wanted)

    ui.timer(0, fill, once=True)


class _Shelf:
    """The recordings, some at a time, and a filter of their names."""

    def __init__(self, session: Session, found: Library, wanted: dict[str, str]) -> None:
        self._session, self._entries, self._wanted = session, found.entries, wanted
        self._search = ui.input("filter: name", value=wanted["name"], on_change=self._draw)
        self._search.props("dense clearable debounce=300").classes("w-80")
        self._search.set_visibility(len(self._entries) > 1)
        self._cards = ui.column().classes("w-full gap-2")
        self._button = ui.button(on_click=self._show_more).props("outline no-caps")
        self._draw()

    def _draw(self) -> None:
        """Shows the first recordings with the name."""
        self._wanted["name"] = wanted = (self._search.value or "").lower()
        folder = self._session.hub.folder
        found = [entry for entry in self._entries if wanted in entry.name_in(folder).lower()]
        self._left, self._count = iter(found), len(found)
        self._cards.clear()
        self._show_more()

    def _show_more(self) -> None:
        with self._cards:
            for entry in islice(self._left, SHOWN):
                RecordingCard(self._session, entry, _list.refresh)
                self._count -= 1
        self._button.set_text(f"Show more: {self._count:,} are not shown")
        self._button.set_visibility(self._count > 0)
