"""The quality of a recorded magnetic field: its norm, what distorts it, and a verdict."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np
import numpy.typing as npt

from xbus.formatting import format_count
from xbus.plots.thin import FloatArray
from xbus.report.ellipsoid import Ellipsoid, coverage, fit_ellipsoid

__all__ = ["FieldQuality", "FieldRows", "Norm", "Quality", "magnetic_field_quality"]

#: Largest deviation of the norm, RMS divided by the mean, of a good and of a fair field. An offset of h times
#: the field gives h/sqrt(3), and turns the direction of the field by up to asin(h).
GOOD, FAIR = 0.02, 0.05
#: A correction that lowers the deviation by this factor is worth a calibration.
HELPS = 2.0
#: Least number of rows to judge by.
MIN_ROWS = 100
#: Least distance of the rows from their mean, RMS, divided by the RMS of the norm: less is a device at rest.
#: Hard iron of nine times the field is still found.
MIN_SPREAD = 0.1
#: Least extent along the shortest axis, divided by that along the longest: less is a turn about one axis.
MIN_FLATNESS = 0.2
#: Least share of the directions, and the largest condition number, of a fit that is determined well. With
#: noise of 1 % of the field, its centre is then known to 0.1 of the field or better, mostly far better.
MIN_COVERAGE, MAX_CONDITION = 0.45, 20.0
#: Rows whose norm deviates by more than this after the correction, RMS, are on no ellipsoid; nor are those on
#: one whose axes differ by more than this factor.
MAX_RESIDUAL, MAX_ASPECT = 0.1, 4.0
NO_ELLIPSOID = "the values are on no ellipsoid, so the field is not the same everywhere"
REMEDY = "turn the device about all of its axes, in one place"
#: A component beyond this, in a.u., is as wrong as NaN.
LARGEST = 1e6


class Quality(Enum):
    """How good a magnetic field is for a heading."""

    GOOD = "good"
    FAIR = "fair"
    DISTURBED = "disturbed"
    UNKNOWN = "not enough motion to judge"


@dataclass(frozen=True)
class Norm:
    """The norm of a magnetic field, in a.u.: 1 where the device was calibrated.

    Attributes:
        mean, std, min, max: Of all rows; NaN without a row.
        within_5, within_10: Share of rows within 5 % and 10 % of the mean, 0 to 1.
    """

    mean: float
    std: float
    min: float
    max: float
    within_5: float
    within_10: float


@dataclass(frozen=True)
class FieldQuality:
    """The quality of a magnetic field.

    Attributes:
        rows: Number of rows.
        missing: Number of further rows with NaN, infinity or an impossible number.
        norm: The norm.
        quality: The verdict.
        verdict: The same with its reason, in one sentence without a full stop.
        ellipsoid: The ellipsoid of the rows, with hard iron and soft iron; None if it is not known.
        coverage: Share of all directions that the field had in the axes of the device, 0 to 1; None if there
            is too little motion.
        before, after: Deviation of the norm without and with the correction, RMS divided by the mean; None
            without an ellipsoid.
        points: Rows evenly spaced over the recording, at most `FieldRows.MAX_POINTS`, ``(N, 3)``.
    """

    rows: int
    missing: int
    norm: Norm
    quality: Quality
    verdict: str
    ellipsoid: Ellipsoid | None
    coverage: float | None
    before: float | None
    after: float | None
    points: FloatArray


class FieldRows:
    """Collects a magnetic field part by part, in limited memory."""

    #: Points that the ellipsoid is fitted to, at most; at least half as many of a longer recording.
    MAX_POINTS = 1 << 13

    def __init__(self) -> None:
        self._rows = self._missing = 0
        self._mean = self._squares = 0.0
        self._min, self._max = np.inf, -np.inf
        self._points = np.empty((0, 3))
        #: Every how many rows one is a point.
        self._step = 1

    def add(self, values: npt.NDArray[np.floating]) -> None:
        """Adds rows, ``(N, 3)``, in a.u."""
        points = values.astype(np.float64)
        # A comparison with NaN is false.
        points = points[(np.abs(points) <= LARGEST).all(axis=1)]
        self._missing += len(values) - len(points)
        if not len(points):
            return
        self._add_norm(np.sqrt(np.square(points).sum(axis=1)))
        self._points = np.concatenate(
            (self._points, points[-self._rows % self._step :: self._step])
        )
        self._rows += len(points)
        while len(self._points) > self.MAX_POINTS:
            self._points, self._step = self._points[::2], 2 * self._step

    def _add_norm(self, norm: FloatArray) -> None:
        self._min, self._max = min(self._min, norm.min()), max(self._max, norm.max())
        rows = self._rows + len(norm)
        mean = norm.mean()
        difference = mean - self._mean
        self._squares += np.square(norm - mean).sum()
        self._squares += difference**2 * self._rows * len(norm) / rows
        self._mean += difference * len(norm) / rows

    def quality(self) -> FieldQuality:
        """Returns the quality of the rows so far."""
        points = self._points
        quality, before, after = Quality.UNKNOWN, None, None
        ellipsoid, seen, reason = _fitted(points)
        if ellipsoid is None and reason == NO_ELLIPSOID and (seen or 0) >= MIN_COVERAGE:
            quality = Quality.DISTURBED
            verdict = f"{quality.value}: the norm deviates by {_percent(_deviation(points))}, and {reason}"
        elif ellipsoid is None:
            verdict = f"{quality.value}: {reason}; {REMEDY}"
        else:
            before, after = _deviation(points), _deviation(ellipsoid.corrected(points))
            quality, verdict = _judged(before, after)
        return FieldQuality(
            rows=self._rows,
            missing=self._missing,
            norm=self._norm(),
            quality=quality,
            verdict=verdict,
            ellipsoid=ellipsoid,
            coverage=seen,
            before=before,
            after=after,
            points=points,
        )

    def _norm(self) -> Norm:
        if not self._rows:
            return Norm(*[np.nan] * 6)
        away = np.abs(np.sqrt(np.square(self._points).sum(axis=1)) - self._mean)
        shares = [float((away <= share * self._mean).mean()) for share in (0.05, 0.1)]
        std = float(np.sqrt(self._squares / self._rows))
        return Norm(float(self._mean), std, float(self._min), float(self._max), *shares)


def magnetic_field_quality(values: npt.ArrayLike) -> FieldQuality:
    """Returns the quality of a magnetic field: its norm, hard and soft iron, and a verdict.

    In a good magnetic environment the field has the same norm in whatever direction the device is turned.
    Magnets and currents that move with the device, hard iron, shift the field; iron that moves with it, soft
    iron, distorts it. Both turn the sphere of all measurements into an ellipsoid, which is fitted here. Iron
    that does not move with the device changes the field from place to place.

    The verdict is about the deviation of the norm from its mean, RMS: up to 2 % is good and up to 5 % fair.
    There is none if the field was seen in less than 45 % of the directions. A field whose values are on no
    ellipsoid, although it was seen in more, is disturbed.

    Args:
        values: ``magnetic_field`` of a log, ``(N, 3)``, in a.u.

    Raises:
        ValueError: The shape is another one.

    >>> import numpy as np
    >>> field = np.random.default_rng(1).normal(size=(1000, 3))
    >>> field /= np.linalg.norm(field, axis=1)[:, None]
    >>> magnetic_field_quality(field).verdict
    'good: the norm deviates by 0.0 %'
    >>> found = magnetic_field_quality(field + [0.3, 0.2, 0.1])
    >>> found.verdict
    'disturbed: the norm deviates by 20 %, and by 0.0 % after a correction of iron that moves with the device'
    >>> found.ellipsoid.center.round(6).tolist()
    [0.3, 0.2, 0.1]
    >>> magnetic_field_quality(field[:1].repeat(1000, axis=0)).quality
    <Quality.UNKNOWN: 'not enough motion to judge'>
    """
    array = np.asarray(values)
    if array.ndim != 2 or array.shape[1] != 3:
        raise ValueError(f"a magnetic field has the shape (N, 3), not {array.shape}")
    rows = FieldRows()
    rows.add(array)
    return rows.quality()


def _fitted(points: FloatArray) -> tuple[Ellipsoid | None, float | None, str]:
    """Returns the ellipsoid of points, and the share of its directions that they have.

    Without an ellipsoid that is determined well, it is None, and the text says why.
    """
    if len(points) < MIN_ROWS:
        return None, None, f"the recording has only {format_count(len(points), 'row')}"
    extent = np.sqrt(np.linalg.eigvalsh(np.cov(points.T)).clip(0))
    spread, size = np.square(extent).sum(), np.square(points).sum(axis=1).mean()
    if not spread > MIN_SPREAD**2 * size:
        return None, None, "the device was hardly turned"
    if extent[0] < MIN_FLATNESS * extent[2]:
        return None, None, "the device was turned about one axis only"
    ellipsoid = fit_ellipsoid(points)
    if (
        ellipsoid is None
        or ellipsoid.axes[2] > MAX_ASPECT * ellipsoid.axes[0]
        or _deviation(corrected := ellipsoid.corrected(points)) > MAX_RESIDUAL
    ):
        return None, coverage(points), NO_ELLIPSOID
    seen = coverage(corrected)
    if seen < MIN_COVERAGE or ellipsoid.condition > MAX_CONDITION:
        return None, seen, f"the field was seen in {100 * seen:.0f} % of the directions"
    return ellipsoid, seen, ""


def _deviation(points: FloatArray) -> float:
    """Returns the deviation of the norm from its mean, RMS divided by the mean."""
    norm = np.sqrt(np.square(points).sum(axis=1))
    return float(norm.std() / norm.mean())


def _judged(before: float, after: float) -> tuple[Quality, str]:
    """Returns the quality of a field by its deviation without and with a correction, and the verdict."""
    quality = (
        Quality.GOOD if before <= GOOD else Quality.FAIR if before <= FAIR else Quality.DISTURBED
    )
    verdict = f"{quality.value}: the norm deviates by {_percent(before)}"
    if quality == Quality.GOOD:
        return quality, verdict
    if before > HELPS * after:
        how = "after a correction of iron that moves with the device"
    else:
        how = "also after a correction, so the field is not the same everywhere"
    return quality, f"{verdict}, and by {_percent(after)} {how}"


def _percent(share: float) -> str:
    return f"{100 * share:.2g} %" if share >= 0.001 else f"{100 * share:.1f} %"
