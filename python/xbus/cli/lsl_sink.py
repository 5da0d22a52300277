"""Sends samples to the Lab Streaming Layer (LSL)."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from xbus.extras import require
from xbus.formatting import device_name, format_count

if TYPE_CHECKING:
    from xbus.log.column import Column
    from xbus.log.log import Log

__all__ = ["LslSink"]

#: Seconds of data that LSL keeps for each client. A slower one loses the oldest.
BUFFER = 360
#: Label of the last channel of each stream, which counts its samples: LSL does not report what clients lose.
COUNTER = "counter"
#: The counter begins again at 0 after this many: float32 holds all integers below it.
COUNTS = 1 << 24


class LslSink:
    """A stream of LSL for each quantity. Its clients read at their own pace; LSL keeps data for each of them.

    The last channel of each stream counts its samples, so that a client sees what it has lost.

    Args:
        source: What identifies the device to clients, where its identifier is not known.

    Raises:
        ImportError: The extra ``lsl`` is not installed.
    """

    def __init__(self, source: str, device_id: int | None) -> None:
        self._pylsl = require("pylsl", "lsl", "to stream to LSL")
        self._device = source if device_id is None else device_name(device_id)
        self._outlets: dict[str, Any] = {}
        #: Number of samples of each stream.
        self._counts: dict[str, int] = {}
        self._samples = 0

    @property
    def offered(self) -> int:
        """Number of samples that LSL took."""
        return self._samples

    def write(self, block: Log) -> None:
        """Sends the quantities of a block."""
        stamps = self._stamps(block)
        for key, column in block.items():
            if column.name == "gnss_sat_info":
                continue
            name = key if isinstance(key, str) else f"{key[0]}_{key[1].lower()}"
            if name not in self._outlets:
                self._outlets[name] = self._outlet(name, column)
            times = stamps[column.sample - block.first_sample]
            rows, count = _rows(column), self._counts.get(name, 0)
            counter = np.arange(count, count + len(rows)) % COUNTS
            self._counts[name] = count + len(rows)
            chunk = np.column_stack([rows, counter]).tolist()
            self._outlets[name].push_chunk(chunk, times.tolist())
        self._samples += len(block)

    def _stamps(self, block: Log) -> Any:
        """Returns when each sample was measured, else when it arrived, on the clock of LSL."""
        now = self._pylsl.local_clock()
        measured = block.host_time + (now - time.time())
        if not (np.abs(measured - now) < BUFFER).any():
            # The clock of a recording or of a virtual device: the last sample is due now.
            known = block.time[np.isfinite(block.time)]
            measured = block.time + (now - (known.max() if len(known) else 0.0))
        return np.where(np.isfinite(measured), np.minimum(measured, now), now)

    def _outlet(self, name: str, column: Column) -> Any:
        pylsl = self._pylsl
        labels = (*(column.fields or (name,)), COUNTER)
        info = pylsl.StreamInfo(
            f"{self._device} {name}",
            "IMU",
            len(labels),
            pylsl.IRREGULAR_RATE,
            pylsl.cf_float32 if column.dtype == np.float32 else pylsl.cf_double64,
            f"xbus-{self._device}-{name}",
        )
        channels = info.desc().append_child("channels")
        for label in labels:
            channel = channels.append_child("channel")
            channel.append_child_value("label", label)
            unit = "" if label == COUNTER else column.units.get(label, column.unit)
            channel.append_child_value("unit", unit)
        if column.coordinates:
            info.desc().append_child_value("coordinates", column.coordinates)
        return pylsl.StreamOutlet(info, max_buffered=BUFFER)

    def note(self, text: str, *, is_bad: bool) -> None:  # noqa: ARG002 - as in `Sink`
        """Prints an event: streams have numbers only."""
        click.echo(f"xbus: {text}", err=True)

    def close(self) -> None:
        """Ends the streams."""
        self._outlets.clear()

    def __str__(self) -> str:
        streams = format_count(len(self._counts), "stream")
        return f"{format_count(self._samples, 'sample')} sent in {streams}"


def _rows(column: Column) -> Any:
    """Returns the numbers of a column, ``(n, k)``."""
    if column.dtype.names:
        return np.stack([column.scaled[name].astype(float) for name in column.dtype.names], axis=1)
    return column.values.reshape(len(column), -1)
