"""Settings that are being edited: the values of the device, the draft, and the differences."""

from __future__ import annotations

import difflib
from dataclasses import fields, replace
from typing import Any

from xbus.device import Settings
from xbus.device.output_configuration import bytes_per_second, check_outputs_fit
from xbus.protocol.products import Support
from xbus.protocol.values import Output
from xbus.wire.codec import data_id_of

__all__ = ["Draft"]


class Draft:
    """Settings on a page.

    Args:
        settings: The settings that the device has.
        support: What its product supports.

    Attributes:
        device: The settings that the device has, as it sent them.
        text: The draft as TOML.
        problem: Why the text is no settings; None if it is.
    """

    def __init__(self, settings: Settings, support: Support) -> None:
        self.device, self.support = settings, support
        self._draft = settings
        self.text = settings.to_toml()
        self.problem: str | None = None

    @property
    def settings(self) -> Settings:
        """The draft; the last valid one while the text is wrong."""
        return self._draft

    def set(self, **values: Any) -> None:
        """Changes settings.

        Raises:
            ValueError: A value is wrong; nothing has changed.
        """
        self._draft = replace(self._draft, **values)
        self.text, self.problem = self._draft.to_toml(), None

    def edit(self, text: str) -> None:
        """Replaces the text; `problem` says what is wrong with it."""
        self.text = text
        try:
            self._draft, self.problem = Settings.from_toml(text), None
        except ValueError as error:
            self.problem = str(error)

    def revert(self) -> None:
        """Makes the draft what the device has."""
        self._draft, self.text, self.problem = self.device, self.device.to_toml(), None

    @property
    def names_that_differ(self) -> list[str]:
        """The settings of the draft that differ from those of the device."""
        pairs = [
            (each.name, getattr(self._draft, each.name), getattr(self.device, each.name))
            for each in fields(Settings)
            if each.compare and each.name != "product"
        ]
        return [name for name, wanted, present in pairs if wanted is not None and wanted != present]

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

    def load(self, baudrate: int | None) -> tuple[int, int | None]:
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
