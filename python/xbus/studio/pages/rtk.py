"""RTK: corrections from an NTRIP caster to the receiver of a device."""

from __future__ import annotations

import html

from nicegui import ui

from xbus.rtk import Mountpoint, read_source_table
from xbus.rtk.address import parse_address
from xbus.studio.commands import command_line
from xbus.studio.entered import problem_of
from xbus.studio.pages.mountpoints import Mountpoints
from xbus.studio.shell import Session
from xbus.studio.station import Station

__all__ = ["rtk_page"]

#: Seconds between two positions that the caster gets.
GGA = 10


def rtk_page(session: Session) -> None:
    """Forwards corrections to the selected device."""
    station = session.require_device("A recording takes no corrections; choose a device.")
    if station is None:
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
        self._form = form = station.caster
        with ui.row().classes("w-full gap-3 items-start no-wrap max-lg:flex-wrap"):
            with (
                ui.element("div").classes("xbus-card grow min-w-0"),
                ui.column().classes("gap-2 w-full"),
            ):
                ui.label("Caster").classes("text-base font-semibold")
                with ui.row().classes("w-full items-end"):
                    self._caster = ui.input(
                        "address", value=form.address, placeholder="caster.example:2101"
                    ).classes("w-72")
                    self._mountpoint = ui.input("mountpoint", value=form.mountpoint).classes("w-40")
                    ui.button("List mountpoints", on_click=self._list).props("flat no-caps")
                with ui.row().classes("w-full items-end"):
                    self._user = ui.input("user", value=form.user).classes("w-40")
                    self._password = ui.input("password", password=True).classes("w-40")
                    self._gga = ui.checkbox(
                        f"send the position every {GGA} s", value=form.sends_position
                    ).tooltip("network services compute corrections for the place of the receiver")
                self._button = ui.button("Start", icon="cell_tower", on_click=self._toggle).props(
                    "no-caps"
                )
                self._points = Mountpoints(self._mountpoint.set_value)
            with ui.element("div").classes("xbus-card w-[420px] shrink-0 max-lg:w-full"):
                ui.label("State").classes("text-base font-semibold")
                self._state = ui.html("", sanitize=False)
        self._keep_entered()
        self._show()
        ui.timer(0.5, self._show)

    def _keep_entered(self) -> None:
        """Keeps what is entered for the next page."""
        form = self._form
        self._mountpoint.bind_value_to(form, "mountpoint")
        self._gga.bind_value_to(form, "sends_position")
        # A password stays in the server, and is for the caster and the user for which it was entered.
        self._caster.on_value_change(self._forget_password)
        self._user.on_value_change(self._forget_password)
        self._caster.bind_value_to(form, "address")
        self._user.bind_value_to(form, "user")
        self._password.on_value_change(self._keep_password)
        self._hint()

    def _keep_password(self) -> None:
        self._form.password = self._password.value or ""
        self._hint()

    def _forget_password(self) -> None:
        if not self._password.value:
            self._keep_password()

    def _entered(self) -> tuple[str, str, str]:
        """Returns address, user and password; the password may be that of an earlier page."""
        form, address, user = self._form, self._caster.value, self._user.value
        is_same = (form.address, form.user) == (address, user)
        return address.strip(), user, self._password.value or (form.password if is_same else "")

    def _hint(self) -> None:
        if self._form.password and not self._password.value:
            self._password.props("stack-label placeholder='as entered before'")
        else:
            self._password.props(remove="stack-label placeholder")

    async def _list(self) -> None:
        url, user, password = self._entered()
        if not self._is_address(url):
            return
        self._show_command("--list")
        self._points.show_state("asking the caster")

        def read() -> list[Mountpoint]:
            return read_source_table(url, user=user or None, password=password or None)

        found = await self._session.attempt(read)
        if found:
            self._points.show(found, self._station.model.fix.position)
        else:
            self._points.show_state("" if found is None else "the caster has no mountpoints")

    async def _toggle(self) -> None:
        if self._station.corrections is not None:
            await self._session.attempt(self._station.stop_corrections)
            self._show()
            return
        (url, user, password), mountpoint = self._entered(), self._mountpoint.value.strip()
        if not self._is_address(url):
            return
        if not mountpoint:
            ui.notify("name a mountpoint of the caster", type="warning")
            return
        gga = GGA if self._gga.value else None
        self._show_command("--mountpoint", mountpoint, *(["--gga", str(gga)] if gga else []))
        await self._session.attempt(
            self._station.start_corrections, url, mountpoint, user, password, gga
        )
        self._show()

    @staticmethod
    def _is_address(url: str) -> bool:
        """Returns whether a text is the address of a caster; a problem is shown."""
        problem = problem_of(parse_address, url) if url else "name the caster first"
        if problem:
            ui.notify(problem, type="warning", multi_line=True)
        return not problem

    def _show_command(self, *words: str) -> None:
        """Shows the command that does the same; a password is not shown."""
        url, user, password = self._entered()
        words = ("--caster", url, *(["--user", user] if user else []), *words)
        self._session.show_command(
            command_line("ntrip", self._station.source, *words),
            "with the password in XBUS_NTRIP_PASSWORD" if password else "",
        )

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
