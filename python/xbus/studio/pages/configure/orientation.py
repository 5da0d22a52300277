"""The cards of heading and orientation: resets, gyro bias, compass calibration, initial heading."""

from __future__ import annotations

from functools import partial

from nicegui import ui

from xbus.device.commands import Commands
from xbus.protocol.tables import STATUS_FLAGS
from xbus.protocol.values import IccCommand, IccReply, IccStatus, ResetCode
from xbus.studio.commands import number_text
from xbus.studio.dialogs import is_confirmed
from xbus.studio.pages.configure.cards import Cards
from xbus.studio.pages.configure.document import Document
from xbus.studio.setting_fields import label

__all__ = ["Orientation", "calibration_text"]

#: What storing does besides.
PAUSE = "No samples for a moment: the device stores in Config State."
#: What to do during a representative motion.
RUNNING = "representative motion is running: turn the device, then Stop"
#: Problems of a compass calibration, and the remedies.
PROBLEMS = {
    IccStatus.DISTURBED: "too much disturbance: repeat it away from iron and magnets",
    IccStatus.NOT_ENOUGH_DATA: "not enough data: turn the device longer, and about more axes",
}


class Orientation(Cards):
    """The cards that the product has.

    Args:
        document: The settings.
    """

    def __init__(self, document: Document) -> None:
        super().__init__(document)
        messages = document.draft.support.messages
        if "ResetOrientation" in messages:
            self._resets()
        if "SetNoRotation" in messages:
            self._no_rotation()
        if "IccCommand" in messages:
            self._calibration()
        if "SetInitialHeading" in messages:
            self._initial_heading()

    def _resets(self) -> None:
        with self._card("Orientation reset", Commands.reset_orientation), ui.row().classes("gap-1"):
            for code in self._document.draft.support.orientation_resets:
                button = ui.button(
                    label(code.name).capitalize(), on_click=partial(self._reset, code)
                )
                button.props("no-caps flat dense")

    async def _reset(self, code: ResetCode) -> None:
        def store() -> None:
            with self._device.configure() as device:
                device.commands.reset_orientation(code)

        name, what = f"code={code.name}", label(code.name)
        if code != ResetCode.STORE:
            self._document.session.show_command(
                self._send("ResetOrientation", name),
                f"device.commands.reset_orientation(ResetCode.{code.name})",
            )
            if await self._run(self._device.commands.reset_orientation, code):
                text = f"{what} done; it is lost at the next restart unless it is stored"
                ui.notify(text, type="positive")
            return
        sentences = ("The device keeps the present reset, also after a restart.", PAUSE)
        if await is_confirmed(
            f"Store the orientation reset in {self._station.title}?", sentences, "Store"
        ):
            self._document.session.show_command(
                self._send("--config", "ResetOrientation", name),
                "with device.configure() as cfg: cfg.commands.reset_orientation(ResetCode.STORE)",
            )
            if await self._run(store):
                ui.notify("the orientation reset is stored", type="positive")

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

    # Heading

    def _calibration(self) -> None:
        commands = Commands.icc_command
        with self._card("In-run compass calibration (ICC): representative motion", commands):
            ui.label(
                "Start, turn the device as it will be used, if possible about all axes, and Stop. Store"
                " keeps a good result."
            ).classes("xbus-quiet text-sm")
            with ui.row().classes("items-center gap-1"):
                for command in (IccCommand.START, IccCommand.STOP, IccCommand.STATE):
                    ui.button(
                        label(command.name).capitalize(), on_click=partial(self._calibrate, command)
                    ).props(f'no-caps flat aria-label="{label(command.name)} of the calibration"')
                ui.button("Store", on_click=self._store_calibration).props(
                    'no-caps flat aria-label="store the calibration"'
                )
            self._result = ui.label().classes("text-sm")
            running = ui.label(RUNNING).classes("xbus-caution text-sm")

        def refresh() -> None:
            word = self._station.model.current("status_word")
            flag = STATUS_FLAGS["representative_motion"]
            running.set_visibility(word is not None and bool(flag.of(int(word.value))))

        refresh()
        ui.timer(0.5, refresh)

    async def _calibrate(self, command: IccCommand) -> None:
        self._document.session.show_command(
            self._send("IccCommand", f"command={command.name}"),
            f"device.commands.icc_command(IccCommand.{command.name})",
        )
        reply = await self._ask(self._device.commands.icc_command, command)
        if reply is not None:
            self._result.set_text(calibration_text(reply))

    async def _store_calibration(self) -> None:
        def store() -> None:
            with self._device.configure() as device:
                device.commands.icc_command(IccCommand.STORE)

        title = f"Store the compass calibration in {self._station.title}?"
        sentences = (
            "The device keeps the result of the last representative motion, also after a restart. It replaces"
            " the stored calibration.",
            PAUSE,
        )
        if await is_confirmed(title, sentences, "Store"):
            self._document.session.show_command(
                self._send("--config", "IccCommand", "command=STORE"),
                "with device.configure() as cfg: cfg.commands.icc_command(IccCommand.STORE)",
            )
            if await self._run(store):
                self._result.set_text("the calibration is stored")

    def _initial_heading(self) -> None:
        def send(degrees: float) -> None:
            with self._device.configure() as device:
                device.commands.set_initial_heading(degrees)

        async def set_heading() -> None:
            if heading.value is None:
                ui.notify("enter a heading from -180 to 180 degrees", type="negative")
                return
            degrees = float(heading.value)
            self._document.session.show_command(
                self._send("--config", "SetInitialHeading", number_text(degrees)),
                f"with device.configure() as cfg: cfg.commands.set_initial_heading({number_text(degrees)})",
            )
            if not await self._document.session.may_interrupt(self._station):
                return
            if await self._run(send, degrees):
                ui.notify(
                    f"the device took the initial heading {number_text(degrees)} deg; it cannot be read back",
                    type="positive",
                )

        with self._card("Initial heading", Commands.set_initial_heading):
            ui.label(
                "The heading with which the filter begins. Only profiles without a magnetic reference use it."
            ).classes("xbus-quiet text-sm")
            with ui.row().classes("items-center"):
                heading = ui.number("heading, deg", value=0, min=-180, max=180, step=1)
                heading.props("dense").classes("w-32")
                ui.button("Set", on_click=set_heading).props(
                    'no-caps flat aria-label="set the initial heading"'
                )


def calibration_text(reply: IccReply) -> str:
    """Returns in words what a device answered to a command of compass calibration.

    >>> from xbus.protocol import IccResult
    >>> calibration_text(IccReply(IccCommand.STOP, IccResult(4.007, 2, IccStatus(0))))
    'good: estimate in 2D, disturbance 4.0 times the noise'
    """
    if reply.result is None:
        is_running = reply.active if reply.active is not None else reply.command == IccCommand.START
        return RUNNING if is_running else "no representative motion is running"
    ratio, dimension, status = reply.result
    found = [text for flag, text in PROBLEMS.items() if flag in status]
    facts = f"estimate in {dimension}D, disturbance {ratio:.1f} times the noise"
    return f"{'; '.join(found) or 'good'}: {facts}"
