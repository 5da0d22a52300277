"""Sends samples to the Lab Streaming Layer (LSL)."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from xbus.extras import require
from xbus.formatting import device_name, format_count
from xbus.protocol.tables import device_of

if TYPE_CHECKING:
    from xbus.log.column import Column
    from xbus.log.log import Log

__all__ = ["ALONE", "LslSink"]

#: Seconds of data that LSL keeps for each client. A slower one loses the oldest.
BUFFER = 360
#: Label of the last channel of each stream, which counts its samples: LSL does not report what clients lose.
COUNTER = "counter"
#: The counter begins again at 0 after this many: float32 holds all integers below it.
COUNTS = 1 << 24
#: The BID of a stand-alone device.
ALONE = 1


@dataclass
class _Stream:
    """A stream of LSL.

    Attributes:
        outlet: The outlet of LSL; None at the end.
        count: Number of its samples.
    """

    outlet: Any
    count: int = 0


class LslSink:
    """A stream of LSL for each quantity of each device. Its clients read at their own pace.

    LSL keeps data for each client. The last channel of each stream counts its samples, so that a client sees
    what it has lost.

    Args:
        source: What identifies a device to clients, where its identifier is not known.
        device_id: Identifier of the device that is connected, if it is known before the first sample.
        bid: Its BID.

    Raises:
        ImportError: The extra ``lsl`` is not installed.
    """

    def __init__(self, source: str, device_id: int | None, bid: int = ALONE) -> None:
        self._pylsl = require("pylsl", "lsl", "to stream to LSL")
        self._source = source
        #: The name of each device, by BID.
        self._names = {} if device_id is None else {device_of(bid): device_name(device_id)}
        #: The streams of each device, by quantity and coordinate system.
        self._streams: dict[tuple[int, str, str | None], _Stream] = {}
        self._samples = 0

    @property
    def offered(self) -> int:
        """Number of samples that LSL took."""
        return self._samples

    def write(self, block: Log) -> None:
        """Sends the quantities of a block."""
        devices = block.devices
        for device in devices:
            number = device_of(device.bid)
            if number not in self._names:
                self._names[number] = self._name(number, device.device_id)
            own = block if len(devices) == 1 else block.of_device(device.bid)
            self._write(own, number)
        self._samples += len(block)

    def _name(self, device: int, device_id: int | None) -> str:
        if device_id is not None:
            return device_name(device_id)
        return self._source if device == ALONE else f"{self._source} BID {device}"

    def _write(self, block: Log, device: int) -> None:
        """Sends the quantities of a block of one device."""
        stamps = self._stamps(block)
        for column in block.values():
            if column.name == "gnss_sat_info":
                continue
            stream = self._stream(device, column)
            rows = _rows(column)
            counter = np.arange(stream.count, stream.count + len(rows)) % COUNTS
            stream.count += len(rows)
            chunk = np.column_stack([rows, counter]).tolist()
            stream.outlet.push_chunk(chunk, stamps[column.sample - block.first_sample].tolist())

    def _stream(self, device: int, column: Column) -> _Stream:
        """Returns the stream of a quantity. In a second coordinate system it is another stream."""
        key = device, column.name, column.coordinates
        if key not in self._streams:
            is_second = any(known[:2] == key[:2] for known in self._streams)
            suffix = f"_{column.coordinates.lower()}" if is_second and column.coordinates else ""
            name = self._names[device], column.name + suffix
            self._streams[key] = _Stream(self._outlet(*name, column))
        return self._streams[key]

    def _stamps(self, block: Log) -> Any:
        """Returns when each sample was measured, else when it arrived, on the clock of LSL."""
        now = self._pylsl.local_clock()
        measured = block.host_time + (now - time.time())
        if not (np.abs(measured - now) < BUFFER).any():
            # The clock of a recording or of a virtual device: the last sample is due now.
            known = block.time[np.isfinite(block.time)]
            measured = block.time + (now - (known.max() if len(known) else 0.0))
        return np.where(np.isfinite(measured), np.minimum(measured, now), now)

    def _outlet(self, device: str, name: str, column: Column) -> Any:
        pylsl = self._pylsl
        labels = (*(column.fields or (name,)), COUNTER)
        info = pylsl.StreamInfo(
            f"{device} {name}",
            "IMU",
            len(labels),
            pylsl.IRREGULAR_RATE,
            pylsl.cf_float32 if column.dtype == np.float32 else pylsl.cf_double64,
            f"xbus-{device}-{name}",
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
        for stream in self._streams.values():
            stream.outlet = None

    def __str__(self) -> str:
        streams = format_count(len(self._streams), "stream")
        return f"{format_count(self._samples, 'sample')} sent in {streams}"


def _rows(column: Column) -> Any:
    """Returns the numbers of a column, ``(n, k)``."""
    if column.dtype.names:
        return np.stack([column.scaled[name].astype(float) for name in column.dtype.names], axis=1)
    return column.values.reshape(len(column), -1)
