"""The content of a report, collected part by part: the log need not fit into memory."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from xbus.describe.listing import FirstRows, LargestRows
from xbus.describe.log_summary import EVENT_MIDS, LogSummary
from xbus.describe.text import describe_message
from xbus.export.valid import has_fix
from xbus.log.axis import Axis
from xbus.log.column import Column
from xbus.log.log import Log
from xbus.log.runs import steady_time
from xbus.plots.panels import MAGNETIC, panel_rows
from xbus.plots.thin import Bands, BoolArray, Curves, FloatArray, Steps
from xbus.protocol.tables import COLUMN_QUANTITIES, STATUS_FLAGS, StatusFlag, device_of
from xbus.protocol.undecoded import output_mids
from xbus.report.allan import Longest
from xbus.report.clock import Clock, ClockPiece
from xbus.report.field_quality import FieldRows
from xbus.report.spectrum import Spectrum
from xbus.report.track import SOURCES, Track

__all__ = ["Flag", "Options", "Panel", "ReportData", "Series", "Setting"]

#: Quantities with an Allan deviation.
NOISY = ("acceleration", "acceleration_hr", "rate_of_turn", "rate_of_turn_hr")
STATUS = ("status_word", "status_byte")
#: Panels of which the section about the track shows everything.
IN_TRACK = {
    ("lat_lon", "latitude"),
    ("lat_lon", "longitude"),
    ("position_ecef", ""),
    ("altitude_ellipsoid", ""),
    ("altitude_msl", ""),
    ("gnss_pvt_data", "height"),
    ("gnss_pvt_data", "stated accuracy"),
}
#: Flags that should be set.
EXPECTED = [STATUS_FLAGS[name] for name in ("filter_valid", "gnss_fix")]
#: Index of the sample after a gap, number of missing samples, and position of that sample.
GAP = np.dtype([("sample", "i8"), ("lost", "i8"), ("position", "f8")])
#: Maximum number of listed settings; a log with many commands contains more.
MAX_SETTINGS = 100
#: Maximum number of gaps, places of damage and events in a table; ``xbus info --json`` lists more.
MAX_ROWS = 100
#: Maximum number of messages in which settings are looked for.
MAX_EXAMINED = 10_000


class Panel(NamedTuple):
    """One plot of a quantity.

    Attributes:
        title: Title of the plot; empty if the quantity has one plot.
        unit: Unit of all curves.
        curves: The curves.
    """

    title: str
    unit: str
    curves: Curves


class Options(NamedTuple):
    """What a report has on request.

    Attributes:
        spectrum: The spectrum of acceleration and rate of turn.
        spectrogram: The same over time.
        base_map: A map below the track, which needs a network when the page is opened.
    """

    spectrum: bool = False
    spectrogram: bool = False
    base_map: bool = False


class Series:
    """One quantity of a device over time.

    Attributes:
        device: ``"BID 2"`` in a log of several devices, else empty.
        panels: The plots by title.
        steps: Time between rows.
        longest: The longest stretch without a gap; None for quantities without an Allan deviation.
        spectrum: The spectrum, for the same quantities; None if it is not wanted.
        field: The rows to judge a magnetic field by; None for other quantities.
    """

    def __init__(self, column: Column, options: Options) -> None:
        self.name = column.name
        self.coordinates = column.coordinates
        self.device = ""
        self.panels: dict[str, Panel] = {}
        self.steps = Steps()
        self.longest = Longest(3) if column.name in NOISY else None
        has_spectrum = column.name in NOISY and (options.spectrum or options.spectrogram)
        self.spectrum = Spectrum() if has_spectrum else None
        self.field = FieldRows() if column.name in MAGNETIC else None
        #: Number of the run of the last row; -1 before the first row.
        self._run = -1

    @property
    def label(self) -> str:
        """Name and device."""
        return ", ".join(filter(None, (self.name, self.device)))

    @property
    def title(self) -> str:
        """Name, device and coordinates."""
        return ", ".join(filter(None, (self.name, self.device, self.coordinates)))

    @property
    def anchor(self) -> str:
        """The target of links to it."""
        coordinates = None if self.coordinates == "ENU" else self.coordinates
        return "-".join(filter(None, (self.name, coordinates, self.device.replace(" ", ""))))

    def add(self, column: Column, time: FloatArray, run: npt.NDArray[np.int64]) -> BoolArray:
        """Adds the next rows.

        Args:
            column: The rows.
            time: Their positions on the axis, ``(N,)``.
            run: The numbers of their runs, ``(N,)``.

        Returns:
            Whether rows are missing before each row, or its run begins there, ``(N,)``.
        """
        starts = run_starts(run, self._run)
        self._run = int(run[-1]) if len(run) else self._run
        breaks = self.steps.breaks(time, starts)
        for rows in panel_rows(column):
            panel = Panel(rows.title, rows.unit, Curves(rows.names))
            self.panels.setdefault(rows.title, panel).curves.add(time, rows.values, breaks)
        if self.longest is not None:
            self.longest.add(time, column.values, breaks)
        if self.spectrum is not None:
            self.spectrum.add(time, column.values, breaks)
        if self.field is not None:
            self.field.add(column.values)
        return breaks


def run_starts(run: npt.NDArray[np.int64], last: int) -> BoolArray:
    """Returns whether each row is the first of its run, ``(N,)``, and not the first of all.

    Args:
        run: The numbers of the runs, ``(N,)``.
        last: The number for the row before; -1 if there is none.
    """
    starts = np.diff(run, prepend=run[:1] if last < 0 else last) != 0
    return np.asarray(starts, np.bool_)


class Flag:
    """A value other than zero of a field of the status word.

    Attributes:
        meaning: Meaning of the field (Table 27).
        rows: Number of status words with this value.
        bands: The times of these status words.
    """

    def __init__(self, field: StatusFlag, value: int) -> None:
        self.name, self.value, self.meaning = field.name, value, field.meaning
        self._has_values = field.width > 1
        self.rows = 0
        self.bands = Bands()

    @property
    def label(self) -> str:
        """The name; for a field of several bits, with the value."""
        return f"{self.name} = {self.value}" if self._has_values else self.name


class Setting(NamedTuple):
    """A message that is not an event.

    Attributes:
        time: Position of the next sample on the axis.
        name: Name of the message.
        text: Content of the message.
    """

    time: float
    name: str
    text: str


class ReportData:
    """The content of a report.

    Attributes:
        options: What the report has on request.
        summary: The content of ``xbus info``.
        axis: The horizontal axis.
        steps: Time between samples of each device, ms, by BID.
        end: Position of the last sample on the axis.
        lost, damage: Times of missing samples and damaged bytes; the weights count them.
        gaps: The largest gaps, `GAP`.
        events: Positions of the first events of the summary.
        marks: Times of errors and warnings, by name.
        flags: Fields of the status word that were ever set, by name and value.
        status_rows: Number of status words.
        last_unset: When each flag of `EXPECTED` was last not set.
        tracks: Positions, by quantity, the best first; in a log of several devices by quantity and BID.
        positions: Number of rows of ``gnss_pvt_data`` with a fix, and of all rows.
        settings: Messages that are not events, without repetitions; at most `MAX_SETTINGS`.
    """

    def __init__(self, parts: Iterable[Log], options: Options) -> None:
        self.options = options
        self.summary = LogSummary(())
        self.axis = Axis()
        self._clocks: dict[int, Clock] = {}
        self.steps: dict[int, Curves] = {}
        self.end = 0.0
        self.lost, self.damage = Bands(), Bands()
        self.gaps = LargestRows(GAP, "lost", MAX_ROWS)
        self.events = FirstRows(np.dtype("f8"), MAX_ROWS)
        self.marks: dict[str, Bands] = {"Error": Bands(), "Warning": Bands()}
        self.flags: dict[tuple[str, int], Flag] = {}
        self.status_rows = 0
        self.last_unset: dict[str, float] = {}
        self.positions = 0, 0
        self.settings: list[Setting] = []
        self._series: dict[tuple[str, str | None, int], Series] = {}
        self._tracks: dict[tuple[str, int], Track] = {}
        self._seen: set[tuple[str, str]] = set()
        self._examined = 0
        #: Position and run of the last sample with a time stamp of each device.
        self._last_step: dict[int, tuple[float, int]] = {}
        #: Position of the last sample of each device.
        self._last: dict[int, float] = {}
        for part in parts:
            self._add(part)
        is_one = len(self.axis.devices) < 2
        for (_, _, bid), series in self._series.items():
            series.device = "" if is_one else f"BID {bid}"
        order = sorted(self._tracks, key=lambda key: (SOURCES.index(key[0]), key[1]))
        self.tracks = {
            name if is_one else f"{name}, BID {bid}": self._tracks[name, bid] for name, bid in order
        }

    @property
    def restarts(self) -> int:
        """Number of restarts of the devices."""
        return sum(len(device.restarts) for device in self.summary.devices)

    @property
    def clock(self) -> list[ClockPiece]:
        """UTC along the axis: that of the first device that knows it; empty if none does."""
        return next(filter(None, (clock.pieces() for clock in self._clocks.values())), [])

    @property
    def utc(self) -> np.datetime64 | None:
        """UTC at the origin, or None."""
        first = next(iter(self.clock), None)
        if first is None or first.utc is None or first.start > 0:
            return None
        return np.datetime64(first.utc, "ns")

    @property
    def is_examining(self) -> bool:
        """Whether all messages about settings are known so far."""
        return self._examined < MAX_EXAMINED and len(self.settings) < MAX_SETTINGS

    @property
    def has_counter(self) -> bool:
        """Whether the log has a packet counter."""
        return self.summary.has_counter

    @property
    def series(self) -> list[Series]:
        """The quantities, in order of first appearance."""
        return list(self._series.values())

    def panels(self, series: Series) -> list[Panel]:
        """Returns the plots of a quantity, without those that the section about the track has."""
        has_track = any(track.rows for track in self.tracks.values())
        return [
            panel
            for title, panel in series.panels.items()
            if not (has_track and (series.name, title) in IN_TRACK)
        ]

    def anchor(self, series: Series) -> str:
        """Returns the target of links to a quantity, or an empty string."""
        if self.panels(series):
            return series.anchor
        if series.panels:
            return "track"
        return "status" if series.name in STATUS else ""

    def _add(self, part: Log) -> None:
        runs = self.summary.add(part)
        last = self.axis.last
        x = self.axis.positions(part.core, runs.run)
        before = np.concatenate(([last], x))
        self._add_damage(part, x, before)
        self._add_events(part, before)
        self._add_gaps(part, x)
        devices = device_of(part.bid)
        for bid in np.unique(devices).tolist():
            is_own = devices == bid
            own = part if is_own.all() else part.of_device(bid, part.first_sample)
            self._add_device(own, bid, x[is_own], runs.run[is_own])
        self._add_settings(part, x)
        if len(x):
            self.end = max(self.end, float(x.max()))

    def _add_device(self, part: Log, bid: int, x: FloatArray, run: npt.NDArray[np.int64]) -> None:
        """Adds the samples of one device at these positions, and the numbers of their runs."""
        self._last[bid] = float(x[-1])
        if self.axis.kind == "time":
            is_steady = np.isfinite(steady_time(part.core))
            self._clocks.setdefault(bid, Clock()).add(x, run, part.utc, is_steady)
        self._add_steps(part, bid, x, run)
        # The status byte repeats a part of the status word.
        status = next((name for name in STATUS if name in part), None)
        for key in part:
            column = part[key]
            rows = column.sample - part.first_sample
            time = x[rows]
            name = column.name, column.coordinates, bid
            if (series := self._series.get(name)) is None:
                series = self._series[name] = Series(column, self.options)
            breaks = series.add(column, time, run[rows])
            if column.name == status:
                self._add_status(column, time, breaks, series.steps.usual)
            if column.name in SOURCES:
                self._tracks.setdefault((column.name, bid), Track()).add(part, column, time, breaks)
            if column.name == "gnss_pvt_data":
                fixes = int(np.count_nonzero(has_fix(column.values)))
                self.positions = self.positions[0] + fixes, self.positions[1] + len(column)

    def _add_gaps(self, part: Log, x: FloatArray) -> None:
        """Adds the gaps of this part: each is between two samples of one device."""
        found = part.gaps
        if not len(found):
            return
        devices = device_of(part.bid)
        rows = found["sample"] - part.first_sample
        before = np.empty(len(rows))
        for bid in np.unique(devices[rows]).tolist():
            own = np.flatnonzero(devices == bid)
            positions = np.concatenate(([self._last.get(bid, x[own[0]])], x[own]))
            is_own = devices[rows] == bid
            before[is_own] = positions[np.searchsorted(own, rows[is_own])]
        gaps = np.empty(len(found), GAP)
        gaps["sample"], gaps["lost"], gaps["position"] = found["sample"], found["lost"], x[rows]
        self.gaps.add(gaps)
        self.lost.add(np.minimum(before, x[rows]), x[rows], found["lost"])

    def _add_damage(self, part: Log, x: FloatArray, before: FloatArray) -> None:
        """Adds the damage of this part, with the positions of its samples and of those before them."""
        found = part.core.damage
        if len(found.offset):
            rows = np.searchsorted(part.offset, found.offset)
            after = np.append(x, before[-1])[rows]
            self.damage.add(np.minimum(before[rows], after), after, found.length)

    def _add_events(self, part: Log, before: FloatArray) -> None:
        """Adds errors and warnings, with the positions of the samples before those of this part."""
        messages = part.messages
        for mid, marks in zip(EVENT_MIDS, self.marks.values(), strict=True):
            times = before[messages.sample[messages.mid == mid] - part.first_sample]
            marks.add(times, times, np.ones(len(times)))
        is_event = np.isin(messages.mid, EVENT_MIDS)
        self.events.add(before[messages.sample[is_event] - part.first_sample])

    def _add_steps(self, part: Log, bid: int, x: FloatArray, run: npt.NDArray[np.int64]) -> None:
        """Adds the time between samples; times of the GNSS receiver are not comparable."""
        if self.axis.kind != "time":
            return
        is_steady = np.isfinite(steady_time(part.core))
        time, run = x[is_steady], run[is_steady]
        if bid in self._last_step:
            last, last_run = self._last_step[bid]
            time, run = np.concatenate(([last], time)), np.concatenate(([last_run], run))
        if len(time):
            self._last_step[bid] = float(time[-1]), int(run[-1])
            starts = run[1:] != run[:-1]  # how long a restart took is not known
            steps = 1000 * np.diff(time)[:, None]
            steps[starts] = np.nan
            curves = self.steps.setdefault(bid, Curves(("step",)))
            curves.add(time[1:], steps, starts)

    def _add_status(
        self, column: Column, time: FloatArray, breaks: BoolArray, usual: float
    ) -> None:
        words = column.values
        self.status_rows += len(words)
        if not len(words):
            return
        for field in EXPECTED:
            if len(missing := np.flatnonzero(field.of(words) == 0)):
                self.last_unset[field.name] = float(time[missing[-1]])
        # Each stretch of equal words lasts until the next one, or for the usual time of a row.
        changes = np.concatenate(([True], (words[1:] != words[:-1]) | breaks[1:]))
        first = np.flatnonzero(changes)
        rows = np.diff(first, append=len(words))
        start = time[first]
        end = time[first + rows - 1] + (usual if np.isfinite(usual) else 0.0)
        follows = np.append(~breaks[first[1:]], False)
        end = np.where(follows, np.append(start[1:], 0.0), end)
        for field in COLUMN_QUANTITIES[column.name].flags:
            values = field.of(words[first])
            for value in np.unique(values[values != 0]).tolist():
                flag = self.flags.setdefault((field.name, value), Flag(field, value))
                on = values == value
                flag.rows += int(rows[on].sum())
                flag.bands.add(start[on], end[on], rows[on])

    def _add_settings(self, part: Log, x: FloatArray) -> None:
        others = [*EVENT_MIDS, *output_mids(np.unique(part.messages.mid).tolist())]
        for at in np.flatnonzero(~np.isin(part.messages.mid, others)).tolist():
            if not self.is_examining:
                return
            self._examined += 1
            message = part.messages[at]
            text = describe_message(message)
            if not text or text.endswith(" bytes") or (message.name, text) in self._seen:
                continue
            self._seen.add((message.name, text))
            row = message.sample - part.first_sample
            time = float(x[row]) if row < len(x) else self.axis.last
            self.settings.append(Setting(time, message.name, text))
