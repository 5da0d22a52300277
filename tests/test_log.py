"""`read_log`: the content of a log from any source.

First a comparison with `reference` on intact and damaged streams of everything that can be sent; then, in
tables, the rules one by one.
"""

from __future__ import annotations

import array
import concurrent.futures
import contextlib
import gc
import io
import math
import mmap
import os
import random
import signal
import struct
import subprocess
import sys
import textwrap
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import reference
import streams
import xbus
from conftest import (
    OWN_CAPTURES,
    SEEDS,
    coarse,
    counter,
    damaged_streams,
    differences,
    facts,
    facts_of,
    fine,
    read,
    sound_streams,
    trigger,
)
from reference import DAY
from streams import frame, mtdata2, packet, real

# ---------------------------------------------------------------------------------------------
# The oracle
# ---------------------------------------------------------------------------------------------


def assert_matches_reference(data: bytes, limit: int = 0xFFFF) -> None:
    """The fast path, the plain path and the reference decoder agree bit by bit."""
    expected = facts_of(reference.decode(data, limit))
    assert differences(facts(read(data, limit=limit)), expected) == []
    assert differences(facts(read(data, limit=limit, fast=False)), expected) == []


@given(sound_streams())
def test_sound_streams(data: bytes) -> None:
    assert_matches_reference(data)


@given(damaged_streams())
def test_damaged_streams(data: bytes) -> None:
    assert_matches_reference(data)


@given(damaged_streams(20), st.sampled_from((0, 1, 20, 99, 254, 255, 300, 8185)))
def test_limits(data: bytes, limit: int) -> None:
    """Frames beyond the limit are damage."""
    assert_matches_reference(data, limit)


@given(SEEDS, st.sampled_from((1e-4, 1e-3, 1e-2)))
def test_noise(seed: int, rate: float) -> None:
    """Flipped bits, lost bytes and bursts of garbage everywhere."""
    rng = random.Random(seed)
    data = streams.damage(streams.random_log(rng, 40), rng, flips=rate, drops=rate, bursts=rate)
    assert_matches_reference(data)


@given(st.binary(max_size=300))
def test_random_bytes(data: bytes) -> None:
    assert_matches_reference(data)
    assert_matches_reference(data.replace(b"\0", b"\xfa").replace(b"\1", b"\xff\x36"))


HOSTILE = {
    "nothing": b"",
    "one preamble": b"\xfa",
    "only preambles": streams.only_fa(2000),
    "no preamble": streams.zeros(2000),
    "lengths that lie": streams.lying(2000),
    "claims of 254": streams.claims(2000, 254),
    "claims of 1990": streams.claims(2000, 1990),
    "packets of nothing": frame(0x36, b"\x70\x00\x00" * 80) * 5,
    "long packets of nothing": frame(0x36, b"\x70\x00\x00" * 900) * 3,
    "frames in a frame": frame(0x36, packet(0x7000, frame(0x3E) * 40)) * 3 + b"\0",
    "a frame in a broken frame": b"\xfa\xff\x36\x28" + frame(0x3E) * 8 + b"\0\0",
}


@pytest.mark.parametrize("data", HOSTILE.values(), ids=HOSTILE)
def test_hostile(data: bytes) -> None:
    assert_matches_reference(data)
    sound = streams.gnssins(30)
    assert_matches_reference(sound + data + sound + data)


@pytest.mark.parametrize("make", [streams.ahrs, streams.hr, streams.gnssins, streams.dirty])
def test_streams_of_the_benchmarks(make: Callable[[int], bytes]) -> None:
    assert_matches_reference(make(1500))


# ---------------------------------------------------------------------------------------------
# Layouts: repeated messages take another path than the first of their kind
# ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("count", [*range(1, 6), 255, 256, 257, 258, 259, 260, 511, 514, 770])
@pytest.mark.parametrize("tail", ["", "00", "FA", "FA FF 36", "FA FF 36 4F 00 00 00"])
def test_any_number_of_messages(count: int, tail: str) -> None:
    assert_matches_reference(streams.hr(count) + bytes.fromhex(tail))


INERTIAL = [mtdata2(counter(i), fine(25 * i), real(0x4020, i, -i, 9.81)) for i in range(8)]


@pytest.mark.parametrize("tail", [b"", b"\0", bytes(40)], ids=len)
@pytest.mark.parametrize("gap", [0, 1, 2, 9, 31, 32, 33, 60])
def test_gaps_of_equal_length(gap: int, tail: bytes) -> None:
    """Messages at equal distances with bytes between them, and few bytes after the last."""
    assert_matches_reference(bytes(gap).join(INERTIAL[:2] * 2 + INERTIAL) + tail)


def test_every_bit_of_a_frame() -> None:
    """One flipped bit loses one message, among many equal ones."""
    before, at, after = b"".join(INERTIAL[:4]), INERTIAL[4], b"".join(INERTIAL[5:])
    for bit in range(8 * len(at)):
        flipped = bytearray(at)
        flipped[bit // 8] ^= 1 << bit % 8
        data = before + bytes(flipped) + after
        assert_matches_reference(data)
        # A flipped length or identifier may match the checksum by chance; here it does not.
        assert len(xbus.read_log(data)) == 7


def test_every_byte_of_a_frame_is_lost() -> None:
    for at in range(len(INERTIAL[4])):
        lacking = INERTIAL[4][:at] + INERTIAL[4][at + 1 :]
        assert_matches_reference(b"".join([*INERTIAL[:4], lacking, *INERTIAL[5:]]))


def test_layouts_of_equal_length() -> None:
    """The same identifiers in other orders, other identifiers of the same size."""
    kinds = [0x2010, 0x4020, 0x8020, 0xC020, 0xE020, 0x1060]
    rng = random.Random(5)
    frames = []
    for _ in range(400):
        rng.shuffle(kinds)
        frames.append(mtdata2(*(streams.random_packet(rng, kind) for kind in kinds)))
    assert_matches_reference(b"".join(frames))


@pytest.mark.parametrize("count", [7, 8, 9, 31, 32, 33, 254, 255, 256, 300])
def test_many_layouts(count: int) -> None:
    """More layouts than the reader remembers."""
    kinds = [mtdata2(packet(0x7000 + (i << 4), bytes([i % 256])), fine(i)) for i in range(count)]
    one_by_one = b"".join(kind * 4 for kind in kinds)
    in_turn = b"".join(kinds) * 4
    assert_matches_reference(one_by_one + in_turn)


@pytest.mark.parametrize("count", [2, 4, 255])
def test_a_wrong_satellite_count_is_unknown(count: int) -> None:
    """A GnssSatInfo whose count does not match its size is kept as an unknown packet."""
    sound = packet(0x7020, bytes([0, 0, 0, 1, 3, 0, 0, 0]) + bytes(12))
    lying = packet(0x7020, bytes([0, 0, 0, 1, count, 0, 0, 0]) + bytes(12))
    data = mtdata2(sound) * 5 + mtdata2(lying) + mtdata2(sound) * 5
    log = xbus.read_log(data)
    assert [item[4] for item in log.unknown[0x7020]] == [count]
    assert log["gnss_sat_info"].sample.tolist() == [0, 1, 2, 3, 4, 6, 7, 8, 9, 10]
    assert_matches_reference(data)


@pytest.mark.parametrize("bid", [0, 1, 2, 31, 32, 0xFE, 0xFF])
def test_layouts_of_every_bus_identifier(bid: int) -> None:
    own = mtdata2(counter(1), fine(25), bid=bid)
    assert_matches_reference(own * 5 + INERTIAL[0] * 5 + own * 5)


@pytest.mark.parametrize(
    ("before", "after"),
    [
        (0x4020, 0x4022),  # Float32, Fp1632
        (0x4022, 0x4020),
        (0x4020, 0x4021),  # of the same size
        (0x4021, 0x4023),
        (0x2010, 0x2014),  # ENU, NED
        (0x2010, 0x2016),
        (0x3010, 0x3013),  # U4 all the same
        (0x1020, 0x1021),
        (0xE080, 0xE080),  # four bytes, eight bytes
        (0x7020, 0x7020),
    ],
)
@pytest.mark.parametrize("count", [1, 3, 63, 64, 65, 66, 300])
def test_output_changes_within_a_log(before: int, after: int, count: int) -> None:
    """The device changes its output and changes it back, after a short and after a long time."""
    rng = random.Random(count)

    def some(data_id: int, of: int, later: bool) -> bytes:
        base, head = data_id & 0xFFF0, b""
        if base == 0xE080:
            size = 8 if later else 4
        elif base == 0x7020:
            satellites = 12 if later else 3
            head, size = bytes([0, 0, 0, 1, satellites, 0, 0, 0]), 4 * satellites
        elif base in reference.REALS:
            size = reference.REALS[base][1] * reference.WIDTHS[data_id & 3]
        else:
            size = 2 if base == 0x1020 else 4
        return b"".join(mtdata2(packet(data_id, head + rng.randbytes(size))) for _ in range(of))

    data = some(before, 5, False) + some(after, count, True) + some(before, 5, False)
    assert_matches_reference(data)
    assert_matches_reference(data + some(after, 70, True) + data)


# ---------------------------------------------------------------------------------------------
# Sources
# ---------------------------------------------------------------------------------------------


class OneByte:
    """A reader that never returns more than one byte."""

    def __init__(self, data: bytes) -> None:
        self.file = io.BytesIO(data)

    def read(self, size: int = -1, /) -> bytes:
        assert size > 0, "asked for everything at once"
        return self.file.read(1)


class AnyPath:
    """A path of another library."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __fspath__(self) -> str:
        return str(self.path)


DATA = (OWN_CAPTURES / "field.mtb").read_bytes()[:20_000]


def strided() -> np.ndarray[Any, np.dtype[np.uint8]]:
    wide = np.zeros((len(DATA), 3), np.uint8)
    wide[:, 1] = np.frombuffer(DATA, np.uint8)
    return wide[:, 1]


def in_memory() -> str:
    fsspec = pytest.importorskip("fsspec")
    fsspec.filesystem("memory").pipe("/xbus/field.mtb", DATA)
    return "memory://xbus/field.mtb"


def pipe(files: contextlib.ExitStack) -> io.BufferedReader:
    """A pipe with the beginning of the data; a pipe has no length and is not seekable."""
    out, into = os.pipe()
    os.write(into, DATA)
    os.close(into)
    return files.enter_context(os.fdopen(out, "rb"))


SOURCES: dict[str, Callable[[Path, contextlib.ExitStack], Any]] = {
    "str": lambda path, _: str(path),
    "Path": lambda path, _: path,
    "os.PathLike": lambda path, _: AnyPath(path),
    "bytes": lambda *_: DATA,
    "bytearray": lambda *_: bytearray(DATA),
    "memoryview": lambda *_: memoryview(DATA),
    "memoryview of shorts": lambda *_: memoryview(array.array("H", DATA)),
    "memoryview of doubles": lambda *_: memoryview(array.array("d", DATA)),
    "memoryview in two dimensions": lambda *_: memoryview(DATA).cast("B", (100, 200)),
    "memoryview with steps": lambda *_: memoryview(bytes(item for item in DATA for _ in "12"))[::2],
    "memoryview backwards": lambda *_: memoryview(DATA[::-1])[::-1],
    "array.array": lambda *_: array.array("I", DATA),
    "uint8 array": lambda *_: np.frombuffer(DATA, np.uint8),
    "uint8 array with steps": lambda *_: strided(),
    "uint8 array backwards": lambda *_: np.frombuffer(DATA[::-1], np.uint8)[::-1],
    "np.memmap": lambda path, _: np.memmap(path, np.uint8, mode="r"),
    "mmap": lambda path, files: files.enter_context(
        mmap.mmap(files.enter_context(path.open("rb")).fileno(), 0, access=mmap.ACCESS_READ)
    ),
    "file": lambda path, files: files.enter_context(path.open("rb")),
    "unbuffered file": lambda path, files: files.enter_context(path.open("rb", buffering=0)),
    "BytesIO": lambda *_: io.BytesIO(DATA),
    "one byte at a time": lambda *_: OneByte(DATA),
    "pipe": lambda _, files: pipe(files),
    "fsspec URL": lambda *_: in_memory(),
    "fsspec file URL": lambda path, _: pytest.importorskip("fsspec") and path.as_uri(),
}


@pytest.fixture
def files() -> Iterator[contextlib.ExitStack]:
    with contextlib.ExitStack() as stack:
        yield stack


@pytest.mark.parametrize("source", SOURCES.values(), ids=SOURCES)
def test_sources(
    source: Callable[[Path, contextlib.ExitStack], Any],
    tmp_path: Path,
    files: contextlib.ExitStack,
) -> None:
    """The same bytes give the same log from every source."""
    path = tmp_path / "field.mtb"
    path.write_bytes(DATA)
    expected = facts_of(reference.decode(DATA))
    assert differences(facts(xbus.read_log(source(path, files))), expected) == []
    parts = list(xbus.iter_log(source(path, files), block_bytes=1000))
    assert len(parts) > 10
    assert differences(facts(*parts), expected) == []
    gc.collect()  # unclosed files would warn here


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes here")
def test_named_pipe(tmp_path: Path) -> None:
    """The pipe is opened once, because the writer exits with the first reader."""
    path = tmp_path / "pipe"
    os.mkfifo(path)
    with concurrent.futures.ThreadPoolExecutor() as pool:
        writer = pool.submit(path.write_bytes, DATA)
        log = xbus.read_log(path)
        assert writer.result() == len(DATA)
    assert differences(facts(log), facts_of(reference.decode(DATA))) == []


INTERRUPTED = """
import sys, xbus
try:
    print("ready", flush=True)
    xbus.read_log(sys.argv[1])
except KeyboardInterrupt:
    print("interrupted")
"""


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs mkfifo and /proc")
@pytest.mark.parametrize("has_writer", [False, True])
def test_ctrl_c_ends_the_wait_for_a_named_pipe(tmp_path: Path, has_writer: bool) -> None:
    """The wait can end before a writer opens the pipe, and while the writer sends nothing."""
    path = tmp_path / "pipe"
    os.mkfifo(path)
    command = [sys.executable, "-c", INTERRUPTED, str(path)]
    with (
        subprocess.Popen(command, stdout=subprocess.PIPE, bufsize=0) as process,  # noqa: S603
        contextlib.ExitStack() as files,
    ):
        assert process.stdout is not None
        assert process.stdout.readline() == b"ready\n"
        if has_writer:
            files.enter_context(path.open("wb"))  # returns when the reader has opened the pipe
        while Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()[0] != "S":
            pass
        process.send_signal(signal.SIGINT)
        assert process.communicate(timeout=30)[0] == b"interrupted\n"


def test_files_are_read_from_their_position() -> None:
    """The file is read from its position to its end."""
    file = io.BytesIO(b"a title\n" + DATA)
    file.readline()
    log = xbus.read_log(file)
    assert log.stats.bytes == len(DATA)
    assert differences(facts(log), facts_of(reference.decode(DATA))) == []
    assert not file.closed
    assert file.read() == b""


def test_empty_arrays() -> None:
    for empty in (b"", bytearray(), memoryview(b""), np.empty(0, np.uint8), io.BytesIO()):
        log = xbus.read_log(empty)
        assert (len(log), list(log), log.stats.bytes) == (0, [], 0)


def test_the_source_is_released() -> None:
    """Columns do not refer to the source, so its buffer can be reused immediately."""
    data = bytearray(DATA)
    log = xbus.read_log(data)
    expected = facts_of(reference.decode(DATA))
    data[:] = bytes(len(data))
    data += b"more"
    assert differences(facts(log), expected) == []


def test_read_only_arrays() -> None:
    data = np.frombuffer(DATA, np.uint8)
    assert not data.flags.writeable
    assert len(xbus.read_log(data)) == len(xbus.read_log(DATA))


def test_threads() -> None:
    """Many threads read at once, and use lazily computed attributes of one log at once."""
    data = streams.gnssins(500)
    expected = facts(read(data))
    log = xbus.read_log(data)
    with concurrent.futures.ThreadPoolExecutor(8) as pool:
        logs = list(pool.map(xbus.read_log, [data] * 16))
        times = list(pool.map(lambda _: log.time.tolist(), range(16)))
    assert all(differences(facts(log), expected) == [] for log in logs)
    assert times == [expected["time"].tolist()] * 16


def test_long_input(tmp_path: Path) -> None:
    """Files are read in pieces; short and long frames cross their boundaries."""
    rng = random.Random(3)
    long = frame(0x91, rng.randbytes(65_535)) + frame(0x36, packet(0x7000, bytes(255)) * 250)
    data = b"".join(streams.dirty(3000, i) + long * (i % 3) + bytes(i) for i in range(8))
    assert len(data) > 2_500_000
    path = tmp_path / "long.mtb"
    path.write_bytes(data)
    expected = facts(read(data, fast=False))
    assert expected["stats"]["samples"] > 15_000
    assert differences(facts(xbus.read_log(data)), expected) == []
    assert differences(facts(xbus.read_log(path)), expected) == []
    assert differences(facts(xbus.read_log(io.BytesIO(data))), expected) == []


# ---------------------------------------------------------------------------------------------
# quantities=
# ---------------------------------------------------------------------------------------------

MIXED = b"".join(
    mtdata2(
        counter(i),
        fine(100 * i),
        real(0x2010, 1, 0, 0, i),
        real(0x2014, 0, 1, 0, i),
        real(0x4020, 1, 2, i),
        packet(0x7000, b"?"),
        packet(0x7020, bytes(8)) if i == 2 else real(0x0810, 20),
    )
    for i in range(5)
)


@pytest.mark.parametrize(
    ("quantities", "keys"),
    [
        (None, ["packet_counter", "sample_time_fine", "quaternion ENU", "quaternion NED",
                "acceleration", "temperature", "gnss_sat_info"]),
        ([], []),
        (["acceleration"], ["acceleration"]),
        (("temperature", "acceleration"), ["acceleration", "temperature"]),
        ({"quaternion"}, ["quaternion ENU", "quaternion NED"]),
        ([("quaternion", "NED")], ["quaternion"]),
        ([("quaternion", xbus.Coordinates.NED)], ["quaternion"]),
        ([0x2014, xbus.DataId.Temperature], ["quaternion", "temperature"]),
        ([("quaternion", "NWU")], []),
        ([("quaternion", "NED"), "quaternion"], ["quaternion ENU", "quaternion NED"]),
        (["acceleration", "acceleration"], ["acceleration"]),
        (["packet_counter"], ["packet_counter"]),
        (["status_word"], []),
        (iter(["temperature"]), ["temperature"]),
    ],
)  # fmt: skip
def test_quantities(quantities: Any, keys: list[str]) -> None:
    """Only the selected quantities, in the order of the log; everything else is unchanged."""
    log = xbus.read_log(MIXED, quantities=quantities)
    assert [item if isinstance(item, str) else " ".join(item) for item in log] == keys
    whole, part = facts(xbus.read_log(MIXED)), facts(log)
    assert len(part) == len([item for item in part if item in whole])
    assert differences(part, {item: whole[item] for item in part}) == []
    assert {item for item in whole if not item.startswith(("(", "satellites"))} <= set(part)


def test_quantities_of_parts() -> None:
    parts = list(
        xbus.iter_log(MIXED, block_bytes=1, quantities=["temperature", ("quaternion", "NED")])
    )
    assert [list(part) for part in parts[:2]] == [["quaternion", "temperature"]] * 2
    assert len(parts[2]["quaternion"]) == 1
    assert "temperature" not in parts[2]


@pytest.mark.parametrize(
    ("quantities", "error", "text"),
    [
        (["accelleration"], ValueError, "no quantity is called 'accelleration'; did you"),
        ([("quaternion", "UFO")], ValueError, "a format is a coordinate system (ENU, NED, NWU)"),
        ("acceleration", TypeError, "must be a list of keys, such as ['acceleration']"),
        ([1], ValueError, "no quantity has the data identifier 0x0001"),
        ([1.5], TypeError, "a key is a name, a DataId, or a tuple"),
        ([["quaternion", "NED"]], TypeError, "a key is a name, a DataId, or a tuple"),
        ([("quaternion", "NED", "Float32")], ValueError, "all precisions of a quantity are one column"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("reader", [xbus.read_log, xbus.iter_log])
def test_unknown_quantities_are_rejected(
    reader: Callable[..., Any], quantities: Any, error: type[Exception], text: str
) -> None:
    """The error is raised immediately, whatever the log contains."""
    with pytest.raises(error) as caught:
        reader(b"", quantities=quantities)
    assert text in str(caught.value)


# ---------------------------------------------------------------------------------------------
# strict=True
# ---------------------------------------------------------------------------------------------

GOOD = mtdata2(counter(1), fine(100))
ODD_SIZE = mtdata2(fine(1), packet(0x4020, bytes(9)))
N = len(GOOD)


@pytest.mark.parametrize(
    ("data", "offset", "data_id", "text"),
    [
        (GOOD + b"\0" + GOOD, N, None, f"no frame at byte {N} (no preamble)"),
        (b"\0" + GOOD, 0, None, "no frame at byte 0 (no preamble)"),
        (GOOD + GOOD[:-1], N, None, f"no frame at byte {N} (truncated)"),
        (GOOD + GOOD[:-1] + b"\0", N, None, f"no frame at byte {N} (checksum)"),
        (GOOD + frame(0xB2) + b"\0", N, None, f"no frame at byte {N} (implausible)"),
        (GOOD + mtdata2() + GOOD, N, None, f"MTData2 at byte {N}: its packets do not fill"),
        (GOOD + frame(0x36, b"\x40") + GOOD, N, None, f"MTData2 at byte {N}"),
        (GOOD + frame(0x36, b"\x40\x20") + GOOD, N, 0x4020, "packet 0x4020 runs past the end"),
        (GOOD + frame(0x36, b"\x40\x20\x0c") + GOOD, N, 0x4020, "packet 0x4020 runs past the end"),
        (GOOD + ODD_SIZE + GOOD, N, 0x4020, "packet 0x4020 with 9 bytes"),
    ],
)  # fmt: skip
def test_strict(data: bytes, offset: int, data_id: int | None, text: str) -> None:
    """The first fault is raised, with its kind, offset and length."""
    with pytest.raises(xbus.DecodeError) as caught:
        xbus.read_log(data, strict=True)
    assert (caught.value.offset, caught.value.data_id) == (offset, data_id)
    assert text in str(caught.value)
    assert isinstance(caught.value, ValueError)
    # Without `strict` the same bytes are data.
    log = xbus.read_log(data)
    assert log.damage.tolist() or log.stats.malformed or log.unknown


def test_strict_in_parts() -> None:
    """The samples before the fault are returned first."""
    parts = xbus.iter_log(GOOD * 3 + b"\0" + GOOD, block_bytes=10_000, strict=True)
    assert len(next(parts)) == 3
    with pytest.raises(xbus.DecodeError):
        next(parts)
    assert list(parts) == []


def test_strict_accepts_undamaged_input() -> None:
    """Unknown packets are not damage."""
    data = GOOD + frame(0xB2, b"?") + mtdata2(packet(0x7770, b"?")) + frame(0x3E, bid=77) + GOOD
    assert len(xbus.read_log(data, strict=True)) == 3
    assert len(xbus.read_log(b"", strict=True)) == 0


# ---------------------------------------------------------------------------------------------
# Columns
# ---------------------------------------------------------------------------------------------


def type_of(values: np.ndarray[Any, Any]) -> str:
    """``"f4"``, whatever the machine's byte order."""
    return str(values.dtype.str).lstrip("<>|")


def read_column(*packets: bytes) -> xbus.Column:
    """Returns the only column of a log with one packet in each message."""
    log = xbus.read_log(b"".join(mtdata2(item) for item in packets))
    assert len(list(log)) == 1
    return log[next(iter(log))]


@pytest.mark.parametrize(
    ("data_id", "dtype", "precision"),
    [
        (0x4020, "f4", "Float32"),
        (0x4021, "f8", "Fp1220"),
        (0x4022, "f8", "Fp1632"),
        (0x4023, "f8", "Float64"),
    ],
)
def test_vectors(data_id: int, dtype: str, precision: str) -> None:
    column = read_column(real(data_id, 0.5, -0.25, 9.75), real(data_id, 1, 2, 3))
    assert column.values.tolist() == [[0.5, -0.25, 9.75], [1, 2, 3]]
    assert (type_of(column.values), column.values.shape) == (dtype, (2, 3))
    assert column.values.flags.c_contiguous
    assert not column.values.flags.writeable
    assert (column.name, column.unit, column.fields) == ("acceleration", "m/s2", ("x", "y", "z"))
    assert (column.precision, column.coordinates, column.data_id) == (precision, None, data_id)
    assert (column.sample.tolist(), type_of(column.sample), len(column)) == ([0, 1], "i8", 2)
    assert (type_of(column.time), column.time.shape) == ("f8", (2,))


@pytest.mark.parametrize(
    ("data_id", "name", "unit", "fields"),
    [
        (0x0810, "temperature", "degC", ()),
        (0x2010, "quaternion", "", ("q0", "q1", "q2", "q3")),
        (0x2030, "euler_angles", "deg", ("roll", "pitch", "yaw")),
        (0x4010, "delta_v", "m/s", ("x", "y", "z")),
        (0x4020, "acceleration", "m/s2", ("x", "y", "z")),
        (0x4030, "free_acceleration", "m/s2", ("x", "y", "z")),
        (0x4040, "acceleration_hr", "m/s2", ("x", "y", "z")),
        (0x5020, "altitude_ellipsoid", "m", ()),
        (0x5030, "position_ecef", "m", ("x", "y", "z")),
        (0x5040, "lat_lon", "deg", ("lat", "lon")),
        (0x8020, "rate_of_turn", "rad/s", ("x", "y", "z")),
        (0x8030, "delta_q", "", ("q0", "q1", "q2", "q3")),
        (0x8040, "rate_of_turn_hr", "rad/s", ("x", "y", "z")),
        (0xC020, "magnetic_field", "a.u.", ("x", "y", "z")),
        (0xD010, "velocity_xyz", "m/s", ("x", "y", "z")),
    ],
)
def test_reals(data_id: int, name: str, unit: str, fields: tuple[str, ...]) -> None:
    """Table 16 and section 5.3.6: names, units and the order of the numbers."""
    numbers = [float(i) for i in range(len(fields) or 1)]
    column = read_column(real(data_id, *numbers))
    assert (column.name, column.unit, column.fields) == (name, unit, fields)
    assert column.values.tolist() == ([numbers] if fields else numbers)


@pytest.mark.parametrize(
    ("data_id", "name", "dtype", "unit"),
    [
        (0x1020, "packet_counter", "u2", ""),
        (0x1060, "sample_time_fine", "u4", "0.1 ms"),
        (0x1070, "sample_time_coarse", "u4", "s"),
        (0x1090, "packet_counter8", "u1", ""),
        (0x10A0, "sample_time64", "u8", ""),
        (0x3010, "baro_pressure", "u4", "Pa"),
        (0x7030, "gnss_pvt_pulse", "u4", "0.1 ms"),
        (0xE010, "status_byte", "u1", ""),
        (0xE020, "status_word", "u4", ""),
        (0xE040, "rssi", "i1", "dBm"),
        (0xE090, "location_id", "u2", ""),
    ],
)
@pytest.mark.parametrize("format_bits", [0, 3, 0xF])
def test_integers(data_id: int, name: str, dtype: str, unit: str, format_bits: int) -> None:
    """Integers keep their width, and format bits are ignored: real devices send 0x3013."""
    size = int(dtype[1])
    raw = bytes(range(0x81, 0x81 + size))
    column = read_column(packet(data_id | format_bits, raw), packet(data_id | format_bits, raw))
    assert column.values.tolist() == [int.from_bytes(raw, "big", signed=dtype[0] == "i")] * 2
    assert (type_of(column.values), column.values.shape) == (dtype, (2,))
    assert (column.name, column.unit, column.fields) == (name, unit, ())
    assert (column.precision, column.coordinates, column.data_id) == (
        None,
        None,
        data_id | format_bits,
    )


def test_integers_with_different_format_bits_share_a_column() -> None:
    column = read_column(packet(0x3010, b"\0\1\x86\xa0"), packet(0x3013, b"\0\1\x86\xa1"))
    assert (column.values.tolist(), column.data_id) == ([100_000, 100_001], 0x3010)


def test_rotation_matrix() -> None:
    """Column by column on the wire; ``values[k, i, j]`` is row i, column j."""
    column = read_column(real(0x2020, 11, 21, 31, 12, 22, 32, 13, 23, 33))
    assert column.values.tolist() == [[[11, 12, 13], [21, 22, 23], [31, 32, 33]]]
    assert (type_of(column.values), column.values.shape) == ("f4", (1, 3, 3))
    assert column.fields == ("m11", "m12", "m13", "m21", "m22", "m23", "m31", "m32", "m33")
    assert dict(zip(column.fields, column.values[0].reshape(-1), strict=True))["m32"] == 32
    assert column.coordinates == "ENU"


def test_rotation_matrix_matches_the_quaternion() -> None:
    """The matrix rotates the sensor's axes to the local frame, as the quaternion does."""
    rng = np.random.default_rng(9)
    q = rng.standard_normal((50, 4))
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    q0, q1, q2, q3 = q.T
    m11, m21, m31 = q0**2 + q1**2 - q2**2 - q3**2, 2 * (q1 * q2 + q0 * q3), 2 * (q1 * q3 - q0 * q2)
    m12, m22, m32 = 2 * (q1 * q2 - q0 * q3), q0**2 - q1**2 + q2**2 - q3**2, 2 * (q2 * q3 + q0 * q1)
    m13, m23, m33 = 2 * (q1 * q3 + q0 * q2), 2 * (q2 * q3 - q0 * q1), q0**2 - q1**2 - q2**2 + q3**2
    wire = np.stack([m11, m21, m31, m12, m22, m32, m13, m23, m33]).T
    both = zip(q.tolist(), wire.tolist(), strict=True)
    log = xbus.read_log(b"".join(mtdata2(real(0x2013, *a), real(0x2023, *b)) for a, b in both))
    a, b = log["quaternion"].values, log["rotation_matrix"].values
    v = rng.standard_normal(3)
    rotated = v + 2 * np.cross(a[:, 1:], np.cross(a[:, 1:], v) + a[:, :1] * v)
    assert np.abs(b @ v - rotated).max() < 1e-12


MIXTURES = [
    # identifiers, dtype, precision, data_id
    ([0x4020, 0x4020], "f4", "Float32", 0x4020),
    ([0x4020, 0x4022], "f8", None, 0x4020),
    ([0x4022, 0x4020], "f8", None, 0x4020),
    ([0x4021, 0x4022, 0x4023], "f8", None, 0x4020),
    ([0x4023, 0x4023], "f8", "Float64", 0x4023),
    ([0x4022, 0x402A], "f8", "Fp1632", 0x4020),  # coordinate bits mean nothing here
    ([0x4024, 0x4024], "f4", "Float32", 0x4024),
]


@pytest.mark.parametrize(("ids", "dtype", "precision", "data_id"), MIXTURES)
@pytest.mark.parametrize("times", [1, 3, 200])
def test_mixed_precisions(
    ids: list[int], dtype: str, precision: str | None, data_id: int, times: int
) -> None:
    """One quantity in two precisions is one column, widened to float64."""
    third = float(np.float32(1 / 3))
    column = read_column(*(real(i, third, -0.5, 2) for i in ids for _ in range(times)))
    assert column.values.dtype == dtype
    assert (column.precision, column.data_id, column.coordinates) == (precision, data_id, None)
    assert np.abs(column.values - [third, -0.5, 2]).max() < 2**-20
    exact = [row for row, i in enumerate(ids) if i & 3 in (0, 3)]
    for row in exact:
        assert column.values[row * times].tolist() == [third, -0.5, 2]


def test_mixed_device_identifiers() -> None:
    """Four bytes of the 10- and 100-series, eight of the later ones."""
    four, eight = packet(0xE080, bytes.fromhex("03700001")), packet(0xE080, b"\0\0\0\0\x80\0\0\1")
    assert (type_of(read_column(four).values), type_of(read_column(eight).values)) == ("u4", "u8")
    for both, expected in ((four, eight), [1, 0]), ((eight, four), [0, 1]):
        column = read_column(*both)
        assert column.values.dtype == "u8"
        assert column.values[expected].tolist() == [0x80000001, 0x03700001]


def test_two_coordinate_systems() -> None:
    """Each system has a column; the bare name is rejected with an error that names the alternatives."""
    log = xbus.read_log(MIXED)
    assert ("quaternion", "ENU") in list(log)
    assert ("quaternion", "NED") in list(log)
    assert "quaternion" not in list(log)
    assert "quaternion" not in log
    assert log.get("quaternion") is None
    assert ("quaternion", "NED") in log
    assert ("quaternion", "NWU") not in log
    with pytest.raises(KeyError) as caught:
        log["quaternion"]
    assert caught.value.args[0] == (
        "'quaternion' is in this log in several coordinate systems: "
        "log['quaternion', 'ENU'] or log['quaternion', 'NED']"
    )
    enu, ned = log["quaternion", "ENU"], log["quaternion", "NED"]
    assert (enu.coordinates, ned.coordinates) == ("ENU", "NED")
    assert (enu.data_id, ned.data_id) == (0x2010, 0x2014)
    assert (enu.values[0].tolist(), ned.values[0].tolist()) == ([1, 0, 0, 0], [0, 1, 0, 0])
    for key in log.keys():  # noqa: SIM118 - they are the same
        assert len(log[key]) > 0
    assert list(log.keys()) == list(log)


@pytest.mark.parametrize(
    ("data_id", "coordinates"),
    [(0x2010, "ENU"), (0x2014, "NED"), (0x2018, "NWU"), (0xD016, "NED"), (0x4030, None), (0x4034, None)],
)  # fmt: skip
def test_coordinates(data_id: int, coordinates: str | None) -> None:
    """Coordinates are defined only for orientations and velocities (Table 17, note 11)."""
    column = read_column(real(data_id, *range(reference.REALS[data_id & 0xFFF0][1])))
    assert (column.coordinates, column.data_id) == (coordinates, data_id)


@pytest.mark.parametrize(
    ("key", "text"),
    [
        ("accelleration", "no 'accelleration' in this log; did you mean 'acceleration'?"),
        ("gnss_pvt_data", "no 'gnss_pvt_data' in this log; it has 'acceleration'"),
        (("quaternion", "NED"), "no ('quaternion', 'NED') in this log; it has 'acceleration'"),
    ],
)
def test_what_is_not_there(key: Any, text: str) -> None:
    log = xbus.read_log(mtdata2(real(0x4020, 1, 2, 3)))
    with pytest.raises(KeyError) as caught:
        log[key]
    assert caught.value.args[0] == text


def test_empty_log() -> None:
    with pytest.raises(KeyError) as caught:
        xbus.read_log(b"")["acceleration"]
    assert caught.value.args[0] == "no 'acceleration' in this log; it has no quantities"


def test_special_numbers_are_preserved() -> None:
    """Every received bit is preserved."""
    for raw in ("7FC00001", "7F800001", "FFC12345", "7F800000", "FF800000", "80000000", "00000001"):
        column = read_column(packet(0x0810, bytes.fromhex(raw)))
        assert column.values.view("u4")[0] == int(raw, 16)
    for raw in ("7FF8000000000001", "7FF0000000000001", "FFF0000000000000", "8000000000000000"):
        column = read_column(packet(0x0813, bytes.fromhex(raw)))
        assert column.values.view("u8")[0] == int(raw, 16)


@pytest.mark.parametrize(
    ("data_id", "raw", "value"),
    [
        (0x0811, "80 00 00 00", -2048.0),
        (0x0811, "7F FF FF FF", 2048 - 2**-20),
        (0x0811, "FF FF FF FF", -(2**-20)),
        (0x0812, "60 00 00 00 00 18", 24.375),
        (0x0812, "00 00 00 00 80 00", -32768.0),
        (0x0812, "FF FF FF FF 7F FF", 32768 - 2**-32),
        (0x0812, "FF FF FF FF FF FF", -(2**-32)),
        (0x0812, "00 00 00 01 00 01", 1 + 2**-32),
    ],
)
def test_fixed_point(data_id: int, raw: str, value: float) -> None:
    """Both are exact in a double. Fp1632 sends its fraction before its integer."""
    assert read_column(packet(data_id, bytes.fromhex(raw))).values.tolist() == [value]


def test_duplicates() -> None:
    """A packet twice in one message is two rows with the same sample; nothing is dropped."""
    twice = mtdata2(real(0x4020, 1, 2, 3), counter(1), real(0x4020, 4, 5, 6), fine(10))
    log = xbus.read_log(GOOD + twice * 5 + GOOD)
    column = log["acceleration"]
    assert column.sample.tolist() == [1, 1, 2, 2, 3, 3, 4, 4, 5, 5]
    assert column.values[:2].tolist() == [[1, 2, 3], [4, 5, 6]]
    assert column.time.tolist() == [0.001] * 10


# ---------------------------------------------------------------------------------------------
# Structs, lists, dates and bits
# ---------------------------------------------------------------------------------------------

# fmt: off
PVT_VALUES = {
    "itow": 49662250, "year": 2019, "month": 1, "day": 20, "hour": 13, "min": 47, "sec": 24,
    "valid": 0x37, "tAcc": 5, "nano": -249768484, "fixtype": 3, "flags": 1, "numSV": 11,
    "Reserved1": 0, "lon": 118825704, "lat": -576794453, "height": 81777, "hMSL": 43306,
    "hAcc": 2259, "vAcc": 2072, "velN": -27, "velE": 10, "velD": -2, "gSpeed": 29, "headMot": 0,
    "sAcc": 350, "headAcc": 0xFFFFFFFF, "headVeh": 131072, "gdop": 154, "pdop": 139, "tdop": 68,
    "vdop": 112, "hdop": 83, "ndop": 55, "edop": 62,
}
# fmt: on


def test_gnss_pvt_data() -> None:
    """Table 25: raw integers under the manual's names, and the same in units."""
    column = read_column(
        packet(0x7010, struct.pack(">IHBBBBBBIiBBBBiiiiIIiiiiiIIiHHHHHHH", *PVT_VALUES.values()))
    )
    assert column.values.dtype.names == column.fields == tuple(PVT_VALUES)
    assert column.values[0].tolist() == tuple(PVT_VALUES.values())
    assert column.values.dtype.itemsize == 94
    assert (column.precision, column.unit, column.data_id, column.values.shape) == (
        None,
        "",
        0x7010,
        (1,),
    )
    scaled = column.scaled[0]
    assert scaled.dtype.names == column.fields
    # fmt: off
    expected = {
        "itow": (49662.25, "s"), "tAcc": (5e-9, "s"), "nano": (-0.249768484, "s"),
        "lon": (11.8825704, "deg"), "lat": (-57.6794453, "deg"),
        "height": (81.777, "m"), "hMSL": (43.306, "m"), "hAcc": (2.259, "m"), "vAcc": (2.072, "m"),
        "velN": (-0.027, "m/s"), "velE": (0.01, "m/s"), "velD": (-0.002, "m/s"),
        "gSpeed": (0.029, "m/s"), "headMot": (0.0, "deg"), "sAcc": (0.35, "m/s"),
        "headVeh": (1.31072, "deg"), "gdop": (1.54, ""), "pdop": (1.39, ""), "tdop": (0.68, ""),
        "vdop": (1.12, ""), "hdop": (0.83, ""), "ndop": (0.55, ""), "edop": (0.62, ""),
    }
    # fmt: on
    assert {name: (scaled[name], column.units[name]) for name in expected} == expected
    assert column.units["headAcc"] == "deg"
    assert math.isnan(scaled["headAcc"])  # not provided by the receiver
    for name in ("year", "month", "valid", "fixtype", "flags", "numSV", "Reserved1"):
        assert (scaled[name], column.units[name]) == (PVT_VALUES[name], "")
        assert column.scaled.dtype[name] == column.values.dtype[name]


@pytest.mark.parametrize("accuracy", ["tAcc", "hAcc", "vAcc", "sAcc", "headAcc"])
def test_missing_accuracies_are_nan(accuracy: str) -> None:
    """An accuracy of all ones is missing; in other fields all ones are a number."""
    ones = read_column(packet(0x7010, b"\xff" * 94))
    assert math.isnan(ones.scaled[accuracy][0])
    missing = [
        name for name, value in zip(ones.fields, ones.scaled[0], strict=True) if value != value
    ]
    assert missing == ["tAcc", "hAcc", "vAcc", "sAcc", "headAcc"]
    assert ones.scaled["velN"][0] == -0.001


STRUCTS = {
    0x1010: ("utc_time", "IHBBBBBB", "ns year month day hour minute second valid"),
    0x4810: ("trigger_in1", "BBIH", "line polarity timestamp frame"),
    0x4820: ("trigger_in2", "BBIH", "line polarity timestamp frame"),
    0xA010: ("raw_acc_gyr_mag_temp", "9Hh", "accX accY accZ gyrX gyrY gyrZ magX magY magZ Temp"),
}


@pytest.mark.parametrize(("data_id", "row"), STRUCTS.items())
def test_structs(data_id: int, row: tuple[str, str, str]) -> None:
    name, layout, fields = row
    values = tuple(range(1, 1 + len(fields.split())))
    column = read_column(packet(data_id, struct.pack(">" + layout, *values)))
    assert (column.name, column.fields) == (name, tuple(fields.split()))
    assert column.values[0].tolist() == values
    assert column.values.dtype.names == column.fields
    assert column.values.dtype.itemsize == struct.calcsize(">" + layout)


def test_raw_temperature_is_signed() -> None:
    """1/256 of a degree Celsius, below zero too."""
    column = read_column(packet(0xA010, struct.pack(">9Hh", *[0xFFFF] * 9, -320)))
    assert column.values[0].tolist() == (*[0xFFFF] * 9, -320)
    assert column.scaled["Temp"][0] == -1.25


def sat_info(*satellites: tuple[int, int, int, int], itow: int = 1000) -> bytes:
    head = struct.pack(">IBBBB", itow, len(satellites), 1, 2, 3)
    return packet(0x7020, head + b"".join(map(bytes, satellites)))


def test_gnss_sat_info() -> None:
    """Table 26: one row for each message, and one row for each of its satellites."""
    a, b, c = (0, 5, 22, 0x14), (1, 120, 0, 1), (6, 24, 39, 16)
    column = read_column(sat_info(a, b), sat_info(itow=1250), sat_info(c, itow=1500))
    assert column.values.dtype.names == column.fields == ("itow", "numSvs", "res1", "res2", "res3")
    assert column.values.tolist() == [(1000, 2, 1, 2, 3), (1250, 0, 1, 2, 3), (1500, 1, 1, 2, 3)]
    assert column.satellites.dtype.names == ("gnssId", "svId", "cno", "flags")
    assert column.satellites.tolist() == [a, b, c]
    assert (column.offsets.tolist(), type_of(column.offsets)) == ([0, 2, 2, 3], "i8")
    of = [
        column.satellites[start:end].tolist()
        for start, end in zip(column.offsets, column.offsets[1:], strict=False)
    ]
    assert of == [[a, b], [], [c]]
    assert column.scaled["itow"].tolist() == [1.0, 1.25, 1.5]


@pytest.mark.parametrize("count", [1, 28, 61])
def test_gnss_sat_info_of_any_size(count: int) -> None:
    satellites = [(i % 7, i, 40, 7) for i in range(count)]
    column = read_column(*[sat_info(*satellites)] * 5, *[sat_info(*satellites[:1])] * 5)
    assert column.satellites.tolist() == satellites * 5 + satellites[:1] * 5
    assert column.offsets.tolist() == [i * count for i in range(6)] + [
        5 * count + i for i in range(1, 6)
    ]


@pytest.mark.parametrize(
    ("ns", "date", "expected"),
    [
        (749227324, (2025, 7, 13, 9, 21, 34), "2025-07-13T09:21:34.749227324"),
        (0, (1970, 1, 1, 0, 0, 0), "1970-01-01T00:00:00.000000000"),
        (999_999_999, (2099, 12, 31, 23, 59, 59), "2099-12-31T23:59:59.999999999"),
        (0, (2024, 2, 29, 0, 0, 0), "2024-02-29T00:00:00.000000000"),
        (0, (2016, 12, 31, 23, 59, 60), "2017-01-01T00:00:00.000000000"),  # a leap second
        (0, (2025, 2, 29, 0, 0, 0), "NaT"),
        (0, (2025, 4, 31, 0, 0, 0), "NaT"),
        (0, (2025, 0, 1, 0, 0, 0), "NaT"),
        (0, (2025, 13, 1, 0, 0, 0), "NaT"),
        (0, (2025, 1, 0, 0, 0, 0), "NaT"),
        (0, (2025, 1, 1, 24, 0, 0), "NaT"),
        (0, (2025, 1, 1, 0, 60, 0), "NaT"),
        (0, (2025, 1, 1, 0, 0, 61), "NaT"),
        (0, (0, 0, 0, 0, 0, 0), "NaT"),
        (0, (1600, 1, 1, 0, 0, 0), "NaT"),  # outside the range of 64 bits of nanoseconds
        (0, (65535, 1, 1, 0, 0, 0), "NaT"),
        (0xFFFFFFFF, (2025, 1, 1, 0, 0, 0), "NaT"),
    ],
)
def test_utc_time(ns: int, date: tuple[int, ...], expected: str) -> None:
    """The layout is that of Table 35; an invalid date is NaT."""
    column = read_column(packet(0x1010, struct.pack(">IHBBBBBB", ns, *date, 7)))
    assert column.datetime.dtype == "datetime64[ns]"
    assert str(column.datetime[0]) == expected
    assert column.values[0].tolist() == (ns, *date, 7)


WORD = 0b0000_1001_1000_0100_0010_0000_0001_0111


def test_flags() -> None:
    """Flags have the names of Table 27, and of the vendor's code for the remaining bits."""
    flags = read_column(packet(0xE020, WORD.to_bytes(4, "big")), packet(0xE020, bytes(4))).flags
    assert {name for name in flags if flags[name][0]} == {
        *("selftest", "filter_valid", "gnss_fix", "no_rotation_update_status"),
        *("clip_gyr_z", "retransmitted", "filter_mode", "rtk_status"),
    }
    assert flags["filter_mode"].tolist() == [3, 0]
    assert flags["rtk_status"].tolist() == [1, 0]
    assert flags["no_rotation_update_status"].tolist() == [2, 0]
    assert (type_of(flags["filter_mode"]), type_of(flags["gnss_fix"])) == ("u1", "b1")
    assert not any(flags[name][1] for name in flags)
    assert "gnss_fix" in flags
    assert "no such flag" not in flags


# fmt: off
BITS = {
    "selftest": 0, "filter_valid": 1, "gnss_fix": 2, "no_rotation_update_status": 3,
    "representative_motion": 5, "clock_bias_estimation": 6, "filter_input_start": 7,
    "clip_acc_x": 8, "clip_acc_y": 9, "clip_acc_z": 10, "clip_gyr_x": 11, "clip_gyr_y": 12,
    "clip_gyr_z": 13, "clip_mag_x": 14, "clip_mag_y": 15, "clip_mag_z": 16, "retransmitted": 18,
    "clipping": 19, "interpolated": 20, "sync_in_marker": 21, "sync_out_marker": 22,
    "filter_mode": 23, "have_gnss_time_pulse": 26, "rtk_status": 27,
}
# fmt: on


@pytest.mark.parametrize(("name", "bit"), BITS.items())
def test_each_flag(name: str, bit: int) -> None:
    flags = read_column(packet(0xE020, (1 << bit).to_bytes(4, "big"))).flags
    assert [flag for flag in flags if flags[flag][0]] == [name]
    assert list(flags) == list(BITS)


def test_flags_of_status_byte() -> None:
    flags = read_column(packet(0xE010, b"\x06")).flags
    assert list(flags) == list(BITS)[:7]
    assert (flags["filter_valid"].tolist(), flags["selftest"].tolist()) == ([True], [False])


@pytest.mark.parametrize("name", ["flags", "datetime", "satellites", "offsets"])
def test_missing_column_attributes_raise(name: str) -> None:
    column = read_column(real(0x4020, 1, 2, 3))
    with pytest.raises(AttributeError, match="acceleration has no"):
        getattr(column, name)
    assert not hasattr(column, name)
    assert column.scaled is column.values


# ---------------------------------------------------------------------------------------------
# Messages, unknown packets, damage
# ---------------------------------------------------------------------------------------------


def test_messages() -> None:
    """All other messages, in order, verbatim, with the index of the next sample."""
    data = frame(0x3E) + GOOD + frame(0x42, b"\x29", bid=2) + frame(0xB2, b"?") + GOOD + frame(0x36)
    log = xbus.read_log(data)
    assert list(log.messages) == [
        xbus.Message(0x3E, "WakeUp", 0xFF, b"", 0, 0),
        xbus.Message(0x42, "Error", 2, b"\x29", 5 + N, 1),
        xbus.Message(0xB2, "0xB2", 0xFF, b"?", 11 + N, 1),
        xbus.Message(0x36, "MTData2", 0xFF, b"", 17 + 2 * N, 2),
    ]
    assert log.messages[-1].mid == 0x36
    assert [message.name for message in log.messages[1:3]] == ["Error", "0xB2"]
    assert log.messages.named("WakeUp", "Error") == [log.messages[0], log.messages[1]]
    with pytest.raises(IndexError):
        log.messages[4]
    assert log.stats == xbus.Stats(
        bytes=len(data), frames=6, samples=2, messages=4, malformed=1, unfit=0, strings=0,
        skipped_bytes=0, checksum_errors=0, lost_samples=0, gaps=0,
    )  # fmt: skip
    assert repr(log.messages).startswith("<Messages 4: ")


def test_message_names_depend_on_the_payload_length() -> None:
    """One MID is the reply to a request and to a setting: the length of the payload decides."""
    frames = [(0x19, b""), (0x19, b"\x02"), (0x19, b"\x02"), (0x65, b"General"), (0x08, b"")]
    log = xbus.read_log(b"".join(xbus.encode_frame(*item) for item in frames))
    assert repr(log.messages) == (
        "<Messages 5: SetBaudrateAck: 1, ReqBaudrateAck: 2, ReqFilterProfileAckModern: 1, 0x08: 1>"
    )
    assert repr(xbus.read_log(b"").messages) == "<Messages 0>"


@pytest.mark.parametrize(
    ("mid", "size", "name"),
    [
        (0x19, 1, "ReqBaudrateAck"),
        (0x19, 0, "SetBaudrateAck"),
        (0xC1, 8, "SetOutputConfigurationAck"),
        (0x0D, 118, "Configuration"),
        (0x77, 2, "ReqGnssPlatformAck"),
        (0x9D, 3, "0x9D"),
    ],
)
def test_names_of_messages(mid: int, size: int, name: str) -> None:
    """Replies to a request and to a setting share a MID; the name depends on the payload if possible."""
    message = xbus.read_log(GOOD + frame(mid, bytes(size)) + GOOD).messages[0]
    assert (message.mid, len(message.payload)) == (mid, size)
    if mid != 0xC1:
        assert message.name == name


def test_unknown() -> None:
    """Packets of unknown identifiers and sizes, verbatim, by identifier as received."""
    odd = mtdata2(packet(0x7772, b"abc"), packet(0x4020, b"short"), packet(0x7772, b""), fine(5))
    log = xbus.read_log(GOOD + odd + GOOD + mtdata2(packet(0x7772, b"z")) + GOOD)
    assert list(log.unknown) == [0x7772, 0x4020]
    strange = log.unknown[0x7772]
    assert (len(strange), list(strange), strange[-1]) == (3, [b"abc", b"", b"z"], b"z")
    assert (strange.sample.tolist(), type_of(strange.sample)) == ([1, 1, 3], "i8")
    assert strange[:2] == [b"abc", b""]
    assert list(log.unknown[0x4020]) == [b"short"]
    assert list(log) == ["packet_counter", "sample_time_fine"]
    assert log.stats.skipped_bytes == 0
    with pytest.raises(IndexError):
        strange[3]


def test_stamps_of_wrong_size_are_ignored() -> None:
    log = xbus.read_log(GOOD + mtdata2(packet(0x1060, b"\0\0\1"), packet(0x1020, bytes(4))) + GOOD)
    assert math.isnan(log.time[1])
    assert log.packet_counter.tolist() == [1, -1, 1]


def test_damage() -> None:
    """A structured array: where, how long, and what was wrong where the next frame was due."""
    data = b"\0\0" + GOOD + GOOD[:-1] + b"\x77" + GOOD + b"\xfa\xff"
    log = xbus.read_log(data)
    assert log.damage.dtype.names == ("offset", "length", "reason")
    assert log.damage.tolist() == [
        (0, 2, "no preamble"),
        (2 + N, N, "checksum"),
        (2 + 3 * N, 2, "truncated"),
    ]
    assert log.offset.tolist() == [2, 2 + 2 * N]
    assert (log.stats.skipped_bytes, log.stats.checksum_errors) == (4 + N, 1)
    assert xbus.read_log(GOOD).damage.tolist() == []
    long = read(GOOD + frame(0x91, bytes(300)) + frame(0xB2) + b"\0", limit=299)
    assert long.damage.tolist() == [(N, 307 + 5 + 1, "too long")]
    assert xbus.read_log(frame(0xB2) + b"\0").damage.tolist() == [(0, 6, "implausible")]


def test_samples() -> None:
    """Every array has one item for each MTData2 message."""
    other = mtdata2(fine(7), bid=3)
    log = xbus.read_log(GOOD + other + frame(0x3E) + GOOD)
    assert log.offset.tolist() == [0, N, N + len(other) + 5]
    types = [type_of(item) for item in (log.offset, log.time, log.packet_counter, log.bid)]
    assert types == ["i8", "f8", "i8", "u1"]
    assert log.bid.tolist() == [0xFF, 3, 0xFF]
    assert len(log) == 3


# ---------------------------------------------------------------------------------------------
# Time
# ---------------------------------------------------------------------------------------------

ALL_BITS = 2**32
MTI_300 = frame(0x01, bytes.fromhex("037003F8"))
MTI_G_710 = frame(0x1D, b"MTi-G-710-2A5G4".ljust(20))
MTI_3 = frame(0x01, bytes.fromhex("03887B6D"))
MTI_630 = frame(0x01, bytes.fromhex("00000000800040D2"))
MTI_680G = frame(0x1D, b"MTi-680G-8A1G6".ljust(20))
EXCHANGED = frame(0x01, bytes.fromhex("800040D200000000"))
UNHEARD_OF = frame(0x01, bytes.fromhex("0B400001"))
GNSS = packet(0x7020, bytes(8))
PVT = packet(0x7010, bytes(94))


def ticks(*frames: bytes) -> list[float]:
    """The times of samples, in ticks of SampleTimeFine: 0.1 ms."""
    return [round(item * 1e4, 3) for item in xbus.read_log(b"".join(frames)).time.tolist()]


def at(*values: int, bid: int = 0xFF) -> bytes:
    """Samples with these SampleTimeFine."""
    return b"".join(mtdata2(fine(value), bid=bid) for value in values)


UNWRAPPING: dict[str, tuple[list[bytes], list[float]]] = {
    # what: messages, ticks
    "starts anywhere": ([at(51_703_123, 51_703_148)], [51_703_123, 51_703_148]),
    # Known device.
    "MTi-300 wraps after a day": ([MTI_300, at(DAY - 25, 0, 25)], [DAY - 25, DAY, DAY + 25]),
    "MTi-G-710 too": ([MTI_G_710, at(DAY - 25, 0)], [DAY - 25, DAY]),
    "MTi-630 does not": ([MTI_630, at(DAY - 25, DAY, DAY + 25)], [DAY - 25, DAY, DAY + 25]),
    "MTi-630 back to 0 is a step back": ([MTI_630, at(DAY - 25, 0)], [DAY - 25, 0]),
    "MTi-630 wraps at 2^32": ([MTI_630, at(ALL_BITS - 25, 0, 25)], [ALL_BITS - 25, ALL_BITS, ALL_BITS + 25]),
    "MTi-680G wraps at 2^32": ([MTI_680G, at(ALL_BITS - 1, 0)], [ALL_BITS - 1, ALL_BITS]),
    "MTi-3 wraps at 2^32": ([MTI_3, at(ALL_BITS - 1, 0)], [ALL_BITS - 1, ALL_BITS]),
    "MTi-3 back to 0 is a step back": ([MTI_3, at(DAY - 25, 0)], [DAY - 25, 0]),
    "halves exchanged, still no 100-series": ([EXCHANGED, at(DAY - 25, 0)], [DAY - 25, 0]),
    "wraps twice": (
        [MTI_300, at(DAY - 1, DAY // 2 - 1, DAY - 1, 5)],
        [DAY - 1, DAY + DAY // 2 - 1, 2 * DAY - 1, 2 * DAY + 5],
    ),
    "named too late": ([at(DAY - 25, 0), MTI_630], [DAY - 25, DAY]),
    "named on the way": ([at(DAY - 50), MTI_630, at(DAY - 25, 0)], [DAY - 50, DAY - 25, 0]),
    "the last name counts": ([MTI_630, MTI_300, at(DAY - 25, 0)], [DAY - 25, DAY]),
    "an unknown family selects no wrap": ([MTI_300, UNHEARD_OF, at(DAY - 25, 0)], [DAY - 25, DAY]),
    # Unknown device: the value before the step back decides.
    "after a day": ([at(DAY - 25, 0, 25)], [DAY - 25, DAY, DAY + 25]),
    "at 2^32": ([at(ALL_BITS - 25, 0)], [ALL_BITS - 25, ALL_BITS]),
    "beyond a day it is 2^32": ([at(3 * 10**9, 0)], [3 * 10**9, ALL_BITS]),
    "a small step back is a step back": ([at(1000, 900, 1025)], [1000, 900, 1025]),
    "far ahead is ahead": ([at(0, ALL_BITS - 1)], [0, ALL_BITS - 1]),
    # Late samples.
    "late around the wrap": ([MTI_300, at(DAY - 25, 0, DAY - 50, 25)], [DAY - 25, DAY, DAY - 50, DAY + 25]),
    "never below zero": ([MTI_300, at(100, DAY - 100)], [100, DAY - 100]),
    # GNSS samples do not move the clock.
    "GNSS late": ([at(1000), mtdata2(GNSS, fine(550)), at(1025)], [1000, 550, 1025]),
    "GNSS late around the wrap": (
        [MTI_300, at(DAY - 25, 25), mtdata2(fine(DAY - 400), PVT), at(50)],
        [DAY - 25, DAY + 25, DAY - 400, DAY + 50],
    ),
    "GNSS without a fix has an arbitrary time": (
        [at(1000), mtdata2(GNSS, fine(3 * 10**9)), at(1025)],
        [1000, 3 * 10**9, 1025],
    ),
    "GNSS first": ([mtdata2(PVT, fine(DAY - 5)), at(3)], [DAY - 5, 3]),
    # TriggerIn: microseconds of the same clock.
    "TriggerIn between": (
        [at(2_906_348), mtdata2(trigger(290_637_743)), at(2_906_373)],
        [2_906_348, 2_906_377.43, 2_906_373],
    ),
    "TriggerIn has wrapped more often": (
        [at(ALL_BITS // 100 - 10), mtdata2(trigger(4)), at(ALL_BITS // 100)],
        [ALL_BITS // 100 - 10, 42_949_673.0, ALL_BITS // 100],
    ),
    "TriggerIn first": ([mtdata2(trigger(123)), at(10)], [1.23, 10]),
    "TriggerIn beside a stamp": ([mtdata2(trigger(123), fine(55))], [55]),
    "two TriggerIn in one message": (
        [mtdata2(trigger(100), trigger(200, 0x4820)), mtdata2(trigger(300)), mtdata2(trigger(400, 0x4820))],
        [2, 3, 4],
    ),
    # SampleTimeCoarse.
    "coarse and fine": ([mtdata2(coarse(5174), fine(51_747_668))], [51_747_668]),
    "coarse knows of days before": (
        [mtdata2(coarse((2 * DAY + 12_345) // 10_000), fine(12_345)), at(12_370)],
        [2 * DAY + 12_345, 2 * DAY + 12_370],
    ),
    "coarse that does not belong moves nothing": (
        [at(1000), mtdata2(coarse(77), fine(1025)), at(1050)],
        [1000, 771_025, 1050],
    ),
    "coarse behind fine belongs to no wrap": (
        [mtdata2(coarse(0), fine(DAY + 5)), at(DAY + 30)],
        [5, DAY + 30],
    ),
    "coarse alone": ([at(1000), mtdata2(coarse(77)), at(1025)], [1000, 770_000, 1025]),
    "coarse beside GNSS": ([at(1000), mtdata2(coarse(86_400), fine(0), GNSS), at(1025)], [1000, DAY, 1025]),
    "coarse starts again with fine": (
        [MTI_300, mtdata2(coarse(86_399), fine(DAY - 25)), mtdata2(coarse(0), fine(0))],
        [DAY - 25, DAY],
    ),
    # Devices on a bus.
    "FF and 1 are one device": ([at(DAY - 25), at(0, bid=1), at(25)], [DAY - 25, DAY, DAY + 25]),
    "2 is another": (
        [at(DAY - 25), at(7, bid=2), at(0), at(9, bid=2)],
        [DAY - 25, 7, DAY, 9],
    ),
    "each has its own name": (
        [MTI_300, frame(0x01, bytes.fromhex("03887B6D"), bid=2), at(DAY - 1, bid=2), at(0, bid=2)],
        [DAY - 1, 0],
    ),
    # Two stamps.
    "the last of two counts": ([mtdata2(fine(5), fine(9))], [9]),
    # A restart does not reset the clock.
    "WakeUp": ([at(DAY - 25), frame(0x3E), at(0)], [DAY - 25, DAY]),
}  # fmt: skip


@pytest.mark.parametrize(("frames", "expected"), UNWRAPPING.values(), ids=UNWRAPPING)
def test_unwrapping(frames: list[bytes], expected: list[float]) -> None:
    """Section 5.3.6: SampleTimeFine wraps after a day, or at 2^32."""
    assert ticks(*frames) == expected
    assert_matches_reference(b"".join(frames))


@pytest.mark.parametrize(
    ("name", "modulus"),
    [
        ("MTi-1-2A8G4", ALL_BITS),
        ("MTi-8", ALL_BITS),
        ("MTi-20", DAY),
        ("MTi-30-2A5G4", DAY),
        ("MTi-300-2A5G4", DAY),
        ("MTi-28A53G35", DAY),
        ("MTi-320-8A1G6", ALL_BITS),
        ("MTi-330", ALL_BITS),
        ("MTi-G-700-2A5G4", DAY),
        ("MTi-G-710-2A5G4", DAY),
        ("MTi-630R", ALL_BITS),
        ("MTi-680G-8A1G6", ALL_BITS),
        ("MTi-700", None),
        ("MTi-", None),
        ("Avior-OEM", ALL_BITS),
        ("Sirius-AHRS", ALL_BITS),
        ("MTw2-3A7G6", None),
        ("", None),
    ],
)
def test_products(name: str, modulus: int | None) -> None:
    """The clock wraps as specified for each product. A late sample shows whether the wrap is known."""
    code = frame(0x1D, name.encode().ljust(20))
    expected = {
        DAY: [DAY - 25, DAY, DAY - 50],
        ALL_BITS: [DAY - 25, 0, DAY - 50],
        None: [DAY - 25, DAY, 2 * DAY - 50],
    }
    assert ticks(code, at(DAY - 25, 0, DAY - 50)) == expected[modulus]


def test_duration_and_rate() -> None:
    """Both use the first and the last stamp; with fewer than two stamps there is neither."""
    log = xbus.read_log(at(1000, 1100, 1200) + mtdata2(real(0x4040, 1, 2, 3)))
    assert log.duration == pytest.approx(0.02)
    assert log["sample_time_fine"].rate == pytest.approx(100)
    assert math.isnan(log["acceleration_hr"].rate)
    for few in (b"", at(1000), mtdata2(counter(1)) * 3):
        assert math.isnan(xbus.read_log(few).duration)
    assert math.isnan(xbus.read_log(at(1000, 1000))["sample_time_fine"].rate)


def test_gnss_samples_do_not_extend_the_duration() -> None:
    """Without a fix the GNSS time is arbitrary; it is used only if no other sample has a time."""
    pvt = packet(0x7010, bytes(94))
    receiver = mtdata2(counter(1), fine(3_000_000_000), pvt) + mtdata2(
        counter(2), fine(3_000_002_500), pvt
    )
    log = xbus.read_log(at(1000, 1100) + receiver + at(1200))
    assert log.time.max() > 10_000
    assert log.duration == pytest.approx(0.02)
    assert xbus.read_log(receiver).duration == pytest.approx(0.25)


def test_no_stamp() -> None:
    """A high-rate sample without any stamp has no time."""
    log = xbus.read_log(at(5) + mtdata2(real(0x4040, 1, 2, 3)) + at(6))
    assert log.time.tolist()[::2] == [0.0005, 0.0006]
    assert math.isnan(log["acceleration_hr"].time[0])


def test_gnss_pvt_pulse_is_a_plain_number() -> None:
    """The pulse uses the same clock, but does not give its sample a time."""
    log = xbus.read_log(mtdata2(packet(0x7030, (2**31).to_bytes(4, "big")), fine(20)))
    assert log.time.tolist() == [0.002]
    assert log["gnss_pvt_pulse"].unit == "0.1 ms"


# ---------------------------------------------------------------------------------------------
# Counter
# ---------------------------------------------------------------------------------------------


def counts(*values: int, bid: int = 0xFF) -> bytes:
    """Samples with these PacketCounter."""
    return b"".join(mtdata2(counter(value), bid=bid) for value in values)


COUNTING: dict[str, tuple[list[bytes], list[int], int, int]] = {
    # what: messages, counter, gaps, lost samples
    "one by one": ([counts(5, 6, 7)], [5, 6, 7], 0, 0),
    "wraps": ([counts(65534, 65535, 0, 1)], [65534, 65535, 65536, 65537], 0, 0),
    "two lost": ([counts(5, 8, 9)], [5, 8, 9], 1, 2),
    "lost twice, once around the wrap": ([counts(65534, 1, 3)], [65534, 65537, 65539], 2, 3),
    "an older sample": ([counts(5, 4, 5, 5, 6)], [5, 4, 5, 5, 6], 0, 0),
    "nearly half ahead": ([counts(0, 32767)], [0, 32767], 1, 32766),
    "just half is back": ([counts(40000, 7232)], [40000, 7232], 0, 0),
    "never below zero": ([counts(5, 65530)], [5, 65530], 1, 65524),
    "a message without one": ([counts(5), mtdata2(trigger(1)), counts(6)], [5, -1, 6], 0, 0),
    "the last of two counts": ([mtdata2(counter(9), counter(5)), counts(6)], [5, 6], 0, 0),
    "GotoMeasurement": ([counts(5), frame(0x11), counts(100, 102)], [5, 100, 102], 1, 1),
    "Reset": ([counts(5), frame(0x41), counts(100)], [5, 100], 0, 0),
    "WakeUp": ([counts(5), frame(0x3E), counts(100)], [5, 100], 0, 0),
    "GoToConfig restarts nothing": ([counts(5), frame(0x31), counts(100)], [5, 100], 1, 94),
    "WakeUp of another device": ([counts(5), frame(0x3E, bid=2), counts(100)], [5, 100], 1, 94),
    "FF and 1 are one device": ([counts(5), counts(6, bid=1), counts(8)], [5, 6, 8], 1, 1),
    "2 is another": ([counts(5), counts(9, bid=2), counts(6), counts(10, bid=2)], [5, 9, 6, 10], 0, 0),
}  # fmt: skip


@pytest.mark.parametrize(("frames", "expected", "gaps", "lost"), COUNTING.values(), ids=COUNTING)
def test_counting(frames: list[bytes], expected: list[int], gaps: int, lost: int) -> None:
    """PacketCounter is unwrapped, and skipped values are lost samples."""
    log = xbus.read_log(b"".join(frames))
    assert log.packet_counter.tolist() == expected
    assert (log.stats.gaps, log.stats.lost_samples) == (gaps, lost)
    assert_matches_reference(b"".join(frames))


#: A sample with a counter, or one of the messages with which a run starts; from one of three devices.
COUNTED = st.tuples(
    st.sampled_from([0xFF, 1, 2, 3]),
    st.one_of(
        *[st.integers(0, 12) | st.integers(65_530, 65_535)] * 3,
        st.sampled_from([("restart", 0x11), ("restart", 0x41), ("restart", 0x3E)]),
        st.just(("uncounted", 0x36)),
    ),
)


@given(st.lists(COUNTED, max_size=60), st.integers(1, 300))
def test_gaps_and_restarts(sent: list[tuple[int, Any]], block: int) -> None:
    """A gap is where the unwrapped counter of a device skips values within a run."""
    frames, gaps, restarts = [], [], []
    is_sample = [not (isinstance(what, tuple) and what[0] == "restart") for _, what in sent]
    for bid, what in sent:
        if isinstance(what, int):
            frames.append(mtdata2(counter(what), bid=bid))
        elif what[0] == "restart":
            frames.append(frame(what[1], bid=bid))
        else:
            frames.append(mtdata2(fine(5), bid=bid))
    data = b"".join(frames)
    log = xbus.read_log(data)
    last: dict[int, int] = {}
    begun: set[int] = set()
    awaited: set[int] = set()
    sent_before: set[int] = set()
    index = 0
    for (bid, what), sample in zip(sent, is_sample, strict=True):
        device = 1 if bid == 0xFF else bid
        if not sample:
            begun.add(device)
            awaited.add(device)
            continue
        if device in awaited and device in sent_before:
            restarts.append((index, bid))
        awaited.discard(device)
        sent_before.add(device)
        if isinstance(what, int):
            count = int(log.packet_counter[index])
            assert count % 65_536 == what
            lost = count - last.get(device, count) - 1
            if lost > 0 and device not in begun:
                gaps.append((index, lost, bid))
            last[device] = count
            begun.discard(device)
        index += 1
    assert log.gaps.tolist() == gaps
    assert (len(log.gaps), log.gaps["lost"].sum()) == (log.stats.gaps, log.stats.lost_samples)
    starts = log._core.restarts
    assert list(zip(starts.sample.tolist(), starts.bid.tolist(), strict=True)) == restarts
    parts = list(xbus.iter_log(data, block_bytes=block))
    np.testing.assert_array_equal(np.concatenate([part.gaps for part in parts]), log.gaps)
    joined = np.concatenate([part._core.restarts.sample for part in parts])
    np.testing.assert_array_equal(joined, starts.sample)
    with pytest.raises(ValueError, match="read-only"):
        log.gaps["lost"] = 0


# ---------------------------------------------------------------------------------------------
# The device
# ---------------------------------------------------------------------------------------------


def configuration(head: str, code: bytes = b"") -> bytes:
    """Tables 13 and 14."""
    payload = bytearray(118)
    payload[:8] = bytes.fromhex(head)
    payload[16:32] = b"2026112209295950"
    payload[32 : 32 + len(code)] = code
    payload[96:98] = b"\0\1"
    payload[98:106] = payload[:8]
    payload[110:118] = bytes.fromhex("0027 010802 49 0501")
    return frame(0x0D, bytes(payload))


def test_identity() -> None:
    code = frame(0x1D, b"MTi-630-8A1G6".ljust(20))
    firmware = frame(0x13, bytes.fromhex("010802 00000025 00011534"))
    log = xbus.read_log(MTI_630 + code + firmware)
    assert (log.device_id, log.product_code) == (0x800040D2, "MTi-630-8A1G6")
    assert log.firmware == (1, 8, 2, 37, 70964)
    assert str(log.firmware) == "1.8.2"
    assert log.configuration is None


def test_configuration_of_the_100_series() -> None:
    log = xbus.read_log(configuration("037003F8 0480 0001"))
    assert log.configuration == xbus.Configuration(
        device_id=0x037003F8, product_code=None, sampling_period=1152, output_skip_factor=1,
        date="20261122", time="09295950", devices=1, filter_profile=39, firmware=xbus.Firmware(1, 8, 2),
        output_mode=1, output_settings=0, filter_type="I", filter_version=(5, 1), data_length=0x0480,
    )  # fmt: skip
    assert (log.device_id, log.product_code, log.firmware) == (
        0x037003F8,
        None,
        (1, 8, 2, None, None),
    )


def test_configuration_of_the_600_series() -> None:
    """The halves of the identifier are exchanged; plain order is accepted too."""
    for head in ("800040D2 00000000", "00000000 800040D2"):
        log = xbus.read_log(configuration(head, b"MTi-630-8A1G6  "))
        assert log.configuration is not None
        assert (log.device_id, log.product_code) == (0x800040D2, "MTi-630-8A1G6")
        assert (log.configuration.sampling_period, log.configuration.output_skip_factor) == (
            None,
            None,
        )


def test_the_first_identity_message_wins() -> None:
    """FirmwareRev takes precedence over Configuration, because it is more detailed."""
    firmware = frame(0x13, bytes.fromhex("010903 00000001 00000002"))
    log = xbus.read_log(configuration("037003F8 0480 0001") + firmware + MTI_630)
    assert (log.device_id, log.firmware) == (0x037003F8, (1, 9, 3, 1, 2))


def test_identities_of_two_devices_are_not_mixed() -> None:
    """A file of two recordings, one after the other, has the identity of the first device."""
    first = configuration("037003F8 0480 0001")
    log = xbus.read_log(first + GOOD + configuration("800040D2 00000000", b"MTi-630-8A1G6  "))
    assert (log.device_id, log.product_code) == (0x037003F8, None)
    assert log.identity == xbus.read_log(first).identity


def test_identity_is_empty_without_messages() -> None:
    log = xbus.read_log(GOOD)
    assert (log.device_id, log.product_code, log.firmware, log.configuration) == (None,) * 4


@pytest.mark.parametrize("payload", ["", "01", "0108", "010802", "010802 000000", "FF" * 12])
def test_firmware_of_any_length(payload: str) -> None:
    """Replies of unusual length are kept as messages and raise no error."""
    raw = bytes.fromhex(payload)
    log = xbus.read_log(GOOD + frame(0x13, raw) + GOOD)
    assert log.messages[0].payload == raw
    assert (log.firmware is None) == (len(raw) < 3)


# ---------------------------------------------------------------------------------------------
# Print
# ---------------------------------------------------------------------------------------------

PRINTED = """\
<Log 1,040 samples, 9.99 s, 15 quantities, MTi-680G-8A1G6>
  packet_counter      1,040  104.5 Hz
  sample_time_fine    1,040  104.5 Hz  0.1 ms
  utc_time            1,040  104.5 Hz
  quaternion          1,000  100.0 Hz  Float32, ENU
  euler_angles        1,000  100.0 Hz  Float32, ENU, deg
  acceleration        1,000  100.0 Hz  Float32, m/s2
  rate_of_turn        1,000  100.0 Hz  Float32, rad/s
  magnetic_field      1,000  100.0 Hz  Float32, a.u.
  lat_lon             1,000  100.0 Hz  Fp1632, deg
  altitude_ellipsoid  1,000  100.0 Hz  Fp1632, m
  velocity_xyz        1,000  100.0 Hz  Fp1632, ENU, m/s
  status_word         1,000  100.0 Hz
  baro_pressure         100   10.0 Hz  Pa
  temperature            10    1.0 Hz  Float32, degC
  gnss_pvt_data          40    4.0 Hz"""


def test_repr() -> None:
    """The repr has the device, counts, duration, rates and losses."""
    assert repr(xbus.read_log(OWN_CAPTURES / "walk.mtb")) == PRINTED
    first = repr(xbus.read_log(OWN_CAPTURES / "field.mtb")).splitlines()[0]
    assert "1,016 samples, 9.99 s, 15 quantities" in first
    assert "23 samples lost in 12 gaps" in first
    assert "1,816 bytes of damage in 12 places" in first
    assert repr(xbus.read_log(b"")) == "<Log 0 samples, 0 quantities>"
    assert "quaternion NED" in repr(xbus.read_log(MIXED))


@pytest.mark.parametrize(
    ("packets", "printed"),
    [
        ([real(0x4020, 1, 2, 3)], "<Column acceleration: (1, 3) float32, Float32, m/s2>"),
        ([real(0x2016, 1, 0, 0, 0)] * 2, "<Column quaternion: (2, 4) float64, Fp1632, NED>"),
        ([packet(0x3010, bytes(4))], "<Column baro_pressure: (1,) uint32, Pa>"),
        ([real(0x2020, *range(9))], "<Column rotation_matrix: (1, 3, 3) float32, Float32, ENU>"),
        ([packet(0x7010, bytes(94))], "<Column gnss_pvt_data: (1,) struct>"),
        ([sat_info((1, 2, 3, 4))], "<Column gnss_sat_info: (1,) struct>"),
        ([packet(0xE020, bytes(4))], "<Column status_word: (1,) uint32>"),
    ],
)
def test_repr_of_a_column(packets: list[bytes], printed: str) -> None:
    assert repr(read_column(*packets)) == printed
    html = read_column(*packets)._repr_html_()
    assert html.count("<tr>") == html.count("</tr>") == 1 + len(packets)
    assert f"<p>{printed[1:-1]}" in html.replace("&lt;", "").replace("&gt;", "")


def test_html_of_a_column() -> None:
    """The first rows, one number in each cell, and the number of further rows."""
    html = xbus.read_log(OWN_CAPTURES / "walk.mtb")["lat_lon"]._repr_html_()
    assert "<th>time</th><th>lat</th><th>lon</th>" in html
    assert html.count("<td>") == 3 * 6
    assert "<p>994 more rows</p>" in html
    matrix = read_column(real(0x2020, 11, 21, 31, 12, 22, 32, 13, 23, 33))._repr_html_()
    assert "<th>m11</th><th>m12</th>" in matrix
    assert "<td>11.0</td><td>12.0</td>" in matrix


def test_html() -> None:
    html = xbus.read_log(OWN_CAPTURES / "walk.mtb")._repr_html_()
    assert "<td>baro_pressure</td><td>100</td><td>10.0 Hz</td><td>Pa</td>" in html
    assert html.count("<tr>") == 16


def test_html_is_escaped() -> None:
    """A product code comes from the input, which can contain any text."""
    log = xbus.read_log(frame(0x1D, b"<script>MTi&</script>"[:20]) + GOOD)
    assert log.product_code == "<script>MTi&</script"
    assert "<script" not in log._repr_html_()
    assert "&lt;script&gt;MTi&amp;" in log._repr_html_()


# ---------------------------------------------------------------------------------------------
# Copies: none from column to numpy, one from frame to column, none from file to frame
# ---------------------------------------------------------------------------------------------


def address(values: Any) -> int:
    return int(values.__array_interface__["data"][0])


def test_arrays_are_views() -> None:
    """Arrays are views of the decoded data; repeated access returns the same memory."""
    log = xbus.read_log(OWN_CAPTURES / "walk.mtb")
    for key in log:
        values = log[key].values
        assert not values.flags.owndata
        assert not values.flags.writeable
        assert address(values) == address(log[key]._core.values)
        assert np.shares_memory(values, log[key].values)
    for name in ("time", "packet_counter"):
        assert address(getattr(log, name)) == address(getattr(log._core, name))


def test_offsets_are_signed() -> None:
    """Offsets are signed as in numpy, so that differences can be negative."""
    log = xbus.read_log(OWN_CAPTURES / "field.mtb")
    assert len(log.messages) > 0
    assert len(log.damage) > 0
    positions = [log.offset, log.messages.offset, log.messages.sample]
    positions += [log.damage["offset"], log.damage["length"]]
    assert {position.dtype for position in positions} == {np.dtype(np.int64)}


def test_arrays_outlive_the_log() -> None:
    log = xbus.read_log(OWN_CAPTURES / "walk.mtb")
    arrays = {str(key): log[key].values for key in log} | {"time": log.time, "offset": log.offset}
    arrays["mid"] = log.messages.mid
    copies = {key: column.copy() for key, column in arrays.items()}
    del log
    gc.collect()
    trash = [bytes(100_000) for _ in range(100)]
    for key, column in arrays.items():
        assert reference.same_bits(column, copies[key]), key
    del trash


MEASURE = """\
    import sys
    import numpy as np
    import xbus

    def anonymous(name):
        with open("/proc/self/status") as status:
            return next(int(line.split()[1]) << 10 for line in status if line.startswith(name))

    path, how = sys.argv[1:]
    data = np.memmap(path, np.uint8, mode="r") if how == "memmap" else path
    xbus.read_log(data[:1_000_000] if how == "memmap" else b"")  # load everything that is loaded once
    with open("/proc/self/clear_refs", "w") as file:
        file.write("5")  # reset the peak
    before = anonymous("RssAnon:"), anonymous("VmRSS:")
    log = xbus.read_log(data)
    columns = sum(log[key].values.nbytes for key in log)
    held = anonymous("RssAnon:") - before[0]
    pages = len(data) if how == "memmap" else 0
    peak = anonymous("VmHWM:") - before[1] - pages
    samples, words = len(log), log["status_word"].values
    del log
    print(samples, columns, held, peak, anonymous("RssAnon:") - before[0])
"""


@pytest.mark.skipif(sys.platform != "linux", reason="measured in /proc")
@pytest.mark.parametrize("how", ["memmap", "file"])
def test_memory(how: str, tmp_path: Path) -> None:
    """Reading 64 MB needs memory for the columns, once, and none for the file."""
    path = tmp_path / "long.mtb"
    piece = streams.ahrs(65_536)  # the counter wraps, so the next piece continues
    with path.open("wb") as file:
        for _ in range(12):
            file.write(piece)
    assert path.stat().st_size > 64e6
    program = [sys.executable, "-c", textwrap.dedent(MEASURE), str(path), how]
    result = subprocess.run(program, check=True, capture_output=True, text=True)  # noqa: S603
    samples, columns, held, peak, kept = map(int, result.stdout.split())
    assert samples == 12 * 65_536
    assert columns == samples * (2 + 4 + 16 + 3 * 12 + 4)
    assert held < 1.5 * columns, (held / columns, peak / columns)
    assert peak < 1.5 * columns, (held / columns, peak / columns)
    # An array keeps only its column alive, not the others.
    assert kept < 0.5 * columns, kept / columns
