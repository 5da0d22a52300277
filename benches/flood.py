"""Receives 4 Mbaud on a pty while Python holds the GIL for a second at a time: nothing may be lost.

    python benches/flood.py [SECONDS]

Another process writes high-rate frames at 400 kB/s, in bursts of 16 ms like a USB-serial adapter. This
process computes, reads now and then, and records. The bytes read and recorded must be the bytes written.
"""

import hashlib
import os
import subprocess
import sys
import tempfile
import time
import tty
from pathlib import Path

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
        link.acquisition.record(path)
        writer = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, pass_fds=(master,))
        read = hashlib.sha256()
        size = 0
        while writer.poll() is None:
            hold_the_gil(1)
            size, read = take(link, size, read)
        assert writer.stdout is not None
        written, samples, digest = writer.stdout.read().split()
        while size < int(written):
            size, read = take(link, size, read)
        stats = link.acquisition.stats()
        link.acquisition.stop_recording()
        link.close()
        recorded = path.read_bytes()
    assert read.hexdigest() == digest, "the bytes read are not the bytes written"
    assert hashlib.sha256(recorded).hexdigest() == digest, (
        "the bytes recorded are not the bytes written"
    )
    assert stats["samples"] == int(samples), stats
    assert stats["dropped_bytes"] == stats["lost_samples"] == stats["skipped_bytes"] == 0, stats
    print(
        f"{size:,} bytes in {seconds:.0f} s ({size / seconds / 1000:.0f} kB/s), {samples} samples:"
        f" none lost, read or recorded; at most {stats['most_queued_bytes'] / 1000:.0f} kB queued"
    )


def take(link: SerialLink, size: int, digest: "hashlib._Hash") -> tuple[int, "hashlib._Hash"]:
    data = link.read(0.1).data
    digest.update(data)
    return size + len(data), digest


if __name__ == "__main__":
    if sys.argv[1:2] == ["write"]:
        write(int(sys.argv[2]), float(sys.argv[3]))
    else:
        main()
