"""Sentences that say what is unusual in a CAN capture, and what to do."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from xbus.can.ids import EXTENDED, STANDARD_IDS, id_text
from xbus.can.traffic import Seen, Verdict
from xbus.formatting import format_count
from xbus.log.log import Log
from xbus.protocol.can import CAN_MESSAGES

__all__ = ["findings"]

SAMPLE_TIME, GROUP_COUNTER = 0x05, 0x06
#: The only documented code of Error.
OVERFLOW = ("Error", 1)
#: Maximum number of identifiers, sizes and channels that a sentence names.
NAMED = 5
#: The clock of one device does not step back in more groups than this share.
MIXED = 0.02
#: Minimum number of messages that must fit at an offset before it is suggested.
FITTING = 3


def findings(log: Log, seen: Seen) -> Iterator[str]:
    """Yields a sentence for each kind of thing that is unusual in a capture.

    Args:
        log: The log of the capture.
        seen: Its frames.
    """
    if seen.frames.fault:
        yield seen.frames.fault
    yield from _channels(seen)
    yield from _frames(seen)
    yield from _bus(seen)
    yield from _events(seen)
    yield from _groups(log, seen)
    yield from _mixed(log, seen)
    yield from _positions(log)
    yield from _unknown(seen)


def _channels(seen: Seen) -> Iterator[str]:
    names = seen.frames.channel_names
    if len(names) > 1:
        yield (
            f"the capture has {len(names)} channels ({_list(names)}), which are read as one bus; if several "
            "have an MTi, choose one with channel= (--channel)"
        )


def _frames(seen: Seen) -> Iterator[str]:
    """Frames with the identifiers of a device that are not decoded as they are."""

    def described(verdict: Verdict) -> Iterator[tuple[str, int]]:
        for key, count in seen.counts(verdict).items():
            row = seen.messages[key]
            yield f"{format_count(count, 'frame')} of {row.name} ({id_text(key)})", key

    other = (
        "if another node uses the identifier, give the device others and name them in ids (--ids)"
    )
    for verdict, end in (
        (Verdict.SHORT, "they are not decoded"),
        (Verdict.LONG, "the rest is ignored"),
    ):
        for text, key in described(verdict):
            sizes = _list(seen.sizes(verdict, key), " or ")
            yield f"{text} with {sizes} bytes instead of {seen.messages[key].size}: {end}; {other}"
    for text, _ in described(Verdict.EXPONENT):
        yield f"{text} with an exponent above 30: they are not decoded; {other}"
    for text, _ in described(Verdict.NO_LAYOUT):
        yield f"{text}: not decoded, because no source gives the layout; traffic.undecoded has them"


def _bus(seen: Seen) -> Iterator[str]:
    if count := len(seen.places(Verdict.ERROR)):
        yield (
            f"{format_count(count, 'error frame')}: the bus is disturbed; check the terminations (120 ohm at "
            "both ends), the wiring, and that all nodes have the same bit rate"
        )
    if count := len(seen.places(Verdict.REMOTE)):
        yield f"{format_count(count, 'remote frame')}: skipped; an MTi does not answer them"


def _events(seen: Seen) -> Iterator[str]:
    rows, counts = np.unique(seen.events[["bid", "kind", "code"]], return_counts=True)
    for (bid, kind, code), count in zip(rows.tolist(), counts.tolist(), strict=True):
        times = format_count(count, "time")
        if (kind, code) == OVERFLOW:
            yield (
                f"device {bid} reports {times} that its output buffer overflowed: frames are missing; lower "
                "its output rates, or raise the bit rate of the bus"
            )
        else:
            yield f"device {bid} sends {kind} {code} {times}; the code is not documented"


def _groups(log: Log, seen: Seen) -> Iterator[str]:
    """Devices without time or counter."""
    sent: dict[int, set[int]] = {}
    for key in seen.counts(Verdict.DECODED, Verdict.LONG):
        sent.setdefault(seen.bids[key], set()).add(seen.messages[key].code)
    for bid, codes in sorted(sent.items()):
        times = log.time[log.bid == bid]
        missing = int(np.count_nonzero(np.isnan(times)))
        if missing == len(times):
            yield (
                f"device {bid} sends no SampleTime: its samples have no device time; add SampleTime to its "
                "output, or give the rate of GroupCounter with rate= (--rate)"
            )
        elif missing:
            yield (
                f"{format_count(missing, 'sample')} of {len(times):,} of device {bid} without SampleTime: "
                "its frame was lost, or is sent less often than others; these samples have no time"
            )
        if GROUP_COUNTER not in codes:
            yield (
                f"device {bid} sends no GroupCounter: losses are not known; add GroupCounter to its output"
            )


def _mixed(log: Log, seen: Seen) -> Iterator[str]:
    """Identifiers that two devices use: the clock jumps back and forth, or its frame comes twice at once."""
    ids = seen.frames.ids[seen.places(Verdict.DECODED, Verdict.LONG)]
    for bid, device in enumerate(seen.devices, 1):
        stamps = [key for key, row in device.items() if row.code in (SAMPLE_TIME, GROUP_COUNTER)]
        own = ids[np.isin(ids, list(device))]
        is_stamp = np.isin(own, stamps)
        repeats = (
            np.count_nonzero((own[1:] == own[:-1]) & is_stamp[1:]) if not is_stamp.all() else 0
        )
        samples = log.bid == bid
        times = log.time[samples]
        steps = np.count_nonzero(np.diff(times[np.isfinite(times)]) < 0)
        if max(steps, repeats) > max(1, MIXED * np.count_nonzero(samples)):
            yield (
                f"two devices use the identifiers of device {bid}: its samples have values and times of "
                "both; give each device its own identifiers (SetCanOutputConfig), and record again"
            )


def _positions(log: Log) -> Iterator[str]:
    if (positions := log.get("position_ecef")) is None:
        return
    if count := int(np.count_nonzero(np.isnan(positions.values).any(axis=1))):
        yield (
            f"{format_count(count, 'row')} of position_ecef without all three components, which are separate "
            "frames: missing ones are NaN"
        )


def _unknown(seen: Seen) -> Iterator[str]:
    if not seen.unknown:
        return
    counts = [f"{id_text(key)} ({count:,})" for key, count in seen.unknown.items()]
    offset = _offset(seen)
    remedy = "if an MTi has one of them, name its identifiers in ids (--ids)"
    if offset is not None:
        remedy = f"they fit an MTi with the offset 0x{offset:X}; try ids=0x{offset:X} (--ids)"
    total = format_count(sum(seen.unknown.values()), "frame")
    kinds = format_count(len(counts), "identifier")
    yield f"{total} with {kinds} of no known device: {_list(counts)}; {remedy}"


def _offset(seen: Seen) -> int | None:
    """Returns the offset at which most unknown identifiers have the sizes of messages; None if few have."""
    places = seen.places(Verdict.UNKNOWN)
    keys, first = np.unique(seen.frames.ids[places], return_index=True)
    sizes = seen.frames.sizes[places][first]
    fits: dict[int, int] = {}
    for key, size in zip(keys.tolist(), sizes.tolist(), strict=True):
        for code, row in CAN_MESSAGES.items():
            if row.signals and row.size == size and key & ~EXTENDED >= code:
                fits[key - code] = fits.get(key - code, 0) + 1
    best = max(fits, key=lambda offset: (fits[offset], -offset), default=0)
    if fits.get(best, 0) < FITTING:
        return None
    number = best & ~EXTENDED
    return number if number >= STANDARD_IDS else best


def _list(names: Sequence[object], separator: str = ", ") -> str:
    more = ", ..." if len(names) > NAMED else ""
    return separator.join(map(str, names[:NAMED])) + more
