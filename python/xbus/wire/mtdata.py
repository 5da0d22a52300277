"""MTData messages, one at a time.

A payload has no identifiers: OutputMode and OutputSettings decide which items it has, and in which form.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from xbus import _core
from xbus.protocol.ids import MessageId
from xbus.protocol.keys import ByQuantity, KeyIndex, QuantityKey
from xbus.protocol.tables import COLUMN_QUANTITIES, Quantity
from xbus.wire.codec import encode_frame, numbers_of
from xbus.wire.struct import struct_of

__all__ = ["MtDataLayout", "decode_mtdata", "encode_mtdata", "mtdata_layout", "value_of"]


class MtDataLayout(NamedTuple):
    """The layout of an MTData payload.

    Attributes:
        items: Its items in the order of the wire. Each has the attributes ``data_id``, the identifier of the
            same numbers in MTData2; ``name`` of its quantity; ``precision`` and ``coordinates``, names or
            None; ``start`` in the payload and ``size``, in bytes.
        size: Length of the payload, in bytes.
    """

    items: tuple[_core.MtDataPlace, ...]
    size: int

    @property
    def keys(self) -> KeyIndex:
        """The keys of the items."""
        return KeyIndex(
            QuantityKey(item.name, item.coordinates, item.precision) for item in self.items
        )


def mtdata_layout(output_mode: int, output_settings: int) -> MtDataLayout:
    """Returns the layout of MTData with these settings.

    Raises:
        OverflowError: ``output_mode`` does not fit 16 bits, or ``output_settings`` 32.
        ValueError: No source gives the layout of these settings.

    >>> layout = mtdata_layout(0x0004, 0x0000_0001)  # the factory settings
    >>> [(item.name, item.start, item.size) for item in layout.items], layout.size
    ([('quaternion', 0, 16), ('packet_counter', 16, 2)], 18)
    """
    items = tuple(_core.mtdata_layout(output_mode, output_settings))
    return MtDataLayout(items, sum(item.size for item in items))


def decode_mtdata(payload: bytes, output_mode: int, output_settings: int) -> ByQuantity[Any]:
    """Returns the values of an MTData payload by quantity, in the order of the wire.

    Keys and values are those of a `Sample`: a number, an array ``(k,)`` or ``(3, 3)``, or a `Struct`.
    Orientation and velocity are NED with bit 31 of the settings, and NWU without it. If settings select a
    quantity twice, as strap-down increments and calibrated data do with the magnetic field, the last value
    counts.

    Raises:
        OverflowError: As `mtdata_layout`.
        ValueError: As `mtdata_layout`, or the payload does not have the length of these settings.

    >>> values = decode_mtdata(bytes.fromhex("41280000 C1A20000 43338000 1234"), 0x0004, 0x0000_0005)
    >>> values["euler_angles"].tolist(), values["packet_counter"]
    ([10.5, -20.25, 179.5], 4660)
    """
    packets = _core.mtdata_packets(payload, output_mode, output_settings)
    last = {packet.data_id: packet for packet in packets}
    keys = (_key(packet) for packet in last.values())
    values = (value_of(packet) for packet in last.values())
    return ByQuantity(KeyIndex(keys), values, "message")


def encode_mtdata(
    values: Mapping[Any, Any], output_mode: int, output_settings: int, *, bid: int = 0xFF
) -> bytes:
    """Returns the frame of an MTData message.

    Args:
        values: The value of each quantity of `mtdata_layout`, by name; others are ignored. Values are those
            that `encode_packet` takes. The pressure is rounded to 2 Pa.
        output_mode: Which items the message has.
        output_settings: In which form.
        bid: Bus identifier.

    Raises:
        KeyError: The value of a quantity is missing.
        OverflowError: As `mtdata_layout`.
        ValueError: As `mtdata_layout`, the wrong number of numbers, an integer that does not fit, or a NaN in
            fixed point.

    >>> frame = encode_mtdata({"euler_angles": [10.5, -20.25, 179.5], "packet_counter": 4660}, 4, 5)
    >>> frame.hex().upper()
    'FAFF320E41280000C1A20000433380001234B9'
    """
    layout = mtdata_layout(output_mode, output_settings)
    missing = [item.name for item in layout.items if item.name not in values]
    if missing:
        raise KeyError(
            f"MTData with {output_mode:04X}:{output_settings:08X} needs {', '.join(missing)}"
        )
    if not layout.items:
        return encode_frame(MessageId.MTData, bid=bid)
    rows = [
        numbers_of(COLUMN_QUANTITIES[item.name], values[item.name])[None] for item in layout.items
    ]
    return _core.encode_mtdata(output_mode, output_settings, rows, bid).data


def value_of(packet: _core.Packet) -> Any:
    """Returns the value of an item of `_core.mtdata_packets`: a number, an array or a `Struct`."""
    row, numbers = _row(packet), packet.numbers
    if row.fields:
        return struct_of(row, numbers)
    if not row.components:
        return numbers[0]
    kind = ("f4" if packet.precision == "Float32" else "f8") if packet.precision else row.kind
    values = np.array(numbers, kind).reshape(row.shape)
    return values.T if row.is_matrix else values


def _row(packet: _core.Packet) -> Quantity:
    assert packet.name is not None  # noqa: S101 - every item has a quantity
    return COLUMN_QUANTITIES[packet.name]


def _key(packet: _core.Packet) -> QuantityKey:
    return QuantityKey(_row(packet).name, packet.coordinates, packet.precision)
