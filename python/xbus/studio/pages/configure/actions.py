"""The tab of the device: baud rate, restart, factory settings, orientation resets and UTC."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from datetime import UTC, datetime
from functools import partial
from typing import Any

from nicegui import ui

from xbus.device.commands import Commands
from xbus.protocol.products import DEFAULT_BAUDRATE
from xbus.protocol.tables import STATUS_FLAGS
from xbus.protocol.values import ResetCode, UtcTime
from xbus.studio.commands import command_line
from xbus.studio.dialogs import is_confirmed
from xbus.studio.pages.configure.document import Document
from xbus.studio.setting_fields import label

__all__ = ["DeviceActions"]

#: What happens at each restart.
RESTARTS = "The device restarts: no samples for about a second, also in a recording."
#: What a restart loses.
LOSES = "Orientation resets that are not stored are lost."


class DeviceActions:
    """The tab.

    Args:
        document: The settings.
    """

    def __init__(self, document: Document) -> None:
        self._document, self._station = document, document.station
        self._device = document.station.device
        messages = document.draft.support.messages
        with ui.column().classes("w-full gap-3"):
            if self._device.link.is_line and self._device.link.baudrate is not None:
                self._baudrate()
            self._restarts()
            if "ResetOrientation" in messages:
                self._orientation()
            if "SetNoRotation" in messages:
                self._no_rotation()
            if "SetUTCTime" in messages:
                self._utc()

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

    async def _run(self, action: Callable[..., Any], *args: Any) -> bool:
        """Runs an action, shows its failure, and what the device has afterwards."""

        def run() -> bool:
            action(*args)
            return True

        is_done = await self._document.session.attempt(run)
        self._document.take_reading()
        self._show_rate()
        return bool(is_done)

    def _send(self, *words: str) -> str:
        """Returns the command that sends a message."""
        return command_line("send", self._station.source, *words)

    # Restarts

    def _baudrate(self) -> None:
        support = self._document.draft.support
        with self._card("Baud rate", Commands.req_baudrate), ui.row().classes("items-center"):
            self._rate = ui.label().classes("xbus-rate")
            options = {rate: f"{rate:,} baud" for rate in support.baudrates}
            present = self._device.link.baudrate
            choice = ui.select(options, value=present if present in options else DEFAULT_BAUDRATE)
            choice.props('dense options-dense aria-label="new baud rate"')
            ui.button("Change", on_click=lambda: self._set_baudrate(choice.value)).props(
                "no-caps flat"
            )
        self._show_rate()

    def _show_rate(self) -> None:
        rate = self._device.link.baudrate
        if rate is not None and hasattr(self, "_rate"):
            self._rate.set_text(f"The port is open at {rate:,} baud.")

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
            ui.button("Factory settings", icon="factory", on_click=self._restore).props(
                "no-caps flat color=negative"
            )

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

    # Orientation

    def _orientation(self) -> None:
        with self._card("Orientation reset", Commands.reset_orientation), ui.row().classes("gap-1"):
            for code in self._document.draft.support.orientation_resets:
                button = ui.button(
                    label(code.name).capitalize(), on_click=partial(self._reset, code)
                )
                button.props("no-caps flat dense")

    async def _reset(self, code: ResetCode) -> None:
        def reset() -> None:
            if code == ResetCode.STORE:
                with self._device.configure():
                    self._device.commands.reset_orientation(code)
            else:
                self._device.commands.reset_orientation(code)

        self._document.session.show_command(
            self._send("ResetOrientation", f"code={code.name}"),
            f"device.commands.reset_orientation(ResetCode.{code.name})",
        )
        if await self._run(reset):
            kept = (
                ""
                if code == ResetCode.STORE
                else "; it is lost at the next restart unless it is stored"
            )
            ui.notify(f"{label(code.name)} done{kept}", type="positive")

    def _no_rotation(self) -> None:
        with (
            self._card("No-rotation update", Commands.set_no_rotation),
            ui.row().classes("items-center"),
        ):
            seconds = ui.number("duration, s", value=10, min=1, max=65_535, step=1).props("dense")
            ui.button("Start", on_click=lambda: start()).props("no-caps flat")
            state = ui.label().classes("text-sm")
        until: float | None = None

        async def start() -> None:
            nonlocal until
            duration = int(seconds.value or 0)
            self._document.session.show_command(
                self._send("SetNoRotation", str(duration)),
                f"device.commands.set_no_rotation({duration})",
            )
            if await self._run(self._device.commands.set_no_rotation, duration):
                until = self._station.model.now + duration

        def refresh() -> None:
            left = 0.0 if until is None else until - self._station.model.now
            flag = STATUS_FLAGS["no_rotation_update_status"]
            word = self._station.model.current("status_word")
            if left > 0:
                state.set_text(f"do not move the device for {left:.0f} s")
            elif word is None:
                state.set_text("the result is in the status word, which is not among the outputs")
            else:
                value = flag.of(int(word.value))
                state.set_text(f"status word: {flag.values.get(value, value)}")

        ui.timer(0.5, refresh)

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
