"""Configure: outputs and settings, the differences before anything is sent, and what the device took."""

from __future__ import annotations

import html
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from nicegui import events, ui

from xbus.device import Applied, Settings
from xbus.protocol.ids import Coordinates, Precision
from xbus.protocol.tables import QUANTITIES
from xbus.protocol.values import EVERY, OptionFlag
from xbus.studio.settings_draft import Draft
from xbus.studio.shell import Session
from xbus.studio.station import Station

__all__ = ["configure_page"]

#: Quantities of the presets; those that the product lacks are left out. None is its highest rate.
PRESETS: dict[str, dict[str, int | None]] = {
    "Orientation at 100 Hz": {
        "packet_counter": EVERY,
        "sample_time_fine": EVERY,
        "quaternion": 100,
        "acceleration": 100,
        "rate_of_turn": 100,
        "status_word": EVERY,
    },
    "Inertial data for processing": {
        "packet_counter": EVERY,
        "sample_time_fine": EVERY,
        "delta_v": None,
        "delta_q": None,
        "magnetic_field": None,
        "status_word": EVERY,
    },
    "Navigation": {
        "packet_counter": EVERY,
        "sample_time_fine": EVERY,
        "utc_time": EVERY,
        "quaternion": 100,
        "lat_lon": 100,
        "altitude_ellipsoid": 100,
        "velocity_xyz": 100,
        "gnss_pvt_data": EVERY,
        "status_word": EVERY,
    },
}


def configure_page(session: Session) -> None:
    """Edits the settings of the selected device."""
    if (station := session.require_station()) is None:
        return
    session.show_command(
        f"xbus config dump {station.source} -o mti.toml",
        "settings = device.settings(); device.apply(settings)",
    )
    body = ui.column().classes("w-full gap-3")

    async def load() -> None:
        settings = await session.attempt(station.device.settings)
        support = station.device.support
        body.clear()
        with body:
            if settings is None:
                ui.button("Try again", on_click=load).props("flat no-caps")
            elif support is None:
                ui.label(
                    "The tables do not have this product, so that its settings cannot be checked."
                )
            else:
                _Editor(session, station, Draft(settings, support), load)

    with body, ui.row().classes("items-center"):
        ui.spinner()
        ui.label("reading the settings")
    ui.timer(0, load, once=True)


class _Editor:
    """The controls; all of them show one draft."""

    def __init__(
        self, session: Session, station: Station, draft: Draft, reload: Callable[[], Any]
    ) -> None:
        self._session, self._station, self._draft, self._reload = session, station, draft, reload
        link = station.device.link
        self._baudrate = link.baudrate if link.is_line and not station.is_virtual else None
        with ui.row().classes("w-full gap-3 items-start no-wrap max-lg:flex-wrap"):
            with ui.column().classes("gap-3 grow min-w-0"):
                with ui.tabs().props("dense no-caps align=left") as tabs:
                    outputs, settings, text = (
                        ui.tab("Outputs"),
                        ui.tab("Settings"),
                        ui.tab("As text"),
                    )
                with ui.tab_panels(tabs, value=outputs).classes("w-full").props("keep-alive"):
                    with ui.tab_panel(outputs).classes("p-0"):
                        self._outputs()
                    with ui.tab_panel(settings).classes("p-0"):
                        self._settings()
                    with ui.tab_panel(text).classes("p-0"):
                        self._text()
            with ui.element("div").classes("xbus-card w-[420px] shrink-0 max-lg:w-full"):
                ui.label("Changes").classes("text-base font-semibold")
                self._differences = ui.html("", sanitize=False).classes("w-full overflow-x-auto")
                with ui.row().classes("items-center gap-1 mt-2"):
                    self._apply = ui.button("Apply", icon="done", on_click=self._apply_draft).props(
                        "no-caps"
                    )
                    ui.button("Revert", on_click=self._revert).props("flat no-caps")
                    ui.button("Read again", on_click=reload).props("flat no-caps").tooltip(
                        "reads all settings of the device; changes that are not applied are lost"
                    )
                upload = ui.upload(
                    on_upload=self._load_file, auto_upload=True, max_file_size=1 << 20
                )
                upload.classes("hidden").props("accept=.toml")
                with ui.row().classes("items-center gap-1"):
                    ui.button("Save file", icon="save", on_click=self._save).props("flat no-caps")
                    ui.button(
                        "Load file",
                        icon="folder_open",
                        on_click=lambda: upload.run_method("pickFiles"),
                    ).props("flat no-caps")
        self._show()

    # Controls

    @ui.refreshable_method
    def _outputs(self) -> None:
        support = self._draft.support
        with ui.element("div").classes("xbus-card w-full"):
            with ui.row().classes("items-center gap-2 w-full"):
                for name, outputs in PRESETS.items():
                    ui.button(name, on_click=lambda outputs=outputs: self._preset(outputs)).props(
                        "outline dense no-caps size=sm"
                    )
            self._budget = ui.html("", sanitize=False).classes("w-full mt-2")
            with ui.grid(columns="auto auto auto auto 1fr").classes(
                "items-center gap-x-4 gap-y-0 mt-2"
            ):
                for head in ("quantity", "rate", "precision", "coordinates", ""):
                    ui.label(head).classes("xbus-quiet text-xs")
                for name in QUANTITIES:
                    if rates := support.rates_of(name):
                        self._output(name, rates)

    def _output(self, name: str, rates: tuple[int, ...]) -> None:
        row, output = QUANTITIES[name], self._draft.output(name)
        frequency = None if output is None else output.frequency

        def change() -> None:
            wanted = rate.value if box.value else None
            self._change(
                lambda: self._draft.set_output(
                    name,
                    wanted,
                    None if precision is None else precision.value,
                    None if coordinates is None else coordinates.value,
                )
            )

        box = ui.checkbox(name, value=output is not None, on_change=change).props("dense")
        box.tooltip(f"{row.manual}, data identifier 0x{row.id:04X}")
        options = {each: "every message" if each == EVERY else f"{each} Hz" for each in rates}
        if frequency is not None and frequency not in options:
            options[frequency] = "highest" if frequency == EVERY else f"{frequency} Hz"
        rate = ui.select(options, value=frequency or rates[0], on_change=change).props(
            "dense borderless"
        )
        precision = coordinates = None
        if row.kind == "real":
            names = [each.name for each in Precision]
            present = (
                output.precision.name
                if output is not None and output.precision is not None
                else names[0]
            )
            precision = ui.select(names, value=present, on_change=change).props("dense borderless")
        else:
            ui.label()
        if row.coordinates:
            systems = [each.name for each in Coordinates]
            system = None if output is None else output.coordinates
            present = system.name if isinstance(system, Coordinates) else systems[0]
            coordinates = ui.select(systems, value=present, on_change=change).props(
                "dense borderless"
            )
        else:
            ui.label()
        ui.label(row.unit).classes("xbus-quiet text-xs")

    @ui.refreshable_method
    def _settings(self) -> None:
        draft, support, now = self._draft, self._draft.support, self._draft.settings
        with ui.element("div").classes("xbus-card w-full"), ui.column().classes("gap-2"):
            labels = [profile.label for profile in support.filter_profiles if profile.label]
            if now.filter_profile is not None and labels:
                ui.input(
                    "filter profile",
                    value=str(now.filter_profile),
                    on_change=lambda event: self._change(
                        lambda: draft.set(filter_profile=event.value)
                    ),
                ).props("dense debounce=600").classes("w-96").tooltip(
                    f"one of {', '.join(labels)}; section 5.3.7"
                )
            if now.option_flags is not None:
                ui.label("option flags (Table 8)").classes("xbus-quiet text-xs mt-2")
                for flag in OptionFlag:
                    if flag in support.option_flags:
                        ui.checkbox(
                            str(flag.name).replace("_", " ").lower(),
                            value=flag in now.option_flags,
                            on_change=lambda event, flag=flag: self._flag(flag, on=event.value),
                        ).props("dense")
            if now.location_id is not None:
                ui.number(
                    "location ID",
                    value=now.location_id,
                    min=0,
                    max=65535,
                    format="%d",
                    on_change=lambda event: self._change(
                        lambda: draft.set(location_id=int(event.value or 0))
                    ),
                ).props("dense debounce=600")
            if (arm := now.gnss_lever_arm) is not None:
                ui.label("lever arm from the device to the antenna, m").classes(
                    "xbus-quiet text-xs mt-2"
                )
                with ui.row():
                    for axis in arm._fields:
                        ui.number(
                            axis,
                            value=getattr(arm, axis),
                            step=0.01,
                            on_change=lambda event, axis=axis: self._lever_arm(axis, event.value),
                        ).props("dense debounce=600").classes("w-28")
            ui.label("All other settings are in the text.").classes("xbus-quiet text-sm mt-2")

    def _text(self) -> None:
        self._editor = ui.codemirror(
            self._draft.text, language="TOML", on_change=self._edit
        ).classes("w-full h-[560px]")
        self._editor.props("line-wrapping")

    # Changes

    def _change(self, action: Callable[[], Any]) -> None:
        """Changes the draft by a control."""
        try:
            action()
        except (ValueError, TypeError) as error:
            ui.notify(str(error), type="negative")
            return
        self._editor.set_value(self._draft.text)
        self._show()

    def _flag(self, flag: OptionFlag, *, on: bool) -> None:
        flags = self._draft.settings.option_flags or OptionFlag(0)
        self._change(lambda: self._draft.set(option_flags=flags | flag if on else flags & ~flag))

    def _lever_arm(self, axis: str, value: float | None) -> None:
        arm = self._draft.settings.gnss_lever_arm
        if arm is not None:
            self._change(
                lambda: self._draft.set(gnss_lever_arm=arm._replace(**{axis: value or 0.0}))
            )

    def _preset(self, outputs: dict[str, int | None]) -> None:
        support = self._draft.support
        offered = {name: support.rates_of(name) for name in outputs}
        rates = {
            name: max(each for each in offered[name] if rate is None or each <= rate)
            for name, rate in outputs.items()
            if offered[name]
        }
        self._change(lambda: self._draft.set(output_configuration=rates))
        self._outputs.refresh()

    def _edit(self, event: events.ValueChangeEventArguments[Any]) -> None:
        """Changes the draft by the text."""
        if event.value == self._draft.text:
            return
        self._draft.edit(event.value)
        if self._draft.problem is None:
            self._outputs.refresh()
            self._settings.refresh()
        self._show()

    def _revert(self) -> None:
        self._draft.revert()
        self._editor.set_value(self._draft.text)
        self._outputs.refresh()
        self._settings.refresh()
        self._show()

    # Device and files

    async def _apply_draft(self) -> None:
        """Shows what the device would change, and changes it once that is confirmed."""
        settings, device = self._draft.settings, self._station.device
        force = settings.product != self._draft.device.product
        checked = not self._station.is_virtual

        def plan() -> Applied:
            return device.apply(settings, dry_run=True, check_baudrate=checked, force=force)

        planned = await self._session.attempt(plan)
        if planned is None:
            return
        with ui.dialog() as dialog, ui.card().classes("min-w-[480px]"):
            ui.label(f"Change {self._station.title}?").classes("text-base font-semibold")
            ui.html(_changes(planned), sanitize=False)
            if planned.needs_reset:
                ui.label("Ports and CAN change at the next reset.").classes("xbus-caution")
            with ui.row():
                ui.button("Apply", on_click=lambda: dialog.submit(True)).props("no-caps").mark(
                    "confirm"
                )
                ui.button("Cancel", on_click=lambda: dialog.submit(False)).props("flat no-caps")
        if not await dialog:
            return

        def apply() -> Applied:
            return device.apply(settings, check_baudrate=checked, force=force)

        self._session.show_command(
            f"xbus config apply {self._station.source} mti.toml",
            'device.apply(xbus.Settings.from_toml(open("mti.toml").read()))',
        )
        applied = await self._session.attempt(apply)
        if applied is not None:
            rounded = (
                f"; the device took other values: {'; '.join(map(str, applied.rounded))}"
                if applied.rounded
                else ""
            )
            ui.notify(
                f"applied and read back{rounded}",
                type="warning" if rounded else "positive",
                timeout=8000,
            )
        await self._reload()

    def _save(self) -> None:
        if self._draft.problem is None:
            name = f"{(self._draft.settings.product or 'mti')}.toml"
            ui.download.content(self._draft.text, name)

    async def _load_file(self, event: events.UploadEventArguments) -> None:
        try:
            text = (await event.file.read()).decode()
            Settings.from_toml(text)
        except ValueError as error:
            ui.notify(
                str(error), type="negative", multi_line=True, timeout=10_000, close_button=True
            )
            return
        # Settings that the file leaves out stay as they are.
        given = Settings.from_toml(text)
        values = {
            name: value
            for name, value in vars(given).items()
            if value is not None and name != "lines"
        }
        self._draft.edit(replace(self._draft.device, **values).to_toml())
        self._editor.set_value(self._draft.text)
        self._outputs.refresh()
        self._settings.refresh()
        self._show()

    # Display

    def _show(self) -> None:
        """Shows the differences, and how much of the line the outputs need."""
        draft = self._draft
        differ = draft.names_that_differ
        self._apply.set_enabled(draft.problem is None and bool(differ))
        if draft.problem is not None:
            lines = "".join(
                f"<div>{html.escape(line)}</div>" for line in draft.problem.splitlines()
            )
            self._differences.set_content(f'<div class="xbus-fault">{lines}</div>')
        elif not differ:
            self._differences.set_content('<span class="xbus-quiet">as the device has it</span>')
        else:
            self._differences.set_content(
                "".join(
                    f'<div class="xbus-mono {"xbus-fault" if line[0] == "-" else "xbus-ok"}">'
                    f"{html.escape(line)}</div>"
                    for line in draft.differences
                )
            )
        self._budget.set_content(self._line_load())

    def _line_load(self) -> str:
        needed, capacity = self._draft.load(self._baudrate)
        if capacity is None:
            return f'<span class="xbus-quiet">about {needed:,} bytes per second</span>'
        share = needed / capacity
        level = "xbus-fault" if share > 1 else "xbus-caution" if share > 0.8 else "xbus-ok"
        reason = self._draft.overload(self._baudrate) if self._baudrate and share > 1 else None
        text = (
            reason or f"about {needed:,} bytes per second: {share:.0%} of {self._baudrate:,} baud"
        )
        width = min(100.0, 100 * share)
        return (
            '<div class="xbus-bar xbus-track">'
            f'<div class="{level} xbus-bar" style="width:{width:.0f}%">'
            f'</div></div><span class="{level} text-sm">{html.escape(text)}</span>'
        )


def _changes(applied: Applied) -> str:
    lines = [line for change in applied.changes for line in str(change).splitlines()]
    if not lines:
        return "nothing would change"
    return "".join(
        f'<div class="xbus-mono {"xbus-fault" if line[:1] == "-" else "xbus-ok"}">{html.escape(line)}</div>'
        for line in [*lines, *applied.skipped]
    )
