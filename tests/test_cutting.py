"""Parts of recordings: ``read_log(between=…)``, ``xbus cut`` and ``xbus split``."""

from __future__ import annotations

import io
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import xbus
from conftest import counter, fine
from streams import mtdata2
from test_cli import FIELD, WALK, run, sentence
from xbus import MessageId, encode_frame
from xbus.cli.piece_file import PieceFile
from xbus.log.arrivals import Arrivals
from xbus.log.cutting import Chunk, split_by_size
from xbus.log.pieces import piece_name
from xbus.log.read import cut_parts

DATA = Path(WALK).read_bytes()
LOG = xbus.read_log(DATA)
HEAD = b"".join(
    DATA[message.offset : message.offset + 5 + len(message.payload)]
    for message in sorted(LOG.messages, key=lambda message: message.mid != MessageId.Configuration)
)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def cut(*args: str) -> bytes:
    result = run("cut", *args, "-o", "part.mtb")
    assert result.exit_code == 0, result.stderr
    return Path("part.mtb").read_bytes()


def rows(start: float, end: float) -> slice:
    """Returns the samples between two times; late ones count as their neighbours."""
    steady = np.maximum.accumulate(LOG.time - LOG.time[0]) + 1e-6
    return slice(*np.searchsorted(steady, [start, end]).tolist())


# Bytes


def test_a_part_is_whole_frames_behind_the_configuration(folder: Path) -> None:
    part = cut(WALK, "--from", "2", "--to", "5")
    wanted = rows(2, 5)
    assert part == HEAD + DATA[LOG.offset[wanted.start] : LOG.offset[wanted.stop]]
    log = xbus.read_log("part.mtb")
    assert log.configuration == LOG.configuration
    assert np.array_equal(log.time, LOG.time[wanted])
    assert log.damage.size == 0


def test_the_ends_of_a_recording_are_kept(folder: Path) -> None:
    assert cut(WALK, "--from", "0") == DATA
    assert cut(WALK, "--to", "99") == DATA
    tail = cut(WALK, "--from", "9.5")
    assert DATA.endswith(tail.removeprefix(HEAD))


@settings(max_examples=15)
@given(st.lists(st.floats(0.01, 9.98), min_size=1, max_size=4, unique=True))
def test_cut_pieces_concatenate_to_the_whole(moments: list[float]) -> None:
    bounds = [None, *sorted(moments), None]
    logs = [
        xbus.read_log(DATA, between=(start, end))
        for start, end in pairwise(bounds)
        if start is None or end is None or rows(start, end).stop > rows(start, end).start
    ]
    assert sum(map(len, logs)) == len(LOG)
    for name, column in LOG.items():
        values = [log[name].values for log in logs if name in log]
        assert np.array_equal(np.concatenate(values), column.values)


@settings(max_examples=15)
@given(st.integers(1, len(DATA) + 1), st.sampled_from([WALK, FIELD]))
def test_split_by_size(size: int, source: str) -> None:
    """Without the repeated heads, the pieces are the recording, damage included."""
    data = Path(source).read_bytes()
    pieces: dict[int, bytes] = {}
    for chunk in split_by_size(io.BytesIO(data), cut_parts, max(size, 500)):
        pieces[chunk.piece] = pieces.get(chunk.piece, b"") + chunk.data
    numbers = sorted(pieces)
    offsets = xbus.read_log(data).offset
    joined = b""
    for number in numbers:
        piece, rest = pieces[number], data[len(joined) :]
        if number > numbers[0]:
            head = len(piece) - next(
                length for length in range(len(piece), 0, -1) if rest.startswith(piece[-length:])
            )
            piece = piece[head:]
            assert len(joined) in offsets
        joined += piece
        assert number == numbers[-1] or len(piece) >= max(size, 500)
    assert joined == data


# Moments


@pytest.mark.parametrize(
    "between",
    [
        ("2026-11-22T09:30:02", "2026-11-22 09:30:05Z"),
        ("2026-11-22T11:30:02+02:00", 5),
        (np.datetime64("2026-11-22T09:30:02"), np.float64(5)),
        (datetime(2026, 11, 22, 9, 30, 2, tzinfo=UTC), np.datetime64("2026-11-22T09:30:05")),
    ],
)
def test_utc(between: Any) -> None:
    assert xbus.read_log(DATA, between=between) == xbus.read_log(DATA, between=(2, 5))
    assert xbus.read_log(io.BytesIO(DATA), between=between) == xbus.read_log(DATA, between=(2, 5))


def test_utc_on_the_command_line(folder: Path) -> None:
    part = cut(WALK, "--from", "2026-11-22T09:30:02", "--to", "2026-11-22T09:30:05")
    assert part == cut(WALK, "--from", "2", "--to", "5")
    assert cut(WALK, "--from", "2026-01-01") == DATA


@pytest.mark.parametrize(
    ("between", "error"),
    [
        ((5, 2), "the end must be after the start"),
        ((float("nan"), 2), "not nan"),
        ((np.datetime64("NaT", "ns"), 2), "not NaT"),
        (("tomorrow", 2), "neither seconds nor UTC"),
        ((1, 2, 3), "two moments"),
    ],
)
def test_wrong_moments(between: Any, error: str) -> None:
    with pytest.raises(ValueError, match=error):
        xbus.read_log(DATA, between=between)


def test_unknown_times(folder: Path) -> None:
    with pytest.raises(ValueError, match="no time stamps"):
        xbus.read_log(mtdata2(counter(1)) + mtdata2(counter(2)), between=(0, 1))
    with pytest.raises(ValueError, match="no valid UTC"):
        xbus.read_log(mtdata2(fine(1)) + mtdata2(fine(2)), between=("2026-01-01", None))
    output = sentence(run("cut", WALK, "--from", "60", "-o", "part.mtb"))
    assert output == f"{WALK} has no samples between these times"
    assert list(folder.iterdir()) == []


def test_seconds_continue_after_a_gap_and_a_wrap() -> None:
    ticks = [2**32 - 200, 2**32 - 100, 0, 100, 600_100, 600_200]
    data = b"".join(mtdata2(counter(at), fine(value)) for at, value in enumerate(ticks))
    log = xbus.read_log(data, between=(0.015, 60.035))
    assert log["sample_time_fine"].values.tolist() == [0, 100, 600_100]


def test_parts_of_a_part() -> None:
    whole = xbus.read_log(DATA, between=(2, 5))
    parts = list(xbus.iter_log(DATA, between=(2, 5), block_bytes=9000))
    assert len(parts) > 3
    assert sum(map(len, parts)) == len(whole)


# Files


def test_split_files_are_pieces(folder: Path) -> None:
    for option, value in (("--size", "40kB"), ("--time", "3s")):
        result = run("split", WALK, option, value, "--out-dir", option)
        assert result.exit_code == 0
        names = sorted(Path(option).iterdir())
        assert names[0].name == "walk-0001.mtb"
        assert len(names) in (4, 5)
        log = xbus.read_log(names)
        assert np.array_equal(log.time, LOG.time)
        assert (log.stats.lost_samples, log.duration) == (0, LOG.duration)


def test_a_failed_split_leaves_no_file(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    written = 0

    def write(self: PieceFile, chunk: Chunk) -> None:
        nonlocal written
        written += len(chunk.data)
        if written > 100_000:
            raise OSError(28, "No space left on device")
        write_chunk(self, chunk)

    write_chunk = PieceFile.write
    monkeypatch.setattr(PieceFile, "write", write)
    failed = run("split", WALK, "--size", "40kB", "--out-dir", "parts")
    assert sentence(failed).startswith("cannot write parts/walk-0002.mtb: No space left")
    assert list(Path("parts").iterdir()) == []


def test_split_by_device(folder: Path) -> None:
    devices = {
        bid: [
            encode_frame(MessageId.MTData2, counter(at) + fine(100 * at), bid=bid)
            for at in range(9)
        ]
        for bid in (1, 2, 3)
    }
    mixed = b"".join(b"".join(frames) for frames in zip(*devices.values(), strict=True))
    Path("bus.mtb").write_bytes(b"noise" + mixed)
    assert run("split", "bus.mtb", "--device", "--out-dir", "out").exit_code == 0
    for bid, frames in devices.items():
        assert Path(f"out/bus-bid{bid}.mtb").read_bytes() == b"".join(frames)


def bus(head: bytes, bids: tuple[int, ...], length: int = 40) -> bytes:
    """Returns samples of devices in turn, 10 ms apart, behind other frames."""
    samples = (
        encode_frame(MessageId.MTData2, counter(at) + fine(100 * at + 5_000 * bid), bid=bid)
        for at in range(length)
        for bid in bids
    )
    return head + b"".join(samples)


def identities(log: xbus.Log) -> dict[int, tuple[int | None, str | None]]:
    return {device.bid: (device.device_id, device.product_code) for device in log.devices}


@pytest.mark.parametrize("bids", [(2,), (1, 2), (2, 3), (0xFF, 3)])
@pytest.mark.parametrize("is_late", [False, True])
def test_parts_by_device_identify_it(folder: Path, bids: tuple[int, ...], is_late: bool) -> None:
    """The master describes a bus; a device describes itself, at the start or later."""
    own = encode_frame(MessageId.DeviceID, bytes.fromhex("00340042"), bid=3)
    head = DATA[: LOG.offset[0]]
    data = bus(b"", bids) + head + own + bus(b"", bids) if is_late else bus(head + own, bids)
    Path("bus.mtb").write_bytes(data)
    whole = xbus.read_log(data)
    assert run("split", "bus.mtb", "--device", "--out-dir", "out").exit_code == 0
    for bid, identity in identities(whole).items():
        path = Path(f"out/bus-bid{1 if bid == 0xFF else bid}.mtb")
        part = xbus.read_log(path)
        assert identities(part) == {bid: identity}
        assert list(part.items()) == list(whole.device(bid).items())
        if identity != (None, None):
            assert part.messages.offset[0] == 0


@pytest.mark.parametrize("bid", [1, 2])
def test_cut_one_device(folder: Path, bid: int) -> None:
    """The part of a device is that of its own recording."""
    data = bus(b"", (1, 2))
    Path("bus.mtb").write_bytes(b"noise" + data)
    Path("alone.mtb").write_bytes(bus(b"", (bid,)))
    part = cut("bus.mtb", "--from", "0.1", "--to", "0.2", "--bid", str(bid))
    assert part == cut("alone.mtb", "--from", "0.1", "--to", "0.2")
    assert len(xbus.read_log(part)) == 10
    assert xbus.read_log(data, between=(0.1, 0.2), bid=bid) == xbus.read_log(part)
    for option in ("--time", "--size"):
        size = "0.1s" if option == "--time" else "1kB"
        args = ["split", "bus.mtb", option, size, "--bid", str(bid), "--out-dir", option]
        assert run(*args).exit_code == 0
        pieces = sorted(Path(option).iterdir(), key=lambda path: piece_name(path.name).number)
        assert len(pieces) > 1
        assert b"".join(piece.read_bytes() for piece in pieces) == bus(b"", (bid,))


def test_cut_a_device_that_is_not_there(folder: Path) -> None:
    Path("bus.mtb").write_bytes(bus(b"", (1, 3)))
    for args in (
        ["cut", "bus.mtb", "--from", "0", "--bid", "2", "-o", "x.mtb"],
        ["split", "bus.mtb", "--size", "1kB", "--bid", "2", "--out-dir", "."],
    ):
        assert sentence(run(*args)).endswith(
            "no samples of device 2; the log has those of BID 1, 3"
        )
    assert [path.name for path in folder.iterdir()] == ["bus.mtb"]


@pytest.mark.parametrize("args", [["--size", "1kB"], ["--device"]])
def test_split_does_not_mix_with_an_earlier_run(folder: Path, args: list[str]) -> None:
    """Readers would join the files of both."""
    Path("bus.mtb").write_bytes(bus(b"", (1, 3)))
    assert run("split", "bus.mtb", *args, "--out-dir", "out").exit_code == 0
    before = {path: path.read_bytes() for path in Path("out").iterdir()}
    shown = sentence(run("split", "bus.mtb", *args, "--out-dir", "out"))
    assert shown.startswith("there are files of an earlier run, such as out/bus")
    assert {path: path.read_bytes() for path in Path("out").iterdir()} == before


def test_cut_with_a_rate_and_hex(folder: Path) -> None:
    """Every input option of the other commands works here too."""
    data = b"".join(mtdata2(counter(at)) for at in range(30))
    Path("log.txt").write_text(data.hex(" "))
    part = cut("log.txt", "--hex", "--rate", "10", "--from", "1", "--to", "2")
    assert xbus.read_log(part)["packet_counter"].values.tolist() == list(range(10, 20))
    args = ["split", "log.txt", "--hex", "--rate", "10", "--time", "1s", "--out-dir", "out"]
    assert run(*args).exit_code == 0
    assert len(list(Path("out").iterdir())) == 3


# Arrivals


@pytest.fixture
def timed(folder: Path) -> xbus.Log:
    """A recording of two devices and a GNSS receiver with arrivals, some of them late."""
    log = xbus.read_log(DATA)
    end = np.append(log.offset[1:], len(DATA)).astype(np.int64)
    delay = np.random.default_rng(5).integers(2_000_000, 9_000_000, len(log))
    sent = np.maximum.accumulate(log.time * 1.00002) * 1e9
    time = np.maximum.accumulate(1_790_000_000 * 10**9 + sent.astype(np.int64) + delay)
    Path("walk.mtb").write_bytes(DATA)
    # Several samples are read at once, and reads end within frames.
    rows = np.arange(3, len(log), 4)
    ends, times = np.append(end[rows] - rows % 3, end[-1]), np.append(time[rows], time[-1] + 1000)
    Path("walk.mtb.times").write_bytes(b"".join(Arrivals(ends, times, len(DATA)).blocks()))
    whole = xbus.read_log("walk.mtb")
    assert np.isfinite(whole.host_time).sum() > 900
    return whole


@pytest.mark.parametrize("block", [None, 3_000, 40_000])
@pytest.mark.parametrize("between", [(2, 5), (None, 4), (9, None), (0, None), (2.345, 2.36)])
def test_host_times_of_a_part_are_those_of_the_whole(
    timed: xbus.Log, between: Any, block: int | None
) -> None:
    if block is None:
        parts = [xbus.read_log("walk.mtb", between=between)]
    else:
        parts = list(xbus.iter_log("walk.mtb", between=between, block_bytes=block))
    start, end = (moment if moment is not None else 99 * at for at, moment in enumerate(between))
    host = np.concatenate([part.host_time for part in parts])
    assert np.array_equal(host, timed.host_time[rows(start, end)], equal_nan=True)
    last = [part for part in parts if len(part)][-1]
    clock = next(iter(xbus.iter_log("walk.mtb", block_bytes=10**6))).host_clock
    if end >= 99:
        assert repr(last.host_clock) == repr(clock)
    assert last.host_clock is not None
    assert {part.times_fault for part in parts} == {None}


def test_host_times_of_a_part_of_pieces(timed: xbus.Log) -> None:
    assert run("split", "walk.mtb", "--time", "2.1s", "--out-dir", "out").exit_code == 0
    pieces = sorted(Path("out").glob("*.mtb"))
    assert len(pieces) == len(list(Path("out").glob("*.mtb.times"))) > 3
    joined = xbus.read_log(pieces)
    assert np.array_equal(joined.host_time, timed.host_time, equal_nan=True)
    part = xbus.read_log(pieces, between=(2, 5))
    assert np.array_equal(part.host_time, timed.host_time[rows(2, 5)], equal_nan=True)
    part = xbus.read_log(pieces, between=("2026-11-22T09:30:02", "2026-11-22T09:30:05"))
    assert np.array_equal(part.host_time, timed.host_time[rows(2, 5)], equal_nan=True)


def test_host_times_of_a_device(folder: Path) -> None:
    data = bus(b"", (1, 2), 200)
    log = xbus.read_log(data)
    end = np.append(log.offset[1:], len(data)).astype(np.int64)
    time = 10**18 + np.arange(len(end)) * 5_000_000
    Path("bus.mtb").write_bytes(data)
    Path("bus.mtb.times").write_bytes(b"".join(Arrivals(end, time, len(data)).blocks()))
    alone = xbus.read_log("bus.mtb", bid=2)
    assert np.isfinite(alone.host_time).all()
    part = xbus.read_log("bus.mtb", bid=2, between=(0.5, 1))
    assert len(part) == 50
    assert part.host_time.tolist() == alone.host_time[50:100].tolist()
    assert run("split", "bus.mtb", "--device", "--out-dir", "out").exit_code == 0
    assert xbus.read_log("out/bus-bid2.mtb").host_time.tolist() == alone.host_time.tolist()


def test_strings_of_a_part_keep_their_arrivals(folder: Path) -> None:
    line = b"$HEHDT,12.3,T*1F\r\n"
    data, ends = b"", []
    for at in range(100):
        data += mtdata2(counter(at), fine(100 * at)) + line
        ends.append(len(data))
    time = 10**18 + np.arange(100) * 10_000_000
    Path("log.mtb").write_bytes(data)
    arrivals = Arrivals(np.array(ends), time, len(data))
    Path("log.mtb.times").write_bytes(b"".join(arrivals.blocks()))
    whole = xbus.read_log("log.mtb")
    part = xbus.read_log("log.mtb", between=(0.2, 0.5))
    assert len(part.strings) == 30
    assert np.array_equal(part.strings.host_time, whole.strings.host_time[20:50])
    cut("log.mtb", "--from", "0.2", "--to", "0.5")
    assert np.array_equal(xbus.read_log("part.mtb").strings.host_time, part.strings.host_time)


def test_cut_writes_the_side_file(timed: xbus.Log) -> None:
    cut("walk.mtb", "--from", "2", "--to", "5")
    part = xbus.read_log("part.mtb")
    assert part.times_fault is None
    # The clock of the part knows less than that of the whole, but it finds the same line.
    apart = part.host_time - timed.host_time[rows(2, 5)]
    assert np.nanmax(np.abs(apart[20:])) < 0.005
    cut("walk.mtb", "--from", "0")
    assert np.array_equal(xbus.read_log("part.mtb").host_time, timed.host_time, equal_nan=True)


def test_a_side_file_of_another_part_does_not_stay(timed: xbus.Log) -> None:
    cut("walk.mtb", "--from", "2")
    assert Path("part.mtb.times").exists()
    cut(WALK, "--from", "3")
    assert not Path("part.mtb.times").exists()


def test_a_faulty_side_file_is_reported(timed: xbus.Log) -> None:
    Path("walk.mtb.times").write_bytes(b"garbage")
    for args in (
        ["cut", "--from", "2", "-o", "part.mtb"],
        ["split", "--time", "3s", "--out-dir", "out"],
    ):
        result = run(args[0], "walk.mtb", *args[1:])
        assert result.exit_code == 0
        assert "walk.mtb.times is not a side file of version 1" in result.stderr
    assert xbus.read_log("walk.mtb", between=(2, 5)).times_fault is not None


def test_parts_are_not_compressed(folder: Path) -> None:
    result = run("cut", WALK, "--from", "2", "-o", "part.mtb.gz")
    assert result.exit_code == 2
    assert "omit .gz" in result.stderr


def test_wrong_calls(folder: Path) -> None:
    for args, words in (
        (["cut", WALK, "-o", "x.mtb"], "needs --from, --to, or both"),
        (["split", WALK, "--out-dir", "x"], "choose one of --size, --time and --device"),
        (["split", WALK, "--size", "3s", "--out-dir", "x"], "has the unit of the other option"),
        (["split", WALK, "--time", "soon", "--out-dir", "x"], "neither a size"),
        (["cut", WALK, FIELD, "--to", "1", "-o", "x.mtb"], "cut each by itself"),
        (["cut", WALK, "--from", "5", "--to", "2", "-o", "x.mtb"], "2.0 is not after 5.0"),
        (["cut", WALK, "--from", "-1", "-o", "x.mtb"], "are not negative: -1.0"),
        (["cut", WALK, "--from", "soon", "-o", "x.mtb"], "'soon' is neither seconds nor UTC"),
        (["cut", WALK, "--from", "nan", "-o", "x.mtb"], "not nan"),
        (
            ["cut", WALK, "--from", "2026-11-22T10:00", "--to", "2026-11-22T09:00", "-o", "x.mtb"],
            "2026-11-22T09:00 is not after 2026-11-22T10:00",
        ),
        (
            ["cut", WALK, "--from", "2026-11-22T09:30:05", "--to", "2", "-o", "x.mtb"],
            "2.0 is not after 2026-11-22T09:30:05",
        ),
        (["cut", WALK, "--from", "2", "-o", "x.csv"], "xbus decode part.mtb -o x.csv"),
        (["cut", WALK, "--from", "2", "-o", "x.HTML"], "xbus report part.mtb -o x.HTML"),
    ):
        result = run(*args)
        assert (args, result.exit_code) == (args, 2)
        assert words in " ".join(result.stderr.split())
        assert not list(folder.iterdir())
    Path("walk.mtb").write_bytes(DATA)
    result = run("split", "walk.mtb", "--size", "40kB", "--out-dir", ".")
    assert (result.exit_code, "OUT is the input" in result.stderr) == (2, True)
    assert Path("walk.mtb").read_bytes() == DATA


def test_standard_input(folder: Path) -> None:
    assert run("cut", "-", "--to", "5", "-o", "part.mtb", stdin=DATA).exit_code == 0
    assert Path("part.mtb").read_bytes() == DATA[: LOG.offset[rows(0, 5).stop]]
    output = sentence(run("cut", "-", "--to", "2026-11-22", "-o", "part.mtb", stdin=DATA))
    assert output.startswith("standard input: UTC needs an input that can be read twice; save")
