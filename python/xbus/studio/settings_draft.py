"""Settings that are being edited: the values of the device, the draft, and the differences."""

from __future__ import annotations

import difflib
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from xbus.device import Settings
from xbus.device.output_configuration import bytes_per_second, check_outputs_fit
from xbus.device.settings import Plan
from xbus.device.settings.table import SETTINGS
from xbus.protocol.products import Support
from xbus.protocol.values import Output
from xbus.wire.codec import data_id_of

__all__ = ["Draft"]

#: The place in `Draft.wrong` of the text as a whole.
TEXT = ""


class Draft:
    """Settings on a page.

    Args:
        settings: The settings that the device has.
        support: What its product supports.
        check: Returns what a device with the second settings would have to change to get the first ones.

    Attributes:
        device: The settings that the device has, as it sent them.
        support: What its product supports.
        text: The draft as TOML.
        wrong: What was entered and is no value, by name of the setting; by an empty name, of the text.
    """

    def __init__(
        self, settings: Settings, support: Support, check: Callable[[Settings, Settings], Plan]
    ) -> None:
        self.device, self.support, self._check = settings, support, check
        self.wrong: dict[str, str] = {}
        self._keep(settings)

    def _keep(self, settings: Settings, text: str | None = None) -> None:
        self._draft = settings
        self.text = settings.to_toml() if text is None else text
        self._plan = self._check(settings, self.device)

    @property
    def settings(self) -> Settings:
        """The draft; the last valid one while something that was entered is wrong."""
        return self._draft

    @property
    def problems(self) -> list[str]:
        """Why the draft cannot be applied, one sentence each; none if it can."""
        return [*self.wrong.values(), *self._plan.problems]

    @property
    def skipped(self) -> tuple[str, ...]:
        """What of a file for another product is left out, and why."""
        return self._plan.skipped

    def problems_of(self, name: str) -> list[str]:
        """Returns the problems of one setting."""
        return [
            problem
            for problem in self.problems
            if problem.partition(": ")[0].rpartition(", ")[2] == name
        ]

    def set(self, **values: Any) -> None:
        """Changes settings.

        Raises:
            ValueError: A value is wrong; nothing has changed.
        """
        settings = replace(self._draft, **values, lines={})
        for name in (*values, TEXT):
            self.wrong.pop(name, None)
        self._keep(settings)

    def enter(self, name: str, value: Callable[[], Any]) -> None:
        """Changes a setting to a value that a person enters; `wrong` says why, if there is none.

        Args:
            name: The setting.
            value: Returns the value, or raises ValueError.
        """
        try:
            self.set(**{name: value()})
        except ValueError as error:
            reason = str(error).removeprefix(f"{name}: ")
            self.wrong[name] = f"{name}: {reason}"

    def edit(self, text: str) -> None:
        """Replaces the text; `wrong` says what is wrong with it."""
        try:
            settings = Settings.from_toml(text)
        except ValueError as error:
            self.text, self.wrong = text, {TEXT: str(error)}
        else:
            self.wrong.clear()
            self._keep(settings, text)

    def load(self, settings: Settings) -> None:
        """Takes over the settings of a file; those that the file leaves out are those of the device."""
        self.wrong.clear()
        self._keep(replace(self.device, **_given(settings), lines={}))

    def revert(self) -> None:
        """Makes the draft what the device has."""
        self.wrong.clear()
        self._keep(self.device)

    def rebase(self, device: Settings) -> None:
        """Takes note of other settings of the device; what differed stays as it is in the draft."""
        changed = {name: getattr(self._draft, name) for name in self.names_that_differ}
        # Controls are drawn again; only a text that is wrong stays as it was entered.
        self.wrong = {name: why for name, why in self.wrong.items() if name == TEXT}
        self.device = device
        self._keep(replace(device, **changed), self.text if self.wrong else None)

    @property
    def names_that_differ(self) -> list[str]:
        """The settings of the draft that differ from those of the device."""
        return [change.name for change in self.device.diff(self._draft)]

    @property
    def differences(self) -> list[str]:
        """The lines that differ: ``-`` as the device has them, ``+`` as they will be."""
        present, wanted = (
            [line for line in text.splitlines() if line and line[0] != "#"]
            for text in (self.device.to_toml(), self._draft.to_toml())
        )
        lines = difflib.unified_diff(present, wanted, n=0, lineterm="")
        return [line for line in lines if line[:1] in "+-" and line[:3] not in ("---", "+++")]

    def output(self, name: str) -> Output | None:
        """Returns the output of a quantity in the draft; None if it is not sent."""
        outputs = self._draft.output_configuration or ()
        return next((output for output in outputs if output.quantity == name), None)

    def set_output(
        self, name: str, frequency: int | None, precision: str | None, coordinates: str | None
    ) -> None:
        """Changes, adds or removes the output of a quantity.

        Args:
            name: The quantity.
            frequency: Rate in Hz, or 0xFFFF for every message; None removes the output.
            precision: Such as ``"Float32"``; None if the quantity is not a real number.
            coordinates: Such as ``"ENU"``; None if the quantity has none.
        """
        outputs = list(self._draft.output_configuration or ())
        place = next(
            (i for i, output in enumerate(outputs) if output.quantity == name), len(outputs)
        )
        new = []
        if frequency is not None:
            key = tuple(part for part in (name, coordinates, precision) if part is not None)
            new = [Output(data_id_of(key), frequency)]
        outputs[place : place + 1] = new
        self.set(output_configuration=tuple(outputs))

    def line_load(self, baudrate: int | None) -> tuple[int, int | None]:
        """Returns the bytes per second of the outputs, and how many a line carries; None without one."""
        outputs = self._draft.output_configuration or ()
        return bytes_per_second(outputs, self.support), None if baudrate is None else baudrate // 10

    def overload(self, baudrate: int) -> str | None:
        """Returns why a line does not carry the outputs; None if it does."""
        try:
            check_outputs_fit(self._draft.output_configuration or (), self.support, baudrate)
        except ValueError as error:
            return str(error)
        return None


def _given(settings: Settings) -> dict[str, Any]:
    """Returns the settings that are not None, and the product."""
    values = {name: getattr(settings, name) for name in SETTINGS}
    given = {name: value for name, value in values.items() if value is not None}
    return given if settings.product is None else {"product": settings.product, **given}
