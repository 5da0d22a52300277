"""What ``xbus info`` knows about a log, gathered part by part: a log need not fit into memory."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import asdict, fields
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from xbus.describe.text import Notice, device_name, finite, read_notice, recording_date
from xbus.log.column import Column
from xbus.log.identity import Identity
from xbus.log.log import Log, steady_time
from xbus.log.stats import Stats
from xbus.protocol.configuration import Configuration
from xbus.protocol.ids import MessageId
from xbus.protocol.tables import QUANTITIES, UTC_VALID
from xbus.wire.message import Message

__all__ = ["Event", "Gap", "LogSummary", "QuantitySummary"]


class Gap(NamedTuple):
    """A place where samples are missing.

    Attributes:
        sample: Index of the sample behind it.
        time: Time of that sample in seconds on the device clock, unwrapped; None where it has none.
        lost: How many are missing.
    """

    sample: int
    time: float | None
    lost: int


class Event(NamedTuple):
    """An Error or Warning message.

    Attributes:
        offset: Where its frame begins, in bytes.
        sample: Index of the next sample.
        time: Time of the sample before it in seconds on the device clock, or None.
        name: ``"Error"`` or ``"Warning"``.
        notice: What it says.
    """

    offset: int
    sample: int
    time: float | None
    name: str
    notice: Notice


class Span:
    """From the earliest to the latest time stamp, and how many there are."""

    def __init__(self) -> None:
        self.start = self.end = float("nan")
        self.stamps = 0

    def add(self, stamps: npt.NDArray[np.float64]) -> None:
        """Takes in the next ones, in any order."""
        if len(stamps):
            self.start = float(np.fmin(self.start, stamps.min()))
            self.end = float(np.fmax(self.end, stamps.max()))
            self.stamps += len(stamps)

    @property
    def duration(self) -> float:
        """Seconds; NaN for fewer than two stamps."""
        return self.end - self.start if self.stamps > 1 else float("nan")


class QuantitySummary:
    """One quantity of a log."""

    def __init__(self, column: Column) -> None:
        self.name = column.name
        self.coordinates = column.coordinates
        self.unit = column.unit
        self.rows = 0
        self._stamped = 0
        self._first = self._last = float("nan")
        self._precisions: set[str | None] = set()
        self._ids: set[int] = set()

    def add(self, column: Column) -> None:
        """Takes in what the next part says."""
        self.rows += len(column)
        self._precisions.add(column.precision)
        self._ids.add(column.data_id)
        stamped = column.time[np.isfinite(column.time)]
        if len(stamped):
            if not self._stamped:
                self._first = float(stamped[0])
            self._last = float(stamped[-1])
            self._stamped += len(stamped)

    @property
    def rate(self) -> float:
        """Rows per second, as `Column.rate` has it."""
        span = self._last - self._first
        return (self._stamped - 1) / span if span > 0 else float("nan")

    @property
    def precision(self) -> str | None:
        """The one precision, or None."""
        return next(iter(self._precisions)) if len(self._precisions) == 1 else None

    @property
    def data_id(self) -> int:
        """The one data identifier, or the base identifier."""
        return next(iter(self._ids)) if len(self._ids) == 1 else QUANTITIES[self.name].id

    def facts(self) -> dict[str, Any]:
        """For programs."""
        return {
            "name": self.name,
            "coordinates": self.coordinates,
            "data_id": f"0x{self.data_id:04X}",
            "rows": self.rows,
            "rate_hz": finite(self.rate),
            "precision": self.precision,
            "unit": self.unit,
        }


class LogSummary:
    """What is in a log.

    Attributes:
        stats: What was counted.
        identity: What the log says about the device.
        quantities: In the order in which they were first seen.
        gaps: Where samples are missing, in order.
        damage: Offset, length and reason of each stretch that is neither frame nor string.
        messages: How many there are of each name.
        strings: The same of string outputs; those that the manual does not list are "others".
        events: Errors and warnings that the device sent.
        unknown: How many packets and bytes there are of each identifier that the tables cannot explain.
        utc: Earliest and latest UTC time that the device calls valid, or None.
        utc_rows, utc_valid: UTC times, and how many of them the device calls valid.
    """

    def __init__(self, parts: Iterable[Log]) -> None:
        self.stats = Stats(**{it.name: 0 for it in fields(Stats)})
        self.identity = Identity()
        self._quantities: dict[tuple[str, str | None], QuantitySummary] = {}
        self.gaps: list[Gap] = []
        self.damage: list[tuple[int, int, str]] = []
        self.messages: Counter[str] = Counter()
        self.strings: Counter[str] = Counter()
        self.events: list[Event] = []
        self.unknown: dict[int, list[int]] = {}
        self.utc: tuple[np.datetime64, np.datetime64] | None = None
        self.utc_rows = self.utc_valid = 0
        self._steady, self._receiver = Span(), Span()
        self._last_time: float | None = None
        for part in parts:
            self.add(part)

    @property
    def quantities(self) -> list[QuantitySummary]:
        """In the order in which they were first seen."""
        return list(self._quantities.values())

    @property
    def start(self) -> float:
        """Earliest time stamp in seconds on the device clock, as `Log.duration` has it; NaN without any."""
        return self._span.start

    @property
    def duration(self) -> float:
        """Seconds between the earliest and the latest time stamp; NaN for fewer than two."""
        return self._span.duration

    @property
    def _span(self) -> Span:
        return self._steady if self._steady.stamps else self._receiver

    def add(self, part: Log) -> None:
        """Takes in the next part."""
        counts = asdict(self.stats)
        self.stats = Stats(**{key: counts[key] + it for key, it in asdict(part.stats).items()})
        self.identity = part.identity
        self.damage += part.damage.tolist()
        self.strings.update({name or "others": it for name, it in part.strings.counts.items()})
        for key in part:
            column = part[key]
            known = self._quantities.setdefault(
                (column.name, column.coordinates), QuantitySummary(column)
            )
            known.add(column)
            if column.name == "utc_time":
                self._add_utc(column)
        for data_id, packets in part.unknown.items():
            count = self.unknown.setdefault(data_id, [0, 0])
            count[0] += len(packets)
            count[1] += packets._bytes.size
        messages = list(part.messages)
        self._add_gaps(part)
        steady = steady_time(part)
        self._add_messages(part, messages, steady)
        is_steady = np.isfinite(steady)
        self._steady.add(steady[is_steady])
        self._receiver.add(part.time[np.isfinite(part.time) & ~is_steady])
        if is_steady.any():
            self._last_time = float(steady[is_steady][-1])

    def _add_utc(self, column: Column) -> None:
        stamps = column.datetime[(column.values["valid"] & UTC_VALID == UTC_VALID)]
        stamps = stamps[~np.isnat(stamps)]
        self.utc_rows += len(column)
        self.utc_valid += len(stamps)
        if len(stamps):
            first, last = self.utc or (stamps[0], stamps[0])
            self.utc = min(first, stamps.min()), max(last, stamps.max())

    def _add_messages(
        self, part: Log, messages: Iterable[Message], steady: npt.NDArray[np.float64]
    ) -> None:
        events = []
        for it in messages:
            self.messages[it.name] += 1
            if it.mid in (MessageId.Error, MessageId.Warning):
                events.append(it)
        if not events:
            return
        # For each sample the last one up to it that has a time stamp, -1 where none has.
        stamped = np.where(np.isfinite(steady), np.arange(len(part)), -1)
        latest = [-1, *np.maximum.accumulate(stamped).tolist()]
        for it in events:
            at = latest[it.sample - part.first_sample]
            time = self._last_time if at < 0 else float(steady[at])
            self.events.append(Event(it.offset, it.sample, time, it.name, read_notice(it)))

    def _add_gaps(self, part: Log) -> None:
        gaps = part.gaps
        times = part.time[gaps["sample"] - part.first_sample].tolist()
        self.gaps += [
            Gap(sample, finite(time), lost)
            for (sample, lost, _), time in zip(gaps.tolist(), times, strict=True)
        ]

    def facts(self, file: str) -> dict[str, Any]:
        """For programs: all of it; null where the log does not say, and for NaN."""
        told, firmware, stats = self.identity, self.identity.firmware, self.stats
        return {
            "file": file,
            "bytes": stats.bytes,
            "device": {
                "product_code": told.product_code,
                "device_id": None if told.device_id is None else device_name(told.device_id),
                "firmware": None if firmware is None else str(firmware),
                "firmware_build": None if firmware is None else firmware.build,
                "firmware_source": None if firmware is None else firmware.scm,
            },
            "recorded": told.configuration and recording_date(told.configuration),
            "configuration": told.configuration and _settings(told.configuration),
            "utc": self._utc_facts(),
            "start_s": finite(self.start),
            "duration_s": finite(self.duration),
            "frames": stats.frames,
            "samples": stats.samples,
            "lost_samples": stats.lost_samples,
            "gaps": [{"sample": it.sample, "time_s": it.time, "lost": it.lost} for it in self.gaps],
            "quantities": [it.facts() for it in self.quantities],
            "skipped_bytes": stats.skipped_bytes,
            "checksum_errors": stats.checksum_errors,
            "damage": [{"offset": at, "length": n, "reason": why} for at, n, why in self.damage],
            "malformed": stats.malformed,
            "messages": dict(self.messages),
            "strings": dict(self.strings),
            "events": [
                {"offset": it.offset, "sample": it.sample, "time_s": it.time, "name": it.name}
                | it.notice._asdict()
                for it in self.events
            ],
            "unknown": [
                {"data_id": f"0x{data_id:04X}", "packets": packets, "bytes": size}
                for data_id, (packets, size) in self.unknown.items()
            ],
        }

    def _utc_facts(self) -> dict[str, Any] | None:
        if not self.utc_rows:
            return None
        first, last = (f"{it}Z" for it in self.utc) if self.utc else (None, None)
        return {"first": first, "last": last, "rows": self.utc_rows, "valid": self.utc_valid}


def _settings(configuration: Configuration) -> dict[str, Any]:
    """What the Configuration says beside the device's name."""
    settings = asdict(configuration)
    for it in ("device_id", "product_code", "firmware"):
        del settings[it]
    return settings
