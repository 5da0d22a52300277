"""The card of changes: differences and problems, Apply, and settings files."""

from __future__ import annotations

import html
from collections.abc import Callable, Iterable
from typing import Any

from nicegui import events, ui

from xbus.device import Applied, Settings
from xbus.device.settings import Change, Plan
from xbus.studio.commands import command_line
from xbus.studio.dialogs import is_confirmed
from xbus.studio.pages.configure.document import Document
from xbus.studio.shell import GAP

__all__ = ["Changes", "difference_lines"]

#: Settings that take effect at the next reset only.
AT_RESET = "Ports and CAN change at the next reset: tab Device, Restart."
#: Largest settings file, in bytes.
MAX_FILE = 1 << 20


#: Names and content of settings files.
Files = list[tuple[str, Settings]]


class Changes:
    """The card.

    Args:
        document: The settings.
    """

    def __init__(self, document: Document) -> None:
        self._document = document
        with ui.element("div").classes(
            "xbus-card w-[420px] max-xl:w-[320px] max-lg:w-full shrink-0"
        ):
            ui.label("Changes").classes("text-base font-semibold")
            self._differences = ui.html("", sanitize=False).classes("w-full overflow-x-auto")
            with ui.row().classes("items-center gap-1 mt-2"):
                self._apply = ui.button("Apply", icon="done", on_click=self._apply_draft)
                self._apply.props("no-caps")
                ui.button("Revert", on_click=lambda: document.replace(document.draft.revert)).props(
                    "flat no-caps"
                )
                ui.button("Read again", on_click=document.read).props("flat no-caps").tooltip(
                    "reads all settings of the device; changes that are not applied stay"
                )
            document.show.append(self._show)
            with ui.row().classes("items-center gap-1"):
                ui.button("Save file", icon="save", on_click=self._save).props("flat no-caps")
                self._file_button("Load file", "folder_open", self._load, multiple=False).tooltip(
                    "takes over the settings of a file as changes; nothing is sent before Apply"
                )
                self._file_button("Compare", "difference", self._compare, multiple=True).tooltip(
                    "lists the differences between the device and a file, or between two files"
                )

    @staticmethod
    def _file_button(
        name: str, icon: str, action: Callable[[Files], Any], *, multiple: bool
    ) -> ui.button:
        async def take(event: events.MultiUploadEventArguments) -> None:
            upload.reset()  # otherwise the next file is refused as one too many
            if (files := await _read_files(event)) is not None:
                action(files)

        upload = ui.upload(
            on_multi_upload=take,
            auto_upload=True,
            multiple=multiple,
            max_file_size=MAX_FILE,
            on_rejected=lambda: ui.notify("a settings file has at most 1 MB", type="negative"),
        )
        upload.classes(f"hidden xbus-upload-{name.split()[0].lower()}").props("accept=.toml")
        return ui.button(name, icon=icon, on_click=lambda: upload.run_method("pickFiles")).props(
            "flat no-caps"
        )

    def _show(self) -> None:
        """Shows the differences and problems of the draft."""
        draft = self._document.draft
        differences = draft.differences
        self._apply.set_enabled(not draft.problems and bool(draft.names_that_differ))
        lines = [
            f'<div class="xbus-fault">{html.escape(line)}</div>' for line in _lines(draft.problems)
        ]
        lines += [
            f'<div class="xbus-caution">left out: {html.escape(line)}</div>'
            for line in draft.skipped
        ]
        if differences:
            lines.append(difference_lines(differences))
        elif not lines:
            lines.append('<span class="xbus-quiet">as the device has it</span>')
        self._differences.set_content("".join(lines))

    # The device

    async def _apply_draft(self) -> None:
        """Shows what the device would change, and changes it once that is confirmed."""
        document = self._document
        settings, before = document.draft.settings, document.draft.device
        planned = document.station.settings.plan(settings, before)
        title = f"Change {document.station.title}?"
        if not await is_confirmed(title, (), "Apply", draw=lambda: self._draw_plan(planned)):
            return
        document.session.show_command(
            command_line("config", "apply", document.station.source, "mti.toml"),
            'device.apply(xbus.Settings.from_toml(open("mti.toml").read()))',
        )
        applied = await document.session.attempt(document.station.settings.apply, settings, before)
        document.take_reading()
        if applied is not None:
            self._report(applied)

    def _draw_plan(self, planned: Plan) -> None:
        """Draws what a device would change, and what follows."""
        ui.html(difference_lines(change_lines(planned.changes)), sanitize=False)
        cautions = [f"left out: {text}" for text in planned.skipped]
        if Applied(planned.changes).needs_reset:
            cautions.append(AT_RESET)
        if self._document.station.is_recording:
            cautions.append(GAP)
        for caution in cautions:
            ui.label(caution).classes("xbus-caution")

    @staticmethod
    def _report(applied: Applied) -> None:
        rounded = "; ".join(map(str, applied.rounded))
        text = "applied and read back"
        if rounded:
            text += f"; the device took other values: {rounded}"
        if applied.needs_reset:
            text += f". {AT_RESET}"
        ui.notify(text, type="warning" if rounded else "positive", timeout=8000)

    # Files

    def _save(self) -> None:
        draft = self._document.draft
        if draft.problems:
            ui.notify("correct what is wrong before you save the settings", type="negative")
            return
        ui.download.content(draft.text, f"{draft.settings.product or 'mti'}.toml")

    def _load(self, files: Files) -> None:
        ((_, settings),) = files
        draft = self._document.draft
        self._document.replace(lambda: draft.load(settings))

    def _compare(self, files: Files) -> None:
        if len(files) > 2:
            ui.notify("choose one file, or two", type="negative")
            return
        station = self._document.station
        if len(files) == 1:
            ((name, wanted),) = files
            before_name = f"{station.title} as read"
            planned = station.settings.plan(wanted, self._document.draft.device)
            changes, notes = planned.changes, [*planned.problems, *planned.skipped]
            self._document.session.show_command(
                command_line("config", "diff", station.source, name),
                "device.settings().diff(settings)",
            )
        else:
            (before_name, before), (name, wanted) = files
            changes, notes = before.diff(wanted), _only_in_one(files)
        with ui.dialog() as dialog, ui.card().classes("min-w-[480px] max-w-none"):
            ui.label("Differences").classes("text-base font-semibold")
            ui.label(f"- {before_name}").classes("xbus-fault xbus-mono")
            ui.label(f"+ {name}").classes("xbus-ok xbus-mono")
            ui.html(
                difference_lines(change_lines(changes)) or "no differences", sanitize=False
            ).classes("overflow-x-auto w-full")
            for note in _lines(notes):
                ui.label(note).classes("xbus-caution text-sm")
            ui.button("Close", on_click=dialog.close).props("flat no-caps")
        dialog.open()


def change_lines(changes: Iterable[Change]) -> list[str]:
    """Returns changes as lines of a file that are removed and added."""
    return [line for change in changes for line in str(change).splitlines()]


def difference_lines(lines: Iterable[str]) -> str:
    """Returns lines that begin with ``-`` or ``+`` as HTML."""
    levels = {"-": "xbus-fault", "+": "xbus-ok"}
    return "".join(
        f'<div class="xbus-mono xbus-difference {levels.get(line[:1], "")}">{html.escape(line)}</div>'
        for line in lines
    )


def _lines(texts: Iterable[str]) -> list[str]:
    return [line for text in texts for line in text.splitlines()]


async def _read_files(event: events.MultiUploadEventArguments) -> Files | None:
    """Returns the names and settings of files; None if one is no settings file, which is shown."""
    found = []
    for file in event.files:
        try:
            data = await file.read()
            found.append((file.name, Settings.from_toml(data.decode())))
        except ValueError as error:
            reason = (
                f"byte {error.start} is not UTF-8; this is not TOML"
                if isinstance(error, UnicodeDecodeError)
                else str(error)
            )
            ui.notify(
                f"{file.name}: {reason}",
                type="negative",
                multi_line=True,
                timeout=10_000,
                close_button=True,
            )
            return None
    return found


def _only_in_one(files: Files) -> list[str]:
    """Returns sentences about the settings that only one of two files has."""
    (first, before), (second, after) = files
    notes = []
    for name, settings, other in ((first, before, after), (second, after, before)):
        only = [
            change.name
            for change in Settings().diff(settings)
            if getattr(other, change.name) is None
        ]
        if only:
            notes.append(f"only in {name}: {', '.join(only)}")
    return notes
