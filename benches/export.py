"""Measures ``xbus decode`` to Parquet and CSV: ``python benches/export.py [MIB] [PATH]``.

The reference is the time in which pyarrow writes the same table from memory, with its default settings and
with those of xbus. With PATH, the ``python`` folder of another build of xbus, it is also the command of that
build. The command is a whole process, with start-up and reading. Peak memory is that of the process.
"""

from __future__ import annotations

import functools
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq

import xbus
from common import ahrs_stream

MEBIBYTES = float(sys.argv[1]) if len(sys.argv) > 1 else 256
OTHER = sys.argv[2] if len(sys.argv) > 2 else None
ROUNDS = 5


#: Runs the command and prints the peak memory of the process: that of wait4 may be of the parent.
MEASURED = """
import sys
from pathlib import Path
from xbus.cli import main
try:
    main(sys.argv[1:])
finally:
    status = Path("/proc/self/status").read_text()
    print(status.partition("VmHWM:")[2].split()[0])
"""


class Cost(NamedTuple):
    """What a run took: seconds, seconds of processor time, MiB at most (of a process)."""

    wall: float
    processor: float
    peak: float


def command(log: Path, out: Path, path: str | None = None) -> Cost:
    """Runs the command of this build, or of the one in the folder ``path``."""
    environment = os.environ | ({"PYTHONPATH": path} if path else {})
    start = time.perf_counter()
    arguments = [sys.executable, "-c", MEASURED, "decode", "-q", str(log), "-o", str(out)]
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(arguments, env=environment, check=True, capture_output=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    processor = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return Cost(time.perf_counter() - start, processor, int(done.stdout) / 1024)


def call(function: Callable[[], object]) -> Cost:
    """Calls a function in this process."""
    start, before = time.perf_counter(), time.process_time()
    function()
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return Cost(time.perf_counter() - start, time.process_time() - before, peak)


def parquet_options(schema: pa.Schema) -> dict[str, Any]:
    """Returns the settings of xbus for pyarrow."""
    integers = [pa.int32(), pa.int64(), pa.uint32(), pa.uint64()]
    encoding = {
        field.name: "BYTE_STREAM_SPLIT"
        if pa.types.is_floating(field.type)
        else "DELTA_BINARY_PACKED"
        for field in schema
        if pa.types.is_floating(field.type) or field.type in integers
    }
    return {
        "compression": "zstd",
        "use_dictionary": False,
        "column_encoding": encoding,
        "write_statistics": ["sample", "time"],
    }


def compare(works: dict[str, Callable[[], Cost]]) -> None:
    """Runs works in turns and prints their medians, and the ratio of the first to each other one."""
    costs: dict[str, list[Cost]] = {name: [] for name in works}
    for _ in range(ROUNDS):
        for name, work in works.items():
            costs[name].append(work())
    first: Cost | None = None
    for name, found in costs.items():
        median = Cost(*(statistics.median(column) for column in zip(*found, strict=True)))
        first = first or median
        print(
            f"  {name:40}{median.wall:8.2f} s{median.processor:8.2f} s of processor time"
            f"{median.peak:8.0f} MiB; the first takes {first.wall / median.wall:.2f} of the time, "
            f"{first.processor / median.processor:.2f} of the processor time"
        )


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "big.mtb"
        log.write_bytes(ahrs_stream(MEBIBYTES))
        table = xbus.read_log(log).to_arrow()
        print(f"{MEBIBYTES:g} MiB, {table.num_rows} rows, {table.num_columns} columns")
        for suffix in ("parquet", "csv"):
            ours, theirs, old = (
                Path(folder) / f"{name}.{suffix}" for name in ("ours", "theirs", "old")
            )

            def write(path: Path = theirs, suffix: str = suffix, **options: Any) -> None:
                if suffix == "csv":
                    pyarrow.csv.write_csv(table, path)
                else:
                    pq.write_table(table, path, **options)

            works: dict[str, Callable[[], Cost]] = {
                "xbus decode": functools.partial(command, log, ours),
                "pyarrow, from memory": functools.partial(call, write),
            }
            if suffix == "parquet":
                same = functools.partial(write, **parquet_options(table.schema))
                works["pyarrow with our settings, from memory"] = functools.partial(call, same)
            if OTHER is not None:
                works[f"xbus decode of {OTHER}"] = functools.partial(command, log, old, OTHER)
            for work in works.values():
                work()
            if suffix == "parquet":
                assert pq.read_table(ours).equals(table)
            else:
                assert ours.read_bytes() == theirs.read_bytes()
            sizes = f"{ours.stat().st_size >> 20} MiB, of pyarrow {theirs.stat().st_size >> 20} MiB"
            print(f"{suffix}: {sizes}")
            compare(works)


if __name__ == "__main__":
    main()
