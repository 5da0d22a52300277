"""NMEA text: the strings of a recording, or sentences made from its samples."""

from __future__ import annotations

import os
from collections.abc import Container, Iterator, Sequence
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
from xbus.export.valid import STATUS, known_time
from xbus.geometry import quaternion
from xbus.protocol.keys import EntryKey
from xbus.protocol.tables import UTC_SOURCES
from xbus.protocol.values import StringType

__all__ = ["MARK", "ORIENTATIONS", "Nmea", "Sentences", "nmea_positions", "sentences", "texts_of"]

ORIENTATIONS = ("quaternion", "rotation_matrix", "euler_angles")
#: A knot in m/s.
KNOT = 1852 / 3600
#: Digits of the minutes: as many as give 1e-7 degrees exactly.
DECIMALS = 7
#: The oldest orientation in s whose heading counts.
HEADING_AGE = 1.0
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
    #: The status decides which positions of the filter count, and UTC is in the sentences.
    always = (*STATUS, "utc_time")
    source: Source | None = None
    has_strings: bool = False

    def __post_init__(self) -> None:
        if self.source not in (None, "filter", "gnss"):
            raise ValueError(f"source must be 'filter' or 'gnss', not {self.source!r}")

    def quantities(self, shape: Part) -> Sequence[EntryKey]:
        """See `Format.quantities`."""
        positions = nmea_positions(shape, self.source)
        names = [key for key in shape if (key if isinstance(key, str) else key[0]) in ORIENTATIONS]
        names += [name for name in UTC_SOURCES if name in shape]
        names += positions.quantities(shape) if positions is not None else []
        # Its fix decides whether the times of its samples are valid.
        names += ["gnss_pvt_data"] if "gnss_pvt_data" in shape else []
        return list(dict.fromkeys(names))

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
        positions = nmea_positions(shape, self.source)
        if positions is None and not any(columns_of(shape, name) for name in ORIENTATIONS):
            needed = self.source or "position or orientation"
            raise ExportError(
                f"no strings, and no {needed} to make sentences from; xbus info lists the content"
            )
        if len(shape.devices) > 1:
            bids = ", ".join(str(device.bid) for device in shape.devices)
            raise ExportError(f"sentences do not name a device; choose one with bid=: {bids}")
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


def nmea_positions(names: Container[object], source: Source | None = None) -> Positions | None:
    """Returns the positions of sentences: those of the receiver, else of the filter; None without any.

    Args:
        names: The quantities of a log.
        source: The only source, or None for either.
    """
    if source is not None:
        return positions_of(names, source)
    return positions_of(names, "gnss") or positions_of(names, "filter")


def texts_of(part: Part) -> list[bytes]:
    """Returns the strings of a part, each with CR LF; a binary one, EM1000, is left out."""
    texts = [string.data for string in part.strings if string.type is not StringType.EM1000]
    return [text.rstrip(b"\r\n") + b"\r\n" for text in texts]


class _StringWriter:
    """Writes the strings of a recording."""

    def __init__(self, out: IO[bytes]) -> None:
        self._out = out
        self._counts = {"sentence": 0}

    @property
    def counts(self) -> dict[str, int]:
        return dict(self._counts)

    def write(self, part: Part) -> None:
        texts = texts_of(part)
        self._out.write(b"".join(texts))
        self._counts["sentence"] += len(texts)
        if omitted := len(part.strings) - len(texts):
            self._counts["omitted binary string"] = (
                self._counts.get("omitted binary string", 0) + omitted
            )


class _SentenceWriter:
    """Writes sentences made from samples, after one that says so."""

    def __init__(self, out: IO[bytes], positions: Positions | None) -> None:
        self._out, self._sentences = out, Sentences(positions)
        self._count = 0

    @property
    def counts(self) -> dict[str, int]:
        return {"sentence": self._count}

    def write(self, part: Part) -> None:
        bodies = self._sentences.of(part)
        if bodies and not self._count:
            self._out.write(sentences([MARK]))
        self._out.write(sentences(bodies))
        self._count += len(bodies)


#: The heading of a sample: index, time in s (NaN if unknown), number of restarts before it, and degrees (NaN
#: if the orientation is no rotation).
HEADING = np.dtype([("sample", "i8"), ("time", "f8"), ("run", "i8"), ("degrees", "f8")])


class Sentences:
    """Makes sentences at each position, or at each orientation if there are no positions, part by part.

    Args:
        positions: The positions.
    """

    def __init__(self, positions: Positions | None) -> None:
        self._positions = positions
        #: The heading of the last orientation.
        self._last = np.array([(-1, np.nan, 0, np.nan)], HEADING)
        self._restarts = 0

    def of(self, part: Part) -> list[str]:
        """Returns the sentences of the next part, as `sentences` takes them."""
        time = known_time(part)
        headings = self._headings(part, time)
        known = np.concatenate([self._last, headings])
        positions = self._positions
        columns: list[list[str]] = []
        if positions is None:
            sample = headings["sample"] - part.first_sample
            columns = [_hdt(headings["degrees"]), _zda(part.utc[sample])]
        elif positions.position(part) is not None:  # a block of live samples may have none
            rows = positions.rows(part)
            talker = "GP" if positions.name == "gnss" else "IN"
            points, is_fixed = rows.points, rows.is_fixed & rows.is_place
            columns = [_gga(points, is_fixed), _rmc(points, is_fixed)]
            columns = [[talker + text for text in column] for column in columns]
            degrees = self._heading_at(rows.sample, part, time, known)
            columns += [_hdt(degrees), _zda(points["time"])]
        self._last = known[-1:]
        self._restarts += len(part.restarts)
        # The sentences of a row of the columns one after the other; empty ones are left out.
        return [body for row in zip(*columns, strict=True) for body in row if body]

    def _headings(self, part: Part, time: npt.NDArray[np.float64]) -> npt.NDArray[Any]:
        """Returns `HEADING` for each sample with an orientation."""
        only = np.ones(len(part), np.bool_)
        sample, q = Measured(part, converts=True, is_driver=False, only=only).orientation
        headings = np.empty(len(sample), HEADING)
        if not len(q):
            return headings
        is_rotation = np.isfinite(q).all(axis=1) & q.any(axis=1)
        norm = np.linalg.norm(q, axis=1, keepdims=True)
        yaw = quaternion.to_euler(np.divide(q, norm, where=norm > 0, out=np.zeros_like(q)))[:, 2]
        headings["sample"] = sample + part.first_sample
        headings["time"] = time[sample]
        headings["run"] = self._run(part, headings["sample"])
        headings["degrees"] = np.where(is_rotation, (90 - yaw) % 360, np.nan)
        return headings

    def _run(self, part: Part, sample: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
        return self._restarts + np.searchsorted(part.restarts, sample, side="right")

    def _heading_at(
        self,
        sample: npt.NDArray[np.int64],
        part: Part,
        time: npt.NDArray[np.float64],
        known: npt.NDArray[Any],
    ) -> npt.NDArray[np.float64]:
        """Returns the heading of the last orientation up to each sample; NaN if it is too old.

        If the time of one of the two is unknown, the orientation must be in the sample or in the one before.
        """
        last = known[np.searchsorted(known["sample"], sample, side="right") - 1]
        age = time[sample - part.first_sample] - last["time"]
        is_next = sample - last["sample"] <= 1
        is_recent = np.where(np.isnan(age), is_next, np.abs(age) <= HEADING_AGE)
        is_recent &= self._run(part, sample) == last["run"]
        return np.where(is_recent, last["degrees"], np.nan)


def sentences(bodies: Sequence[str]) -> bytes:
    r"""Returns sentences with ``$`` and checksum, each with CR LF.

    >>> sentences(["HEHDT,045.00,T"])
    b'$HEHDT,045.00,T*1E\r\n'
    """
    if not bodies:
        return b""
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
