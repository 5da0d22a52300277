"""Recordings as the output of virtual devices: every frame, unchanged, at the pace of its stamps."""

from __future__ import annotations

import gzip
import lzma
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import xbus
from conftest import OWN_CAPTURES, fine
from streams import frame, mtdata2, packet
from xbus.log.pacing import LONGEST_PAUSE, UNSTAMPED_RATE
from xbus.protocol.values import StringType
from xbus.sim.replay import Replay

WALK = OWN_CAPTURES / "walk.mtb"
FIELD = OWN_CAPTURES / "field.mtb"

PLAIN = mtdata2(packet(0x1020, b"\0\1"))
UNKNOWN = frame(0x5B, b"unheard of")
ERROR = frame(0x42, b"\x28")
ACK = frame(0x31)
WAKE_UP = frame(0x3E)


def at(seconds: float) -> bytes:
    """Returns a sample with this time stamp."""
    return mtdata2(fine(round(seconds * 10_000)))


def gnss(seconds: float) -> bytes:
    """Returns a sample of the receiver."""
    return mtdata2(fine(round(seconds * 10_000)), packet(0x7010, bytes(94)))


def played(data: bytes) -> list[tuple[float, bytes]]:
    """Returns what is sent, each with its time."""
    return Replay(data).play(0.0).take(1e9)


def times(*frames: bytes) -> list[float]:
    return [round(time, 6) for time, _ in played(b"".join(frames))]


@pytest.mark.parametrize("strings", [["EM1000"], [StringType.EM1000]])
def test_strings_without_a_checksum_are_sent_if_asked_for(strings: list[StringType | str]) -> None:
    em1000 = bytes.fromhex("00 90 7B 00 38 FE 00 00 39 30")
    data = b"".join([at(0.0), em1000, at(0.01), em1000 * 2, at(0.02)])
    found = Replay(data, strings=strings)
    assert len(found) == 6
    assert b"".join(sent for _, sent in found.play(0.0).take(1e9)) == data
    assert b"".join(sent for _, sent in played(data)) == at(0.0) + at(0.01) + at(0.02)


@pytest.mark.parametrize("path", [WALK, FIELD])
def test_all_samples_of_a_recording_are_sent_unchanged(path: Path) -> None:
    sent = b"".join(frame for _, frame in Replay(path).play(0.0).take(1e9))
    recorded, again = xbus.read_log(path), xbus.read_log(sent)
    assert len(again) == len(recorded)
    assert again.stats.skipped_bytes == 0
    assert list(again) == list(recorded)
    for key in recorded:
        assert again[key].values.tobytes() == recorded[key].values.tobytes()


def test_frames_keep_their_pace() -> None:
    log = xbus.read_log(WALK)
    expected = log.time[np.isfinite(log.time)]
    sent = np.array([time for time, _ in played(WALK.read_bytes())])
    assert sent[-1] == pytest.approx(expected[-1] - expected[0], abs=0.05)
    assert (np.diff(sent) >= 0).all()
    assert np.diff(sent).max() < 0.011


@pytest.mark.parametrize(
    ("frames", "expected"),
    [
        ([], []),
        ([at(5.0)], [0.0]),
        ([at(5.0), at(5.5), at(6.5)], [0.0, 0.5, 1.5]),
        # Without a stamp, or later than the others: between the neighbours.
        ([at(5.0), PLAIN, PLAIN, at(5.3)], [0.0, 0.1, 0.2, 0.3]),
        ([at(5.0), gnss(1.0), at(5.5), gnss(9.0), at(6.0)], [0.0, 0.25, 0.5, 0.75, 1.0]),
        ([PLAIN, at(5.0), at(5.5), PLAIN], [0.0, 0.0, 0.5, 0.5]),
        # A restarted device, and an interrupted recording.
        ([at(60.0), at(60.5), at(0.1), at(0.2)], [0.0, 0.5, 0.5, 0.6]),
        ([at(5.0), at(500.0)], [0.0, LONGEST_PAUSE]),
        # Without stamps.
        ([PLAIN] * 3, [0.0, 1 / UNSTAMPED_RATE, 2 / UNSTAMPED_RATE]),
        # Other messages are sent with the next sample.
        ([ERROR, at(5.0), UNKNOWN, at(5.5), ERROR], [0.0, 0.0, 0.5, 0.5, 0.5]),
        ([ERROR, UNKNOWN], [0.0, 0.0]),
    ],
)  # fmt: skip
def test_time_stamps_set_the_pace(frames: list[bytes], expected: list[float]) -> None:
    assert times(*frames) == pytest.approx(expected)


def test_replies_are_skipped() -> None:
    data = b"".join([WAKE_UP, at(5.0), ACK, UNKNOWN, at(5.1), b"damage", ERROR])
    assert [frame for _, frame in played(data)] == [at(5.0), UNKNOWN, at(5.1), ERROR]


def test_long_frames_and_other_bus_identifiers() -> None:
    frames = [frame(0x5B, bytes(size), bid=3) for size in (0, 254, 255, 256, 4000)]
    frames.append(mtdata2(*[packet(0x4020, bytes(12))] * 40, bid=3))
    assert [frame for _, frame in played(b"".join(frames))] == frames


@given(st.lists(st.floats(0, 12)))
def test_the_number_of_calls_has_no_effect(cuts: list[float]) -> None:
    replay = Replay(WALK)
    playback = replay.play(0.5)
    taken = [playback.take(cut) for cut in sorted(cuts)]
    for (since, until), frames in zip(pairwise([-1.0, *sorted(cuts)]), taken, strict=True):
        assert all(since < time <= until + 1e-9 for time, _ in frames)
    assert [sent for part in taken for sent in part] + playback.take(99) == replay.play(0.5).take(
        99
    )
    assert playback.take(999) == []


def test_every_playback_starts_at_the_beginning() -> None:
    replay = Replay(WALK)
    first, later = replay.play(0.0).take(99), replay.play(50.0).take(99)
    assert [frame for _, frame in first] == [frame for _, frame in later]
    assert later[0][0] == 50.0


def test_latest_is_the_newest_sample() -> None:
    playback = Replay(b"".join([at(5.0), at(5.5), ERROR, at(6.0)])).play(10.0)
    assert [playback.latest(now) for now in (9.9, 10.0, 10.6, 99)] == [
        [],
        [at(5.0)],
        [at(5.5)],
        [at(6.0)],
    ]


def test_the_identity_is_that_of_the_recorded_device() -> None:
    identity = Replay(WALK).identity
    assert identity.product_code == "MTi-680G-8A1G6"
    assert identity.device_id == xbus.read_log(WALK).device_id
    assert str(identity.firmware) == "1.12.0"


def test_a_file_without_frames_is_empty_and_a_missing_file_raises() -> None:
    assert len(Replay(b"nothing at all")) == 0
    with pytest.raises(FileNotFoundError):
        Replay("nowhere.mtb")


def test_a_replay_begins_at_any_moment() -> None:
    replay, whole = Replay(WALK), Replay(WALK)
    frames = whole.play(0.0).take(100.0)
    assert whole.position == whole.duration
    for start in (0.0, 0.005, 5.0, replay.duration):
        replay.start = start
        playback = replay.play(50.0)
        assert replay.position == start
        assert playback.take(49.0) == []
        found = playback.take(100.0)
        expected = [(50.0 + time - start, frame) for time, frame in frames if time > start - 1e-6]
        assert [frame for _, frame in found] == [frame for _, frame in expected]
        assert [time for time, _ in found] == pytest.approx([time for time, _ in expected])
        assert replay.position == replay.duration


def test_the_position_goes_on_in_a_pause() -> None:
    samples = [xbus.encode_sample({"sample_time_fine": ticks}) for ticks in (0, 50_000)]
    replay = Replay(b"".join(samples))
    playback = replay.play(7.0)
    found = [(len(playback.take(until)), replay.position) for until in (7.0, 9.0, 12.5)]
    assert found == [(1, 0.0), (0, 2.0), (1, 5.0)]


def test_pieces_are_replayed_as_one(tmp_path: Path) -> None:
    data = WALK.read_bytes()
    paths = [tmp_path / "walk.mtb", tmp_path / "walk-0001.mtb"]
    for path, piece in zip(paths, (data[:70_001], data[70_001:]), strict=True):  # within a frame
        path.write_bytes(piece)
    assert Replay(paths).play(0.0).take(100.0) == Replay(data).play(0.0).take(100.0)


@pytest.mark.parametrize(("suffix", "compress"), [(".gz", gzip.compress), (".xz", lzma.compress)])
def test_a_compressed_recording_is_replayed(
    suffix: str, compress: Callable[[bytes], bytes], tmp_path: Path
) -> None:
    path = tmp_path / f"walk.mtb{suffix}"
    path.write_bytes(compress(WALK.read_bytes()))
    assert Replay(path).play(0.0).take(100.0) == Replay(WALK).play(0.0).take(100.0)
