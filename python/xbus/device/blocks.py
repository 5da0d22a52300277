"""Samples as they come, in blocks of columns."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable

from xbus import _core
from xbus.codec import LONGEST_LIVE, encode_frame
from xbus.device.channel import Channel
from xbus.ids import MessageId
from xbus.log import Log
from xbus.protocol.messages import encode
from xbus.source import Key, wishes

__all__ = ["Blocks"]


class Blocks:
    """Samples as they come, in blocks: an iterator, also for ``async for``. See `Device.blocks`."""

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
            raise TypeError("a block is told by its seconds or by its samples: name one of them")
        if (seconds or samples or 0) <= 0:
            raise ValueError(f"a block must have more than {seconds or samples or 0}")
        self._channel, self._seconds, self._samples = channel, seconds, samples
        self._timeout = timeout
        self._wanted = wishes(quantities)
        self._decoder = _core.Decoder(LONGEST_LIVE, self._wanted)
        if device_id is not None:
            # When the fine time wraps depends on the family of the device.
            self._decoder.feed(encode_frame(MessageId.DeviceID, encode("DeviceID", device_id)))
            self._decoder.take()

    def __iter__(self) -> Blocks:
        return self

    def __next__(self) -> Log:
        if self._seconds is not None:
            self._channel.wait_for(lambda: False, self._seconds)
        self._channel.wait_for_samples(self._samples or 1, self._timeout)
        waiting = self._channel.samples
        count = len(waiting) if self._samples is None else self._samples
        self._decoder.feed(b"".join([waiting.popleft().frame for _ in range(count)]))
        return Log(self._decoder.take(), wanted=self._wanted)

    def __aiter__(self) -> Blocks:
        return self

    async def __anext__(self) -> Log:
        return await asyncio.to_thread(self.__next__)
