"""A summary of a log, built part by part: the log need not fit into memory."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import asdict, fields
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from xbus.describe.text import (
    ResultCode,
    device_name,
    finite,
    known_digits,
    read_result_code,
    recording_date,
)
from xbus.log.column import Column
from xbus.log.identity import IDENTITY_MESSAGES, Identity, identities_of, identity_of
from xbus.log.log import DAMAGE, Log, steady_time
from xbus.log.rates import Rates
from xbus.log.runs import PartRuns, Run, Runs, recorded
from xbus.log.stats import Stats
from xbus.log.trackers import count_losses, frames_of
from xbus.protocol.configuration import Configuration
from xbus.protocol.ids import MessageId
from xbus.protocol.tables import QUANTITIES, UTC_VALID, device_of
from xbus.protocol.undecoded import Undecoded

__all__ = [
    "DeviceSummary",
    "Event",
    "Gap",
    "LogSummary",
    "QuantitySummary",
    "Stamp",
    "TrackerSummary",
]


class Stamp(NamedTuple):
    """A time stamp: the number of its run in `LogSummary.runs`, and unwrapped seconds on the device clock."""

    run: int
    time: float


class Gap(NamedTuple):
    """A place where samples are missing.

    Attributes:
        sample: Index of the sample after the gap.
        stamp: Time stamp of that sample, or None.
        lost: Number of missing samples.
        bid: BID of the device.
        before: The last time stamp of the device before the gap, or None.
    """

    sample: int
    stamp: Stamp | None
    lost: int
    bid: int
    before: Stamp | None


class Event(NamedTuple):
    """An Error or Warning message.

    Attributes:
        offset: Byte offset in the input at which its frame begins.
        sample: Index of the next sample.
        before: The last time stamp of the device before it, or None.
        name: ``"Error"`` or ``"Warning"``.
        result: Its code and text.
    """

    offset: int
    sample: int
    before: Stamp | None
    name: str
    result: ResultCode


class _PartStamps:
    """The time stamps of the devices in a part, without those of the GNSS receiver, which has its own time.

    Args:
        part: The part.
        runs: The runs of its samples.
        last: The last stamp of each device before the part.
    """

    def __init__(self, part: Log, runs: PartRuns, last: dict[int, Stamp]) -> None:
        self._run, self._last = runs.run, last
        self._steady = steady_time(part)
        self._devices = device_of(part.bid)
        self._rows: dict[int, npt.NDArray[np.intp]] = {}

    def before(self, row: int, bid: int) -> Stamp | None:
        """Returns the last stamp of a device before a sample, which is counted from the start of the part."""
        device = device_of(bid)
        if device not in self._rows:
            is_own = self._devices == device
            self._rows[device] = np.flatnonzero(is_own & np.isfinite(self._steady))
        rows = self._rows[device]
        at = int(np.searchsorted(rows, row)) - 1
        if at < 0:
            return self._last.get(device)
        return Stamp(int(self._run[rows[at]]), float(self._steady[rows[at]]))

    def last(self) -> dict[int, Stamp]:
        """Returns the last stamp of each device up to the end of the part."""
        devices = [*self._last, *np.unique(self._devices).tolist()]
        ends = {device: self.before(len(self._run), device) for device in devices}
        return {device: stamp for device, stamp in ends.items() if stamp is not None}


class TrackerSummary(NamedTuple):
    """An Awinda tracker.

    Attributes:
        device_id: Its identifier in hex.
        rows: Number of snapshots, with those that were sent again.
        lost_samples: Number of missing frame numbers.
        gaps: Number of places at which they are missing.
    """

    device_id: str
    rows: int
    lost_samples: int
    gaps: int


class DeviceSummary:
    """One device of a log: identity, number of samples, runs and rate.

    Attributes:
        bid: Bus identifier, as in its first sample.
        identity: Identifier, product code and firmware.
        runs: Its runs, in order.
    """

    def __init__(
        self, bid: int, identity: Identity, runs: list[Run], rates: Rates, *, has_counter: bool
    ) -> None:
        self.bid, self.identity, self.runs = bid, identity, runs
        self.rate = rates.mean
        self.nominal_rate = rates.nominal(self.samples, has_counter=has_counter)

    @property
    def samples(self) -> int:
        """Number of samples."""
        return sum(run.samples for run in self.runs)

    @property
    def lost(self) -> int:
        """Number of lost samples."""
        return sum(run.lost for run in self.runs)

    @property
    def duration(self) -> float:
        """Seconds recorded; NaN if not known."""
        return recorded(self.runs)

    @property
    def restarts(self) -> list[float]:
        """Seconds that were recorded before each restart."""
        seconds, restarts = 0.0, []
        for run in self.runs[:-1]:
            seconds += run.span.duration if run.span.stamps > 1 else 0.0
            restarts.append(seconds)
        return restarts

    def to_dict(self) -> dict[str, Any]:
        """Returns the summary as plain values for JSON."""
        return {
            "bid": self.bid,
            **_identity_dict(self.identity),
            "samples": self.samples,
            "lost_samples": self.lost,
            "duration_s": known_digits(self.duration),
            "rate_hz": known_digits(self.rate),
            "nominal_rate_hz": known_digits(self.nominal_rate),
        }


class QuantitySummary:
    """One quantity of a log: name, format, number of rows and rate."""

    def __init__(self, log: LogSummary, column: Column) -> None:
        self._log = log
        self.name = column.name
        self.coordinates = column.coordinates
        self.unit = column.unit
        self.rows = 0
        self._rates = Rates()
        self._precisions: set[str | None] = set()
        self._ids: set[int] = set()

    def add(self, column: Column, part: Log, runs: PartRuns) -> None:
        """Adds the column of the next part, whose samples belong to ``runs``."""
        self.rows += len(column)
        self._precisions.add(column.precision)
        self._ids.add(column.data_id)
        samples = column.sample - part.first_sample
        self._rates.add(runs, samples, part.time)

    @property
    def rate(self) -> float:
        """Rows per second, as `Column.rate`."""
        return self._rates.mean

    @property
    def nominal_rate(self) -> float:
        """Rows per second where no sample is missing, as `Column.nominal_rate`."""
        return self._rates.nominal(self._log.stats.samples, has_counter=self._log.has_counter)

    @property
    def precision(self) -> str | None:
        """The precision; None if several occur, and for integers."""
        return next(iter(self._precisions)) if len(self._precisions) == 1 else None

    @property
    def data_id(self) -> int:
        """The data identifier as received; the one with format bits zero if several occur."""
        return next(iter(self._ids)) if len(self._ids) == 1 else QUANTITIES[self.name].id

    def to_dict(self) -> dict[str, Any]:
        """Returns the summary as plain values for JSON."""
        return {
            "name": self.name,
            "coordinates": self.coordinates,
            "data_id": f"0x{self.data_id:04X}",
            "rows": self.rows,
            "rate_hz": known_digits(self.rate),
            "nominal_rate_hz": known_digits(self.nominal_rate),
            "precision": self.precision,
            "unit": self.unit,
        }


class LogSummary:
    """The contents of a log, summarized: the source of ``xbus info`` and of reports.

    Args:
        parts: The parts of the log, in order; more can be added with `add`.

    Attributes:
        stats: Counts of what was read.
        gaps: The places where samples are missing, in order.
        damage: Offset, length and reason of each range of bytes that is neither frame nor string.
        messages: Number of messages by name.
        strings: Number of string outputs by name; those that the manual does not list are ``"others"``.
        events: Errors and warnings that the device sent, in order.
        unknown: Number of packets and bytes by data identifier, of packets that the tables do not explain.
        frames: Frame numbers of Awinda trackers, by device identifier, in the order in which they arrived.
        utc: Earliest and latest UTC time that the device marks as valid, or None.
        utc_rows: Number of UTC times.
        utc_valid: Number of those that the device marks as valid.

    >>> import xbus
    >>> summary = LogSummary([xbus.read_log("tests/captures/walk.mtb")])
    >>> summary.stats.samples, summary.has_counter, len(summary.gaps)
    (1040, True, 0)
    """

    def __init__(self, parts: Iterable[Log]) -> None:
        self.stats = Stats(**{field.name: 0 for field in fields(Stats)})
        self._identities: dict[int, Identity] = {}
        self._runs = Runs()
        self._device_rates: dict[int, Rates] = {}
        self._quantities: dict[tuple[str, str | None], QuantitySummary] = {}
        self.gaps: list[Gap] = []
        self.damage: list[tuple[int, int, str]] = []
        self.messages: Counter[str] = Counter()
        self.strings: Counter[str] = Counter()
        self.events: list[Event] = []
        self.unknown: dict[int, list[int]] = {}
        self._undecoded: dict[tuple[str, int], Undecoded] = {}
        self.frames: dict[int, list[npt.NDArray[np.int64]]] = {}
        self.utc: tuple[np.datetime64, np.datetime64] | None = None
        self.utc_rows = self.utc_valid = 0
        #: The last time stamp of each device.
        self._last: dict[int, Stamp] = {}
        #: `Runs.seconds_before`, if it is known.
        self._before_runs: list[float] | None = None
        for part in parts:
            self.add(part)

    @property
    def quantities(self) -> list[QuantitySummary]:
        """The quantities, in the order in which they were first seen."""
        return list(self._quantities.values())

    @property
    def undecoded(self) -> list[Undecoded]:
        """Output that is not decoded, as `Log.undecoded`."""
        messages = sorted(item for item in self._undecoded.values() if item.kind == "message")
        return [*messages, *(item for item in self._undecoded.values() if item.kind == "packet")]

    @property
    def trackers(self) -> list[TrackerSummary]:
        """The Awinda trackers, in the order in which they were first seen."""
        return [
            TrackerSummary(device_name(device_id), len(frame), *count_losses(frame))
            for device_id, frames in self.frames.items()
            for frame in [np.concatenate(frames)]
        ]

    @property
    def has_counter(self) -> bool:
        """Whether samples have a packet counter, without which losses are not detected."""
        return any(quantity.name == "packet_counter" for quantity in self.quantities)

    @property
    def identity(self) -> Identity:
        """Identifier, product code, firmware and configuration of the device; of the first of several."""
        return identity_of(self._identities, list(self._runs.of_devices()))

    @property
    def runs(self) -> list[Run]:
        """The runs of all devices, as `Log.runs`."""
        return self._runs.all

    @property
    def devices(self) -> list[DeviceSummary]:
        """The devices that sent samples, in the order of their first samples."""
        devices = self._runs.of_devices()
        return [
            DeviceSummary(
                bid,
                identity_of(self._identities, list(devices), bid),
                runs,
                self._device_rates[device_of(bid)],
                has_counter=self.has_counter,
            )
            for bid, runs in devices.items()
        ]

    @property
    def start(self) -> float:
        """Start of the first run with time stamps, in seconds on the device clock; NaN without any."""
        starts = (run.span.start for run in self.runs if run.span.stamps)
        return next(starts, float("nan"))

    @property
    def duration(self) -> float:
        """Seconds recorded, as `Log.duration`."""
        return self._runs.duration

    def seconds_before(self, stamp: Stamp | None) -> float | None:
        """Returns the seconds that a device recorded up to a time stamp, without those between its runs."""
        if stamp is None:
            return None
        if self._before_runs is None:
            self._before_runs = self._runs.seconds_before()
        return self._before_runs[stamp.run] + stamp.time - self.runs[stamp.run].span.start

    def add(self, part: Log) -> PartRuns:
        """Adds the next part, and returns the runs that its samples belong to."""
        counts = asdict(self.stats)
        self.stats = Stats(**{name: counts[name] + n for name, n in asdict(part.stats).items()})
        self._identities = identities_of(
            (message for message in part.messages if message.mid in IDENTITY_MESSAGES),
            self._identities,
        )
        runs = self._runs.add(part.core)
        self._before_runs = None
        devices = device_of(part.bid)
        for device in np.unique(devices).tolist():
            rates = self._device_rates.setdefault(device, Rates())
            samples = np.flatnonzero(devices == device)
            rates.add(runs, samples, part.time)
        self.damage += part.damage.tolist()
        self.strings.update({name or "others": n for name, n in part.strings.counts.items()})
        for column in part.values():
            known = self._quantities.setdefault(
                (column.name, column.coordinates), QuantitySummary(self, column)
            )
            known.add(column, part, runs)
            if column.name == "utc_time":
                self._add_utc(column)
        for device_id, frame in frames_of(part.get("awinda_snapshot")).items():
            self.frames.setdefault(device_id, []).append(frame)
        for item in part.undecoded:
            earlier = self._undecoded.get(item[:2])
            self._undecoded[item[:2]] = item if earlier is None else earlier.plus(item)
        for data_id, packets in part.unknown.items():
            count = self.unknown.setdefault(data_id, [0, 0])
            count[0] += len(packets)
            count[1] += packets.size
        stamps = _PartStamps(part, runs, self._last)
        self._last = stamps.last()
        self._add_gaps(part, runs, stamps)
        self._add_messages(part, stamps)
        return runs

    def _add_utc(self, column: Column) -> None:
        stamps = column.datetime[(column.values["valid"] & UTC_VALID == UTC_VALID)]
        stamps = stamps[~np.isnat(stamps)]
        self.utc_rows += len(column)
        self.utc_valid += len(stamps)
        if len(stamps):
            first, last = self.utc or (stamps[0], stamps[0])
            self.utc = min(first, stamps.min()), max(last, stamps.max())

    def _add_messages(self, part: Log, stamps: _PartStamps) -> None:
        for message in part.messages:
            self.messages[message.name] += 1
            if message.mid in (MessageId.Error, MessageId.Warning):
                before = stamps.before(message.sample - part.first_sample, message.bid)
                result = read_result_code(message)
                event = Event(message.offset, message.sample, before, message.name, result)
                self.events.append(event)

    def _add_gaps(self, part: Log, runs: PartRuns, stamps: _PartStamps) -> None:
        for sample, lost, bid in part.gaps.tolist():
            row = sample - part.first_sample
            time = finite(part.time[row])
            stamp = None if time is None else Stamp(int(runs.run[row]), time)
            self.gaps.append(Gap(sample, stamp, lost, bid, stamps.before(row, bid)))

    def to_dict(self, file: str) -> dict[str, Any]:
        """Returns the summary as plain values for JSON: None for what is not known, and for NaN."""
        stats, configuration = self.stats, self.identity.configuration
        return {
            "file": file,
            "bytes": stats.bytes,
            "device": _identity_dict(self.identity),
            "devices": [device.to_dict() for device in self.devices],
            "recorded": configuration and recording_date(configuration),
            "configuration": configuration and _settings(configuration),
            "utc": self._utc_dict(),
            "start_s": known_digits(self.start),
            "duration_s": known_digits(self.duration),
            "runs": [
                {
                    "bid": run.bid,
                    "first": run.first,
                    "last": run.last,
                    "start_s": known_digits(run.span.start),
                    "duration_s": known_digits(run.span.duration),
                }
                for run in self.runs
            ],
            "frames": stats.frames,
            "samples": stats.samples,
            "lost_samples": stats.lost_samples,
            "gaps": [
                {
                    "sample": gap.sample,
                    "bid": gap.bid,
                    "time_s": gap.stamp and known_digits(gap.stamp.time),
                    "recorded_s": known_digits(self.seconds_before(gap.stamp)),
                    "after_s": known_digits(self.seconds_before(gap.before)),
                    "lost": gap.lost,
                }
                for gap in self.gaps
            ],
            "quantities": [quantity.to_dict() for quantity in self.quantities],
            "skipped_bytes": stats.skipped_bytes,
            "checksum_errors": stats.checksum_errors,
            "damage": [dict(zip(DAMAGE.names or (), row, strict=True)) for row in self.damage],
            "malformed": stats.malformed,
            "messages": dict(self.messages),
            "strings": dict(sorted(self.strings.items())),
            "events": [
                {
                    "offset": event.offset,
                    "sample": event.sample,
                    "time_s": event.before and known_digits(event.before.time),
                    "recorded_s": known_digits(self.seconds_before(event.before)),
                    "name": event.name,
                    **event.result._asdict(),
                }
                for event in self.events
            ],
            "undecoded": [item.to_dict() for item in self.undecoded],
            "trackers": [tracker._asdict() for tracker in self.trackers],
            "unknown": [
                {"data_id": f"0x{data_id:04X}", "packets": packets, "bytes": size}
                for data_id, (packets, size) in self.unknown.items()
            ],
        }

    def _utc_dict(self) -> dict[str, Any] | None:
        if not self.utc_rows:
            return None
        first, last = (f"{time}Z" for time in self.utc) if self.utc else (None, None)
        return {"first": first, "last": last, "rows": self.utc_rows, "valid": self.utc_valid}


def _identity_dict(identity: Identity) -> dict[str, Any]:
    firmware = identity.firmware
    return {
        "product_code": identity.product_code,
        "device_id": None if identity.device_id is None else device_name(identity.device_id),
        "firmware": None if firmware is None else str(firmware),
        "firmware_build": None if firmware is None else firmware.build,
        "firmware_source": None if firmware is None else firmware.scm,
    }


def _settings(configuration: Configuration) -> dict[str, Any]:
    """Returns the fields of a Configuration that do not identify the device."""
    identifying = ("device_id", "product_code", "firmware")
    return {name: v for name, v in asdict(configuration).items() if name not in identifying}
