"""Parts of a log as columns of a rerun recording."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from xbus.errors import XbusError
from xbus.export.part import Part, PartColumn, PartDevice
from xbus.export.rerun.events import Event, StatusChanges, events_of
from xbus.export.rerun.scene import Scene
from xbus.export.rerun.times import Clock, Times
from xbus.export.valid import has_fix, has_position, known_time
from xbus.extras import require
from xbus.formatting import device_name
from xbus.geometry.earth import ecef_to_geodetic
from xbus.geometry.quaternion import from_euler, from_matrix
from xbus.protocol.tables import COLUMN_QUANTITIES, Field, device_of

__all__ = ["RerunStream", "names_of", "new_recording"]

#: Identifier of the application in recordings: the viewer keeps its layout for each.
APPLICATION = "xbus"
#: Quantities that hold an orientation, the preferred one first.
ORIENTATIONS = ("quaternion", "rotation_matrix", "euler_angles")
#: Positions, clocks, identifiers and lists, which are no series.
NO_SERIES = (
    "lat_lon",
    "utc_time",
    "gps_time_utc",
    "itow",
    "sample_time64",
    "packet_counter8",
    "packet_counter32",
    "frame_range",
    "gnss_pvt_pulse",
    "device_id",
    "location_id",
    "gnss_sat_info",
    "awinda_snapshot",
)
#: Roles of quantities in the clock; those are no series.
CLOCKS = ("counter", "fine", "coarse")
#: Fields of structs that are dates, or on the map.
NO_SERIES_FIELDS = (
    "itow",
    "year",
    "month",
    "day",
    "hour",
    "min",
    "sec",
    "nano",
    "valid",
    "timestamp",
    "Reserved1",
    "lat",
    "lon",
)
#: Positions per second on the map, which the viewer draws one by one.
MAP_RATE = 10

Rows = npt.NDArray[np.intp]


def new_recording() -> Any:
    """Returns a recording stream of rerun, without a place where it sends data.

    Raises:
        ImportError: The extra ``rerun`` is not installed.
        XbusError: The environment switches rerun off.
    """
    rerun = require("rerun", "rerun", "to write for the viewer rerun")
    recording = rerun.RecordingStream(APPLICATION)
    if not rerun.is_enabled(recording):
        raise XbusError("the environment variable RERUN switches rerun off; unset it")
    return recording


def names_of(devices: Iterable[PartDevice]) -> dict[int, int]:
    """Returns the known identifiers of devices, as `RerunStream` takes them."""
    return {
        device_of(found.bid): found.device_id for found in devices if found.device_id is not None
    }


@dataclass
class _Device:
    """A device.

    Attributes:
        path: Path of its entities.
        bid: Bus identifier of its first sample.
        clock: Its clock.
        status: The changes of its status.
        mapped: For each quantity with positions when the last one was put on the map, in steps of the map.
    """

    path: str
    bid: int
    clock: Clock = field(default_factory=Clock)
    status: StatusChanges = field(default_factory=StatusChanges)
    mapped: dict[str, float] = field(default_factory=dict)


class RerunStream:
    """Sends parts of a log, or blocks of live samples, to a recording stream of rerun.

    Entities are below the identifier of their device, or ``bid_N`` if it is not known. The timelines are
    ``sample``, ``device_time``, ``utc`` and ``host_time``; a row is on those on which its sample has a time.

    Args:
        recording: The recording stream.
        names: Device identifiers by bus identifier (1 stands for FF too), where parts do not have them.
    """

    def __init__(self, recording: Any, names: Mapping[int, int] | None = None) -> None:
        self._rr = require("rerun", "rerun", "to write for the viewer rerun")
        self._recording = recording
        self._names = dict(names or {})
        self._scene = Scene(self._rr, recording)
        self._devices: dict[int, _Device] = {}
        #: Events of which the next sample has not come yet.
        self._waiting: list[Event] = []
        self._last: Times | None = None
        #: The number of samples and events that were sent.
        self.samples = self.events = 0

    def write(self, part: Part) -> None:
        """Sends the next part."""
        events = [*self._waiting, *events_of(part)]
        if not len(part):
            self._waiting = events
            return
        devices = device_of(part.bid)
        found, first = np.unique(devices, return_index=True)
        in_order = found[np.argsort(first)].tolist()
        rows = {device: np.flatnonzero(devices == device) for device in in_order}
        time = known_time(part)
        for device, own in rows.items():
            self._add_device(device, part, own)
            events += self._shift(device, part, time, own)
        times = Times.of(part, time)
        is_drawn = np.zeros(len(part), np.bool_)
        for column in _columns(part):
            of_rows = devices[column.sample - part.first_sample]
            for device in rows:
                own = np.flatnonzero(of_rows == device)
                if len(own):
                    events += self._write(self._devices[device], part, column, own, times, is_drawn)
        events.sort(key=lambda event: event.sample)
        now = [event for event in events if event.sample < times.end]
        self._waiting, self._last = events[len(now) :], times.last
        self._write_events(now, times)
        self.samples += len(part)
        if self._scene.has_changed:
            self._scene.send_layout()

    def note(self, text: str, level: str = "INFO") -> None:
        """Sends an event that happens now."""
        end = 0 if self._last is None else self._last.end
        self._waiting.append(Event(end, None, level, text))
        self.close()

    def close(self) -> None:
        """Sends the events after the last sample."""
        if self._last is not None:
            last = self._last.end - 1
            self._write_events([event._replace(sample=last) for event in self._waiting], self._last)
            self._waiting = []

    def _add_device(self, device: int, part: Part, rows: Rows) -> None:
        if device in self._devices:
            return
        number = self._names.get(device) or names_of(part.devices).get(device)
        path = f"bid_{device}" if number is None else device_name(number)
        self._devices[device] = _Device(path, int(part.bid[rows[0]]))
        self._scene.add_device(path)

    def _shift(
        self, device: int, part: Part, time: npt.NDArray[np.float64], rows: Rows
    ) -> Iterator[Event]:
        """Replaces times of a device by those that do not overlap, and yields an event for each shift."""
        found = self._devices[device]
        starts = np.flatnonzero(np.isin(rows + part.first_sample, part.restarts))
        time[rows], shifts = found.clock.shifted(time[rows], starts)
        for row, shift in shifts:
            text = f"device_time is the clock of the device plus {shift:,.4f} s"
            yield Event(int(rows[row]) + part.first_sample, found.bid, "INFO", text)

    def _write(
        self,
        device: _Device,
        part: Part,
        column: PartColumn,
        rows: Rows,
        times: Times,
        is_drawn: npt.NDArray[np.bool_],
    ) -> Iterator[Event]:
        """Sends the rows of a device, and yields changes of its status."""
        path, name = device.path, column.name
        row = COLUMN_QUANTITIES[name]
        if row.has_flags:
            yield from device.status.of(column, rows, device.bid)
            return
        if name in ORIENTATIONS:
            self._write_orientation(path, column, rows, times, is_drawn)
        if name == "lat_lon" or (name == "position_ecef" and "lat_lon" not in part):
            self._write_map(device, column, rows[has_position(part, column)[rows]], times)
        elif name == "gnss_pvt_data":
            self._write_map(device, column, rows[has_fix(column.values[rows])], times)
        if row.clock in CLOCKS or name in NO_SERIES:
            return
        if column.coordinates is not None:
            name = f"{name}_{column.coordinates.lower()}"
        entity = f"{path}/{name}"
        if not row.fields:
            lines = [*column.fields] or [name]
            self._scene.add_series(path, _with_unit(name, column.unit), entity, lines)
            self._send(entity, column, rows, times, column.values.reshape(len(column), -1))
        for part_of in row.fields:
            if part_of.name not in NO_SERIES_FIELDS:
                entity = f"{path}/{name}/{part_of.name}"
                self._scene.add_series(path, _title(name, part_of), entity, [part_of.name])
                self._send(entity, column, rows, times, column.scaled[part_of.name])

    def _send(
        self,
        entity: str,
        column: PartColumn,
        rows: Rows,
        times: Times,
        values: npt.NDArray[Any],
    ) -> None:
        for own, indexes in times.columns(column.sample[rows]):
            with np.errstate(invalid="ignore"):  # a signalling NaN becomes a quiet one
                numbers = self._rr.Scalars.columns(scalars=values[rows[own]])
            self._recording.send_columns(entity, indexes, numbers)

    def _write_orientation(
        self,
        path: str,
        column: PartColumn,
        rows: Rows,
        times: Times,
        is_drawn: npt.NDArray[np.bool_],
    ) -> None:
        """Sends the orientations of samples that have none from a preferred quantity."""
        assert column.coordinates is not None  # noqa: S101 - orientations have coordinates
        entity = self._scene.add_body(path, column.coordinates)
        at = column.sample - times.first
        rows = rows[~is_drawn[at[rows]]]
        is_drawn[at[rows]] = True
        for own, indexes in times.columns(column.sample[rows]):
            rotations = _rotations(column.name, column.values[rows[own]])
            self._recording.send_columns(
                entity, indexes, self._rr.Transform3D.columns(quaternion=rotations)
            )

    def _write_map(self, device: _Device, column: PartColumn, rows: Rows, times: Times) -> None:
        """Sends positions, at most `MAP_RATE` per second."""
        if not len(rows):
            return
        entity = f"{device.path}/{column.name}/position"
        self._scene.add_map(entity)
        steps = np.floor(column.time[rows] * MAP_RATE)
        before = np.concatenate(([device.mapped.get(column.name, np.nan)], steps[:-1]))
        device.mapped[column.name] = float(steps[-1])
        rows = rows[steps != before]  # NaN, for no time stamp, differs from NaN
        if column.name == "position_ecef":
            lat, lon, _ = ecef_to_geodetic(column.values[rows].astype(np.float64))
        else:
            fields = column.scaled if column.name == "gnss_pvt_data" else column
            lat, lon = fields["lat"][rows], fields["lon"][rows]
        degrees = np.stack((lat, lon), axis=1)
        for own, indexes in times.columns(column.sample[rows]):
            positions = degrees[own]
            self._recording.send_columns(
                entity, indexes, self._rr.GeoPoints.columns(positions=positions)
            )

    def _write_events(self, events: list[Event], times: Times) -> None:
        by_path: dict[str, list[Event]] = {}
        for event in events:
            by_path.setdefault(self._path_of(event), []).append(event)
        for path, own in by_path.items():
            samples = np.array([event.sample for event in own], np.int64)
            texts = np.array([event.text for event in own], object)
            levels = np.array([event.level for event in own], object)
            for rows, indexes in times.columns(samples):
                log = self._rr.TextLog.columns(text=texts[rows], level=levels[rows])
                self._recording.send_columns(f"{path}events", indexes, log)
        self.events += len(events)

    def _path_of(self, event: Event) -> str:
        """Returns the path of the device of an event, with a slash at the end; empty if it has none."""
        if event.bid is None:
            return ""
        device = device_of(event.bid)
        found = self._devices.get(device)
        return f"bid_{device}/" if found is None else f"{found.path}/"


def _columns(part: Part) -> Iterator[PartColumn]:
    """Yields the columns of a part; those with orientations come first, in the order of preference."""
    columns = [part[key] for key in part]
    preferred = {name: place for place, name in enumerate(ORIENTATIONS)}
    yield from sorted(columns, key=lambda column: preferred.get(column.name, len(preferred)))


def _rotations(name: str, values: npt.NDArray[Any]) -> npt.NDArray[np.float32]:
    """Returns orientations as quaternions x, y, z, w, ``(n, 4)``."""
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        if name == "rotation_matrix":
            values = from_matrix(values)
        elif name == "euler_angles":
            values = from_euler(values)
        return values[:, [1, 2, 3, 0]].astype(np.float32)


def _title(name: str, part_of: Field) -> str:
    """Returns the title of the plot of a field: accuracies have plots of their own, and so have DOPs."""
    for end, text in {"Acc": " accuracy", "dop": " dilution of precision"}.items():
        if part_of.name.endswith(end):
            name += text
    return _with_unit(name, part_of.unit)


def _with_unit(name: str, unit: str) -> str:
    return f"{name}, {unit}" if unit else name
