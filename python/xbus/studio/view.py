"""What pages show: kept by the server, so that a reload, and the next page, begin with it."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import dataclass, field, replace
from itertools import count
from typing import NamedTuple
from weakref import WeakValueDictionary

from xbus.studio.cursors import Cursors
from xbus.studio.history import SPAN, History

__all__ = ["CasterForm", "Held", "Plot", "RecordForm", "View", "held_of"]

_numbers = count(1)
_held: WeakValueDictionary[int, Held] = WeakValueDictionary()


class Plot(NamedTuple):
    """A plot: the port of a device, and the name of a series of it."""

    source: str
    name: str


class Held:
    """The samples of paused plots: nothing is added, and nothing is removed while a page or a view has it.

    Args:
        end: When the plots were paused, in seconds since 1970.

    Attributes:
        number: The number by which a page asks for it.

    >>> held = Held(10.0)
    >>> held_of(held.number) is held
    True
    """

    def __init__(self, end: float) -> None:
        self._end = end
        self._histories: dict[str, History] = {}
        self.number = next(_numbers)
        _held[self.number] = self

    def history(self, source: str) -> History:
        """Returns what is held of a device."""
        return self._histories.setdefault(source, History())

    def hold(self, plot: Plot, history: History) -> None:
        """Holds the samples of a plot, those before it was paused; once held, they stay."""
        own = self.history(plot.source)
        if plot.name not in own.series:
            series = history.copy(plot.name, self._end - SPAN, self._end)
            if series is not None:
                own.put(series)


def held_of(number: int) -> Held | None:
    """Returns what is held under a number; None if no page has it any more."""
    return _held.get(number)


@dataclass
class View:
    """What a page shows of a device.

    Attributes:
        plots: The plots; None before a choice.
        span: Seconds that live plots show.
        is_grid: Whether two plots are side by side.
        limits: The limits of the y axes that are locked; None if they are free.
        cursors: What paused plots show; None while they are live.
        held: The samples of paused plots; None while they are live.
        attitude: Name of the picture of the attitude.
        map_span: Seconds of the track that the map shows.
    """

    plots: list[Plot] | None = None
    span: int = 10
    is_grid: bool = False
    limits: dict[Plot, tuple[float, float]] | None = None
    cursors: Cursors | None = None
    held: Held | None = None
    attitude: str = "Horizon"
    map_span: int = 300

    def copy(self) -> View:
        """Returns a view that changes on its own; what is held is shared."""
        return replace(
            self,
            plots=None if self.plots is None else list(self.plots),
            limits=None if self.limits is None else dict(self.limits),
            cursors=deepcopy(self.cursors),
        )


@dataclass
class CasterForm:
    """What was entered for the corrections of a device. The password is never sent to a page."""

    address: str = ""
    mountpoint: str = ""
    user: str = ""
    password: str = field(default="", repr=False)
    sends_position: bool = True


@dataclass
class RecordForm:
    """What was entered for the next recording.

    Attributes:
        note: The note.
        duration: Seconds after which it stops; None for no limit.
        rotation: When the next file begins, as text.
        chosen: Whether a device is recorded, by port.
    """

    note: str = ""
    duration: float | None = None
    rotation: str | None = ""
    chosen: dict[str, bool] = field(default_factory=dict)
