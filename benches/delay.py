"""Measures the age of live data, from the write to a pty until a program or a disk has them.

    python benches/delay.py [SECONDS]

Every sample carries the time at which another process writes it, which gives its age: in a loop over samples,
in blocks of 20 ms, and in the recorded file, which is written every half second.
"""

import os
import subprocess
import sys
import tempfile
import threading
import time
import tty
from pathlib import Path

import numpy as np
import serial

import xbus
from xbus.device import Device
from xbus.device.link import SerialLink

#: Samples per second, and seconds of a block.
SAMPLE_RATE = 2000
BLOCK_SECONDS = 0.02


def write(descriptor: int, seconds: float) -> None:
    """Writes a sample every half millisecond, in another process."""
    begun = time.monotonic()
    for number in range(int(seconds * SAMPLE_RATE)):
        while (wait := begun + number / SAMPLE_RATE - time.monotonic()) > 0:
            time.sleep(wait)
        packets = {"packet_counter": number % 65536, "sample_time64": time.monotonic_ns()}
        os.write(descriptor, xbus.encode_sample(packets))


def print_ages(what: str, ages: "np.typing.NDArray[np.float64]") -> None:
    median, most = np.percentile(ages * 1000, [50, 99])
    print(f"{what:28} median {median:8.2f} ms, 99 % below {most:8.2f} ms")


def main() -> None:
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 10
    for what in (samples, blocks, disk):
        master, slave = os.openpty()
        tty.setraw(slave)
        link = SerialLink(serial.Serial(os.ttyname(slave), 4_000_000), owned=True)
        os.close(slave)
        command = [sys.executable, __file__, "write", str(master), str(seconds)]
        with subprocess.Popen(command, pass_fds=(master,)) as writer, Device(link) as device:
            ages = np.array(what(device, int(seconds * SAMPLE_RATE)))
            writer.wait()
            assert device.stats.lost_samples == 0, device.stats
        os.close(master)
        assert len(ages) >= 0.9 * seconds * SAMPLE_RATE, len(ages)
        assert (ages > 0).all()
        print_ages(what.__name__, ages)


def samples(device: Device, count: int) -> list[float]:
    """Returns the ages of samples that are read one by one."""
    ages = []
    for _ in range(count):
        written = device.read_sample()["sample_time64"]
        ages.append((time.monotonic_ns() - written) / 1e9)
    return ages


def blocks(device: Device, count: int) -> list[float]:
    """Returns the ages of samples when their blocks are complete."""
    ages: list[float] = []
    while len(ages) < count:
        for block in device.blocks(seconds=BLOCK_SECONDS):
            now = time.monotonic_ns()
            ages += ((now - block["sample_time64"].values.astype(np.int64)) / 1e9).tolist()
            if len(ages) >= 0.95 * count:
                return ages
    return ages


def disk(device: Device, count: int) -> list[float]:
    """Returns the ages of samples in the file, which another thread reads every millisecond."""
    ages: list[float] = []
    stop = threading.Event()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.mtb"
        recorder = device.link.acquisition.record(path)

        def watch() -> None:
            with path.open("rb") as file:
                while not stop.wait(0.001):
                    if (data := file.read()) and (now := time.monotonic_ns()):
                        log = xbus.read_log(data)
                        if "sample_time64" in log:
                            stamps = log["sample_time64"].values.astype(np.int64)
                            ages.extend(((now - stamps) / 1e9).tolist())

        watcher = threading.Thread(target=watch)
        watcher.start()
        for _ in range(count):
            device.read_sample()
        recorder.stop()
        stop.wait(0.1)
        stop.set()
        watcher.join()
    return ages


if __name__ == "__main__":
    if sys.argv[1:2] == ["write"]:
        write(int(sys.argv[2]), float(sys.argv[3]))
    else:
        main()
