"""The frame of every page: devices, pages, the health of the selected device, and the last command."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, TypeVar

from nicegui import run, ui
from nicegui.element import Element

from xbus.errors import XbusError
from xbus.studio.dialogs import is_confirmed
from xbus.studio.health import health
from xbus.studio.hub import Hub, HubError
from xbus.studio.replay_bar import ReplayBar
from xbus.studio.replaying import source_label
from xbus.studio.station import Station

__all__ = ["GAP", "PAGES", "Session", "failure_text", "frame"]

T = TypeVar("T")

#: What Config State does to a recording.
GAP = "The device does not measure meanwhile, so the recording gets a gap."

#: Pages in the order of the menu: path, name, icon.
PAGES = (
    ("devices", "Devices", "cable"),
    ("live", "Live", "show_chart"),
    ("configure", "Configure", "tune"),
    ("record", "Record", "fiber_manual_record"),
    ("recordings", "Recordings", "folder"),
    ("rtk", "RTK", "cell_tower"),
    ("messages", "Messages", "forum"),
)
HEAD = """
<link rel="stylesheet" href="/static/uPlot.min.css">
<link rel="stylesheet" href="/static/studio.css">
<script src="/static/uPlot.iife.js"></script>
<script src="/static/feed.js"></script>
"""


@dataclass
class Session:
    """One page in a browser.

    Attributes:
        hub: The devices.
        key: Key of the selected device; None if none is.
        page: Name of the page that is shown.
        dialogs: Where dialogs are drawn that stay until another page is shown.
    """

    hub: Hub
    key: str | None = None
    page: str = "devices"
    dialogs: Element = field(init=False, repr=False)
    _panel: Callable[[str, str], None] = field(default=lambda _command, _python: None)
    _menu: dict[str, ui.button] = field(default_factory=dict, repr=False)
    #: The device that the page is about, if there is one.
    _shown: Station | None = None

    def begin_page(self, page: str, key: str | None) -> None:
        """Removes what the page before has left, and marks the page in the menu."""
        self.page, self.key = page, key or self.key
        self.dialogs.clear()
        self.show_command("", "")
        for name, button in self._menu.items():
            button.props("aria-current=page" if name == page else "", remove="aria-current")

    @property
    def station(self) -> Station | None:
        """The selected device, or else the first one; None if it is not open."""
        stations = self.hub.stations.values()
        if self.key is None:
            return next(iter(stations), None)
        return next((each for each in stations if each.key == self.key), None)

    def require_station(self) -> Station | None:
        """Returns the selected device; without one, the page offers to open it."""
        self._shown = self.station
        if self._shown is None:
            source = None if self.key is None else self.hub.source_of(self.key)
            with ui.element("div").classes("xbus-card w-full"):
                name = self.key if source is None else source_label(source)
                ui.label("No device is open." if name is None else f"{name} is not open.")
                if source is not None:
                    ui.button(f"Open {name}", on_click=lambda: self._open_and_show(source)).props(
                        "no-caps"
                    ).classes("my-2")
                ui.link("All devices", "/")
        return self._shown

    def require_device(self, refusal: str) -> Station | None:
        """Returns the selected device; for a replay, the page shows the refusal."""
        station = self.require_station()
        if station is None or station.replaying is None:
            return station
        with ui.element("div").classes("xbus-card w-full"):
            ui.label(refusal)
            ui.link("All devices", "/")
        return None

    async def may_interrupt(self, station: Station) -> bool:
        """Returns whether a device may stop measuring for a moment: during a recording, the user decides."""
        if not station.is_recording:
            return True
        return await is_confirmed(
            f"Interrupt the recording of {station.title}?",
            (GAP,),
            "Interrupt",
        )

    async def open(self, source: str) -> Station | None:
        """Opens a device, makes it measure and selects it. Returns None if it cannot be opened."""
        waiting = ui.notification(f"opening {source_label(source)}", spinner=True, timeout=None)
        try:
            station = await self.attempt(self.hub.open, source)
            if station is not None:
                self.key = station.key
                await self.attempt(station.measure)
        finally:
            waiting.dismiss()
        return station

    async def _open_and_show(self, source: str) -> None:
        if (station := await self.open(source)) is not None:
            ui.navigate.to(address(self.page, station.key))
            ui.navigate.reload()

    async def stay(self, action: Awaitable[T]) -> T:
        """Runs an action whose button may be drawn again meanwhile: its dialogs and messages stay."""
        with self.dialogs:
            return await action

    def show_command(self, command: str, python: str) -> None:
        """Shows what does the same in a shell and in Python."""
        self._panel(command, python)

    async def attempt(self, action: Callable[..., T], *args: Any) -> T | None:
        """Runs an action in a thread; a failure is shown as one sentence.

        Returns:
            What the action returns; None if it failed.
        """
        try:
            return await run.io_bound(action, *args)
        except (HubError, XbusError, ImportError, OSError, ValueError, RuntimeError) as error:
            ui.notify(
                failure_text(error),
                type="negative",
                multi_line=True,
                timeout=10_000,
                close_button=True,
            )
            return None


def failure_text(error: Exception) -> str:
    """Returns the sentence about a failure."""
    if isinstance(error, OSError) and error.strerror and not isinstance(error, XbusError):
        return f"{error.filename or 'The file'}: {error.strerror}"
    return str(error)


@contextmanager
def frame(session: Session) -> Iterator[None]:
    """Draws header, health strip and footer around a page."""
    ui.add_head_html(HEAD)
    with ui.header(elevated=False).classes("xbus-header items-center gap-3 py-1"):
        ui.label("xbus studio").classes("text-base font-semibold")
        with ui.row().classes("gap-1 items-center").props("role=navigation"):
            for path, name, icon in PAGES:
                button = ui.button(name, icon=icon, on_click=lambda path=path: _go(session, path))
                session._menu[path] = button.props("flat dense no-caps").mark(f"page-{path}")
        ui.space()
        with ui.row().classes("gap-1 items-center") as tabs:
            pass
        ui.button(icon="dark_mode", on_click=_toggle_dark).props(
            "flat dense round aria-label='dark or light'"
        ).tooltip("dark or light")
    with ui.element("div").classes("xbus-strip w-full"):
        strip = ui.html("", sanitize=False).classes("xbus-health").props("aria-live=off")
        clear = ui.button("Clear counts", icon="restart_alt", on_click=lambda: _clear(session))
        clear.props("flat dense no-caps size=sm").classes("shrink-0").tooltip(
            "counts losses, damage and samples out of range from now on"
        )
    replay = ReplayBar(lambda: session.station, session.attempt)
    with ui.footer(elevated=False).classes("xbus-footer items-center gap-4 py-1"):
        prompt = ui.icon("terminal").classes("xbus-quiet")
        command = ui.label().classes("xbus-mono")
        python = ui.label().classes("xbus-mono xbus-quiet")

    def show(text: str, code: str) -> None:
        prompt.set_visibility(bool(text or code))
        command.set_text(text)
        python.set_text(code)

    session._panel = show
    shown: list[tuple[str, str, bool]] = []

    def refresh() -> None:
        titled = session.hub.titled().values()
        selected = session.station
        state = [(station.key, title, station is selected) for station, title in titled]
        if state != shown:
            shown[:] = state
            tabs.clear()
            with tabs:
                for key, title, is_selected in state:
                    tab = ui.button(title, on_click=lambda key=key: _select(session, key))
                    tab.classes("xbus-tab").tooltip(title)
                    tab.props(
                        "dense no-caps " + ("unelevated color=primary" if is_selected else "flat")
                    )
        strip.set_content("" if selected is None else health(selected))
        clear.set_visibility(selected is not None and selected.model.has_faults)
        replay.refresh()
        if session._shown is not None and session._shown not in session.hub.stations.values():
            session._shown = None
            ui.navigate.reload()  # another page has closed the device

    refresh()
    ui.timer(0.5, refresh)
    session.dialogs = ui.element("div").classes("hidden")
    with ui.element("div").classes("xbus-page"):
        yield


def address(page: str, key: str | None) -> str:
    """Returns the address of a page; pages about one device have its key."""
    if page == "devices":
        return "/"
    return f"/{page}" if key is None or page == "recordings" else f"/{page}/{key}"


def _go(session: Session, path: str) -> None:
    station = session.station
    ui.navigate.to(address(path, session.key if station is None else station.key))


def _select(session: Session, key: str) -> None:
    session.key = key
    ui.navigate.to(address(session.page, key))


def _clear(session: Session) -> None:
    if (station := session.station) is not None:
        station.clear_counts()


def _toggle_dark() -> None:
    ui.run_javascript("Quasar.Dark.toggle()")
