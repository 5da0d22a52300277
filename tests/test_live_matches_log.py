"""The same bytes give the same times, counters, gaps and values live and from a file."""

from __future__ import annotations

import itertools
import random
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from conftest import SEEDS, clock_streams, damaged_clock_streams, damaged_streams, read
from xbus import Log, Sample, StringType, _core
from xbus.protocol.tables import QUANTITIES
from xbus.wire.strings import type_at

#: Limit of the length of a payload on a live link.
LIVE = 8185

#: Values of one sample by quantity or data identifier, in the order of its packets.
Row = dict[Any, list[Any]]


def rows_of(log: Log) -> list[Row]:
    """Returns the values of each sample of a log, to the bit."""
    rows: list[Row] = [{} for _ in range(len(log))]

    def add(key: Any, samples: Iterable[int], values: Iterable[Any]) -> None:
        for at, value in zip(samples, values, strict=True):
            rows[at - log.first_sample].setdefault(key, []).append(value)

    for key in log:
        column = log[key]
        values = column.values
        if values.dtype in (np.float32, np.uint32):
            # A column with several precisions, or lengths of device identifiers, has the widest.
            with np.errstate(invalid="ignore"):
                values = values.astype(f"{values.dtype.kind}8")
        found = [value.tobytes() for value in values]
        if column.name == "gnss_sat_info":
            parts = itertools.pairwise(column.offsets.tolist())
            satellites = [column.satellites[first:last].tobytes() for first, last in parts]
            found = [value + more for value, more in zip(found, satellites, strict=True)]
        add((column.name, column.coordinates), column.sample.tolist(), found)
    for data_id, unknown in log.unknown.items():
        add(data_id, unknown.sample.tolist(), unknown)
    return rows


@dataclass
class Taken:
    """What was taken from an acquisition, in order.

    Attributes:
        time: Times of samples.
        bid: Bus identifiers of samples.
        rows: Values of samples.
        counters: Unwrapped packet counters, by index of the sample; samples taken alone have none.
        gaps: Lost samples before a sample, likewise.
        leads: Whether a sample arrived when it was measured; only those taken alone.
        arrivals: When a sample arrived, likewise.
        strings: Type and bytes of strings; for those in a block, index of the first sample of the block and
            of the sample after the string.
    """

    time: list[float] = field(default_factory=list)
    bid: list[int] = field(default_factory=list)
    rows: list[Row] = field(default_factory=list)
    counters: dict[int, int] = field(default_factory=dict)
    gaps: dict[int, int] = field(default_factory=dict)
    leads: dict[int, bool] = field(default_factory=dict)
    arrivals: dict[int, tuple[int, float]] = field(default_factory=dict)
    strings: list[tuple[StringType | None, bytes, tuple[int, int] | None]] = field(
        default_factory=list
    )

    def sample(self, received: _core.ReceivedSample) -> None:
        """Adds a sample that was taken alone."""
        at, sample = len(self.time), Sample.of(received)
        self.leads[at] = sample.leads
        assert sample.arrival is not None
        self.arrivals[at] = sample.offset, sample.arrival
        self.time.append(sample.time)
        self.bid.append(sample.bid)
        self.rows += rows_of(read(sample.frame))

    def block(self, block: _core.Block) -> None:
        """Adds the samples of a block."""
        log, at = Log(block.part), len(self.time)
        for string in log.strings:
            assert string.sample is not None
            after = string.sample - log.first_sample + at
            self.strings.append((string.type, string.data, (at, after)))
        self.counters |= enumerate(log.packet_counter.tolist(), at)
        self.gaps |= {gap["sample"] - log.first_sample + at: gap["lost"] for gap in log.gaps}
        self.time += log.time.tolist()
        self.bid += log.bid.tolist()
        self.rows += rows_of(log)
        assert len(block.host_time) == len(log)
        assert len(block.string_time) == len(log.strings)


def taken_at_random(data: bytes, cuts: list[int], rng: random.Random) -> Taken:
    """Pushes the bytes in pieces, and takes what has arrived in a random order of access."""
    acquisition, taken = _core.Acquisition(None, epoch=0), Taken()
    decoder = acquisition.block_decoder()
    at = piece = 0
    has_ended = False
    while True:
        if not has_ended:
            size = cuts[piece % len(cuts)]
            acquisition.push(data[at : at + size], float(piece))
            at, piece = at + size, piece + 1
            if at >= len(data):
                acquisition.end("over")
                has_ended = True
        for _ in range(rng.randrange(4)):
            match rng.randrange(5):
                case 0 | 1:
                    if (received := acquisition.take_sample()) is not None:
                        taken.sample(received)
                case 2:
                    count = rng.randrange(1, 6)
                    is_short = acquisition.waiting.samples < count
                    block = acquisition.take_block(decoder, count)
                    assert (block is None) == is_short
                    if block is not None:
                        taken.block(block)
                case 3:
                    block = acquisition.take_block(decoder)
                    assert block is not None
                    taken.block(block)
                case 4:
                    if (string := acquisition.take_string()) is not None:
                        taken.strings.append((type_at(string.place), string.data, None))
        waiting = acquisition.waiting
        if has_ended and not (waiting.samples or waiting.strings):
            return taken


def same(one: Iterable[float], other: Iterable[float]) -> bool:
    """Returns whether times are equal to the bit."""
    return np.array(list(one), "f8").tobytes() == np.array(list(other), "f8").tobytes()


CUTS = st.lists(st.integers(1, 400), min_size=1, max_size=8)


@given(clock_streams() | damaged_streams() | damaged_clock_streams(), CUTS, SEEDS)
def test_any_order_of_access_gives_what_the_log_has(
    data: bytes, cuts: list[int], seed: int
) -> None:
    taken, log = taken_at_random(data, cuts, random.Random(seed)), read(data, limit=LIVE)
    assert same(taken.time, log.time)
    assert taken.bid == log.bid.tolist()
    assert taken.rows == rows_of(log)
    counters, gaps = log.packet_counter.tolist(), {gap["sample"]: gap["lost"] for gap in log.gaps}
    in_blocks = taken.counters.keys()
    assert taken.counters == {at: counters[at] for at in in_blocks}
    assert taken.gaps == {at: lost for at, lost in gaps.items() if at in in_blocks}
    late = {
        int(at)
        for key in log
        if QUANTITIES[log[key].name].clock in ("trigger", "receiver")
        for at in log[key].sample
    }
    assert taken.leads == {at: at not in late for at in set(range(len(log))) - in_blocks}
    assert [string[:2] for string in taken.strings] == [
        (string.type, string.data) for string in log.strings
    ]
    for string, (_, _, place) in zip(log.strings, taken.strings, strict=True):
        assert string.sample is not None
        # Samples before the string may have been taken alone.
        assert place is None or place[1] == max(string.sample, place[0])
    ends = np.cumsum([cuts[at % len(cuts)] for at in range(len(data) + 1)])
    for at, (offset, arrival) in taken.arrivals.items():
        assert offset == log.offset[at]
        extended = data[offset + 3] == 0xFF
        length = (
            int.from_bytes(data[offset + 4 : offset + 6], "big") + 7
            if extended
            else data[offset + 3] + 5
        )
        assert arrival == np.searchsorted(ends, offset + length)
