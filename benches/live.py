"""What live data cost: 2 kHz acceleration and 1.6 kHz rate of turn from another process, on a pty.

    python benches/live.py [SECONDS]

Processor time of this process over elapsed time, for recording alone (drained, scanned and written by
threads), in blocks of 0.1 s, and sample by sample; and how old data are when they arrive. Each checks
that nothing was lost.
"""

import contextlib
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import xbus

OUTPUTS = {
    "packet_counter": None,
    "sample_time_fine": None,
    "acceleration_hr": 2000,
    "rate_of_turn_hr": 1600,
}
RATE = 3600


@contextlib.contextmanager
def measuring() -> Iterator[xbus.Device]:
    command = [sys.executable, "-m", "xbus", "sim", "--product", "MTi-630"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        port = process.stdout.readline().removeprefix("port: ").strip()
        try:
            with xbus.connect(port) as device:
                with device.configure(OUTPUTS, check_baudrate=False):
                    pass
                yield device
        finally:
            process.terminate()


def share(device: xbus.Device, work: Callable[[], None]) -> float:
    """Processor time over elapsed time; afterwards nothing may be missing."""
    began, used = time.perf_counter(), sum(os.times()[:2])
    work()
    elapsed, used = time.perf_counter() - began, sum(os.times()[:2]) - used
    stats = device.stats
    assert stats.lost_samples == stats.dropped_bytes == stats.skipped_bytes == 0, stats
    return used / elapsed


def record(seconds: float) -> None:
    with measuring() as device, tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.mtb"
        with device.record(path):
            used = share(device, lambda: time.sleep(seconds))
        log = xbus.read_log(path)
    assert log.stats.lost_samples == 0
    assert abs(len(log) / seconds - RATE) < RATE / 20, len(log)
    print(f"recording, nobody reads      {used:6.1%} of a core  (goal: 3 %)")


def blocks(seconds: float) -> None:
    with measuring() as device:
        sizes = []

        def read() -> None:
            for block in device.blocks(seconds=0.1):
                sizes.append(len(block["acceleration_hr"].values))
                if len(sizes) >= seconds * 10:
                    return

        used = share(device, read)
    assert abs(sum(sizes) / seconds - 2000) < 100, sum(sizes)
    print(f"blocks of 0.1 s              {used:6.1%} of a core  (goal: 5 %)")


def samples(seconds: float) -> None:
    with measuring() as device:
        ages, norms = [], 0.0

        def read() -> None:
            nonlocal norms
            for number, sample in enumerate(device):
                if "acceleration_hr" in sample:
                    norms += float(sample["acceleration_hr"][2])
                if sample.arrival is not None:
                    ages.append(time.monotonic() - sample.arrival)
                if number >= seconds * RATE:
                    return

        used = share(device, read)
    assert norms > 0
    print(f"sample by sample             {used:6.1%} of a core  (goal: 25 %)")
    ages.sort()
    median, late = 1000 * statistics.median(ages), 1000 * ages[int(0.99 * len(ages))]
    print(f"from the port to the loop    {median:6.2f} ms, 99 % below {late:.2f} ms")


def main() -> None:
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 5
    record(seconds)
    blocks(seconds)
    samples(seconds)


if __name__ == "__main__":
    main()
