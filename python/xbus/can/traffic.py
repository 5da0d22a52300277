"""What was on the bus besides samples: undecoded frames, events of devices, and what is unusual."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any

import numpy as np
import numpy.typing as npt

from xbus.can.captures import Frames
from xbus.log.arrays import read_only
from xbus.log.log import Log
from xbus.protocol.can import CanMessage

__all__ = ["Devices", "Tally", "Traffic", "Verdict"]


class Verdict(IntEnum):
    """What became of a frame; the numbers are those of the core."""

    DECODED = 0
    LONG = 1
    EVENT = 2
    UNKNOWN = 3
    SHORT = 4
    EXPONENT = 5
    NO_LAYOUT = 6
    REMOTE = 7
    ERROR = 8

    @property
    def text(self) -> str:
        """The verdict in words."""
        return self.name.lower().replace("_", " ")


UNDECODED = np.dtype(
    [
        ("frame", "i8"),
        ("time", "f8"),
        ("id", "u4"),
        ("size", "u1"),
        ("data", "u1", 8),
        ("reason", "U9"),
    ]
)
EVENTS = np.dtype([("frame", "i8"), ("time", "f8"), ("bid", "u1"), ("kind", "U7"), ("code", "u1")])


@dataclass(frozen=True)
class Traffic:
    """What was on a bus besides samples. Comes from `CanLog.traffic`.

    Attributes:
        frames: Number of all frames in the capture.
        decoded: Number of those that samples have.
        unknown: Number of frames of each identifier that no device has; bit 31 marks 29 bits.
        undecoded: Frames of a device that are not decoded, remote frames and error frames: a structured
            array of frame (the index in the capture), time, id, size, data and reason.
        events: Errors and Warnings of devices: a structured array of frame, time, bid, kind and code. Error 1
            means that the output buffer of the device overflowed, so that frames are missing.
        findings: Sentences that say what is unusual, and what to do.
    """

    frames: int
    decoded: int
    unknown: Mapping[int, int]
    undecoded: npt.NDArray[Any] = field(repr=False)
    events: npt.NDArray[Any] = field(repr=False)
    findings: tuple[str, ...]


#: Maximum number of identifiers that are counted one by one; a capture of another bus can have millions.
MAX_IDS = 1 << 14
SAMPLE_TIME, GROUP_COUNTER = 0x05, 0x06


class Devices:
    """The devices on a bus.

    Args:
        devices: The messages of each by identifier.
    """

    def __init__(self, devices: Sequence[Mapping[int, CanMessage]]) -> None:
        self.devices = devices
        #: The message of each identifier.
        self.messages = {key: row for device in devices for key, row in device.items()}
        #: The bus identifier of the device of each identifier.
        self.bids = {key: bid for bid, device in enumerate(devices, 1) for key in device}

    def undecoded(
        self, frames: Frames, verdicts: npt.NDArray[np.uint8], first: int
    ) -> npt.NDArray[Any]:
        """Returns the frames that are not decoded; `first` is the index of the first."""
        at = np.flatnonzero(verdicts >= Verdict.SHORT)
        rows = np.empty(len(at), UNDECODED)
        rows["frame"], rows["time"], rows["id"] = at + first, frames.time[at], frames.ids[at]
        rows["size"], rows["data"] = frames.sizes[at], frames.data[at]
        rows["reason"] = np.array([verdict.text for verdict in Verdict])[verdicts[at]]
        return read_only(rows)

    def events(
        self, frames: Frames, verdicts: npt.NDArray[np.uint8], first: int
    ) -> npt.NDArray[Any]:
        """Returns the events; `first` is the index of the first frame."""
        at = np.flatnonzero(verdicts == Verdict.EVENT)
        rows = np.empty(len(at), EVENTS)
        rows["frame"], rows["time"], rows["code"] = at + first, frames.time[at], frames.data[at, 0]
        ids = frames.ids[at].tolist()
        rows["bid"] = [self.bids[key] for key in ids]
        rows["kind"] = [self.messages[key].name for key in ids]
        return read_only(rows)


@dataclass
class Stamps:
    """What the time stamps of a device say.

    Attributes:
        samples: Number of its samples.
        untimed: Number of those without a time.
        steps: How often its clock steps back.
        repeats: How often the same stamp comes twice in a row.
        only_stamps: Whether nothing but stamps has come.
        last_time: Time of its last sample that has one.
        last_id: Identifier of its last frame.
    """

    samples: int = 0
    untimed: int = 0
    steps: int = 0
    repeats: int = 0
    only_stamps: bool = True
    last_time: float = -math.inf
    last_id: int = -1


class Tally:
    """Counts of the frames on a bus, added block by block. Its size is bounded.

    Args:
        devices: The devices.
    """

    def __init__(self, devices: Devices) -> None:
        self.devices = devices
        self.frames = 0
        self.channel_names: tuple[str, ...] = ()
        self.fault: str | None = None
        #: Number of frames by verdict, identifier and size.
        self._counts: dict[tuple[Verdict, int, int], int] = {}
        #: Number of frames of unknown identifiers beyond `MAX_IDS`.
        self.uncounted = 0
        #: Number of events by bus identifier, kind and code.
        self.events: dict[tuple[int, str, int], int] = {}
        self.stamps = [Stamps() for _ in devices.devices]
        #: Number of rows of position_ecef, in which not all components came.
        self.incomplete_positions = 0

    def add(self, frames: Frames, verdicts: npt.NDArray[np.uint8]) -> None:
        """Adds frames, and what became of them."""
        self.channel_names, self.fault = frames.channel_names, frames.fault or self.fault
        if not len(frames.ids):
            return
        rows = verdicts.astype(np.uint64) << np.uint64(40)
        rows |= frames.ids.astype(np.uint64) << np.uint64(8)
        rows |= frames.sizes
        found, counts = np.unique(rows, return_counts=True)
        for row, count in zip(found.tolist(), counts.tolist(), strict=True):
            key = Verdict(row >> 40), row >> 8 & 0xFFFFFFFF, row & 0xFF
            if key in self._counts or len(self._counts) < MAX_IDS or key[0] != Verdict.UNKNOWN:
                self._counts[key] = self._counts.get(key, 0) + count
            else:
                self.uncounted += count
        events = self.devices.events(frames, verdicts, 0)
        for event in events[["bid", "kind", "code"]].tolist():
            self.events[event] = self.events.get(event, 0) + 1
        own = frames.ids[verdicts <= Verdict.LONG]
        for stamps, device in zip(self.stamps, self.devices.devices, strict=True):
            self._add_repeats(stamps, device, own)
        self.frames += len(frames.ids)

    def _add_repeats(
        self, stamps: Stamps, device: Mapping[int, CanMessage], ids: npt.NDArray[np.uint32]
    ) -> None:
        keys = [key for key, row in device.items() if row.code in (SAMPLE_TIME, GROUP_COUNTER)]
        own = ids[np.isin(ids, list(device))]
        if not len(own):
            return
        is_stamp = np.isin(own, keys)
        before = np.concatenate(([stamps.last_id], own[:-1].astype(np.int64)))
        stamps.repeats += int(np.count_nonzero((own == before) & is_stamp))
        stamps.only_stamps &= bool(is_stamp.all())
        stamps.last_id = int(own[-1])

    def add_samples(self, log: Log) -> None:
        """Adds the samples of the frames."""
        bids, times = log.bid, log.time
        for bid, stamps in enumerate(self.stamps, 1):
            own = times[bids == bid]
            timed = own[np.isfinite(own)]
            stamps.samples += len(own)
            stamps.untimed += len(own) - len(timed)
            if len(timed):
                stamps.steps += int(np.count_nonzero(np.diff(timed, prepend=stamps.last_time) < 0))
                stamps.last_time = float(timed[-1])
        if (positions := log.get("position_ecef")) is not None:
            incomplete = np.isnan(positions.values).any(axis=1)
            self.incomplete_positions += int(np.count_nonzero(incomplete))

    def total(self, *verdicts: Verdict) -> int:
        """Returns the number of frames with one of these verdicts."""
        return sum(count for (verdict, _, _), count in self._counts.items() if verdict in verdicts)

    def counts(self, *verdicts: Verdict) -> dict[int, int]:
        """Returns the number of frames of each identifier, the most frequent first."""
        found: dict[int, int] = {}
        for (verdict, key, _), count in sorted(self._counts.items()):
            if verdict in verdicts:
                found[key] = found.get(key, 0) + count
        return dict(sorted(found.items(), key=lambda item: -item[1]))

    def sizes(self, verdict: Verdict, key: int) -> list[int]:
        """Returns the sizes of the frames with an identifier and a verdict."""
        return sorted(size for kind, own, size in self._counts if (kind, own) == (verdict, key))
