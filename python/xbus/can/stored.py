"""Captures larger than memory, whose parts wait in a temporary file."""

from __future__ import annotations

import math
import pickle
import threading
from collections.abc import Iterable
from dataclasses import dataclass
from tempfile import TemporaryFile
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt

from xbus import _core
from xbus.can.read import CanLog
from xbus.log.arrivals import HostTimes
from xbus.log.log import Log, MissingDeviceError
from xbus.log.source import quantity_filter
from xbus.protocol.keys import Key
from xbus.protocol.tables import device_of

__all__ = ["StoredCapture", "StoredPart"]


class StoredCapture:
    """The parts of a capture, which are read once and can then be read again; a context manager.

    Args:
        logs: The parts, from `iter_can`.
        bid: The device whose samples are wanted, or None for all.

    Attributes:
        parts: The parts, in order; at least one.
        frames: Number of frames.
        findings: Sentences that say what is unusual.

    Raises:
        MissingDeviceError: The capture has no samples of the device.
        OSError: The temporary file cannot be written.
    """

    def __init__(self, logs: Iterable[CanLog], *, bid: int | None = None) -> None:
        self.frames = 0
        self.findings: tuple[str, ...] = ()
        self.parts: list[StoredPart] = []
        self._shape, self._lock = _core.Shape(), threading.Lock()
        self._file: BinaryIO = TemporaryFile(prefix="xbus-")  # noqa: SIM115 - `close` closes it
        try:
            self._store(logs, bid)
        except BaseException:
            self.close()
            raise

    def _store(self, logs: Iterable[CanLog], bid: int | None) -> None:
        counts: dict[int, int] = {}
        whole, own = _core.Shape(), _core.Shape()
        samples = 0
        for log in logs:
            self.frames += log.traffic.frames
            self.findings = log.traffic.findings
            core, host_time = log.core, log.host_time
            whole.add(core)
            for device, count in zip(*np.unique(core.bid, return_counts=True), strict=True):
                counts[int(device)] = counts.get(int(device), 0) + int(count)
            if bid is not None:
                host_time = host_time[device_of(core.bid) == device_of(bid)]
                core = core.of_device(bid, samples)
                own.add(core)
            start = self._file.tell()
            pickle.dump((core, host_time), self._file, pickle.HIGHEST_PROTOCOL)
            earliest = float(np.nanmin(core.time)) if np.isfinite(core.time).any() else math.nan
            self.parts.append(StoredPart(self, start, self.frames, len(core), earliest))
            samples += len(core)
        if bid is not None and not samples:
            raise MissingDeviceError(bid, counts)
        self._shape = whole if bid is None else whole.of_device(own)

    def load(self, start: int) -> tuple[_core.Part, npt.NDArray[np.float64]]:
        """Returns what is stored at a position: the samples with all columns, and their host times."""
        with self._lock:
            self._file.seek(start)
            core, host_time = pickle.load(self._file)  # noqa: S301 - what `_store` has written
        return core.shaped(self._shape), host_time

    def empty(self) -> _core.Part:
        """Returns a part without samples, with the columns of all parts."""
        return self._shape.empty()

    def close(self) -> None:
        """Removes the temporary file."""
        self._file.close()

    def __enter__(self) -> StoredCapture:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


@dataclass(frozen=True)
class StoredPart:
    """A part of a stored capture: a `xbus.log.parts.Part`.

    Attributes:
        end: Number of frames up to its end.
        samples: Number of its samples.
        earliest: The earliest `Log.time` of its samples in s, NaN if none has a time.
    """

    _capture: StoredCapture
    _start: int
    end: int
    samples: int
    earliest: float

    def read(self, *, quantities: Iterable[Key] | None = None) -> Log:
        """Returns the part as a log with the columns of the whole capture."""
        core, host_time = self._capture.load(self._start)
        host_times = HostTimes.known_already(core, host_time, {}, np.empty(0))
        return Log(core, quantities=quantity_filter(quantities), host_times=host_times)

    def empty(self, *, quantities: Iterable[Key] | None = None) -> Log:
        """Returns a log without samples, with the columns of the whole capture."""
        core = self._capture.empty()
        host_times: Any = HostTimes(core, is_known=True)
        return Log(core, quantities=quantity_filter(quantities), host_times=host_times)
