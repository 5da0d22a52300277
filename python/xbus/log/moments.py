"""Moments in a recording: seconds since its first sample, or UTC."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from datetime import UTC, datetime

import numpy as np
import numpy.typing as npt

from xbus.log.log import Log
from xbus.log.pacing import ReplayPace

__all__ = ["Between", "Moment", "OrderError", "check_order", "parse_moment", "seconds_of"]

#: A place in a recording: seconds since its first sample, or UTC as a datetime or text in ISO 8601.
Moment = float | str | datetime | np.datetime64
#: From the first moment on, up to but without the second; None for the start and the end.
Between = tuple[Moment | None, Moment | None]


class OrderError(ValueError):
    """The second of two moments is not after the first."""

    def __init__(self, moments: Between) -> None:
        start, end = moments
        first = "the first sample" if start is None else start
        super().__init__(f"the end must be after the start: {end} is not after {first}")


def seconds_of(moments: Between, parts: Callable[[], Iterator[Log]]) -> tuple[float, float]:
    """Returns moments as seconds since the first sample.

    Args:
        moments: The moments.
        parts: Reads the parts of the recording, with the quantities in `NEEDED`, if UTC is needed.

    Raises:
        OrderError: The second moment is not after the first.
        ValueError: A moment is no time, or the recording has no valid UTC.
    """
    check_order(moments)
    wanted = [parse_moment(moment) for moment in moments]
    if any(isinstance(moment, np.datetime64) for moment in wanted):
        times, utc = _utc(parts())
        origin = utc[0]
        known = (utc - origin) / np.timedelta64(1, "s")
        wanted = [
            _interpolated((moment - origin) / np.timedelta64(1, "s"), known, times)
            if isinstance(moment, np.datetime64)
            else moment
            for moment in wanted
        ]
    start, end = wanted
    start = 0.0 if start is None else float(start)
    end = math.inf if end is None else float(end)
    if not start < end:
        raise OrderError(moments)
    return start, end


def check_order(moments: Between) -> None:
    """Checks that the second moment is after the first, as far as this is known without a recording.

    Raises:
        OrderError: It is not.
        ValueError: A moment is no time, or there are not two.
    """
    if len(moments) != 2:
        raise ValueError(f"between has two moments, a start and an end, not {moments!r}")
    start, end = map(parse_moment, moments)
    if start is not None and type(start) is type(end) and not start < end:
        raise OrderError(moments)


def parse_moment(moment: Moment | None) -> float | np.datetime64 | None:
    """Returns a moment as a number of seconds or as UTC; None for None.

    Raises:
        ValueError: It is no time.
    """
    if moment is None:
        return None
    if isinstance(moment, np.datetime64):
        if np.isnat(moment):
            raise ValueError("a moment must be a date, not NaT")
        return moment
    if isinstance(moment, int | float | np.number):
        if not math.isfinite(moment):
            raise ValueError(f"a moment must be a finite number of seconds, or UTC, not {moment}")
        if moment < 0:
            raise ValueError(f"seconds count from the first sample and are not negative: {moment}")
        return float(moment)
    try:
        date = datetime.fromisoformat(moment) if isinstance(moment, str) else moment
        if date.tzinfo is not None:
            date = date.astimezone(UTC).replace(tzinfo=None)
        return np.datetime64(date, "ns")
    except (AttributeError, ValueError):
        raise ValueError(
            f"{moment!r} is neither seconds nor UTC such as 2026-11-22T09:30:00"
        ) from None


def _utc(parts: Iterator[Log]) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.datetime64]]:
    """Returns seconds since the first sample, and UTC, where UTC is known."""
    pace = ReplayPace(math.inf)
    times, dates = [], []
    for part in parts:
        seconds = pace.times(part)
        is_known = ~np.isnat(part.utc)
        times.append(seconds[is_known])
        dates.append(part.utc[is_known])
    if not sum(map(len, times)):
        raise ValueError("the recording has no valid UTC; use seconds")
    return np.concatenate(times), np.concatenate(dates)


def _interpolated(
    at: np.float64, known: npt.NDArray[np.float64], times: npt.NDArray[np.float64]
) -> float:
    order = np.argsort(known, kind="stable")
    known, times = known[order], times[order]
    beyond = min(at - known[0], 0.0) + max(at - known[-1], 0.0)
    return float(np.interp(at, known, times) + beyond)
