"""Sentences that say what is unusual in a CAN capture, and what to do."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from xbus.can.ids import EXTENDED, STANDARD_IDS, id_text
from xbus.can.traffic import GROUP_COUNTER, SAMPLE_TIME, Tally, Verdict
from xbus.formatting import format_count
from xbus.protocol.can import CAN_MESSAGES

__all__ = ["findings", "unknown_ids"]

#: The only documented code of Error.
OVERFLOW = ("Error", 1)
#: Maximum number of identifiers, sizes and channels that a sentence names.
NAMED = 5
#: The clock of one device does not step back in more groups than this share.
MIXED = 0.02
#: Minimum number of messages that must fit at an offset before it is suggested.
FITTING = 3


def findings(seen: Tally) -> Iterator[str]:
    """Yields a sentence for each kind of thing that is unusual on a bus.

    Args:
        seen: The counts of the frames and samples.
    """
    if seen.fault:
        yield seen.fault
    yield from _channels(seen)
    yield from _frames(seen)
    yield from _bus(seen)
    yield from _events(seen)
    yield from _groups(seen)
    yield from _mixed(seen)
    yield from _positions(seen)
    yield from unknown_ids(seen)


def _channels(seen: Tally) -> Iterator[str]:
    names = list(filter(None, seen.channel_names))
    if len(names) > 1:
        yield (
            f"the capture has {len(names)} channels ({_list(names)}), which are read as one bus; if several "
            "have an MTi, choose one with channel= (--channel)"
        )


def _frames(seen: Tally) -> Iterator[str]:
    """Frames with the identifiers of a device that are not decoded as they are."""

    def described(verdict: Verdict) -> Iterator[tuple[str, int]]:
        for key, count in seen.counts(verdict).items():
            row = seen.devices.messages[key]
            yield f"{format_count(count, 'frame')} of {row.name} ({id_text(key)})", key

    other = (
        "if another node uses the identifier, give the device others and name them in ids (--ids)"
    )
    for verdict, end in (
        (Verdict.SHORT, "not decoded"),
        (Verdict.LONG, "the rest is ignored"),
    ):
        for text, key in described(verdict):
            sizes = _list(seen.sizes(verdict, key), " or ")
            yield f"{text} with {sizes} bytes instead of {seen.devices.messages[key].size}: {end}; {other}"
    for text, _ in described(Verdict.EXPONENT):
        yield f"{text} with an exponent above 30: not decoded; {other}"
    for text, _ in described(Verdict.NO_LAYOUT):
        yield f"{text}: not decoded, because no source gives the layout; traffic.undecoded has them"


def _bus(seen: Tally) -> Iterator[str]:
    if count := seen.total(Verdict.ERROR):
        yield (
            f"{format_count(count, 'error frame')}: the bus is disturbed; check the terminations (120 ohm at "
            "both ends), the wiring, and that all nodes have the same bit rate"
        )
    if count := seen.total(Verdict.REMOTE):
        yield f"{format_count(count, 'remote frame')}: skipped; an MTi does not answer them"


def _events(seen: Tally) -> Iterator[str]:
    for (bid, kind, code), count in sorted(seen.events.items()):
        times = format_count(count, "time")
        if (kind, code) == OVERFLOW:
            yield (
                f"device {bid} reports {times} that its output buffer overflowed: frames are missing; lower "
                "its output rates, or raise the bit rate of the bus"
            )
        else:
            yield f"device {bid} sends {kind} {code} {times}; the code is not documented"


def _groups(seen: Tally) -> Iterator[str]:
    """Devices without time or counter."""
    sent: dict[int, set[int]] = {}
    for key in seen.counts(Verdict.DECODED, Verdict.LONG):
        sent.setdefault(seen.devices.bids[key], set()).add(seen.devices.messages[key].code)
    for bid, codes in sorted(sent.items()):
        stamps = seen.stamps[bid - 1]
        if SAMPLE_TIME not in codes and stamps.untimed == stamps.samples:
            yield (
                f"device {bid} sends no SampleTime: its samples have no device time; add SampleTime to its "
                "output, or give the rate of GroupCounter with rate= (--rate)"
            )
        elif stamps.untimed:
            yield (
                f"{format_count(stamps.untimed, 'sample')} of {stamps.samples:,} of device {bid} without "
                "SampleTime: its frame was lost, or is sent less often than others; these samples have no "
                "time"
            )
        if GROUP_COUNTER not in codes:
            yield (
                f"device {bid} sends no GroupCounter: losses are not known; add GroupCounter to its output"
            )


def _mixed(seen: Tally) -> Iterator[str]:
    """Identifiers that two devices use: the clock jumps back and forth, or its frame comes twice at once."""
    for bid, stamps in enumerate(seen.stamps, 1):
        repeats = 0 if stamps.only_stamps else stamps.repeats
        if max(stamps.steps, repeats) > max(1, MIXED * stamps.samples):
            yield (
                f"two devices use the identifiers of device {bid}: its samples have values and times of "
                "both; give each device its own identifiers (SetCanOutputConfig), and record again"
            )


def _positions(seen: Tally) -> Iterator[str]:
    if count := seen.incomplete_positions:
        yield (
            f"{format_count(count, 'row')} of position_ecef without all three components, which are separate "
            "frames: missing ones are NaN"
        )


def unknown_ids(seen: Tally) -> Iterator[str]:
    """Yields a sentence about identifiers that no device has, with the offset at which they would fit."""
    unknown = seen.counts(Verdict.UNKNOWN)
    if not unknown:
        return
    counts = [f"{id_text(key)} ({count:,})" for key, count in unknown.items()]
    offset = _offset(seen, unknown)
    remedy = "if an MTi has one of them, name its identifiers in ids (--ids)"
    if offset is not None:
        remedy = f"they fit an MTi with the offset 0x{offset:X}; try ids=0x{offset:X} (--ids)"
    total = format_count(sum(unknown.values()) + seen.uncounted, "frame")
    more = " or more" if seen.uncounted else ""
    kinds = format_count(len(counts), "identifier")
    yield f"{total} with {kinds}{more} of no known device: {_list(counts)}; {remedy}"


def _offset(seen: Tally, unknown: Iterable[int]) -> int | None:
    """Returns the offset at which most unknown identifiers have the sizes of messages; None if few have."""
    fits: dict[int, int] = {}
    for key in sorted(unknown):
        sizes = seen.sizes(Verdict.UNKNOWN, key)
        for code, row in CAN_MESSAGES.items():
            if row.signals and row.size in sizes and key & ~EXTENDED >= code:
                fits[key - code] = fits.get(key - code, 0) + 1
    best = max(fits, key=lambda offset: (fits[offset], -offset), default=0)
    if fits.get(best, 0) < FITTING:
        return None
    number = best & ~EXTENDED
    return number if number >= STANDARD_IDS else best


def _list(names: Sequence[object], separator: str = ", ") -> str:
    more = ", ..." if len(names) > NAMED else ""
    return separator.join(map(str, names[:NAMED])) + more
