"""A recording between two times, as a file object that knows the host times of the whole recording."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt

from xbus import _core
from xbus.log.arrivals import Arrivals, HostTimes
from xbus.log.cutting import Parts, cut
from xbus.log.log import Log
from xbus.log.source import Readable
from xbus.protocol.tables import device_of

__all__ = ["CutSource"]

#: Bytes to read at a time if all are wanted.
PIECE = 1 << 20


class CutSource:
    """The bytes that `cut` yields.

    Args:
        source: The recording.
        parts: Reads the parts of the recording, as for `cut`.
        start: Seconds since the first sample.
        end: The same.
        bid: The only device, or None.
        arrivals: When the bytes of the recording arrived, or None.
        is_owned: Whether to close `source`.

    Attributes:
        size: Number of bytes so far.
    """

    def __init__(
        self,
        source: Readable,
        parts: Parts,
        start: float,
        end: float,
        *,
        bid: int | None = None,
        arrivals: Arrivals | None = None,
        is_owned: bool,
    ) -> None:
        self._owned: Any = source if is_owned else None
        self._arrivals = arrivals
        self._parts, self._device = parts, None if bid is None else device_of(bid)
        self._chunks = cut(source, self._read_parts, start, end, bid=bid, arrivals=arrivals)
        self._data = memoryview(b"")
        #: Host times of the parts of the recording in which samples of the cut can be.
        self._seen: list[HostTimes] = []
        #: Where ranges of bytes begin in the cut and in the recording, and the size of the cut so far.
        self._here: list[npt.NDArray[np.int64]] = []
        self._there: list[npt.NDArray[np.int64]] = []
        self.size = 0
        self._copy: BinaryIO | None = None

    def copy_to(self, file: BinaryIO) -> None:
        """Has all bytes that are read from now on written to a file too."""
        self._copy = file

    def __del__(self) -> None:
        if self._owned is not None:
            self._owned.close()

    def read(self, size: int = -1, /) -> bytes:
        """Returns at most ``size`` bytes; none at the end."""
        if size < 0:
            return b"".join(iter(lambda: self.read(PIECE), b""))
        while not self._data:
            if (chunk := next(self._chunks, None)) is None:
                break
            lengths = chunk.end - chunk.start
            if self._arrivals is not None and len(lengths):
                self._here.append(self.size + np.cumsum(lengths) - lengths)
                self._there.append(chunk.start)
            self.size += len(chunk.data)
            if self._copy is not None:
                self._copy.write(chunk.data)
            self._data = memoryview(chunk.data)
        data, self._data = self._data[:size], self._data[size:]
        return bytes(data)

    def _read_parts(self, source: Readable) -> Iterator[Log]:
        for part in self._parts(source):
            if self._arrivals is not None:
                if not self._here:  # the cut has not begun
                    self._seen.clear()
                if len(part):
                    self._seen.append(part._host_times)
            yield part

    def host_times(self, part: _core.Part) -> HostTimes:
        """Returns the host times of the next part of the cut, which are those in the whole recording."""
        arrivals = self._arrivals
        if arrivals is None:
            return HostTimes(part)
        here, there = (np.concatenate([[0], *starts]) for starts in (self._here, self._there))

        def in_recording(offsets: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
            at = np.searchsorted(here, offsets, "right") - 1
            return np.asarray(there[at] + offsets - here[at], np.int64)

        offsets = in_recording(part.offset)
        strings = part.strings
        ends = np.asarray(
            strings.offset + np.diff(strings.ends.astype(np.int64), prepend=0), np.int64
        )
        arrived = arrivals.of(in_recording(ends - 1) + 1)
        string_times = np.full(len(ends), np.nan)
        string_times[: len(arrived)] = arrived / 1e9
        if not len(offsets):
            return HostTimes.known_already(part, None, {}, string_times, arrivals.fault)
        while len(self._seen) > 1 and self._seen[1].part.offset[0] <= offsets[0]:
            del self._seen[0]
        known = np.concatenate([seen.part.offset for seen in self._seen])
        times = np.concatenate([seen.time for seen in self._seen])
        times = times[np.searchsorted(known, offsets)]
        last = [seen for seen in self._seen if seen.part.offset[0] <= offsets[-1]][-1]
        clocks = last.clocks_before(int(np.searchsorted(last.part.offset, offsets[-1])) + 1)
        if self._device is not None:
            clocks = {bid: clock for bid, clock in clocks.items() if bid == self._device}
        times_or_none = times if clocks else None
        return HostTimes.known_already(part, times_or_none, clocks, string_times, arrivals.fault)
