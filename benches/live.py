"""Measures live data: 2 kHz acceleration and 1.6 kHz rate of turn from another process, on a pty.

    python benches/live.py [SECONDS]

Prints the processor time of this process relative to the elapsed time: for recording alone (read, scanned and
written by threads), in blocks of 0.1 s, and sample by sample; and the age of samples on arrival. Each part
checks that nothing is lost.
"""

import os
import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import xbus
from common import seconds_argument, virtual_device

#: Samples per second, and those with an acceleration.
SAMPLE_RATE, ACCELERATION_RATE = 3600, 2000
BLOCK_SECONDS = 0.1


def processor_share(device: xbus.Device, work: Callable[[], None]) -> float:
    """Returns processor time relative to elapsed time; afterwards no sample may be missing."""
    began, used = time.perf_counter(), sum(os.times()[:2])
    work()
    elapsed, used = time.perf_counter() - began, sum(os.times()[:2]) - used
    stats = device.stats
    assert stats.lost_samples == stats.dropped_samples == stats.skipped_bytes == 0, stats
    return used / elapsed


def record(seconds: float) -> None:
    with virtual_device() as (device, _), tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.mtb"
        with device.record(path):
            share = processor_share(device, lambda: time.sleep(seconds))
        log = xbus.read_log(path)
    assert log.stats.lost_samples == 0
    assert abs(len(log) / seconds - SAMPLE_RATE) < SAMPLE_RATE / 20, len(log)
    print(f"recording alone              {share:6.1%} of a core  (goal: 0.7 %)")


def blocks(seconds: float) -> None:
    with virtual_device() as (device, _):
        sizes = []

        def read() -> None:
            for block in device.blocks(seconds=BLOCK_SECONDS):
                sizes.append(len(block["acceleration_hr"].values))
                if len(sizes) >= seconds / BLOCK_SECONDS:
                    return

        share = processor_share(device, read)
    assert abs(sum(sizes) / seconds - ACCELERATION_RATE) < ACCELERATION_RATE / 20, sum(sizes)
    print(f"blocks of 0.1 s              {share:6.1%} of a core  (goal: 1.2 %)")


def samples(seconds: float) -> None:
    with virtual_device() as (device, _):
        ages, total = [], 0.0

        def read() -> None:
            nonlocal total
            for number, sample in enumerate(device):
                if "acceleration_hr" in sample:
                    total += float(sample["acceleration_hr"][2])
                if sample.arrival is not None:
                    ages.append(time.monotonic() - sample.arrival)
                if number >= seconds * SAMPLE_RATE:
                    return

        share = processor_share(device, read)
    assert total > 0
    print(f"sample by sample             {share:6.1%} of a core  (goal: 3 %)")
    ages.sort()
    median, most = 1000 * statistics.median(ages), 1000 * ages[int(0.99 * len(ages))]
    print(f"from the port to the loop    {median:6.2f} ms, 99 % below {most:.2f} ms")


def main() -> None:
    seconds = seconds_argument(5)
    record(seconds)
    blocks(seconds)
    samples(seconds)


if __name__ == "__main__":
    main()
