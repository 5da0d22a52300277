"""What is known of a stream: plain data, which the sources keep and the view draws."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from typing import Any

from xbus.cli.monitor.attitude import FORMS, Attitude, attitude
from xbus.log.column import Column
from xbus.log.log import Log
from xbus.protocol.keys import Key
from xbus.protocol.tables import RECEIVER
from xbus.protocol.values import State
from xbus.rtk.forward import Fix

__all__ = ["Counts", "Event", "Known", "Model", "Recorded"]

#: Seconds over which rates are told.
SPAN = 5.0
#: What has not come for so many of its periods, and so many seconds, has stopped: the slowest rate is 1 Hz.
PERIODS, SILENCE = 3.0, 1.5
#: Their samples have times of their own, arbitrary without a fix.
#: What a `Fix` is told from.
TELLING = ("status_word", "gnss_pvt_data", "lat_lon", "altitude_ellipsoid")
#: Events that are kept.
KEPT = 100


@dataclass
class Known:
    """What is known of a quantity, or of a type of string.

    Attributes:
        name: Its name, or the identifier in hex where the tables have none.
        coordinates: ``"ENU"``, ``"NED"``, ``"NWU"``, or None.
        unit: Of its numbers; empty for a struct, whose fields have their own.
        fields: Names of its components or fields.
        units: Units of the fields of a struct.
        count: Packets that came.
        value: The latest row of the column, scaled; the bytes of an unknown one; the satellites of
            ``gnss_sat_info``; the text of a string.
        at: When it came, on the clock of the source.
    """

    name: str
    coordinates: str | None = None
    unit: str = ""
    fields: tuple[str, ...] = ()
    units: dict[str, str] = field(default_factory=dict)
    count: int = 0
    value: Any = None
    at: float = -math.inf
    #: Instants at which blocks ended, on a clock for rates, and the packets until then.
    _ends: deque[tuple[float, int]] = field(default_factory=deque)
    _is_stamped: bool = False

    def seen(self, count: int, now: float, stamp: float) -> None:
        """Takes note of packets: how many, when, and the device's time of the last, NaN without."""
        ends, is_stamped = self._ends, math.isfinite(stamp)
        instant = stamp if is_stamped else now
        # Another clock, one that was set, or a pause: what was before tells nothing of the rate.
        if is_stamped != self._is_stamped or (ends and not 0 <= instant - ends[-1][0] <= SPAN):
            ends.clear()
        self._is_stamped = is_stamped
        self.count += count
        self.at = now
        ends.append((instant, self.count))
        while instant - ends[0][0] > SPAN:
            ends.popleft()

    @property
    def _measured(self) -> float | None:
        (begin, before), (end, count) = (
            (self._ends[0], self._ends[-1]) if self._ends else 2 * [(0, 0)]
        )
        return (count - before) / (end - begin) if end > begin else None

    def has_stopped(self, now: float) -> bool:
        """Whether it should have come again by now."""
        rate = self._measured
        return now - self.at > max(SILENCE, PERIODS / rate if rate else 0.0)

    def rate(self, now: float) -> float | None:
        """Packets a second by the device's clock, or by the host's where it sends none; 0 if they stopped."""
        return 0.0 if self.has_stopped(now) else self._measured


@dataclass
class Counts:
    """What was counted since the monitor began; what waits, as it is now.

    Attributes:
        samples, bytes: What came.
        lost_samples, gaps: Samples that are missing by the packet counter, and in how many places.
        skipped_bytes, checksum_errors, malformed: Damage.
        errors, warnings: Messages of the device.
        overruns, dropped_bytes, dropped_samples: What driver, queue and program had no room for.
        queued_bytes, unread_samples: What waits.
    """

    samples: int = 0
    bytes: int = 0
    lost_samples: int = 0
    gaps: int = 0
    skipped_bytes: int = 0
    checksum_errors: int = 0
    malformed: int = 0
    errors: int = 0
    warnings: int = 0
    overruns: int = 0
    dropped_bytes: int = 0
    dropped_samples: int = 0
    queued_bytes: int = 0
    unread_samples: int = 0


@dataclass
class Recorded:
    """A recording: its files, the bytes in them, and why it ended by itself, or None."""

    file: str
    bytes: int
    error: str | None = None

    def __str__(self) -> str:
        early = "" if self.error is None else f"; it ended too early: {self.error}"
        return f"recorded {self.bytes:,} bytes in {self.file}{early}"


@dataclass
class Event:
    """Something that happened: when, in seconds since the monitor began; what; and whether it is bad."""

    at: float
    text: str
    is_bad: bool = True


@dataclass
class Model:
    """What is known of a stream.

    Attributes:
        name: Port or file.
        device: Who it is, once it has said so.
        state: Its state; None for a recording.
        is_lost: Whether the port is gone.
        baudrate: Of the port; None for a recording and where nobody knows.
        now: Seconds on the clock of the source.
        begin: When the monitor began, on the same clock.
        read: How much of a recording was read, 0 to 1; None for a port.
        quantities: In the order in which they came, by name and coordinates.
        attitude: Which way the device pointed at last, and when that came.
        fix: What is known of its position.
        counts: What was counted.
        events: The latest.
        recorded: The recording that is under way.
    """

    name: str
    device: str | None = None
    state: State | None = None
    is_lost: bool = False
    baudrate: int | None = None
    now: float = 0.0
    begin: float = 0.0
    read: float | None = None
    quantities: dict[tuple[str, str | None], Known] = field(default_factory=dict)
    attitude: tuple[Attitude, float] | None = None
    fix: Fix = field(default_factory=Fix)
    counts: Counts = field(default_factory=Counts)
    events: deque[Event] = field(default_factory=lambda: deque(maxlen=KEPT))
    recorded: Recorded | None = None

    @property
    def elapsed(self) -> float:
        """Seconds since the monitor began."""
        return self.now - self.begin

    @property
    def points(self) -> Attitude | None:
        """Which way the device points; None if that is not told, or was too long ago to be true."""
        if self.attitude is None or self.now - self.attitude[1] > SILENCE:
            return None
        return self.attitude[0]

    @property
    def status(self) -> Known | None:
        """The status word, or else byte, that still comes."""
        return self.latest("status_word") or self.latest("status_byte")

    def happened(self, text: str, *, is_bad: bool = True) -> None:
        """Takes note of an event."""
        self.events.append(Event(self.elapsed, text, is_bad))

    def latest(self, name: str) -> Known | None:
        """A quantity that still comes, in whichever coordinates."""
        found = [it for (other, _), it in self.quantities.items() if other == name]
        there = [it for it in found if not it.has_stopped(self.now)]
        return max(there, key=lambda it: it.at, default=None)

    def take(self, block: Log, now: float) -> None:
        """Takes in samples.

        Args:
            block: Those that have come since the last call.
            now: When the last of them came, on the clock of the source.
        """
        self.now = now
        came = {}
        for key in block:
            column = block[key]
            came[column.name] = self._take(column, now)
        for data_id, packets in block.unknown.items():
            name = f"0x{data_id:04X}"
            known = self.quantities.setdefault((name, None), Known(name))
            known.value = packets[-1]
            known.seen(len(packets), now, math.nan)
        self._take_strings(block, now)
        self._take_attitude(came, now)
        self._take_fix(block)

    def _take_strings(self, block: Log, now: float) -> None:
        counts = block.strings.counts
        for string in block.strings:
            name = "" if string.type is None else str(string.type.name)
            known = self.quantities.setdefault((name, None), Known(name or "other strings"))
            known.value = string.text
        for name, count in counts.items():
            self.quantities[name, None].seen(count, now, math.nan)

    def _take(self, column: Column, now: float) -> Known:
        name, coordinates = column.name, column.coordinates
        known = self.quantities.get((name, coordinates))
        if known is None:
            known = Known(name, coordinates, column.unit, column.fields, column.units)
            self.quantities[name, coordinates] = known
        if name == "gnss_sat_info":
            known.value = column.satellites[column.offsets[-2] :]
        else:
            known.value = column.scaled[-1]
        known.seen(len(column), now, math.nan if name in RECEIVER else float(column.time[-1]))
        return known

    def _take_attitude(self, came: dict[str, Known], now: float) -> None:
        form = next((it for it in FORMS if it in came), None)
        if form is not None:
            known = came[form]
            told = attitude(form, known.coordinates, known.value)
            self.attitude = None if told is None else (told, now)

    def _take_fix(self, block: Log) -> None:
        latest: dict[Key, Any] = {it: block[it].values[-1] for it in TELLING if it in block}
        if (pvt := latest.get("gnss_pvt_data")) is not None:
            latest["gnss_pvt_data"] = dict(zip(pvt.dtype.names, pvt.item(), strict=True))
        self.fix.update(latest)
