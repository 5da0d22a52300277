"""Whether ``--rate`` gives a time to samples."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from xbus.formatting import format_count

if TYPE_CHECKING:
    from xbus.log.log import Log

__all__ = ["RateUse"]

#: The clocks of quantities with a time stamp.
STAMPS = ("fine", "coarse", "trigger")


@dataclass
class RateUse:
    """Counts the samples to which ``--rate`` gives a time.

    Attributes:
        rate: The rate, or None.
        derived: Number of samples whose time comes from the packet counter.
        untimed: Number of samples with a packet counter and without a time.
        has_counter: Whether a sample has a packet counter.
    """

    rate: float | None
    derived: int = 0
    untimed: int = 0
    has_counter: bool = False

    def watch(self, parts: Iterable[Log]) -> Iterator[Log]:
        """Yields the parts of a log, and counts their samples."""
        for part in parts:
            self.add(part)
            yield part

    def add(self, part: Log) -> None:
        """Counts the samples of a log, or of a part of one."""
        if self.rate is None or not len(part):
            return
        import numpy as np

        from xbus.protocol.tables import COLUMN_QUANTITIES

        is_counted = part.packet_counter != -1
        is_timed = np.isfinite(part.time)
        self.has_counter |= bool(is_counted.any())
        self.untimed += int(np.count_nonzero(is_counted & ~is_timed))
        for column in part.core.columns:
            if column.name is not None and COLUMN_QUANTITIES[column.name].clock in STAMPS:
                is_timed[column.sample - part.first_sample] = False
        self.derived += int(np.count_nonzero(is_timed))

    @property
    def note(self) -> str | None:
        """What to say if the rate has no effect, or not on all samples; else None."""
        if self.rate is None:
            return None
        if not self.has_counter:
            return "--rate has no effect: no sample has a packet counter"
        if not self.derived:
            return "--rate has no effect: the device sends time stamps"
        if self.untimed:
            samples = format_count(self.untimed, "sample")
            return f"--rate gives no time to {samples} after the first time stamp of the device"
        return None
