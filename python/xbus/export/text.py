"""Many numbers as text, without a loop over them."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
import numpy.typing as npt

__all__ = ["formatted", "shortest", "utc_text"]

#: Units of ISO 8601 fractions, and their nanoseconds.
FRACTIONS: tuple[tuple[Literal["s", "ms", "us", "ns"], int], ...] = (
    ("s", 10**9),
    ("ms", 10**6),
    ("us", 1000),
    ("ns", 1),
)


def formatted(template: str, values: npt.NDArray[Any], missing: str = "") -> list[str]:
    """Returns each number in a template, which has one place for it; ``missing`` for NaN.

    >>> formatted("<ele>%.1f</ele>", np.array([1.25, np.nan]))
    ['<ele>1.2</ele>', '']
    """
    is_known = values == values
    known = values if is_known.all() else values[is_known]
    texts = ((template + "\n") * len(known) % tuple(known.tolist())).split("\n")[:-1]
    if len(known) == len(values):
        return texts
    found = iter(texts)
    return [next(found) if known else missing for known in is_known.tolist()]


def shortest(values: npt.NDArray[np.floating[Any]]) -> list[str]:
    """Returns each number with the fewest digits that give the same float64 again, without an exponent.

    NaN is an empty text.

    >>> shortest(np.array([52.2404917, 1e-7, 3.0, np.nan]))
    ['52.2404917', '0.0000001', '3.0', '']
    """
    texts = formatted("%r", values)
    magnitude = np.abs(values)
    # These are the numbers that `repr` writes with an exponent.
    for row in np.flatnonzero(((magnitude < 1e-4) & (values != 0)) | (magnitude >= 1e16)).tolist():
        texts[row] = np.format_float_positional(values[row], trim="0")
    return texts


def utc_text(stamps: npt.NDArray[np.datetime64]) -> list[str]:
    """Returns times as ISO 8601 with Z, as many digits as needed in groups of three; empty for NaT.

    >>> utc_text(np.array(["2026-02-03T04:05:06.250", "NaT"], "M8[ns]"))
    ['2026-02-03T04:05:06.250Z', '']
    """
    texts = np.full(len(stamps), "", object)
    nanoseconds = stamps.astype("M8[ns]").view(np.int64)
    rest = np.flatnonzero(~np.isnat(stamps))
    for unit, step in FRACTIONS:
        is_whole = nanoseconds[rest] % step == 0
        rows = rest[is_whole]
        texts[rows] = np.char.add(np.datetime_as_string(stamps[rows], unit=unit), "Z")
        rest = rest[~is_whole]
    found: list[str] = texts.tolist()
    return found
