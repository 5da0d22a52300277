"""The dialog about the magnetic field of a recording."""

from __future__ import annotations

import asyncio
import html
import threading
from collections.abc import Iterator

from nicegui import ui

from xbus.formatting import format_size
from xbus.log.log import Log
from xbus.log.read import iter_log
from xbus.plots.panels import MAGNETIC
from xbus.report import BLOCK, FieldQuality, Quality, gather_parts
from xbus.report.data import ReportData, Series
from xbus.report.magnetic import SCALE, facts
from xbus.studio.commands import command_line
from xbus.studio.drawing import cloud, curve
from xbus.studio.library import Entry
from xbus.studio.shell import Session, failure_text

__all__ = ["show_field"]

LEVELS = {
    Quality.GOOD: ("check_circle", "xbus-ok"),
    Quality.FAIR: ("info", "xbus-caution"),
    Quality.DISTURBED: ("error", "xbus-fault"),
    Quality.UNKNOWN: ("help", "xbus-quiet"),
}


class _ClosedError(Exception):
    """The dialog is closed."""


async def show_field(session: Session, entry: Entry) -> None:
    """Reads the magnetic field of a recording, and shows its quality."""
    session.show_command(
        command_line("report", *entry.arguments),
        'xbus.report.magnetic_field_quality(log["magnetic_field"].values)',
    )
    stop, done = threading.Event(), 0

    def read() -> ReportData:
        def parts() -> Iterator[Log]:
            nonlocal done
            for part in iter_log(
                [str(file) for file in entry.files], block_bytes=BLOCK, quantities=MAGNETIC
            ):
                if stop.is_set() or dialog.is_deleted:
                    raise _ClosedError
                yield part
                done += part.stats.bytes

        return gather_parts(parts())

    def close() -> None:
        stop.set()
        dialog.delete()

    def show_progress() -> None:
        if not progress.is_deleted:
            share = f"{100 * done / max(entry.size, 1):.0f} %"
            progress.set_text(
                f"decompressed {format_size(done)}" if entry.is_compressed else f"reading {share}"
            )

    with ui.dialog() as dialog, ui.card().classes("w-[860px] max-w-full gap-2"):
        ui.label(f"Magnetic field of {entry.heading}").classes("text-base font-semibold")
        content = ui.column().classes("w-full gap-2")
        with content:
            with ui.row().classes("items-center"):
                ui.spinner()
                progress = ui.label("reading").classes("xbus-quiet")
            ui.timer(0.5, show_progress)
        with ui.row().classes("w-full justify-end"):
            ui.button("Close", on_click=dialog.close).props("flat no-caps")
    dialog.on("hide", close)
    dialog.open()
    try:
        data = await asyncio.to_thread(read)
    except _ClosedError:
        return
    except (ImportError, OSError, ValueError) as error:
        if dialog.is_deleted:
            return
        content.clear()
        with content:
            ui.label(failure_text(error)).classes("xbus-fault")
        return
    finally:
        stop.set()  # also when the studio ends
    if dialog.is_deleted:
        return
    content.clear()
    with content:
        for series in data.series:
            if series.field is not None:
                _show(series, series.field.quality())


def _show(series: Series, quality: FieldQuality) -> None:
    icon, level = LEVELS[quality.quality]
    with ui.row().classes("items-center no-wrap gap-2"):
        ui.icon(icon, size="sm").classes(level)
        ui.label(f"{series.title}: {quality.verdict}").classes(level)
    (panel,) = series.panels.values()
    time, norm = panel.curves.by_name["norm"].line()
    clouds = [("as recorded", quality.points)]
    if quality.ellipsoid is not None:
        clouds.append(("corrected", quality.ellipsoid.corrected(quality.points)))
    ui.html(curve("norm, a.u.", time, norm), sanitize=False).classes("w-full")
    ui.html(cloud(clouds), sanitize=False).classes("w-full")
    rows = "".join(
        f"<tr><th>{html.escape(name)}</th><td>{html.escape(text)}</td></tr>"
        for name, text in facts(quality)
    )
    ui.html(f'<table class="xbus-table">{rows}</table>', sanitize=False).classes("w-full")
    ui.label(f"{SCALE} Nothing is written to a device.").classes("xbus-quiet text-sm")
