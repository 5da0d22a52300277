"""Configure: outputs and settings, the differences before anything is sent, and what the device took."""

from __future__ import annotations

from nicegui import ui

from xbus.studio.commands import command_line
from xbus.studio.pages.configure.document import Document
from xbus.studio.pages.configure.editor import draw_editor
from xbus.studio.shell import GAP, Session

__all__ = ["configure_page"]


def configure_page(session: Session) -> None:
    """Edits the settings of the selected device."""
    station = session.require_device(
        "A recording does not have all settings of its device, and none can be changed; choose a device."
    )
    if station is None:
        return
    session.show_command(
        command_line("config", "dump", station.source, "-o", "mti.toml"),
        "settings = device.settings(); device.apply(settings)",
    )
    body = ui.column().classes("w-full gap-3")

    async def load() -> None:
        reading = await session.attempt(station.settings.read)
        support = station.device.support
        body.clear()
        with body:
            if reading is None:
                ui.label("The settings of the device cannot be read.").classes("xbus-fault")
                ui.button("Try again", on_click=load).props("no-caps")
            elif support is None:
                ui.label(
                    "The tables do not have this product, so that its settings cannot be checked."
                )
            else:
                draw_editor(Document(session, station, reading, support))

    async def begin() -> None:
        body.clear()
        with body, ui.row().classes("items-center"):
            ui.spinner()
            ui.label("reading the settings")
        await load()

    if not station.is_recording:
        ui.timer(0, begin, once=True)
        return
    with body, ui.element("div").classes("xbus-card w-full"):
        ui.label(f"Reading the settings interrupts the recording. {GAP}").classes("xbus-caution")
        ui.button("Read the settings", on_click=begin).props("no-caps").classes("mt-2")
