"""Measures peak memory: ``python benches/memory.py``. Linux only: it reads /proc/self/status.

`read_log` of a memory-mapped file must need less than 1.5 times the memory of its columns, without the pages
of the file. `iter_log` must need a few blocks, for a file of any length.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

from common import ahrs_stream

#: Limits of the peak: relative to all columns, and to a block.
MOST_COLUMNS, MOST_BLOCKS = 1.5, 4
MEASURE = """
import sys, numpy as np, xbus
from pathlib import Path

def private_bytes():
    # Private memory only: the pages of the file are shared.
    lines = Path("/proc/self/status").read_text().splitlines()
    return int(next(line for line in lines if line.startswith("RssAnon")).split()[1]) * 1024

import threading
peak, stop = 0, threading.Event()
def watch():
    global peak
    while not stop.wait(0.001):
        peak = max(peak, private_bytes())

path, mode = sys.argv[1:]
before = private_bytes()
watcher = threading.Thread(target=watch)
watcher.start()
if mode == "read_log":
    log = xbus.read_log(np.memmap(path, np.uint8, "r"))
    columns = sum(log[key].values.nbytes for key in log)
else:
    parts = xbus.iter_log(path, block_bytes=int(mode))
    columns = sum(part[key].values.nbytes for part in parts for key in part)
peak = max(peak, private_bytes())
stop.set()
watcher.join()
print(peak - before, columns)
"""


def measure(path: Path, mode: str) -> tuple[int, int]:
    """Returns the peak in bytes, and the bytes of all columns."""
    run = [sys.executable, "-c", MEASURE, str(path), mode]
    peak, columns = subprocess.run(run, check=True, capture_output=True, text=True).stdout.split()
    return int(peak), int(columns)


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "big.mtb"
        path.write_bytes(ahrs_stream(256))
        peak, columns = measure(path, "read_log")
        print(f"read_log: peak {peak / columns:.2f} times the columns ({columns >> 20} MiB)")
        assert peak < MOST_COLUMNS * columns
        for block in (4 << 20, 32 << 20):
            peak, total = measure(path, str(block))
            assert total == columns
            print(f"iter_log: peak {peak / block:.2f} times its block of {block >> 20} MiB")
            assert peak < MOST_BLOCKS * block


if __name__ == "__main__":
    main()
