"""Parts that can be read by themselves: in any process, any order, together the whole log."""

from __future__ import annotations

import gzip
import io
import itertools
import math
import os
import pickle
import platform
import random
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import reference
import streams
import xbus
from conftest import OWN_CAPTURES, damaged_streams, differences, facts, facts_of
from streams import frame, mtdata2, packet
from xbus import XbusError, _core, split_log

MAKERS = [streams.ahrs, streams.gnssins, streams.dirty, streams.hr]


def read_shuffled(parts: list[xbus.LogPart]) -> list[xbus.Log]:
    """Reads copies of the parts in random order, and returns them in order."""
    copies = pickle.loads(pickle.dumps(parts))  # noqa: S301
    order = random.Random(len(parts)).sample(range(len(parts)), len(parts))
    read = {at: copies[at].read() for at in order}
    return [read[at] for at in range(len(parts))]


@given(damaged_streams(30), st.integers(1, 4000))
def test_parts_of_bytes(data: bytes, block: int) -> None:
    parts = split_log(data, block_bytes=block)
    assert differences(facts(*read_shuffled(parts)), facts_of(reference.decode(data))) == []
    assert [part.start for part in parts] == [0, *(part.end for part in parts[:-1])]
    assert parts[-1].end == len(data)


@pytest.mark.parametrize("make", MAKERS)
@pytest.mark.parametrize("block", [7, 1000, 20_000])
def test_parts_of_a_file(make: Callable[[int], bytes], block: int, tmp_path: Path) -> None:
    path = tmp_path / "log.mtb"
    path.write_bytes(make(900))
    parts = split_log(path, block_bytes=block)
    assert len(parts) > 1
    assert differences(facts(*read_shuffled(parts)), facts(xbus.read_log(path))) == []


@pytest.mark.parametrize("name", ["walk.mtb", "field.mtb"])
def test_parts_equal_those_of_iter_log(name: str) -> None:
    """Also host times and identities. Parts of `split_log` have all columns, some without rows."""
    path = OWN_CAPTURES / name
    split = [part.read() for part in split_log(path, block_bytes=5000)]
    parts = list(xbus.iter_log(path, block_bytes=5000))
    for one, other in zip(split, parts, strict=True):
        assert {key: column for key, column in one.items() if len(column)} == dict(other.items())
        assert (one.stats, one.devices) == (other.stats, other.devices)
        assert one.host_time.tobytes() == other.host_time.tobytes()
    assert [part.device_id for part in split] == [part.device_id for part in parts]


def test_host_times_go_on(tmp_path: Path) -> None:
    path = tmp_path / "log.mtb"
    with xbus.connect("sim:MTi-630") as device:
        with device.configure({"sample_time_fine": None, "acceleration": 100}):
            pass
        with device.record(path):
            for _ in range(500):
                device.read_sample()
    whole = xbus.read_log(path)
    assert np.isfinite(whole.host_time).all()
    read = read_shuffled(split_log(path, block_bytes=3000))
    assert len(read) > 3
    assert np.concatenate([part.host_time for part in read]).tolist() == whole.host_time.tolist()


def test_several_devices_and_restarts() -> None:
    frames = []
    for i in range(2000):
        time = packet(0x1060, (i % 1200 * 100).to_bytes(4, "big"))
        frames.append(mtdata2(packet(0x1020, (i % 1200).to_bytes(2, "big")), time, bid=i % 3 + 1))
        frames += [frame(0x3E, bid=1)] if i == 1199 else []
    data = b"".join(frames)
    read = read_shuffled(split_log(data, block_bytes=999))
    assert differences(facts(*read), facts(xbus.read_log(data))) == []


def test_parts_know_their_times() -> None:
    times = [*range(100, 150), *range(150, 200), *range(199, 149, -1)]
    frames = [mtdata2(packet(0x1060, (10_000 * time).to_bytes(4, "big"))) for time in times]
    frames[70] = mtdata2(packet(0x1020, bytes(2)))
    size = len(frames[0]) * 50
    parts = split_log(b"".join(frames), block_bytes=size - 1)
    log = xbus.read_log(b"".join(frames))
    for part in parts:
        time = log.time[part.first_sample : part.first_sample + part.samples]
        assert (part.earliest, part.latest) == (np.nanmin(time), np.nanmax(time))
        assert part.is_ascending == bool((np.diff(time) >= 0).all())
    assert {part.is_ascending for part in parts} == {True, False}
    (part,) = split_log(mtdata2(packet(0x1020, bytes(2))))
    assert (math.isnan(part.earliest), part.is_ascending) == (True, False)


def test_chosen_quantities(tmp_path: Path) -> None:
    path = tmp_path / "log.mtb"
    path.write_bytes(streams.gnssins(500))
    for part in split_log(path, block_bytes=10_000):
        log = part.read(quantities=["acceleration"], threads=2)
        assert list(log) == ["acceleration"]
        assert len(log) == part.samples
        assert part.first_sample <= log["acceleration"].sample[0]


def test_rate_and_strings() -> None:
    data = b"".join(mtdata2(packet(0x1020, i.to_bytes(2, "big"))) for i in range(100))
    data += bytes([0, 0x90, 1, 0, 2, 0, 3, 0, 4, 0])
    read = read_shuffled(split_log(data, block_bytes=50, rate=50, strings=["EM1000"]))
    whole = xbus.read_log(data, rate=50, strings=["EM1000"])
    assert whole.stats.strings == 1
    assert differences(facts(*read), facts(whole)) == []
    assert np.concatenate([part.time for part in read])[-1] == 99 / 50


@pytest.mark.parametrize("suffix", ["", ".gz"])
def test_pieces(tmp_path: Path, suffix: str) -> None:
    data = streams.ahrs(1500)
    cuts = [0, 30_011, 30_500, 90_000, len(data)]
    paths = []
    for number, (start, end) in enumerate(itertools.pairwise(cuts)):
        name = f"night-{number:04}.mtb" if number else "night.mtb"
        paths.append(tmp_path / f"{name}{suffix}")
        piece = data[start:end]
        paths[-1].write_bytes(gzip.compress(piece) if suffix else piece)
    parts = split_log(paths[::-1], block_bytes=20_000)
    assert differences(facts(*read_shuffled(parts)), facts(xbus.read_log(data))) == []


def test_compressed_files(tmp_path: Path) -> None:
    path = tmp_path / "log.mtb.gz"
    path.write_bytes(gzip.compress(streams.dirty(1000)))
    parts = split_log(path, block_bytes=20_000)
    assert differences(facts(*read_shuffled(parts)), facts(xbus.read_log(path))) == []


def test_urls() -> None:
    fsspec = pytest.importorskip("fsspec")
    data = streams.dirty(1000)
    with fsspec.open("memory://split/log.mtb", "wb") as file:
        file.write(data)
    parts = split_log("memory://split/log.mtb", block_bytes=20_000)
    assert len(parts) > 3
    assert differences(facts(*read_shuffled(parts)), facts(xbus.read_log(data))) == []


def test_another_process_reads_a_part(tmp_path: Path) -> None:
    path = tmp_path / "log.mtb"
    path.write_bytes(streams.ahrs(1000))
    part = split_log(path, block_bytes=30_000)[1]
    code = "import pickle, sys; sys.stdout.buffer.write(pickle.dumps(pickle.load(sys.stdin.buffer).read()))"
    out = subprocess.run(  # noqa: S603
        [sys.executable, "-c", code], input=pickle.dumps(part), stdout=subprocess.PIPE, check=True
    ).stdout
    assert pickle.loads(out) == part.read()  # noqa: S301


TOUCHES = """
import resource, sys, threading, xbus
parts = xbus.split_log(sys.argv[1], block_bytes=int(sys.argv[2]))
def read():
    for _ in range(3):
        before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
        for part in parts:
            part.read()
        touched = resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before
    print(touched / len(parts))
if sys.argv[3] == "main":
    read()
else:
    thread = threading.Thread(target=read)
    thread.start()
    thread.join()
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="another malloc")
def test_parts_reuse_memory_unless_malloc_has_settings(tmp_path: Path) -> None:
    path = tmp_path / "log.mtb"
    data = streams.ahrs(50_000)

    def pages_per_part(block: int = 1 << 19, thread: str = "main", **settings: str) -> float:
        program = [sys.executable, "-c", TOUCHES, str(path), str(block), thread]
        environment = {**os.environ, **settings}
        out = subprocess.run(program, env=environment, stdout=subprocess.PIPE, check=True)  # noqa: S603
        return float(out.stdout)

    path.write_bytes(data)
    dask = pages_per_part(MALLOC_TRIM_THRESHOLD_="65536")
    chosen = [
        pages_per_part(MALLOC_TRIM_THRESHOLD_="65537"),
        pages_per_part(MALLOC_MMAP_THRESHOLD_="131072"),
        pages_per_part(MALLOC_TOP_PAD_="0"),
    ]
    assert pages_per_part() < 20
    assert dask < 20
    assert min(chosen) > 60

    # More than a heap of a thread, which has 64 MiB.
    path.write_bytes(24 * data)
    assert pages_per_part(1 << 30, "other") < 200


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes here")
def test_a_file_that_became_a_pipe_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "log.mtb"
    path.write_bytes(streams.ahrs(1000))
    parts = split_log(path, block_bytes=30_000)
    path.unlink()
    os.mkfifo(path)
    with pytest.raises(XbusError, match=r"log\.mtb has changed since it was split; split it again"):
        parts[0].read()


@pytest.mark.parametrize("threads", [1, 2])
def test_a_file_in_a_list_is_regular(threads: int, tmp_path: Path) -> None:
    """To open a pipe would wait for its writer."""
    path = tmp_path / "log.mtb"
    os.mkfifo(path)
    with pytest.raises(OSError, match="not a regular file") as refused:
        _core.Reader([str(path)], limit=1 << 16, strict=False, wanted=None, threads=threads)
    assert refused.value.filename == str(path)


@pytest.mark.parametrize("change", ["longer", "shorter", "touched"])
def test_a_file_that_has_changed_is_refused(change: str, tmp_path: Path) -> None:
    path = tmp_path / "log.mtb"
    data = streams.ahrs(1000)
    path.write_bytes(data)
    parts = split_log(path, block_bytes=30_000)
    if change == "touched":
        os.utime(path, (1, 1))
    else:
        path.write_bytes(data + data if change == "longer" else data[:70_000])
    with pytest.raises(XbusError, match=r"log\.mtb has changed since it was split; split it again"):
        parts[0].read()


def test_bytes_at_a_url_that_have_changed_are_refused() -> None:
    fsspec = pytest.importorskip("fsspec")
    url = "memory://split/changed.mtb"

    def write(data: bytes) -> None:
        with fsspec.open(url, "wb") as file:
            file.write(data)

    write(streams.ahrs(1000))
    parts = split_log(url, block_bytes=30_000)
    write(streams.hr(1000))
    with pytest.raises(XbusError, match="has changed since it was split"):
        parts[1].read()


@pytest.mark.parametrize("data", [b"", b"\xfa", bytes(100)])
def test_inputs_without_samples_have_one_part(data: bytes) -> None:
    (part,) = split_log(data)
    assert part.read() == xbus.read_log(data)


@pytest.mark.parametrize("hole", [bytes(3 << 20), b"\xfa" * (3 << 20), b"$" * (3 << 20)])
def test_parts_do_not_end_in_damage(hole: bytes, tmp_path: Path) -> None:
    path = tmp_path / "log.mtb"
    path.write_bytes(streams.ahrs(2000) + hole + streams.ahrs(2000, seed=2) + hole)
    parts = split_log(path, block_bytes=100_000)
    assert [len(part.read().damage) for part in parts] == [0, 1, 0, 1]
    assert differences(facts(*read_shuffled(parts)), facts(xbus.read_log(path))) == []


@pytest.mark.parametrize("cuts", [(0, 88_000), (0, 30_000, 88_000)])
def test_parts_of_memory_that_is_written_later(cuts: tuple[int, ...]) -> None:
    """They have what was there when it was split, and no other bytes than their own."""
    data = streams.ahrs(1000)
    pieces = [np.frombuffer(data[a:b], np.uint8).copy() for a, b in itertools.pairwise(cuts)]
    parts = split_log(pieces if len(pieces) > 1 else pieces[0], block_bytes=300)
    for piece in pieces:
        piece[:] = 0
    assert differences(facts(*read_shuffled(parts)), facts(xbus.read_log(data))) == []
    last = len(pickle.dumps(parts[-1]))
    assert last < 20_000


def test_large_inputs_are_split_by_several_threads(tmp_path: Path) -> None:
    path = tmp_path / "log.mtb"
    path.write_bytes(streams.ahrs(120_000))
    split = [split_log(path, block_bytes=5 << 20, threads=threads) for threads in (1, 3)]
    assert split[0] == split[1]
    assert sum(part.samples for part in split[0]) == 120_000


@pytest.mark.parametrize(
    ("source", "options", "message"),
    [
        (io.BytesIO(), {}, "a file object can be read only once"),
        ([b"", io.BytesIO()], {}, "a file object can be read only once"),
        (b"", {"block_bytes": 0}, "block_bytes must be at least 1, not 0"),
        (b"", {"threads": 0}, "threads must be at least 1, not 0"),
        (b"", {"bid": 256}, "bid must be from 0 to 255, not 256"),
        (b"", {"bid": -1}, "bid must be from 0 to 255, not -1"),
    ],
)
def test_wrong_calls(source: Any, options: dict[str, Any], message: str) -> None:
    with pytest.raises((TypeError, ValueError), match=message):
        split_log(source, **options)
