"""The spectrum of a quantity, part by part: Welch's method, over all time and over stretches of time."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from xbus.plots.thin import BoolArray, FloatArray

__all__ = ["Spectrum"]

#: Rows without a gap from which the rate is known well enough to choose the length of a segment.
MIN_ROWS = 64
#: Approximate length of a segment in s, and its limits in rows.
SECONDS, SHORTEST, LONGEST = 2.56, 64, 8192
#: A segment of another rate is left out if it differs by more than this share.
TOLERANCE = 0.1
#: Maximum number of columns and rows of a spectrogram.
COLUMNS, ROWS = 512, 256
#: Segments that are transformed at once.
BATCH = 64


class Spectrum:
    """Power spectral density by Welch's method: Hann windows that overlap by half, without their mean.

    Attributes:
        size: Rows of a segment, a power of two; 0 while the rate is not known.
        segments: Number of segments.
        left_out: Number of segments of another rate.

    >>> import numpy as np
    >>> time = np.arange(10_000) / 100
    >>> spectrum = Spectrum()
    >>> sine = 3 * np.sin(2 * np.pi * 12.5 * time)
    >>> spectrum.add(time, sine[:, None], np.zeros(10_000, bool))
    >>> frequency, density = spectrum.density()
    >>> float(frequency[density[:, 0].argmax()]), spectrum.size
    (12.5, 256)
    """

    def __init__(self) -> None:
        self.size = self.segments = self.left_out = 0
        self._rate = float("nan")
        self._seconds = 0.0
        self._power: FloatArray = np.empty(0)
        #: The last rows without a gap, whose segments are not complete.
        self._time: FloatArray = np.empty(0)
        self._values: FloatArray = np.empty((0, 0))
        #: Width of a column in s, and for each column the sum of the power and the number of segments.
        self._width = 0.0
        self._columns: FloatArray = np.empty((0, 0))
        self._counts: FloatArray = np.zeros(COLUMNS)

    def add(self, time: FloatArray, values: npt.NDArray[Any], breaks: BoolArray) -> None:
        """Adds rows.

        Args:
            time: Times, ``(N,)``, s.
            values: ``(N, k)``. A row that is not finite is a gap.
            breaks: Whether rows are missing before each row, ``(N,)``.
        """
        if not len(time):
            return
        finite = np.isfinite(values).all(axis=1)
        is_start = breaks | ~finite
        is_start[1:] |= ~finite[:-1]
        edges = np.append(np.flatnonzero(is_start), len(time))
        if edges[0] > 0:
            self._add_piece(time[: edges[0]], values[: edges[0]].astype(np.float64))
        # Of the pieces that begin here, a short one has no segment, unless the next rows continue it.
        first, end = edges[:-1], edges[1:]
        is_long = (end - first >= SHORTEST) | (end == len(time))
        for at, to in zip(first[is_long].tolist(), end[is_long].tolist(), strict=True):
            self._time = np.empty(0)
            if finite[at]:
                self._add_piece(time[at:to], values[at:to].astype(np.float64))

    def _add_piece(self, time: FloatArray, values: FloatArray) -> None:
        """Adds rows that follow the last ones without a gap."""
        if len(self._time):
            time = np.concatenate((self._time, time))
            values = np.concatenate((self._values, values))
        if not self.size and len(time) >= MIN_ROWS:
            self._choose_size(time[:MIN_ROWS], values.shape[1])
        hop = self.size // 2
        number = (len(time) - self.size) // hop + 1 if hop else 0
        for first in range(0, number, BATCH):
            chosen = np.arange(first, min(first + BATCH, number)) * hop
            self._transform(time, values, chosen)
        rest = max(number, 0) * hop
        self._time, self._values = time[rest:], values[rest:]

    def _choose_size(self, time: FloatArray, width: int) -> None:
        span = float(time[-1] - time[0])
        if span <= 0:
            return
        self._rate = (len(time) - 1) / span
        size = 2 ** round(np.log2(SECONDS * self._rate))
        self.size = int(np.clip(size, SHORTEST, LONGEST))
        self._power = np.zeros((self.size // 2 + 1, width))
        self._width = 2.0 ** np.ceil(np.log2(self.size / 2 / self._rate))
        self._columns = np.zeros((COLUMNS, min(self.size // 2, ROWS)))

    def _transform(
        self, time: FloatArray, values: FloatArray, first: npt.NDArray[np.int64]
    ) -> None:
        """Adds the segments that begin at these rows."""
        last = first + self.size - 1
        seconds = time[last] - time[first]
        with np.errstate(divide="ignore"):
            usual = np.abs((self.size - 1) / seconds / self._rate - 1) <= TOLERANCE
        self.left_out += int(np.count_nonzero(~usual))
        first, last = first[usual], last[usual]
        if not len(first):
            return
        segments = values[first[:, None] + np.arange(self.size)]
        segments -= segments.mean(axis=1, keepdims=True)
        segments *= _hann(self.size)[:, None]
        power = np.square(np.abs(np.fft.rfft(segments, axis=1)))
        self.segments += len(first)
        self._seconds += float(seconds[usual].sum())
        self._power += power.sum(axis=0)
        # Without the mean, which is zero.
        rows = power.sum(axis=2)[:, 1:].reshape(len(first), self._columns.shape[1], -1).mean(axis=2)
        self._add_columns((time[first] + time[last]) / 2, rows)

    def _add_columns(self, time: FloatArray, rows: FloatArray) -> None:
        while (time[-1] // self._width) >= COLUMNS:
            self._width *= 2
            half = self._columns[0::2] + self._columns[1::2]
            self._columns = np.concatenate((half, np.zeros_like(half)))
            counts = self._counts[0::2] + self._counts[1::2]
            self._counts = np.concatenate((counts, np.zeros_like(counts)))
        place = np.clip(time // self._width, 0, COLUMNS - 1).astype(np.intp)
        np.add.at(self._columns, place, rows)
        np.add.at(self._counts, place, 1)

    @property
    def rate(self) -> float:
        """Mean rows per second of the segments."""
        return self.segments * (self.size - 1) / self._seconds

    @property
    def _scale(self) -> float:
        """Turns squared magnitudes to density: both sides, per Hz."""
        return float(2 / (self.rate * np.square(_hann(self.size)).sum()))

    def density(self) -> tuple[FloatArray, FloatArray]:
        """Returns frequencies in Hz, ``(m,)``, and the density of each component in unit^2/Hz, ``(m, k)``.

        Both are empty without a segment. The frequency 0 is left out.
        """
        if not self.segments:
            return np.empty(0), np.empty((0, 0))
        density = self._power * self._scale / self.segments
        density[-1] /= 2  # the Nyquist frequency has no other side
        frequency: FloatArray = np.arange(1, len(density)) * self.rate / self.size
        return frequency, density[1:]

    def over_time(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Returns the spectrogram, summed over the components; only with a segment.

        Returns:
            The edges of the columns in s, ``(c + 1,)``; the middles of the rows in Hz, ``(r,)``; and the
            density in unit^2/Hz, ``(r, c)``, with NaN where there is no segment.
        """
        known = np.flatnonzero(self._counts)
        columns = np.arange(known[0], known[-1] + 1)
        with np.errstate(invalid="ignore"):
            density = self._columns[columns] * self._scale / self._counts[columns, None]
        group = self.size // 2 // density.shape[1]
        step = self.rate / self.size
        rows = (1 + (group - 1) / 2 + group * np.arange(density.shape[1])) * step
        return np.append(columns, columns[-1] + 1) * self._width, rows, density.T


def _hann(size: int) -> FloatArray:
    """Returns the periodic Hann window."""
    window: FloatArray = np.hanning(size + 1)[:-1]
    return window
