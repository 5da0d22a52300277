"""The tab of the device: baud rate, restart, factory settings, orientation and UTC."""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime

from nicegui import ui

from xbus.device.commands import Commands
from xbus.protocol.products import DEFAULT_BAUDRATE
from xbus.protocol.values import UtcTime
from xbus.studio.commands import command_line
from xbus.studio.dialogs import is_confirmed
from xbus.studio.pages.configure.cards import Cards
from xbus.studio.pages.configure.document import Document
from xbus.studio.pages.configure.orientation import Orientation

__all__ = ["DeviceActions"]

#: What happens at each restart.
RESTARTS = "The device restarts: no samples for about a second, also in a recording."
#: What a restart loses.
LOSES = "Orientation resets that are not stored are lost."


class DeviceActions(Cards):
    """The tab.

    Args:
        document: The settings.
    """

    def __init__(self, document: Document) -> None:
        super().__init__(document)
        with ui.column().classes("w-full gap-3"):
            if self._device.link.is_line and self._device.link.baudrate is not None:
                self._baudrate()
            self._restarts()
            Orientation(document)
            if "SetUTCTime" in document.draft.support.messages:
                self._utc()

    # Restarts

    def _baudrate(self) -> None:
        support = self._document.draft.support
        with self._card("Baud rate", Commands.req_baudrate), ui.row().classes("items-center"):
            shown = ui.label()
            options = {rate: f"{rate:,} baud" for rate in support.baudrates}
            present = self._device.link.baudrate
            choice = ui.select(options, value=present if present in options else DEFAULT_BAUDRATE)
            choice.props('dense options-dense aria-label="new baud rate"')
            ui.button("Change", on_click=lambda: self._set_baudrate(choice.value)).props(
                "no-caps flat"
            )

        def refresh() -> None:
            shown.set_text(f"The port is open at {self._device.link.baudrate or 0:,} baud.")

        refresh()
        ui.timer(0.5, refresh)

    async def _set_baudrate(self, rate: int) -> None:
        present = self._device.link.baudrate
        sentences = (
            f"The device keeps {rate:,} baud; until now it is {present:,}.",
            f"{RESTARTS} The port is opened again at {rate:,} baud.",
            "Other programs, and what else is connected to the device, must use the new rate.",
            LOSES,
        )
        if await is_confirmed(
            f"Change the baud rate of {self._station.title}?", sentences, "Change"
        ):
            self._document.session.show_command(
                command_line("baudrate", self._station.source, str(rate)),
                f"device.set_baudrate({rate})",
            )
            if await self._run(self._station.settings.set_baudrate, rate):
                ui.notify(f"the device answers at {rate:,} baud", type="positive")

    def _restarts(self) -> None:
        with (
            self._card("Restart", type(self._device).reset, Commands.restore_factory_def),
            ui.row(),
        ):
            ui.button("Restart", icon="restart_alt", on_click=self._restart).props("no-caps flat")
            ui.button("Factory settings", icon="factory", on_click=self._restore, color=None).props(
                "no-caps flat"
            ).classes("xbus-fault")

    async def _restart(self) -> None:
        sentences = (f"{RESTARTS} {LOSES}", "Changed ports and CAN take effect.")
        if await is_confirmed(f"Restart {self._station.title}?", sentences, "Restart"):
            self._document.session.show_command(
                command_line("reset", self._station.source), "device.reset()"
            )
            if await self._run(self._station.settings.restart):
                ui.notify("the device has restarted", type="positive")

    async def _restore(self) -> None:
        is_serial = self._device.link.baudrate is not None
        sentences = (
            "All settings are lost: outputs, filter profile, alignment, ports and all others. Save file keeps"
            " them.",
            f"{RESTARTS} {LOSES}"
            + (f" The port is opened again at {DEFAULT_BAUDRATE:,} baud." if is_serial else ""),
        )
        title = f"Restore the factory settings of {self._station.title}?"
        if await is_confirmed(title, sentences, "Restore"):
            self._document.session.show_command(
                self._send("--config", "RestoreFactoryDef"),
                "with device.configure() as cfg: cfg.restore_factory_settings()",
            )
            if await self._run(self._station.settings.restore_factory_settings):
                ui.notify("the device has its factory settings", type="positive")

    # Time

    def _utc(self) -> None:
        with self._card("UTC", Commands.set_utc_time), ui.row().classes("items-center"):
            ui.button("Read", on_click=lambda: read()).props("no-caps flat")
            ui.button("Set to the time of this computer", on_click=lambda: adjust()).props(
                "no-caps flat"
            )
            shown = ui.label().classes("text-sm")

        def request() -> UtcTime:
            with self._device.configure() as device:
                return device.commands.req_utc_time()

        def send() -> UtcTime:
            with self._device.configure() as device:
                now = datetime.now(UTC)
                device.commands.set_utc_time(UtcTime(now.microsecond * 1000, *now.timetuple()[:6]))
                return device.commands.req_utc_time()

        async def show(action: Callable[[], UtcTime]) -> None:
            if not await self._document.session.may_interrupt(self._station):
                return
            if (time := await self._document.session.attempt(action)) is not None:
                date = f"{time.year}-{time.month:02}-{time.day:02}"
                clock = f"{time.hour:02}:{time.minute:02}:{time.second:02}"
                shown.set_text(f"the device has {date} {clock} UTC")

        async def read() -> None:
            self._document.session.show_command(
                self._send("--config", "ReqUTCTime"),
                "cfg.commands.req_utc_time()",
            )
            await show(request)

        async def adjust() -> None:
            self._document.session.show_command(
                self._send("--config", "SetUTCTime") + " ...",
                "cfg.commands.set_utc_time(time)",
            )
            await show(send)
