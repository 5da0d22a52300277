"""Peak memory: ``python benches/memory.py``. Linux only: it reads /proc/self/status.

`read_log` on a memory-mapped file must stay under 1.5 times the columns it returns, beside the file's own
pages; `iter_log` must be bounded by its block, however long the file.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

from common import ahrs_stream

MEASURE = """
import sys, numpy as np, xbus
from pathlib import Path

def anonymous():
    # The peak of private memory: the file's own pages, which are shared, do not count.
    lines = Path("/proc/self/status").read_text().splitlines()
    return int(next(line for line in lines if line.startswith("RssAnon")).split()[1]) * 1024

import threading
peak, stop = 0, threading.Event()
def watch():
    global peak
    while not stop.wait(0.001):
        peak = max(peak, anonymous())

path, mode = sys.argv[1:]
before = anonymous()
watcher = threading.Thread(target=watch)
watcher.start()
if mode == "read_log":
    log = xbus.read_log(np.memmap(path, np.uint8, "r"))
    columns = sum(log[key].values.nbytes for key in log)
else:
    parts = xbus.iter_log(path, block_bytes=int(mode))
    columns = sum(part[key].values.nbytes for part in parts for key in part)
peak = max(peak, anonymous())
stop.set()
watcher.join()
print(peak - before, columns)
"""


def measured(path: Path, mode: str) -> tuple[int, int]:
    """Peak bytes, and bytes of all columns."""
    run = [sys.executable, "-c", MEASURE, path, mode]
    peak, columns = subprocess.run(run, check=True, capture_output=True, text=True).stdout.split()
    return int(peak), int(columns)


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "big.mtb"
        path.write_bytes(ahrs_stream(256))
        peak, columns = measured(path, "read_log")
        print(f"read_log: peak {peak / columns:.2f} times the columns ({columns >> 20} MiB)")
        assert peak < 1.5 * columns
        for block in (4 << 20, 32 << 20):
            peak, total = measured(path, str(block))
            assert total == columns
            print(f"iter_log: peak {peak / block:.2f} times its block of {block >> 20} MiB")


if __name__ == "__main__":
    main()
