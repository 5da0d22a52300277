"""Measures what ``--jobs`` brings to a batch: ``python benches/batch.py [RECORDINGS]``.

Prints the time of each command over recordings of 4 MB with one job and with one per core, and their ratio.
Checks that both write the same files.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))
import streams

RECORDINGS = int(sys.argv[1]) if len(sys.argv) > 1 else 40
ROWS = 45_000
COMMANDS = {
    "decode to Parquet": ["decode"],
    "decode to CSV": ["decode", "--suffix", ".csv"],
    "info": ["info"],
    "report": ["report"],
}
REPEATS = 3


def run(command: list[str], folder: Path, out: Path, jobs: int) -> float:
    """Returns the seconds that a command takes."""
    call = [sys.executable, "-m", "xbus", *command, str(folder), "--out-dir", str(out)]
    start = time.perf_counter()
    subprocess.run([*call, "-q", "--jobs", str(jobs)], check=True)
    return time.perf_counter() - start


def main() -> None:
    cores = os.cpu_count() or 1
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name, "in")
        folder.mkdir()
        for seed in range(RECORDINGS):
            (folder / f"r{seed}.mtb").write_bytes(bytes(streams.ahrs(ROWS, seed=seed)))
        for title, command in COMMANDS.items():
            times: dict[int, list[float]] = {jobs: [] for jobs in (1, cores)}
            for _ in range(REPEATS):
                for jobs, seconds in times.items():
                    seconds.append(run(command, folder, Path(name, f"{title} {jobs}"), jobs))
            one, all_cores = (min(seconds) for seconds in times.values())
            outs = [sorted(Path(name, f"{title} {jobs}").iterdir()) for jobs in times]
            assert len(outs[0]) == RECORDINGS
            assert [path.read_bytes() for path in outs[0]] == [
                path.read_bytes() for path in outs[1]
            ]
            print(
                f"{title}: {one:.2f} s, {cores} jobs {all_cores:.2f} s, {one / all_cores:.2f} times"
            )


if __name__ == "__main__":
    main()
