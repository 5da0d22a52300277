"""UTC along the axis of a report, run by run: how long a restart took is not on the axis, but in UTC."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from xbus.plots.thin import BoolArray, FloatArray

__all__ = ["Clock", "ClockPiece"]

#: Maximum number of runs whose UTC is kept; axes show no UTC for later ones.
MAX_RUNS = 1000
#: Shortest distance in s of two values of UTC that show the drift of the device's clock.
LONG = 10.0


class ClockPiece(NamedTuple):
    """The UTC of a run.

    Attributes:
        start: Where it begins on the axis.
        utc: UTC there in ns since 1970; None if it is not known.
        rate: Seconds of UTC per second of the axis.
    """

    start: float
    utc: int | None
    rate: float = 1.0


class _Run:
    """The first and the last UTC of a run; those of the receiver only if there are no others."""

    def __init__(self, start: float) -> None:
        self.start = start
        self.ends: tuple[tuple[float, int], tuple[float, int]] | None = None
        self._is_steady = False

    def add(self, x: FloatArray, utc: npt.NDArray[np.int64], steady: BoolArray) -> None:
        if steady.any():
            x, utc = x[steady], utc[steady]
            if not self._is_steady:
                self.ends, self._is_steady = None, True
        elif self._is_steady:
            return
        first, last = (float(x[0]), int(utc[0])), (float(x[-1]), int(utc[-1]))
        self.ends = (first if self.ends is None else self.ends[0]), last

    def piece(self) -> ClockPiece:
        if self.ends is None:
            return ClockPiece(self.start, None)
        (x, utc), (last_x, last_utc) = self.ends
        rate = (last_utc - utc) / 1e9 / (last_x - x) if last_x - x >= LONG else 1.0
        if not 0.99 < rate < 1.01:
            rate = 1.0  # UTC was corrected in between, which is no rate of the clock
        return ClockPiece(self.start, utc - round((x - self.start) * rate * 1e9), rate)


class Clock:
    """Collects the UTC of the runs of one device, part by part."""

    def __init__(self) -> None:
        self._runs: dict[int, _Run] = {}

    def add(
        self,
        x: FloatArray,
        run: npt.NDArray[np.int64],
        utc: npt.NDArray[np.datetime64],
        steady: BoolArray,
    ) -> None:
        """Adds samples.

        Args:
            x: Their positions, ``(N,)``.
            run: The numbers of their runs, ascending, ``(N,)``.
            utc: Their UTC, ``(N,)`` ``datetime64[ns]``; NaT if it is not known.
            steady: Whether they are on the clock of the device, not of the receiver, ``(N,)``.
        """
        is_known = ~np.isnat(utc)
        starts = np.flatnonzero(np.diff(run, prepend=-1))
        for first, end in zip(starts.tolist(), [*starts[1:].tolist(), len(run)], strict=True):
            number = int(run[first])
            if number not in self._runs:
                if len(self._runs) == MAX_RUNS:
                    return
                self._runs[number] = _Run(float(x[first]))
            rows = first + np.flatnonzero(is_known[first:end])
            if len(rows):
                self._runs[number].add(x[rows], utc[rows].astype(np.int64), steady[rows])

    def pieces(self) -> list[ClockPiece]:
        """Returns the UTC of each run, in order; empty if none is known."""
        found = [run.piece() for run in self._runs.values()]
        return found if any(piece.utc is not None for piece in found) else []
