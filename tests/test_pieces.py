"""Recordings in pieces: `read_log` and `iter_log` of a list."""

from __future__ import annotations

import gzip
import io
import os
import random
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import streams
import xbus
from conftest import OWN_CAPTURES, counter, differences, facts, fine
from streams import mtdata2, packet
from test_cli import run
from xbus import MessageId, encode_frame
from xbus.cli.failure import Failure
from xbus.cli.inputs import Input
from xbus.log.parts import LogChangedError
from xbus.log.pieces import piece_name, pieces_of
from xbus.log.read import reader_of
from xbus.log.source import Source

WALK = OWN_CAPTURES / "walk.mtb"
FIELD = OWN_CAPTURES / "field.mtb"
DATA = WALK.read_bytes()


def stamped(*times: float, count: int | None = None, bid: int = 255) -> bytes:
    """Returns samples with these times in s, and packet counters from `count` on."""
    data = b""
    for at, time in enumerate(times):
        packets = fine(round(time * 10_000)) + (b"" if count is None else counter(count + at))
        data += encode_frame(MessageId.MTData2, packets, bid=bid)
    return data


def device(number: int) -> bytes:
    return encode_frame(MessageId.DeviceID, number.to_bytes(4, "big"))


def saved(folder: Path, **pieces: bytes) -> list[Path]:
    """Writes files; ``walk_0001`` stands for walk-0001.mtb."""
    paths = []
    for name, data in pieces.items():
        paths.append(folder / f"{name.replace('_', '-')}.mtb")
        paths[-1].write_bytes(data)
    return paths


@pytest.mark.parametrize(
    ("name", "recording", "number"),
    [
        ("walk.mtb", "walk.mtb", 0),
        ("walk-0001.mtb", "walk.mtb", 1),
        ("a/walk-12345.mtb.gz", "a/walk.mtb", 12345),
        ("walk-001.mtb", "walk-001.mtb", 0),
        ("walk-2026-0003.mtb", "walk-2026.mtb", 3),
        ("walk-0001", "walk", 1),
        ("-0001.mtb", "-0001.mtb", 0),
    ],
)
def test_names(name: str, recording: str, number: int) -> None:
    assert piece_name(name) == (recording, number)


# Any cut, in any order


@settings(max_examples=10)
@given(
    st.lists(st.integers(0, len(DATA)), min_size=1, max_size=5), st.randoms(use_true_random=False)
)
def test_named_pieces_in_any_order_equal_the_whole(
    tmp_path_factory: pytest.TempPathFactory, cuts: list[int], rng: random.Random
) -> None:
    """The names give the order, so a piece may be a part of one frame, or empty."""
    folder = tmp_path_factory.mktemp("pieces")
    bounds = [0, *sorted(cuts), len(DATA)]
    paths = []
    for at, (start, end) in enumerate(pairwise(bounds)):
        paths.append(folder / (f"walk-{at:04}.mtb" if at else "walk.mtb"))
        paths[-1].write_bytes(DATA[start:end])
    rng.shuffle(paths)
    assert xbus.read_log(paths) == xbus.read_log(DATA)
    parts = list(xbus.iter_log([str(path) for path in paths], block_bytes=30_000))
    assert differences(facts(*parts), facts(xbus.read_log(DATA))) == []


@settings(max_examples=10)
@given(st.lists(st.integers(0, len(DATA)), max_size=5))
def test_pieces_in_order_equal_the_whole(cuts: list[int]) -> None:
    pieces = [DATA[start:end] for start, end in pairwise([0, *sorted(cuts), len(DATA)])]
    assert xbus.read_log(pieces) == xbus.read_log(DATA)


@settings(max_examples=10)
@given(
    st.lists(st.integers(1, len(DATA) // 2000), min_size=1, max_size=5, unique=True),
    st.randoms(use_true_random=False),
)
def test_pieces_with_samples_in_any_order_equal_the_whole(
    cuts: list[int], rng: random.Random
) -> None:
    """Without names, the times at their starts give the order."""
    bounds = [0, *(cut * 2000 - 7 for cut in sorted(cuts)), len(DATA)]
    pieces = [DATA[start:end] for start, end in pairwise(bounds)]
    rng.shuffle(pieces)
    assert xbus.read_log(pieces) == xbus.read_log(DATA)


def test_every_kind_of_source(tmp_path: Path) -> None:
    (path,) = saved(tmp_path, first=DATA[:50_000])
    array = np.frombuffer(DATA[50_000:70_000], np.uint8)
    pieces: list[Source] = [
        path,
        array,
        memoryview(DATA)[70_000:90_000],
        io.BytesIO(DATA[90_000:100_000]),
        bytearray(DATA[100_000:]),
    ]
    assert xbus.read_log(pieces) == xbus.read_log(DATA)
    assert xbus.read_log((DATA[:9000], DATA[9000:])) == xbus.read_log(DATA)


def test_one_piece_and_none() -> None:
    assert xbus.read_log([DATA]) == xbus.read_log(DATA)
    with pytest.raises(ValueError, match="at least one piece"):
        xbus.read_log([])


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes here")
@pytest.mark.parametrize("read", [xbus.read_log, xbus.split_log])
def test_a_pipe_is_no_piece(read: Any, tmp_path: Path) -> None:
    """It has no writer, for which a reader would wait."""
    names = [str(tmp_path / name) for name in ("a.mtb", "pipe")]
    Path(names[0]).write_bytes(DATA)
    os.mkfifo(names[1])
    for order in (names, names[::-1]):
        with pytest.raises(ValueError, match="pipe is a pipe and cannot be one of several pieces"):
            read(order)
        result = run("cut", *order, "--from", "0", "-o", str(tmp_path / "cut.mtb"))
        assert result.exit_code == 1
        assert result.stderr.startswith(f"xbus: {names[1]} is a pipe and cannot be one of several")


def test_a_stream_is_no_piece() -> None:
    class Pipe:
        def read(self, size: int = -1, /) -> bytes:
            return b""

    with pytest.raises(ValueError, match="a stream cannot be one of several pieces"):
        xbus.read_log([DATA, Pipe()])


# The clock of the device


def test_the_clock_may_wrap_between_pieces() -> None:
    for end in (429_496.7, 86_399.9):
        log = xbus.read_log([stamped(end - 0.1, end), stamped(0.05, 0.15)])
        assert log.stats.frames == 4


@pytest.mark.parametrize(
    ("one", "other", "reason"),
    [
        (stamped(9, 10), stamped(9.5, 11), "the clock goes back from 10.00 s to 9.50 s"),
        (stamped(9, 10), stamped(0, 1) + stamped(9, 10), "goes back from 10.00 s to 0.00 s"),
        (
            mtdata2(counter(7)),
            mtdata2(counter(7)),
            "the packet counter goes back from 7 to 7",
        ),
        (device(0x0680_0001) + stamped(1), device(0x0680_0002) + stamped(2), "device 06800002"),
        (stamped(1, bid=1), stamped(2, bid=2), "it has BID 2, not 1"),
    ],
)
def test_different_recordings(one: bytes, other: bytes, reason: str) -> None:
    with pytest.raises(ValueError, match=r"piece 2 does not continue piece 1: .*" + reason):
        xbus.read_log([one, other])
    with pytest.raises(ValueError, match="does not continue"):
        next(xbus.iter_log([one, other]))


def test_a_gap_between_pieces_is_counted() -> None:
    log = xbus.read_log([stamped(1.0, 1.01, count=5), stamped(1.05, 1.06, count=10)])
    assert (log.stats.lost_samples, log.stats.gaps) == (3, 1)


# Restarts between pieces


def test_a_restart_needs_consecutive_names_or_permission(tmp_path: Path) -> None:
    one, other = stamped(5.0, 5.01), stamped(0.0, 5.005)
    with pytest.raises(ValueError, match="allow_restart=True"):
        xbus.read_log([one, other])
    assert len(xbus.read_log([one, other], allow_restart=True)) == 4
    first, second = saved(tmp_path, walk=one, walk_0001=other)
    assert xbus.read_log([second, first])["sample_time_fine"].values.tolist() == [
        50_000, 50_100, 0, 50_050,
    ]  # fmt: skip
    assert pieces_of([second, first]).notes == [f"the device restarted before {second}"]
    third = saved(tmp_path, walk_0003=other)[0]
    with pytest.raises(ValueError, match=r"walk-0003.mtb does not continue .*walk.mtb"):
        xbus.read_log([first, third])


def test_a_copy_of_a_piece_is_no_restart(tmp_path: Path) -> None:
    piece = stamped(1, 2, 3)
    names = saved(tmp_path, walk=stamped(0), walk_0001=piece, walk_0002=piece)
    with pytest.raises(ValueError, match=r"walk-0002.mtb does not .*: it has the same samples"):
        xbus.read_log(names)
    assert len(xbus.read_log(names, allow_restart=True)) == 7


def test_a_device_that_appears_later_on_a_bus() -> None:
    """It names itself in a later piece than the first device does."""
    pieces = [
        device(1) + stamped(1, bid=1) + stamped(1, bid=2),
        encode_frame(MessageId.DeviceID, (2).to_bytes(4, "big"), bid=2)
        + stamped(2, bid=1)
        + stamped(2, bid=2),
    ]
    log = xbus.read_log(pieces)
    assert {device.bid: device.samples for device in log.devices} == {1: 2, 2: 2}


def test_a_piece_of_another_session_is_no_restart(tmp_path: Path) -> None:
    """The Configuration at the start of a file has the time at which the recording started."""
    payload = bytearray(118)
    payload[0:4] = (0x0680_0001).to_bytes(4, "big")
    payload[16:32] = b"2026112909000000"
    one = encode_frame(MessageId.Configuration, bytes(payload))
    payload[16:32] = b"2026112809000000"
    other = encode_frame(MessageId.Configuration, bytes(payload))
    names = saved(tmp_path, a=one + stamped(5, 6), a_0001=other + stamped(0, 1))
    with pytest.raises(ValueError, match="does not continue"):
        xbus.read_log(names)
    names = saved(tmp_path, a=one + stamped(5, 6), a_0001=one + stamped(0, 1))
    assert len(xbus.read_log(names)) == 4


def test_a_missing_piece_is_named(tmp_path: Path) -> None:
    names = saved(tmp_path, a=stamped(1), a_0003=stamped(9))
    assert pieces_of(names[::-1]).notes == [
        f"{tmp_path}/a-0001.mtb to {tmp_path}/a-0002.mtb are missing"
    ]


def test_a_missing_first_piece_is_named(tmp_path: Path) -> None:
    names = saved(tmp_path, a_0002=stamped(1, 2), a_0003=stamped(3))
    assert pieces_of(names).notes == [f"{tmp_path}/a.mtb to {tmp_path}/a-0001.mtb are missing"]


@pytest.mark.parametrize("date", [b"2026112909000000", b"0" * 16])
def test_pieces_around_missing_ones(
    date: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without the first file, a gap is accepted if the Configuration has the same start of the recording."""
    monkeypatch.chdir(tmp_path)
    payload = bytearray(118)
    payload[0:4] = (0x0680_0001).to_bytes(4, "big")
    payload[16:32] = date
    head = encode_frame(MessageId.Configuration, bytes(payload))
    saved(Path(), a_0001=head + stamped(5, 6, count=1), a_0003=head + stamped(900, 901, count=900))
    result = run("decode", ".", "-o", "out.npz")
    if date.strip(b"0"):
        assert result.exit_code == 0
        assert result.stderr.splitlines()[:2] == [
            "xbus: ./a.mtb is missing",
            "xbus: ./a-0002.mtb is missing",
        ]
        assert "samples lost in 1 gap" in result.stderr
    else:
        assert result.exit_code == 2
        assert "different recordings" in result.stderr


def test_a_repeated_configuration_is_no_restart() -> None:
    head = DATA[: xbus.read_log(DATA).offset[0]]
    cut = int(xbus.read_log(DATA).offset[500])
    log, whole = xbus.read_log([DATA[:cut], head + DATA[cut:]]), xbus.read_log(DATA)
    assert np.array_equal(log.time, whole.time, equal_nan=True)
    assert (log.duration, log.stats.lost_samples) == (whole.duration, 0)


@pytest.mark.parametrize("suffix", ["", ".gz"])
def test_a_piece_that_is_not_named_is_noted(tmp_path: Path, suffix: str) -> None:
    """Who names the first file of a night does not get an hour of it without a word."""
    pack = gzip.compress if suffix else bytes
    for name, piece in (("walk", DATA[:50_000]), ("walk-0001", DATA[50_000:])):
        (tmp_path / f"{name}.mtb{suffix}").write_bytes(pack(piece))
    first, second = (str(tmp_path / f"{name}.mtb{suffix}") for name in ("walk", "walk-0001"))
    missing = f"xbus: {second}, the piece after {first}, is not read; "
    for words in (["info"], ["decode", "-q", "-o", str(tmp_path / "walk.csv")]):
        assert f"{missing}name it too, or the folder\n" in run(*words, first).stderr
        for names in ([first, second], [second], [str(tmp_path)]):
            assert "is not read" not in run(*words, *names).stderr


def test_other_names_of_the_next_piece(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A piece that was named in another way is not missing."""
    for name, piece in (("walk", DATA[:50_000]), ("walk-0001", DATA[50_000:])):
        (tmp_path / f"{name}.mtb").write_bytes(piece)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "link.mtb").symlink_to("walk-0001.mtb")
    for other in (str(tmp_path / "walk-0001.mtb"), "walk-0001.mtb", "link.mtb"):
        assert "is not read" not in run("info", "./walk.mtb", other).stderr


def test_commands_that_read_one_file_note_the_next_piece(tmp_path: Path) -> None:
    for name, piece in (("walk", DATA[:50_000]), ("walk-0001", DATA[50_000:])):
        (tmp_path / f"{name}.mtb").write_bytes(piece)
    first, second = (str(tmp_path / f"{name}.mtb") for name in ("walk", "walk-0001"))
    note = f"xbus: {second}, the piece after {first}, is not read; this command reads one file\n"
    for words in (
        ["monitor", "--once", "1"],
        ["stream", "--to", "udp://127.0.0.1:9", "--speed", "1000"],
    ):
        assert note in run(*words, first).stderr
        assert "is not read" not in run(*words, second).stderr


def test_rotated_recording(tmp_path: Path) -> None:
    """Host times of the pieces are joined too."""
    with xbus.connect("sim:MTi-630") as device, device.record(
        tmp_path / "night.mtb", rotate_seconds=1
    ):  # fmt: skip
        device.listen(3.5)
    names = sorted(tmp_path.glob("*.mtb"))
    assert names[0].name == "night-0001.mtb"
    log = xbus.read_log(names)
    assert (np.diff(log.time) > 0).all()
    assert log.stats.lost_samples == 0
    assert np.isfinite(log.host_time).all()


def test_files_that_are_no_pieces_can_be_read_by_themselves() -> None:
    files = [io.BytesIO(b"start" + streams.ahrs(10)) for _ in range(2)]
    for file in files:
        file.seek(5)
    with pytest.raises(ValueError, match="read each recording by itself"):
        xbus.read_log(files)
    assert [len(xbus.read_log(file)) for file in files] == [10, 10]


def test_only_direct_continuations() -> None:
    def direct(*pieces: bytes) -> int:
        return len(pieces_of(pieces, direct=True).names)

    assert direct(stamped(1, 2), stamped(3)) == 2
    assert direct(stamped(1, count=7), stamped(2, count=8)) == 2
    assert direct(DATA[:50_000], DATA[50_000:50_009], DATA[50_009:]) == 3
    for one, other, reason in (
        (stamped(1, 2), stamped(20), "it begins 18.00 s later"),
        (stamped(1), stamped(2), "it begins 1.00 s later"),
        (stamped(1, count=7), stamped(2, count=18), "it begins 11 samples later"),
        (mtdata2(counter(1)), mtdata2(counter(5000)), "it begins 4,999 samples later"),
        (DATA[:50_000], b"$HEHDT" * 1000, "piece 2 has no samples that show it"),
        (mtdata2(packet(0x0810, b"ab")), mtdata2(packet(0x0810, b"ab")), "neither time stamps nor"),
    ):
        with pytest.raises(ValueError, match=reason):
            direct(one, other)


@pytest.fixture
def long_pieces(tmp_path: Path) -> list[Path]:
    """Three pieces, each of several reads."""
    data = streams.ahrs(30_000)
    cuts = [0, 10_000 * 88, 20_000 * 88, len(data)]
    pieces = {f"walk_{at}": data[start:end] for at, (start, end) in enumerate(pairwise(cuts))}
    return saved(tmp_path, **pieces)


@pytest.mark.parametrize("is_file", [False, True])
@pytest.mark.parametrize("number", [0, 1, 2])
def test_a_piece_that_becomes_shorter_while_it_is_read(
    long_pieces: list[Path], number: int, is_file: bool
) -> None:
    """The next piece does not continue it."""
    files = [path.open("rb") for path in long_pieces]
    parts = xbus.iter_log(files if is_file else long_pieces, block_bytes=200_000)
    assert len(next(parts)) > 2000
    os.truncate(long_pieces[number], 500_000)
    name = f"piece {number + 1}" if is_file else str(long_pieces[number])
    with pytest.raises(OSError, match="the file has become shorter while it was read") as error:
        list(parts)
    assert error.value.filename == name
    for file in files:
        file.close()


@pytest.mark.parametrize("threads", [1, 2])
def test_a_piece_that_becomes_shorter_while_it_is_read_at_once(
    long_pieces: list[Path], threads: int
) -> None:
    pieces = pieces_of(long_pieces)
    reader = reader_of(pieces, strict=False, quantities=None, strings=0, threads=threads)
    assert reader.advance(100_000)
    os.truncate(long_pieces[1], 500_000)
    with pytest.raises(OSError, match=r"become shorter while it was read: '.*walk-1\.mtb'"):
        list(iter(lambda: reader.advance(100_000), False))


@pytest.mark.parametrize("threads", [1, 2])
def test_a_piece_that_becomes_shorter_before_it_is_opened(
    long_pieces: list[Path], threads: int
) -> None:
    pieces = pieces_of(long_pieces)
    os.truncate(long_pieces[1], 0)

    def read() -> None:
        reader = reader_of(pieces, strict=False, quantities=None, strings=0, threads=threads)
        while reader.advance(100_000):
            pass

    with pytest.raises(OSError, match=r"become shorter while it was read: '.*walk-1\.mtb'"):
        read()


def test_a_piece_that_becomes_shorter_while_it_is_split(long_pieces: list[Path]) -> None:
    def shorten(_: int) -> None:
        os.truncate(long_pieces[1], 500_000)

    for threads in (1, 2):
        whole = long_pieces[1].read_bytes()
        with pytest.raises(LogChangedError, match=r"walk-1\.mtb changed while it was split"):
            xbus.split_log(long_pieces, block_bytes=100_000, threads=threads, progress=shorten)
        long_pieces[1].write_bytes(whole)


def test_commands_report_a_piece_that_becomes_shorter(long_pieces: list[Path]) -> None:
    names = list(map(str, long_pieces))
    with Input(names) as source:
        assert source.read(100_000)
        os.truncate(names[1], 500_000)
        with pytest.raises(
            Failure, match=r"cannot read .*walk-1\.mtb: the file has become shorter"
        ):
            list(iter(lambda: source.read(100_000), b""))
    with Input(names[:1]) as source:  # a single file ends where its end is
        source.read(100_000)
        os.truncate(names[0], 500_000)
        list(iter(lambda: source.read(100_000), b""))
        assert source.size == 500_000
