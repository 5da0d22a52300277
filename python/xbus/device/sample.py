"""A sample that has just arrived: one MTData2 message, decoded on access."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from xbus import _core
from xbus.protocol.ids import MessageId
from xbus.protocol.keys import ByQuantity, EntryKey, Key, KeyIndex, QuantityKey, key_of
from xbus.protocol.tables import QUANTITIES
from xbus.wire.codec import encode_frame
from xbus.wire.struct import struct_of

__all__ = ["Sample"]

#: The numpy type that holds each precision exactly; integers have their own type.
_REALS = {"Float32": np.float32, "Fp1220": np.float64, "Fp1632": np.float64, "Float64": np.float64}


class Sample(Mapping[EntryKey, Any]):
    """One MTData2 message: a mapping from quantity to value, in the order of its packets.

    Keys are those of a `Log`. A value is that of a row of the `Column`: a number for a scalar, an array
    ``(k,)`` for a vector, ``(3, 3)`` for the rotation matrix, a `Struct` for a struct. If a packet occurs
    twice, the last one counts. Packets that the tables do not explain are in `unknown`.

    Samples can be pickled. Two are equal if payload, bid, offset and arrival are.

    Attributes:
        payload: The bytes of the message.
        bid: Bus identifier.
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
        "_index",
        "_packets",
        "arrival",
        "bid",
        "host_time",
        "leads",
        "offset",
        "payload",
        "time",
    )
    #: Set by `_decode`.
    _index: KeyIndex

    def __init__(self, payload: bytes, bid: int = 0xFF, offset: int = 0) -> None:
        self.payload = payload
        self.bid = bid
        self.offset = offset
        self.time = self.host_time = math.nan
        self.leads = False
        self.arrival: float | None = None
        self._packets: dict[EntryKey, _core.Packet] | None = None

    @classmethod
    def of(cls, received: _core.ReceivedSample) -> Sample:
        """Returns a sample that an acquisition has received."""
        sample = cls(received.payload, received.bid, received.offset)
        sample.time, sample.leads = received.time, received.leads
        sample.arrival, sample.host_time = received.arrival, received.host_time
        return sample

    def _decode(self) -> dict[EntryKey, _core.Packet]:
        """Returns the packets by key, decoded once."""
        if self._packets is None:
            packets = _core.packets(self.payload)
            # Name or not: a packet of a size that its identifier does not have is unknown.
            self._index, places = _layout(
                tuple([None if packet.name is None else packet.data_id for packet in packets])
            )
            self._packets = dict(
                zip(self._index.keys, [packets[place] for place in places], strict=True)
            )
        return self._packets

    def _by_quantity(self) -> ByQuantity[_core.Packet]:
        """Returns the packets by every kind of key. Making it costs more than a look-up by a listed key."""
        packets = self._decode().values()
        return ByQuantity(self._index, packets, "sample")

    @cached_property
    def unknown(self) -> dict[int, bytes]:
        """Packets that the tables do not explain, by data identifier."""
        return {
            packet.data_id: packet.numbers
            for packet in _core.packets(self.payload)
            if isinstance(packet.numbers, bytes)
        }

    @property
    def frame(self) -> bytes:
        """The frame of the message: `read_log` reads concatenated frames as a log."""
        return encode_frame(MessageId.MTData2, self.payload, bid=self.bid)

    def __getitem__(self, key: Key) -> Any:
        packets = self._decode()
        if isinstance(key, str) and key in packets:  # nearly always
            return _value(packets[key])
        return _value(self._by_quantity()[key])

    def get(self, key: Key, /, default: Any = None) -> Any:
        """Returns the value, or ``default`` if ``key`` does not name exactly one quantity of the sample."""
        if key not in self:
            return default
        return self[key]

    def __contains__(self, key: object) -> bool:
        if isinstance(key, str):  # a name is listed, or names several entries or none
            return key in self._decode()
        return key in self._by_quantity()

    def __iter__(self) -> Iterator[EntryKey]:
        return iter(self._decode())

    def __len__(self) -> int:
        return len(self._decode())

    def data_id(self, key: Key) -> int:
        """Returns the data identifier of a quantity, as received.

        Raises:
            KeyError: The sample does not have the quantity.
        """
        return self._by_quantity()[key].data_id

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Sample):
            return NotImplemented
        return (self.payload, self.bid, self.offset, self.arrival) == (
            other.payload,
            other.bid,
            other.offset,
            other.arrival,
        )

    __hash__ = None  # type: ignore[assignment]

    def __reduce__(self) -> tuple[Any, ...]:
        state = {name: getattr(self, name) for name in ("time", "leads", "arrival", "host_time")}
        return Sample, (self.payload, self.bid, self.offset), (None, state)

    def __repr__(self) -> str:
        return f"<Sample {', '.join(map(str, self)) or 'without known quantities'}>"


@lru_cache(maxsize=256)
def _layout(data_ids: tuple[int | None, ...]) -> tuple[KeyIndex, tuple[int, ...]]:
    """Returns the keys of a message with these packets, and the place of the packet of each key.

    A device repeats a handful of layouts, so the result is cached.

    Args:
        data_ids: The data identifier of each packet, None for one that the tables do not explain.
    """
    places: dict[tuple[str, str | None], tuple[QuantityKey, int]] = {}
    for place, data_id in enumerate(data_ids):
        if data_id is not None:
            key = key_of(data_id)
            places[key.name, key.coordinates] = key, place
    return KeyIndex(key for key, _ in places.values()), tuple(place for _, place in places.values())


def _value(packet: _core.Packet) -> Any:
    row, numbers = QUANTITIES[packet.name or ""], packet.numbers
    if row.fields:
        return struct_of(row, numbers)
    if not row.components:
        return numbers[0]
    values = np.array(numbers, _REALS[packet.precision] if packet.precision else row.kind)
    return values.reshape(row.shape).T if row.is_matrix else values
