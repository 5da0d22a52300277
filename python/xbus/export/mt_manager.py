"""The text files that MT Manager exports: a header of comments, and a row for each sample."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import IO, Any, Literal

import numpy as np
import numpy.typing as npt

from xbus import _core
from xbus.export.format import ExportError, Format, Survey, Writer
from xbus.export.part import Part, PartDevice, device_label
from xbus.export.replacing import replacing_all
from xbus.export.ros.measured import Measured, Rows, columns_of, outer, system_of
from xbus.export.text import formatted
from xbus.export.update_rate import UpdateRate
from xbus.protocol.keys import EntryKey
from xbus.protocol.tables import device_of

__all__ = ["MtManager"]

Generation = Literal["2022", "4.8", "4.x", "3.x"]
Separator = Literal["tab", "comma", "semicolon", "space"]
SEPARATORS = {"tab": "\t", "comma": ",", "semicolon": ";", "space": " "}
XYZ, QUATERNION = "XYZ", ("q0", "q1", "q2", "q3")
UTC = ("Nano", "Year", "Month", "Day", "Hour", "Minute", "Second", "Valid")
#: The quantities with columns, in their order: the beginning of the names, what distinguishes them, and how
#: numbers are written. A row needs one of these.
COLUMNS: dict[str, tuple[str, Sequence[str], str]] = {
    "acceleration": ("Acc_", XYZ, "%.6f"),
    "free_acceleration": ("FreeAcc_", XYZ, "%.6f"),
    "rate_of_turn": ("Gyr_", XYZ, "%.6f"),
    "magnetic_field": ("Mag_", XYZ, "%.6f"),
    "delta_v": ("VelInc_", XYZ, "%.6f"),
    "delta_q": ("OriInc_", QUATERNION, "%.6f"),
    "quaternion": ("Quat_", QUATERNION, "%.6f"),
    "euler_angles": ("", ("Roll", "Pitch", "Yaw"), "%.6f"),
    "rotation_matrix": ("Mat", [f"[{i}][{j}]" for j in (1, 2, 3) for i in (1, 2, 3)], "%.6f"),
    "lat_lon": ("", ("Latitude", "Longitude"), "%.9f"),
    "altitude_ellipsoid": ("", ("Altitude",), "%.6f"),
    "velocity_xyz": ("Vel_", XYZ, "%.6f"),
    "temperature": ("", ("Temperature",), "%.6f"),
    "baro_pressure": ("", ("Pressure",), "%d"),
}
#: Columns that do not make a row.
OTHERS: dict[str, tuple[str, Sequence[str], str]] = {"status_word": ("", ("StatusWord",), "%d")}
#: Rows of missing samples that a gap has at most: a damaged time stamp must not fill the disk.
MOST_MISSING = 100_000
#: Rows that are written at a time.
STEP = 1 << 15


@dataclass(frozen=True)
class MtManager(Format):
    """Text files as those of MT Manager, one for each device, in the layout of one of its generations.

    If the log has several devices, the path ``walk.txt`` stands for ``walk_0080001E.txt`` and so on. Lost
    samples have rows without values where device times show how many there are.

    Attributes:
        mtm: The generation: ``"2022"`` (2019.2 and later), ``"4.8"`` (4.x with option flags), ``"4.x"`` or
            ``"3.x"``.
        separator: What stands between columns.
        missing: Text for a value that is missing; None for that of the generation: NaN in 2022, otherwise
            nothing.
        rates: Samples per second by device, which the survey finds.
    """

    mtm: Generation = "2022"
    separator: Separator = "tab"
    missing: str | None = None
    rates: Mapping[int, float | None] | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        if self.mtm not in ("2022", "4.8", "4.x", "3.x") or self.separator not in SEPARATORS:
            raise ValueError(f"there is no {self.mtm!r} with separator {self.separator!r}")
        if SEPARATORS[self.separator] in self.missing_text or "\n" in self.missing_text:
            raise ValueError(f"{self.missing!r} cannot stand for a missing value")
        if SEPARATORS[self.separator] == " " and not self.missing_text:
            raise ValueError("missing values between spaces need a text, such as NaN")

    @property
    def missing_text(self) -> str:
        """Text for a value that is missing."""
        if self.missing is not None:
            return self.missing
        return "NaN" if self.mtm == "2022" else ""

    def quantities(self, shape: Part) -> Sequence[EntryKey]:
        """See `Format.quantities`."""
        found = [key for key in shape if _name(key) in COLUMNS]
        if not found:
            raise ExportError(f"MT Manager's text needs one of {', '.join(COLUMNS)}")
        for name in COLUMNS:
            if len(columns_of(shape, name)) > 1:
                systems = [
                    ":".join(key) for key in found if isinstance(key, tuple) and key[0] == name
                ]
                other = "; or one device with bid=" if len(shape.devices) > 1 else ""
                raise ExportError(
                    f"{name} in several coordinates; choose quantities={' or '.join(systems)}, and the other "
                    f"quantities{other}"
                )
        others = (*OTHERS, "sample_time_fine", "utc_time")
        return [*found, *(name for name in others if name in shape)]

    def survey(self, shape: Part) -> Survey:
        """See `Format.survey`: the rates of the devices."""
        return _RateSurvey(self, shape)

    @contextmanager
    def open(self, path: str | os.PathLike[str], shape: Part) -> Iterator[Writer]:
        """See `Format.open`."""
        self.quantities(shape)
        devices = shape.devices
        names = [os.fspath(path)]
        if len(devices) > 1:
            stem, suffix = os.path.splitext(path)  # noqa: PTH122 - a path may be text
            names = [f"{stem}_{device_label(device)}{suffix}" for device in devices]
        with replacing_all(names) as files:
            writer = _MtManagerWriter(self, shape, files)
            yield writer
            if not writer.counts["row"]:
                raise ExportError(f"no sample has one of {', '.join(COLUMNS)}")


def _name(key: EntryKey) -> str:
    return key if isinstance(key, str) else key[0]


def _device(device: PartDevice) -> int:
    return device_of(device.bid)


class _RateSurvey:
    def __init__(self, file_format: MtManager, shape: Part) -> None:
        self._format = file_format
        self.quantities: Sequence[EntryKey] = list(file_format.quantities(shape))
        self._rates = {_device(device): UpdateRate() for device in shape.devices}

    def add(self, part: Part) -> None:
        bids = device_of(part.bid)
        for device, rate in self._rates.items():
            sample = _samples(_measured(part, bids == device))
            rate.add(part.time[sample])

    @property
    def format(self) -> MtManager:
        rates = {device: rate.value for device, rate in self._rates.items()}
        return replace(self._format, rates=rates)


def _measured(part: Part, only: npt.NDArray[np.bool_]) -> dict[str, Rows]:
    measured = Measured(part, converts=False, is_driver=False, only=only)
    names = [*COLUMNS, *OTHERS, "sample_time_fine", "utc_time"]
    return {name: measured.rows(name) for name in names if columns_of(part, name)}


def _samples(rows: Mapping[str, Rows]) -> npt.NDArray[np.int64]:
    """Returns the samples of a part that have rows, counted from its start."""
    return outer(*(rows[name] for name in COLUMNS if name in rows))


class _Layout:
    """The header and the columns of the file of a device.

    Args:
        file_format: The format.
        shape: The log.
        device: The device.
        rate: Its samples per second; None if they are not known.
    """

    def __init__(
        self, file_format: MtManager, shape: Part, device: PartDevice, rate: float | None
    ) -> None:
        self._mtm, self._device, self._rate = file_format.mtm, device, rate
        self._shape = shape
        self.missing = file_format.missing_text
        self.separator = SEPARATORS[file_format.separator]
        self.end = self.separator * (self._mtm == "3.x") + "\n"
        self.stamps = [
            name
            for name in ("sample_time_fine", "utc_time")
            if name in shape and self._mtm != "3.x"
        ]
        self.quantities = [name for name in (*COLUMNS, *OTHERS) if columns_of(shape, name)]

    @property
    def width(self) -> int:
        """The number of columns."""
        return len(self._all_names())

    @property
    def head(self) -> bytes:
        """The comments and the line of names."""
        text = "".join(f"//{line}\n" for line in self._comments())
        return (text + self.separator.join(self._all_names()) + self.end).encode()

    def _all_names(self) -> list[str]:
        names = ["Counter" if self._mtm == "3.x" else "PacketCounter"]
        names += ["SampleTimeFine"] if "sample_time_fine" in self.stamps else []
        names += [f"UTC_{name}" for name in UTC] if "utc_time" in self.stamps else []
        return names + [name for quantity in self.quantities for name in self._names(quantity)]

    def _names(self, quantity: str) -> list[str]:
        start, ends, _ = (COLUMNS | OTHERS)[quantity]
        if ends is QUATERNION and self._mtm == "3.x":
            ends = "wxyz"
        if self._mtm == "2022" and quantity in ("free_acceleration", "velocity_xyz"):
            ends = system_of(columns_of(self._shape, quantity)[0])
        return [start + end for end in ends]

    def _comments(self) -> list[str]:
        firmware = self._device.firmware
        version = "Unknown" if firmware is None else ".".join(map(str, firmware[:3]))
        if self._mtm != "2022":
            if self._rate is None:
                raise ExportError(
                    f"the header of MT Manager {self._mtm} has an update rate, which time stamps show; "
                    'rate=HZ gives times to a log with a counter, and mtm="2022" has no rate'
                )
            rate = f"{self._rate:.1f}Hz"
            flags = [" Option Flags: Unknown "] * (self._mtm == "4.8")
            middle = [f" Update Rate: {rate}", " Filter Profile: Unknown", *flags]
            if self._mtm == "3.x":
                middle = [f" Sample rate: {rate}", " Scenario: Unknown"]
            start = "0" if self._mtm == "3.x" else "Unknown"
            return [f" Start Time: {start}", *middle, f" Firmware Version: {version}"]
        code = "".join(filter(str.isprintable, self._device.product_code or "Unknown"))
        return [
            " General information: ",
            "  MT Manager version: 2022.2.0 ",
            f"  XDA version: none, written by xbus {_core.__version__} in the layout of MT Manager",
            " Device information: ",
            f"  DeviceId: {device_label(self._device)}",
            f"  ProductCode: {code}",
            f"  Firmware Version: {version}",
            "  Hardware Version: Unknown",
            " Device settings: ",
            "  Filter Profile: Unknown",
            "  Option Flags: Unknown",
            f" Coordinate system: {self._system()}",
        ]

    def _system(self) -> str:
        names = ("quaternion", "rotation_matrix", "euler_angles", "velocity_xyz")
        found = {
            column.coordinates or "ENU"
            for name in names
            for column in columns_of(self._shape, name)
        }
        return " and ".join(sorted(found)) or "ENU"

    def counter(self, counters: npt.NDArray[np.int64]) -> list[str]:
        """Returns packet counters, unwrapped, as text; -1 is missing."""
        values = np.where(counters < 0, np.nan, counters & 0xFFFF)
        return formatted("%5d" if self._mtm == "3.x" else "%05d", values, self.missing)

    def lines(
        self,
        rows: Mapping[str, Rows],
        sample: npt.NDArray[np.int64],
        counters: npt.NDArray[np.int64],
    ) -> list[str]:
        """Returns the lines of samples of a part, which are counted from its start."""
        columns = [self.counter(counters)]
        for name in (*self.stamps, *self.quantities):
            template = (COLUMNS | OTHERS)[name][2] if name not in self.stamps else "%d"
            # The samples that have a value, and the rows of these.
            own, place, row = np.intersect1d(sample, rows[name].sample, return_indices=True)
            values = _flat(rows[name].values[row])
            for column in values.T:
                full = column
                if len(own) < len(sample):
                    full = np.full(len(sample), np.nan)
                    full[place] = column
                columns.append(formatted(template, full, self.missing))
        return list(map(self.separator.join, zip(*columns, strict=True)))

    def lost_lines(self, counters: Sequence[int], count: int) -> list[str]:
        """Returns lines of missing samples; their counters are known if there are as many of these."""
        known = np.array(counters if len(counters) == count else [-1] * count)
        rest = self.separator + self.separator.join([self.missing] * (self.width - 1))
        return [counter + rest for counter in self.counter(known)]


def _flat(values: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Returns the values of a quantity as rows of numbers, a matrix column by column."""
    if values.dtype.names:
        return np.column_stack([values[name].astype(np.int64) for name in values.dtype.names])
    if values.ndim == 3:
        values = values.transpose(0, 2, 1)
    return values.reshape(len(values), math.prod(values.shape[1:]))


class _File:
    """The file of a device.

    Args:
        layout: Its layout.
        rate: Samples per second; None if they are not known.
        out: The file.
    """

    def __init__(self, layout: _Layout, rate: float | None, out: IO[bytes]) -> None:
        self._layout, self._rate, self._out = layout, rate, out
        #: Lost samples and restarts so far, up to the end of the part.
        self._lost = self._restarts = 0
        #: Of the last row: time, lost samples, restarts, counter.
        self._last: tuple[float, int, int, int] | None = None
        self.rows = self.missing = 0
        out.write(layout.head)

    def write(self, part: Part, only: npt.NDArray[np.bool_]) -> None:
        """Writes the samples of the device in a part.

        Args:
            part: The part.
            only: Which samples are of the device, ``(n,)``.
        """
        rows = _measured(part, only)
        sample = _samples(rows)
        gaps = part.gaps[only[part.gaps["sample"] - part.first_sample]]
        restarts = part.restarts[only[part.restarts - part.first_sample]]
        lost = np.concatenate([[0], np.cumsum(gaps["lost"])]) + self._lost
        self._lost = int(lost[-1])
        lost = lost[np.searchsorted(gaps["sample"], sample + part.first_sample, side="right")]
        run = self._restarts + np.searchsorted(restarts, sample + part.first_sample, side="right")
        self._restarts += len(restarts)
        if not len(sample):
            return
        time, counters = part.time[sample], part.packet_counter[sample]
        missing = self._missing(time, lost, run)
        before = np.concatenate([[self._last[3] if self._last else -1], counters[:-1]])
        for first in range(0, len(sample), STEP):
            block = slice(first, first + STEP)
            lines = self._layout.lines(rows, sample[block], counters[block])
            self._write(lines, missing[block], before[block], counters[block])
        self._last = float(time[-1]), int(lost[-1]), int(run[-1]), int(counters[-1])

    def _missing(
        self,
        time: npt.NDArray[np.float64],
        lost: npt.NDArray[np.int64],
        run: npt.NDArray[np.int64],
    ) -> npt.NDArray[np.int64]:
        """Returns how many rows are missing before each row: those of its time that were lost."""
        missing = np.zeros(len(time), np.int64)
        if self._rate is None:
            return missing
        last = self._last or (np.nan, 0, -1, -1)
        steps = np.diff(time, prepend=last[0]) * self._rate
        were_lost = np.diff(lost, prepend=last[1])
        is_gap = (np.diff(run, prepend=last[2]) == 0) & (were_lost > 0) & (steps > 1)
        limit = np.minimum(were_lost[is_gap], MOST_MISSING)
        missing[is_gap] = np.minimum(np.rint(steps[is_gap]) - 1, limit).astype(np.int64)
        return missing

    def _write(
        self,
        lines: list[str],
        missing: npt.NDArray[np.int64],
        before: npt.NDArray[np.int64],
        counters: npt.NDArray[np.int64],
    ) -> None:
        """Writes lines, with those of missing samples before them."""
        found, done = [], 0
        for row in np.flatnonzero(missing).tolist():
            found += lines[done:row]
            count = int(missing[row])
            between = range(int(before[row]) + 1, int(counters[row]))
            found += self._layout.lost_lines(between if before[row] >= 0 else (), count)
            done = row
        found += lines[done:]
        end = self._layout.end
        self._out.write((end.join(found) + end).encode())
        self.rows += len(lines)
        self.missing += int(missing.sum())


class _MtManagerWriter:
    def __init__(self, file_format: MtManager, shape: Part, files: Sequence[IO[bytes]]) -> None:
        self._files: dict[int, _File] = {}
        for device, out in zip(shape.devices, files, strict=True):
            rate = (file_format.rates or {}).get(_device(device))
            layout = _Layout(file_format, shape, device, rate)
            self._files[_device(device)] = _File(layout, rate, out)

    @property
    def counts(self) -> dict[str, int]:
        missing = sum(file.missing for file in self._files.values())
        return {
            "row": sum(file.rows for file in self._files.values()),
            **({"missing row": missing} if missing else {}),
            **({"file": len(self._files)} if len(self._files) > 1 else {}),
        }

    def write(self, part: Part) -> None:
        bids = device_of(part.bid)
        for device, file in self._files.items():
            file.write(part, bids == device)
