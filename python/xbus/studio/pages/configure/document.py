"""The settings that the parts of the page show and change."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from xbus.protocol.products import Support
from xbus.studio.device_settings import Reading
from xbus.studio.settings_draft import Draft
from xbus.studio.shell import Session
from xbus.studio.station import Station

__all__ = ["Document"]


class Document:
    """One draft, and the parts of a page that show it.

    Args:
        session: The page.
        station: The device.
        reading: Its settings.
        support: What its product supports.

    Attributes:
        draft: The settings that the page shows.
        reading: What the device reported last.
        show: Called after every change, to show differences and problems.
        draw: Called after a change of the whole draft, to draw controls again.
    """

    def __init__(
        self, session: Session, station: Station, reading: Reading, support: Support
    ) -> None:
        self.session, self.station, self.reading = session, station, reading
        self.draft = Draft(reading.settings, support, station.settings.plan)
        self.show: list[Callable[[], Any]] = []
        self.draw: list[Callable[[], Any]] = []
        self._is_stale = False

    def change(self, action: Callable[[], Any]) -> None:
        """Changes the draft by a control, which shows the value already."""
        action()
        for show in self.show:
            show()

    def replace(self, action: Callable[[], Any]) -> None:
        """Changes the draft as a whole."""
        action()
        self._is_stale = False
        for part in (*self.draw, *self.show):
            part()

    def edit(self, text: str) -> None:
        """Changes the draft by its text. Controls are drawn again when another tab is chosen."""
        self.change(lambda: self.draft.edit(text))
        self._is_stale = True

    def draw_if_stale(self) -> None:
        """Draws the controls again if the text was edited."""
        if self._is_stale:
            self.replace(lambda: None)

    async def read(self) -> None:
        """Reads the settings again; changes that are not applied stay."""
        if await self.session.may_interrupt(self.station):
            await self.session.attempt(self.station.settings.read)
            self.take_reading()

    def take_reading(self) -> None:
        """Shows what the device has, if this page or another one has read it."""
        reading = self.station.settings.reading
        if reading is None or reading is self.reading:
            return
        is_other = reading.settings != self.reading.settings
        self.reading = reading
        if is_other:
            self.replace(lambda: self.draft.rebase(reading.settings))

    @property
    def warning(self) -> str:
        """Why the page may not show what the device has; an empty text if it does."""
        clock = time.strftime("%H:%M:%S", time.localtime(self.reading.time))
        if self.station.model.is_lost:
            return f"The port is gone; check the cable. These are the settings of {clock}."
        if self.station.settings.is_outdated:
            return (
                f"A message may have changed the settings, which were read at {clock}. Read again shows what"
                " the device has."
            )
        return ""
