"""Inputs for the fields of a message, or for those of each entry of a list."""

from __future__ import annotations

import html
from collections.abc import Callable, Mapping
from enum import IntEnum, IntFlag
from functools import partial
from typing import Any

from nicegui import ui
from nicegui.elements.mixins.value_element import ValueElement

from xbus.protocol.layout import Layout
from xbus.protocol.messages import LAYOUTS
from xbus.protocol.products import Support
from xbus.protocol.tables import MESSAGES, MessageField
from xbus.studio.entered import problem_of
from xbus.studio.setting_fields import message_choices

__all__ = ["MessageForm"]

#: Names to choose from; of more, one is typed, with completion.
MAX_CHOICES = 20
#: Payloads whose layout is in no source.
WITHOUT_LAYOUT = ("unknown", "opaque")


class MessageForm:
    """The inputs.

    Args:
        name: Name of the message.
        support: What the product of the device supports; None if that is not known.
        on_change: Called after each change.
        on_enter: Called when Enter is pressed in an input.
    """

    def __init__(
        self,
        name: str,
        support: Support | None,
        on_change: Callable[[], Any],
        on_enter: Callable[[], Any],
    ) -> None:
        self._row, self._layout, self._on_change = MESSAGES[name], LAYOUTS[name], on_change
        rows = {field.name: field for form in self._row.forms for field in form}
        fields = {field: rows.get(field) for field in self._layout.fields}
        numbers = {
            field: message_choices(name, field, support) or {}
            for field, kind in self._layout.kinds.items()
            if kind is int and support is not None
        }
        self._draw_record = partial(_Record, self._layout, fields, numbers, on_change, on_enter)
        self._entries: list[_ListEntry] = []
        if self._layout.several:
            self._draw_list()
        else:
            with ui.row().classes("items-start gap-x-4 gap-y-0"):
                self._record = self._draw_record()
            if self._row.kind == "bytes":
                ui.label(self._reason).classes("xbus-quiet text-sm self-center")

    @property
    def _reason(self) -> str:
        """Why a message has no inputs but one for hex."""
        if self._row.payload in WITHOUT_LAYOUT:
            return "Only in hex, because no source describes the fields."
        return f"In hex: {self._row.payload}."

    @property
    def words(self) -> list[str]:
        """The fields as ``xbus send`` takes them."""
        if self._layout.several:
            return [",".join(entry.record.words) for entry in self._entries]
        return self._record.words

    def read(self) -> Any:
        """Returns the value of the message.

        Raises:
            ValueError: A field is missing, or has no value.
        """
        for at, entry in enumerate(self._entries, 1):
            if not entry.record.words:
                raise ValueError(f"entry {at} is empty; fill in its fields, or remove it")
        return self._layout.read(self.words)

    # Lists

    def _draw_list(self) -> None:
        with ui.column().classes("w-full gap-0"):
            self._list = ui.column().classes("w-full gap-0")
            self._empty = ui.label("no entries: the list of the device is cleared")
            self._empty.classes("xbus-quiet text-sm")
            self._button = ui.button("Add entry", icon="add", on_click=self._add_row)
            self._button.props("flat no-caps")
        for _ in range(max(1, self._row.least)):
            self._add_row()

    def _add_row(self) -> None:
        with self._list:
            entry = _ListEntry(self._draw_record, self._remove)
        self._entries.append(entry)
        self._show_list()

    def _remove(self, entry: _ListEntry) -> None:
        self._entries.remove(entry)
        entry.delete()
        self._show_list()

    def _show_list(self) -> None:
        """Shows numbers, and what can be added and removed."""
        count, least = len(self._entries), 0 if self._row.zeros else self._row.least
        for at, entry in enumerate(self._entries, 1):
            entry.show(at, is_removable=count > least)
        self._empty.set_visibility(count == 0)
        self._button.set_visibility(count < self._row.most)
        self._on_change()


class _Record:
    """The inputs of a record."""

    def __init__(
        self,
        layout: Layout,
        fields: Mapping[str, MessageField | None],
        numbers: Mapping[str, Mapping[int, str]],
        on_change: Callable[[], Any],
        on_enter: Callable[[], Any],
    ) -> None:
        self._controls = {
            name: _control(name, layout, field, numbers.get(name), on_change, on_enter)
            for name, field in fields.items()
        }

    @property
    def words(self) -> list[str]:
        """``NAME=VALUE`` of each field that has a value."""
        words = {name: _word(control.value) for name, control in self._controls.items()}
        return [f"{name}={word}" for name, word in words.items() if word]


class _ListEntry:
    """An entry of a list.

    Attributes:
        record: The inputs.
    """

    def __init__(
        self, draw_record: Callable[[], _Record], on_remove: Callable[[_ListEntry], Any]
    ) -> None:
        with ui.row().classes("w-full items-start gap-x-4 gap-y-0 xbus-entry") as self._row:
            self._number = ui.label().classes("xbus-quiet self-center")
            self.record = draw_record()
            self._button = ui.button(icon="delete", on_click=lambda: on_remove(self))
            self._button.props("flat round").classes("self-center")

    def show(self, number: int, *, is_removable: bool) -> None:
        """Shows the number of the entry, and whether it can be removed."""
        self._number.set_text(f"{number}.")
        self._button.props(f'aria-label="Remove entry {number}"').set_visibility(is_removable)

    def delete(self) -> None:
        """Removes the inputs."""
        self._row.delete()


def _control(
    name: str,
    layout: Layout,
    field: MessageField | None,
    numbers: Mapping[int, str] | None,
    on_change: Callable[[], Any],
    on_enter: Callable[[], Any],
) -> ValueElement[Any]:
    """Draws the input of one field; of ``numbers``, which have names, one is chosen."""
    kind = layout.kinds[name]
    label = f"{name}, {field.unit}" if field is not None and field.unit else name
    if kind is bool:
        return ui.checkbox(label, value=False, on_change=on_change).classes("self-center")
    names = [str(each.name) for each in kind] if issubclass(kind, IntEnum | IntFlag) else []
    control: ui.select | ui.input
    if numbers:
        control = ui.select(dict(numbers), label=label, clearable=True, on_change=on_change)
    elif issubclass(kind, IntFlag):
        # Without a flag the value is zero.
        control = ui.select(names, label=label, multiple=True, on_change=on_change).props(
            "use-chips"
        )
    elif 0 < len(names) <= MAX_CHOICES:
        control = ui.select(names, label=label, clearable=True, on_change=on_change)
    else:
        control = ui.input(
            label,
            autocomplete=names,
            validation=partial(problem_of, layout.fields[name]),
            on_change=on_change,
        ).on("keydown.enter", on_enter)
    control.classes("w-56").props(f'dense options-dense hide-bottom-space aria-label="{label}"')
    if field is not None and (note := _note(field)):
        control.props(f'hint="{html.escape(note)}"')
    return control


def _note(field: MessageField) -> str:
    """Returns what a field takes; an empty text if the tables do not say."""
    if field.repeat > 1 and field.type not in ("text", "bytes"):
        return ", ".join(filter(None, (f"{field.repeat} numbers with commas between", field.note)))
    return field.note


def _word(value: Any) -> str:
    """Returns what was entered as a word of a command line."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, list):
        return "|".join(value) or "0"
    return "" if value is None else str(value).strip()
