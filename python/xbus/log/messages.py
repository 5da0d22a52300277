"""The messages of a log that are not samples, and the packets that the tables do not know."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from functools import cached_property
from typing import overload

import numpy as np
import numpy.typing as npt

from xbus import _core
from xbus.protocol.tables import message_name
from xbus.wire.message import Message

__all__ = ["Messages", "Unknown"]


class Messages(Sequence[Message]):
    """The messages of a log that are no samples, in order; each is made when it is asked for.

    Attributes:
        mid, bid, offset, sample: Those of all messages, as arrays.
    """

    def __init__(self, core: _core.Part) -> None:
        self._core = messages = core.messages
        self.mid, self.bid = messages.mid, messages.bid
        self.offset, self.sample = messages.offset, messages.sample

    def __len__(self) -> int:
        return len(self.mid)

    @overload
    def __getitem__(self, index: int) -> Message: ...
    @overload
    def __getitem__(self, index: slice) -> list[Message]: ...
    def __getitem__(self, index: int | slice) -> Message | list[Message]:
        if isinstance(index, slice):
            return [self[it] for it in range(*index.indices(len(self)))]
        at = range(len(self))[index]
        mid = int(self.mid[at])
        payload = _piece(self._core.payloads, self._core.ends, at)
        name = message_name(mid, len(payload))
        bid, offset, sample = int(self.bid[at]), int(self.offset[at]), int(self.sample[at])
        return Message(mid, name, bid, payload, offset, sample)

    def named(self, *names: str) -> list[Message]:
        """The messages with one of these names."""
        return [it for it in self if it.name in names]

    def __repr__(self) -> str:
        # One MID has several names, by the length of the payload.
        lengths = np.diff(self._core.ends, prepend=np.uint64(0))
        kinds, counts = np.unique(np.stack([self.mid, lengths]), axis=1, return_counts=True)
        by_name: Counter[str] = Counter()
        for mid, length, count in zip(*kinds.tolist(), counts.tolist(), strict=True):
            by_name[message_name(mid, length)] += count
        names = ", ".join(f"{name}: {count}" for name, count in by_name.items())
        return f"<Messages {len(self)}: {names}>"


class Unknown(Sequence[bytes]):
    """The packets of one data identifier that the tables cannot explain, verbatim.

    Attributes:
        sample: Which sample each belongs to, int64.
    """

    def __init__(self, core: _core.Column) -> None:
        assert core.ends is not None  # noqa: S101 - raw packets have ends
        self._core = core
        self._ends = core.ends
        self._bytes = core.values

    @cached_property
    def sample(self) -> npt.NDArray[np.int64]:
        """Which sample each belongs to, int64."""
        # Looks at every sample, and a hostile log can hold thousands of identifiers.
        return self._core.sample

    def __len__(self) -> int:
        return len(self._ends)

    @overload
    def __getitem__(self, index: int) -> bytes: ...
    @overload
    def __getitem__(self, index: slice) -> list[bytes]: ...
    def __getitem__(self, index: int | slice) -> bytes | list[bytes]:
        if isinstance(index, slice):
            return [self[it] for it in range(*index.indices(len(self)))]
        return _piece(self._bytes, self._ends, range(len(self))[index])

    def __repr__(self) -> str:
        return f"<Unknown {len(self)} packets, {len(self._bytes)} bytes>"


def _piece(data: npt.NDArray[np.uint8], ends: npt.NDArray[np.uint64], at: int) -> bytes:
    start = int(ends[at - 1]) if at else 0
    return data[start : int(ends[at])].tobytes()
