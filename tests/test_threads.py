"""Logs read by several threads equal logs read by one."""

from __future__ import annotations

import itertools
import os
import random
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import streams
import xbus
from streams import frame, mtdata2, packet, random_log
from xbus import DecodeError, _core

WAKEUP = frame(0x3E)


def restarted() -> bytes:
    return streams.ahrs(16_000) + WAKEUP + streams.ahrs(16_000, seed=2)


def several_devices() -> bytes:
    """Devices that send other packets in other orders, one of them more rarely."""
    rng = random.Random(1)
    frames = []
    for i in range(60_000):
        bid = rng.choice([1, 2, 2, 2, 0xFF])
        counter, time = (
            packet(0x1020, (i % 65_536).to_bytes(2, "big")),
            packet(0x1060, (i * 10).to_bytes(4, "big")),
        )
        value = streams.real(0x4020 if i < 30_000 else 0x4023, i, 1.5, -2.25)
        packets = [counter, time, value, packet(0x0810, b"\x41\xc3\0\0")][: bid % 4 + 1]
        frames.append(mtdata2(*packets, bid=bid))
    return b"".join(frames)


def anything() -> bytes:
    """All quantities, other messages, strings and damage."""
    rng = random.Random(2)
    return b"".join(random_log(rng, 2000) for _ in range(30))


STREAMS: dict[str, Callable[[], bytes]] = {
    "ahrs": lambda: streams.ahrs(40_000),
    "gnssins": lambda: streams.gnssins(25_000),
    "dirty": lambda: streams.dirty(40_000),
    "restarted": restarted,
    "several devices": several_devices,
    "anything": anything,
    "no frame": lambda: streams.only_fa(3 << 20),
    "lying headers": lambda: streams.lying(3 << 20),
}


@pytest.mark.parametrize("name", STREAMS)
def test_threads_do_not_change_the_log(name: str, tmp_path: Path) -> None:
    data = STREAMS[name]()
    assert len(data) > 2 << 20  # two blocks at least
    path = tmp_path / "log.mtb"
    path.write_bytes(data)
    for source in (data, path):
        one = xbus.read_log(source, threads=1)
        for threads in (2, 5):
            several = xbus.read_log(source, threads=threads)
            assert several == one
            assert list(several) == list(one)
            for key in one:
                assert np.array_equal(several[key].sample, one[key].sample)
                assert several[key].data_id == one[key].data_id
                assert several[key].values.strides == one[key].values.strides


def test_threads_keep_the_chosen_quantities() -> None:
    data = streams.gnssins(25_000)
    keep = ["acceleration", "gnss_pvt_data"]
    assert xbus.read_log(data, quantities=keep, threads=3) == xbus.read_log(
        data, quantities=keep, threads=1
    )


def test_threads_stop_at_the_first_damage() -> None:
    data = bytearray(streams.ahrs(40_000))
    for at in (30_000 * 88 + 20, 35_000 * 88 + 20):
        data[at] ^= 1
    found = []
    for threads in (1, 3):
        with pytest.raises(DecodeError) as error:
            xbus.read_log(bytes(data), strict=True, threads=threads)
        found.append((error.value.offset, str(error.value)))
    assert found[0] == found[1]
    assert found[0][0] == 30_000 * 88


@pytest.mark.parametrize("threads", [0, -1])
def test_at_least_one_thread(threads: int) -> None:
    with pytest.raises(ValueError, match=f"threads must be at least 1, not {threads}"):
        xbus.read_log(b"", threads=threads)


def night(folder: Path) -> tuple[bytes, list[Path]]:
    """Returns a log and its pieces, of which one is empty and one ends in a frame."""
    data = streams.ahrs(60_000)
    cuts = [0, 1_000_003, 1_000_003, 3_500_000, 3_500_040, len(data)]
    paths = []
    for number, (start, end) in enumerate(itertools.pairwise(cuts)):
        paths.append(folder / (f"night-{number:04}.mtb" if number else "night.mtb"))
        paths[-1].write_bytes(data[start:end])
    return data, paths


def test_threads_read_pieces(tmp_path: Path) -> None:
    data, paths = night(tmp_path)
    whole = xbus.read_log(data, threads=1)
    assert xbus.read_log(paths[::-1], threads=3) == whole
    assert xbus.read_log(paths, threads=1) == whole


@pytest.mark.parametrize("threads", [1, 2])
def test_a_piece_that_becomes_shorter(threads: int, tmp_path: Path) -> None:
    _, paths = night(tmp_path)
    reader = _core.Reader(paths, limit=65_535, strict=False, wanted=None, threads=threads)
    os.truncate(paths[2], 1000)
    with pytest.raises(
        OSError, match=rf"the file has become shorter while it was read: '{paths[2]}'"
    ):
        reader.advance(10 << 20)
