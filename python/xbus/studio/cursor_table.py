"""The table of the cursors A and B: what is at them, and between them, as text."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from xbus.studio.history import Reading, Selection

__all__ = ["HEADS", "apart", "table_of"]

#: The columns of the table of the cursors, and what they mean.
HEADS = (
    ("", "component"),
    ("A", "the last sample at cursor A or before it"),
    ("B", "the last sample at cursor B or before it"),
    ("B - A", "difference of these two; of an angle, the shorter way round"),
    ("n", "samples from one cursor to the other that are numbers"),
    ("mean", "arithmetic mean; like all on its right, of angles without jumps at 180 degrees"),
    ("std", "standard deviation: the root of the mean square of the deviations from the mean"),
    ("min", "smallest value"),
    ("max", "largest value"),
    ("max - min", "peak to peak"),
    ("slope/min", "slope of the line of least squares, per minute"),
)
#: Digits of a number that is no position on the scale, and of the spread of those that are.
DIGITS, SPREAD_DIGITS = 5, 4
#: Decimals of a number, at most.
MAX_DECIMALS = 12


def apart(seconds: float) -> str:
    """Returns how far B is after A, and the frequency of that period."""
    return f"B - A {seconds:.6f} s" + (f", {1 / abs(seconds):.5g} Hz" if seconds else "")


def table_of(name: str, selection: Selection, a: float | None, b: float | None) -> dict[str, Any]:
    """Returns the rows about a series for the table of the cursors.

    Args:
        name: Name of the plot.
        selection: The series at the cursors and between them.
        a: Time of cursor A; None without one.
        b: Time of cursor B; None without one.
    """
    series = selection.series
    notes = []
    if selection.lost is not None:
        notes.append(_lost(selection.lost))
    starts = [at for at in (a, b) if at is not None]
    if starts and min(starts) < selection.first:
        late = selection.first - min(starts)
        notes.append(f"the samples begin {late:.3g} s after the first cursor")
    readings = {"A": selection.a, "B": selection.b}
    old = [each for each, reading in readings.items() if reading is not None and reading.is_old]
    for each, at in (("A", a), ("B", b)):
        if each in old and at is not None and (reading := readings[each]) is not None:
            notes.append(f"{each}: the last sample is {at - reading.time:.3g} s older")
    return {
        "name": name,
        "title": f"{name} [{series.unit}]" if series.unit else name,
        "notes": notes,
        "old": old,
        "rows": [_row(selection, at) for at in range(len(series.fields))],
    }


def _lost(seconds: float) -> str:
    if math.isnan(seconds):
        return "too few samples to know what is lost"
    return f"lost {seconds:.3f} s" if seconds else "nothing lost"


def _row(selection: Selection, at: int) -> list[str]:
    """Returns the cells of a component."""

    def value(reading: Reading | None) -> float:
        return math.nan if reading is None else float(reading.values[at])

    before, after, statistics = value(selection.a), value(selection.b), selection.statistics
    field = selection.series.fields[at]
    if statistics is None:
        spread = 0.0
        rest = [""] * (len(HEADS) - 4)
    else:
        spread = float(statistics.peak_to_peak[at])
        places = [statistics.mean, statistics.minimum, statistics.maximum]
        mean, low, high = (_place(float(each[at]), spread) for each in places)
        widths = [statistics.std, statistics.peak_to_peak, statistics.slope]
        std, width, slope = (_width(float(each[at])) for each in widths)
        rest = [str(int(statistics.number[at])), mean, std, low, high, width, slope]
    change = "" if selection.change is None else _width(float(selection.change[at]))
    return [field, _place(before, spread), _place(after, spread), change, *rest]


def _place(value: float, spread: float) -> str:
    """Returns a value with the digits that show how it differs from others that are ``spread`` apart."""
    if not math.isfinite(value):
        return "-"
    if not (spread > 0 and math.isfinite(spread)):
        return f"{value:.9g}"
    decimals = min(max(SPREAD_DIGITS - 1 - math.floor(math.log10(spread)), 0), MAX_DECIMALS)
    return f"{np.round(value, decimals) + 0.0:.{decimals}f}"


def _width(value: float) -> str:
    return "-" if not math.isfinite(value) else f"{value:.{DIGITS}g}"
