"""Pickling and comparing: logs, columns, samples, messages, strings, flags."""

from __future__ import annotations

import copy
import multiprocessing
import pickle
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given

import xbus
from conftest import counter, damaged_streams, differences, facts, fine
from streams import damage, frame, mtdata2, packet, random_log, real
from test_arrivals import DATA, GOOD, written
from xbus.wire.struct import Struct

WALK = Path(__file__).parent / "captures" / "walk.mtb"
#: Something of everything: coordinates, structs, satellites, unknown packets, messages, strings, damage.
MIXED = b"".join(
    [
        frame(0x01, bytes.fromhex("0080005F")),
        mtdata2(counter(1), fine(100), real(0x2010, 1, 0, 0, 0), real(0x4020, 1, float("nan"), 3)),
        mtdata2(counter(2), fine(200), real(0x2014, 0, 1, 0, 0), real(0x0812, 20.5)),
        b"noise",
        xbus.encode_string("HEHDT", {"heading": 12.5}),
        mtdata2(fine(300), packet(0x7020, bytes.fromhex("000003E8 02 000000 01020304 05060708"))),
        mtdata2(counter(9), fine(900), packet(0x7770, b"what"), packet(0x0810, bytes(3))),
        mtdata2(packet(0xE020, bytes(4)), packet(0x1010, bytes.fromhex("00000001 07E9 07 0D 09 15 22 07"))),
        frame(0x42, b"\x04"),
        bytes(3),
    ]
)  # fmt: skip


NAN, OTHER_NAN = bytes.fromhex("7FC00000"), bytes.fromhex("7FC00001")


def logs() -> list[xbus.Log]:
    """Whole logs, logs with some quantities, and parts."""
    random_one = random_log(random.Random(5), 40)
    return [
        xbus.read_log(b""),
        xbus.read_log(MIXED),
        xbus.read_log(MIXED, quantities=["acceleration"]),
        xbus.read_log(WALK),
        xbus.read_log(damage(random_one, random.Random(6), flips=1e-3)),
        *xbus.iter_log(MIXED, block_bytes=60),
        *xbus.iter_log(WALK, block_bytes=30_000, quantities=["acceleration", "status_word"]),
    ]


def again(value: Any, protocol: int = pickle.HIGHEST_PROTOCOL) -> Any:
    return pickle.loads(pickle.dumps(value, protocol))  # noqa: S301 - our own bytes


COPIES: list[Callable[[Any], Any]] = [
    *(lambda value, n=n: again(value, n) for n in range(2, pickle.HIGHEST_PROTOCOL + 1)),
    copy.copy,
    copy.deepcopy,
    lambda value: again(again(value)),
]


@pytest.mark.parametrize("copied", COPIES)
def test_logs(copied: Callable[[Any], Any]) -> None:
    for log in logs():
        other = copied(log)
        assert other == log
        assert (other != log) is False
        assert differences(facts(other), facts(log)) == []
        assert repr(other) == repr(log)
        assert other.first_sample == log.first_sample
        assert other.to_polars().equals(log.to_polars())


@given(damaged_streams())
def test_any_log(data: bytes) -> None:
    log = xbus.read_log(data)
    assert again(log) == log


@pytest.mark.parametrize("copied", COPIES)
def test_columns(copied: Callable[[Any], Any]) -> None:
    for log in logs():
        for key, column in log.items():
            other = copied(column)
            assert other == column
            assert other.to_polars().equals(log.to_polars(key))
            assert (other.rate == column.rate) or (np.isnan(other.rate) and np.isnan(column.rate))


def test_a_pickled_column_leaves_the_rest_of_the_log_behind() -> None:
    log = xbus.read_log(WALK)
    sizes = {key: len(pickle.dumps(column)) for key, column in log.items()}
    assert sizes["temperature"] < len(log) * 9 + 1_000  # a time and a byte per sample
    assert sum(sizes.values()) < 2 * len(pickle.dumps(log)) + len(log) * 9 * len(sizes)


def test_host_times(tmp_path: Path) -> None:
    """They go along: of samples, columns, strings and the clock, without the files."""
    data = DATA[:500] + xbus.encode_string("HEHDT", {"heading": 12.5}) + DATA[500:]
    path = written(tmp_path, data, GOOD)
    log = xbus.read_log(path)
    parts = list(xbus.iter_log(path, block_bytes=700))
    assert np.isfinite(log.host_time).any()
    assert np.isfinite(log.strings.host_time).all()
    pickles = [pickle.dumps(item) for item in (log, parts, log["packet_counter"], log.strings)]
    path.unlink()
    path.with_name("a.mtb.times").unlink()
    whole, pieces, column, strings = (pickle.loads(item) for item in pickles)  # noqa: S301
    assert (whole, pieces, column, strings) == (log, parts, log["packet_counter"], log.strings)
    assert whole.to_arrow().column_names == log.to_arrow().column_names
    assert "host_time" in column.to_arrow().column_names
    clock, other = log.host_clock, whole.host_clock
    assert clock is not None
    assert (other.offset, other.drift, other.fits) == (clock.offset, clock.drift, clock.fits)
    at = log.time[-1] + 1
    assert other.update(at, 1_790_000_002 * 10**9) == clock.update(at, 1_790_000_002 * 10**9)
    assert whole.times_fault == log.times_fault


def test_a_copied_clock_goes_on_separately() -> None:
    clock = xbus.HostClock()
    clock.update(1.0, 10**9)
    for other in (copy.copy(clock), copy.deepcopy(clock), again(clock), clock.copy()):
        before = clock.offset
        other.update(2.0, 3 * 10**9)
        assert clock.offset == before


def _mean(column: xbus.Column) -> tuple[float, xbus.Column]:
    return float(np.mean(column)), column


def _read(path: str) -> xbus.Log:
    return xbus.read_log(path)


def test_another_process() -> None:
    """There and back, with the start method that inherits nothing."""
    log = xbus.read_log(WALK)
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        (mean, column), other = (
            pool.apply(_mean, [log["temperature"]]),
            pool.apply(_read, [str(WALK)]),
        )
    assert mean == float(np.mean(log["temperature"]))
    assert (column, other) == (log["temperature"], log)


def test_a_state_of_another_version() -> None:
    make, (state,) = xbus.read_log(MIXED)._core.__reduce__()
    with pytest.raises(
        ValueError, match=r"saved by xbus 9.1.0, and this is .*: read the log again"
    ):
        make(state.replace(xbus.__version__.encode(), b"9.1.0", 1))
    for damaged in (state[:-1], state[: len(state) // 2], state + b"\0", b""):
        with pytest.raises(ValueError, match="the saved state is damaged"):
            make(damaged)


@pytest.mark.parametrize("value", [xbus.read_log(MIXED)._core, xbus.HostClock()._core])
def test_a_changed_state_is_refused(value: Any) -> None:
    """Its lengths may disagree, and then it would panic wherever it is used."""
    make, (state,) = value.__reduce__()
    for at in range(len(state)):
        changed = bytearray(state)
        changed[at] ^= 1 << at % 8
        with pytest.raises(ValueError, match="read the log again"):
            make(bytes(changed))


# ---------------------------------------------------------------------------------------------
# What makes logs differ
# ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (mtdata2(real(0x4020, 1, 2, 3)), mtdata2(real(0x4020, 1, 2, 4))),
        (mtdata2(real(0x0810, 0.0)), mtdata2(real(0x0810, -0.0))),
        (mtdata2(real(0x2010, 1, 0, 0, 0)), mtdata2(real(0x2014, 1, 0, 0, 0))),
        (mtdata2(packet(0x0810, NAN)), mtdata2(packet(0x0810, OTHER_NAN))),
        (mtdata2(real(0x4020, 1, 2, 3)), mtdata2(real(0x4021, 1, 2, 3))),
        (mtdata2(fine(1)), mtdata2(fine(2))),
        (mtdata2(fine(1)), mtdata2(fine(1), bid=2)),
        (mtdata2(fine(1)), mtdata2(fine(1)) * 2),
        (mtdata2(fine(1)), b"x" + mtdata2(fine(1))),
        (mtdata2(packet(0x7770, b"a")), mtdata2(packet(0x7770, b"b"))),
        (mtdata2(packet(0x7770, b"a")), mtdata2(packet(0x7771, b"a"))),
        (frame(0x42, b"\x04"), frame(0x42, b"\x03")),
        (frame(0x01, bytes(4)), frame(0x01, bytes(3) + b"\1")),
        (xbus.encode_string("HEHDT", {"heading": 1}), xbus.encode_string("HEHDT", {"heading": 2})),
        (b"abc", b"abcd"),
        (mtdata2(packet(0x7020, bytes.fromhex("000003E8 01 000000 01020304"))),
         mtdata2(packet(0x7020, bytes.fromhex("000003E8 01 000000 01020305")))),
    ],
)  # fmt: skip
def test_different_logs(one: bytes, other: bytes) -> None:
    first, second = xbus.read_log(one), xbus.read_log(other)
    assert first != second
    assert (first == second) is False
    assert first == xbus.read_log(one)


def test_what_is_compared_is_of_one_kind() -> None:
    """Of another kind it is different, and an array is compared element by element, as numpy does."""
    log = xbus.read_log(MIXED)
    strings, flags = log.strings, log["status_word"].flags
    things = [log, log["temperature"], log.messages, log.messages[0], strings, strings[0], flags,
              log.unknown[0x7770]]  # fmt: skip
    for one in things:
        for other in (*things, None, 1, "text", {}, []):
            assert bool(one == other) is (one is other)
    temperature: Any = log["temperature"]
    assert (temperature == np.array([20.5])).tolist() == [True]
    assert (np.array([20.5]) == temperature).tolist() == [True]


def test_hashes() -> None:
    """Messages and strings are values and have one; what holds arrays has none."""
    log = xbus.read_log(MIXED)
    assert hash(log.messages[0]) == hash(again(log.messages[0]))
    assert hash(log.strings[0]) == hash(again(log.strings[0]))
    sample = xbus.Sample(b"")
    for thing in (
        log,
        log["temperature"],
        log.messages,
        log.strings,
        log["status_word"].flags,
        sample,
    ):
        with pytest.raises(TypeError, match="unhashable"):
            hash(thing)


@pytest.mark.parametrize("copied", COPIES)
def test_what_a_log_holds(copied: Callable[[Any], Any]) -> None:
    for log in logs():
        for thing in (log.messages, log.strings, log.unknown, log.stats, log.identity):
            assert copied(thing) == thing
        assert copied(log.messages[:]) == log.messages[:]
        assert copied(log.strings[:]) == log.strings[:]
        for name in ("status_word", "status_byte"):
            if name in log:
                assert copied(log[name].flags) == log[name].flags
                assert copied(log[name].flags)["filter_valid"].flags.writeable is False


# ---------------------------------------------------------------------------------------------
# Samples
# ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("copied", COPIES)
def test_samples(copied: Callable[[Any], Any]) -> None:
    with xbus.connect("sim:MTi-680G") as device:
        samples = [device.read_sample() for _ in range(20)]
        assert copied(samples) == samples
        for sample in samples:
            other = copied(sample)
            assert (other == sample) is True
            assert (other.arrival, other.offset, other.bid) == (
                sample.arrival,
                sample.offset,
                sample.bid,
            )
            assert (other.time, other.host_time) == (sample.time, sample.host_time)
            assert list(other) == list(sample)
        assert samples[0] != samples[1]
        assert samples[0] != dict(samples[0])


def test_structs() -> None:
    payload = packet(0x7020, bytes.fromhex("000003E8 01 000000 01020304"))
    payload += packet(0x1010, bytes.fromhex("00000001 07E9 07 0D 09 15 22 07"))
    sample = xbus.Sample(payload)
    info, utc = sample["gnss_sat_info"], sample["utc_time"]
    assert isinstance(info, Struct)
    for copied in COPIES:
        assert copied(info) == info
        assert copied(info).satellites == info.satellites
        assert copied(utc).scaled == utc.scaled
    assert info == {"itow": 1000, "numSvs": 1, "res1": 0, "res2": 0, "res3": 0}
    assert info != Struct(sample["gnss_sat_info"]._fields, info.values())
