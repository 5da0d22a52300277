"""Measures how fast CAN frames become a log, after checking the log against the simple decoder.

    python benches/can.py

One core; two devices on one bus, with frames of other nodes between theirs. The second figure includes what
`read_can` finds out about the traffic.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np

import xbus
from xbus import _core
from xbus.can import CAN_MESSAGES
from xbus.can.ids import device_ids

GROUPS = 200_000
CODES = (0x05, 0x06, 0x11, 0x21, 0x31, 0x32, 0x34, 0x51, 0x71, 0x76)
OFFSETS = (0, 0x19FF0000)
FOREIGN = 0x123
RUNS = 5
CHECKED = 997


def capture() -> tuple[Any, Any, Any, Any]:
    """Groups of two devices in turn, with a foreign frame behind each."""
    random = np.random.default_rng(0)
    codes = np.array([*CODES, FOREIGN])
    sizes = np.array([*(CAN_MESSAGES[code].size for code in CODES), 8], np.uint8)
    offsets = np.repeat(np.resize(OFFSETS, GROUPS), len(codes)).astype(np.uint32)
    ids = np.tile(codes, GROUPS).astype(np.uint32)
    ids = np.where(ids == FOREIGN, ids, ids + offsets).astype(np.uint32)
    data = random.integers(0, 256, (len(ids), 8), np.uint8)
    numbers = np.arange(GROUPS) // 2
    frames = data.reshape(GROUPS, len(codes), 8)
    frames[:, 0, :4] = (25 * numbers).astype(">u4").view(np.uint8).reshape(-1, 4)
    frames[:, 1, :2] = (numbers % 65536).astype(">u2").view(np.uint8).reshape(-1, 2)
    frames[:, CODES.index(0x31), 6] = 17
    return np.arange(len(ids)) / 8e3, ids, np.tile(sizes, GROUPS), data


def check(log: xbus.can.CanLog, frames: tuple[Any, Any, Any, Any]) -> None:
    """Compares some rows of each column with the simple decoder."""
    _, ids, _, data = frames
    assert len(log) == GROUPS
    assert log.stats.lost_samples == 0
    assert log.traffic.unknown == {FOREIGN: GROUPS}
    for code in CODES:
        row = CAN_MESSAGES[code]
        assert row.quantity is not None
        own = data[
            (ids == code) | (ids == (OFFSETS[1] + code) | 1 << 31) | (ids == OFFSETS[1] + code)
        ]
        values = log[row.quantity].values
        assert len(values) == len(own) == GROUPS
        for at in range(0, GROUPS, CHECKED):
            expected = row.decode(own[at].tobytes())
            expected.pop("exponent", None)
            if row.kind == "integer":
                expected = {"": int.from_bytes(own[at, : row.size].tobytes(), "big")}
            np.testing.assert_array_equal(np.ravel(values[at]), list(expected.values()))


def best(run: Any) -> float:
    """Returns the shortest processor time of several runs, in seconds."""
    times = []
    for _ in range(RUNS):
        start = time.process_time()
        run()
        times.append(time.process_time() - start)
    return min(times)


def main() -> None:
    """Prints frames per second."""
    frames = capture()
    offsets = list(OFFSETS)
    check(xbus.read_can(frames, offsets), frames)
    times, ids, sizes, data = frames
    marked = np.where(ids > 0x7FF, ids | _core.CAN_EXTENDED, ids).astype(np.uint32)
    entries = [
        (key, bid, row.code)
        for bid, device in enumerate(device_ids(offsets), 1)
        for key, row in device.items()
    ]
    for name, run in (
        (
            "grouping and decoding",
            lambda: _core.CanReader(entries).push(times, marked, sizes, data, end=True),
        ),
        ("read_can", lambda: xbus.read_can(frames, offsets)),
    ):
        seconds = best(run)
        print(f"{name:<22} {len(ids) / seconds / 1e6:6.1f} million frames/s")


if __name__ == "__main__":
    main()
