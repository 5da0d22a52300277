"""Samples as they come, in blocks of columns."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from xbus import _core
from xbus.codec import LONGEST_LIVE, encode_frame
from xbus.device.channel import Channel
from xbus.ids import MessageId
from xbus.log import Log
from xbus.protocol.messages import encode
from xbus.source import Key, wishes

__all__ = ["blocks"]


def blocks(
    channel: Channel,
    device_id: int | None,
    *,
    seconds: float | None,
    samples: int | None,
    quantities: Iterable[Key] | None,
    timeout: float,
) -> Iterator[Log]:
    """See `Device.blocks`."""
    if (seconds is None) == (samples is None):
        raise TypeError("a block is told by its seconds or by its samples: name one of them")
    if (seconds or samples or 0) <= 0:
        raise ValueError(f"a block must have more than {seconds or samples or 0}")
    wanted = wishes(quantities)
    decoder = _core.Decoder(LONGEST_LIVE, wanted)
    if device_id is not None:
        # When the fine time wraps depends on the family of the device.
        decoder.feed(encode_frame(MessageId.DeviceID, encode("DeviceID", device_id)))
        decoder.take()

    def gathered() -> Iterator[Log]:
        while True:
            if seconds is not None:
                channel.wait_for(lambda: False, seconds)
            channel.wait_for_samples(samples or 1, timeout)
            count = len(channel.samples) if samples is None else samples
            frames = [channel.samples.popleft().frame for _ in range(count)]
            decoder.feed(b"".join(frames))
            yield Log(decoder.take(), wanted=wanted)

    return gathered()
