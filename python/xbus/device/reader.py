"""Reads what a device measures: takes samples and strings, and waits for them."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import NoReturn

from xbus import _core
from xbus.device.can_sample import CanSample
from xbus.device.channel import Channel
from xbus.device.sample import Sample
from xbus.device.stats import live_stats
from xbus.errors import StateError, XbusTimeout
from xbus.formatting import format_count
from xbus.protocol.undecoded import output_mids, undecoded_output
from xbus.protocol.values import State
from xbus.wire.strings import String, type_at

__all__ = ["Reader"]

#: Maximum number of threads that wait for an event loop, for one device.
ASYNC_WAITS = 16


class Reader:
    """Takes samples and strings from the queues of a channel's link. Any number of threads may read.

    Args:
        channel: The channel.
    """

    def __init__(self, channel: Channel) -> None:
        self._channel = channel
        self._sample = CanSample if channel.link.acquisition.is_can else Sample
        self._executor: ThreadPoolExecutor | None = None

    @property
    def _acquisition(self) -> _core.Acquisition:
        return self._channel.link.acquisition

    def take_sample(self) -> Sample | None:
        """Removes the oldest unread sample and returns it; None if all are read."""
        received = self._acquisition.take_sample()
        return None if received is None else self._sample.of(received)

    def take_string(self) -> String | None:
        """Removes the oldest unread string and returns it; None if all are read."""
        received = self._acquisition.take_string()
        if received is None:
            return None
        kind = type_at(received.place)
        return String(kind, received.data, received.offset, arrival=received.arrival)

    def wait_for_samples(
        self, count: int, timeout: float, cancel: _core.Cancel | None = None
    ) -> None:
        """Waits until some samples are unread.

        Args:
            count: How many.
            timeout: Seconds to wait for each.
            cancel: Ends the wait.

        Raises:
            StateError: The device is in Config State, in which it sends no samples.
            ValueError: This number of samples does not fit into the queue.
            XbusTimeout: No sample came in time.
        """
        channel, acquisition = self._channel, self._acquisition
        began, dropped = channel.link.clock(), acquisition.waiting.dropped_samples
        if channel.session.state == State.MEASUREMENT and acquisition.ended is None:
            # Nearly always samples come, and nothing else. The rest of this method costs more than a sample.
            channel.link.wait(timeout, samples=count, events=channel.seen, cancel=cancel)
            if acquisition.waiting.samples >= count:
                return

        def is_over() -> bool:
            return (
                acquisition.waiting.samples >= count
                or channel.sends_no_data
                or channel.meets_unknown_mtdata
                or (count > 1 and acquisition.waiting.dropped_samples > dropped)
            )

        while True:
            arrived = max(began, acquisition.waiting.last_sample or began)
            left = max(0.0, arrived + timeout - channel.link.clock())
            if channel.wait_for(is_over, left, samples=count, cancel=cancel):
                if not channel.meets_unknown_mtdata or acquisition.waiting.samples >= count:
                    break
                channel.learn_mtdata()
                continue
            if cancel is not None and cancel.is_set:
                return
            if (acquisition.waiting.last_sample or began) <= arrived:
                self._refuse_silence("sample", timeout)
        if acquisition.waiting.samples >= count:
            return
        if channel.sends_no_data:
            self._refuse_config("read_sample")
        raise ValueError(
            f"{count} samples do not fit into the queue of {channel.link.name}; make blocks shorter, or"
            " increase queue_seconds of connect()"
        )

    def wait_for_strings(
        self, timeout: float, *, samples: bool = False, cancel: _core.Cancel | None = None
    ) -> None:
        """Waits until a string is unread.

        Args:
            timeout: Seconds to wait.
            samples: Whether an unread sample also ends the wait.
            cancel: Ends the wait.

        Raises:
            StateError: The device is in Config State, in which it sends no strings.
            XbusTimeout: No string came in time.
        """

        def has_data() -> bool:
            waiting = self._acquisition.waiting
            return bool(waiting.strings or (samples and waiting.samples))

        channel = self._channel

        def is_over() -> bool:
            return has_data() or channel.sends_no_data or (samples and channel.meets_unknown_mtdata)

        def wait() -> bool:
            need = 1 if samples else None
            return channel.wait_for(is_over, timeout, samples=need, strings=True, cancel=cancel)

        is_in_time = wait()
        if samples and channel.meets_unknown_mtdata and not has_data():
            channel.learn_mtdata()
            is_in_time = wait()
        if not is_in_time:
            if cancel is None or not cancel.is_set:
                self._refuse_silence("data" if samples else "string", timeout)
        elif not has_data():
            self._refuse_config("read_string")

    def _refuse_silence(self, what: str, timeout: float) -> NoReturn:
        link, waiting = self._channel.link, self._acquisition.waiting
        now = link.clock()
        stats = live_stats(self._acquisition.stats(now), self._channel.outdated)
        advice = ""
        if what == "sample" and waiting.strings:
            advice = "; the device sends strings, which read_string() returns"
        elif what == "string" and waiting.samples:
            advice = "; the device sends samples, which read_sample() returns"
        elif waiting.last_arrival is not None and now - waiting.last_arrival <= timeout:
            rates = stats.message_rates
            # No rate is known in the first half second.
            active = [mid for mid in stats.message_counts if rates.get(mid, math.inf) > 0]
            if mids := output_mids(active):
                advice = f"; the device sends {', '.join(map(undecoded_output, mids))}"
            elif stats.skipped_bytes and not (active or any(stats.rates.values())):
                count = format_count(stats.skipped_bytes, "byte")
                advice = f"; {count} without a message arrived: the baud rate may have changed"
        text = f"no {what} from {link.name} within {timeout:g} s{advice}"
        raise XbusTimeout(text, None, timeout)

    def _refuse_config(self, command: str) -> NoReturn:
        raise StateError(
            "the device is in Config State and sends no data; go_to_measurement() starts it",
            command,
            self._channel.session.state,
        )

    async def wait_async(self, wait: Callable[[_core.Cancel], object]) -> None:
        """Waits in a thread. A cancellation ends the wait at once."""
        if self._executor is None:
            self._executor = ThreadPoolExecutor(ASYNC_WAITS, thread_name_prefix="xbus-wait")
        loop, cancel = asyncio.get_running_loop(), _core.Cancel()
        # No thread waits for a device that was closed, here or in the parent process.
        self._channel.connection.refuse_closed(None)
        try:
            waited = loop.run_in_executor(self._executor, wait, cancel)
        except RuntimeError:
            self._channel.connection.refuse_closed(None)  # meanwhile, by another thread
            raise
        try:
            await waited
        finally:
            self._acquisition.cancel(cancel)

    def close(self) -> None:
        """Lets the threads that wait for event loops end. The connection must be closed before."""
        if self._executor is not None:
            self._executor.shutdown(wait=False)
