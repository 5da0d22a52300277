"""A sample that has just arrived on a CAN bus."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property
from typing import Any

from xbus import _core
from xbus.device.sample import Sample
from xbus.log.column import Column
from xbus.log.log import Log
from xbus.protocol.can import CAN_MESSAGES
from xbus.protocol.keys import EntryKey, Key
from xbus.protocol.tables import COLUMN_QUANTITIES
from xbus.wire.struct import struct_of

__all__ = ["CanSample"]

#: Bytes of a frame in the payload: the code of the message, and its data with padding.
FRAME_SIZE = 9


class CanSample(Sample):
    """The frames that a device sends on CAN for one sample instant: a mapping from quantity to value.

    Values are those of a row of the `Column` that `xbus.read_can` gives for the same frames. What differs
    from a `Sample` of a serial port:

    - `offset` is the index of the first frame on the bus, counted from when the bus was opened.
    - `arrival` and `host_time` are by the time stamp of the first frame.
    - `payload` has nine bytes for each frame; `frames` has them by message.

    >>> sample = CanSample(bytes.fromhex("05000003E800000000 340180FDC009CF0000"))
    >>> list(sample), sample["acceleration"].tolist()
    (['sample_time_fine', 'acceleration'], [1.5, -2.25, 9.80859375])
    >>> {name: data.hex() for name, data in sample.frames.items()}
    {'SampleTime': '000003e8', 'Acceleration': '0180fdc009cf'}
    """

    __slots__ = ()

    @property
    def frames(self) -> dict[str, bytes]:
        """The data of the frames by the name of the message."""
        rows = range(0, len(self.payload), FRAME_SIZE)
        found = [
            (CAN_MESSAGES[self.payload[at]], self.payload[at + 1 : at + FRAME_SIZE]) for at in rows
        ]
        return {row.name: data[: row.size] for row, data in found}

    @property
    def frame(self) -> bytes:
        """Raises AttributeError: there is no Xbus frame."""
        raise AttributeError("a sample of CAN has no Xbus frame; frames has its CAN frames")

    @property
    def unknown(self) -> dict[int, bytes]:
        """Always empty: frames of unknown messages are in no sample."""
        return {}

    @cached_property
    def _log(self) -> Log:
        return Log(_core.can_sample(self.payload, self.bid, self.offset))

    def __getitem__(self, key: Key) -> Any:
        column: Column = self._log[key]
        value = column.values[0]
        row = COLUMN_QUANTITIES[column.name]
        if row.fields:
            return struct_of(row, value.item())
        return value if row.components else value.item()

    def __contains__(self, key: object) -> bool:
        return key in self._log

    def __iter__(self) -> Iterator[EntryKey]:
        return iter(self._log)

    def __len__(self) -> int:
        return len(self._log)

    def data_id(self, key: Key) -> int:
        """Returns the data identifier that a packet of Xbus with the same values would have.

        Raises:
            KeyError: The sample does not have the quantity.
        """
        return int(self._log[key].data_id)

    def __reduce__(self) -> tuple[Any, ...]:
        _, arguments, state = super().__reduce__()
        return CanSample, arguments, state
