"""Receives 4 Mbaud with damage for a long time: constant memory, no intact frame lost, every loss counted.

    python benches/soak.py [SECONDS]

Another process writes high-rate frames at 400 kB/s and damages one in a thousand. The recording must have all
intact frames, except for the few that an 8-bit checksum cannot protect, and the counter must show the missing
ones.
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

import xbus
from flood import BURST_PERIOD, BYTE_RATE, sample
from xbus.device.link import SerialLink

#: Fraction of damaged frames.
DAMAGE = 1e-3
#: Fraction of intact frames that can be lost: a frame without one of its bytes takes the first byte of the
#: next frame for its checksum, which is right by chance once in 256.
MOST_LOST = 1e-5
#: Fraction of the time after which memory is measured, and the MiB by which it may grow from then on.
WARM_UP, MOST_GROWTH = 0.2, 8


def write(descriptor: int, seconds: float) -> None:
    """Writes frames in another process, and prints their count and the numbers of the damaged ones."""
    draw, counter, damaged = random.Random(1), 0, []
    begun = time.monotonic()
    size = len(sample(0))
    while time.monotonic() - begun < seconds:
        pieces = []
        for _ in range(int((time.monotonic() - begun) * BYTE_RATE / size) - counter):
            frame = bytearray(sample(counter))
            if draw.random() < DAMAGE:
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
        time.sleep(BURST_PERIOD)
    print(counter, *damaged)


def memory() -> float:
    """Returns the peak memory of this process in MiB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def discard(link: SerialLink) -> bool:
    """Waits up to half a second for samples, removes what waits, and returns whether any came."""
    has_samples = link.wait(0.5, samples=1)
    link.acquisition.clear_data()
    link.acquisition.take_events()
    return has_samples


def main() -> None:
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 600
    master, slave = os.openpty()
    tty.setraw(slave)
    with tempfile.TemporaryDirectory() as folder:
        path, report = Path(folder) / "log.mtb", Path(folder) / "written"
        link = SerialLink(serial.Serial(os.ttyname(slave), 4_000_000), owned=True)
        os.close(slave)
        recorder = link.acquisition.record(path)
        command = [sys.executable, __file__, "write", str(master), str(seconds)]
        with report.open("w") as output:  # too long for the buffer of a pipe
            writer = subprocess.Popen(command, stdout=output, pass_fds=(master,))
        begun, warm = time.monotonic(), 0.0
        while writer.poll() is None:
            discard(link)
            if not warm and time.monotonic() - begun > WARM_UP * seconds:
                warm = memory()
        grown = memory() - warm
        sent, *damaged = map(int, report.read_text().split())
        while discard(link):
            pass
        stats = link.acquisition.stats(link.clock())
        recorder.stop()
        link.close()
        log = xbus.read_log(path)
    lost = stats["counts"]["losses"]["samples"]
    is_recorded = np.zeros(sent, np.bool_)
    counters = log.packet_counter
    is_recorded[counters[(counters >= 0) & (counters < sent)]] = True
    missing = np.flatnonzero(~is_recorded)
    lost_intact = np.setdiff1d(missing, damaged)
    print(
        f"{sent:,} frames in {seconds:.0f} s, {len(damaged):,} damaged: {len(missing):,} missing, of these"
        f" {len(lost_intact)} intact; counted as lost {lost:,}; memory grew {grown:.1f} MiB"
    )
    assert len(lost_intact) <= MOST_LOST * sent + 1, lost_intact
    assert stats["dropped"]["samples"] == stats["dropped"]["messages"] == 0, stats
    # The counter does not show what is missing after the last sample.
    assert abs(lost - len(missing)) <= 2, stats
    assert grown < MOST_GROWTH, f"memory grew by {grown:.1f} MiB"


if __name__ == "__main__":
    if sys.argv[1:2] == ["write"]:
        write(int(sys.argv[2]), float(sys.argv[3]))
    else:
        main()
