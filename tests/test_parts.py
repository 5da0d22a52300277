"""`iter_log`: the joined parts of a log equal the log."""

from __future__ import annotations

import concurrent.futures
import contextlib
import gzip
import io
import os
import random
import socket
import subprocess
import sys
import tempfile
import textwrap
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

import reference
import streams
import xbus
from conftest import (
    OWN_CAPTURES,
    counter,
    damaged_streams,
    differences,
    facts,
    facts_of,
    fine,
    read,
    shared,
)
from streams import frame, mtdata2, packet, real

GOOD = mtdata2(counter(1), fine(100), real(0x4020, 1, 2, 3))


class Choppy:
    """A reader that returns any number of bytes, up to the requested number."""

    def __init__(self, data: bytes, most: int) -> None:
        self.file = io.BytesIO(data)
        self.rng = random.Random(most)
        self.most = most

    def read(self, size: int = -1, /) -> bytes:
        return self.file.read(min(size, self.rng.randint(1, self.most)))


# ---------------------------------------------------------------------------------------------
# Joined parts
# ---------------------------------------------------------------------------------------------

BLOCKS = st.sampled_from((1, 7, 100, 4096, 1 << 40))


@given(damaged_streams(30), BLOCKS)
@example(b"", 1)
@example(b"\xfa", 1)
@example(GOOD * 5, 1)
def test_parts_of_bytes(data: bytes, block: int) -> None:
    """Every column, time, counter, offset, message, stretch of damage and count is equal."""
    parts = list(xbus.iter_log(data, block_bytes=block))
    assert differences(facts(*parts), facts_of(reference.decode(data))) == []


@given(damaged_streams(30), BLOCKS, st.sampled_from((1, 3, 64, 5000)))
def test_parts_of_a_stream(data: bytes, block: int, piece: int) -> None:
    """The sizes of the reader's chunks do not matter."""
    parts = list(xbus.iter_log(Choppy(data, piece), block_bytes=block))
    assert differences(facts(*parts), facts_of(reference.decode(data))) == []


@given(damaged_streams(30), BLOCKS)
def test_parts_of_a_file(tmp_path_factory: pytest.TempPathFactory, data: bytes, block: int) -> None:
    path = tmp_path_factory.getbasetemp() / "parts.mtb"
    path.write_bytes(data)
    parts = list(xbus.iter_log(path, block_bytes=block))
    assert differences(facts(*parts), facts_of(reference.decode(data))) == []


@pytest.mark.parametrize("block", [1, 7, 100, 4096, 1 << 40])
@pytest.mark.parametrize("make", [streams.gnssins, streams.dirty, streams.hr])
def test_parts_of_long_streams(make: Callable[[int], bytes], block: int) -> None:
    """Layouts that are already learned continue from part to part."""
    data = make(500)
    parts = list(xbus.iter_log(data, block_bytes=block))
    assert differences(facts(*parts), facts_of(reference.decode(data))) == []


@pytest.mark.parametrize("block", [1000, 300_000, 1 << 20])
def test_parts_larger_than_the_read_buffer(block: int, tmp_path: Path) -> None:
    """The pieces in which a file is read do not end where the parts end."""
    long = frame(0x91, bytes(65_535)) + frame(0x36, packet(0x7000, bytes(255)) * 250)
    data = b"".join(streams.dirty(2000, i) + long * (i % 3) + bytes(i) for i in range(8))
    path = tmp_path / "long.mtb"
    path.write_bytes(data)
    expected = facts(read(data))
    for source in (path, data, Choppy(data, 100_000)):
        parts = list(xbus.iter_log(source, block_bytes=block))
        assert differences(facts(*parts), expected) == []


@pytest.mark.parametrize("name", ["walk.mtb", "field.mtb"])
@pytest.mark.parametrize("block", [1, 7, 1000, 50_000])
def test_parts_of_a_recording(name: str, block: int) -> None:
    path = OWN_CAPTURES / name
    parts = list(xbus.iter_log(path, block_bytes=block))
    assert len(parts) > 1
    assert differences(facts(*parts), facts(xbus.read_log(path))) == []


@pytest.mark.parametrize("number", range(1, 6))
def test_parts_of_a_real_recording(number: int) -> None:
    data = shared(f"captures/mtig710-{number}/raw.bin").read_bytes()
    parts = list(xbus.iter_log(data, block_bytes=99))
    assert differences(facts(*parts), facts_of(reference.decode(data))) == []


# ---------------------------------------------------------------------------------------------
# What a part is
# ---------------------------------------------------------------------------------------------


def test_parts_have_about_the_requested_size() -> None:
    """A part ends with the frame in which the block ends; only the last part is smaller."""
    data = streams.gnssins(500)
    for block in (1, 100, 5000):
        sizes = [item.stats.bytes for item in xbus.iter_log(data, block_bytes=block)]
        assert sum(sizes) == len(data)
        assert all(block <= size < block + 260 for size in sizes[:-1])
        assert sizes[-1] < block + 260


def test_parts_continue_the_numbering() -> None:
    """Samples, offsets, time and counter are those of the whole log."""
    day = reference.DAY
    stamps = [(65534, day - 200), (65535, day - 100), (0, 0), (1, 100), (5, 500)]
    data = b"".join(mtdata2(counter(c), fine(t), real(0x4020, c, 0, 0)) for c, t in stamps)
    parts = list(xbus.iter_log(data, block_bytes=1))[:5]
    assert [part.first_sample for part in parts] == [0, 1, 2, 3, 4]
    assert [part["acceleration"].sample.tolist() for part in parts] == [[0], [1], [2], [3], [4]]
    assert [part.offset.tolist() for part in parts] == [[i * len(data) // 5] for i in range(5)]
    assert [part.packet_counter.tolist() for part in parts] == [
        [65534], [65535], [65536], [65537], [65541],
    ]  # fmt: skip
    assert [part.time[0] * 1e4 for part in parts] == pytest.approx(
        [day - 200, day - 100, day, day + 100, day + 500]
    )
    assert [part["acceleration"].time[0] for part in parts] == [part.time[0] for part in parts]
    assert [(part.stats.gaps, part.stats.lost_samples) for part in parts[-2:]] == [(0, 0), (1, 3)]


def test_times_do_not_depend_on_when_a_part_is_read() -> None:
    """Times are computed from the beginning of the part, not from the reader's current position."""
    data = streams.gnssins(300)
    parts = list(xbus.iter_log(data, block_bytes=3000))
    times = [part.time for part in reversed(parts)]
    assert np.concatenate(times[::-1]).tolist() == xbus.read_log(data).time.tolist()


def test_parts_have_independent_columns() -> None:
    """A column of a part has the precision, type and identifier of this part only."""
    float32, fp1632, ned = real(0x4020, 1, 2, 3), real(0x4022, 4, 5, 6), real(0x2014, 1, 0, 0, 0)
    data = b"".join(mtdata2(item) for item in (float32, fp1632, float32, ned, float32))
    parts = [item for item in xbus.iter_log(data, block_bytes=1) if len(item)]
    accelerations = [part["acceleration"] for part in parts if "acceleration" in part]
    assert [acceleration.precision for acceleration in accelerations] == [
        "Float32",
        "Fp1632",
        "Float32",
        "Float32",
    ]
    assert [acceleration.data_id for acceleration in accelerations] == [
        0x4020,
        0x4022,
        0x4020,
        0x4020,
    ]
    assert [list(part) for part in parts[3:]] == [["quaternion"], ["acceleration"]]
    assert xbus.read_log(data)["acceleration"].precision is None


def test_later_parts_know_the_device() -> None:
    """Identity and clock wrap come from messages in the first part."""
    name = frame(0x01, bytes.fromhex("00000000800040D2")) + frame(0x1D, b"MTi-630".ljust(20))
    firmware = frame(0x13, bytes.fromhex("010802 00000025 00011534"))
    end = 2**32 - 50
    data = name + mtdata2(fine(end)) + mtdata2(fine(50)) + firmware + mtdata2(fine(100))
    parts = list(xbus.iter_log(data, block_bytes=1))
    assert [part.device_id for part in parts] == [0x800040D2] * len(parts)
    assert [part.product_code for part in parts][:2] == [None, "MTi-630"]
    assert {part.product_code for part in parts[1:]} == {"MTi-630"}
    assert str(parts[-1].firmware) == "1.8.2"
    assert parts[2].firmware is None
    times = [time for part in parts for time in part.time * 1e4]
    assert times == pytest.approx([end, 2**32 + 50, 2**32 + 100])
    # Each part has only its own messages.
    assert [len(part.messages) for part in parts][:3] == [1, 1, 0]


def test_parts_do_not_depend_on_later_bytes() -> None:
    """A part does not change when more bytes follow."""
    data = streams.gnssins(100) + streams.dirty(100)
    first = next(iter(xbus.iter_log(data, block_bytes=4000)))
    for more in (b"", frame(0x3E), data[5000:5003] + frame(0x01, bytes.fromhex("03887B6D"))):
        cut = data[: 4000 + 300] + more
        assert (
            differences(facts(next(iter(xbus.iter_log(cut, block_bytes=4000)))), facts(first)) == []
        )


def test_an_empty_input_has_one_part() -> None:
    parts = list(xbus.iter_log(b""))
    assert [len(part) for part in parts] == [0]
    assert parts[0].stats.bytes == 0


@pytest.mark.parametrize("block", [0, -1])
def test_block_bytes_must_be_positive(block: int) -> None:
    """The error is raised by the call, not by the first part."""
    with pytest.raises(ValueError, match=f"block_bytes must be at least 1, not {block}"):
        xbus.iter_log(b"", block_bytes=block)


def test_a_missing_file_raises_immediately(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        xbus.iter_log(tmp_path / "no.mtb")


def test_parts_as_tables() -> None:
    """A table of a part has the numbers of the whole log; the tables of all parts can be joined."""
    pa = pytest.importorskip("pyarrow")
    data = streams.gnssins(120)
    tables = [item.to_arrow() for item in xbus.iter_log(data, block_bytes=3000)]
    assert tables[1]["sample"][0].as_py() == len(tables[0])
    whole: Any = xbus.read_log(data).to_arrow()
    names = [
        column_name for column_name in whole.column_names if not column_name.startswith("gnss")
    ]
    joined = pa.concat_tables(
        [table.select(names) for table in tables], promote_options="permissive"
    )
    assert joined.equals(whole.select(names))


# ---------------------------------------------------------------------------------------------
# Slow inputs
# ---------------------------------------------------------------------------------------------


#: A source, and a file to write what it delivers.
Pair = tuple[Any, Any]


def pipe(files: contextlib.ExitStack, buffering: int) -> Pair:
    ours, theirs = os.pipe()
    source = files.enter_context(os.fdopen(ours, "rb", buffering=buffering))
    return source, files.enter_context(os.fdopen(theirs, "wb", buffering=0))


def sockets(files: contextlib.ExitStack) -> Pair:
    ours, theirs = map(files.enter_context, socket.socketpair())
    source = files.enter_context(ours.makefile("rb"))
    return source, files.enter_context(theirs.makefile("wb", buffering=0))


def named_pipe(files: contextlib.ExitStack, name: str) -> Pair:
    path = Path(files.enter_context(tempfile.TemporaryDirectory()), name)
    os.mkfifo(path)
    # Opened for both, it does not wait for the reader.
    return path, files.enter_context(os.fdopen(os.open(path, os.O_RDWR), "wb", buffering=0))


def compressed_pipe(files: contextlib.ExitStack) -> Pair:
    path, file = named_pipe(files, "log.mtb.gz")
    return path, files.enter_context(gzip.GzipFile(fileobj=file, mode="wb"))


@pytest.mark.skipif(sys.platform != "linux", reason="a named pipe is opened for both")
@pytest.mark.parametrize(
    "pair",
    [
        pytest.param(lambda files: pipe(files, 0), id="unbuffered pipe"),
        pytest.param(lambda files: pipe(files, -1), id="buffered pipe"),
        pytest.param(sockets, id="sockets"),
        pytest.param(lambda files: named_pipe(files, "log.mtb"), id="named pipe"),
        pytest.param(compressed_pipe, id="compressed pipe"),
    ],
)
def test_a_slow_input_delivers_a_part_when_its_bytes_are_there(
    pair: Callable[[contextlib.ExitStack], Pair],
) -> None:
    """The reader waits for nothing that the part does not need, though the input stays open."""
    frames = 1000 // len(GOOD) + 1
    with concurrent.futures.ThreadPoolExecutor() as pool, contextlib.ExitStack() as files:
        source, writer = pair(files)
        parts = xbus.iter_log(source, block_bytes=1000)
        for _ in range(3):
            part = pool.submit(next, parts)
            writer.write(GOOD * frames)
            writer.flush()
            assert part.result(timeout=60).stats.bytes == frames * len(GOOD)


def test_no_more_is_read_than_parts_need() -> None:
    """A block and the rest of a frame, or a few kilobytes at once."""
    data = streams.ahrs(40_000)
    file, asked = io.BytesIO(data), []

    class Source:
        def read(self, size: int = -1, /) -> bytes:
            asked.append(size)
            return file.read(size)

    done = 0
    for part in xbus.iter_log(Source(), block_bytes=100_000):
        done += part.stats.bytes
        assert file.tell() <= done + 4096
    assert done == len(data)
    assert max(asked) <= 100_000
    assert len(asked) <= 2 * len(data) / 100_000 + 2
    del asked[:]
    file.seek(0)
    for _ in xbus.iter_log(Source(), block_bytes=100):
        pass
    assert len(asked) <= len(data) / 4096 + 3


def test_a_class_with_read_alone_is_enough() -> None:
    """`io.BufferedIOBase` defines a ``read1`` that only raises."""

    class Minimal(io.BufferedIOBase):
        def __init__(self) -> None:
            self.file = io.BytesIO(GOOD * 3)

        def read(self, size: int | None = -1, /) -> bytes:
            return self.file.read(size)

    assert len(xbus.read_log(Minimal())) == 3


# ---------------------------------------------------------------------------------------------
# Memory
# ---------------------------------------------------------------------------------------------

MEASURE = """\
    import sys
    import xbus

    def resident(name):
        with open("/proc/self/status") as status:
            return next(int(line.split()[1]) << 10 for line in status if line.startswith(name))

    path, block = sys.argv[1], int(sys.argv[2])
    for part in xbus.iter_log(path, block_bytes=block):  # load everything that is loaded once
        part.time
        break
    del part
    with open("/proc/self/clear_refs", "w") as file:
        file.write("5")  # reset the peak
    before, samples = resident("VmRSS:"), 0
    for part in xbus.iter_log(path, block_bytes=block):
        samples += len(part)
        assert part.time[-1] > 0
    print(samples, resident("VmHWM:") - before)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="measured in /proc")
@pytest.mark.parametrize("block", [4 << 20, 100_000])
def test_memory_is_bounded_by_the_part_size(tmp_path: Path, block: int) -> None:
    """Memory does not grow with the log: here 69 MB."""
    path = tmp_path / "long.mtb"
    piece = streams.ahrs(65_536)
    with path.open("wb") as file:
        for _ in range(12):
            file.write(piece)
    program = [sys.executable, "-c", textwrap.dedent(MEASURE), str(path), str(block)]
    result = subprocess.run(program, check=True, capture_output=True, text=True)  # noqa: S603
    samples, peak = map(int, result.stdout.split())
    assert samples == 12 * 65_536
    # Two parts at a time, each with its times, and the buffer.
    assert peak < 4 * block + (4 << 20), peak
