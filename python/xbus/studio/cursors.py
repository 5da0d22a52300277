"""The part of the time that paused plots show, and the cursors A and B in it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

__all__ = ["NAMES", "Cursors", "Name"]

Name = Literal["A", "B"]
NAMES: tuple[Name, Name] = ("A", "B")
#: Shortest part of the time that is shown, in seconds.
SHORTEST = 0.01
#: Place of a new cursor in the part that is shown, if nothing else is known.
PLACES: dict[Name, float] = {"A": 1 / 3, "B": 2 / 3}


@dataclass
class Cursors:
    """The view of paused plots. All times are in seconds since 1970.

    Attributes:
        first: Earliest time that can be shown.
        last: Latest time that can be shown.
        begin: Begin of the part that is shown.
        end: End of it.
        active: The cursor that moves.

    >>> view = Cursors(first=0, last=100, begin=90, end=100)
    >>> view.place(92.0), view.place(98.0), view.times
    (None, None, {'A': 92.0, 'B': 98.0})
    >>> view.zoom(0.5)
    >>> view.begin, view.end  # around B, where it is on the screen
    (94.0, 99.0)
    """

    first: float
    last: float
    begin: float
    end: float
    active: Name = "A"

    def __post_init__(self) -> None:
        self.times: dict[Name, float] = {}

    def place(self, time: float) -> None:
        """Puts the active cursor at a time; B follows A until both are there."""
        self.times[self.active] = time
        if self.active == "A" and "B" not in self.times:
            self.active = "B"

    def choose(self, name: Name, time: float | None = None) -> None:
        """Makes a cursor the active one.

        Args:
            name: The cursor.
            time: Where to put it; None to leave it. A new one begins in the middle of the part that is shown.
        """
        self.active = name
        if time is None:
            time = self.times.get(name, self.begin + PLACES[name] * (self.end - self.begin))
        self.times[name] = time
        self._reveal(time)

    def move(self, seconds: float) -> None:
        """Moves the active cursor, or the only one; the part that is shown follows it."""
        if self.active not in self.times and self.times:
            (self.active,) = self.times
        if self.active in self.times:
            time = min(max(self.times[self.active] + seconds, self.first), self.last)
            self.times[self.active] = time
            self._reveal(time)

    def show(self, begin: float, end: float) -> None:
        """Shows a part of the time, as far as it can be shown."""
        width = min(max(end - begin, SHORTEST), self.last - self.first)
        middle = (begin + end) / 2
        self.begin = min(max(middle - width / 2, self.first), self.last - width)
        self.end = self.begin + width

    def zoom(self, factor: float) -> None:
        """Shows ``factor`` times as much time; the active cursor, or else the middle, keeps its place."""
        width = self.end - self.begin
        centre = self.times.get(self.active, self.begin - 1)
        share = (centre - self.begin) / width
        if not 0 <= share <= 1:
            share, centre = 0.5, (self.begin + self.end) / 2
        begin = centre - share * factor * width
        self.show(begin, begin + factor * width)

    def _reveal(self, time: float) -> None:
        """Moves the part that is shown until a time is in it."""
        shift = min(time - self.begin, 0.0) or max(time - self.end, 0.0)
        if shift:
            self.show(self.begin + shift, self.end + shift)
