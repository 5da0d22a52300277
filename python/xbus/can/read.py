"""Reads CAN captures as logs."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from xbus import _core
from xbus.can.captures import Capture, Frames, read_frames
from xbus.can.findings import findings
from xbus.can.ids import Ids, device_ids, id_text
from xbus.can.traffic import Seen, Traffic, Verdict
from xbus.errors import DecodeError
from xbus.formatting import format_count
from xbus.log.arrivals import HostTimes
from xbus.log.hostclock import HostClock
from xbus.log.log import Log

__all__ = ["CanLog", "read_can"]

#: Why a frame of a device is not decoded.
FAULTS = [verdict.text for verdict in (Verdict.SHORT, Verdict.EXPONENT, Verdict.NO_LAYOUT)]


class CanLog(Log):
    """A log of CAN frames. A sample is a group: the frames that a device sends for one sample instant.

    It has all that a `Log` has. Some of it means something else, because CAN has no Xbus frames:

    - `offset` is the index of the first frame of a sample in the capture.
    - `bid` is the place of the device in ``ids``, from 1.
    - `packet_counter` is the GroupCounter, and `time` the SampleTime.
    - `host_time` is by the timestamps of the capture. Without SampleTime it is the timestamp of the first
      frame.
    - `stats` counts data bytes (``bytes``), and frames that are decoded or events (``frames``). `damage`,
      `messages` and `strings` are empty; `traffic` has what is not decoded.

    Attributes:
        traffic: What was on the bus besides samples, and what is unusual.
    """

    def __init__(self, core: _core.Part, host_times: HostTimes, traffic: Traffic) -> None:
        super().__init__(core, host_times=host_times)
        self.traffic = traffic

    def __reduce__(self) -> tuple[Any, ...]:
        return CanLog, (self._core, self._host_times, self.traffic)

    def _summary(self) -> str:
        findings = len(self.traffic.findings)
        note = f", {format_count(findings, 'finding')} in traffic" if findings else ""
        return super()._summary() + note


def read_can(
    source: Capture,
    ids: Ids | None = None,
    *,
    channel: int | str | None = None,
    rate: float | None = None,
    strict: bool = False,
) -> CanLog:
    """Reads the CAN output of MTi-600 devices from a capture, as a log.

    Frames are grouped to samples: a group ends where an identifier does not rise, because the bus sends the
    lowest identifier first. If a device sends in another order, a group starts with SampleTime or
    GroupCounter.

    Args:
        source: A path (.asc, .blf, .log of candump, .trc, .csv or .mf4), an iterable of ``can.Message``, or
            the arrays ``(timestamps, ids, dlcs, data)``: seconds ``(n,)``, integers ``(n,)`` and ``(n,)``,
            and uint8 ``(n, 8)``. Identifiers above 0x7FF, or with bit 31, have 29 bits; bit 30 marks a remote
            frame, and bit 29 an error frame, as in SocketCAN.
        ids: The identifiers of the devices. None for one device with the default identifiers. A number is
            the offset of a device that adds it to them: ``0x100``. A mapping has its own ones by message or
            quantity: ``{"SampleTime": 0x10, "acceleration": 0x11}``. A list has one of these for each device,
            with bus identifiers from 1. Identifiers above 0x7FF have 29 bits; `xbus.can.EXTENDED` added to a
            smaller one marks 29 bits too.
        channel: Read only this channel of the capture, as python-can names it; None for all.
        rate: Groups per second, for devices that send GroupCounter but not SampleTime.
        strict: Raise at the first frame of a device that cannot be decoded, instead of reporting it in
            `CanLog.traffic`.

    Raises:
        DecodeError: With ``strict``, at the first frame that cannot be decoded.
        ImportError: The extra ``can`` is not installed.
        OSError: The file cannot be read.
        TypeError: The source or the identifiers are of the wrong type.
        ValueError: The file is no capture, arrays do not fit together, identifiers are out of range or used
            twice, or a rate that is not a positive number.

    >>> import numpy as np, xbus
    >>> ids = np.array([0x005, 0x034, 0x005, 0x034])
    >>> data = np.zeros((4, 8), np.uint8)
    >>> data[2, :4], data[1::2, :6] = [0, 0, 0, 100], [1, 128, 253, 192, 9, 207]
    >>> log = xbus.read_can((np.arange(4) / 400, ids, np.array([4, 6, 4, 6]), data))
    >>> log.time, log["acceleration"].values[0]
    (array([0.  , 0.01]), array([ 1.5     , -2.25    ,  9.808594], dtype=float32))
    """
    if rate is not None and not 0 < rate < math.inf:
        raise ValueError(f"rate must be a positive number of Hz, not {rate!r}")
    devices = device_ids(ids)
    frames = read_frames(source)
    if channel is not None:
        frames = _of_channel(frames, str(channel))
    entries = [
        (key, bid, message.code)
        for bid, device in enumerate(devices, 1)
        for key, message in device.items()
    ]
    found = _core.read_can(frames.ids, frames.sizes, frames.data, entries, rate)
    seen = Seen(frames, found.verdicts, devices)
    traffic = Traffic(
        len(frames.ids),
        len(seen.places(Verdict.DECODED, Verdict.LONG)),
        seen.unknown,
        seen.undecoded,
        seen.events,
        tuple(findings(Log(found.part), seen)),
    )
    if strict:
        _check(traffic)
    return CanLog(found.part, _host_times(found.part, frames.time), traffic)


def _of_channel(frames: Frames, channel: str) -> Frames:
    if channel not in frames.channel_names:
        found = ", ".join(frames.channel_names) or "no channels"
        raise ValueError(f"the capture has no channel {channel}; it has {found}")
    if frames.channels is None:
        return frames
    own = frames.channels == frames.channel_names.index(channel)
    return Frames(
        frames.time[own], frames.ids[own], frames.sizes[own], frames.data[own], fault=frames.fault
    )


def _check(traffic: Traffic) -> None:
    """Raises the error of the first frame that cannot be decoded."""
    for row in traffic.undecoded:
        if row["reason"] in FAULTS:
            raise DecodeError(
                f"frame {row['frame']} ({id_text(int(row['id']))}, {row['size']} bytes) cannot be decoded: "
                f"{row['reason']}",
                int(row["frame"]),
                None,
            )


def _host_times(part: _core.Part, time: npt.NDArray[np.float64]) -> HostTimes:
    """Returns the host times of samples, from the timestamps of their first frames."""
    if not len(part):
        return HostTimes(part)
    received = time[part.offset]
    found = received.copy()
    clocks: dict[int, HostClock] = {}
    bids, stamps = part.bid, part.time
    for bid in np.unique(bids).tolist():
        own = np.flatnonzero((bids == bid) & np.isfinite(stamps))
        if len(own):
            clocks[bid] = HostClock()
            found[own] = clocks[bid].update(
                stamps[own], np.rint(received[own] * 1e9).astype(np.int64)
            )
    return HostTimes.known_already(part, found, clocks, np.empty(0))
