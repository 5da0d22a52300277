"""CAN captures part by part: the parts, joined, are the log of the whole capture."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import xbus
from test_can import CODES, GOOD, arrays, group, messages, write
from xbus.can import CanLog, iter_can

OFFSETS = [0, 0x100, 0x19FF0000]
Frame = tuple[int, bytes]


@st.composite
def buses(draw: st.DrawFn) -> list[Frame]:
    """Up to three devices at different rates, some frames of which are lost, and other traffic."""
    random = draw(st.randoms(use_true_random=False))
    queues = []
    for seed, offset in enumerate(OFFSETS[: draw(st.integers(1, 3))]):
        every = draw(st.integers(1, 4))
        codes = list(CODES)
        if draw(st.booleans()):  # a device that does not send in the order of identifiers
            random.shuffle(codes)
        numbers = range(0, draw(st.integers(0, 24)), every)
        queues.append([f for n in numbers for f in group(n, *codes, offset=offset, seed=seed)])
    sent: list[Frame] = []
    while any(queues):
        queue = random.choice([queue for queue in queues if queue])
        for _ in range(random.randint(1, 6)):
            if queue and random.random() > 0.05:
                sent.append(queue.pop(0))
            elif queue:
                queue.pop(0)
        if random.random() < 0.1:
            sent.append(
                random.choice([(0x7FE, b"1"), (1, b"\1"), (0x34, b"short"), (1 << 29, bytes(8))])
            )
    return sent


def joined(parts: Sequence[CanLog], name: Any, of: Any) -> list[Any]:
    return [row for part in parts if (rows := part.get(name)) is not None for row in of(rows)]


def check_joined(parts: Sequence[CanLog], whole: CanLog) -> None:
    assert sum(map(len, parts)) == len(whole)
    for attribute in ("offset", "bid", "time", "packet_counter", "host_time"):
        found = np.concatenate([getattr(part, attribute) for part in parts])
        np.testing.assert_array_equal(found, getattr(whole, attribute))
    for name, column in whole.items():
        assert joined(parts, name, lambda rows: rows.sample.tolist()) == column.sample.tolist()
        values = np.array(joined(parts, name, lambda rows: list(rows.values)), column.values.dtype)
        np.testing.assert_array_equal(values, column.values)
    traffic = [part.traffic for part in parts]
    assert traffic[-1].findings == whole.traffic.findings
    assert sum(part.frames for part in traffic) == whole.traffic.frames
    assert sum(part.decoded for part in traffic) == whole.traffic.decoded
    for rows in ("undecoded", "events"):
        found = np.concatenate([getattr(part, rows) for part in traffic])
        np.testing.assert_array_equal(found, getattr(whole.traffic, rows))
    assert sum(part.stats.lost_samples for part in parts) == whole.stats.lost_samples
    assert sum(part.stats.frames for part in parts) == whole.stats.frames


def instants(
    seed: int, loss: float, jitter: float, codes: Sequence[int] = (0x05, 0x06, 0x32, 0x34, 0x41)
) -> tuple[Any, ...]:
    """Frames of a device at 100 Hz as arrays. Their numbers are those of their instants; many are lost.

    Args:
        seed: Seed of what is random.
        loss: Share of the frames that is lost, one by one and in runs.
        jitter: Seconds by which each timestamp is late at most.
        codes: The messages of a group in their order.
    """
    random = np.random.default_rng(seed)
    number, place = (each.ravel() for each in np.indices((60, len(codes))))
    times = number * 0.01 + place * 3e-4 + random.uniform(0, jitter, len(number))
    is_kept = random.random(len(number)) >= loss
    for first in random.integers(0, len(number), int(loss * 20)):
        is_kept[first : first + random.integers(1, 3 * len(codes))] = False
    ids = np.array(codes, np.uint32)[place]
    sizes = np.select([ids == 0x05, ids == 0x06], [4, 2], 6)
    data = np.zeros((len(ids), 8), np.uint8)
    data[np.arange(len(ids)), sizes - 1 - 4 * (sizes == 6)] = number
    return tuple(rows[is_kept] for rows in (times, ids, sizes.astype(np.uint8), data))


#: Counts per unit of the quantities of `instants`.
COUNTS = {
    "sample_time_fine": 1,
    "packet_counter": 1,
    "rate_of_turn": 512,
    "acceleration": 256,
    "magnetic_field": 1024,
}


@pytest.mark.parametrize("codes", [(0x05, 0x06, 0x32, 0x34, 0x41), (0x06, 0x05, 0x41, 0x34, 0x32)])
@given(st.integers(0, 1 << 30), st.sampled_from([0.02, 0.05]), st.integers(10, 60))
def test_no_sample_mixes_two_instants(codes: Any, seed: int, loss: float, block: int) -> None:
    source = instants(seed, loss, 1e-3, codes)
    log = xbus.read_can(source)
    check_joined(list(iter_can(source, block_frames=block)), log)
    if "packet_counter" not in log:
        return
    samples = np.concatenate([log[name].sample for name in COUNTS if name in log])
    numbers = np.concatenate(
        [
            np.rint(log[name].values.reshape(len(log[name]), -1)[:, 0] * count)
            for name, count in COUNTS.items()
            if name in log
        ]
    )
    # No counter follows after the last one, and none is before the first.
    first, last = log["packet_counter"].sample[[0, -1]]
    is_between = (samples > first) & (samples < last)
    pairs = set(zip(samples[is_between].tolist(), numbers[is_between].tolist(), strict=True))
    assert len(pairs) == len({sample for sample, _ in pairs})


def test_a_late_receiver_cuts_no_group() -> None:
    """Without a loss, frames that are far apart in time are still one group."""
    times, ids, sizes, data = instants(1, 0.0, 0.0)
    times[152:] += 3.0
    log = xbus.read_can((times, ids, sizes, data))
    assert len(log) == 60
    assert {len(column) for column in log.values()} == {60}


@given(buses(), st.integers(1, 40), st.integers(0, 1 << 30))
def test_parts_joined_are_the_whole(sent: list[Frame], block: int, seed: int) -> None:
    _, *frames = arrays(sent)
    steps = np.random.default_rng(seed).choice([0, 1e-4, 1e-4, 5e-3, -1e-4], len(sent))
    source = (np.cumsum(steps), *frames)
    check_joined(
        list(iter_can(source, OFFSETS, block_frames=block)), xbus.read_can(source, OFFSETS)
    )


def test_a_silent_device_holds_nothing_back() -> None:
    """A device that stops within a group does not delay the samples of others until the end."""
    sent = [*group(0, 0x34, offset=0x100), *GOOD * 60]
    lengths = [len(part) for part in iter_can(arrays(sent), OFFSETS, block_frames=1000)]
    whole = xbus.read_can(arrays(sent), OFFSETS)
    check_joined(list(iter_can(arrays(sent), OFFSETS, block_frames=1000)), whole)
    assert len(whole) == 1 + 60 * 100
    # The order of a device of which only one group came is decided at the end, or after 65,536 frames.
    assert lengths[-1] == len(whole)
    longer = sent + GOOD * 240
    lengths = [len(part) for part in iter_can(arrays(longer), OFFSETS, block_frames=1000)]
    assert max(lengths[:-1]) > 20_000
    assert lengths[-1] < 700
    check_joined(
        list(iter_can(arrays(longer), OFFSETS, block_frames=1000)),
        xbus.read_can(arrays(longer), OFFSETS),
    )


@pytest.mark.parametrize("suffix", ["blf", "asc", "log"])
def test_files_part_by_part(tmp_path: Path, suffix: str) -> None:
    path = write(tmp_path / f"drive.{suffix}", GOOD)
    check_joined(list(iter_can(path, block_frames=70)), xbus.read_can(path))
    with pytest.raises(ValueError, match="no channel 7; it has"):
        list(iter_can(path, channel=7, block_frames=70))


def test_channels_part_by_part() -> None:
    sent = messages(GOOD)
    for at, message in enumerate(sent):
        message.channel = "can1" if at >= 150 else "can0"
    for channel in ("can0", "can1"):
        parts = list(iter_can(sent, channel=channel, block_frames=40))
        check_joined(parts, xbus.read_can(sent, channel=channel))


def test_a_block_has_a_frame_at_least() -> None:
    with pytest.raises(ValueError, match="block_frames must be at least 1"):
        iter_can([], block_frames=0)
