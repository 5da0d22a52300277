"""The protocol's tables, as the extension declares them: the single source of names and numbers."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Any, NamedTuple

from xbus import _core
from xbus._core import device_of

__all__ = [
    "CAN_QUANTITIES",
    "COLUMN_QUANTITIES",
    "LATE",
    "LEGACY_PRODUCTS",
    "MASTER",
    "MESSAGES",
    "MTDATA_QUANTITIES",
    "PREAMBLE",
    "PRODUCTS",
    "QUANTITIES",
    "RECEIVER",
    "RESULT_CODES",
    "STATUS_FLAGS",
    "UTC_SOURCES",
    "UTC_VALID",
    "Field",
    "MessageField",
    "MessageRow",
    "Product",
    "Quantity",
    "StatusFlag",
    "device_of",
    "message_name",
]


#: The bits of a data identifier that name precision and coordinates (Table 17).
FORMAT_BITS = 0xF


class Field(NamedTuple):
    """A field of a struct quantity.

    Attributes:
        name: The manual's name.
        type: numpy's type of the raw integer: ``"u4"``.
        scale: Value of one count in ``unit``.
        unit: SI unit or degrees; empty for counts, dates and bits.
        missing: The integer for "not provided", or None.
    """

    name: str
    type: str
    scale: float
    unit: str
    missing: int | None

    @property
    def per_unit(self) -> int:
        """Counts in one ``unit``."""
        return round(1 / self.scale)

    def scaled(self, raw: Any) -> Any:
        """Returns raw integers in ``unit``; NaN for those that mean "not provided".

        Args:
            raw: An integer, or a numpy array of them.

        Returns:
            A float, or float64 of the same shape; the integers themselves if one count is worth 1.

        >>> lat = {field.name: field for field in QUANTITIES["gnss_pvt_data"].fields}["lat"]
        >>> lat.scaled(522404917)
        52.2404917
        """
        if self.scale == 1:
            return raw
        # A power of ten is exact as a divisor, not as a factor.
        values = raw / self.per_unit
        if self.missing is None:
            return values
        if getattr(raw, "ndim", 0) == 0:
            return math.nan if raw == self.missing else values
        values[raw == self.missing] = math.nan
        return values


class StatusFlag(NamedTuple):
    """A field of ``StatusWord`` (Table 27): its lowest bit and how many bits it has."""

    name: str
    bit: int
    width: int
    meaning: str

    def of(self, word: Any) -> Any:
        """Returns the value of the field in a word, or in an array of words.

        >>> STATUS_FLAGS["rtk_status"].of(0x1000_0081)
        2
        """
        return word >> self.bit & ((1 << self.width) - 1)

    @property
    def values(self) -> dict[int, str]:
        """The meaning of each value of a field of several bits; empty for one bit.

        >>> STATUS_FLAGS["filter_mode"].values
        {0: 'without GNSS', 1: 'coasting after its loss', 3: 'with GNSS'}
        """
        if self.width == 1:
            return {}
        meanings = re.findall(r"(\d) (.+?)(?=, \d |$)", self.meaning)
        return {int(value): meaning for value, meaning in meanings}


class Quantity(NamedTuple):
    """A data identifier: a row of the manual's Table 16.

    Attributes:
        id: Data identifier, its four format bits zero.
        name: Name in xbus.
        manual: Name in the manual.
        group: Group in Table 16.
        kind: ``"real"``, ``"struct"``, ``"list"``, ``"id"``, or numpy's type of an integer.
        numbers: Numbers in a packet, for reals and integers.
        size: Bytes in a packet; None if precision or a count changes it.
        components: Names of the numbers, in the order of the wire; empty for one number.
        fields: Fields of a struct, or of the head of a list.
        entry: Fields of the entries of a list.
        unit: Unit of the numbers.
        is_matrix: Whether the numbers are a matrix of 3 by 3, column by column.
        axes: The axes that its numbers refer to: ``"sensor"``, ``"local"``, ``"sensor to local"`` for a
            rotation between the two, ``"earth"``, or None.
        interpolation: How a value between two samples follows from them: ``"linear"``; ``"angle"``, linear in
            degrees that wrap; ``"rotation"``, at a constant rate about a fixed axis; ``"previous"``; or None
            for counters, time stamps, events and changes over one sampling period.
        coordinates: Whether the identifier names a coordinate system.
        clock: Its role in the clock: ``"counter"``, ``"fine"`` or ``"coarse"`` time; ``"trigger"`` or
            ``"receiver"`` if its samples arrive late; or None.
        has_flags: Whether its integer has the bits of `STATUS_FLAGS`.
        products: Numbers of the products that offer it.
        source: Document that describes the layout.
    """

    id: int
    name: str
    manual: str
    group: str
    kind: str
    numbers: int
    size: int | None
    components: tuple[str, ...]
    fields: tuple[Field, ...]
    entry: tuple[Field, ...]
    unit: str
    is_matrix: bool
    axes: str | None
    interpolation: str | None
    coordinates: bool
    clock: str | None
    has_flags: bool
    products: tuple[int, ...]
    source: str

    @classmethod
    def of(cls, data_id: int) -> Quantity | None:
        """Returns the quantity of a data identifier, whatever its format bits; None for an unknown one.

        >>> Quantity.of(0x2016).name
        'quaternion'
        """
        return _BY_ID.get(data_id & ~FORMAT_BITS)

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the numbers of one packet: ``()``, ``(k,)``, or ``(3, 3)`` for a matrix."""
        if self.is_matrix:
            return 3, 3
        return (self.numbers,) if self.components else ()

    @property
    def flags(self) -> tuple[StatusFlag, ...]:
        """The flags in its integer; empty if it has none."""
        bits = 8 * (self.size or 0) if self.has_flags else 0
        return tuple(flag for flag in STATUS_FLAGS.values() if flag.bit + flag.width <= bits)

    def fields_of(self, word: int) -> dict[str, int]:
        """Returns the values of the flags in a word, by name.

        >>> QUANTITIES["status_byte"].fields_of(0x83)["filter_valid"]
        1
        """
        return {flag.name: flag.of(word) for flag in self.flags}

    def scaled(self, record: Mapping[str, Any]) -> dict[str, Any]:
        """Returns the fields of a struct in their units, by name: see `Field.scaled`.

        Args:
            record: The raw integers by name.
        """
        return {field.name: field.scaled(record[field.name]) for field in self.fields}


class MessageField(NamedTuple):
    """A field of a message.

    Attributes:
        name: Its name.
        type: numpy's type of a number, ``"u4"``; ``"text"`` for ASCII, ``"bytes"`` for anything else.
        repeat: Numbers of this type, or bytes of a text.
        rest: Whether it takes the rest of the payload, at most ``repeat`` bytes.
        unit: Unit of a number, empty if it has none.
        note: Valid values, or the table of the manual that lists them.
    """

    name: str
    type: str
    repeat: int
    rest: bool
    unit: str
    note: str


class MessageRow(NamedTuple):
    """A message: a row of the manual's section 5.3.

    Attributes:
        mid: Message identifier.
        name: The manual's name.
        direction: ``"to device"``, ``"to host"`` or ``"both"``.
        states: States in which it is valid: ``"wakeup"``, ``"config"``, ``"measurement"``.
        payload: Its payload, in words.
        lengths: The payload lengths it can have, or None if no source gives them. A message from the device
            has those of all messages with its MID.
        kind: ``"empty"``, ``"record"``, ``"list"``, ``"text"``, or ``"bytes"`` for bytes without a layout.
        forms: Fields of the records that it can be, the longest first; of a list, those of an entry.
        least: The fewest entries of a list, or characters of a text.
        most: The most of them.
        filled: Whether a text is filled with spaces to ``most`` bytes.
        zeros: Whether an empty list is written as one entry of zeros.
        restarts: Whether a device starts a new run with it: clock and counter may start again.
        reply: MID of the message that answers it, or None.
        products: Numbers of the products of the manual that support it.
        legacy: Names of others that support it: products before the manual (`LEGACY_PRODUCTS`), and those
            whose earlier firmware sent MTData.
        status: Empty, ``"reserved"``, ``"deprecated"``, ``"obsolete"`` or ``"unlisted"``.
    """

    mid: int
    name: str
    direction: str
    states: tuple[str, ...]
    payload: str
    lengths: tuple[int, ...] | None
    kind: str
    forms: tuple[tuple[MessageField, ...], ...]
    least: int
    most: int
    filled: bool
    zeros: bool
    restarts: bool
    reply: int | None
    products: tuple[int, ...]
    legacy: tuple[str, ...]
    status: str


class Product(NamedTuple):
    """A product of the manual's section 3, or one before these.

    Attributes:
        number: The manual's number: 630. Legacy products have none: 0.
        name: The model: ``"MTi-630"``.
        title: The model and what it is.
        series: Its family: ``"600-series"``, or ``"legacy"``.
        kind: What it computes: ``"IMU"``, ``"VRU"``, ``"AHRS"`` or ``"GNSS/INS"``.
        id_size: Bytes of its device identifier.
        fine_wrap: Ticks of 0.1 ms after which SampleTimeFine starts again at zero.
    """

    number: int
    name: str
    title: str
    series: str
    kind: str
    id_size: int
    fine_wrap: int


def _tuples(row: dict[str, Any]) -> dict[str, Any]:
    return {key: tuple(value) if isinstance(value, list) else value for key, value in row.items()}


def _quantity(row: dict[str, Any]) -> Quantity:
    fields = {key: tuple(Field(**field) for field in row[key]) for key in ("fields", "entry")}
    return Quantity(**{**_tuples(row), **fields})


def _message(row: dict[str, Any]) -> MessageRow:
    forms = tuple(tuple(MessageField(**field) for field in form) for form in row["forms"])
    return MessageRow(**{**_tuples(row), "forms": forms})


#: All data identifiers, by name.
QUANTITIES = {row["name"]: _quantity(row) for row in _core.quantities()}
#: The quantities that only CAN has, by name. Their identifiers are those of columns, not of packets.
CAN_QUANTITIES = {row["name"]: _quantity(row) for row in _core.can_quantities()}
#: The quantities that only MTData has, by name. Their identifiers are those of columns, not of packets.
MTDATA_QUANTITIES = {row["name"]: _quantity(row) for row in _core.mtdata_quantities()}
#: The quantities that a log can have.
COLUMN_QUANTITIES = QUANTITIES | CAN_QUANTITIES | MTDATA_QUANTITIES
_BY_ID = {
    quantity.id: quantity
    for table in (QUANTITIES, MTDATA_QUANTITIES)
    for quantity in table.values()
}
#: Quantities of the GNSS receiver, whose samples come late, and without a fix with an arbitrary time.
RECEIVER = tuple(name for name, row in QUANTITIES.items() if row.clock == "receiver")
#: Quantities whose samples come later than they were taken.
LATE = tuple(name for name, row in QUANTITIES.items() if row.clock in ("receiver", "trigger"))
#: Quantities from which the UTC of samples is known.
UTC_SOURCES = ("utc_time", "gnss_pvt_data")
#: The bus identifier of a stand-alone device, which has 1 as well (section 5.1): see `device_of`.
MASTER = 0xFF
#: First byte of every frame (section 5.1).
PREAMBLE = 0xFA
#: All messages by name, in the order of their MIDs.
MESSAGES = {row["name"]: _message(row) for row in _core.messages()}


def message_name(mid: int, length: int) -> str:
    """Returns the manual's name of a message with a payload of this length, or the MID in hex if it has none.

    >>> message_name(0x19, 0), message_name(0x19, 1), message_name(0x08, 0)
    ('SetBaudrateAck', 'ReqBaudrateAck', '0x08')
    """
    return _core.message_name(mid, length) or f"0x{mid:02X}"


#: The products of the manual, by number.
PRODUCTS = {row["number"]: Product(**row) for row in _core.products()}
#: The products before those of the manual, which send MTData, by name.
LEGACY_PRODUCTS = {row["name"]: Product(**row) for row in _core.legacy_products()}
#: The fields of ``StatusWord`` by name, from bit 0.
STATUS_FLAGS = {row["name"]: StatusFlag(**row) for row in _core.status_flags()}
#: What the numbers in Error and Warning messages mean.
RESULT_CODES = dict(_core.result_codes())
#: The bits that mark date, time and UTC as valid (Tables 25 and 35). Higher bits may also be set.
UTC_VALID = _core.UTC_VALID
