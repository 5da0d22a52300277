"""Receives 4 Mbaud on a pty while Python holds the GIL for a second at a time: nothing may be lost.

    python benches/flood.py [SECONDS]

Another process writes high-rate frames at 400 kB/s, in bursts of 16 ms like a USB-serial adapter. This
process computes, reads now and then, and records. Each sample must be read once, with the values written, and
the bytes recorded must be the bytes written.
"""

import hashlib
import os
import subprocess
import sys
import tempfile
import time
import tty
from pathlib import Path

import numpy as np
import serial

import xbus
from xbus.device.link import SerialLink

#: Bytes per second, and seconds between two bursts.
BYTE_RATE = 400_000
BURST_PERIOD = 0.016


def sample(counter: int) -> bytes:
    return xbus.encode_sample(
        {"packet_counter": counter % 65536, "acceleration_hr": [counter, 0.5, -9.8]}
    )


def write(descriptor: int, seconds: float) -> None:
    """Writes frames in another process, and prints their bytes, count and digest."""
    digest, written, counter = hashlib.sha256(), 0, 0
    begun = time.monotonic()
    while time.monotonic() - begun < seconds:
        due = int((time.monotonic() - begun) * BYTE_RATE) - written
        count = due // len(sample(0))
        data = b"".join(map(sample, range(counter, counter + count)))
        counter += count
        digest.update(data)
        written += len(data)
        while data:
            data = data[os.write(descriptor, data) :]
        time.sleep(BURST_PERIOD)
    print(written, counter, digest.hexdigest())


def hold_the_gil(seconds: float) -> None:
    """Computes with calls that do not release the GIL."""
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        pow(7, 1_000_000)


def main() -> None:
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 60
    master, slave = os.openpty()
    tty.setraw(slave)
    command = [sys.executable, __file__, "write", str(master), str(seconds)]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.mtb"
        link = SerialLink(serial.Serial(os.ttyname(slave), 4_000_000), owned=True)
        os.close(slave)
        recorder = link.acquisition.record(path)
        writer = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, pass_fds=(master,))
        reader, most_queued = Reader(link), 0
        while writer.poll() is None:
            hold_the_gil(1)
            most_queued = max(most_queued, link.acquisition.stats(link.clock())["queued"])
            reader.read()
        assert writer.stdout is not None
        written, samples, digest = writer.stdout.read().split()
        while link.wait(0.5, samples=1):
            reader.read()
        stats = link.acquisition.stats(link.clock())
        recorder.stop()
        link.close()
        recorded = path.read_bytes()
    assert reader.count == int(samples), f"{reader.count} samples read, {samples} written"
    assert hashlib.sha256(recorded).hexdigest() == digest, (
        "the bytes recorded are not the bytes written"
    )
    counts = stats["counts"]
    assert (counts["bytes"], counts["samples"]) == (int(written), int(samples)), stats
    assert counts["losses"]["samples"] == counts["skipped_bytes"] == 0, stats
    assert stats["dropped"]["samples"] == stats["unread"] == 0, stats
    print(
        f"{counts['bytes']:,} bytes in {seconds:.0f} s ({counts['bytes'] / seconds / 1000:.0f} kB/s),"
        f" {samples} samples: each read once and recorded; at most {most_queued / 1000:.0f} kB queued"
    )


class Reader:
    """Reads samples in blocks, and checks that each is the next one.

    Attributes:
        count: Number of samples.
    """

    def __init__(self, link: SerialLink) -> None:
        self._acquisition = link.acquisition
        self._decoder = link.acquisition.block_decoder()
        self.count = 0

    def read(self) -> None:
        """Reads all samples that wait."""
        block = self._acquisition.take_block(self._decoder)
        assert block is not None
        log = xbus.Log(block.part)
        if len(log):
            expected = np.arange(self.count, self.count + len(log))
            assert np.array_equal(log["packet_counter"].values, expected % 65536)
            assert np.array_equal(log["acceleration_hr"].values[:, 0], expected.astype(np.float32))
        self.count += len(log)


if __name__ == "__main__":
    if sys.argv[1:2] == ["write"]:
        write(int(sys.argv[2]), float(sys.argv[3]))
    else:
        main()
