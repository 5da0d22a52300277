"""What a report says of a log, gathered part by part: a log need not fit into memory."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from xbus.describe.log_summary import LogSummary
from xbus.describe.text import describe_message
from xbus.log.column import Column
from xbus.log.log import Log, steady_time
from xbus.protocol.ids import MessageId
from xbus.protocol.tables import QUANTITIES, STATUS_FLAGS, StatusFlag
from xbus.report.allan import Longest
from xbus.report.axis import Axis
from xbus.report.thin import Bands, BoolArray, Curves, FloatArray, Steps
from xbus.report.track import SOURCES, Track, has_fix

__all__ = ["Flag", "Gathered", "Panel", "Series", "Setting"]

#: What is plotted of struct quantities: title, unit, fields that belong together. Of others nothing is.
MAIN: dict[str, list[tuple[str, str, tuple[str, ...]]]] = {
    "gnss_pvt_data": [
        ("fix type and satellites", "", ("fixtype", "numSV")),
        ("stated accuracy", "m", ("hAcc", "vAcc")),
        ("height", "m", ("height", "hMSL")),
        ("velocity", "m/s", ("velN", "velE", "velD", "sAcc")),
        ("dilution of precision", "", ("pdop", "hdop", "vdop", "tdop")),
    ],
    "gps_dop": [("", "", ("pdop", "hdop", "vdop", "tdop"))],
    "raw_acc_gyr_mag_temp": [
        ("accelerometer", "counts", ("accX", "accY", "accZ")),
        ("gyroscope", "counts", ("gyrX", "gyrY", "gyrZ")),
        ("magnetometer", "counts", ("magX", "magY", "magZ")),
        ("temperature", "degC", ("Temp",)),
    ],
    "trigger_in1": [("polarity", "", ("polarity",))],
    "trigger_in2": [("polarity", "", ("polarity",))],
    "trigger_in3": [("polarity", "", ("polarity",))],
}
#: What a receiver says without a fix, too.
ALWAYS = ("fix type and satellites",)
#: Of these the noise is told: their unit, as rows of a sensor at rest.
NOISY = ("acceleration", "acceleration_hr", "rate_of_turn", "rate_of_turn_hr")
STATUS = ("status_word", "status_byte")
#: Flags that are set while all is well.
WANTED = [it for it in STATUS_FLAGS if it.name in ("filter_valid", "gnss_fix")]
EVENTS = (MessageId.Error, MessageId.Warning)
#: How many settings are listed; a log of a day of commands holds many.
SETTINGS = 100


class Panel(NamedTuple):
    """One plot of a quantity.

    Attributes:
        title: Which of its plots; empty where it has one.
        unit: Of all curves in it.
        curves: The curves.
    """

    title: str
    unit: str
    curves: Curves


class Series:
    """One quantity over time.

    Attributes:
        panels: Its plots, by title.
        steps: Where rows are missing.
        longest: Its longest stretch without a gap, of quantities of which the noise is told.
    """

    def __init__(self, column: Column) -> None:
        self.name = column.name
        self.coordinates = column.coordinates
        self.panels: dict[str, Panel] = {}
        self.steps = Steps()
        self.longest = Longest(3) if column.name in NOISY else None

    @property
    def anchor(self) -> str:
        """Its place in the page."""
        return self.name if self.coordinates in (None, "ENU") else f"{self.name}-{self.coordinates}"

    def add(self, column: Column, time: FloatArray) -> BoolArray:
        """Takes in the next rows and their times; before which of them some are missing."""
        breaks = self.steps.breaks(time)
        for title, unit, names, values in _plotted(column):
            panel = self.panels.setdefault(title, Panel(title, unit, Curves(names)))
            panel.curves.add(time, values, breaks)
        if self.longest is not None:
            self.longest.add(time, column.values, breaks)
        return breaks


def _plotted(
    column: Column,
) -> Iterator[tuple[str, str, tuple[str, ...], npt.NDArray[Any]]]:
    """Title, unit, names and values ``(N, k)`` of each plot of a quantity."""
    row = QUANTITIES[column.name]
    if column.name == "gnss_sat_info":
        yield "satellites", "", ("numSvs",), column.values["numSvs"][:, None]
        if len(column.satellites):
            yield "signal strength", "dBHz", ("least", "mean", "greatest"), _signals(column)
    elif column.fields and row.fields:
        for title, unit, names in MAIN.get(column.name, []):
            values = np.stack([column.scaled[it] for it in names], axis=1)
            if column.name == "gnss_pvt_data" and title not in ALWAYS:
                # What a receiver says of a position that it does not have is nothing.
                values = np.where(has_fix(column.values)[:, None], values, np.nan)
            yield title, unit, names, values
    elif row.group != "Timestamp" and row.kind != "id" and column.name not in STATUS:
        values = column.values
        names = column.fields or (column.name,)
        yield "", column.unit, names, values.reshape(len(values), len(names))


def _signals(column: Column) -> FloatArray:
    """Least, mean and greatest carrier to noise of the satellites of each row; NaN where it has none."""
    signals = column.satellites["cno"].astype(np.float64)
    starts, ends = column.offsets[:-1], column.offsets[1:]
    found = np.full((len(starts), 3), np.nan)
    some = ends > starts
    for at, reduce in enumerate((np.minimum, np.add, np.maximum)):
        found[some, at] = reduce.reduceat(signals, starts[some])
    found[some, 1] /= (ends - starts)[some]
    return found


class Flag:
    """A value of a field of the status word that is not zero.

    Attributes:
        meaning: Of the field (Table 27).
        rows: In how many status words it was.
        bands: When.
    """

    def __init__(self, field: StatusFlag, value: int) -> None:
        self.name, self.value, self.meaning = field.name, value, field.meaning
        self._has_values = field.width > 1
        self.rows = 0
        self.bands = Bands()

    @property
    def label(self) -> str:
        """Its name, with the value where it can have several."""
        return f"{self.name} = {self.value}" if self._has_values else self.name


class Setting(NamedTuple):
    """What a message says that is no event.

    Attributes:
        time: Of the next sample on the report's axis.
        name: Of the message.
        words: What it says.
    """

    time: float
    name: str
    words: str


class Gathered:
    """Everything that a report says of a log.

    Attributes:
        facts: What ``xbus info`` says.
        axis: The horizontal axis.
        utc: UTC at the origin, or None.
        steps: Time between samples, ms.
        end: The last sample on the axis.
        lost, damage: When samples are missing and bytes are damaged; weights are samples and bytes.
        gaps: Where the samples behind the gaps of the facts are on the axis.
        events: Where the errors and warnings of the facts are on the axis.
        flags: Fields of the status word that were ever set, by name and value.
        status_rows: How many status words there are.
        without: Where a flag that should be set was last not set, for those of `WANTED`.
        tracks: Where the device was, by quantity.
        positions: Rows of ``gnss_pvt_data`` with a fix, and all.
        restarts: How often the device has started, the beginning not counted.
        settings: What the messages say, each once; no more than `SETTINGS`.
    """

    def __init__(self, parts: Iterable[Log]) -> None:
        self.facts = LogSummary(())
        self.axis = Axis()
        self.utc: np.datetime64 | None = None
        self.steps = Curves(("step",))
        self.end = 0.0
        self.lost, self.damage = Bands(), Bands()
        self.gaps: list[float] = []
        self.events: list[float] = []
        self.flags: dict[tuple[str, int], Flag] = {}
        self.status_rows = 0
        self.without: dict[str, float] = {}
        self.tracks: dict[str, Track] = {}
        self.positions = 0, 0
        self.restarts = 0
        self.settings: list[Setting] = []
        self._series: dict[tuple[str, str | None], Series] = {}
        self._said: set[tuple[str, str]] = set()
        self._last_step: float | None = None
        for part in parts:
            self._add(part)

    @property
    def series(self) -> list[Series]:
        """Quantities in the order in which they were first seen."""
        return list(self._series.values())

    def _add(self, part: Log) -> None:
        gaps, damage = len(self.facts.gaps), len(self.facts.damage)
        self.facts.add(part)
        last = self.axis.last
        x = self.axis.places(part)
        if self.utc is None and self.axis.kind == "time":
            self._find_utc(part, x)
        before = np.concatenate(([last], x))
        self._add_lost(part, x, before, gaps, damage)
        new = self.facts.events[len(self.events) :]
        self.events += [float(before[event.sample - part.first_sample]) for event in new]
        self._add_steps(part, x)
        # The byte says again what the word says.
        status = next((it for it in STATUS if it in part), None)
        for key in part:
            column = part[key]
            time = x[column.sample - part.first_sample]
            series = self._series.setdefault((column.name, column.coordinates), Series(column))
            breaks = series.add(column, time)
            if column.name == status:
                self._add_status(column, time, breaks, series.steps.usual)
            if column.name in SOURCES:
                self.tracks.setdefault(column.name, Track()).add(column, time, breaks)
            if column.name == "gnss_pvt_data":
                fixes = int(np.count_nonzero(has_fix(column.values)))
                self.positions = self.positions[0] + fixes, self.positions[1] + len(column)
        self._add_settings(part, x)
        woken = (part.messages.mid == MessageId.WakeUp) & (part.messages.sample > 0)
        self.restarts += int(np.count_nonzero(woken))
        if len(x):
            self.end = max(self.end, float(x.max()))

    def _find_utc(self, part: Log, x: FloatArray) -> None:
        known = np.flatnonzero(~np.isnat(part.utc) & np.isfinite(steady_time(part)))
        if len(known):
            since = np.timedelta64(round(x[known[0]] * 1e9), "ns")
            self.utc = part.utc[known[0]] - since

    def _add_lost(
        self, part: Log, x: FloatArray, before: FloatArray, gaps: int, damage: int
    ) -> None:
        """Where the gaps and the damage are that this part has added."""
        if found := self.facts.gaps[gaps:]:
            rows = np.array([it.sample for it in found]) - part.first_sample
            self.gaps += x[rows].tolist()
            lost = [it.lost for it in found]
            self.lost.add(np.minimum(before[rows], x[rows]), x[rows], lost)
        if spoilt := self.facts.damage[damage:]:
            offsets, lengths, _ = zip(*spoilt, strict=True)
            rows = np.searchsorted(part.offset, offsets)
            after = np.append(x, before[-1])[rows]
            self.damage.add(np.minimum(before[rows], after), after, lengths)

    def _add_steps(self, part: Log, x: FloatArray) -> None:
        """Time between samples; those of the receiver have a time of their own."""
        if self.axis.kind != "time":
            return
        time = x[np.isfinite(steady_time(part))]
        if self._last_step is not None:
            time = np.concatenate(([self._last_step], time))
        if len(time):
            self._last_step = float(time[-1])
            self.steps.add(time[1:], 1000 * np.diff(time)[:, None], np.zeros(len(time) - 1, bool))

    def _add_status(
        self, column: Column, time: FloatArray, breaks: BoolArray, usual: float
    ) -> None:
        words = column.values
        self.status_rows += len(words)
        if not len(words):
            return
        for field in WANTED:
            if len(missing := np.flatnonzero(words >> field.bit & 1 == 0)):
                self.without[field.name] = float(time[missing[-1]])
        # Stretches of equal words; each lasts until the next begins, or as long as a row does.
        changes = np.concatenate(([True], (words[1:] != words[:-1]) | breaks[1:]))
        first = np.flatnonzero(changes)
        rows = np.diff(first, append=len(words))
        start = time[first]
        end = time[first + rows - 1] + (usual if np.isfinite(usual) else 0.0)
        follows = np.append(~breaks[first[1:]], False)
        end = np.where(follows, np.append(start[1:], 0.0), end)
        for field in STATUS_FLAGS:
            if field.bit + field.width > 8 * words.dtype.itemsize:
                continue
            values = words[first] >> field.bit & ((1 << field.width) - 1)
            for value in np.unique(values[values != 0]).tolist():
                flag = self.flags.setdefault((field.name, value), Flag(field, value))
                on = values == value
                flag.rows += int(rows[on].sum())
                flag.bands.add(start[on], end[on], rows[on])

    def _add_settings(self, part: Log, x: FloatArray) -> None:
        for at in np.flatnonzero(~np.isin(part.messages.mid, EVENTS)).tolist():
            if len(self.settings) == SETTINGS:
                return
            message = part.messages[at]
            words = describe_message(message)
            if not words or words.endswith(" bytes") or (message.name, words) in self._said:
                continue
            self._said.add((message.name, words))
            row = message.sample - part.first_sample
            time = float(x[row]) if row < len(x) else self.axis.last
            self.settings.append(Setting(time, message.name, words))
