"""The NMEA sentences of a device or a recording as they arrive."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import TYPE_CHECKING

import click
import numpy as np

from xbus.cli.failure import Failure
from xbus.export.nmea import MARK, ORIENTATIONS, Sentences, nmea_positions, sentences, texts_of
from xbus.protocol.tables import device_of

if TYPE_CHECKING:
    from xbus.describe.log_summary import LogSummary
    from xbus.log.log import Log

__all__ = ["NmeaStream"]

#: Seconds in which a device that sends strings sends the first one, and each of its quantities.
WAIT = 2.0


class NmeaStream:
    """The strings of a device; if it sends none, sentences made from its samples, as in an ``.nmea`` file.

    Args:
        recording: The content of a recording; None for a device, which has `WAIT` seconds to send a string.
    """

    def __init__(self, recording: LogSummary | None = None) -> None:
        self._due = time.monotonic() + WAIT
        self._names: set[str] = set()
        self._devices: set[int] = set()
        self._has_strings = False
        self._made: Sentences | None = None
        if recording is not None:
            self._due = 0.0
            self._names = {quantity.name for quantity in recording.quantities}
            self._has_strings = len(recording.strings) > 0

    def of(self, block: Log) -> Iterator[bytes]:
        """Yields the sentences of a block.

        Raises:
            Failure: Sentences are to be made and several devices send samples.
        """
        self._has_strings |= len(block.strings) > 0
        if self._has_strings:
            yield from texts_of(block)
            return
        self._names |= {column.name for column in block.values()}
        self._devices |= set(np.unique(device_of(block.bid)).tolist())
        if self._made is None:
            if time.monotonic() < self._due:
                return
            positions = nmea_positions(self._names)
            if positions is None and self._names.isdisjoint(ORIENTATIONS):
                return
            self._made = Sentences(positions)
            click.echo("xbus: no strings are sent; sentences are made from MTData2", err=True)
            yield sentences([MARK])
        if len(self._devices) > 1:
            bids = ", ".join(map(str, sorted(self._devices)))
            raise Failure(f"sentences do not name a device; choose one with --bid: {bids}")
        yield from sentences(self._made.of(block)).splitlines(keepends=True)
