"""RTK: corrections from an NTRIP caster to the receiver of a device."""

from __future__ import annotations

import html

from nicegui import ui

from xbus.rtk import Mountpoint, read_source_table
from xbus.studio.commands import command_line
from xbus.studio.shell import Session
from xbus.studio.station import Station

__all__ = ["rtk_page"]


def rtk_page(session: Session) -> None:
    """Forwards corrections to the selected device."""
    if (station := session.require_station()) is None:
        return
    support = station.device.support
    if support is not None and "ForwardGnssData" not in support.messages:
        ui.label(f"{station.title} takes no corrections: it has no RTK receiver.")
        return
    _Corrections(session, station)


class _Corrections:
    """The form, and the state of the corrections."""

    def __init__(self, session: Session, station: Station) -> None:
        self._session, self._station = session, station
        with ui.row().classes("w-full gap-3 items-start no-wrap max-lg:flex-wrap"):
            with (
                ui.element("div").classes("xbus-card grow min-w-0"),
                ui.column().classes("gap-2 w-full"),
            ):
                ui.label("Caster").classes("text-base font-semibold")
                with ui.row().classes("w-full items-end"):
                    self._caster = ui.input("address", placeholder="caster.example:2101").classes(
                        "w-72"
                    )
                    self._mountpoint = ui.input("mountpoint").classes("w-40")
                    ui.button("List mountpoints", on_click=self._list).props("flat no-caps")
                with ui.row().classes("w-full items-end"):
                    self._user = ui.input("user").classes("w-40")
                    self._password = ui.input("password", password=True).classes("w-40")
                    self._gga = ui.checkbox("send the position every 10 s", value=True).tooltip(
                        "network services compute corrections for the place of the receiver"
                    )
                self._button = ui.button("Start", icon="cell_tower", on_click=self._toggle).props(
                    "no-caps"
                )
                self._table = ui.column().classes("w-full max-h-96 overflow-auto")
            with ui.element("div").classes("xbus-card w-[420px] shrink-0 max-lg:w-full"):
                ui.label("State").classes("text-base font-semibold")
                self._state = ui.html("", sanitize=False)
        self._show()
        ui.timer(0.5, self._show)

    async def _list(self) -> None:
        url, user, password = self._caster.value.strip(), self._user.value, self._password.value
        if not url:
            ui.notify("name the caster first", type="warning")
            return
        self._session.show_command(
            command_line("ntrip", self._station.source, "--caster", url, "--list"), ""
        )

        def read() -> list[Mountpoint]:
            return read_source_table(url, user=user or None, password=password or None)

        found = await self._session.attempt(read)
        if found is None:
            return
        self._table.clear()
        with self._table:
            for point in found:
                with ui.row().classes("items-center w-full no-wrap"):
                    ui.button(
                        point.name,
                        on_click=lambda name=point.name: self._mountpoint.set_value(name),
                    ).props("flat dense no-caps")
                    facts = (point.place, point.format, point.systems, point.country)
                    ui.label(", ".join(fact for fact in facts if fact)).classes(
                        "text-sm xbus-quiet"
                    )

    async def _toggle(self) -> None:
        if self._station.corrections is not None:
            await self._session.attempt(self._station.stop_corrections)
            self._show()
            return
        url, mountpoint = self._caster.value.strip(), self._mountpoint.value.strip()
        if not url or not mountpoint:
            ui.notify("name the caster and a mountpoint of it", type="warning")
            return
        gga = 10 if self._gga.value else None
        # The password is not shown.
        self._session.show_command(
            command_line(
                "ntrip", self._station.source, "--caster", url, "--mountpoint", mountpoint
            ),
            "",
        )
        await self._session.attempt(
            self._station.start_corrections,
            url,
            mountpoint,
            self._user.value,
            self._password.value,
            gga,
        )
        self._show()

    def _show(self) -> None:
        corrections, fix = self._station.corrections, self._station.model.fix
        self._button.set_text("Start" if corrections is None else "Stop")
        rows = {"fix": fix.type or "unknown", "RTK": fix.rtk or "unknown"}
        if corrections is not None:
            age = corrections.age
            rows |= {
                "caster": f"{corrections.caster.host}: {corrections.caster.state}",
                "corrections": corrections.describe_counts(),
                "age": "none yet" if age is None else f"{age:.1f} s",
            }
        levels = {"RTK": {"fixed": "xbus-ok", "float": "xbus-caution"}.get(fix.rtk or "", "")}
        if corrections is not None and corrections.caster.problem:
            levels["corrections"] = "xbus-fault"
        self._state.set_content(
            '<table class="xbus-table" style="width:auto">'
            + "".join(
                f'<tr><th>{name}</th><td class="{levels.get(name, "")}" style="white-space:normal">'
                f"{html.escape(text)}</td></tr>"
                for name, text in rows.items()
            )
            + "</table>"
        )
