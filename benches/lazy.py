"""Measures `scan_log`, parts of a log and dask: ``python benches/lazy.py [MIB] [NAME...]``.

``scan``: the mean of one vector by `scan_log` over that by `read_log` of that quantity, with all processors.
``parts``: the processor time of `split_log` parts of 1 to 64 MiB, read one after the other with one thread,
over that of one pass with `iter_log`.
``dask``: the mean of each column of four files by two workers with one thread each, over one process with one
thread: wall time, and processor time per process. The same for two processes with half of the files each,
which is the best that a machine allows.
``rates``: gigabytes of input per second of processor time, from files in the page cache.

All results are compared before they are measured.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import polars as pl
from dask import config
from distributed import Client, LocalCluster

import xbus
import xbus.dask
from common import medians, streams

ROUNDS = 5
QUANTITY = "acceleration"
AXES = [f"{QUANTITY}_{axis}" for axis in "xyz"]


def recording(path: Path, size: int) -> None:
    """Writes inertial samples of about this size, which repeat after some megabytes."""
    piece = np.frombuffer(streams.ahrs(65_536), np.uint8)
    with path.open("wb") as file:
        for _ in range(max(1, round(size / len(piece)))):
            file.write(piece.tobytes())


def same(one: list[float], other: list[float]) -> None:
    if not np.allclose(one, other, rtol=1e-4):
        raise SystemExit(f"the results differ: {one} {other}")


def read_mean(path: Path, threads: int | None) -> list[float]:
    log = xbus.read_log(path, quantities=[QUANTITY], threads=threads)
    mean: list[float] = log[QUANTITY].values.mean(axis=0, dtype=np.float64).tolist()
    return mean


def scan_mean(path: Path) -> list[float]:
    query = xbus.scan_log(path).select(pl.col(AXES).cast(pl.Float64).mean())
    return list(query.collect(engine="streaming").row(0))


def scan(path: Path) -> None:
    same(scan_mean(path), read_mean(path, None))
    one, other = medians(ROUNDS, lambda: scan_mean(path), lambda: read_mean(path, None))
    print(f"scan_log over read_log                {one / other:.2f}")


def processor_time(work: Callable[[], object]) -> float:
    """Returns the processor time of a function in seconds."""
    start = time.process_time()
    work()
    return time.process_time() - start


def processor_seconds(works: list[Callable[[], object]]) -> list[float]:
    """Returns the least processor time of each function, run in turns."""
    rounds = [[processor_time(work) for work in works] for _ in range(ROUNDS)]
    return [min(times) for times in zip(*rounds, strict=True)]


def parts(path: Path) -> None:
    sizes = (1, 4, 16, 64)
    split = {size: xbus.split_log(path, block_bytes=size << 20) for size in sizes}
    whole = read_mean(path, None)
    for found in split.values():
        logs = (part.read(quantities=[QUANTITY]) for part in found)
        sums = np.sum([log[QUANTITY].values.sum(axis=0, dtype=np.float64) for log in logs], axis=0)
        same(list(sums / sum(part.samples for part in found)), whole)

    def read_all(size: int) -> None:
        for part in split[size]:
            part.read()

    works: list[Callable[[], object]] = [lambda: [len(part) for part in xbus.iter_log(path)]]
    works += [lambda size=size: read_all(size) for size in sizes]  # type: ignore[misc]
    # Ratios of neighbours: the speed of a shared machine changes by more than parts cost.
    rounds = [[processor_time(work) for work in works] for _ in range(2 * ROUNDS)]
    ratios = [[seconds / base for seconds in taken] for base, *taken in rounds]
    for size, ratio in zip(sizes, np.median(ratios, axis=0), strict=True):
        print(f"parts of {size:>2} MiB over one pass            {ratio:.2f}")


def column_means(files: list[Path]) -> list[float]:
    """Returns the means of a vector; dask computes those of all columns."""
    frame = xbus.dask.read_logs(files, index=None)
    return frame.mean(numeric_only=True).compute()[AXES].tolist()  # type: ignore[no-any-return]


def column_means_alone(files: list[Path]) -> list[float]:
    # Not an argument of compute(): read_logs would still find the parts on the cluster.
    with config.set(scheduler="sync"):
        return column_means(files)


def dask(path: Path) -> None:
    size = path.stat().st_size
    files = []
    for number in range(4):
        files.append(path.with_name(f"{number}.mtb"))
        recording(files[-1], size // 4)

    with (
        LocalCluster(  # type: ignore[no-untyped-call]
            n_workers=2, threads_per_worker=1, dashboard_address=None, memory_limit=0
        ) as cluster,
        Client(cluster) as client,  # type: ignore[no-untyped-call]
        ProcessPoolExecutor(2, get_context("spawn")) as pool,
    ):

        def mean() -> list[float]:
            return column_means(files)

        def mean_alone() -> list[float]:
            return column_means_alone(files)

        def mean_of_halves() -> list[float]:
            halves = pool.map(column_means_alone, (files[:2], files[2:]))
            return list(np.mean(list(halves), axis=0))

        for found in (mean(), mean_of_halves()):
            same(found, read_mean(files[0], 1))
        two, halves, one = medians(ROUNDS, mean, mean_of_halves, mean_alone)
        before = client.run(time.process_time)
        mean()
        after = client.run(time.process_time)
    (alone,) = processor_seconds([mean_alone])
    most = max(after[worker] - before[worker] for worker in before)
    print(f"dask, two workers over one process    {two / one:.2f}")
    print(f"the same, processor time of one       {most / alone:.2f}")
    print(f"two processes that share nothing      {halves / one:.2f}")


def rates(path: Path) -> None:
    size = path.stat().st_size / 1e9
    found = xbus.split_log(path, block_bytes=16 << 20)

    def read_file() -> None:
        buffer = bytearray(1 << 19)
        with path.open("rb", buffering=0) as file:
            while file.readinto(buffer):
                pass

    works: dict[str, Callable[[], object]] = {
        "only read": read_file,
        "first pass": lambda: xbus.split_log(path, block_bytes=16 << 20, threads=1),
        "one vector": lambda: [len(part.read(quantities=[QUANTITY])) for part in found],
        "all quantities": lambda: [len(part.read()) for part in found],
        "Arrow tables": lambda: [part.read().to_arrow().num_rows for part in found],
        "DataFrames": lambda: [len(part.read().to_pandas()) for part in found],
    }
    for name, seconds in zip(works, processor_seconds(list(works.values())), strict=True):
        print(f"{name:<38}{size / seconds:.1f} GB/s")


def main() -> None:
    size = int(float(sys.argv[1]) if len(sys.argv) > 1 else 2048) << 20
    wanted = sys.argv[2:] or ["scan", "parts", "dask", "rates"]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.mtb"
        recording(path, size)
        print(f"{path.stat().st_size >> 20} MiB")
        for name in wanted:
            {"scan": scan, "parts": parts, "dask": dask, "rates": rates}[name](path)


if __name__ == "__main__":
    main()
