"""GPX 1.1: the track of a GNSS receiver."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import BinaryIO

import numpy as np

from xbus.export.format import ExportError, Format, Writer
from xbus.export.part import Part
from xbus.export.replacing import replacing
from xbus.protocol.keys import EntryKey
from xbus.protocol.tables import UTC_SOURCES

__all__ = ["Gpx"]

START = b"""<?xml version="1.0" encoding="UTF-8"?>
<gpx version="1.1" creator="xbus" xmlns="http://www.topografix.com/GPX/1/1">
<trk>
"""
END = b"</trk>\n</gpx>\n"
#: The fix types of a position, and what GPX calls them.
FIXES = {2: "2d", 3: "3d", 4: "3d"}


@dataclass(frozen=True)
class Gpx(Format):
    """A track of the positions in ``gnss_pvt_data`` (Table 25) with time, height, fix and HDOP."""

    def quantities(self, shape: Part) -> Sequence[EntryKey]:
        """See `Format.quantities`."""
        if "gnss_pvt_data" not in shape:
            raise ExportError("a GPX file needs positions (gnss_pvt_data)")
        return [name for name in UTC_SOURCES if name in shape]

    @contextmanager
    def open(self, path: str | os.PathLike[str], shape: Part) -> Iterator[Writer]:  # noqa: ARG002
        """See `Format.open`."""
        with replacing(path) as out:
            out.write(START)
            writer = _GpxWriter(out)
            yield writer
            writer.close()
            out.write(END)


class _GpxWriter:
    def __init__(self, out: BinaryIO) -> None:
        self._out = out
        self._points = self._segments = 0
        self._is_open = False

    @property
    def counts(self) -> dict[str, int]:
        return {"point": self._points, "segment": self._segments}

    def write(self, part: Part) -> None:
        column = part["gnss_pvt_data"]
        rows = column.scaled
        times = part.utc[column.sample - part.first_sample]
        # A restart ends a segment, and so does a position without a fix.
        run = np.searchsorted(part.restarts, column.sample, side="right")
        starts = np.diff(run, prepend=0) > 0
        for row, time, is_start in zip(rows, times, starts.tolist(), strict=True):
            fix = FIXES.get(int(row["fixtype"]))
            if is_start or fix is None:
                self.close()
            if fix is None:
                continue
            if not self._is_open:
                self._out.write(b"<trkseg>\n")
                self._is_open = True
                self._segments += 1
            stamp = "" if np.isnat(time) else f"<time>{np.datetime_as_string(time, 'ms')}Z</time>"
            self._out.write(
                f'<trkpt lat="{row["lat"]:.7f}" lon="{row["lon"]:.7f}"><ele>{row["hMSL"]:.3f}</ele>{stamp}'
                f"<fix>{fix}</fix><sat>{row['numSV']}</sat><hdop>{row['hdop']:.2f}</hdop></trkpt>\n".encode()
            )
            self._points += 1

    def close(self) -> None:
        """Ends the present segment."""
        if self._is_open:
            self._out.write(b"</trkseg>\n")
            self._is_open = False
