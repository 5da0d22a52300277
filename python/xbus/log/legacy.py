"""Settings of MTData that the caller of `read_log` knows."""

from __future__ import annotations

from collections.abc import Sequence
from operator import index
from typing import Any, SupportsIndex

from xbus.wire.mtdata import mtdata_layout

__all__ = ["Legacy", "legacy_outputs"]

#: OutputMode and OutputSettings of a device; several pairs are those of the trackers of an Xbus Master.
Legacy = tuple[SupportsIndex, SupportsIndex] | Sequence[tuple[SupportsIndex, SupportsIndex]]


def legacy_outputs(legacy: Legacy | None) -> list[tuple[int, int]]:
    """Returns the settings of each device.

    Raises:
        TypeError: ``legacy`` is neither a pair of integers nor a list of pairs.
        ValueError: No source gives the layout of some settings, they do not fit 16 and 32 bits, or there are
            more than 31 pairs.

    >>> legacy_outputs((0x0006, 0x0000_0001))
    [(6, 1)]
    """
    if legacy is None:
        return []
    pairs: list[Any] = [legacy] if _is_pair(legacy) else list(legacy)
    if isinstance(legacy, str) or not all(map(_is_pair, pairs)):
        raise TypeError(
            f"legacy is a pair (OutputMode, OutputSettings), or a list of them, not {legacy!r}"
        )
    if len(pairs) > MOST_TRACKERS:
        raise ValueError(f"an Xbus Master has at most {MOST_TRACKERS} trackers, not {len(pairs)}")
    pairs = [(index(mode), index(settings)) for mode, settings in pairs]
    for mode, settings in pairs:
        if not (0 <= mode <= 0xFFFF and 0 <= settings <= 0xFFFF_FFFF):
            raise ValueError(
                f"OutputMode has 16 bits and OutputSettings 32: {mode:#x} and {settings:#x} do not fit"
            )
        mtdata_layout(mode, settings)
    return pairs


#: Most trackers of an Xbus Master: their bus identifiers are 1 to 31.
MOST_TRACKERS = 31


def _is_pair(value: object) -> bool:
    return (
        isinstance(value, tuple)
        and len(value) == 2
        and all(hasattr(number, "__index__") for number in value)
    )
