"""What the cards of the tab Device share: running a command, its failure, and the settings afterwards."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any, TypeVar

from nicegui import ui

from xbus.studio.commands import command_line
from xbus.studio.pages.configure.document import Document

__all__ = ["Cards"]

T = TypeVar("T")


class Cards:
    """Cards with commands of a device.

    Args:
        document: The settings.
    """

    def __init__(self, document: Document) -> None:
        self._document, self._station = document, document.station
        self._device = document.station.device

    @staticmethod
    def _card(title: str, *commands: Callable[..., Any]) -> ui.element:
        """Returns a card whose tooltip is the documentation of commands."""
        card = ui.element("div").classes("xbus-card w-full")
        with card, ui.row().classes("items-center gap-2"):
            ui.label(title).classes("text-sm font-semibold")
            ui.icon("info").classes("xbus-quiet").tooltip(
                " ".join(
                    " ".join((inspect.getdoc(each) or "").replace("`", "").split())
                    for each in commands
                )
            )
        return card

    async def _ask(self, action: Callable[..., T], *args: Any) -> T | None:
        """Returns what an action returns, and shows what the device has afterwards; None if it failed."""
        answer = await self._document.session.attempt(action, *args)
        self._document.take_reading()
        return answer

    async def _run(self, action: Callable[..., Any], *args: Any) -> bool:
        """Runs an action, and returns whether it succeeded; a failure is shown."""

        def run() -> bool:
            action(*args)
            return True

        return bool(await self._ask(run))

    def _send(self, *words: str) -> str:
        """Returns the command that sends a message."""
        return command_line("send", self._station.source, *words)
