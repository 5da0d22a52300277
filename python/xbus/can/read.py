"""Reads CAN captures as logs."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

from xbus import _core
from xbus.can.captures import Capture, Frames, read_frames
from xbus.can.findings import findings
from xbus.can.ids import Ids, core_entries, device_ids, id_text
from xbus.can.traffic import Devices, Tally, Traffic, Verdict
from xbus.errors import DecodeError
from xbus.formatting import format_count
from xbus.log.arrivals import HostTimes
from xbus.log.hostclock import HostClock
from xbus.log.log import Log

__all__ = ["CanLog", "check_rate", "iter_can", "read_can"]

#: Default number of frames that are read for a part of a capture: some megabytes, and minutes of a busy bus.
BLOCK_FRAMES = 1 << 18

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
            frame, and bit 29 an error frame, as in SocketCAN. The first bytes of a file show its format; the
            suffix counts only if they do not.
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
        ValueError: The file is no capture, such as a log, arrays do not fit together, identifiers are out of
            range or used twice, or a rate that is not a positive number.

    >>> import numpy as np, xbus
    >>> ids = np.array([0x005, 0x034, 0x005, 0x034])
    >>> data = np.zeros((4, 8), np.uint8)
    >>> data[2, :4], data[1::2, :6] = [0, 0, 0, 100], [1, 128, 253, 192, 9, 207]
    >>> log = xbus.read_can((np.arange(4) / 400, ids, np.array([4, 6, 4, 6]), data))
    >>> log.time, log["acceleration"].values[0]
    (array([0.  , 0.01]), array([ 1.5     , -2.25    ,  9.808594], dtype=float32))
    """
    [log] = _read(source, ids, channel=channel, rate=rate, strict=strict, block=None)
    return log


def iter_can(
    source: Capture,
    ids: Ids | None = None,
    *,
    channel: int | str | None = None,
    rate: float | None = None,
    strict: bool = False,
    block_frames: int = BLOCK_FRAMES,
) -> Iterator[CanLog]:
    """Yields the parts of a capture, which may be larger than memory. Joined they are the log of `read_can`.

    Samples, offsets, times and counters continue from part to part. The counts of `CanLog.traffic` are those
    of the frames of the part, and its `findings` those of all frames up to its end.

    Args:
        source: As in `read_can`, like the next four.
        ids: The identifiers of the devices.
        channel: Read only this channel.
        rate: Groups per second.
        strict: Raise at the first frame that cannot be decoded.
        block_frames: Number of frames that are read for a part.

    Raises:
        ValueError: ``block_frames`` is less than 1. The other errors are those of `read_can`, when the part
            with their cause is read.

    >>> import numpy as np
    >>> frames = np.arange(4.0), np.full(4, 0x006), np.full(4, 2), np.zeros((4, 8), np.uint8)
    >>> frames[3][:, 1] = range(4)
    >>> [log.packet_counter.tolist() for log in iter_can(frames, block_frames=3)]
    [[], [0, 1, 2, 3]]
    """
    if block_frames < 1:
        raise ValueError(f"block_frames must be at least 1, not {block_frames}")
    return _read(source, ids, channel=channel, rate=rate, strict=strict, block=block_frames)


def _read(
    source: Capture,
    ids: Ids | None,
    *,
    channel: int | str | None,
    rate: float | None,
    strict: bool,
    block: int | None,
) -> Iterator[CanLog]:
    check_rate(rate)
    devices = Devices(device_ids(ids))
    blocks = read_frames(source, block)
    if channel is not None:
        blocks = _of_channel(blocks, str(channel))
    return _parts(blocks, devices, rate, strict=strict)


def check_rate(rate: float | None) -> None:
    """Raises ValueError if a rate is not a positive number."""
    if rate is not None and not 0 < rate < math.inf:
        raise ValueError(f"rate must be a positive number of Hz, not {rate!r}")


def _parts(
    blocks: Iterator[Frames], devices: Devices, rate: float | None, *, strict: bool
) -> Iterator[CanLog]:
    reader = _core.CanReader(core_entries(devices.devices), rate)
    tally, clocks = Tally(devices), dict[int, HostClock]()
    following = next(blocks, None)
    while (frames := following) is not None:
        following = next(blocks, None)
        first = tally.frames
        found = reader.push(
            frames.time, frames.ids, frames.sizes, frames.data, end=following is None
        )
        tally.add(frames, found.verdicts)
        tally.add_samples(Log(found.part))
        traffic = Traffic(
            len(frames.ids),
            int(np.count_nonzero(found.verdicts <= Verdict.LONG)),
            _counts(frames.ids[found.verdicts == Verdict.UNKNOWN]),
            devices.undecoded(frames, found.verdicts, first),
            devices.events(frames, found.verdicts, first),
            tuple(findings(tally)),
        )
        if strict:
            _check(traffic)
        yield CanLog(found.part, _host_times(found, clocks), traffic)


def _counts(ids: npt.NDArray[np.uint32]) -> dict[int, int]:
    """Returns how often each identifier occurs, the most frequent first."""
    found, counts = np.unique(ids, return_counts=True)
    order = np.argsort(-counts, kind="stable")
    return dict(zip(found[order].tolist(), counts[order].tolist(), strict=True))


def _of_channel(blocks: Iterator[Frames], channel: str) -> Iterator[Frames]:
    """Yields the frames of a channel.

    Raises:
        ValueError: The capture has no such channel.
    """
    names: tuple[str, ...] = ()
    for frames in blocks:
        names = frames.channel_names
        if frames.channels is None:
            own = np.full(len(frames.ids), names == (channel,))
        else:
            own = frames.channels == (names.index(channel) if channel in names else -1)
        yield frames.chosen(own)
    if channel not in names:
        raise ValueError(
            f"the capture has no channel {channel}; it has {', '.join(filter(None, names)) or 'no channels'}"
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


def _host_times(found: _core.CanPart, clocks: dict[int, HostClock]) -> HostTimes:
    """Returns the host times of samples, from the times of their first frames, and updates the clocks."""
    part = found.part
    if not len(part):
        return HostTimes(part)
    received = np.rint(found.received * 1e9).astype(np.int64)
    host_time = found.received.copy()
    bids, stamps = part.bid, part.time
    for bid in np.unique(bids).tolist():
        own = np.flatnonzero((bids == bid) & np.isfinite(stamps))
        if len(own):
            clock = clocks.setdefault(bid, HostClock())
            host_time[own] = clock.update(stamps[own], received[own])
    known = {bid: clock.copy() for bid, clock in clocks.items()}
    return HostTimes.known_already(part, host_time, known, np.empty(0))
