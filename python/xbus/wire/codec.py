"""Encodes frames and packets, and scans bytes for messages and strings."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from xbus import _core
from xbus.protocol.ids import Coordinates, MessageId, Precision
from xbus.protocol.keys import Key, resolve_key
from xbus.protocol.tables import Quantity, message_name
from xbus.protocol.values import StringType
from xbus.wire.message import Message
from xbus.wire.strings import String, mask_of, type_at

__all__ = [
    "Damage",
    "ScannedItem",
    "Scanner",
    "data_id_of",
    "encode_frame",
    "encode_packet",
    "encode_sample",
    "is_sample",
    "message_of",
    "named_item",
]

#: The MID of samples as a plain integer: comparing it with an enum costs more, and every frame is compared.
MTDATA2 = int(MessageId.MTData2)
#: The longest payload accepted from a live device, in bytes: the vendor limits frames to 8192 bytes.
LONGEST_LIVE = 8185


#: What the scanner of the core finds.
ScannedItem: TypeAlias = _core.ScannedFrame | _core.ScannedString | _core.ScannedDamage


class Damage(NamedTuple):
    """A range of bytes that is neither frame nor string.

    Attributes:
        offset: Byte offset in the input at which it begins.
        length: Number of bytes.
        reason: What was found at its beginning: see `Log.damage`.
    """

    offset: int
    length: int
    reason: str


class Scanner:
    """Finds messages and strings in bytes that are fed in pieces, however they are cut.

    Args:
        limit: Longest payload that a frame may have, in bytes.
        strings: String types without checksum and terminator to parse too: ``["EM1000"]``.

    Raises:
        ValueError: The limit is not from 0 to 65535, or no string type has a given name.

    >>> import xbus
    >>> scanner = xbus.Scanner()
    >>> frame = xbus.encode_frame(xbus.MessageId.GoToConfigAck)
    >>> scanner.feed(frame[:2]), [message.name for message in scanner.feed(frame[2:])]
    ([], ['GoToConfigAck'])
    """

    def __init__(
        self, limit: int = LONGEST_LIVE, *, strings: Iterable[StringType | str] = ()
    ) -> None:
        if not 0 <= limit <= 0xFFFF:
            raise ValueError(f"limit must be from 0 to 65535 bytes, not {limit}")
        self._core = _core.Scanner(limit, mask_of(strings))
        self._samples = 0

    def feed(self, data: bytes | bytearray | memoryview) -> list[Message | String | Damage]:
        """Returns everything that is complete with these bytes, in order."""
        return self._found(self._core.feed(bytes(data), last=False))

    def close(self) -> list[Message | String | Damage]:
        """Returns what is left at the end of the input."""
        return self._found(self._core.feed(b"", last=True))

    def _found(self, items: list[ScannedItem]) -> list[Message | String | Damage]:
        found = []
        for item in items:
            found.append(named_item(item, self._samples))
            self._samples += is_sample(item)
        return found


def is_sample(item: ScannedItem) -> bool:
    """Returns whether an item is an MTData2 message that its packets fill."""
    if not isinstance(item, _core.ScannedFrame) or item.mid != MTDATA2:
        return False
    return _core.is_sample(item.payload)


def message_of(frame: _core.ScannedFrame, sample: int = 0) -> Message:
    """Returns a frame that the scanner of the core has found, with the manual's name: see `named_item`."""
    name = message_name(frame.mid, len(frame.payload))
    return Message(frame.mid, name, frame.bid, frame.payload, frame.offset, sample)


def named_item(item: ScannedItem, sample: int = 0) -> Message | String | Damage:
    """Returns what the scanner of the core has found, with the names of the manual.

    Args:
        item: The frame, string or damage.
        sample: Index of the next sample.
    """
    if isinstance(item, _core.ScannedFrame):
        return message_of(item, sample)
    if isinstance(item, _core.ScannedString):
        return String(type_at(item.place), item.data, item.offset, sample)
    return Damage(item.offset, item.length, item.reason)


def encode_frame(mid: int, payload: bytes = b"", *, bid: int = 0xFF) -> bytes:
    """Returns the frame of a message (section 5.1), in its shortest form.

    Raises:
        ValueError: The payload has more than 65535 bytes.
        OverflowError: MID or BID does not fit a byte.

    >>> import xbus
    >>> xbus.encode_frame(xbus.MessageId.GoToConfig).hex(" ").upper()
    'FA FF 30 00 D1'
    """
    return _core.encode_frame(bid, mid, payload)


def encode_packet(key: Key, values: Any) -> bytes:
    """Returns one packet of an MTData2 message (section 5.3.6).

    Args:
        key: The quantity. The default precision is Float32, the default coordinate system ENU.
        values: A number, or the numbers of the quantity in the order of a column's row; a mapping or a
            structured row for a struct; (head, satellites) for ``gnss_sat_info``. Fixed-point numbers are
            rounded half away from zero, and saturate.

    Raises:
        TypeError: The key is not of a type that `Key` lists.
        ValueError: No such quantity, the wrong number of numbers, an integer that does not fit, or a
            NaN in fixed point.

    >>> import xbus
    >>> xbus.encode_packet(("temperature", "Fp1632"), 24.375).hex(" ").upper()
    '08 12 06 60 00 00 00 00 18'
    """
    name, coordinates, precision = resolved = resolve_key(key)
    return _core.encode_packet(name, precision, coordinates, numbers_of(resolved.quantity, values))


def encode_sample(
    packets: Mapping[Any, Any] | Iterable[tuple[Key, Any]], *, bid: int = 0xFF
) -> bytes:
    """Returns the frame of an MTData2 message with these packets, in this order.

    Raises:
        TypeError: As `encode_packet`.
        ValueError: As `encode_packet`.

    >>> import xbus
    >>> frame = xbus.encode_sample({"packet_counter": 57285, "acceleration": [0, 0, 9.81]})
    >>> float(xbus.read_log(frame)["acceleration"].values[0, 2])
    9.8100004196167
    """
    items = packets.items() if isinstance(packets, Mapping) else packets
    payload = b"".join(encode_packet(key, values) for key, values in items)
    return encode_frame(MessageId.MTData2, payload, bid=bid)


def data_id_of(key: Key) -> int:
    """Returns the data identifier, with format bits, that a key names.

    Raises:
        ValueError: No such quantity.

    >>> hex(data_id_of(("quaternion", "NED", "Fp1632")))
    '0x2016'
    """
    resolved = resolve_key(key)
    if isinstance(key, int):
        return int(key)
    precision, coordinates = resolved.precision or "Float32", resolved.coordinates or "ENU"
    return resolved.quantity.id | Precision[precision] | Coordinates[coordinates]


def numbers_of(quantity: Quantity, values: Any) -> npt.NDArray[Any]:
    """Returns the numbers in the order of the wire, in a type that holds them exactly."""
    if quantity.kind == "list":
        head, entries = values
        rows = [
            _record(quantity.fields, head),
            *(_record(quantity.entry, entry) for entry in entries),
        ]
        return np.concatenate(rows)
    if quantity.kind == "struct":
        return _record(quantity.fields, values)
    array = np.asarray(values)
    if quantity.is_matrix:
        if array.ndim == 1:
            array = array.reshape(quantity.shape)
        array = array.T  # column by column on the wire
    return _exact(array.reshape(-1))


def _record(fields: tuple[Any, ...], values: Any) -> npt.NDArray[Any]:
    names = [field.name for field in fields]
    if isinstance(values, Mapping):
        if set(values) != set(names):
            raise ValueError(f"a record needs exactly the fields {', '.join(names)}")
        return _exact(np.array([values[name] for name in names]))
    return _exact(np.array(values.item() if isinstance(values, np.void) else values))


def _exact(array: npt.NDArray[Any]) -> npt.NDArray[Any]:
    kind, size = array.dtype.kind, array.dtype.itemsize
    if kind == "f":
        return array.astype(np.float32 if size <= 4 else np.float64)
    if kind == "u" and size == 8:
        return array
    if kind in "iub":
        return array.astype(np.int64)
    raise ValueError(f"packets hold numbers, not {array.dtype}")
