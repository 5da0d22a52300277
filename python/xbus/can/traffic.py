"""What was on the bus besides samples: undecoded frames, events of devices, and what is unusual."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from xbus.can.captures import Frames
from xbus.log.arrays import read_only
from xbus.protocol.can import CanMessage

__all__ = ["Seen", "Traffic", "Verdict"]


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


class Seen:
    """The frames of a capture, and what became of them.

    Args:
        frames: The frames.
        verdicts: The `Verdict` of each.
        devices: The messages of each device by identifier.
    """

    def __init__(
        self,
        frames: Frames,
        verdicts: npt.NDArray[np.uint8],
        devices: Sequence[Mapping[int, CanMessage]],
    ) -> None:
        self.frames, self.devices, self._verdicts = frames, devices, verdicts
        #: The message of each identifier.
        self.messages = {key: row for device in devices for key, row in device.items()}
        #: The bus identifier of the device of each identifier.
        self.bids = {key: bid for bid, device in enumerate(devices, 1) for key in device}

    def places(self, *verdicts: Verdict) -> npt.NDArray[np.int64]:
        """Returns the indices of the frames with one of these verdicts."""
        return np.flatnonzero(np.isin(self._verdicts, verdicts))

    def counts(self, *verdicts: Verdict) -> dict[int, int]:
        """Returns the number of frames of each identifier, the most frequent first."""
        ids, counts = np.unique(self.frames.ids[self.places(*verdicts)], return_counts=True)
        order = np.argsort(-counts, kind="stable")
        return dict(zip(ids[order].tolist(), counts[order].tolist(), strict=True))

    def sizes(self, verdict: Verdict, key: int) -> list[int]:
        """Returns the sizes of the frames with an identifier and a verdict."""
        places = self.places(verdict)
        sizes: list[int] = np.unique(
            self.frames.sizes[places[self.frames.ids[places] == key]]
        ).tolist()
        return sizes

    @cached_property
    def unknown(self) -> dict[int, int]:
        """Number of frames of each identifier that no device has."""
        return self.counts(Verdict.UNKNOWN)

    @cached_property
    def undecoded(self) -> npt.NDArray[Any]:
        """As `Traffic.undecoded`."""
        at, frames = (
            self.places(*(verdict for verdict in Verdict if verdict >= Verdict.SHORT)),
            self.frames,
        )
        rows = np.empty(len(at), UNDECODED)
        rows["frame"], rows["time"], rows["id"] = at, frames.time[at], frames.ids[at]
        rows["size"], rows["data"] = frames.sizes[at], frames.data[at]
        rows["reason"] = np.array([verdict.text for verdict in Verdict])[self._verdicts[at]]
        return read_only(rows)

    @cached_property
    def events(self) -> npt.NDArray[Any]:
        """As `Traffic.events`."""
        at, frames = self.places(Verdict.EVENT), self.frames
        rows = np.empty(len(at), EVENTS)
        rows["frame"], rows["time"], rows["code"] = at, frames.time[at], frames.data[at, 0]
        ids = frames.ids[at].tolist()
        rows["bid"] = [self.bids[key] for key in ids]
        rows["kind"] = [self.messages[key].name for key in ids]
        return read_only(rows)
