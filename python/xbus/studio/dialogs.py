"""Questions before something is changed that cannot be undone."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from nicegui import ui

__all__ = ["is_confirmed"]


async def is_confirmed(
    title: str,
    sentences: Iterable[str],
    answer: str,
    *,
    draw: Callable[[], object] = lambda: None,
) -> bool:
    """Asks a question, and returns whether it is confirmed.

    Args:
        title: The question.
        sentences: What happens.
        answer: The button that confirms it.
        draw: Draws what is more than sentences.
    """
    with ui.dialog() as dialog, ui.card().classes("min-w-[480px]"):
        ui.label(title).classes("text-base font-semibold")
        for sentence in sentences:
            ui.label(sentence)
        draw()
        with ui.row():
            ui.button(answer, on_click=lambda: dialog.submit(True)).props("no-caps")
            ui.button("Cancel", on_click=lambda: dialog.submit(False)).props("flat no-caps")
    answered = bool(await dialog)
    if not dialog.is_deleted:  # with its page
        dialog.delete()
    return answered
