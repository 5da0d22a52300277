"""What ``xbus decode`` says about a log that it decodes part by part."""

from __future__ import annotations

import math
from dataclasses import asdict, fields

from xbus.log.log import Log
from xbus.log.runs import Runs
from xbus.log.stats import Stats
from xbus.log.trackers import TrackerCounts, TrackerSummary
from xbus.protocol.undecoded import Undecoded

__all__ = ["DecodedTotals"]


class DecodedTotals:
    """The counts of a log, added up part by part: much less work than a `LogSummary`.

    Args:
        times_fault: What is wrong with the side file of arrivals, or None; if it is known before the parts.

    Attributes:
        stats: Counts of what was read.
        has_counter: Whether a sample has a packet counter.
        runs: The runs of all devices.
        times_fault: What is wrong with the side file of arrivals, or None.
    """

    def __init__(self, times_fault: str | None = None) -> None:
        self.stats = Stats(**{field.name: 0 for field in fields(Stats)})
        self.has_counter = False
        self.times_fault = times_fault
        self._damaged = 0
        self.runs = Runs()
        self._undecoded: dict[tuple[str, int, str], Undecoded] = {}
        self._trackers = TrackerCounts()

    def add(self, part: Log) -> None:
        """Adds the next part."""
        counts = asdict(self.stats)
        self.stats = Stats(**{name: counts[name] + n for name, n in asdict(part.stats).items()})
        self.has_counter |= part.has_counter
        self.times_fault = self.times_fault or part.times_fault
        self._damaged += len(part.damage)
        self.runs.add(part.core)
        for item in part.undecoded:
            earlier = self._undecoded.get(item.key)
            self._undecoded[item.key] = item if earlier is None else earlier.plus(item)
        self._trackers.add(part.get("awinda_snapshot"))

    @property
    def damage(self) -> range:
        """Numbers of the places of damage."""
        return range(self._damaged)

    @property
    def start(self) -> float:
        """Start of the first run with time stamps, in seconds on the device clock; NaN without any."""
        spans = self.runs.spans
        starts = spans["start"][spans["stamps"] > 0]
        return float(starts[0]) if len(starts) else math.nan

    @property
    def duration(self) -> float:
        """Seconds recorded, as `Log.duration`."""
        return self.runs.duration

    @property
    def undecoded(self) -> list[Undecoded]:
        """Output that is not decoded, as `Log.undecoded`."""
        messages = sorted(item for item in self._undecoded.values() if item.kind == "message")
        return [*messages, *(item for item in self._undecoded.values() if item.kind == "packet")]

    @property
    def trackers(self) -> dict[int, TrackerSummary]:
        """The Awinda trackers by device identifier, in the order in which they appear."""
        return self._trackers.summaries()
