"""The colours of curves."""

from __future__ import annotations

from typing import NamedTuple

__all__ = ["ALARM", "COLOURS", "Style", "style_of"]

#: Colours of curves, from Okabe and Ito: people with any kind of colour blindness distinguish them, and
#: they are visible on white and on black.
COLOURS = ("#d55e00", "#0072b2", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
#: The colour of problems.
ALARM = "#d62828"


class Style(NamedTuple):
    """How a curve is drawn."""

    colour: str
    is_dashed: bool


def style_of(number: int) -> Style:
    """Returns the style of a curve of a plot; when all colours are used, lines are dashed.

    >>> style_of(0), style_of(6)
    (Style(colour='#d55e00', is_dashed=False), Style(colour='#d55e00', is_dashed=True))
    """
    return Style(COLOURS[number % len(COLOURS)], number // len(COLOURS) % 2 == 1)
