"""The CAN messages of the 600-series, as the extension declares them, and their frames one at a time."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import Any, NamedTuple

from xbus import _core

__all__ = [
    "CAN_MESSAGES",
    "CanMessage",
    "CanSignal",
    "can_message",
    "can_messages",
    "frame_bits",
]

#: The exponents of DeltaV that are decoded; devices send 8 to 17.
MAX_EXPONENT = 30


class CanSignal(NamedTuple):
    """A number of a CAN message, big-endian.

    Attributes:
        name: Its name.
        type: numpy's type of the integer: ``"i2"``.
        per_unit: Counts in one ``unit``; 1 where the integer is the value.
        unit: Unit of the value; empty for counts, dates and bits.
        min: Lowest value that the vendor documents.
        max: Highest value that the vendor documents.
    """

    name: str
    type: str
    per_unit: int
    unit: str
    min: float
    max: float

    @property
    def size(self) -> int:
        """Number of bytes."""
        return int(self.type[1:])

    @property
    def is_signed(self) -> bool:
        """Whether it is two's complement."""
        return self.type.startswith("i")

    @property
    def limits(self) -> tuple[int, int]:
        """The lowest and highest integer."""
        bits = 8 * self.size
        return (-(1 << bits - 1), (1 << bits - 1) - 1) if self.is_signed else (0, (1 << bits) - 1)

    def count(self, value: float, per_unit: int | None = None) -> int:
        """Returns the integer for a value: rounded to the nearest one, and limited to the range of the type.

        Args:
            value: The value in ``unit``.
            per_unit: Counts in one unit, for a signal whose message has the exponent.

        >>> CAN_MESSAGES[0x34].signals[0].count(1000.0)
        32767
        """
        low, high = self.limits
        return min(max(round(value * (per_unit or self.per_unit)), low), high)


class CanMessage(NamedTuple):
    """A CAN message: a row of the vendor's document MT1604P.

    Attributes:
        code: Its code in the configuration (XCDI), and its default identifier.
        name: The vendor's name.
        kind: ``"numbers"``; ``"scaled"`` if the last byte is the exponent of the unit; ``"component"`` of a
            vector; ``"integer"``; ``"record"``; ``"utc"``; ``"event"`` of the device; ``"opaque"`` if no
            source gives the layout.
        quantity: The quantity that a log has of it, or None.
        signals: Its numbers, in the order of the bytes; none if it is opaque.
        size: Bytes of data.
        max_rate: Highest rate in Hz; None if it follows the group or is not documented.
        products: Numbers of the products that offer it.
    """

    code: int
    name: str
    kind: str
    quantity: str | None
    signals: tuple[CanSignal, ...]
    size: int
    max_rate: int | None
    products: tuple[int, ...]

    @property
    def _format(self) -> str:
        letters = {"u1": "B", "u2": "H", "u4": "I", "i2": "h", "i4": "i"}
        return ">" + "".join(letters[signal.type] for signal in self.signals)

    def decode(self, data: bytes) -> dict[str, int | float]:
        """Returns the values of the signals by name, in their units.

        Args:
            data: The data of a frame. Bytes behind the message are ignored.

        Raises:
            ValueError: Too few bytes, an exponent that is out of range, or a message without a known layout.

        >>> CAN_MESSAGES[0x34].decode(bytes.fromhex("0180FDC009CF"))
        {'x': 1.5, 'y': -2.25, 'z': 9.80859375}
        """
        self._check_layout()
        if len(data) < self.size:
            raise ValueError(f"{self.name} has {self.size} bytes, not {len(data)}")
        counts = struct.unpack_from(self._format, data)
        if self.kind == "scaled":
            *numbers, exponent = counts
            if exponent > MAX_EXPONENT:
                raise ValueError(
                    f"{self.name} has the exponent {exponent}; it is at most {MAX_EXPONENT}"
                )
            values = [number / (1 << exponent) for number in numbers] + [exponent]
        else:
            values = [
                count if signal.per_unit == 1 else count / signal.per_unit
                for count, signal in zip(counts, self.signals, strict=True)
            ]
        return {signal.name: value for signal, value in zip(self.signals, values, strict=True)}

    def encode(self, values: Mapping[str, float]) -> bytes:
        """Returns the data of a frame: each value is rounded to the nearest count, and limited to its range.

        Args:
            values: The values of all signals by name, in their units.

        Raises:
            ValueError: A signal is missing or not finite, or the message has no known layout.

        >>> CAN_MESSAGES[0x34].encode({"x": 1.5, "y": -2.25, "z": 9.80859375}).hex()
        '0180fdc009cf'
        """
        self._check_layout()
        names = [signal.name for signal in self.signals]
        if sorted(values) != sorted(names):
            raise ValueError(
                f"{self.name} has the signals {', '.join(names)}, not {', '.join(values)}"
            )
        per_unit = None
        if self.kind == "scaled":
            per_unit = 1 << min(max(round(values["exponent"]), 0), MAX_EXPONENT)
        try:
            counts = [
                signal.count(values[signal.name], None if signal.name == "exponent" else per_unit)
                for signal in self.signals
            ]
        except (ValueError, OverflowError) as error:
            raise ValueError(f"{self.name}: a value is not a finite number") from error
        return struct.pack(self._format, *counts)

    def _check_layout(self) -> None:
        if self.kind == "opaque":
            raise ValueError(f"no source gives the layout of {self.name}")


def _message(row: dict[str, Any]) -> CanMessage:
    signals = tuple(CanSignal(**signal) for signal in row["signals"])
    return CanMessage(**{**row, "signals": signals, "products": tuple(row["products"])})


#: All messages, by code.
CAN_MESSAGES = {message.code: message for message in map(_message, _core.can_messages())}


def _plain(name: str) -> str:
    return name.replace("_", "").lower()


#: All messages by name, and by the name of the quantity where that is one message; without "_" and capitals.
CAN_BY_NAME = {
    _plain(name): message
    for message in CAN_MESSAGES.values()
    for name in (message.name, message.quantity if message.kind != "component" else None)
    if name is not None
}


def can_message(name: str | int) -> CanMessage:
    """Returns a message.

    Args:
        name: The vendor's name (``"SampleTime"``), the name of the quantity (``"sample_time_fine"``), or the
            code.

    Raises:
        ValueError: No message has this name or code.

    >>> can_message("acceleration").code == can_message("Acceleration").code == 0x34
    True
    """
    message = CAN_MESSAGES.get(name) if isinstance(name, int) else CAN_BY_NAME.get(_plain(name))
    if message is None:
        shown = f"0x{name:02X}" if isinstance(name, int) else repr(name)
        names = ", ".join(message.name for message in CAN_MESSAGES.values())
        raise ValueError(f"no CAN message is called {shown}; choose from {names}")
    return message


def can_messages(name: str | int) -> tuple[CanMessage, ...]:
    """Returns the messages of a quantity, which can be several, or the message of a name or code.

    Raises:
        ValueError: No quantity of CAN and no message has this name or code.

    >>> [message.name for message in can_messages("position_ecef")]
    ['PositionEcef_X', 'PositionEcef_Y', 'PositionEcef_Z']
    """
    found = tuple(message for message in CAN_MESSAGES.values() if message.quantity == name)
    return found or (can_message(name),)


def frame_bits(size: int, *, is_extended: bool) -> int:
    """Returns the most bits of a frame on the bus, with stuff bits and the space before the next frame.

    >>> frame_bits(8, is_extended=False), frame_bits(8, is_extended=True)
    (135, 160)
    """
    header, stuffed = (67, 53) if is_extended else (47, 33)
    return 8 * size + header + (stuffed + 8 * size) // 4
