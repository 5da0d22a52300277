"""What the Python benches share: a recording, a virtual device, and timing of alternating runs."""

from __future__ import annotations

import contextlib
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import xbus

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))

import streams

__all__ = [
    "ahrs_stream",
    "medians",
    "processor_seconds",
    "ratio",
    "seconds_argument",
    "streams",
    "virtual_device",
]

#: Bytes of a frame of `ahrs_stream`.
AHRS_FRAME = 88
#: 3,600 samples per second.
HIGH_RATE_OUTPUTS = {
    "packet_counter": None,
    "sample_time_fine": None,
    "acceleration_hr": 2000,
    "rate_of_turn_hr": 1600,
}


def ahrs_stream(mebibytes: float) -> bytes:
    """Returns messages with counter, time, orientation, inertial and magnetic vectors, and status."""
    return streams.ahrs(max(1, round(mebibytes * 2**20 / AHRS_FRAME)))


def seconds_argument(default: float) -> float:
    """Returns the duration on the command line."""
    return float(sys.argv[1]) if len(sys.argv) > 1 else default


def processor_seconds(pid: int) -> float:
    """Returns the processor time of a process so far, in seconds. Linux only."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    user, system = int(fields[11]), int(fields[12])
    return (user + system) / os.sysconf("SC_CLK_TCK")


@contextlib.contextmanager
def virtual_device(
    outputs: Mapping[str, int | None] = HIGH_RATE_OUTPUTS,
) -> Iterator[tuple[xbus.Device, subprocess.Popen[str]]]:
    """Connects to a virtual MTi-630 in another process, which measures with these outputs."""
    command = [sys.executable, "-m", "xbus", "sim", "--product", "MTi-630"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        port = process.stdout.readline().removeprefix("port: ").strip()
        try:
            with xbus.connect(port) as device:
                with device.configure(outputs, check_baudrate=False):
                    pass
                yield device, process
        finally:
            process.terminate()


def medians(rounds: int, *works: Callable[[], object]) -> list[float]:
    """Returns the median seconds of each function, run in turns after one warm-up round."""
    times: list[list[float]] = [[] for _ in works]
    for round_ in range(rounds + 1):
        for work, seconds in zip(works, times, strict=True):
            start = time.perf_counter()
            work()
            if round_:
                seconds.append(time.perf_counter() - start)
    return [statistics.median(seconds) for seconds in times]


def ratio(rounds: int, work: Callable[[], object], reference: Callable[[], object]) -> float:
    """Returns the time of ``work`` relative to ``reference``."""
    mine, other = medians(rounds, work, reference)
    return mine / other
