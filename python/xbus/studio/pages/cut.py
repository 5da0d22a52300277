"""The dialog that cuts a part out of a recording."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from nicegui import ui

from xbus.describe.names import file_label
from xbus.studio.commands import command_line, part_options
from xbus.studio.library import Entry

__all__ = ["choose_part"]

#: Numbers of the slider.
STEPS = 1000


async def choose_part(entry: Entry, duration: float, picture: str, out: Path) -> list[str] | None:
    """Asks for begin and end of a part of a recording.

    Args:
        entry: The recording.
        duration: Its duration in seconds.
        picture: Its thumbnail.
        out: Where the part goes.

    Returns:
        The command that writes the part, without ``xbus``; None if the user does not want one.
    """

    def words() -> list[str]:
        return [
            "cut",
            *entry.arguments,
            *part_options(begin.value, end.value, duration),
            *("-o", str(out), "-q"),
        ]

    def problem() -> str | None:
        if begin.value is None or end.value is None:
            return "give begin and end in seconds"
        if not 0 <= begin.value < end.value:
            return "the end must be after the begin"
        return None

    def changed() -> None:
        reason = problem()
        command.set_text(reason or command_line(*words()))
        command.classes(add="xbus-fault" if reason else "", remove="" if reason else "xbus-fault")
        button.set_enabled(reason is None)

    def slid(event: Any) -> None:
        low, high = (event.value[name] / STEPS * duration for name in ("min", "max"))
        begin.set_value(round(low, 2))
        end.set_value(round(high, 2))

    with ui.dialog() as dialog, ui.card().classes("w-[640px] max-w-full gap-2"):
        ui.label(f"Cut {entry.heading}").classes("text-base font-semibold")
        ui.html(picture, sanitize=False).classes("xbus-picture w-full")
        ui.range(min=0, max=STEPS, value={"min": 0, "max": STEPS}, on_change=slid).props(
            "aria-label='part of the recording'"
        )
        with ui.row().classes("w-full items-center gap-4"):
            begin = ui.number("begin, s", value=0, min=0, on_change=lambda: changed())
            end = ui.number("end, s", value=round(duration, 2), min=0, on_change=lambda: changed())
            ui.label(f"of {duration:,.2f} s").classes("xbus-quiet")
        ui.label(
            f"Writes {file_label(out.name)} beside the recording, which stays as it is."
        ).classes("xbus-quiet text-sm")
        command = ui.label().classes("xbus-mono break-all")
        with ui.row().classes("w-full justify-end"):
            ui.button("Cancel", on_click=lambda: dialog.submit(None)).props("flat no-caps")
            button = ui.button(
                "Cut", icon="content_cut", on_click=lambda: dialog.submit(words())
            ).props("no-caps")
    changed()
    chosen: list[str] | None = await dialog
    if not dialog.is_deleted:  # with its page
        dialog.delete()
    return chosen
