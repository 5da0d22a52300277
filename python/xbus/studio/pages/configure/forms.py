"""The controls of one setting: fields with unit, range and what they mean, checked as they are edited."""

from __future__ import annotations

import html
from collections.abc import Callable, Mapping
from dataclasses import replace
from enum import IntFlag
from functools import partial
from typing import Any

import numpy as np
from nicegui import ui
from nicegui.elements.mixins.value_element import ValueElement

from xbus.device.can_output import parse_can_configuration
from xbus.device.settings import converters
from xbus.geometry.quaternion import from_euler, to_euler
from xbus.protocol import values as v
from xbus.studio.pages.configure.document import Document
from xbus.studio.setting_fields import (
    Field,
    choices,
    entry_kind,
    fields_of,
    flags,
    help_of,
    is_record,
    label,
    profiles,
    title,
)

__all__ = ["SettingForm"]

#: Rotations, which have roll, pitch and yaw too.
ROTATIONS = ("rot_sensor", "rot_local")
#: Lists whose number of entries the product determines.
FIXED = ("port_config",)
#: Names of their entries.
PORTS = ("RS232", "UART", "RS232 for corrections")

#: Fields of an entry that fit into a table on a small screen.
MAX_COLUMNS = 6

#: Returns the value of a control, or raises ValueError.
Get = Callable[[], Any]


class SettingForm:
    """The card of a setting.

    Args:
        document: The settings.
        name: The setting.
    """

    def __init__(self, document: Document, name: str) -> None:
        self._document, self.name = document, name
        with ui.element("div").classes(f"xbus-card w-full xbus-setting-{name}"):
            with ui.row().classes("items-center gap-2"):
                ui.label(title(name)).classes("text-sm font-semibold")
                ui.label(name).classes("xbus-mono xbus-quiet")
                ui.icon("info").classes("xbus-quiet").tooltip(help_of(name))
            self._body = ui.element("div").classes("w-full")
            self._problems = ui.html("", sanitize=False)
        self._draw()
        document.draw.append(self._draw)
        document.show.append(self._show_problems)

    @property
    def _value(self) -> Any:
        return getattr(self._document.draft.settings, self.name)

    def _draw(self) -> None:
        """Draws the controls with the value of the draft."""
        self._body.clear()
        with self._body:
            if self.name == "filter_profile":
                self._draw_profile()
            elif self.name in ROTATIONS:
                self._draw_rotation()
            elif entry_kind(self.name)[1]:
                self._draw_list()
            else:
                with ui.row().classes("items-start gap-x-4 gap-y-0"):
                    self._get: Get = self._entry(self._value, self._enter)

    def _show_problems(self) -> None:
        """Shows what is wrong with the setting."""
        problems = self._document.draft.problems_of(self.name)
        self._problems.set_content(
            "".join(
                f'<div class="xbus-fault text-sm">{html.escape(each)}</div>' for each in problems
            )
        )

    def _enter(self) -> None:
        """Takes over what the controls show."""
        draft = self._document.draft
        self._document.change(lambda: draft.enter(self.name, self._get))

    # Fields

    @property
    def _is_table(self) -> bool:
        """Whether the fields are columns of a table, and not labelled one by one."""
        return entry_kind(self.name)[1] and len(fields_of(self.name)) <= MAX_COLUMNS

    def _entry(self, entry: Any, on_change: Callable[[], None]) -> Get:
        """Draws the fields of a value, or of an entry of a list, and returns how to get it."""
        fields = fields_of(self.name)
        if not is_record(self.name):
            return self._control(fields[0], entry, entry, on_change)
        controls = {
            field.name: self._control(field, entry, getattr(entry, field.name), on_change)
            for field in fields
            if getattr(entry, field.name) is not None  # of another series
        }

        def get() -> Any:
            return _with(entry, {name: control() for name, control in controls.items()})

        return get

    def _control(self, field: Field, entry: Any, value: Any, on_change: Callable[[], None]) -> Get:
        """Draws one field, and returns how to get its value."""
        support, in_list = self._document.draft.support, self._is_table
        name = None if in_list else label(field.name)
        tip = ". ".join(part.rstrip(".") for part in (field.help, field.hint) if part)
        control: ValueElement[Any]
        if (known := choices(self.name, field, support, entry)) is not None:
            options = {**known, **({} if int(value) in known else {int(value): str(int(value))})}
            control = ui.select(options, value=int(value), label=name, on_change=on_change)
            control.props("dense options-dense").classes("min-w-32").tooltip(tip)
            return lambda: control.value
        if field.kind is bool:
            control = ui.checkbox(name or "", value=value, on_change=on_change).props("dense")
            control.props(f'aria-label="{label(field.name)}"').classes("self-center").tooltip(tip)
            return lambda: control.value
        if issubclass(field.kind, IntFlag):
            return self._flags(field, value, on_change)
        shown = converters.FLOAT32.write(value) if self.name == "gnss_lever_arm" else value
        number = ui.number(
            name and (f"{name}, {field.unit}" if field.unit else name),
            value=shown,
            step=0.01 if field.kind is float else 1,
            on_change=on_change,
        )
        number.props(f'dense debounce=300 aria-label="{label(field.name)}"')
        number.classes("w-28" if in_list else "w-40").tooltip(tip)
        if field.range and not in_list:
            number.props(f'hint="{html.escape(field.range)}"')
        return lambda: _number(field, number.value)

    def _flags(self, field: Field, value: IntFlag, on_change: Callable[[], None]) -> Get:
        boxes = {}
        with ui.row().classes("gap-x-6 gap-y-0"):
            for flag in flags(field, self._document.draft.support):
                text = str(flag.name) if field.kind is v.StringType else label(str(flag.name))
                boxes[flag] = ui.checkbox(text, value=flag in value, on_change=on_change)
                boxes[flag].props("dense")
        others = int(value) & ~sum(boxes)

        def get() -> IntFlag:
            chosen: IntFlag = field.kind(
                others + sum(flag for flag, box in boxes.items() if box.value)
            )
            return chosen

        return get

    # Settings with a special form

    def _draw_profile(self) -> None:
        names = profiles(self._document.draft.support)
        present = str(self._value)
        options = names if present in names else [*names, present]
        control = ui.select(options, value=present, on_change=self._enter).props("dense")
        control.classes("w-80")
        self._get = lambda: control.value

    def _draw_rotation(self) -> None:
        """Draws a quaternion, and the same as roll, pitch and yaw."""
        is_filling = False

        def fill(controls: list[ui.number], numbers: Any) -> None:
            nonlocal is_filling
            is_filling = True
            for control, number in zip(controls, numbers, strict=True):
                control.set_value(round(float(number), 7) + 0.0)
            is_filling = False

        def quaternion() -> tuple[float, ...]:
            return tuple(
                _number(field, control.value) for field, control in zip(parts, q, strict=True)
            )

        def change_q() -> None:
            if is_filling:
                return
            self._enter()
            if not self._document.draft.problems_of(self.name):
                fill(angles, to_euler(np.array(self._value)).round(4))

        def change_angles() -> None:
            if is_filling or any(control.value is None for control in angles):
                return
            fill(q, from_euler([control.value for control in angles]))
            self._enter()

        parts = [Field(f"q{i}", float, "", "", "") for i in range(4)]
        with ui.row().classes("gap-x-4 gap-y-0"):
            q = [
                ui.number(
                    part.name, value=converters.FLOAT32.write(number), step=0.01, on_change=change_q
                )
                for part, number in zip(parts, self._value, strict=True)
            ]
        with ui.row().classes("gap-x-4 gap-y-0"):
            angles = [
                ui.number(f"{name}, deg", value=float(angle) + 0.0, step=1, on_change=change_angles)
                for name, angle in zip(
                    ("roll", "pitch", "yaw"), to_euler(np.array(self._value)).round(4), strict=True
                )
            ]
        for control in (*q, *angles):
            control.props("dense debounce=300").classes("w-32")
        self._get = quaternion

    # Lists

    def _draw_list(self) -> None:
        """Draws the fields of each entry."""
        rows: list[Get] = []
        self._get = lambda: tuple(get() for get in rows)
        if not self._value:
            ui.label("none").classes("xbus-quiet text-sm")
        elif self._is_table:
            self._draw_table(rows)
        else:
            for number, entry in enumerate(self._value):
                with ui.row().classes("w-full items-start gap-x-4 gap-y-0 xbus-entry"):
                    rows.append(self._entry(entry, partial(self._enter_row, number)))
                    self._remove_button(number)
        if self.name not in FIXED:
            ui.button("Add", icon="add", on_click=self._add).props("flat dense no-caps")

    def _draw_table(self, rows: list[Get]) -> None:
        fields = fields_of(self.name)
        columns = f"repeat({len(fields) + 1}, auto)"
        with ui.element("div").classes("w-full overflow-x-auto"), ui.grid(columns=columns) as grid:
            grid.classes("items-center gap-x-3 gap-y-0 w-max")
            if self.name in FIXED:
                ui.label()
            for field in fields:
                text = f"{label(field.name)}, {field.unit}" if field.unit else label(field.name)
                ui.label(text).classes("xbus-quiet text-xs").tooltip(field.help)
            if self.name not in FIXED:
                ui.label()
            for number, entry in enumerate(self._value):
                if self.name in FIXED:
                    ui.label(PORTS[number]).classes("text-sm")
                rows.append(self._entry(entry, partial(self._enter_row, number)))
                if self.name not in FIXED:
                    self._remove_button(number)

    def _remove_button(self, number: int) -> None:
        button = ui.button(icon="delete", on_click=partial(self._remove, number))
        button.props(f'flat dense round aria-label="Remove entry {number + 1}"')

    def _enter_row(self, number: int) -> None:
        """Takes over what the controls show; another sync function has other lines."""
        before = self._value
        self._enter()
        entry = self._value[number]
        if isinstance(entry, v.SyncSetting) and entry.function != before[number].function:
            lines = self._document.draft.support.sync.get(v.SyncFunction(entry.function), ())
            if lines and entry.line not in lines:
                entry = replace(entry, line=lines[0])
            self._replace((*self._value[:number], entry, *self._value[number + 1 :]))

    def _add(self) -> None:
        try:
            self._replace((*self._value, self._new_entry()))
        except ValueError as error:
            ui.notify(str(error), type="negative")

    def _remove(self, number: int) -> None:
        self._replace((*self._value[:number], *self._value[number + 1 :]))

    def _replace(self, value: tuple[Any, ...]) -> None:
        self._document.change(lambda: self._document.draft.set(**{self.name: value}))
        self._draw()

    def _new_entry(self) -> Any:
        """Returns an entry for the end of the list.

        Raises:
            ValueError: The product has no other one.
        """
        support = self._document.draft.support
        if self.name == "sync_settings":
            used = {entry.function for entry in self._value}
            function = next(
                (each for each in support.sync if each not in used), next(iter(support.sync))
            )
            return v.SyncSetting(function, support.sync[function][0])
        (data_id,) = (field for field in fields_of(self.name) if field.name == "data_id")
        used = {int(output.data_id) for output in self._value}
        for code in choices(self.name, data_id, support, None) or {}:
            if code not in used and code not in (v.CanDataId.ERROR, v.CanDataId.WARNING):
                return parse_can_configuration({code: None})[0]
        raise ValueError("all messages of the product are in the list")


def _with(entry: Any, values: Mapping[str, Any]) -> Any:
    return entry._replace(**values) if hasattr(entry, "_replace") else replace(entry, **values)


def _number(field: Field, value: float | None) -> int | float:
    """Returns a number that was entered.

    Raises:
        ValueError: It is none, or no whole one where the field has only those.
    """
    if value is None:
        raise ValueError(f"{label(field.name)}: enter a number")
    try:
        if field.kind is float:
            return float(converters.FLOAT64.read(value))
        return int(converters.INTEGER.read(int(value) if float(value).is_integer() else value))
    except ValueError as error:
        raise ValueError(f"{label(field.name)}: {error}") from None
