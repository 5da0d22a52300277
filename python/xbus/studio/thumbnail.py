"""A recording as a small picture."""

from __future__ import annotations

import html
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from xbus.export.palette import COLOURS
from xbus.formatting import format_count, format_size
from xbus.protocol.tables import QUANTITIES, device_of
from xbus.studio.sampled import MOST_DECOMPRESSED, columns_of, sampled

__all__ = ["thumbnail"]

#: Size of the picture in its own units: columns, and a height.
COLUMNS, HEIGHT = 160, 40
#: Width of the mark of a short gap.
SHORTEST = 0.8
#: The first of these that a recording has is drawn.
WANTED = (
    "acceleration",
    "acceleration_hr",
    "free_acceleration",
    "delta_v",
    "rate_of_turn",
    "rate_of_turn_hr",
    "euler_angles",
    "quaternion",
    "magnetic_field",
    "velocity_xyz",
    "baro_pressure",
    "temperature",
)


def thumbnail(files: Sequence[Path]) -> str:
    """Returns an SVG of one quantity over a recording; empty if there is none, a text if it is too large.

    Each column shows the minimum and the maximum of each component. The columns are moments of the
    recording; without time stamps, its packet counter or the places in its bytes. Gaps are marked. Of several
    devices, the first is drawn. See `xbus.studio.sampled` for what is read of a large recording.

    Args:
        files: The pieces of the recording.

    Raises:
        ImportError: The library for a compression is not installed.
        OSError: A file cannot be read.

    >>> thumbnail([Path("tests/captures/walk.mtb")])[:52]
    '<svg viewBox="0 0 160 40" preserveAspectRatio="none"'
    """
    found = sampled(files, COLUMNS, WANTED)
    if found is None:
        most = format_size(MOST_DECOMPRESSED)
        return f'<span class="xbus-quiet text-xs">no picture: more than {most} decompressed</span>'
    if (name := next((each for each in WANTED if each in found.log), None)) is None:
        return ""
    rows = found.log[name]
    bids = device_of(found.log.bid[rows.sample])
    own = bids == bids[0]
    sample = rows.sample[own]
    values = np.asarray(rows.values, np.float64).reshape(len(rows), -1)[own]
    places = columns_of(found.position[sample], COLUMNS)
    lines = [_line(places, component) for component in values.T]
    finite = np.concatenate([end for line in lines for end in (line[1], line[2])])
    if not len(finite):
        return ""
    low, high = float(finite.min()), float(finite.max())
    gaps = found.gaps(sample)
    marks = "".join(
        f'<rect x="{x:.2f}" width="{end - x:.2f}" height="{HEIGHT}"/>' for x, end in _marks(gaps)
    )
    paths = "".join(
        f'<path d="{_path(line, low, high)}" stroke="{COLOURS[at % len(COLOURS)]}"/>'
        for at, line in enumerate(lines)
    )
    unit = QUANTITIES[name].unit
    of = "" if own.all() else f" of BID {bids[0]}"
    facts = [f"{name}{of}, {low:.4g} to {high:.4g} {unit}".strip()]
    facts += [format_count(len(gaps), "gap")] if gaps else []
    title = html.escape(", ".join(facts))
    return (
        f'<svg viewBox="0 0 {COLUMNS} {HEIGHT}" preserveAspectRatio="none" class="xbus-thumbnail" role="img" '
        f'aria-label="{title}"><title>{title}</title>{marks}{paths}</svg>'
    )


def _marks(gaps: Iterable[tuple[float, float]]) -> list[tuple[float, float]]:
    """Returns the marks of gaps in ascending order: a short one is visible, and those that touch are one."""
    marks: list[tuple[float, float]] = []
    for begin, end in gaps:
        x, right = COLUMNS * begin, COLUMNS * max(end, begin + SHORTEST / COLUMNS)
        if marks and x <= marks[-1][1]:
            x = marks.pop()[0]
        marks.append((x, right))
    return marks


def _line(
    places: npt.NDArray[np.int64], values: npt.NDArray[np.float64]
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Returns the columns that have a number, and the minimum and the maximum of each."""
    is_finite = np.isfinite(values)
    places, values = places[is_finite], values[is_finite]
    low, high = np.full(COLUMNS, np.inf), np.full(COLUMNS, -np.inf)
    np.minimum.at(low, places, values)
    np.maximum.at(high, places, values)
    columns = np.flatnonzero(low <= high)
    return columns, low[columns], high[columns]


def _path(line: tuple[Any, Any, Any], low: float, high: float) -> str:
    """Returns a line from the minimum to the maximum of each column, as the data of an SVG path."""
    columns, lows, highs = line
    # Halves, because the difference of two numbers can be too large.
    scale = (high / 2 - low / 2) or 1.0
    top, bottom = ((HEIGHT - 2) * (1 - (ends / 2 - low / 2) / scale) + 1 for ends in (highs, lows))
    return "".join(
        f"M{column}.5 {one - 0.4:.1f}V{other + 0.4:.1f}"
        for column, one, other in zip(columns.tolist(), top.tolist(), bottom.tolist(), strict=True)
    )
