"""What maps have in common: the positions of a log as tracks, one for each device, in segments.

A track is made of the positions of the device's filter, or of those of its GNSS receiver. A position without
a fix is no point. A segment ends where the fix is lost, where samples are missing, and where the device
restarts.
"""

from __future__ import annotations

import os
import shutil
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from itertools import pairwise
from tempfile import SpooledTemporaryFile
from typing import IO, ClassVar

import numpy as np
import numpy.typing as npt

from xbus.export.format import ExportError, Format, Writer
from xbus.export.part import Part, PartDevice
from xbus.export.positions import Points, Positions, Source, positions_of
from xbus.export.replacing import replacing
from xbus.export.thinning import Thinning
from xbus.formatting import device_name, format_count
from xbus.protocol.keys import EntryKey
from xbus.protocol.tables import device_of

__all__ = ["TrackFormat", "TrackText"]

#: Points that are written at a time.
STEP = 1 << 16


def spool() -> IO[bytes]:
    """Returns a temporary file, which is in memory up to 1 MB."""
    return SpooledTemporaryFile(1 << 20)


class TrackText(ABC):
    """The text of the track of a device. A subclass writes it.

    Args:
        out: Where to write.
        name: Name of the device.
        has_msl: Whether heights above sea level are known.
        extras: Names of the fields of `POINT` that are known, of those that not every log has.
        stack: Closes what is set aside.
    """

    #: What stands between the texts of two devices.
    separator: ClassVar[bytes] = b""

    def __init__(
        self,
        out: IO[bytes],
        name: str,
        *,
        has_msl: bool,
        extras: Sequence[str],
        stack: ExitStack,
    ) -> None:
        self._out, self._name, self._has_msl, self._extras = out, name, has_msl, extras
        self._stack = stack
        self._files: dict[str, IO[bytes]] = {}

    def _aside(self, name: str) -> IO[bytes]:
        """Returns a temporary file for text that comes later in the file."""
        if name not in self._files:
            self._files[name] = self._stack.enter_context(spool())
        return self._files[name]

    def _copy_aside(self, name: str) -> None:
        """Writes what was set aside, which is then empty."""
        aside = self._aside(name)
        aside.seek(0)
        shutil.copyfileobj(aside, self._out)
        aside.seek(0)
        aside.truncate()

    @abstractmethod
    def write(self, points: Points, *, is_start: bool) -> None:
        """Writes the next points of a segment, or the first ones of the next segment."""

    @abstractmethod
    def close(self) -> None:
        """Ends the track. Called only after `write`."""


@dataclass(frozen=True)
class TrackFormat(Format):
    """A format with tracks.

    Attributes:
        source: ``"filter"`` for ``lat_lon`` (or ``position_ecef``) and altitude, ``"gnss"`` for
            ``gnss_pvt_data``; None for the filter if the log has its positions.
        every_seconds: Shortest time between two points of a segment in s; None for all points.
        every_metres: Shortest distance between two points of a segment in m; None for all points.
    """

    source: Source | None = None
    every_seconds: float | None = None
    every_metres: float | None = None

    def __post_init__(self) -> None:
        if self.source not in (None, "filter", "gnss"):
            raise ValueError(f"source must be 'filter' or 'gnss', not {self.source!r}")
        for name in ("every_seconds", "every_metres"):
            limit = getattr(self, name)
            if limit is not None and not limit > 0:
                raise ValueError(f"{name} must be positive, not {limit}")

    always: ClassVar[tuple[str, ...]] = ("status_word", "status_byte", "utc_time")
    #: Name of the format in messages.
    title: ClassVar[str]
    #: What it does with a height if heights above sea level are not known, as a noun; None if it needs none.
    without_msl: ClassVar[str | None]
    #: The file before and after the tracks.
    head: ClassVar[bytes]
    tail: ClassVar[bytes]
    #: The class of the text of a track.
    text: ClassVar[type[TrackText]]

    def quantities(self, shape: Part) -> Sequence[EntryKey]:
        """See `Format.quantities`."""
        return self._positions(shape).quantities(shape)

    def _positions(self, shape: Part) -> Positions:
        positions = positions_of(shape, self.source)
        if positions is None:
            needed = {"filter": "lat_lon or position_ecef", "gnss": "gnss_pvt_data"}
            names = needed.get(self.source or "", "lat_lon, position_ecef or gnss_pvt_data")
            raise ExportError(f"{self.title} needs {names}; xbus info lists the content")
        return positions

    @contextmanager
    def open(self, path: str | os.PathLike[str], shape: Part) -> Iterator[Writer]:
        """See `Format.open`."""
        positions = self._positions(shape)
        with replacing(path) as out, ExitStack() as stack:
            out.write(self.head)
            writer = _TrackWriter(self, positions, shape, out, stack)
            yield writer
            writer.finish()
            out.write(self.tail)


class _Track:
    """The track of a device so far.

    Attributes:
        text: Its text.
        places: Number of places so far that end a segment.
        segment: That number at the last point; None without a point.
        thinning: Which points to keep.
    """

    def __init__(self, text: TrackText, thinning: Thinning) -> None:
        self.text, self.thinning = text, thinning
        self.places = 0
        self.segment: int | None = None


class _TrackWriter:
    def __init__(
        self,
        track_format: TrackFormat,
        positions: Positions,
        shape: Part,
        out: IO[bytes],
        stack: ExitStack,
    ) -> None:
        self._positions, self._out = positions, out
        self._has_msl, self._without_msl = positions.has_msl(shape), track_format.without_msl
        self._position = positions.position(shape)
        self._can_be_gnss = positions.name != "gnss" and "gnss_pvt_data" in shape
        self._counts = {"point": 0, "segment": 0}
        #: The track of the first device is written at once. The others are set aside, since they follow it.
        self._aside: dict[int, IO[bytes]] = {}
        self._tracks: dict[int, _Track] = {}
        for device in shape.devices:
            target = out
            if self._tracks:
                target = self._aside[device_of(device.bid)] = stack.enter_context(spool())
            text = track_format.text(
                target,
                _name(device),
                has_msl=self._has_msl,
                extras=positions.extras(shape),
                stack=stack,
            )
            thinning = Thinning(track_format.every_seconds, track_format.every_metres)
            self._tracks[device_of(device.bid)] = _Track(text, thinning)

    @property
    def counts(self) -> dict[str, int]:
        return dict(self._counts)

    def write(self, part: Part) -> None:
        rows = self._positions.rows(part)
        bids = device_of(part.bid)
        devices = bids[rows.sample - part.first_sample]
        self._count("unfixed position", ~rows.is_fixed)
        self._count("invalid position", rows.is_fixed & ~rows.is_place)
        is_point = rows.is_fixed & rows.is_place
        time = part.time[rows.sample - part.first_sample]
        for device, track in self._tracks.items():
            own = devices == device
            restarts = part.restarts[bids[part.restarts - part.first_sample] == device]
            gaps = part.gaps["sample"][device_of(part.gaps["bid"]) == device]
            ends = np.sort(np.concatenate([restarts, gaps, rows.sample[own & ~is_point]]))
            own &= is_point
            places = track.places + np.searchsorted(ends, rows.sample[own], side="right")
            track.places += len(ends)
            if len(places):
                self._add(track, rows.points[own], time[own], places)

    def _add(
        self,
        track: _Track,
        points: Points,
        time: npt.NDArray[np.float64],
        places: npt.NDArray[np.intp],
    ) -> None:
        """Writes points of a device, each with its device time and the number of segment ends before it."""
        before = places[0] - 1 if track.segment is None else track.segment
        is_start = np.diff(places, prepend=before) != 0
        track.segment = int(places[-1])
        kept = track.thinning.keep(points, time, is_start)
        self._count("omitted point", ~kept)
        points, is_start = points[kept], is_start[kept]
        self._count("point", kept)
        self._count("segment", is_start)
        self._count("untimed point", np.isnat(points["time"]))
        if self._without_msl and not self._has_msl:
            self._count(self._without_msl, np.isfinite(points["ellipsoid"]))
        bounds = np.union1d(np.flatnonzero(is_start), np.arange(0, len(points), STEP)).tolist()
        for first, end in pairwise([*bounds, len(points)]):
            track.text.write(points[first:end], is_start=bool(is_start[first]))

    def _count(self, what: str, found: npt.NDArray[np.bool_]) -> None:
        if number := int(np.count_nonzero(found)):
            self._counts[what] = self._counts.get(what, 0) + number

    def finish(self) -> None:
        """Ends the tracks and joins them.

        Raises:
            ExportError: There is no point.
        """
        if not self._counts["point"]:
            raise ExportError(self._without_points())
        is_first = True
        for device, track in self._tracks.items():
            if track.segment is None:
                continue
            track.text.close()
            if not is_first:
                self._out.write(track.text.separator)
            is_first = False
            if (aside := self._aside.get(device)) is not None:
                aside.seek(0)
                shutil.copyfileobj(aside, self._out)

    def _without_points(self) -> str:
        """Returns why there is no point, and what to do."""
        name = self._position
        if unfixed := self._counts.get("unfixed position", 0):
            other = '; choose source="gnss", the receiver' if self._can_be_gnss else ""
            return f"none of the {format_count(unfixed, 'position')} ({name}) has a fix{other}"
        if self._counts.get("invalid position", 0):
            return f"no position ({name}) is a place on Earth; xbus info lists the content"
        return f"no position ({name}); xbus info lists the content"


def _name(device: PartDevice) -> str:
    """Returns the name of the track of a device, in printable characters."""
    number = f"BID {device.bid}" if device.device_id is None else device_name(device.device_id)
    return "".join(filter(str.isprintable, f"{device.product_code or 'MTi'} {number}"))
