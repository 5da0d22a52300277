"""The messages of a log that are not samples, and the packets that the tables do not know."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import Any, overload

import numpy as np
import numpy.typing as npt

from xbus import _core
from xbus.log.arrays import identical, read_only
from xbus.protocol.tables import message_name
from xbus.wire.message import Message

__all__ = ["Messages", "Unknown"]


class Messages(Sequence[Message]):
    """The messages of a log that are not samples, in order. Each `Message` is made on access.

    Can be pickled; two are equal if all messages are.

    Attributes:
        mid: Message identifiers, ``(n,)`` uint8, read-only as all arrays here.
        bid: Bus identifiers, ``(n,)`` uint8.
        offset: Byte offsets in the input at which the frames begin, ``(n,)`` int64.
        sample: Index of the next sample after each message, ``(n,)`` int64.
    """

    def __init__(
        self,
        mid: npt.NDArray[np.uint8],
        bid: npt.NDArray[np.uint8],
        offset: npt.NDArray[np.int64],
        sample: npt.NDArray[np.int64],
        ends: npt.NDArray[np.uint64],
        payloads: npt.NDArray[np.uint8],
    ) -> None:
        self.mid, self.bid = read_only(mid), read_only(bid)
        self.offset, self.sample = read_only(offset), read_only(sample)
        self._ends, self._payloads = read_only(ends), read_only(payloads)

    def _arrays(self) -> tuple[npt.NDArray[Any], ...]:
        return self.mid, self.bid, self.offset, self.sample, self._ends, self._payloads

    def __len__(self) -> int:
        return len(self.mid)

    @overload
    def __getitem__(self, index: int) -> Message: ...
    @overload
    def __getitem__(self, index: slice) -> list[Message]: ...
    def __getitem__(self, index: int | slice) -> Message | list[Message]:
        if isinstance(index, slice):
            return [self[row] for row in range(*index.indices(len(self)))]
        row = range(len(self))[index]
        mid = int(self.mid[row])
        payload = piece(self._payloads, self._ends, row)
        name = message_name(mid, len(payload))
        bid, offset, sample = int(self.bid[row]), int(self.offset[row]), int(self.sample[row])
        return Message(mid, name, bid, payload, offset, sample)

    @property
    def length(self) -> npt.NDArray[np.int64]:
        """Payload bytes of each message, ``(n,)`` int64."""
        ends = self._ends.astype(np.int64)
        return read_only(ends - np.concatenate(([0], ends[:-1])))

    @property
    def counts(self) -> dict[str, int]:
        """Number of messages by name, in the order in which the names first occur."""
        # One MID has several names, by the length of the payload.
        key = self.mid.astype(np.int64) << 32 | self.length
        kinds, first, counts = np.unique(key, return_index=True, return_counts=True)
        order = np.argsort(first)
        by_name: Counter[str] = Counter()
        for kind, count in zip(kinds[order].tolist(), counts[order].tolist(), strict=True):
            by_name[message_name(kind >> 32, kind & 0xFFFFFFFF)] += count
        return dict(by_name)

    def payloads(self, rows: npt.NDArray[np.intp]) -> Iterator[bytes]:
        """Yields the payloads of messages by their indices."""
        for row in rows.tolist():
            yield piece(self._payloads, self._ends, row)

    def with_mids(self, *mids: int) -> Iterator[Message]:
        """Yields the messages with one of these message identifiers."""
        is_wanted = np.zeros(256, np.bool_)
        is_wanted[list(mids)] = True
        for row in np.flatnonzero(is_wanted[self.mid]).tolist():
            yield self[row]

    def named(self, *names: str) -> list[Message]:
        """Returns the messages with one of these names."""
        return [message for message in self if message.name in names]

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Messages):
            return NotImplemented
        return all(map(identical, self._arrays(), other._arrays()))

    __hash__ = None  # type: ignore[assignment]

    def __reduce__(self) -> tuple[Any, ...]:
        return Messages, self._arrays()

    def __repr__(self) -> str:
        names = ", ".join(f"{name}: {count}" for name, count in self.counts.items())
        return f"<Messages {len(self)}: {names}>" if names else "<Messages 0>"


class Unknown(Sequence[bytes]):
    """The packets of one data identifier that the tables do not explain, verbatim.

    Can be pickled; two are equal if all packets are.
    """

    def __init__(self, core: _core.Column) -> None:
        assert core.ends is not None  # noqa: S101 - raw packets have ends
        self._ends, self._bytes = core.ends, core.values
        self._core: _core.Column | None = core

    @cached_property
    def sample(self) -> npt.NDArray[np.int64]:
        """Index of the sample of each packet, ``(n,)`` int64, read-only."""
        assert self._core is not None  # noqa: S101 - only an unpickled one has none, and has this
        # Scans every sample, so not before it is asked for: a hostile log can have thousands of identifiers.
        return read_only(self._core.sample)

    def __len__(self) -> int:
        return len(self._ends)

    @overload
    def __getitem__(self, index: int) -> bytes: ...
    @overload
    def __getitem__(self, index: slice) -> list[bytes]: ...
    def __getitem__(self, index: int | slice) -> bytes | list[bytes]:
        if isinstance(index, slice):
            return [self[row] for row in range(*index.indices(len(self)))]
        return piece(self._bytes, self._ends, range(len(self))[index])

    @property
    def size(self) -> int:
        """Bytes of all packets."""
        return len(self._bytes)

    def _arrays(self) -> tuple[npt.NDArray[Any], ...]:
        return self._ends, self._bytes, self.sample

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Unknown):
            return NotImplemented
        return all(map(identical, self._arrays(), other._arrays()))

    __hash__ = None  # type: ignore[assignment]

    def __getstate__(self) -> dict[str, Any]:
        return {"_core": None, "_ends": self._ends, "_bytes": self._bytes, "sample": self.sample}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        for array in self._arrays():
            read_only(array)

    def __repr__(self) -> str:
        return f"<Unknown {len(self)} packets, {self.size} bytes>"


def piece(data: npt.NDArray[np.uint8], ends: npt.NDArray[np.uint64], index: int) -> bytes:
    """Returns one of several byte strings that are stored one after the other."""
    start = int(ends[index - 1]) if index else 0
    return data[start : int(ends[index])].tobytes()
