"""Logs of output that is not decoded, and of Awinda trackers: what they contain, how much, and why."""

from __future__ import annotations

import json
import pickle
import random
from itertools import accumulate, pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

import streams
import xbus
from conftest import SEEDS, differences, edited, edits, facts
from streams import mtdata2, packet
from test_cli import run, sentence
from xbus import MessageId, encode_frame, encode_sample
from xbus.log import trackers
from xbus.log.trackers import RESTART_STEP, TrackerCounts, count_losses
from xbus.protocol.tables import QUANTITIES
from xbus.report import gather
from xbus.report.findings import findings

LEGACY = encode_frame(MessageId.MTData, bytes(50)) * 40
UNKNOWN = mtdata2(packet(0xC820, bytes(70))) * 30
SAMPLES = encode_sample({"temperature": 20.0, "packet_counter": 1})
TEXTS = {
    LEGACY: "40 messages MTData (0x32), 2.0 kB: no OutputMode and OutputSettings for 50 bytes",
    UNKNOWN: "30 packets 0xC820, 2.1 kB: xbus knows no layout",
}
ONE, OTHER = 0x00B42D4B, 0x00B42D4C


@pytest.fixture(autouse=True)
def _empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def written(data: bytes) -> str:
    Path("x.mtb").write_bytes(data)
    return "x.mtb"


def plain(text: str) -> str:
    """Returns a text without its line breaks."""
    return " ".join(text.split())


@pytest.mark.parametrize("data", [LEGACY, UNKNOWN], ids=["legacy", "unknown"])
@pytest.mark.parametrize("suffix", [".parquet", ".csv", ".npz"])
def test_decode_fails_if_nothing_is_decoded(data: bytes, suffix: str) -> None:
    result = run("decode", written(data), "-o", f"out{suffix}")
    assert f"x.mtb: nothing was decoded: {TEXTS[data]}" in sentence(result)
    assert not Path(f"out{suffix}").exists()


@pytest.mark.parametrize("data", [LEGACY, UNKNOWN], ids=["legacy", "unknown"])
def test_report_fails_if_nothing_is_decoded(data: bytes) -> None:
    for args in (["-o", "out.html"], ["--out-dir", "."]):
        result = run("report", written(data), *args)
        assert result.exit_code == 1
        assert f"xbus: x.mtb: nothing was decoded: {TEXTS[data]}" in result.stderr
    assert list(Path().glob("*.html")) == []


def test_report_of_strings_or_messages() -> None:
    """It has content, and its summary says that there are no samples."""
    text = xbus.encode_string("GPGGA", {})
    for data, words in (
        (text * 3, "x.html: no samples, 3 strings, no damage"),
        (encode_frame(MessageId.WakeUp) * 2, "x.html: no samples, 2 messages, no damage"),
    ):
        result = run("report", written(data), "-o", "x.html")
        assert (result.exit_code, result.stderr) == (0, f"{words}\n")


def test_a_quantity_that_is_not_there_is_another_failure() -> None:
    args = ["-o", "out.csv", "--quantity", "acceleration"]
    result = run("decode", written(SAMPLES + LEGACY), *args)
    assert "no acceleration in x.mtb" in sentence(result)
    assert "nothing was decoded" in sentence(run("decode", written(LEGACY), *args))


@pytest.mark.parametrize("data", [LEGACY, UNKNOWN], ids=["legacy", "unknown"])
def test_everything_names_what_is_left_out(data: bytes) -> None:
    file = written(SAMPLES + data)
    result = run("decode", file, "-o", "out.csv", "--json")
    assert f"not decoded: {TEXTS[data]}" in plain(result.stderr)
    [item] = json.loads(result.stdout)["undecoded"]
    assert (item["number"], item["size"]) == ((40, 2000) if data == LEGACY else (30, 2100))
    assert f"undecoded {TEXTS[data]}" in plain(run("info", file).stdout)
    [shown] = json.loads(run("info", file, "--json").stdout)
    assert shown["undecoded"] == [item]
    log = xbus.read_log(file)
    assert f"not decoded: {TEXTS[data]}" in repr(log)
    assert [found.to_dict() for found in log.undecoded] == [item]
    assert any(TEXTS[data] in found.text for found in findings(gather(file)))


def test_a_sound_log_leaves_nothing_out() -> None:
    result = run("decode", written(SAMPLES), "-o", "out.csv")
    assert "not decoded" not in result.stderr
    assert xbus.read_log(SAMPLES).undecoded == ()
    assert "undecoded" not in run("info", "x.mtb").stdout


def test_parts_add_up() -> None:
    data = (LEGACY + UNKNOWN) * 50
    (messages, packets) = xbus.read_log(data).undecoded
    parts = [part.undecoded for part in xbus.iter_log(data, block_bytes=5000)]
    assert sum(item.number for part in parts for item in part) == messages.number + packets.number
    [shown] = json.loads(run("info", written(data), "--json").stdout)
    assert shown["undecoded"] == [messages.to_dict(), packets.to_dict()]


# Awinda


def snapshot(device: int, frame: int, mag: tuple[int, int, int], *, again: bool = False) -> bytes:
    """Returns a sample as an Awinda master sends it, built from the layout and not from the table."""
    return mtdata2(snapshot_packet(device, frame, mag, again=again))


def snapshot_packet(
    device: int, frame: int, mag: tuple[int, int, int], *, again: bool = False
) -> bytes:
    data = device.to_bytes(4, "big") + frame.to_bytes(4, "big") + bytes(range(24))
    data += b"".join(number.to_bytes(2, "big", signed=True) for number in mag)
    return packet(0xC811 if again else 0xC810, data + bytes(8))


def awinda() -> bytes:
    """Two trackers: one sends 65,530 to 65,549 without 65,533 and 65,540, which comes again; one loses 3."""
    parts = []
    for frame in range(65530, 65550):
        if frame not in (65533, 65540):
            parts.append(snapshot(ONE, frame, (4096, -2048, frame - 65530)))
        if frame == 65544:
            parts.append(snapshot(ONE, 65540, (4096, -2048, 10), again=True))
        if frame not in (65535, 65536, 65539):
            parts.append(snapshot(OTHER, frame, (-4096, 0, 1)))
    return b"".join(parts)


def test_trackers() -> None:
    log = xbus.read_log(awinda())
    assert list(log.trackers) == [ONE, OTHER]
    one, other = log.trackers.values()
    assert one.packet_counter.tolist() == [n for n in range(65530, 65550) if n != 65533]
    assert (one.lost_samples, one.gaps) == (1, 1)
    assert (other.lost_samples, other.gaps) == (3, 2)
    assert one.magnetic_field.dtype == np.float64
    expected = [[1, -0.5, (n - 65530) / 4096] for n in range(65530, 65550) if n != 65533]
    assert one.magnetic_field.tolist() == expected
    assert np.array_equal(other.magnetic_field, np.tile([-1, 0, 1 / 4096], (17, 1)))
    assert log["awinda_snapshot"].values["frame"][one.sample[:2]].tolist() == [65530, 65531]
    assert "2 Awinda trackers, no orientation" in repr(log)
    assert pickle.loads(pickle.dumps(log)).trackers.keys() == log.trackers.keys()  # noqa: S301


def test_the_table_has_the_layout_of_the_vendor() -> None:
    [row] = xbus.read_log(snapshot(ONE, 7, (1, -2, 3)))["awinda_snapshot"].values.tolist()
    increments = [int.from_bytes(bytes(range(at, at + 4)), "big") for at in range(0, 24, 4)]
    assert row == (ONE, 7, *increments, 1, -2, 3, 0, 0, 0, 0)
    assert QUANTITIES["awinda_snapshot"].size == 46


def test_info_lists_the_trackers() -> None:
    file = written(awinda())
    text = plain(run("info", file).stdout)
    assert "00B42D4B 19 rows, 1 sample lost in 1 gap; 00B42D4C 17 rows, 3 samples lost" in text
    assert "from which the vendor's software computes the orientation: the file holds none" in text
    [shown] = json.loads(run("info", file, "--json").stdout)
    expected: list[dict[str, Any]] = [
        {"device_id": "00B42D4B", "rows": 19, "lost_samples": 1, "gaps": 1},
        {"device_id": "00B42D4C", "rows": 17, "lost_samples": 3, "gaps": 2},
    ]
    assert shown["trackers"] == expected


@pytest.mark.parametrize("tracker", ["00B42D4C", "b42d4c"])
def test_one_table_per_tracker(tracker: str) -> None:
    result = run("decode", written(awinda()), "-o", "out.parquet", "--tracker", tracker)
    table = pq.read_table("out.parquet")
    assert table.equals(xbus.read_log(awinda()).trackers[OTHER].to_arrow())
    assert table.column_names[:3] == ["sample", "packet_counter", "magnetic_field_x"]
    assert table.schema.field("magnetic_field_x").metadata == {b"unit": b"a.u."}
    assert "3 samples lost in 2 gaps" in result.stderr
    assert "--tracker" not in result.stderr
    assert "the file holds none" in plain(result.stderr)


def test_a_table_of_several_trackers_says_so() -> None:
    """Samples of two trackers in one message are one row."""
    shown = plain(run("decode", written(awinda()), "-o", "out.parquet").stderr)
    assert "--tracker writes all rows of one: 00B42D4B, 00B42D4C" in shown


def test_trackers_that_are_not_there() -> None:
    result = run("decode", written(awinda()), "-o", "out.csv", "--tracker", "1")
    assert "no tracker 1 in x.mtb; it has 00B42D4B, 00B42D4C" in sentence(result)
    result = run("decode", written(SAMPLES), "-o", "out.csv", "--tracker", "1")
    assert "it has no Awinda trackers" in sentence(result)


def missing(frames: list[int]) -> tuple[int, int]:
    """What `count_losses` returns, one number after the other."""
    runs: list[set[int]] = []
    last = highest = -1
    for frame in frames:
        if last < 0 or frame - last < -RESTART_STEP:
            runs.append(set())
            highest = frame
        last, highest = frame, max(frame, highest)
        if highest - frame <= RESTART_STEP:
            runs[-1].add(frame)
    steps = [b - a - 1 for run in runs for a, b in pairwise(sorted(run))]
    return sum(steps), sum(step > 0 for step in steps)


STEPS = [1, 1, 2, 0, -1, -3, 5, 10_000, -20_000, 70_000, -40_000]
STEPS += [sign * RESTART_STEP + by for sign in (-1, 1) for by in (-1, 0, 1)]


@given(st.integers(0, 2**20), st.lists(st.sampled_from(STEPS), max_size=40), st.integers(1, 9))
def test_losses_of_trackers_do_not_depend_on_the_parts(
    first: int, steps: list[int], size: int
) -> None:
    frames = list(accumulate([first, *steps], lambda frame, step: max(frame + step, 0)))
    counts = TrackerCounts()
    for at in range(0, len(frames), size):
        part = b"".join(snapshot(ONE, frame, (0, 0, 0)) for frame in frames[at : at + size])
        counts.add(xbus.read_log(part, threads=1)["awinda_snapshot"])
    expected = missing(frames)
    assert count_losses(np.array(frames)) == expected
    assert counts.summaries() == {ONE: ("00B42D4B", len(frames), *expected)}


def trackers_stream(rng: random.Random, messages: int) -> bytes:
    """Snapshots of some trackers, alone or together in a message; some are lost, some come again later."""
    frames = {rng.getrandbits(32): rng.randrange(65_000, 66_000) for _ in range(rng.randint(1, 5))}
    missing = [(next(iter(frames)), 64_999)]
    sent = []
    for _ in range(messages):
        packets = []
        for device in rng.sample(list(frames), rng.choice((1, 1, 1, len(frames)))):
            frames[device] += 1
            if rng.random() < 0.05:
                missing.append((device, frames[device]))
            else:
                packets.append(snapshot_packet(device, frames[device], (1, frames[device] % 99, 3)))
        if rng.random() < 0.05:
            packets.append(snapshot_packet(*rng.choice(missing), (1, 2, 3), again=True))
        if packets:
            sent.append(mtdata2(*packets[:4]))
    return b"".join(sent)


def counts_of(*parts: xbus.Log) -> dict[int, trackers.TrackerSummary]:
    counts = TrackerCounts()
    for part in parts:
        counts.add(part.get("awinda_snapshot"))
    return counts.summaries()


@given(SEEDS, st.lists(edits(), max_size=5), st.integers(1, 3000))
def test_parts_of_snapshots_are_the_whole(
    seed: int, changes: list[tuple[float, str, Any]], block: int
) -> None:
    data = edited(trackers_stream(random.Random(seed), 40), changes)
    log = xbus.read_log(data, threads=1)
    split = pickle.loads(pickle.dumps(xbus.split_log(data, block_bytes=block)))  # noqa: S301
    for parts in ([part.read() for part in split], list(xbus.iter_log(data, block_bytes=block))):
        assert differences(facts(*parts), facts(log)) == []
        assert counts_of(*parts) == counts_of(log)
    assert {key: one[2:] for key, one in counts_of(log).items()} == {
        key: (one.lost_samples, one.gaps) for key, one in log.trackers.items()
    }


def test_threads_read_snapshots_as_one() -> None:
    data = streams.damage(trackers_stream(random.Random(1), 40_000), random.Random(2), 1e-5)
    assert len(data) > 2 << 20  # two blocks at least
    log = xbus.read_log(data, threads=1)
    several = xbus.read_log(data, threads=3)
    assert several == log
    assert len(log.trackers) > 1
    for key, tracker in log.trackers.items():
        assert np.array_equal(several.trackers[key].sample, tracker.sample)
    parts = xbus.split_log(data, block_bytes=1 << 20)
    assert differences(facts(*(part.read() for part in parts)), facts(log)) == []
    assert counts_of(*(part.read() for part in parts)) == counts_of(log)


def test_counts_of_trackers_need_little_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(trackers, "MAX_TRACKERS", 3)
    counter = trackers._FrameCounter()
    for start in range(0, 1_000_000, 100_000):
        counter.add(np.arange(start, start + 100_000, 2))
        assert len(counter._recent) <= RESTART_STEP // 2 + 1
    assert counter.losses == (499_999, 499_999)
    counts = TrackerCounts()
    counts.add(
        xbus.read_log(b"".join(snapshot(n, n, (0, 0, 0)) for n in (7, 5, 6, 4, 5, 3)))[
            "awinda_snapshot"
        ]
    )
    assert [(key, counted.rows) for key, counted in counts.summaries().items()] == [
        (7, 1),
        (5, 2),
        (6, 1),
    ]


def test_a_message_names_some_trackers() -> None:
    data = b"".join(snapshot(1 + n, n, (0, 0, 0)) for n in range(40))
    result = run("decode", written(data), "-o", "out.csv", "--tracker", "0")
    assert "it has 00000001, 00000002," in sentence(result)
    assert sentence(result).endswith("00000020 and 8 more")


def test_the_report_has_the_trackers() -> None:
    texts = [found.text for found in findings(gather(awinda()))]
    assert any("tracker 00B42D4C: 3 samples lost in 2 gaps" in text for text in texts)
    assert any("the file holds none" in text for text in texts)


def test_losses_are_counted_within_runs() -> None:
    frames = np.array([70000, 70001, 70004, 3, 4, 6])
    assert count_losses(frames) == (3, 2)
    assert count_losses(np.empty(0, np.int64)) == (0, 0)
