"""A recording as a small picture, from samples of it: a file of any size takes the same time."""

from __future__ import annotations

import html
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from xbus.export.palette import COLOURS
from xbus.log.log import Log
from xbus.log.read import read_log
from xbus.protocol.tables import QUANTITIES

__all__ = ["thumbnail"]

#: Size of the picture in its own units: one column for each place in the recording that is read.
COLUMNS, HEIGHT = 160, 40
#: A recording up to this size is read as a whole; of a larger one, this many bytes for each column.
WHOLE, WINDOW = 4 << 20, 24 << 10
#: Bytes at the start of a recording that are read with each window: legacy devices describe samples there.
HEAD = 2048
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

Rows = tuple[npt.NDArray[Any], npt.NDArray[Any]]


def thumbnail(files: Sequence[Path]) -> str:
    """Returns an SVG of one quantity over a recording; empty if it has none to draw.

    Each column shows the minimum and the maximum of each component, at its place in the bytes of the
    recording. Of a large recording only a part of each column is read, 4 MB in all.

    Args:
        files: The pieces of the recording.

    Raises:
        OSError: A file cannot be read.

    >>> thumbnail([Path("tests/captures/walk.mtb")])[:52]
    '<svg viewBox="0 0 160 40" preserveAspectRatio="none"'
    """
    found: dict[str, list[Rows]] = {}
    for columns, log in _samples(files):
        for name in WANTED:
            if name in log:
                rows = log[name]
                values = np.asarray(rows.values, np.float64).reshape(len(rows), -1)
                found.setdefault(name, []).append((columns[rows.sample], values))
    if not found:
        return ""
    name = min(found, key=WANTED.index)
    places, values = (np.concatenate(parts) for parts in zip(*found[name], strict=True))
    lines = [_line(places, component) for component in values.T]
    ends = [end for line in lines for end in (line[1], line[2])]
    finite = np.concatenate(ends)
    if not len(finite):
        return ""
    low, high = float(finite.min()), float(finite.max())
    paths = "".join(
        f'<path d="{_path(line, low, high)}" stroke="{COLOURS[at % len(COLOURS)]}"/>'
        for at, line in enumerate(lines)
    )
    unit = QUANTITIES[name].unit
    title = html.escape(f"{name}, {low:.4g} to {high:.4g} {unit}".strip())
    return (
        f'<svg viewBox="0 0 {COLUMNS} {HEIGHT}" preserveAspectRatio="none" class="xbus-thumbnail" role="img" '
        f'aria-label="{title}"><title>{title}</title>{paths}</svg>'
    )


def _samples(files: Sequence[Path]) -> Iterator[tuple[npt.NDArray[np.int64], Log]]:
    """Yields parts of a recording, with the column of each sample."""
    sizes = [file.stat().st_size for file in files]
    total = sum(sizes)
    if total <= WHOLE:
        data = b"".join(file.read_bytes() for file in files)
        log = read_log(data, quantities=WANTED)
        yield log.offset * COLUMNS // max(total, 1), log
        return
    head = _read(files, sizes, 0, HEAD)
    for column in range(COLUMNS):
        data = head + _read(files, sizes, total * column // COLUMNS, WINDOW)
        log = read_log(data, quantities=WANTED)
        places = np.where(log.offset < len(head), 0, column)
        yield places, log


def _read(files: Sequence[Path], sizes: Sequence[int], start: int, size: int) -> bytes:
    """Returns bytes of the recording; fewer at the end of a piece."""
    for file, length in zip(files, sizes, strict=True):
        if start < length:
            with file.open("rb") as opened:
                opened.seek(start)
                return opened.read(size)
        start -= length
    return b""


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
