"""A sample that has just come: one MTData2 message, read when it is asked."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from functools import cached_property
from typing import Any

import numpy as np

from xbus import _core
from xbus.device.timing import Timing
from xbus.protocol.ids import MessageId
from xbus.protocol.keys import Key
from xbus.protocol.tables import QUANTITIES
from xbus.wire.codec import encode_frame

__all__ = ["Sample"]

#: Reals have in numpy what loses nothing; integers their own type.
_REALS = {"Float32": np.float32, "Fp1220": np.float64, "Fp1632": np.float64, "Float64": np.float64}


class Sample(Mapping[Key, Any]):
    """One MTData2 message: quantities by name, in the order in which they stand in it.

    The keys and values are those of a `Log` and of a row of its columns: a number for a scalar, an array
    ``(k,)`` for a vector, ``(3, 3)`` for the rotation matrix, a dict of the manual's fields with raw
    integers for a struct. Where a packet comes twice the last one counts. Identifiers that no table
    explains are in `unknown`.

    Attributes:
        payload: The bytes of the message.
        bid: Bus identifier.
        offset: Where its frame begins, in bytes since the port was opened.
        arrival: When its last byte came, seconds on the clock of the link (`time.monotonic` for a port); None
            for one that did not come over a link.

    >>> sample = Sample(bytes.fromhex("1020 02 DFC5 4020 0C BEDC9AFA 3F549F37 411CBB70"))
    >>> sample["packet_counter"], sample["acceleration"].tolist()
    (57285, [-0.4308698773384094, 0.8305544257164001, 9.795761108398438])
    """

    __slots__ = ("__dict__", "arrival", "bid", "offset", "payload", "timing")

    def __init__(self, payload: bytes, bid: int = 0xFF, offset: int = 0) -> None:
        self.payload = payload
        self.bid = bid
        self.offset = offset
        self.arrival: float | None = None
        self.timing: Timing | None = None

    @cached_property
    def _times(self) -> tuple[float, float]:
        return (math.nan, math.nan) if self.timing is None else self.timing.of(self)

    @property
    def time(self) -> float:
        """Seconds on the device's clock, unwrapped; NaN where it carries none, or did not come over a link.

        This and `host_time` go by the samples before: ask for them in the order in which the samples came.
        """
        return self._times[0]

    @property
    def host_time(self) -> float:
        """The same instant on this computer's clock, seconds since 1970, by a `HostClock`; or NaN."""
        return self._times[1]

    @cached_property
    def _packets(self) -> dict[Key, _core.Packet]:
        found: dict[tuple[str, str | None], _core.Packet] = {}
        for packet in _core.packets(self.payload):
            if (name := packet.name) is not None:
                found[name, packet.coordinates] = packet
        names = [name for name, _ in found]
        return {
            (name, system) if system and names.count(name) > 1 else name: packet
            for (name, system), packet in found.items()
        }

    @cached_property
    def unknown(self) -> dict[int, bytes]:
        """Packets that the tables cannot explain, by data identifier."""
        return {
            packet.data_id: packet.numbers
            for packet in _core.packets(self.payload)
            if isinstance(packet.numbers, bytes)
        }

    @property
    def frame(self) -> bytes:
        """The bytes that `read_log` reads: samples joined are a log of them."""
        return encode_frame(MessageId.MTData2, self.payload, bid=self.bid)

    def __getitem__(self, key: Key) -> Any:
        packets = self._packets
        if key in packets:
            return _value(packets[key])
        if isinstance(key, tuple):
            packet = packets.get(key[0])
            if packet is not None and packet.coordinates == key[1]:
                return _value(packet)
        several = [it for it in packets if isinstance(it, tuple) and it[0] == key]
        if several:
            raise KeyError(
                f"{key!r} is in several coordinate systems: {' and '.join(map(str, several))}"
            )
        raise KeyError(
            f"the sample has no {key!r}; it has {', '.join(map(str, packets)) or 'nothing'}"
        )

    def __iter__(self) -> Iterator[Key]:
        return iter(self._packets)

    def __len__(self) -> int:
        return len(self._packets)

    def data_id(self, key: Key) -> int:
        """The data identifier, as it came, of a quantity."""
        return self._packets[key].data_id

    def __repr__(self) -> str:
        return f"<Sample {', '.join(map(str, self._packets)) or 'of nothing known'}>"


def _value(packet: _core.Packet) -> Any:
    numbers, precision = packet.numbers, packet.precision
    row = QUANTITIES[packet.name or ""]
    if row.kind in ("struct", "list"):
        head = dict(zip((it.name for it in row.fields), numbers, strict=False))
        if row.kind == "struct":
            return head
        fields, at = [it.name for it in row.entry], len(row.fields)
        entries = range(at, len(numbers), len(fields))
        head["satellites"] = [dict(zip(fields, numbers[it:], strict=False)) for it in entries]
        return head
    if not row.components:
        return numbers[0]
    values = np.array(numbers, _REALS[precision] if precision else row.kind)
    return values.reshape(3, 3).T if row.name == "rotation_matrix" else values
