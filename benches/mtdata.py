"""Processor time of `read_log` for MTData, over that for MTData2 messages with the same numbers.

Usage: python benches/mtdata.py
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

import xbus
from xbus import _core

SAMPLES, ROUNDS = 400_000, 9
#: Calibrated data, quaternion and counter, and the data identifiers of the same numbers.
OUTPUT = (0x0006, 0x0000_0001)
DATA_IDS = (0x4020, 0x8020, 0xC020, 0x2018, 0x1020)


def processor_time(work: Callable[[], object]) -> float:
    start = time.process_time()
    work()
    return time.process_time() - start


def main() -> None:
    random = np.random.default_rng(1)
    arrays = [random.normal(size=(SAMPLES, width)).astype("f4") for width in (3, 3, 3, 4)]
    arrays.append(np.arange(SAMPLES) % 65536)
    old = _core.encode_mtdata(*OUTPUT, arrays, 0xFF).data
    new = _core.encode_samples(list(zip(DATA_IDS, arrays, strict=True)), 0xFF).data

    logs = xbus.read_log(old, legacy=OUTPUT), xbus.read_log(new)
    for array, *columns in zip(arrays, *(log.values() for log in logs), strict=True):
        for column in columns:
            np.testing.assert_array_equal(column.values, array.reshape(column.values.shape))

    times = [
        (
            processor_time(lambda: xbus.read_log(old, legacy=OUTPUT, threads=1)),
            processor_time(lambda: xbus.read_log(new, threads=1)),
        )
        for _ in range(ROUNDS)
    ]
    legacy, usual = np.median(times, axis=0)
    print(f"MTData {len(old) / legacy / 1e9:.2f} GB/s, MTData2 {len(new) / usual / 1e9:.2f} GB/s")
    print(f"samples per second over those of MTData2: {usual / legacy:.2f}")


if __name__ == "__main__":
    main()
