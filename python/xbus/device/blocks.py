"""Live samples in blocks of columns."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Iterable

import numpy as np
import numpy.typing as npt

from xbus import _core
from xbus.device.channel import Channel
from xbus.device.sample import Sample
from xbus.log.arrivals import Arrivals, HostTimes
from xbus.log.hostclock import HostClock
from xbus.log.log import Log
from xbus.log.source import quantity_filter
from xbus.protocol.ids import MessageId
from xbus.protocol.keys import Key
from xbus.protocol.messages import encode
from xbus.protocol.values import StringType
from xbus.wire.codec import LONGEST_LIVE, encode_frame
from xbus.wire.strings import String, mask_of

__all__ = ["Blocks"]


class Blocks:
    """An iterator over blocks of live samples, also for ``async for``. See `Device.blocks`."""

    def __init__(
        self,
        channel: Channel,
        device_id: int | None,
        *,
        seconds: float | None,
        samples: int | None,
        quantities: Iterable[Key] | None,
        timeout: float,
    ) -> None:
        if (seconds is None) == (samples is None):
            raise TypeError("give the length of a block either in seconds or in samples")
        if (seconds or samples or 0) <= 0:
            raise ValueError(
                f"the length of a block must be positive, not {seconds or samples or 0}"
            )
        self._channel, self._seconds, self._samples = channel, seconds, samples
        self._timeout = timeout
        self._filter = quantity_filter(quantities)
        # The session has identified the strings, so all types are accepted.
        self._decoder = _core.Decoder(LONGEST_LIVE, self._filter, mask_of(StringType))
        self._clocks: dict[int, HostClock] = {}
        #: Bytes that the decoder has received.
        self._end = 0
        if device_id is not None:
            # The device determines when its fine time wraps.
            self._feed([encode_frame(MessageId.DeviceID, encode("DeviceID", device_id))])
            self._decoder.take()

    def _feed(self, frames: list[bytes]) -> npt.NDArray[np.int64]:
        """Feeds frames to the decoder, and returns the end of each in all bytes fed so far."""
        ends = self._end + np.cumsum([len(frame) for frame in frames])
        self._end = int(ends[-1])
        self._decoder.feed(b"".join(frames))
        return ends

    def __iter__(self) -> Blocks:
        return self

    def __next__(self) -> Log:
        channel = self._channel
        if self._seconds is not None:
            channel.wait_for(lambda: False, self._seconds)
            channel.wait_for_strings(self._timeout, samples=True)
        else:
            channel.wait_for_samples(self._samples or 1, self._timeout)
        waiting, strings = channel.samples, channel.strings
        available = len(strings)  # later ones belong to the next block
        count = len(waiting) if self._samples is None else self._samples
        taken: list[Sample | String] = [waiting.popleft() for _ in range(count)]
        # Also take the strings before the last sample of the block, or before the first of the next.
        bounded = taken if self._samples is not None else [*waiting][:1]
        until = bounded[-1].offset if bounded else math.inf
        while available and strings[0].offset < until:
            taken.append(strings.popleft())
            available -= 1
        if len(taken) > count:
            taken.sort(key=lambda item: item.offset)
        ends = self._feed([item.frame if isinstance(item, Sample) else item.data for item in taken])
        epoch = channel.link.epoch
        seconds = np.array([item.arrival or 0.0 for item in taken])
        arrivals = Arrivals(ends, np.rint(seconds * 1e9).astype(np.int64) + epoch)
        host_times = HostTimes(self._decoder.take(), arrivals, self._clocks)
        self._clocks = host_times.clocks
        return Log(host_times.part, quantities=self._filter, host_times=host_times)

    def __aiter__(self) -> Blocks:
        return self

    async def __anext__(self) -> Log:
        return await asyncio.to_thread(self.__next__)
