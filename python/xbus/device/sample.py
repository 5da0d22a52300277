"""A sample that has just arrived: one MTData2 or MTData message, decoded on access."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator, Mapping
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import numpy as np

from xbus import _core
from xbus.protocol.ids import MessageId
from xbus.protocol.keys import ByQuantity, EntryKey, Key, KeyIndex, QuantityKey, key_of
from xbus.protocol.tables import COLUMN_QUANTITIES, QUANTITIES, Quantity
from xbus.wire.codec import encode_frame
from xbus.wire.mtdata import decode_mtdata, mtdata_layout
from xbus.wire.struct import struct_of

__all__ = ["Sample"]


class Sample(Mapping[EntryKey, Any]):
    """One MTData2 or MTData message: a mapping from quantity to value, in the order of the message.

    Keys are those of a `Log`. A value is that of a row of the `Column`: a number for a scalar, an array
    ``(k,)`` for a vector, ``(3, 3)`` for the rotation matrix, a `Struct` for a struct. If a packet occurs
    twice, the last one counts. Packets that the tables do not explain are in `unknown`.

    Samples can be pickled. Two are equal if payload, bid, offset and arrival are.

    Attributes:
        payload: The bytes of the message.
        bid: Bus identifier.
        output: OutputMode and OutputSettings of MTData, the output of legacy devices; None for MTData2.
        offset: Byte offset at which its frame begins, counted from when the port was opened.
        time: Seconds on the device clock, unwrapped: the same as `Log.time` of the same bytes. NaN without a
            time stamp, or outside a session.
        leads: Whether it arrived when it was measured. Samples with data of the GNSS receiver or of a trigger
            arrive later.
        arrival: When its last byte arrived, in seconds on the clock of the link (`time.monotonic` for a
            port); None for a sample that did not arrive over a link.
        host_time: When it was measured, in seconds since 1970 on the clock of this computer, by a
            `HostClock`; NaN without a time stamp or a link.

    >>> sample = Sample(bytes.fromhex("1020 02 DFC5 4020 0C BEDC9AFA 3F549F37 411CBB70"))
    >>> sample["packet_counter"], sample["acceleration"].round(3).tolist()
    (57285, [-0.4309999942779541, 0.8309999704360962, 9.795999526977539])
    """

    __slots__ = (
        "__dict__",
        "_known_layout",
        "arrival",
        "bid",
        "host_time",
        "leads",
        "offset",
        "output",
        "payload",
        "time",
    )

    def __init__(
        self,
        payload: bytes,
        bid: int = 0xFF,
        offset: int = 0,
        output: tuple[int, int] | None = None,
    ) -> None:
        self.payload = payload
        self.output = output
        self.bid = bid
        self.offset = offset
        self.time = self.host_time = math.nan
        self.leads = False
        self.arrival: float | None = None
        self._known_layout: _Layout | None = None

    @classmethod
    def of(cls, received: _core.ReceivedSample) -> Sample:
        """Returns a sample that an acquisition has received."""
        sample = cls.__new__(cls)  # every attribute is set once: there may be thousands a second
        sample.payload, sample.bid, sample.offset = received.payload, received.bid, received.offset
        sample.time, sample.leads = received.time, received.leads
        sample.arrival, sample.host_time = received.arrival, received.host_time
        sample.output = received.output
        sample._known_layout = None
        return sample

    @property
    def _layout(self) -> _Layout:
        """Where the quantities are in the payload, found once."""
        if self._known_layout is None:
            self._known_layout = (
                _layout_of(_core.packet_headers(self.payload))
                if self.output is None
                else _mtdata_layout_of(*self.output)
            )
        return self._known_layout

    @cached_property
    def _mtdata(self) -> ByQuantity[Any] | None:
        """The values of MTData; None for MTData2."""
        return None if self.output is None else decode_mtdata(self.payload, *self.output)

    @cached_property
    def unknown(self) -> dict[int, bytes]:
        """Packets that the tables do not explain, by data identifier."""
        if self.output is not None:
            return {}
        return {
            packet.data_id: packet.numbers
            for packet in _core.packets(self.payload)
            if isinstance(packet.numbers, bytes)
        }

    @property
    def frame(self) -> bytes:
        """The frame of the message: `read_log` reads concatenated frames as a log."""
        mid = MessageId.MTData2 if self.output is None else MessageId.MTData
        return encode_frame(mid, self.payload, bid=self.bid)

    def __getitem__(self, key: Key) -> Any:
        place = self._place(key)
        if self._mtdata is not None:
            return self._mtdata[place.row.name]
        numbers = _core.packet_numbers(place.data_id, self.payload[place.start : place.end])
        row = place.row
        if row.fields:
            return struct_of(row, numbers)
        if not row.components:
            return numbers[0]
        values = numbers if isinstance(numbers, np.ndarray) else np.array(numbers, row.kind)
        return values.reshape(row.shape).T if row.is_matrix else values

    def _place(self, key: Key) -> _Place:
        places = self._layout.places
        if isinstance(key, str) and key in places:  # nearly always
            return places[key]
        return ByQuantity(self._layout.keys, places.values(), "sample")[key]

    def get(self, key: Key, /, default: Any = None) -> Any:
        """Returns the value, or ``default`` if ``key`` does not name exactly one quantity of the sample."""
        if key not in self:
            return default
        return self[key]

    def __contains__(self, key: object) -> bool:
        if isinstance(key, str):  # a name is listed, or names several entries or none
            return key in self._layout.places
        return key in ByQuantity(self._layout.keys, self._layout.places.values(), "sample")

    def __iter__(self) -> Iterator[EntryKey]:
        return iter(self._layout.places)

    def __len__(self) -> int:
        return len(self._layout.places)

    def data_id(self, key: Key) -> int:
        """Returns the data identifier of a quantity, as received.

        Raises:
            KeyError: The sample does not have the quantity.
        """
        return self._place(key).data_id

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Sample):
            return NotImplemented
        return (self.payload, self.output, self.bid, self.offset, self.arrival) == (
            other.payload,
            other.output,
            other.bid,
            other.offset,
            other.arrival,
        )

    __hash__ = None  # type: ignore[assignment]

    def __reduce__(self) -> tuple[Any, ...]:
        state = {name: getattr(self, name) for name in ("time", "leads", "arrival", "host_time")}
        return Sample, (self.payload, self.bid, self.offset, self.output), (None, state)

    def __repr__(self) -> str:
        return f"<Sample {', '.join(map(str, self)) or 'without known quantities'}>"


class _Place(NamedTuple):
    """Where a quantity is in a payload."""

    row: Quantity
    data_id: int
    start: int
    end: int


class _Layout(NamedTuple):
    """Where the quantities of a message are in its payload."""

    keys: KeyIndex
    places: dict[EntryKey, _Place]


@lru_cache(maxsize=64)
def _mtdata_layout_of(mode: int, settings: int) -> _Layout:
    """Returns the layout of an MTData message with these settings."""
    # An item that occurs twice counts once, with its last value.
    items = {item.data_id: item for item in mtdata_layout(mode, settings).items}.values()
    keys = KeyIndex(QuantityKey(item.name, item.coordinates, item.precision) for item in items)
    places = (
        _Place(COLUMN_QUANTITIES[item.name], item.data_id, item.start, item.start + item.size)
        for item in items
    )
    return _Layout(keys, dict(zip(keys.keys, places, strict=True)))


@lru_cache(maxsize=1024)
def _layout_of(headers: bytes) -> _Layout:
    """Returns the layout of a message with these packets: see `_core.packet_headers`.

    A device repeats a handful of layouts, so the result is cached.
    """
    found: dict[tuple[str, str | None], tuple[QuantityKey, _Place]] = {}
    start = 0
    for data_id, size, is_known in struct.iter_unpack(">HB?", headers):
        start += _core.PACKET_HEADER
        # A packet of a size that its identifier does not have is unknown.
        if is_known:
            key = key_of(data_id)
            place = _Place(QUANTITIES[key.name], data_id, start, start + size)
            found[key.name, key.coordinates] = key, place
        start += size
    keys = KeyIndex(key for key, _ in found.values())
    places = [place for _, place in found.values()]
    return _Layout(keys, dict(zip(keys.keys, places, strict=True)))
