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


@given(buses(), st.integers(1, 40))
def test_parts_joined_are_the_whole(sent: list[Frame], block: int) -> None:
    source = arrays(sent)
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
