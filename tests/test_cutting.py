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
from xbus.log.cutting import split_by_size
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
    for number, chunk in split_by_size(io.BytesIO(data), cut_parts, max(size, 500)):
        pieces[number] = pieces.get(number, b"") + chunk
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
        ((float("nan"), 2), "not NaN"),
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


def test_wrong_calls(folder: Path) -> None:
    for args, words in (
        (["cut", WALK, "-o", "x.mtb"], "needs --from, --to, or both"),
        (["split", WALK, "--out-dir", "x"], "choose one of --size, --time and --device"),
        (["split", WALK, "--size", "3s", "--out-dir", "x"], "has the unit of the other option"),
        (["split", WALK, "--time", "soon", "--out-dir", "x"], "neither a size"),
        (["cut", WALK, FIELD, "--to", "1", "-o", "x.mtb"], "cut each by itself"),
    ):
        result = run(*args)
        assert result.exit_code == 2
        assert words in " ".join(result.stderr.split())
    Path("walk.mtb").write_bytes(DATA)
    result = run("split", "walk.mtb", "--size", "40kB", "--out-dir", ".")
    assert (result.exit_code, "OUT is the input" in result.stderr) == (2, True)
    assert Path("walk.mtb").read_bytes() == DATA


def test_standard_input(folder: Path) -> None:
    assert run("cut", "-", "--to", "5", "-o", "part.mtb", stdin=DATA).exit_code == 0
    assert Path("part.mtb").read_bytes() == DATA[: LOG.offset[rows(0, 5).stop]]
    output = sentence(run("cut", "-", "--to", "2026-11-22", "-o", "part.mtb", stdin=DATA))
    assert output.startswith("standard input: standard input is read once")
