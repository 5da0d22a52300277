"""NMEA text: the strings of a recording, or sentences made from its samples."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import IO, Any

import numpy as np
import numpy.typing as npt

from xbus.export.format import ExportError, Format, Survey, Writer
from xbus.export.part import Part
from xbus.export.positions import Points, Positions, Source, positions_of
from xbus.export.replacing import replacing
from xbus.export.ros.measured import Measured, columns_of
from xbus.geometry import quaternion
from xbus.protocol.keys import EntryKey
from xbus.protocol.tables import UTC_SOURCES
from xbus.protocol.values import StringType

__all__ = ["Nmea"]

ORIENTATIONS = ("quaternion", "rotation_matrix", "euler_angles")
#: A knot in m/s.
KNOT = 1852 / 3600
#: Digits of the minutes: as many as give 1e-7 degrees exactly.
DECIMALS = 7
#: The first sentence of a file with sentences that the device did not send.
MARK = "GNTXT,01,01,02,made by xbus from MTData2"


@dataclass(frozen=True)
class Nmea(Format):
    """The strings that the device sent, or sentences GGA, RMC, HDT and ZDA where it sent none.

    Attributes:
        source: ``"gnss"`` or ``"filter"``: positions as for maps; None for the receiver if the log has its
            positions.
        has_strings: Whether the log has strings; the survey finds out.
    """

    needs_samples = False
    source: Source | None = None
    has_strings: bool = False

    def __post_init__(self) -> None:
        if self.source not in (None, "filter", "gnss"):
            raise ValueError(f"source must be 'filter' or 'gnss', not {self.source!r}")

    def quantities(self, shape: Part) -> Sequence[EntryKey]:
        """See `Format.quantities`."""
        positions = self._positions(shape)
        names = [key for key in shape if (key if isinstance(key, str) else key[0]) in ORIENTATIONS]
        names += [name for name in UTC_SOURCES if name in shape]
        names += positions.quantities(shape) if positions is not None else []
        return list(dict.fromkeys(names))

    def _positions(self, shape: Part) -> Positions | None:
        if self.source is not None:
            return positions_of(shape, self.source)
        return positions_of(shape, "gnss") or positions_of(shape, "filter")

    def survey(self, shape: Part) -> Survey:  # noqa: ARG002 - as in the base class
        """See `Format.survey`: whether there are strings."""
        return _StringSurvey(self)

    @contextmanager
    def open(self, path: str | os.PathLike[str], shape: Part) -> Iterator[Writer]:
        """See `Format.open`."""
        with replacing(path) as out:
            writer = _StringWriter(out) if self.has_strings else self._maker(out, shape)
            yield writer
            if not writer.counts["sentence"]:
                raise ExportError(
                    "no strings that are text"
                    if self.has_strings
                    else "no strings, and no sample with a position or an orientation to make sentences from"
                )

    def _maker(self, out: IO[bytes], shape: Part) -> _SentenceWriter:
        positions = self._positions(shape)
        if positions is None and not any(columns_of(shape, name) for name in ORIENTATIONS):
            needed = self.source or "position or orientation"
            raise ExportError(
                f"no strings, and no {needed} to make sentences from; xbus info lists the content"
            )
        if len(shape.devices) > 1:
            bids = ", ".join(str(device.bid) for device in shape.devices)
            raise ExportError(f"sentences do not name a device; choose one with --bid: {bids}")
        return _SentenceWriter(out, positions)


class _StringSurvey:
    def __init__(self, file_format: Nmea) -> None:
        self._format = file_format
        self.quantities: Sequence[EntryKey] = ()
        self._has_strings = False

    def add(self, part: Part) -> None:
        self._has_strings = self._has_strings or len(part.strings) > 0

    @property
    def format(self) -> Nmea:
        return replace(self._format, has_strings=self._has_strings)


class _StringWriter:
    """Writes the strings of a recording, each with CR LF; a binary one, EM1000, is left out."""

    def __init__(self, out: IO[bytes]) -> None:
        self._out = out
        self._counts = {"sentence": 0}

    @property
    def counts(self) -> dict[str, int]:
        return dict(self._counts)

    def write(self, part: Part) -> None:
        strings = list(part.strings)
        texts = [string.data for string in strings if string.type is not StringType.EM1000]
        self._out.write(b"".join(text.rstrip(b"\r\n") + b"\r\n" for text in texts))
        self._counts["sentence"] += len(texts)
        if len(texts) < len(strings):
            omitted = self._counts.get("omitted binary string", 0) + len(strings) - len(texts)
            self._counts["omitted binary string"] = omitted


class _SentenceWriter:
    """Makes sentences at each position, or at each orientation if there are no positions."""

    def __init__(self, out: IO[bytes], positions: Positions | None) -> None:
        self._out, self._positions = out, positions
        #: The heading of the last orientation, in degrees.
        self._heading = np.nan
        self._counts = {"sentence": 0}

    @property
    def counts(self) -> dict[str, int]:
        return dict(self._counts)

    def write(self, part: Part) -> None:
        sample, heading = self._headings(part)
        if self._positions is None:
            times = part.utc[sample - part.first_sample]
            self._write([_hdt(heading), _zda(times)])
        else:
            rows = self._positions.rows(part)
            known = np.concatenate([[self._heading], heading])
            own = known[np.searchsorted(sample, rows.sample, side="right")]
            talker = "GP" if self._positions.name == "gnss" else "IN"
            points = rows.points
            lat, lon = np.abs(points["lat"]) <= 90, np.abs(points["lon"]) <= 180
            is_fixed = rows.is_fixed & lat & lon
            columns = [_gga(points, is_fixed), _rmc(points, is_fixed)]
            columns = [[talker + text for text in column] for column in columns]
            self._write([*columns, _hdt(own), _zda(points["time"])])
        if len(heading):
            self._heading = heading[-1]

    def _headings(self, part: Part) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.float64]]:
        """Returns the samples with an orientation, and their headings in degrees, NaN if there is none."""
        only = np.ones(len(part), np.bool_)
        sample, q = Measured(part, converts=True, is_driver=False, only=only).orientation
        if not len(q):
            return np.empty(0, np.int64), np.empty(0)
        is_rotation = np.isfinite(q).all(axis=1) & q.any(axis=1)
        norm = np.linalg.norm(q, axis=1, keepdims=True)
        yaw = quaternion.to_euler(np.divide(q, norm, where=norm > 0, out=np.zeros_like(q)))[:, 2]
        heading = np.where(is_rotation, (90 - yaw) % 360, np.nan)
        return sample + part.first_sample, heading

    def _write(self, columns: Sequence[Sequence[str]]) -> None:
        """Writes sentences: those of a row of the columns after another; empty ones are left out."""
        bodies = [body for row in zip(*columns, strict=True) for body in row if body]
        if not bodies:
            return
        if not self._counts["sentence"]:
            self._out.write(_sentences([MARK]))
        self._out.write(_sentences(bodies))
        self._counts["sentence"] += len(bodies)


def _sentences(bodies: Sequence[str]) -> bytes:
    """Returns sentences with their checksums."""
    data = np.frombuffer("".join(bodies).encode("ascii"), np.uint8)
    starts = np.cumsum([0, *map(len, bodies[:-1])])
    sums = np.bitwise_xor.reduceat(data, starts).tolist()
    return "".join(map("$%s*%02X\r\n".__mod__, zip(bodies, sums, strict=True))).encode("ascii")


def _gga(points: Points, is_fixed: npt.NDArray[np.bool_]) -> list[str]:
    """Returns GGA without a talker; position, height and dilution are empty without a fix."""
    where = zip(*_place(points, is_fixed), strict=True)
    geoid = points["ellipsoid"] - points["msl"]
    fields = (
        _time(points["time"]),
        map(",".join, where),
        np.where(is_fixed, points["quality"], 0).tolist(),
        _numbers("%02d", points["satellites"]),
        _numbers("%.2f", np.where(is_fixed, points["hdop"], np.nan)),
        _numbers("%.3f", np.where(is_fixed, points["msl"], np.nan)),
        _numbers("%.3f", np.where(is_fixed, geoid, np.nan)),
    )
    return list(map("GGA,%s,%s,%d,%s,%s,%s,M,%s,M,,".__mod__, zip(*fields, strict=True)))


def _rmc(points: Points, is_fixed: npt.NDArray[np.bool_]) -> list[str]:
    """Returns RMC without a talker; A is valid, V is not."""
    where = zip(*_place(points, is_fixed), strict=True)
    fields = (
        _time(points["time"]),
        np.where(is_fixed, "A", "V").tolist(),
        map(",".join, where),
        _numbers("%.3f", np.where(is_fixed, points["speed"] / KNOT, np.nan)),
        _numbers("%.2f", np.where(is_fixed, np.round(points["course"], 2) % 360, np.nan)),
        [text and text[8:10] + text[5:7] + text[2:4] for text in _dates(points["time"])],
    )
    return list(map("RMC,%s,%s,%s,%s,%s,%s,,".__mod__, zip(*fields, strict=True)))


def _hdt(heading: npt.NDArray[np.float64]) -> list[str]:
    """Returns HDT, or an empty text if the heading is not known."""
    # 359.996 is written as 000.00.
    return [text and f"HEHDT,{text},T" for text in _numbers("%06.2f", np.round(heading, 2) % 360)]


def _zda(times: npt.NDArray[np.datetime64]) -> list[str]:
    """Returns ZDA, or an empty text if the time is not known."""
    dates = [",".join(reversed(text.split("-"))) for text in _dates(times)]
    both = zip(_time(times), dates, strict=True)
    return [time and f"GPZDA,{time},{date},00,00" for time, date in both]


def _numbers(template: str, values: npt.NDArray[Any]) -> list[str]:
    return ["" if value != value else template % value for value in values.tolist()]


def _rounded(times: npt.NDArray[np.datetime64]) -> npt.NDArray[np.datetime64]:
    """Returns times to the hundredth of a second, so that 59.996 s is the next minute."""
    nanoseconds = times.astype("M8[ns]").view(np.int64)
    rounded = ((nanoseconds + 5_000_000) // 10_000_000 * 10).view("M8[ms]")
    return np.where(np.isnat(times), np.datetime64("NaT", "ms"), rounded)


def _texts(times: npt.NDArray[np.datetime64]) -> list[str]:
    return [
        "" if text == "NaT" else text for text in np.datetime_as_string(_rounded(times)).tolist()
    ]


def _dates(times: npt.NDArray[np.datetime64]) -> list[str]:
    """Returns dates as 2026-11-22; empty for NaT."""
    return [text[:10] for text in _texts(times)]


def _time(times: npt.NDArray[np.datetime64]) -> list[str]:
    """Returns times of day as hhmmss.ss; empty for NaT."""
    return [text[11:22].replace(":", "") for text in _texts(times)]


def _place(points: Points, is_fixed: npt.NDArray[np.bool_]) -> tuple[list[str], list[str]]:
    """Returns latitude and longitude, each with its letter; empty without a fix."""
    return (
        _angles(np.where(is_fixed, points["lat"], np.nan), 2, "NS"),
        _angles(np.where(is_fixed, points["lon"], np.nan), 3, "EW"),
    )


def _angles(degrees: npt.NDArray[np.float64], digits: int, letters: str) -> list[str]:
    """Returns degrees and minutes, rounded as a whole, so that 59.99999999 minutes are a degree."""
    unit = 10**DECIMALS
    template = f"%0{digits}d%02d.%0{DECIMALS}d,%s"
    texts = []
    for value in degrees.tolist():
        if value != value:
            texts.append(",")
            continue
        minutes, fraction = divmod(round(abs(value) * 60 * unit), unit)
        texts.append(template % (*divmod(minutes, 60), fraction, letters[value < 0]))
    return texts
