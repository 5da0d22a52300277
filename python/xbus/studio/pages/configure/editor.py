"""The parts of the page: a tab for each group of settings, the text, and the changes."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from nicegui import events, ui

from xbus.studio.pages.configure.actions import DeviceActions
from xbus.studio.pages.configure.changes import Changes
from xbus.studio.pages.configure.document import Document
from xbus.studio.pages.configure.forms import SettingForm
from xbus.studio.pages.configure.outputs import Outputs
from xbus.studio.setting_fields import TABS

__all__ = ["draw_editor"]


def draw_editor(document: Document) -> None:
    """Draws all parts, and keeps them up to date."""
    banner = ui.label().classes("xbus-card xbus-caution w-full").mark("warning")

    def refresh() -> None:
        document.take_reading()
        banner.set_text(document.warning)
        banner.set_visibility(bool(document.warning))

    with ui.row().classes("w-full gap-3 items-start no-wrap max-lg:flex-wrap"):
        with ui.column().classes("gap-3 grow min-w-0"):
            _draw_tabs(document)
        Changes(document)
    document.change(lambda: None)
    refresh()
    ui.timer(0.5, refresh)


def _draw_tabs(document: Document) -> None:
    settings, support = document.draft.settings, document.draft.support
    contents: dict[str, Callable[[], Any]] = {}
    if settings.output_configuration is not None and support.rates:
        contents["Outputs"] = partial(Outputs, document)
    for title, names in TABS.items():
        if present := [name for name in names if getattr(settings, name) is not None]:
            contents[title] = partial(_draw_forms, document, present)
    contents["Device"] = partial(DeviceActions, document)
    contents["As text"] = partial(_draw_text, document)
    with ui.tabs().props("dense no-caps align=left outside-arrows mobile-arrows") as tabs:
        tabs.classes("w-full")
        drawn = {title: ui.tab(title) for title in contents}
    tabs.on_value_change(document.draw_if_stale)
    with ui.tab_panels(tabs, value=next(iter(contents))).classes("w-full").props("keep-alive"):
        for title, draw in contents.items():
            with ui.tab_panel(drawn[title]).classes("p-0"):
                draw()


def _draw_forms(document: Document, names: list[str]) -> None:
    with ui.column().classes("w-full gap-3"):
        for name in names:
            SettingForm(document, name)


def _draw_text(document: Document) -> None:
    draft = document.draft

    def edit(event: events.ValueChangeEventArguments[Any]) -> None:
        if event.value != draft.text:
            document.edit(event.value)

    text = ui.codemirror(draft.text, language="TOML", on_change=edit).props("line-wrapping")
    text.classes("w-full h-[560px]")
    document.show.append(lambda: text.set_value(draft.text))
