"""4 Mbaud for long, with damage on the line: memory flat, every intact frame recorded, every loss counted.

    python benches/soak.py [SECONDS]

Another process writes high-rate frames at 400 kB/s and damages one in a thousand. Afterwards the
recording is read: it must have the frames that were left intact (but for what a checksum of eight bits
lets pass), and the samples that it misses must be those that its counter tells.
"""

import os
import random
import resource
import subprocess
import sys
import tempfile
import time
import tty
from pathlib import Path

import numpy as np
import serial
from flood import BURST, RATE, sample

import xbus
from xbus.device.link import SerialLink

DAMAGED = 1e-3
#: A frame that lost a byte takes one of the next: one in 256 such passes the checksum, and costs that one.
CHANCE = 1e-5
#: Part of the time after which memory must not grow, and by how many MiB it may.
WARM, GROWTH = 0.2, 8


def write(descriptor: int, seconds: float) -> None:
    """The other process: writes, and prints how many frames, and which of them are damaged."""
    draw, counter, damaged = random.Random(1), 0, []
    begun = time.monotonic()
    size = len(sample(0))
    while time.monotonic() - begun < seconds:
        pieces = []
        for _ in range(int((time.monotonic() - begun) * RATE / size) - counter):
            frame = bytearray(sample(counter))
            if draw.random() < DAMAGED:
                damaged.append(counter)
                if draw.random() < 0.5:
                    frame[draw.randrange(size)] ^= 1 << draw.randrange(8)
                else:
                    del frame[draw.randrange(size)]
            pieces.append(frame)
            counter += 1
        data = b"".join(pieces)
        while data:
            data = data[os.write(descriptor, data) :]
        time.sleep(BURST)
    print(counter, *damaged)


def memory() -> float:
    """The most memory that this process has had, in MiB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def main() -> None:
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 600
    master, slave = os.openpty()
    tty.setraw(slave)
    with tempfile.TemporaryDirectory() as folder:
        path, told = Path(folder) / "log.mtb", Path(folder) / "told"
        link = SerialLink(serial.Serial(os.ttyname(slave), 4_000_000), owned=True)
        os.close(slave)
        link.acquisition.record(path)
        command = [sys.executable, __file__, "write", str(master), str(seconds)]
        with told.open("w") as output:  # more than a pipe holds
            writer = subprocess.Popen(command, stdout=output, pass_fds=(master,))
        begun, warm = time.monotonic(), 0.0
        while writer.poll() is None:
            link.read(0.5)
            if not warm and time.monotonic() - begun > WARM * seconds:
                warm = memory()
        grown = memory() - warm
        sent, *damaged = map(int, told.read_text().split())
        while link.read(0.5).data:
            pass
        stats = link.acquisition.stats()
        link.acquisition.stop_recording()
        link.close()
        log = xbus.read_log(path)
    there = np.zeros(sent, np.bool_)
    counters = log.packet_counter
    there[counters[(counters >= 0) & (counters < sent)]] = True
    missing = np.flatnonzero(~there)
    wrong = np.setdiff1d(missing, damaged)
    print(
        f"{sent:,} frames in {seconds:.0f} s, {len(damaged):,} damaged: {len(missing):,} not there, of these"
        f" {len(wrong)} intact ones; counted as lost {stats['lost_samples']:,}; memory grew {grown:.1f} MiB"
    )
    assert len(wrong) <= CHANCE * sent + 1, wrong
    assert stats["dropped_bytes"] == 0, stats
    # The counter cannot know what is missing behind the last sample.
    assert abs(stats["lost_samples"] - len(missing)) <= 2, stats
    assert grown < GROWTH, f"memory grew by {grown:.1f} MiB"


if __name__ == "__main__":
    if sys.argv[1:2] == ["write"]:
        write(int(sys.argv[2]), float(sys.argv[3]))
    else:
        main()
