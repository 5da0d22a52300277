"""A summary of a log, built part by part: the log need not fit into memory."""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable, Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np
import numpy.typing as npt

from xbus import _core
from xbus.describe.json_text import JsonRows
from xbus.describe.listing import MAX_LISTED, FirstRows, LargestRows
from xbus.describe.text import known_digits, recording_date
from xbus.formatting import device_name
from xbus.log.column import Column
from xbus.log.identity import (
    IDENTITY_MESSAGES,
    Identity,
    device_id_of,
    identities_of,
    identity_of,
)
from xbus.log.log import Log
from xbus.log.messages import Messages
from xbus.log.rates import Rates, SharedRates
from xbus.log.runs import DeviceRuns, PartRuns, Runs, steady_time
from xbus.log.stats import Stats
from xbus.log.trackers import TrackerCounts, TrackerSummary
from xbus.protocol.configuration import Configuration
from xbus.protocol.ids import MessageId
from xbus.protocol.tables import COLUMN_QUANTITIES, UTC_VALID, device_of, message_name
from xbus.protocol.undecoded import Undecoded
from xbus.wire.message import Message
from xbus.wire.result_code import ResultCode, read_result_code

__all__ = [
    "EVENT_MIDS",
    "GAP",
    "MAX_KINDS",
    "DeviceSummary",
    "EventKind",
    "LogSummary",
    "QuantitySummary",
    "event_result",
]


#: A time stamp: the number of its run, -1 for none, and unwrapped seconds on the device clock.
STAMP = np.dtype([("run", "i8"), ("time", "f8")])
#: A place where samples are missing: index, time stamp and device of the sample after it, number of missing
#: samples, and the last time stamp of the device before it.
GAP = np.dtype(
    [("sample", "i8"), ("stamp", STAMP), ("lost", "i8"), ("bid", "u1"), ("before", STAMP)]
)
#: A range of bytes that is neither frame nor string; the reason is an index of `_core.damage_reasons`.
DAMAGED = np.dtype([("offset", "i8"), ("length", "i8"), ("reason", "u1")])
#: An Error or Warning message: offset of its frame, index of the next sample, the last time stamp of the
#: device before it, and the first `MAX_PAYLOAD` bytes of its payload.
EVENT = np.dtype(
    [("offset", "i8"), ("sample", "i8"), ("before", STAMP), ("mid", "u1"), ("payload", "O")]
)
EVENT_MIDS = (MessageId.Error, MessageId.Warning)
#: Maximum number of bytes that are kept of the payload of an event, more than a device sends.
MAX_PAYLOAD = 256
#: Maximum number of kinds of events that are counted separately.
MAX_KINDS = 1000
#: Number of the largest gaps that are kept.
MAX_LARGEST = 100
#: Rows of a table that are converted at once when they are printed.
CHUNK = 1000


@dataclass
class EventKind:
    """Errors or warnings with the same result.

    Attributes:
        name: ``"Error"`` or ``"Warning"``.
        result: Its code and text.
        before: The last time stamp of the device before the first of them, `STAMP`.
        number: Number of events.
    """

    name: str
    result: ResultCode
    before: npt.NDArray[Any]
    number: int = 0


def event_result(mid: int, payload: bytes) -> tuple[str, ResultCode]:
    """Returns the name and the result of an event."""
    message = Message(mid, message_name(mid, len(payload)), 0, payload, 0, 0)
    return message.name, read_result_code(message)


class _PartStamps:
    """The time stamps of the devices in a part, without those of the GNSS receiver, which has its own time.

    Args:
        part: The part.
        runs: The runs of its samples.
        last: The last stamp of each device before the part.
    """

    def __init__(self, part: Log, runs: PartRuns, last: Mapping[int, npt.NDArray[Any]]) -> None:
        self._last = last
        self._size = len(part)
        self._stamps = stamps_of(runs.run, steady_time(part.core))
        #: The samples with a stamp, sorted by device, and the device of each.
        self._places = np.flatnonzero(self._stamps["run"] >= 0)
        self._devices = device_of(part.bid[self._places])
        order = np.argsort(self._devices, kind="stable")
        self._places, self._devices = self._places[order], self._devices[order]

    def before(self, rows: npt.NDArray[np.int64], bids: npt.NDArray[np.uint8]) -> npt.NDArray[Any]:
        """Returns the last stamp of a device before each sample, `STAMP`.

        Args:
            rows: The samples, counted from the start of the part, ``(n,)``.
            bids: The BIDs of the devices.
        """
        found = np.empty(len(rows), STAMP)
        devices = device_of(bids)
        asked = np.unique(devices)
        firsts = np.searchsorted(self._devices, asked, "left").tolist()
        ends = np.searchsorted(self._devices, asked, "right").tolist()
        for device, first, end in zip(asked.tolist(), firsts, ends, strict=True):
            is_asked, places = devices == device, self._places[first:end]
            known = np.concatenate((self._last.get(device, NO_STAMP), self._stamps[places]))
            found[is_asked] = known[np.searchsorted(places, rows[is_asked])]
        return found

    def last(self) -> dict[int, npt.NDArray[Any]]:
        """Returns the last stamp of each device up to the end of the part."""
        devices = np.array(sorted({*self._last, *np.unique(self._devices).tolist()}), np.uint8)
        stamps = self.before(np.full(len(devices), self._size), devices)
        return {device: stamps[at : at + 1] for at, device in enumerate(devices.tolist())}


def stamps_of(run: npt.NDArray[np.int64], time: npt.NDArray[np.float64]) -> npt.NDArray[Any]:
    """Returns time stamps from the numbers of runs and seconds, which are NaN without a time stamp."""
    stamps = np.empty(len(run), STAMP)
    stamps["run"], stamps["time"] = np.where(np.isfinite(time), run, -1), time
    return stamps


NO_STAMP = np.array([(-1, np.nan)], STAMP)


class DeviceSummary:
    """One device of a log: identity, number of samples, runs and rate.

    Attributes:
        bid: Bus identifier, as in its first sample.
        identity: Identifier, product code and firmware.
        samples: Number of samples.
        lost: Number of lost samples.
        duration: Seconds recorded; NaN if not known.
        restarts: Seconds that were recorded before each restart, ``(n,)``.
        rate: Samples per second.
        nominal_rate: Samples per second where no sample is missing.
    """

    def __init__(
        self, bid: int, identity: Identity, runs: DeviceRuns, rates: Rates, *, has_counter: bool
    ) -> None:
        self.bid, self.identity = bid, identity
        self.samples, self.lost, self.duration = runs.samples, runs.lost, runs.duration
        self.restarts = runs.before[1:]
        self.rate = rates.mean
        self.nominal_rate = rates.nominal(self.samples, has_counter=has_counter)

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
        self._precisions: set[str | None] = set()
        self._ids: set[int] = set()

    def add(self, column: Column) -> None:
        """Adds the column of the next part."""
        self.rows += len(column)
        self._precisions.add(column.precision)
        self._ids.add(column.data_id)

    @property
    def _rates(self) -> Rates:
        return self._log.rates[self.name, self.coordinates]

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
        return next(iter(self._ids)) if len(self._ids) == 1 else COLUMN_QUANTITIES[self.name].id

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

    All counts are exact. Of gaps, damage, events and runs, the first `MAX_LISTED` are listed, and of trackers
    the first thousand.

    Args:
        parts: The parts of the log, in order; more can be added with `add`.

    Attributes:
        stats: Counts of what was read.
        gaps: The first places where samples are missing, `GAP`.
        largest_gaps: The largest of all.
        damage: The first ranges of bytes that are neither frame nor string, `DAMAGED`.
        reasons: Number of these ranges by reason.
        messages: Number of messages by name.
        strings: Number of string outputs by name; those that the manual does not list are ``"others"``.
        events: The first errors and warnings that the device sent, `EVENT`.
        kinds: The kinds of these, at most `MAX_KINDS`, by message and payload.
        other_devices: Identifiers of devices whose bus identifier another device has, as in a file that joins
            two recordings; a dictionary that has them as keys.
        runs: The runs of all devices.
        rates: The rates of each device, by its number, and of each quantity, by the tuple of its name and
            coordinates.
        unknown: Number of packets and bytes by data identifier, of packets that the tables do not explain.
        utc: Earliest and latest UTC time that the device marks as valid, or None.
        utc_rows: Number of UTC times.
        utc_valid: Number of those that the device marks as valid.
        capture_findings: What is unusual in a CAN capture, in sentences; None for a log that is from none.

    >>> import xbus
    >>> summary = LogSummary([xbus.read_log("tests/captures/walk.mtb")])
    >>> summary.stats.samples, summary.has_counter, len(summary.gaps)
    (1040, True, 0)
    """

    def __init__(self, parts: Iterable[Log]) -> None:
        self.stats = Stats(**{field.name: 0 for field in fields(Stats)})
        self._identities: dict[int, Identity] = {}
        self.other_devices: dict[int, None] = {}
        self.capture_findings: tuple[str, ...] | None = None
        self.runs = Runs()
        self.rates = SharedRates()
        self._quantities: dict[tuple[str, str | None], QuantitySummary] = {}
        self.gaps = FirstRows(GAP)
        self.largest_gaps = LargestRows(GAP, "lost", MAX_LARGEST)
        self.damage = FirstRows(DAMAGED)
        self.reasons: Counter[str] = Counter()
        self.messages: Counter[str] = Counter()
        self.strings: Counter[str] = Counter()
        self.events = FirstRows(EVENT)
        self.kinds: dict[tuple[int, bytes], EventKind] = {}
        self.unknown: dict[int, list[int]] = {}
        self._undecoded: dict[tuple[str, int, str], Undecoded] = {}
        self._trackers = TrackerCounts()
        self.utc: tuple[np.datetime64, np.datetime64] | None = None
        self.utc_rows = self.utc_valid = 0
        #: The last time stamp of each device.
        self._last: dict[int, npt.NDArray[Any]] = {}
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
        return list(self._trackers.summaries().values())

    @property
    def has_counter(self) -> bool:
        """Whether samples have a packet counter, without which losses are not detected."""
        return any(quantity.name == "packet_counter" for quantity in self.quantities)

    @property
    def identity(self) -> Identity:
        """Identifier, product code, firmware and configuration of the device; of the first of several."""
        return identity_of(self._identities, list(self.runs.of_devices()))

    @property
    def devices(self) -> list[DeviceSummary]:
        """The devices that sent samples, in the order of their first samples."""
        devices = self.runs.devices()
        return [
            DeviceSummary(
                bid,
                identity_of(self._identities, list(devices), bid),
                runs,
                self.rates[device_of(bid)],
                has_counter=self.has_counter,
            )
            for bid, runs in devices.items()
        ]

    @property
    def start(self) -> float:
        """Start of the first run with time stamps, in seconds on the device clock; NaN without any."""
        spans = self.runs.spans
        stamped = np.flatnonzero(spans["stamps"])
        return float(spans["start"][stamped[0]]) if len(stamped) else float("nan")

    @property
    def duration(self) -> float:
        """Seconds recorded, as `Log.duration`."""
        return self.runs.duration

    def seconds_before(self, stamps: npt.NDArray[Any]) -> npt.NDArray[np.float64]:
        """Returns the seconds that a device recorded up to time stamps, without those between its runs.

        Args:
            stamps: The time stamps, `STAMP`.

        Returns:
            Seconds, NaN without a time stamp.
        """
        if not len(self.runs):
            return np.full(len(stamps), np.nan)
        run = stamps["run"]
        seconds = self.runs.seconds_before()[run] + stamps["time"] - self.runs.spans["start"][run]
        return np.where(run >= 0, seconds, np.nan)

    def add(self, part: Log) -> PartRuns:
        """Adds the next part, and returns the runs that its samples belong to."""
        counts = asdict(self.stats)
        self.stats = Stats(**{name: counts[name] + n for name, n in asdict(part.stats).items()})
        messages = list(part.messages.with_mids(*IDENTITY_MESSAGES))
        self._identities = identities_of(messages, self._identities)
        self._add_other_devices(messages)
        runs = self.runs.add(part.core)
        devices = device_of(part.bid)
        rows: dict[Hashable, npt.NDArray[np.int64]] = {
            device: np.flatnonzero(devices == device) for device in np.unique(devices).tolist()
        }
        for column in part.values():
            rows[column.name, column.coordinates] = column.sample - part.first_sample
        self.rates.add(runs, rows, part.time)
        self._add_damage(part)
        self.strings.update({name or "others": n for name, n in part.strings.counts.items()})
        for column in part.values():
            known = self._quantities.setdefault(
                (column.name, column.coordinates), QuantitySummary(self, column)
            )
            known.add(column)
            if column.name == "utc_time":
                self._add_utc(column)
        self._trackers.add(part.get("awinda_snapshot"))
        for item in part.undecoded:
            earlier = self._undecoded.get(item.key)
            self._undecoded[item.key] = item if earlier is None else earlier.plus(item)
        for data_id, packets in part.unknown.items():
            count = self.unknown.setdefault(data_id, [0, 0])
            count[0] += len(packets)
            count[1] += packets.size
        stamps = _PartStamps(part, runs, self._last)
        self._last = stamps.last()
        self._add_gaps(part, runs, stamps)
        self._add_messages(part, stamps)
        return runs

    def _add_other_devices(self, messages: Iterable[Message]) -> None:
        for message in messages:
            found, own = device_id_of(message), self._identities[device_of(message.bid)].device_id
            if found not in (None, own) and len(self.other_devices) < MAX_KINDS:
                self.other_devices.setdefault(found)

    def _add_utc(self, column: Column) -> None:
        stamps = column.datetime[(column.values["valid"] & UTC_VALID == UTC_VALID)]
        stamps = stamps[~np.isnat(stamps)]
        self.utc_rows += len(column)
        self.utc_valid += len(stamps)
        if len(stamps):
            first, last = self.utc or (stamps[0], stamps[0])
            self.utc = min(first, stamps.min()), max(last, stamps.max())

    def _add_damage(self, part: Log) -> None:
        found = part.core.damage
        damage = np.empty(len(found.offset), DAMAGED)
        damage["offset"], damage["length"] = found.offset, found.length
        damage["reason"] = found.reason
        self.damage.add(damage)
        numbers = np.bincount(found.reason).tolist()
        names = _core.damage_reasons()[: len(numbers)]
        self.reasons.update({name: n for name, n in zip(names, numbers, strict=True) if n})

    def _add_messages(self, part: Log, stamps: _PartStamps) -> None:
        messages = part.messages
        self.messages.update(messages.counts)
        rows = np.flatnonzero(np.isin(messages.mid, EVENT_MIDS))
        before = stamps.before(messages.sample[rows] - part.first_sample, messages.bid[rows])
        for at in range(0, len(rows), CHUNK):
            self._add_events(messages, rows[at : at + CHUNK], before[at : at + CHUNK])

    def _add_events(
        self, messages: Messages, rows: npt.NDArray[np.intp], before: npt.NDArray[Any]
    ) -> None:
        events = np.empty(len(rows), EVENT)
        events["offset"], events["sample"] = messages.offset[rows], messages.sample[rows]
        events["before"], events["mid"] = before, messages.mid[rows]
        events["payload"] = [payload[:MAX_PAYLOAD] for payload in messages.payloads(rows)]
        self.events.add(events)
        keys = list(zip(events["mid"].tolist(), events["payload"].tolist(), strict=True))
        for at, key in enumerate(keys):
            kind = self.kinds.get(key)
            if kind is None:
                if len(self.kinds) == MAX_KINDS:
                    continue
                kind = self.kinds[key] = EventKind(*event_result(*key), before[at : at + 1])
            kind.number += 1

    def _add_gaps(self, part: Log, runs: PartRuns, stamps: _PartStamps) -> None:
        found = part.gaps
        rows = found["sample"] - part.first_sample
        gaps = np.empty(len(found), GAP)
        for name in ("sample", "lost", "bid"):
            gaps[name] = found[name]
        gaps["stamp"] = stamps_of(runs.run[rows], part.time[rows])
        gaps["before"] = stamps.before(rows, found["bid"])
        self.gaps.add(gaps)
        self.largest_gaps.add(gaps)

    def to_dict(self, file: str) -> dict[str, Any]:
        """Returns the summary for `json_pieces`: None for what is not known, and for NaN."""
        stats, configuration = self.stats, self.identity.configuration
        return {
            "file": file,
            "bytes": stats.bytes,
            "device": _identity_dict(self.identity),
            "devices": [device.to_dict() for device in self.devices],
            "other_devices": [device_name(found) for found in self.other_devices],
            "recorded": configuration and recording_date(configuration),
            "configuration": configuration and _settings(configuration),
            "utc": self._utc_dict(),
            "start_s": known_digits(self.start),
            "duration_s": known_digits(self.duration),
            "runs": JsonRows(self._run_rows),
            "totals": {
                "runs": len(self.runs),
                "gaps": len(self.gaps),
                "damage": len(self.damage),
                "events": len(self.events),
            },
            "frames": stats.frames,
            "samples": stats.samples,
            "lost_samples": stats.lost_samples,
            "gaps": JsonRows(self._gap_rows),
            "quantities": [quantity.to_dict() for quantity in self.quantities],
            "skipped_bytes": stats.skipped_bytes,
            "checksum_errors": stats.checksum_errors,
            "damage": JsonRows(self._damage_rows),
            "malformed": stats.malformed,
            "unfit": stats.unfit,
            "messages": dict(self.messages),
            "strings": dict(sorted(self.strings.items())),
            "events": JsonRows(self._event_rows),
            "undecoded": [item.to_dict() for item in self.undecoded],
            "trackers": [tracker._asdict() for tracker in self.trackers],
            "unknown": [
                {"data_id": f"0x{data_id:04X}", "packets": packets, "bytes": size}
                for data_id, (packets, size) in self.unknown.items()
            ],
        }

    def _run_rows(self) -> Iterator[dict[str, Any]]:
        for rows in _chunks(self.runs.table()[:MAX_LISTED]):
            for bid, first, last, start, duration in rows.tolist():
                yield {
                    "bid": bid,
                    "first": first,
                    "last": last,
                    "start_s": known_digits(start),
                    "duration_s": known_digits(duration),
                }

    def _gap_rows(self) -> Iterator[dict[str, Any]]:
        gaps = self.gaps.rows
        recorded, after = map(self.seconds_before, (gaps["stamp"], gaps["before"]))
        for chunk in zip(*map(_chunks, (gaps, recorded, after)), strict=True):
            rows = zip(*(column.tolist() for column in chunk), strict=True)
            for (sample, (_, time), lost, bid, _), at, last in rows:
                yield {
                    "sample": sample,
                    "bid": bid,
                    "time_s": known_digits(time),
                    "recorded_s": known_digits(at),
                    "after_s": known_digits(last),
                    "lost": lost,
                }

    def _damage_rows(self) -> Iterator[dict[str, Any]]:
        reasons = _core.damage_reasons()
        for rows in _chunks(self.damage.rows):
            for offset, length, reason in rows.tolist():
                yield {"offset": offset, "length": length, "reason": reasons[reason]}

    def _event_rows(self) -> Iterator[dict[str, Any]]:
        events = self.events.rows
        recorded = self.seconds_before(events["before"])
        for chunk in zip(*map(_chunks, (events, recorded)), strict=True):
            rows = zip(*(column.tolist() for column in chunk), strict=True)
            for (offset, sample, (_, time), mid, payload), at in rows:
                name, result = event_result(mid, payload)
                yield {
                    "offset": offset,
                    "sample": sample,
                    "time_s": known_digits(time),
                    "recorded_s": known_digits(at),
                    "name": name,
                    **result._asdict(),
                }

    def _utc_dict(self) -> dict[str, Any] | None:
        if not self.utc_rows:
            return None
        first, last = (f"{time}Z" for time in self.utc) if self.utc else (None, None)
        return {"first": first, "last": last, "rows": self.utc_rows, "valid": self.utc_valid}


def _chunks(rows: npt.NDArray[Any]) -> Iterator[npt.NDArray[Any]]:
    """Yields rows of a table, some at a time."""
    for at in range(0, len(rows), CHUNK):
        yield rows[at : at + CHUNK]


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
