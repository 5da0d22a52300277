"""Messages of ROS 2 of samples as they arrive."""

from __future__ import annotations

import io
import time
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from xbus.export.format import ExportError
from xbus.export.part import Part
from xbus.export.ros.mcap import Mcap, McapWriter
from xbus.export.ros.stamps import Base, Stamps, TimeBase
from xbus.extras import require

__all__ = ["LiveMessages"]

#: The clock of a host is wrong, or that of a virtual device, if it differs more from the present, in s.
NEAR = 3600.0


class LiveMessages:
    """Makes the messages of `Mcap`, block by block.

    Args:
        file_format: How messages are made.
        times: The times of a recording, from a first pass; None for a device, whose messages have the time of
            the measurement on the clock of this computer.

    Raises:
        ImportError: The extra ``foxglove`` is not installed.
    """

    def __init__(self, file_format: Mcap, times: TimeBase | None = None) -> None:
        self._reader = require("mcap.stream_reader", "foxglove", "to make live messages")
        self._records = require("mcap.records", "foxglove", "to make live messages")
        passes: Any = _HostTimes() if times is None else _Shared(times)
        self._format = replace(file_format, times=passes)

    def of(self, block: Part) -> Iterator[tuple[Any, Any, Any]]:
        """Yields schema, channel and message of each message, as `mcap` has them, in order.

        A block that has nothing for a message yields none.
        """
        out = io.BytesIO()
        try:
            writer = McapWriter(self._format, out, block)
            writer.write(block)
            writer.close()
        except ExportError:
            return
        out.seek(0)
        schemas, channels, records = {}, {}, self._records
        for record in self._reader.StreamReader(out).records:
            match record:
                case records.Schema():
                    schemas[record.id] = record
                case records.Channel():
                    channels[record.id] = record
                case records.Message():
                    channel = channels[record.channel_id]
                    yield schemas[channel.schema_id], channel, record
                case records.DataEnd():
                    return


class _Shared:
    """The second pass over a recording, which the writers of all blocks share."""

    def __init__(self, times: TimeBase) -> None:
        self._pass = times.second_pass()

    def second_pass(self) -> Any:
        return self._pass


class _HostTimes:
    """Gives live samples their time on the clock of this computer."""

    base: Base = "host"

    def __init__(self) -> None:
        self._shift: float | None = None
        self._highest = 0

    def second_pass(self) -> _HostTimes:
        return self

    def stamps(self, part: Part) -> Stamps:
        """Returns the times of samples; the present for those without."""
        now, host = time.time(), part.host_time
        known = host[np.isfinite(host)]
        if self._shift is None and len(known):
            self._shift = 0.0 if abs(known[-1] - now) < NEAR else now - float(known[-1])
        seconds = np.where(np.isfinite(host), host + (self._shift or 0.0), now)
        measured: npt.NDArray[np.int64] = np.rint(seconds * 1e9).astype(np.int64)
        ordered = np.maximum.accumulate(np.append(self._highest, measured))[1:]
        self._highest = int(ordered[-1]) if len(ordered) else self._highest
        return Stamps(measured, ordered.astype(np.uint64))
