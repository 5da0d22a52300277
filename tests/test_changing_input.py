"""Input that others write, truncate or extend while it is read, and input that does not fit into memory."""

from __future__ import annotations

import mmap
import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import streams
import xbus
from xbus.log.read import reader_of

SAMPLES = 60_000
STREAM = streams.ahrs(SAMPLES)
SIZE = len(STREAM) // SAMPLES


def file_of(tmp_path: Path, data: bytes) -> Path:
    path = tmp_path / "log.mtb"
    path.write_bytes(data)
    return path


# ---------------------------------------------------------------------------------------------
# Memory
# ---------------------------------------------------------------------------------------------


def test_every_kind_of_memory_gives_the_same_log(tmp_path: Path) -> None:
    whole = xbus.read_log(STREAM)
    padded = np.frombuffer(b"ab" + STREAM + b"c", np.uint8)[2:-1]
    with file_of(tmp_path, STREAM).open("rb") as file:
        mapped = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
    for source in (
        padded,
        padded.copy(),
        bytearray(STREAM),
        memoryview(STREAM),
        memoryview(bytearray(b"a" + STREAM))[1:],
        memoryview(mapped),
    ):
        for threads in (1, 2):
            assert xbus.read_log(source, threads=threads) == whole
        assert sum(map(len, xbus.iter_log(source, block_bytes=100_000))) == SAMPLES
    assert len(xbus.read_log(padded[:0].copy())) == len(xbus.read_log(bytearray())) == 0


@pytest.fixture
def written() -> Iterator[np.ndarray[Any, np.dtype[np.uint8]]]:
    """An array of samples that another thread writes: it moves back and forth by a byte."""
    array = np.frombuffer(STREAM, np.uint8)[: 20_000 * SIZE].copy()
    original, moved = array.copy(), np.roll(array, 1)
    done = threading.Event()

    def write() -> None:
        while not done.is_set():
            array[:] = moved
            array[:] = original

    writer = threading.Thread(target=write)
    writer.start()
    yield array
    done.set()
    writer.join()


def test_an_array_that_another_thread_writes(written: np.ndarray[Any, np.dtype[np.uint8]]) -> None:
    """Each byte is in a frame or in damage, whatever it was when it was read."""
    for attempt in range(30):
        log = xbus.read_log(written, threads=1 + attempt % 3)
        messages = int(log.messages.length.sum()) + 5 * len(log.messages)
        strings = int((log.strings.end - log.strings.offset).sum())
        frames = int((log.core.end - log.offset).sum())
        assert frames + messages + strings + log.stats.skipped_bytes == log.stats.bytes
        assert log.stats.bytes == len(written)


# ---------------------------------------------------------------------------------------------
# Files
# ---------------------------------------------------------------------------------------------

HALF = SAMPLES // 2 * SIZE


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize(
    ("resize", "samples", "damage"),
    [
        # (size of the file after a third of it was read, samples, damage)
        (HALF, SAMPLES // 2, []),
        (HALF + 10, SAMPLES // 2, [(HALF, 10, "truncated")]),
        (len(STREAM) * 2, SAMPLES * 2, []),
        (len(STREAM) + 10, SAMPLES, [(len(STREAM), 10, "truncated")]),
    ],
    ids=["shrinks", "shrinks in a frame", "grows", "grows by a part of a frame"],
)
def test_a_file_that_changes_its_size(
    tmp_path: Path, threads: int, resize: int, samples: int, damage: list[Any]
) -> None:
    """It ends where it ends when its end is reached."""
    path = file_of(tmp_path, STREAM)
    reader = reader_of(path, strict=False, quantities=None, strings=0, threads=threads)
    assert reader.advance(len(STREAM) // 3)
    with path.open("r+b") as file:
        if resize < len(STREAM):
            file.truncate(resize)
        else:
            file.seek(0, os.SEEK_END)
            file.write(STREAM[: resize - len(STREAM)])
    while reader.advance(1 << 20):
        pass
    log = xbus.Log(reader.take())
    assert len(log) == samples
    assert log.damage.tolist() == damage
    assert log.stats.bytes == resize


# ---------------------------------------------------------------------------------------------
# Memory that is used up
# ---------------------------------------------------------------------------------------------

LIMITED = """
import resource, sys
import xbus
xbus.read_log(b"").damage  # imports what it needs
data = open(sys.argv[1], "rb").read()
used = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (used + int(sys.argv[2]),) * 2)
try:
    log = xbus.read_log(data, threads=int(sys.argv[3]))
    for name in ("damage", "messages", "gaps", "offset", "time", "bid"):
        getattr(log, name)
    print(len(log))
except MemoryError:
    print("MemoryError")
"""


@pytest.mark.skipif(sys.platform != "linux", reason="the limit is that of Linux")
@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize(
    ("data", "samples"),
    [
        (STREAM, SAMPLES),
        (b"\xfa\xff\x31\x00\xd0" * 1_000_000, 0),
        (b"\xfa\xff\x31\x00\xd0\x00" * 1_000_000, 0),
    ],
    ids=["samples", "messages", "damage"],
)
def test_a_lack_of_memory(tmp_path: Path, data: bytes, samples: int, threads: int) -> None:
    """It raises MemoryError and never ends the process."""
    path = file_of(tmp_path, data)
    results = []
    for limit in (1 << 20, 1 << 30):
        command = [sys.executable, "-c", LIMITED, str(path), str(limit), str(threads)]
        run = subprocess.run(command, capture_output=True, text=True, check=False)  # noqa: S603
        assert (run.returncode, run.stderr) == (0, "")
        results.append(run.stdout.strip())
    assert (results[0], results[-1]) == ("MemoryError", str(samples))


@pytest.mark.skipif(sys.platform != "linux", reason="the limit is that of Linux")
def test_a_lack_of_memory_for_many_small_columns(tmp_path: Path) -> None:
    """There is room for the check, but not for another heap of the second thread.

    malloc then gives each small vector a separate page.
    """
    ids = range(0x9000, 0x9000 + 8000)
    unit = b"".join(streams.mtdata2(streams.packet(data_id, b"\0")) for data_id in ids)
    path = file_of(tmp_path, unit * 100)
    command = [sys.executable, "-c", LIMITED, str(path), str(40 << 20), "2"]
    run = subprocess.run(command, capture_output=True, text=True, check=False)  # noqa: S603
    assert (run.returncode, run.stderr, run.stdout) == (0, "", "MemoryError\n")


TABLE_LIMITED = """
import resource, sys
import pyarrow
import xbus
log = xbus.read_log(sys.argv[1])
stream = log.arrow_stream()
xbus.read_log(b"").to_arrow()  # imports what it needs

def rows_with(limit, work):
    used = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + (limit << 20), -1))
    taken = []
    try:
        while not limit:  # memory that malloc has kept would be enough
            taken.append(bytearray(1 << 20))
    except MemoryError:
        pass
    try:
        return len(work())
    except MemoryError:
        return "MemoryError"
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (-1, -1))

reader = pyarrow.RecordBatchReader.from_stream(stream)
print(*(rows_with(limit, reader.read_next_batch) for limit in (1000, 0, 1000, 1000)))
print(*(rows_with(limit, log.to_arrow) for limit in range(0, 161, 20)))
"""


@pytest.mark.skipif(sys.platform != "linux", reason="the limit is that of Linux")
def test_a_lack_of_memory_for_a_table(tmp_path: Path) -> None:
    """pyarrow asks for the batches of a table. There is no batch that it misses, and the process goes on."""
    pytest.importorskip("pyarrow")
    samples = 10 * SAMPLES
    path = file_of(tmp_path, STREAM * 10)
    command = [sys.executable, "-c", TABLE_LIMITED, str(path)]
    run = subprocess.run(command, capture_output=True, text=True, check=False)  # noqa: S603
    assert (run.returncode, run.stderr) == (0, "")
    batches, tables = map(str.split, run.stdout.splitlines())
    assert (tables[0], tables[-1]) == ("MemoryError", str(samples))
    assert set(tables) == {"MemoryError", str(samples)}
    assert (batches[1], sum(map(int, batches[:1] + batches[2:]))) == ("MemoryError", samples)


FILE_LIMITED = """
import resource, sys
import xbus
log = xbus.read_log(sys.argv[1], threads=1)
log.to_parquet(sys.argv[2])  # starts its threads, which take memory
used = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (used + (300 << 20), -1))
log.to_parquet(sys.argv[2])
"""


@pytest.mark.skipif(sys.platform != "linux", reason="the limit is that of Linux")
def test_memory_for_a_file_with_many_columns(tmp_path: Path) -> None:
    """The columns of a batch share memory, which counts once: a table of 43 MB needs no gigabyte."""
    sizes = {
        0x2010: 16,
        0x2020: 36,
        0x2030: 12,
        0x4020: 12,
        0x4030: 12,
        0x8020: 12,
        0x8030: 16,
        0xC020: 12,
    }
    unit = streams.mtdata2(
        *(streams.packet(data_id, bytes(size)) for data_id, size in sizes.items())
    )
    path = file_of(tmp_path, unit * 300_000)
    command = [sys.executable, "-c", FILE_LIMITED, str(path), str(tmp_path / "log.parquet")]
    run = subprocess.run(command, capture_output=True, text=True, check=False)  # noqa: S603
    assert (run.returncode, run.stderr) == (0, "")
