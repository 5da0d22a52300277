"""The lines of ``xbus dump``."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, NamedTuple

from xbus import _core
from xbus.cli.argument_options import with_argument_options
from xbus.cli.rate_use import RateUse
from xbus.describe.text import describe_message, describe_packet, message_dict, packet_dict
from xbus.log.source import LONGEST
from xbus.protocol.ids import DataId, MessageId
from xbus.protocol.mtdata import remedy_of_size
from xbus.protocol.tables import device_of
from xbus.wire.codec import Damage, ScannedItem, Scanner, encode_frame, named_item
from xbus.wire.message import Message
from xbus.wire.strings import String

__all__ = ["DumpFormatter"]

#: Bytes to keep for the hex: two of the longest frames, because a frame may be found only with the next one.
KEPT = 2 * (LONGEST + 7)


#: What is wrong with an MTData2 message that is no sample.
MALFORMED = "malformed: the packets do not fill the message"


class _Sample(NamedTuple):
    """The sample of a message.

    Attributes:
        packets: Its packets, as `_core.packets`.
        stamps: An MTData2 payload with those that a clock needs.
        problem: What is wrong with the message, or None.
    """

    packets: list[_core.Packet]
    stamps: bytes
    problem: str | None


class DumpFormatter:
    """Converts bytes to lines.

    Args:
        wanted: Names and numbers of messages; if empty, all messages, strings and damage.
        bid: Only the messages of this device, without strings and damage, which name no device; None for all.
        rate: Rate of the packet counter, as in `read_log`.
        strings: String types to parse, as in `read_log`.
        legacy: Settings of MTData, as in `read_log`.
        with_hex: Whether each line ends with the bytes of the frame or string.
        as_json: Whether lines are JSON objects instead of text.

    Attributes:
        frames: Number of frames and strings, wanted or not.
        devices: The BIDs of the frames; 1 stands for FF too.
        size: Number of bytes fed.
        damaged_bytes: Number of bytes that are neither frame nor string.
        rate_use: Counts the samples to which the rate gives a time.
    """

    def __init__(
        self,
        wanted: Iterable[int | str],
        *,
        bid: int | None = None,
        rate: float | None = None,
        strings: Iterable[str] = (),
        legacy: Sequence[tuple[int, int]] = (),
        with_hex: bool,
        as_json: bool,
    ) -> None:
        # The same limit as in `read_log`, with the same result.
        self._scanner = Scanner(LONGEST, strings=strings)
        self._outputs = _core.MtDataOutputs(list(legacy))
        self._clock = _core.SampleClock(rate)
        self._device_clock = None if rate is None else _core.SampleClock()
        self._wanted = frozenset(wanted)
        self._device = None if bid is None else device_of(bid)
        self._hex = with_hex
        self._json = as_json
        self._kept = bytearray()
        self.frames = 0
        self.devices: set[int] = set()
        self.size = 0
        self.damaged_bytes = 0
        self.rate_use = RateUse(rate)

    def feed(self, data: bytes) -> list[str]:
        """Returns the lines that these bytes complete."""
        self.size += len(data)
        self._kept += data
        lines = self._lines(self._scanner.feed(data))
        del self._kept[:-KEPT]
        return lines

    def add(self, items: Iterable[ScannedItem]) -> list[str]:
        """Returns the lines of what an acquisition has found."""
        return self._lines(map(named_item, items))

    def close(self) -> list[str]:
        """Returns the last lines."""
        return self._lines(self._scanner.close())

    def _lines(self, found: Iterable[Message | String | Damage]) -> list[str]:
        lines = []
        for item in found:
            if isinstance(item, Damage):
                self.damaged_bytes += item.length
                if self._has_all:
                    lines.append(_damage(item, as_json=self._json))
                continue
            self.frames += 1
            if isinstance(item, String):
                if self._has_all:
                    lines.append(_string(item, with_hex=self._hex, as_json=self._json))
                continue
            for message, sample in self._samples(item):
                time = self._time(message, sample)
                self.devices.add(device_of(message.bid))
                if self._is_wanted(message):
                    frame = self._frame(item) if self._hex else None
                    line = _json if self._json else _text
                    lines.append(line(message, sample, time, frame))
        return lines

    def _samples(self, message: Message) -> Iterator[tuple[Message, _Sample | None]]:
        """Yields a message with its sample or None; of several trackers, with the BID and sample of each."""
        if message.mid == MessageId.MTData2:
            packets, is_whole = _core.packets(message.payload), _core.is_sample(message.payload)
            yield message, _Sample(packets, message.payload, None if is_whole else MALFORMED)
        elif message.mid == MessageId.MTData:
            found = self._outputs.samples(message.bid, message.payload)
            if found is None:
                problem = with_argument_options(remedy_of_size(len(message.payload)))
                yield message, _Sample([], b"", problem)
            for sample in found or ():
                yield message._replace(bid=sample.bid), _Sample(sample.packets, sample.stamps, None)
        else:
            self._outputs.message(message.bid, message.mid, message.payload)
            yield message, None

    @property
    def _has_all(self) -> bool:
        return not self._wanted and self._device is None

    def _is_wanted(self, message: Message) -> bool:
        if self._device not in (None, device_of(message.bid)):
            return False
        return not self._wanted or message.mid in self._wanted or message.name in self._wanted

    def _time(self, message: Message, sample: _Sample | None) -> float | None:
        """Returns the time of a sample, as `Log.time`; None if it has none, and for other messages."""
        if sample is not None:
            seconds, _ = self._clock.sample(message.bid, sample.stamps)
            if self._device_clock is not None:
                stamp, _ = self._device_clock.sample(message.bid, sample.stamps)
                self._count(sample, seconds, stamp)
            return None if math.isnan(seconds) else seconds
        # It may name the device, or start a new run.
        for clock in filter(None, (self._clock, self._device_clock)):
            for bid in self._outputs.devices_of(message.bid):
                clock.message(bid, message.mid, message.payload)
        return None

    def _count(self, sample: _Sample, seconds: float, stamp: float) -> None:
        """Counts a sample: its time, and the same without the rate."""
        is_counted = any(packet.data_id == DataId.PacketCounter for packet in sample.packets)
        self.rate_use.has_counter |= is_counted
        self.rate_use.untimed += is_counted and math.isnan(seconds)
        self.rate_use.derived += math.isnan(stamp) and not math.isnan(seconds)

    def _frame(self, message: Message) -> bytes:
        """Returns the received bytes of a message; of one from `add`, the frame with the same content."""
        if not self.size:
            return encode_frame(message.mid, message.payload, bid=message.bid)
        at = message.offset - (self.size - len(self._kept))
        frame = bytes(self._kept[at:])
        return frame[: _core.frame_size(frame)]


def _damage(damage: Damage, *, as_json: bool) -> str:
    if as_json:
        return json.dumps(damage._asdict())
    return f"{damage.offset:>10}  {'':>12}  damage  {damage.length} bytes: {damage.reason}"


def _string(string: String, *, with_hex: bool, as_json: bool) -> str:
    if as_json:
        facts = {"offset": string.offset, "string": string.name, "text": string.text}
        return json.dumps(facts | ({"bytes": string.data.hex().upper()} if with_hex else {}))
    line = f"{string.offset:>10}  {'':>12}  {string.name}  {string.text}"
    return f"{line}  | {string.data.hex(' ').upper()}" if with_hex else line


def _text(message: Message, sample: _Sample | None, time: float | None, frame: bytes | None) -> str:
    stamp = "" if time is None else f"{time:.4f}"
    if sample is not None:
        parts = [describe_packet(packet) for packet in sample.packets]
        text = "; ".join([*parts, *([sample.problem] if sample.problem else [])])
    else:
        text = describe_message(message)
    if message.bid != 0xFF:
        text = f"(BID {message.bid}) {text}"
    line = f"{message.offset:>10}  {stamp:>12}  {message.name}  {text}".rstrip()
    return line if frame is None else f"{line}  | {frame.hex(' ').upper()}"


def _json(message: Message, sample: _Sample | None, time: float | None, frame: bytes | None) -> str:
    facts: dict[str, Any] = {"offset": message.offset}
    if sample is not None:
        facts |= {"bid": message.bid, "mid": message.mid, "name": message.name}
        facts["time_s"] = time
        facts["malformed"] = sample.problem is not None
        facts["packets"] = [packet_dict(packet) for packet in sample.packets]
    else:
        facts |= message_dict(message)
    if frame is not None:
        facts["frame"] = frame.hex().upper()
    return json.dumps(facts)
