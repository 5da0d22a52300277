"""Live samples in blocks of columns."""

from __future__ import annotations

from collections.abc import Iterable

from xbus import _core
from xbus.device.channel import Channel
from xbus.device.reader import Reader
from xbus.log.arrivals import HostTimes
from xbus.log.hostclock import HostClock
from xbus.log.log import Log
from xbus.log.source import quantity_filter
from xbus.protocol.keys import Key

__all__ = ["Blocks"]


class Blocks:
    """An iterator over blocks of live samples, also for ``async for``. See `Device.blocks`."""

    def __init__(
        self,
        channel: Channel,
        reader: Reader,
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
        self._channel, self._reader = channel, reader
        self._seconds, self._samples = seconds, samples
        self._timeout = timeout
        self._filter = quantity_filter(quantities)
        self._decoder = channel.link.acquisition.block_decoder(self._filter)

    def __iter__(self) -> Blocks:
        return self

    def __next__(self) -> Log:
        while True:
            self._wait()
            if (block := self._take()) is not None:
                return block

    def __aiter__(self) -> Blocks:
        return self

    async def __anext__(self) -> Log:
        while True:
            await self._reader.wait_async(self._wait)
            # The samples are taken after the wait: one that is cancelled leaves them unread.
            if (block := self._take()) is not None:
                return block

    def _wait(self, cancel: _core.Cancel | None = None) -> None:
        """Waits until the next block is complete."""
        if self._seconds is None:
            self._reader.wait_for_samples(self._samples or 1, self._timeout, cancel)
            return
        # What had arrived before the port was lost is a block, too.
        self._channel.wait_for(self._has_last_data, self._seconds, cancel=cancel)
        self._reader.wait_for_strings(self._timeout, samples=True, cancel=cancel)

    def _has_last_data(self) -> bool:
        acquisition = self._channel.link.acquisition
        waiting = acquisition.waiting
        return acquisition.ended is not None and bool(waiting.samples or waiting.strings)

    def _take(self) -> Log | None:
        """Removes a block of samples and returns it; None if another reader was faster."""
        block = self._channel.link.acquisition.take_block(self._decoder, self._samples)
        if block is None or not (len(block.part) or len(block.string_time)):
            return None
        clocks = {bid: HostClock.of(clock) for bid, clock in block.clocks}
        host_times = HostTimes.known_already(block.part, block.host_time, clocks, block.string_time)
        return Log(block.part, quantities=self._filter, host_times=host_times)
