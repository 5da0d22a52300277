"""Measures `read_log` on several threads against one: ``python benches/threads.py [MIB]``.

Each recording is read from memory and from a file (in the page cache), whole and into fresh columns. Before
the measurement, the logs of one and of all threads are compared. On two processors the goal is 1.6.
"""

from __future__ import annotations

import os
import sys
import tempfile
from functools import partial
from pathlib import Path

import numpy as np

import xbus
from common import medians, streams

ROUNDS = 7
#: A recording of some megabytes, which is repeated.
RECORDINGS = {
    "ahrs": partial(streams.ahrs, 65_536),
    "gnssins": partial(streams.gnssins, 50_000),
    "dirty": partial(streams.dirty, 65_536),
}


def main() -> None:
    size = int(float(sys.argv[1] if len(sys.argv) > 1 else 512) * 2**20)
    threads = os.cpu_count() or 1
    print(f"{threads} threads over one, {size >> 20} MiB")
    for name, make in RECORDINGS.items():
        piece = np.frombuffer(make(), np.uint8)
        data = np.tile(piece, max(1, round(size / len(piece))))
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "log.mtb"
            data.tofile(path)
            for where, source in (("memory", data), ("file", path)):
                if xbus.read_log(source, threads=1) != xbus.read_log(source, threads=threads):
                    raise SystemExit(f"{name}, {where}: the logs differ")
                one, several = medians(
                    ROUNDS,
                    partial(xbus.read_log, source, threads=1),
                    partial(xbus.read_log, source, threads=threads),
                )
                print(f"{name:<10}{where:<8}{one / several:.2f}")


if __name__ == "__main__":
    main()
