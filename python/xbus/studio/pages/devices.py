"""Devices: ports and virtual devices, what is open, and what is wrong with a port."""

from __future__ import annotations

import asyncio
import html
from collections.abc import Awaitable, Callable
from functools import partial
from typing import Any

from nicegui import ui

from xbus.describe.names import file_label
from xbus.device import Port, find_ports
from xbus.doctor import examine
from xbus.formatting import device_name
from xbus.protocol.values import Selftest
from xbus.studio.commands import command_line
from xbus.studio.hub import virtual_sources
from xbus.studio.shell import Session
from xbus.studio.station import Station
from xbus.watch.rows import device_state

__all__ = ["devices_page"]

#: Seconds after which the page looks for devices and ports again.
REFRESH = 2.0
#: Icon and class of each verdict of the doctor.
VERDICTS = {
    "ok": ("check_circle", "xbus-ok"),
    "warning": ("warning", "xbus-caution"),
    "problem": ("error", "xbus-fault"),
}
#: The parts that every product tests.
SENSORS = Selftest((Selftest.MAG_Z << 1) - 1)
#: Icon, class and words of each result of a self test.
RESULTS = {
    "passed": ("check_circle", "xbus-ok", "passed"),
    "failed": ("error", "xbus-fault", "failed"),
    "not reported": ("remove", "xbus-quiet", "not reported; the product may not have this part"),
}


def devices_page(session: Session) -> None:
    """Lists ports and open devices."""
    session.show_command(command_line("ports"), "xbus.find_ports()")
    devices: list[str] = []
    ports: list[Port] = []
    with ui.row().classes("w-full gap-4 items-start no-wrap max-md:flex-wrap"):
        with ui.column().classes("gap-3 grow min-w-0"):
            ui.label("Open devices").classes("text-lg")
            _open_devices(session, devices)
        with ui.column().classes("gap-3 w-96 shrink-0"):
            _ports(session, ports)
            _virtual(session)
            _findings(session)

    async def refresh() -> None:
        """Shows devices that others open and close, and ports that come and go."""
        found = await asyncio.to_thread(find_ports)
        if found != ports or list(session.hub.stations) != devices:
            _draw_again()

    ui.timer(REFRESH, refresh)


def _draw_again() -> None:
    """Draws the devices and the ports on all pages again."""
    _open_devices.refresh()
    _port_list.refresh()


@ui.refreshable
def _open_devices(session: Session, shown: list[str]) -> None:
    """Draws the open devices, and keeps their ports in a list."""
    stations = list(session.hub.stations.values())
    shown[:] = [station.source for station in stations]
    if not stations:
        with ui.element("div").classes("xbus-card w-full"):
            ui.label("No device is open.")
            ui.label("Choose a port, or a virtual device if you have none at hand.").classes(
                "xbus-quiet"
            )
    for station in stations:
        _device(session, station)


def _device(session: Session, station: Station) -> None:
    device, replaying = station.device, station.replaying
    with ui.element("div").classes(f"xbus-card w-full xbus-device-{station.key}"):
        with ui.row().classes("items-center w-full"):
            ui.label(station.title).classes("text-base font-semibold")
            if station.is_virtual:
                ui.badge("virtual" if replaying is None else "replay").props("outline")
            ui.space()
            ui.button(
                "Live", icon="show_chart", on_click=lambda: ui.navigate.to(f"/live/{station.key}")
            ).props("flat dense no-caps")
            if replaying is None:  # it would be a test of no device
                ui.button(
                    "Self test",
                    icon="health_and_safety",
                    on_click=lambda: session.stay(_self_test(session, station)),
                ).props("flat dense no-caps").tooltip(
                    "RunSelftest, section 5.3.2 of the manual: takes up to 3 s, and measuring stops meanwhile"
                )
            ui.button(
                "Close", icon="close", on_click=lambda: session.stay(_close(session, station))
            ).props("flat dense no-caps")
        identity = station.identity
        firmware = "unknown" if identity.firmware is None else str(identity.firmware)
        number = "unknown" if identity.device_id is None else device_name(identity.device_id)
        rate = device.link.baudrate
        rows = {"device identifier": number, "firmware": firmware}
        if replaying is None:
            line = f"{rate:,}" if device.link.is_line and rate else "none: not a serial line"
            rows = {"port": station.source, **rows, "baud rate": line}
        else:
            rows = {"recording": ", ".join(map(file_label, replaying.files)), **rows}
        cells = "".join(
            f"<tr><th>{html.escape(name)}</th><td>{html.escape(text)}</td></tr>"
            for name, text in rows.items()
        )
        ui.html(f'<table class="xbus-table" style="width:auto">{cells}</table>', sanitize=False)
        state = ui.label().classes("text-sm")

        def refresh() -> None:
            state.set_text(device_state(station.model))
            state.classes(
                add="xbus-fault" if station.model.is_lost else "xbus-quiet",
                remove="xbus-quiet" if station.model.is_lost else "xbus-fault",
            )

        refresh()
        ui.timer(0.5, refresh)


async def _self_test(session: Session, station: Station) -> None:
    if not await session.may_interrupt(station):
        return

    def run() -> Any:
        with station.device.configure() as device:
            return device.commands.run_selftest()

    session.show_command(
        command_line("send", station.source, "--config", "RunSelftest"),
        "with device.configure() as cfg: cfg.commands.run_selftest()",
    )
    result = await session.attempt(run)
    if result is None:
        return
    support = station.device.support
    expected = SENSORS if support is None else support.selftest
    with ui.dialog() as dialog, ui.card():
        ui.label(f"Self test of {station.title}").classes("text-base font-semibold")
        for part in Selftest:
            icon, level, verdict = RESULTS[
                "passed" if part in result else "failed" if part in expected else "not reported"
            ]
            with ui.row().classes("items-center gap-2"):
                ui.icon(icon).classes(level)
                name = str(part.name).replace("_", " ").lower()
                ui.label(f"{name}: {verdict}")
        ui.button("Close", on_click=dialog.close).props("flat no-caps")
    dialog.on("hide", dialog.delete)
    dialog.open()


async def _open(session: Session, source: str) -> None:
    if await session.open(source) is not None:
        session.show_command(command_line("identify", source), f'device = xbus.connect("{source}")')
        _draw_again()


async def _close(session: Session, station: Station) -> None:
    if problem := await session.attempt(session.hub.close, station.source):
        ui.notify(problem, type="negative", multi_line=True, timeout=0, close_button=True)
    if session.key == station.key:
        session.key = None
    _draw_again()


def _ports(session: Session, shown: list[Port]) -> None:
    with ui.element("div").classes("xbus-card w-full"):
        with ui.row().classes("items-center w-full"):
            ui.label("Ports").classes("text-base font-semibold")
            ui.space()
            ui.button(icon="refresh", on_click=lambda: _port_list.refresh()).props(
                "flat dense round aria-label='look for ports again'"
            ).tooltip("look for ports again")
        _port_list(session, shown)
        with ui.row().classes("items-center w-full no-wrap"):
            name = ui.input("port or URL", placeholder="/dev/ttyUSB0, socket://HOST:PORT")
            name.classes("grow").props("dense")
            open_port = _open_button(session, "the port or URL", lambda: name.value)
            name.on("keydown.enter", open_port)


@ui.refreshable
def _port_list(session: Session, shown: list[Port]) -> None:
    """Draws the ports, and keeps them in a list."""
    shown[:] = find_ports()
    if not shown:
        ui.label("No serial port. Check the cable, or use a virtual device.").classes(
            "xbus-quiet text-sm"
        )
    for port in shown:
        with ui.row().classes("items-center w-full no-wrap"):
            with ui.column().classes("gap-0 grow min-w-0"):
                ui.label(port.device).classes("xbus-mono")
                if port.description != "n/a":  # as pyserial writes that there is none
                    ui.label(port.description).classes("xbus-quiet text-xs ellipsis")
            if port.likely:
                ui.badge("Xsens").props("outline color=positive")
            if port.device in session.hub.stations:
                ui.label("open").classes("xbus-ok text-sm")
            else:
                _open_button(session, port.device, partial(str, port.device))


def _virtual(session: Session) -> None:
    with ui.element("div").classes("xbus-card w-full"):
        ui.label("Virtual device").classes("text-base font-semibold")
        with ui.row().classes("items-center w-full no-wrap"):
            choice = (
                ui.select(virtual_sources(), value="sim:MTi-680G").classes("grow").props("dense")
            )
            _open_button(session, "the virtual device", lambda: choice.value)


def _findings(session: Session) -> None:
    """Shows what the doctor finds on this computer: permissions, ModemManager, latency timers."""
    with ui.element("div").classes("xbus-card w-full"):
        with ui.row().classes("items-center w-full"):
            ui.label("This computer").classes("text-base font-semibold")
            ui.space()
            ui.button("Check", icon="troubleshoot", on_click=lambda: check()).props(
                "flat dense no-caps"
            )
        found = ui.column().classes("gap-1 text-sm")
        with found:
            ui.label("Checks permissions and settings of the ports.").classes("xbus-quiet")

    async def check() -> None:
        session.show_command("xbus doctor", "")
        examination = await session.attempt(examine)
        if examination is None:
            return
        found.clear()
        with found:
            for finding in examination.findings:
                icon, level = VERDICTS[finding.verdict]
                with ui.row().classes("items-start no-wrap gap-2"):
                    ui.icon(icon).classes(level)
                    remedy = f"; {finding.remedy}" if finding.remedy else ""
                    ui.label(finding.message + remedy)


def _open_button(
    session: Session, what: str, source: Callable[[], str]
) -> Callable[[], Awaitable[None]]:
    """Draws a button that opens a port, and returns what it does."""

    async def open_port() -> None:
        if name := source().strip():
            await session.stay(_open(session, name))

    ui.button("Open", on_click=open_port).props(f'flat dense no-caps aria-label="Open {what}"')
    return open_port
