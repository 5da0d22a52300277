"""`host_time` and `utc` of logs: valid and invalid side files of arrivals, and the UTC of samples."""

from __future__ import annotations

import bz2
import gzip
import io
import json
import lzma
import os
import pickle
import struct
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import xbus
from conftest import coarse, counter, fine, shared, trigger
from streams import frame, mtdata2, packet, real
from test_cli import run
from xbus import HostClock, XbusError
from xbus.log import arrivals
from xbus.log.arrivals import Arrivals
from xbus.log.parts import joined_parts

HEAD = b"XBUSTIME" + struct.pack("<IIq", 1, 16, 0)
BEGIN = 1_790_000_000 * 10**9
MS = 10**6
#: A GnssSatInfo of one satellite.
ONE = bytes([0, 0, 0, 0, 1, 0, 0, 0]) + bytes(4)


def records(*pieces: tuple[int, int]) -> bytes:
    """Returns records of where pieces end, and when they arrived."""
    return b"".join(struct.pack("<Qq", end, arrival) for end, arrival in pieces)


def gnss(ticks: int) -> bytes:
    """A sample of the receiver."""
    return mtdata2(fine(ticks), packet(0x7020, bytes(8)))


def recording(samples: list[bytes], read: int = 7) -> tuple[bytes, list[tuple[int, int]]]:
    """Returns samples sent every 10 ms after a Configuration message, and the pieces of their reads."""
    data = frame(0x0C, bytes(118))
    pieces = []
    for at, sample in enumerate(samples):
        data += sample
        if at % read == read - 1:
            # Some pieces end within the next frame.
            pieces.append((len(data) + (at % 3) * 4, BEGIN + 10 * at * MS + 2 * MS))
    pieces = [piece for piece in pieces if piece[0] < len(data)]
    return data, [*pieces, (len(data), BEGIN + 10 * len(samples) * MS)]


def written(folder: Path, data: bytes, side: bytes | None, name: str = "a.mtb") -> Path:
    path = folder / name
    path.write_bytes(data)
    if side is not None:
        path.with_name(name + ".times").write_bytes(side)
    return path


def expected(data: bytes, pieces: list[tuple[int, int]]) -> list[float]:
    """Computes host times sample by sample, with parts of the library that other tests cover."""
    log, clock, host_times = xbus.read_log(data), HostClock(), []
    ends = [*log.offset[1:].tolist(), len(data)][: len(log)]
    gnss = {
        int(item)
        for key in ("gnss_sat_info", "trigger_in1")
        if key in log
        for item in log[key].sample
    }
    for sample, end in enumerate(ends):
        stamps = [arrival for upto, arrival in pieces if upto >= end]
        time = float(log.time[sample])
        host_times.append(
            clock.update(time, stamps[0], sample not in gnss) if stamps else float("nan")
        )
    return host_times


SAMPLES = [mtdata2(counter(index), fine(5000 + 100 * index)) for index in range(100)]
DATA, PIECES = recording(SAMPLES)
GOOD = HEAD + records(*PIECES)


# ---------------------------------------------------------------------------------------------
# Host time
# ---------------------------------------------------------------------------------------------


def test_host_time(tmp_path: Path) -> None:
    log = xbus.read_log(written(tmp_path, DATA, GOOD))
    assert log.host_time.shape == (100,)
    assert log.host_time.dtype == np.float64
    assert log.host_time.tolist() == expected(DATA, PIECES)
    assert not log.host_time.flags.writeable
    # The seventh has the least delay: it was read 2 ms after it was sent.
    assert log.host_time[50:] == pytest.approx(
        BEGIN / 1e9 + np.arange(50, 100) / 100 + 0.002, abs=1e-6
    )
    assert log.times_fault is None
    assert log.host_clock is not None
    assert log.host_clock.fits == 1
    assert log.host_clock.offset == pytest.approx(BEGIN / 1e9 + 0.002 - 0.5, abs=1e-6)
    np.testing.assert_array_equal(log["packet_counter"].host_time, log.host_time)


def test_without_a_side_file(tmp_path: Path) -> None:
    path = written(tmp_path, DATA, None)
    written(tmp_path, b"", GOOD, "b.mtb")
    for source in (
        path,
        str(path),
        DATA,
        io.BytesIO(DATA),
        np.frombuffer(DATA, np.uint8),
        path.as_uri()[7:],
    ):
        log = xbus.read_log(source)
        assert np.isnan(log.host_time).all()
        assert log.host_clock is None
        assert log.times_fault is None
        assert np.isnan(log["packet_counter"].host_time).all()
    assert len(xbus.read_log(tmp_path / "b.mtb").host_time) == 0


MIXED = {
    "receiver": [
        it if at % 10 != 5 else gnss(5000 + 100 * at - 450) for at, it in enumerate(SAMPLES)
    ],
    "receiver without a fix": [
        it if at % 10 != 5 else gnss(2**31 + at) for at, it in enumerate(SAMPLES)
    ],
    "receiver first": [gnss(4000), gnss(4500), *SAMPLES],
    "trigger": [
        it if at % 10 else mtdata2(trigger(500_000 + 9_000 * at)) for at, it in enumerate(SAMPLES)
    ],
    "no stamps": [
        mtdata2(real(0x4040, 1, 2, 3)) if at % 3 else it for at, it in enumerate(SAMPLES)
    ],
    "wrap": [mtdata2(fine((2**32 - 5000 + 100 * index) % 2**32)) for index in range(100)],
    "coarse": [
        mtdata2(fine(9900 + index * 100), coarse((9900 + index * 100) // 10_000))
        for index in range(100)
    ],
    "reset": [
        mtdata2(fine(90_000 + index * 100 if index < 50 else index * 100)) for index in range(100)
    ],
    "extended": [mtdata2(fine(100 * index), *[real(0x4020, 1, 2, 3)] * 20) for index in range(100)],
    "damage": [it if at % 9 else b"\xfa\xff" + it for at, it in enumerate(SAMPLES)],
    "one": SAMPLES[:1],
    "none": [],
}


@pytest.mark.parametrize("samples", MIXED.values(), ids=MIXED)
def test_all_kinds_of_samples(tmp_path: Path, samples: list[bytes]) -> None:
    data, pieces = recording(samples)
    path = written(tmp_path, data, HEAD + records(*pieces))
    log = xbus.read_log(path)
    host_times = log.host_time
    assert host_times.tolist() == pytest.approx(expected(data, pieces), nan_ok=True, abs=0, rel=0)
    leads = np.isfinite(host_times)
    for name in ("gnss_sat_info", "trigger_in1"):
        if name in log:
            leads[log[name].sample] = False
    assert np.all(host_times[leads][1:] >= host_times[leads][:-1])
    for block in (1, 100, 1000):
        parts = list(xbus.iter_log(path, block_bytes=block))
        np.testing.assert_array_equal(
            np.concatenate([part.host_time for part in parts]), host_times
        )
        for key in log:
            rows = [part[key].host_time for part in parts if key in part]
            np.testing.assert_array_equal(np.concatenate(rows), log[key].host_time)
        if log.host_clock is not None and parts[-1].host_clock is not None:
            assert repr(parts[-1].host_clock) == repr(log.host_clock)


def test_host_times_by_kind_of_sample(tmp_path: Path) -> None:
    """GNSS samples get the host time of their time stamp; samples without a stamp have none."""

    def log(name: str) -> xbus.Log:
        data, pieces = recording(MIXED[name])
        return xbus.read_log(written(tmp_path, data, HEAD + records(*pieces)))

    behind = log("receiver")
    here = behind["gnss_sat_info"].sample[2:]
    assert behind.host_time[here] == pytest.approx(behind.host_time[here - 1] - 0.035, abs=1e-3)
    assert np.isnan(log("receiver without a fix")["gnss_sat_info"].host_time).all()
    assert np.isnan(log("receiver first").host_time[:2]).all()
    assert np.isnan(log("no stamps").host_time).sum() == 66
    reset = log("reset").host_clock
    assert reset is not None
    assert [step.reason for step in reset.steps] == ["device time went back"]
    wrap = log("wrap").host_clock
    assert wrap is not None
    assert wrap.steps == []


def test_parts_have_separate_clocks(tmp_path: Path) -> None:
    path = written(tmp_path, DATA, GOOD)
    parts = list(xbus.iter_log(path, block_bytes=500))
    first, last = parts[1].host_clock, parts[-1].host_clock
    assert first is not None
    assert last is not None
    assert first is not last
    assert first.residual < last.residual


def test_devices_have_separate_host_clocks(tmp_path: Path) -> None:
    """Each bus identifier has a separate clock; FF and 1 are the same device."""
    samples = [
        mtdata2(fine(index * 100 + (10**7 if index % 3 == 2 else 0)), bid=(0xFF, 1, 2)[index % 3])
        for index in range(90)
    ]
    data, pieces = recording(samples, 1)
    log = xbus.read_log(written(tmp_path, data, HEAD + records(*pieces)))
    assert np.diff(log.host_time).min() > 0
    assert sorted(log._host_times.clocks) == [1, 2]
    assert all(clock.fits == 1 for clock in log._host_times.clocks.values())


def test_host_times_do_not_depend_on_the_selected_quantities(tmp_path: Path) -> None:
    """The quantities that the clocks need are read in any case."""
    data, pieces = recording(MIXED["receiver"])
    path = written(tmp_path, data, HEAD + records(*pieces))
    some = xbus.read_log(path, quantities=["acceleration"])
    np.testing.assert_array_equal(some.host_time, xbus.read_log(path).host_time)


def test_tables(tmp_path: Path) -> None:
    """Every table has a column next to time; it is null if a sample has no host time."""
    arrow = pytest.importorskip("pyarrow")
    samples = [
        *SAMPLES,
        mtdata2(counter(100)),
        mtdata2(counter(101), fine(15_200), packet(0x7020, ONE)),
    ]
    data, pieces = recording(samples)
    log = xbus.read_log(written(tmp_path, data, HEAD + records(*pieces)))
    wide = log.to_arrow()
    assert wide.column_names[:3] == ["sample", "time", "host_time"]
    assert wide.schema.field("host_time").metadata == {b"unit": b"s"}
    assert wide["host_time"].null_count == int(np.isnan(log.host_time).sum()) == 1
    host = wide["host_time"].to_numpy()
    assert np.array_equal(host, log.host_time, equal_nan=True)
    fine_time = log.to_arrow("sample_time_fine")
    assert fine_time["host_time"].to_numpy().tolist() == log["sample_time_fine"].host_time.tolist()
    assert arrow.table(log["sample_time_fine"]).equals(fine_time)
    satellites = log.to_arrow("gnss_sat_info")
    assert satellites["host_time"].to_pylist() == [log.host_time[101]]
    assert "host_time" not in xbus.read_log(data).to_arrow().column_names


def test_parquet_of_several_files(tmp_path: Path) -> None:
    """The command uses the side files of a split recording, up to the first file without one."""
    pq = pytest.importorskip("pyarrow.parquet")
    names = []
    for number in range(3):
        samples = [
            mtdata2(counter(index), fine(5000 + 100 * index))
            for index in range(100 * number, 100 * number + 100)
        ]
        data, pieces = recording(samples)
        later = [(end, arrival + number * 10**9) for end, arrival in pieces]
        side = HEAD + records(*later) if number < 2 else None
        names.append(str(written(tmp_path, data, side, f"{number}.mtb")))
    out = tmp_path / "all.parquet"
    assert run("decode", *names, "-o", str(out)).exit_code == 0
    host = pq.read_table(out)["host_time"].to_numpy()
    assert np.isfinite(host[:200]).all()
    assert np.diff(host[20:200]) == pytest.approx(0.01, abs=1e-4)
    assert np.isnan(host[200:]).all()
    assert np.array_equal(host[:100], xbus.read_log(names[0]).host_time)
    for side in (b"garbage", HEAD + records(*pieces[:3])):
        written(tmp_path, Path(names[0]).read_bytes(), side, "0.mtb")
        alone = xbus.read_log(names[0])
        result = run("decode", *names, "-o", str(out))
        if alone.host_clock is None:
            assert "host_time" not in pq.read_schema(out).names
            assert "is not a side file of version 1" in result.stderr
        else:
            host = pq.read_table(out)["host_time"].to_numpy()
            assert np.array_equal(host[:100], alone.host_time, equal_nan=True)
            assert np.isnan(host[100:]).all()
    assert run("decode", names[2], "-o", str(out)).exit_code == 0
    assert "host_time" not in pq.read_schema(out).names


def test_npz(tmp_path: Path) -> None:
    log = xbus.read_log(written(tmp_path, DATA, GOOD))
    log.to_npz(tmp_path / "a.npz")
    np.testing.assert_array_equal(np.load(tmp_path / "a.npz")["host_time"], log.host_time)
    xbus.read_log(DATA).to_npz(tmp_path / "b.npz")
    assert "host_time" not in np.load(tmp_path / "b.npz")


# ---------------------------------------------------------------------------------------------
# Side files
# ---------------------------------------------------------------------------------------------

END, ARRIVAL = PIECES[-1]
#: Content of the side file; number of samples with a host time; text of the fault, or None.
SIDES = {
    "good": (GOOD, 100, None),
    "empty": (b"", 0, "is not a side file of version 1"),
    "cut in the head": (HEAD[:23], 0, "is not a side file of version 1"),
    "head alone": (HEAD, 0, None),
    "cut in the first record": (HEAD + GOOD[24:39], 0, None),
    "cut in the last record": (GOOD[:-1], 98, None),
    "cut in the middle": (HEAD + records(*PIECES[:5]), 35, None),
    "other magic": (b"xbustimE" + GOOD[8:], 0, "is not a side file of version 1"),
    "other version": (HEAD[:8] + struct.pack("<II", 2, 16) + GOOD[16:], 0, "of version 1"),
    "other record size": (HEAD[:8] + struct.pack("<II", 1, 24) + GOOD[16:], 0, "of version 1"),
    "big-endian": (b"XBUSTIME" + struct.pack(">II", 1, 16) + GOOD[16:], 0, "of version 1"),
    "text": (b"time,offset\n" * 99, 0, "is not a side file of version 1"),
    "zeros": (bytes(999), 0, "is not a side file of version 1"),
    "zeros at the end": (
        HEAD + records(*PIECES[:5]) + bytes(64),
        28,
        "offsets descend after record 4",
    ),
    "an offset falls": (
        HEAD + records(*PIECES[:8], PIECES[3], *PIECES[8:]),
        49,
        "offsets descend after record 7",
    ),
    "an offset is huge": (
        HEAD + records(*PIECES[:8], (2**64 - 1, 0), *PIECES[8:]),
        56,
        "descend after record 8",
    ),
    "offsets repeat": (HEAD + records(*[piece for piece in PIECES for _ in range(2)]), 100, None),
    "an arrival falls": (
        HEAD + records(*PIECES[:8], (PIECES[8][0], PIECES[7][1] - 1), *PIECES[9:]),
        100,
        None,
    ),
    "bytes that were lost": (
        HEAD + records(*PIECES, (END + 99, ARRIVAL + MS)),
        100,
        f"but the log has {END}",
    ),
    "of another log": (
        HEAD + records(*PIECES, (END + 99, ARRIVAL + 61_000 * MS)),
        0,
        "belongs to another",
    ),
    "of a very long log": (HEAD + records((2**63 - 1, BEGIN), (2**64 - 1, -(2**63))), 0, "another"),
}


@pytest.mark.parametrize(("side", "known", "fault"), SIDES.values(), ids=SIDES)
def test_side_files(tmp_path: Path, side: bytes, known: int, fault: str | None) -> None:
    """The log is read with any side file, and host times are correct or absent."""
    path = written(tmp_path, DATA, side)
    log = xbus.read_log(path)
    assert len(log) == 100
    assert np.isfinite(log.host_time).tolist() == [True] * known + [False] * (100 - known)
    if fault is None:
        assert log.times_fault is None
    else:
        assert log.times_fault is not None
        assert fault in log.times_fault
        assert f"{path}.times" in log.times_fault
        assert log.times_fault in repr(log)
    joined = np.concatenate([item.host_time for item in xbus.iter_log(path, block_bytes=300)])
    np.testing.assert_array_equal(joined, log.host_time)
    assert {item.times_fault for item in xbus.iter_log(path, block_bytes=300)} == {log.times_fault}


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes here")
def test_a_side_file_that_is_a_pipe_is_not_read(tmp_path: Path) -> None:
    """The pipe has no writer, for which a reader would wait."""
    path = written(tmp_path, DATA, None)
    os.mkfifo(f"{path}.times")
    log = xbus.read_log(path)
    assert log.times_fault == f"{path}.times cannot be read: not a regular file"
    assert len(log) == 100


def test_a_side_file_of_any_size_needs_little_memory(tmp_path: Path) -> None:
    """It is not read to its end: 8 GiB of zeros are records of pieces without bytes."""
    path = written(tmp_path, DATA, HEAD)
    with Path(f"{path}.times").open("r+b") as file:
        file.truncate(8 << 30)
    tracemalloc.start()
    log = xbus.read_log(path)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert log.times_fault == f"{path}.times has more records than the log has bytes"
    assert peak < 64 << 20


@pytest.fixture
def _stored(monkeypatch: pytest.MonkeyPatch) -> None:
    """All records stay in the side file, and are read three at a time."""
    monkeypatch.setattr(arrivals, "MOST_HELD", 0)
    monkeypatch.setattr(arrivals, "BLOCK", 3 * 16)


@pytest.mark.usefixtures("_stored")
@pytest.mark.parametrize("samples", MIXED.values(), ids=MIXED)
def test_arrivals_that_stay_in_the_file(
    tmp_path: Path, samples: list[bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Logs, parts of any size, parts that are joined again, and cuts have the same host times."""
    data, pieces = recording(samples)
    path = written(tmp_path, data, HEAD + records(*pieces))
    want = expected(data, pieces)
    np.testing.assert_array_equal(xbus.read_log(path).host_time, want)
    for block in (1, 100, 1000):
        parts = xbus.split_log(path, block_bytes=block)
        groups = [joined_parts(parts[at : at + 3]) for at in range(0, len(parts), 3)]
        for read in (
            list(xbus.iter_log(path, block_bytes=block)),
            [part.read() for part in pickle.loads(pickle.dumps(parts))],  # noqa: S301
            [part.read() for part in groups],
        ):
            np.testing.assert_array_equal(np.concatenate([one.host_time for one in read]), want)
    if len(want) < 2:
        return
    sides = []
    for most in (0, 1000):
        monkeypatch.setattr(arrivals, "MOST_HELD", most)
        cut = tmp_path / f"{most}.mtb"
        assert run("cut", str(path), "--from", "0.3", "-o", str(cut)).exit_code == 0
        between = xbus.read_log(path, between=(0.3, None)).host_time
        sides.append((Path(f"{cut}.times").read_bytes(), between.tolist()))
    assert repr(sides[0]) == repr(sides[1])


@pytest.mark.usefixtures("_stored")
def test_pieces_whose_arrivals_stay_in_the_files(tmp_path: Path) -> None:
    data, pieces = recording(SAMPLES)
    at = pieces[7][0]
    first = written(tmp_path, data[:at], HEAD + records(*pieces[:8]), "night.mtb")
    behind = [(end - at, time) for end, time in pieces[8:]]
    second = written(tmp_path, data[at:], HEAD + records(*behind), "night-0001.mtb")
    want = expected(data, pieces)
    assert xbus.read_log([first, second]).host_time.tolist() == want
    parts = xbus.split_log([second, first], block_bytes=200)
    assert [time for part in parts for time in part.read().host_time.tolist()] == want


@pytest.mark.usefixtures("_stored")
@pytest.mark.parametrize("change", ["shorter", "another", "missing"])
def test_a_side_file_that_changes_while_it_is_read(tmp_path: Path, change: str) -> None:
    path = written(tmp_path, DATA, GOOD)
    parts = xbus.split_log(path, block_bytes=500)
    side = Path(f"{path}.times")
    if change == "missing":
        side.unlink()
    else:
        side.write_bytes(GOOD[:40] if change == "shorter" else HEAD + GOOD[40:])
    problem = "cannot be read any more" if change == "missing" else "changed while its log was read"
    with pytest.raises(XbusError, match=rf"a\.mtb\.times {problem}"):
        _ = parts[-1].read().host_time


def test_a_long_side_file_needs_little_memory(tmp_path: Path) -> None:
    """It has a record for each byte."""
    data = DATA + frame(0x31) * 300_000
    ends = np.arange(1, len(data) + 1, dtype=np.int64)
    side = b"".join(Arrivals(ends, BEGIN + ends * MS, len(data)).blocks())
    path = written(tmp_path, data, side)
    tracemalloc.start()
    parts = xbus.split_log(path, block_bytes=100_000)
    split = [part.read().host_time for part in parts]
    parted = [part.host_time for part in xbus.iter_log(path, block_bytes=100_000)]
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 12_000_000 < len(side) / 2
    log = xbus.read_log(DATA)
    arrival = BEGIN + np.append(log.offset[1:], len(DATA)) * MS
    want = HostClock().update(log.time, arrival)
    for found in (split, parted):
        np.testing.assert_array_equal(np.concatenate(found), want)


@pytest.mark.parametrize("is_side_compressed", [False, True])
@pytest.mark.parametrize("suffix", [".gz", ".xz", ".bz2"])
def test_compressed_logs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, suffix: str, is_side_compressed: bool
) -> None:
    """The side file has the name of the log before compression."""
    monkeypatch.chdir(tmp_path)
    compressors: dict[str, Callable[[bytes], bytes]] = {
        ".gz": gzip.compress,
        ".xz": lzma.compress,
        ".bz2": bz2.compress,
    }
    compress = compressors[suffix]
    whole = xbus.read_log(written(tmp_path, DATA, GOOD)).host_time
    for old in tmp_path.iterdir():
        old.unlink()
    side = "a.mtb.times" + suffix * is_side_compressed
    for half, name in ((DATA, "a"), (DATA[:1000], "b")):
        Path(f"{name}.mtb{suffix}").write_bytes(compress(half))
        Path(side.replace("a", name, 1)).write_bytes(compress(GOOD) if is_side_compressed else GOOD)
    log = xbus.read_log(f"a.mtb{suffix}")
    assert log.host_time.tolist() == whole.tolist()
    part = xbus.read_log(f"a.mtb{suffix}", between=(0.2, 0.5))
    assert part.host_time.tolist() == whole[20:50].tolist()
    assert run("decode", f"a.mtb{suffix}", "-o", "a.npz").exit_code == 0
    assert np.load("a.npz")["host_time"].tolist() == whole.tolist()
    # A side file for more than the log has is detected here too.
    fault = xbus.read_log(f"b.mtb{suffix}").times_fault
    assert fault is not None
    assert f"is for {END} bytes, but the log has 1000" in fault
    # A side file that a pattern names is no recording.
    result = run("info", f"a.mtb{suffix}", side, "--json")
    assert [found["file"] for found in json.loads(result.stdout)] == [f"a.mtb{suffix}"]


def test_compressed_pieces(tmp_path: Path) -> None:
    """The arrivals of a piece are not those of the next one, whatever the size of the compressed file."""
    names, hosts = [], []
    for number in range(2):
        samples = [
            mtdata2(counter(at), fine(5000 + 100 * at))
            for at in range(100 * number, 100 * number + 100)
        ]
        data, pieces = recording(samples)
        side = HEAD + records(*((end, time + number * 10**9) for end, time in pieces))
        names.append(tmp_path / f"{number}.mtb.gz")
        names[-1].write_bytes(gzip.compress(data))
        names[-1].with_suffix(".times").write_bytes(side)
        plain = written(tmp_path, data, side, f"plain{number}.mtb")
        hosts.append(plain)
    expected_times = xbus.read_log(hosts).host_time
    assert np.isfinite(expected_times).all()
    assert xbus.read_log(names).host_time.tolist() == expected_times.tolist()
    out = tmp_path / "all.npz"
    assert run("decode", *map(str, names), "-o", str(out)).exit_code == 0
    assert np.load(out)["host_time"].tolist() == expected_times.tolist()


def test_text_in_hex_has_no_arrivals(tmp_path: Path) -> None:
    path = tmp_path / "a.mtb"
    path.write_text(DATA.hex())
    path.with_name("a.mtb.times").write_bytes(GOOD)
    assert run("decode", str(path), "--hex", "-o", str(tmp_path / "a.npz")).exit_code == 0
    assert "host_time" not in np.load(tmp_path / "a.npz")


def test_unreadable_side_files(tmp_path: Path) -> None:
    path = written(tmp_path, DATA, None)
    (tmp_path / "a.mtb.times").mkdir()
    log = xbus.read_log(path)
    assert len(log) == 100
    assert log.times_fault is not None
    assert "cannot be read" in log.times_fault


@pytest.mark.parametrize("cut", range(0, len(DATA), 97))
def test_truncated_logs_keep_their_times(tmp_path: Path, cut: int) -> None:
    """The remaining samples keep their times."""
    whole = xbus.read_log(written(tmp_path, DATA, GOOD)).host_time
    log = xbus.read_log(written(tmp_path, DATA[:cut], GOOD))
    assert log.host_time.tolist() == whole[: len(log)].tolist()


@given(st.binary(max_size=200), st.integers(0, len(GOOD)))
def test_garbage(tmp_path_factory: pytest.TempPathFactory, garbage: bytes, at: int) -> None:
    folder = tmp_path_factory.getbasetemp()
    for side in (garbage, HEAD + garbage, GOOD[:at] + garbage + GOOD[at + len(garbage) :]):
        log = xbus.read_log(written(folder, DATA, side))
        assert log.host_time.shape == (100,)
        assert isinstance(log.times_fault, str | None)


# ---------------------------------------------------------------------------------------------
# UTC
# ---------------------------------------------------------------------------------------------


def utc_time(nanos: int, second: int, valid: int, day: int = 20) -> bytes:
    return packet(0x1010, struct.pack(">IHBBBBBB", nanos, 2019, 1, day, 13, 47, second, valid))


def pvt(nanos: int, second: int, valid: int, day: int = 20) -> bytes:
    head = struct.pack(">IHBBBBBBIi", 49662250, 2019, 1, day, 13, 47, second, valid, 5, nanos)
    return packet(0x7010, head + bytes(74))


def test_utc() -> None:
    """UTC comes from either valid quantity; `utc_time` takes precedence, as in other samples."""
    table = {
        mtdata2(fine(1)): "NaT",
        mtdata2(utc_time(250_000_000, 24, 0x37)): "2019-01-20T13:47:24.250000000",
        mtdata2(utc_time(0, 24, 7)): "2019-01-20T13:47:24.000000000",
        mtdata2(utc_time(1, 24, 3)): "NaT",
        mtdata2(utc_time(1, 24, 0xF8)): "NaT",
        mtdata2(utc_time(2, 24, 7, day=32)): "NaT",
        mtdata2(pvt(249_768_484, 24, 0x37)): "2019-01-20T13:47:24.249768484",
        mtdata2(pvt(-1, 0, 7)): "2019-01-20T13:46:59.999999999",
        mtdata2(pvt(0, 24, 6)): "NaT",
        mtdata2(pvt(0, 24, 7, day=0)): "NaT",
        mtdata2(
            pvt(249_768_484, 24, 0x37), utc_time(250_000_000, 24, 0x37)
        ): "2019-01-20T13:47:24.250000000",
        mtdata2(pvt(0, 24, 0), utc_time(1, 24, 7)): "2019-01-20T13:47:24.000000001",
        mtdata2(pvt(2, 24, 7), utc_time(1, 24, 0)): "2019-01-20T13:47:24.000000002",
    }
    log = xbus.read_log(b"".join(table))
    assert log.utc.dtype == np.dtype("datetime64[ns]")
    assert log.utc.astype(str).tolist() == list(table.values())
    assert not log.utc.flags.writeable
    parts = list(xbus.iter_log(b"".join(table), block_bytes=1))
    np.testing.assert_array_equal(np.concatenate([part.utc for part in parts]), log.utc)
    assert str(log["gnss_pvt_data"].datetime[1]) == "2019-01-20T13:46:59.999999999"


def test_utc_without_gnss() -> None:
    assert np.isnat(xbus.read_log(DATA).utc).all()
    assert len(xbus.read_log(b"").utc) == 0


@pytest.mark.parametrize("number", range(1, 6))
def test_utc_of_a_real_recording(number: int) -> None:
    """GNSS samples and others agree on UTC at a device time, however late they arrived."""
    log = xbus.read_log(shared(f"captures/mtig710-{number}/raw.bin"))
    known = ~np.isnat(log.utc)
    assert known[log["gnss_pvt_data"].sample].all()
    since = (log.utc[known] - log.utc[known][0]) / np.timedelta64(1, "s")
    assert since == pytest.approx(log.time[known] - log.time[known][0], abs=1e-6)
    fix = log["gnss_pvt_data"]
    apart = (fix.datetime - log.utc[fix.sample]) / np.timedelta64(1, "ms")
    assert np.abs(apart).max() < 0.25
