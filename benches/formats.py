"""Measures the formats of other software: ``python benches/formats.py [SAMPLES] [SUFFIX...]``.

Prints samples and bytes per second of processor time, of a log in memory that is already decoded.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

import xbus
from common import streams
from xbus.cli.export_formats import EXPORTS, FormatOptions
from xbus.export.format import export


def main() -> None:
    samples = int(sys.argv[1]) if len(sys.argv) > 1 else 200_000
    log = xbus.read_log(streams.gnssins(samples))
    with tempfile.TemporaryDirectory() as folder:
        for suffix in sys.argv[2:] or EXPORTS:
            file_format = FormatOptions().format_of(suffix)
            assert file_format is not None
            best = float("inf")
            for _ in range(3):
                start = time.process_time()
                export(file_format, log, [log], Path(folder) / f"out{suffix}")
                best = min(best, time.process_time() - start)
            size = sum(path.stat().st_size for path in Path(folder).glob("*"))
            print(f"{suffix:10} {samples / best:12,.0f} samples/s {size / best / 1e6:8.1f} MB/s")
            for path in Path(folder).glob("*"):
                path.unlink()


if __name__ == "__main__":
    main()
