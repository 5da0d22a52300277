"""The parts of a recording between two times, with the host times of the whole recording."""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np

from xbus import _core
from xbus.log.arrivals import HostTimes
from xbus.log.cut_source import CutSource
from xbus.log.legacy import Legacy
from xbus.log.parts import LogPart, split_log
from xbus.log.read import CUT_BLOCK, iter_log
from xbus.protocol.values import StringType

__all__ = ["CutCopy", "copy_cut"]

#: The host time of a string, and the offset at which the string begins.
STRING = np.dtype([("offset", "i8"), ("time", "f8")])


@dataclass(frozen=True)
class CutCopy:
    """A copy of the bytes of a cut, with its host times in files beside it.

    Attributes:
        path: The copy.
        size: Its size in bytes.
        has_host_times: Whether a sample has a host time.
    """

    path: str
    size: int
    has_host_times: bool

    def split(self, **options: Any) -> list[LogPart]:
        """Returns the parts, as `split_log` with these options."""
        parts = split_log(self.path, **options)
        whole = replace(parts[0]._whole, has_host_times=self.has_host_times)
        own = {item.name for item in fields(LogPart)} - {"_whole"}
        return [
            _CutPart(**{name: getattr(part, name) for name in own}, _whole=whole, _copy=self)
            for part in parts
        ]

    def times_of(self, part: _core.Part) -> HostTimes:
        """Returns the host times of a part."""
        if not self.has_host_times:
            return HostTimes(part, is_known=False)
        times = np.fromfile(_of_samples(self.path), np.float64, len(part), offset=8 * part.first)
        offsets = part.strings.offset
        strings = np.full(len(offsets), np.nan)
        if len(offsets):
            found = np.memmap(_of_strings(self.path), STRING, "r")
            first = int(np.searchsorted(found["offset"], offsets[0]))
            strings[:] = found["time"][first : first + len(offsets)]
        return HostTimes.known_already(part, times, {}, strings)


@dataclass(frozen=True)
class _CutPart(LogPart):
    _copy: CutCopy = field(repr=False)

    def _host_times(self, core: _core.Part) -> HostTimes:
        return self._copy.times_of(core)


def copy_cut(
    cut: CutSource,
    path: str,
    *,
    rate: float | None = None,
    strings: Iterable[StringType | str] = (),
    legacy: Legacy | None = None,
) -> CutCopy:
    """Copies the bytes of a cut to a file, and its host times to files beside it.

    Args:
        cut: The cut.
        path: Path of the file.
        rate: As in `read_log`.
        strings: As in `read_log`.
        legacy: As in `read_log`.

    Raises:
        OSError: A file cannot be written, or the recording cannot be read.
        ValueError: As `xbus.log.cutting.cut`.
    """
    has_host_times = False
    with (
        open(path, "wb") as copy,  # noqa: PTH123 - pathlib is slow to import
        open(_of_samples(path), "wb") as of_samples,  # noqa: PTH123
        open(_of_strings(path), "wb") as of_strings,  # noqa: PTH123
    ):
        cut.copy_to(copy)
        for part in iter_log(
            cut, block_bytes=CUT_BLOCK, quantities=(), rate=rate, strings=strings, legacy=legacy
        ):
            has_host_times |= part._host_times.known is not None
            part.host_time.tofile(of_samples)
            found = np.empty(len(part.strings), STRING)
            found["offset"] = part.core.strings.offset
            found["time"] = part._host_times.strings
            found.tofile(of_strings)
    return CutCopy(path, os.stat(path).st_size, has_host_times)  # noqa: PTH116


def _of_samples(path: str) -> str:
    return path + ".samples"


def _of_strings(path: str) -> str:
    return path + ".strings"
