"""Runs, devices on a bus, losses, rates, and UTC and units in tables."""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Hashable
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

import xbus
from conftest import counter, differences, facts, fine
from streams import dirty, frame, gnssins, mtdata2, packet
from test_cli import FIELD, WALK, run
from xbus.describe.log_summary import LogSummary
from xbus.log.rates import Rates, SharedRates
from xbus.log.runs import PartRuns, Runs
from xbus.protocol.tables import QUANTITIES
from xbus.report import gather

WAKE_UP = 0x3E


def samples(
    count: int, *, rate: int = 100, first: int = 0, ticks: int = 0, bid: int = 0xFF
) -> list[bytes]:
    """Returns samples with counter, time and temperature."""
    return [
        mtdata2(
            counter(first + index),
            fine(ticks + index * 10_000 // rate),
            packet(0x0810, struct.pack(">f", index)),
            bid=bid,
        )
        for index in range(count)
    ]


def power_cycle() -> bytes:
    """Returns 10 s at 100 Hz, a restart, and 10 s more."""
    first = samples(1000, first=30_000, ticks=1_000_000)
    return b"".join([*first, frame(WAKE_UP), *samples(1000, ticks=5_700)])


def info(tmp_path: Path, data: bytes) -> tuple[dict[str, Any], str]:
    """Returns what ``xbus info`` prints about a log, as JSON and as text."""
    path = tmp_path / "log.mtb"
    path.write_bytes(data)
    facts = json.loads(run("info", str(path), "--json").stdout)[0]
    return facts, " ".join(run("info", str(path)).stdout.split())


def test_power_cycle(tmp_path: Path) -> None:
    data = power_cycle()
    log = xbus.read_log(data)
    assert log.duration == pytest.approx(19.98)
    assert log["temperature"].rate == pytest.approx(100)
    assert log["temperature"].nominal_rate == 100
    assert log.runs.tolist() == [
        (255, 0, 999, 100.0, pytest.approx(9.99)),
        (255, 1000, 1999, 0.57, pytest.approx(9.99)),
    ]
    assert log.stats.lost_samples == 0
    facts, text = info(tmp_path, data)
    assert facts["duration_s"] == 19.98
    assert [run["duration_s"] for run in facts["runs"]] == [9.99, 9.99]
    assert {row["rate_hz"] for row in facts["quantities"]} == {100.0}
    assert "19.98 s, restarted once, after 10.0 s" in text


def test_events_after_a_restart(tmp_path: Path) -> None:
    """Their times are seconds recorded, whatever the clock shows: after the restart it starts near zero."""
    first = b"".join(mtdata2(counter(at), fine(5_000_000 + 100 * at)) for at in range(1000))
    second = [mtdata2(counter(at), fine(5800 + 100 * at)) for at in range(200)]
    data = first + frame(WAKE_UP) + b"".join(second[:50]) + frame(0x42, b"\x1e")
    data += b"".join(second[50:100] + second[110:])
    facts, text = info(tmp_path, data)
    assert "10.98 10 1,100" in text  # the last sample before the gap
    assert "after 10.48 s: Error 30" in text
    (gap,), (event,) = facts["gaps"], facts["events"]
    assert gap == {
        "sample": 1100,
        "bid": 255,
        "time_s": 1.68,
        "recorded_s": 11.09,
        "after_s": 10.98,
        "lost": 10,
    }
    assert (event["time_s"], event["recorded_s"]) == (1.07, 10.48)


def test_an_event_after_a_sample_without_time_in_a_later_run(tmp_path: Path) -> None:
    """Its time is the last known one, in the run to which that belongs."""
    first = b"".join(mtdata2(counter(at), fine(5_000_000 + 100 * at)) for at in range(1000))
    data = first + frame(WAKE_UP) + mtdata2(counter(0)) + frame(0x42, b"\x1e")
    data += b"".join(mtdata2(counter(at), fine(5800 + 100 * at)) for at in range(1, 50))
    facts, text = info(tmp_path, data)
    assert "after 9.99 s: Error 30" in text
    (event,) = facts["events"]
    assert (event["time_s"], event["recorded_s"]) == (509.99, 9.99)
    assert gather(data).events.rows.tolist() == pytest.approx([10.0])


def test_gaps_and_events_of_two_devices(tmp_path: Path) -> None:
    """Their times are those of the device to which they belong, whose BID the list of gaps has."""
    rows = [(bid, at) for at in range(100) for bid in (1, 2) if not (bid == 2 and 50 <= at < 60)]
    frames = [mtdata2(counter(at), fine(1_000_000 * bid + 100 * at), bid=bid) for bid, at in rows]
    frames.insert(rows.index((1, 55)), frame(0x42, b"\x1e", bid=2))
    facts, text = info(tmp_path, b"".join(frames))
    assert "BID after/s lost next sample 2 0.49 10" in text
    assert "after 0.49 s: Error 30" in text
    (gap,), (event,) = facts["gaps"], facts["events"]
    assert (gap["bid"], gap["time_s"], gap["after_s"]) == (2, 200.6, 0.49)
    assert (event["time_s"], event["recorded_s"]) == (200.49, 0.49)


@pytest.mark.parametrize("message", [b"", frame(WAKE_UP)])
def test_restart_of_counter_and_clock(message: bytes) -> None:
    """A restart is found with and without the WakeUp."""
    first = [
        mtdata2(counter(0x7530), fine(5_000_000)),
        mtdata2(counter(0x7531), fine(5_000_100)),
    ]
    second = [mtdata2(counter(0), fine(6_000)), mtdata2(counter(1), fine(6_100))]
    log = xbus.read_log(b"".join([*first, message, *second]))
    assert log.runs["duration"].tolist() == pytest.approx([0.01, 0.01])
    assert (log.runs["first"].tolist(), log.runs["last"].tolist()) == ([0, 2], [1, 3])
    assert log.duration == pytest.approx(0.02)
    assert log["packet_counter"].rate == pytest.approx(100)
    assert log.stats.lost_samples == 0


def test_step_back_of_a_stamp_is_no_restart() -> None:
    """A clock that steps back while the counter continues is a damaged stamp."""
    stamps = [100_000, 100_100, 50_000, 100_300]
    log = xbus.read_log(
        b"".join(mtdata2(counter(i), fine(ticks)) for i, ticks in enumerate(stamps))
    )
    assert len(log.runs) == 1


def bus() -> bytes:
    """Returns 2 s of devices 1 and 2 at 100 Hz, and of 3 at 50 Hz, with identifiers."""
    one = samples(200, bid=1, first=5, ticks=900_000)
    two = samples(200, bid=2, first=40_000, ticks=77)
    three = samples(100, rate=50, bid=3, ticks=5_000)
    frames = [frame(0x01, bytes.fromhex(f"0080000{bid}"), bid=bid) for bid in (1, 2, 3)]
    for index in range(200):
        frames += [one[index], two[index]]
        if index % 2 == 0:
            frames.append(three[index // 2])
    return b"".join(frames)


def test_devices_on_a_bus(tmp_path: Path) -> None:
    data = bus()
    log = xbus.read_log(data)
    assert [(row.bid, row.device_id, row.samples) for row in log.devices] == [
        (1, 0x800001, 200),
        (2, 0x800002, 200),
        (3, 0x800003, 100),
    ]
    assert log.duration == pytest.approx(1.99)
    assert log.runs["bid"].tolist() == [1, 2, 3]
    assert log.to_arrow().column("bid").to_pylist() == log.bid.tolist()
    assert log.to_arrow("temperature").column("bid").to_pylist() == log.bid.tolist()
    facts, text = info(tmp_path, data)
    assert [(row["bid"], row["rate_hz"], row["nominal_rate_hz"]) for row in facts["devices"]] == [
        (1, 100.0, 100.0),
        (2, 100.0, 100.0),
        (3, 50.0, 50.0),
    ]
    assert facts["duration_s"] == 1.99
    assert "BID 2 id 00800002, 200 samples in 1.99 s, 100.0 Hz" in text


@pytest.mark.parametrize("block", [40, 1 << 20])
def test_the_damage_of_a_bus_is_that_of_each_device(tmp_path: Path, block: int) -> None:
    path = tmp_path / "bus.mtb"
    one, two = (b"".join(samples(50, bid=bid)) for bid in (1, 2))
    path.write_bytes(one + b"\xfa\xff\x36" + two)
    for bid in (1, 2):
        logs = [xbus.read_log(path, bid=bid), xbus.read_log(path).device(bid)]
        for log in logs:
            assert log.damage[["offset", "length"]].tolist() == [(len(one), 3)]
            assert (log.stats.skipped_bytes, log.stats.bytes) == (3, len(one) + 3)
        parts = list(xbus.iter_log(path, bid=bid, block_bytes=block))
        assert [row for part in parts for row in part.damage.tolist()] == logs[0].damage.tolist()
        assert sum(part.stats.skipped_bytes for part in parts) == 3
    text = run("info", str(path), "--bid", "2").stdout
    assert "3 bytes of damage in 1 place, 0.25 % of the bytes" in text
    out = run("decode", str(path), "--bid", "1", "-o", str(tmp_path / "one.csv")).stderr
    assert "no samples lost, 3 bytes of damage in 1 place" in out


@given(
    st.lists(st.tuples(st.integers(1, 3), st.integers(0, 3)), min_size=1, max_size=60),
    st.integers(1, 500),
)
def test_interleaved_devices_equal_each_alone(order: list[tuple[int, int]], block: int) -> None:
    """Some samples are lost, and devices restart; each has its own counter, time and messages."""
    alone: dict[int, list[bytes]] = {}
    together: list[bytes] = []
    counts = {1: 10, 2: 65_530, 3: 0}
    for bid, what in order:
        if what == 3:
            sent = frame(WAKE_UP, bid=bid)
        else:
            counts[bid] += 1 + what
            value = packet(0x0810, struct.pack(">f", len(together)))
            more = (
                [packet(0x7020, bytes(4) + b"\1" + bytes(7))] if what else [packet(0xE990, b"abc")]
            )
            sent = mtdata2(counter(counts[bid]), fine(counts[bid] * 100), value, *more, bid=bid)
        alone.setdefault(bid, []).append(sent)
        together.append(sent)
    data = b"".join(together)
    log = xbus.read_log(data)
    for device in log.devices:
        own = log.device(device.bid)
        expected = facts(xbus.read_log(b"".join(alone[device.bid])))
        parts = xbus.iter_log(data, bid=device.bid, block_bytes=block)
        for found in (facts(own), facts(*parts)):
            for content in (found, expected):
                content["messages"] = [(m[0], m[1], m[2], m[4]) for m in content["messages"]]
                del content["offset"]
            assert differences(found, expected) == []
            expected = facts(xbus.read_log(b"".join(alone[device.bid])))
        assert own.runs.tolist() == [
            (bid, first, last, start, pytest.approx(duration, nan_ok=True))
            for bid, first, last, start, duration in xbus.read_log(
                b"".join(alone[device.bid])
            ).runs.tolist()
        ]


def test_the_runs_of_many_devices_are_added_up_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """The work for a device does not depend on how many others there are."""
    bids = range(1, 255)
    sent = [samples(5, first=3 * bid, ticks=100 * bid, bid=bid) for bid in bids]
    log = xbus.read_log(b"".join(message for row in zip(*sent, strict=True) for message in row))
    summary = LogSummary([log])
    counted = Mock(wraps=summary.runs.of_devices)
    monkeypatch.setattr(summary.runs, "of_devices", counted)
    devices = summary.devices
    counted.assert_called_once()
    assert [(device.bid, device.samples) for device in devices] == [(bid, 5) for bid in bids]
    assert [device.duration for device in devices] == pytest.approx([0.04] * len(bids))


def test_a_bid_is_no_device_identifier() -> None:
    """A device may report an identifier that is the BID of another one, such as 0."""
    named = frame(0x01, bytes.fromhex("00000000"), bid=1)
    log = named + b"".join(samples(100, bid=1) + samples(50, bid=0))
    assert xbus.read_log(log, bid=0).bid.tolist() == [0] * 50
    assert [part.samples for part in xbus.split_log(log, bid=0)] == [50]


def test_a_device_without_identity_has_none() -> None:
    """What one device of a bus says about itself describes no other."""
    named = frame(0x01, bytes.fromhex("00800002"), bid=2)
    log = xbus.read_log(named + b"".join(samples(2, bid=1) + samples(2, bid=2)))
    assert [(device.bid, device.device_id) for device in log.devices] == [(1, None), (2, 0x800002)]
    assert (log.identity.device_id, log.device(2).identity.device_id) == (None, 0x800002)
    alone = xbus.read_log(named + b"".join(samples(2, bid=1)))
    assert alone.identity.device_id == 0x800002


def test_device_that_is_not_there() -> None:
    log = xbus.read_log(bus())
    assert log.device(0x800003).bid.tolist() == [3] * 100
    assert xbus.read_log(bus(), bid=3) == log.device(3)
    with pytest.raises(
        ValueError, match="no samples of device 9; the log has those of BID 1, 2, 3"
    ):
        log.device(9)


@pytest.mark.parametrize("read", [xbus.read_log, xbus.iter_log])
@pytest.mark.parametrize("bid", [-1, 256, 0x800003])
def test_numbers_that_are_no_bus_identifier(read: Any, bid: int) -> None:
    with pytest.raises(ValueError, match=f"bid must be from 0 to 255, not {bid}; Log.device"):
        read(bus(), bid=bid)


def test_single_device_has_no_bid_column() -> None:
    log = xbus.read_log(b"".join(samples(3) + samples(3, first=3, ticks=300, bid=1)))
    assert "bid" not in log.to_arrow().column_names
    assert len(log.devices) == 1


def test_losses_over_wraps_of_the_counter(tmp_path: Path) -> None:
    counts = [10, 11, 12, 17, 18]
    ticks = [1000, 1100, 1200, 6_555_300, 6_555_400]
    data = b"".join(mtdata2(counter(c), fine(t)) for c, t in zip(counts, ticks, strict=True))
    log = xbus.read_log(data)
    assert (log.stats.lost_samples, log.stats.gaps) == (65_540, 1)
    assert log.packet_counter.tolist() == [10, 11, 12, 65_553, 65_554]
    assert log["packet_counter"].nominal_rate == 100
    assert info(tmp_path, data)[0]["lost_samples"] == 65_540


@given(st.integers(1, 12), st.integers(0, 65_535), st.sampled_from([50, 100, 400]))
def test_any_number_of_wraps(wraps: int, step: int, rate: int) -> None:
    lost = 65_536 * wraps + step
    before = samples(20, rate=rate)
    after = samples(5, rate=rate, first=20 + lost, ticks=(20 + lost) * 10_000 // rate)
    assert xbus.read_log(b"".join(before + after)).stats.lost_samples == lost


def test_a_pause_is_no_wrap() -> None:
    """The counter continues after a pause, so its pace does not explain the time."""
    data = samples(100) + samples(100, first=100, ticks=5_000_000)
    assert xbus.read_log(b"".join(data)).stats.lost_samples == 0


def test_nominal_rate_without_two_samples_in_a_row() -> None:
    """Every second sample is lost: the counter has the rate."""
    log = xbus.read_log(b"".join(mtdata2(counter(2 * i), fine(200 * i)) for i in range(100)))
    assert log.stats.lost_samples == 99
    assert log["packet_counter"].rate == pytest.approx(50)
    assert log["packet_counter"].nominal_rate == 100


@pytest.mark.parametrize("rate", [100, 400, 800])
def test_nominal_rate_with_losses(rate: int) -> None:
    """The mean rate falls with losses, the nominal rate does not."""
    kept = np.random.default_rng(rate).random(5000) < 0.1
    data = b"".join(np.array(samples(5000, rate=rate), object)[kept])
    column = xbus.read_log(data)["temperature"]
    assert column.rate < 0.15 * rate
    assert column.nominal_rate == pytest.approx(rate, rel=2e-3)


@given(
    st.lists(
        st.dictionaries(
            st.sampled_from("abcde"), st.sampled_from([range(6), range(0, 6, 2), range(3), []])
        ),
        max_size=6,
    )
)
def test_series_with_the_same_rows_share_their_rates(parts: list[dict[str, Any]]) -> None:
    shared, alone = SharedRates(), {name: Rates() for name in "abcde"}
    for number, part in enumerate(parts):
        run = number // 2  # each goes on in a second part
        runs = PartRuns(np.full(6, run), np.zeros(6, np.int64), (run,))
        time = (np.arange(6) * [1, 1, 2, 1, 1, 5] + 100 * number) / 100
        series: dict[Hashable, Any] = {
            name: np.array(rows, np.int64) for name, rows in part.items()
        }
        shared.add(runs, series, time)
        for name in part:
            alone[name].add(runs, series[name], time)
    names = {name for part in parts for name in part}
    for name in names:
        found, expected = (
            (rates.mean, rates.nominal(6 * len(parts), has_counter=True))
            for rates in (shared[name], alone[name])
        )
        assert found == pytest.approx(expected, nan_ok=True)
        same = {
            other for other in names if all(part.get(other) == part.get(name) for part in parts)
        }
        assert {other for other in names if shared[other] is shared[name]} == same


def test_rate_gives_time_to_logs_without_time_stamps(tmp_path: Path) -> None:
    values = [*range(65_500, 65_536), *range(64)]
    data = b"".join(mtdata2(counter(value)) for value in values)
    log = xbus.read_log(data)
    assert np.isnan(log.time).all()
    assert math.isnan(log.duration)
    text = info(tmp_path, data)[1]
    assert "no time stamps; --rate HZ derives them from the packet counter" in text
    log = xbus.read_log(data, rate=100)
    assert log.time.tolist() == pytest.approx([(65_500 + index) / 100 for index in range(100)])
    assert log.duration == pytest.approx(0.99)
    assert log["packet_counter"].rate == pytest.approx(100)
    parts = xbus.iter_log(data, rate=100, block_bytes=100)
    assert np.concatenate([part.time for part in parts]).tolist() == log.time.tolist()


def test_rate_option(tmp_path: Path) -> None:
    (tmp_path / "log.mtb").write_bytes(b"".join(mtdata2(counter(value)) for value in range(101)))
    path, out = str(tmp_path / "log.mtb"), str(tmp_path / "log.parquet")
    assert "no time stamps (--rate HZ derives them" in run("decode", path, "-o", out).stderr
    assert "1.00 s" in run("decode", path, "-o", out, "--rate", "100").stderr
    assert pq.read_table(out)["time"].to_pylist() == [value / 100 for value in range(101)]
    assert json.loads(run("info", path, "--rate", "100", "--json").stdout)[0]["duration_s"] == 1.0


def test_rate_does_not_replace_time_stamps() -> None:
    data = b"".join(samples(10))
    assert xbus.read_log(data, rate=7) == xbus.read_log(data)


@pytest.mark.parametrize("rate", [0, -1, math.nan, math.inf])
def test_rate_must_be_positive(rate: float) -> None:
    with pytest.raises(ValueError, match="rate must be"):
        xbus.read_log(b"", rate=rate)


UTC = ">IHBBBBBB"


def test_utc_in_tables() -> None:
    """UTC is null where the device does not mark it as valid."""
    valid = packet(0x1010, struct.pack(UTC, 5, 2026, 7, 1, 12, 0, 0, 7))
    invalid = packet(0x1010, struct.pack(UTC, 5, 2020, 1, 1, 0, 0, 0, 3))
    log = xbus.read_log(
        mtdata2(counter(0), invalid) + mtdata2(counter(1), valid) + mtdata2(counter(2))
    )
    table = log.to_arrow()
    for name in ("utc", "utc_time"):
        assert [time is None for time in table.column(name).to_pylist()] == [True, False, True]
        assert str(table.column(name)[1]).startswith("2026-07-01 12:00:00")
    assert "utc" not in log.to_arrow(["packet_counter"]).column_names
    assert log.to_arrow(["packet_counter", "utc_time"]).column_names[:3] == [
        "sample",
        "time",
        "utc",
    ]


def test_struct_fields_in_tables_are_in_their_units() -> None:
    fields = {field.name: 0 for field in QUANTITIES["gnss_pvt_data"].fields}
    fields |= {"lat": 522_406_918, "hAcc": 2**32 - 1}
    log = xbus.read_log(xbus.encode_sample({"gnss_pvt_data": fields}))
    table = log.to_arrow()
    assert table.column("gnss_pvt_data_lat").to_pylist() == [52.2406918]
    assert table.schema.field("gnss_pvt_data_lat").metadata[b"unit"] == b"deg"
    assert table.column("gnss_pvt_data_hAcc").to_pylist() == [None]
    raw = log.to_arrow(raw=True)
    assert raw.column("gnss_pvt_data_hAcc").to_pylist() == [2**32 - 1]
    assert raw.column("gnss_pvt_data_lat").to_pylist() == [522_406_918]
    assert raw.schema.field("gnss_pvt_data_lat").metadata[b"unit"] == b"1e-7 deg"


def test_raw_option(tmp_path: Path) -> None:
    out = str(tmp_path / "walk.parquet")
    log = xbus.read_log(WALK)
    for options, keys in (([], None), (["--quantity", "gnss_pvt_data"], "gnss_pvt_data")):
        run("decode", WALK, "-o", out, *options, "--raw")
        assert pq.read_table(out).equals(log.to_arrow(keys, raw=True))
        run("decode", WALK, "-o", out, *options)
        assert pq.read_table(out).equals(log.to_arrow(keys))
    for wrong in (["--tracker", "1", "-o", "x.csv"], ["-o", "x.csv", "--rate-out", "10"]):
        assert run("decode", WALK, "--raw", *wrong).exit_code == 2


# ---------------------------------------------------------------------------------------------
# Parts of one run
# ---------------------------------------------------------------------------------------------


def runs_in_parts(data: bytes, block: int) -> tuple[Runs, list[PartRuns]]:
    runs = Runs()
    return runs, [runs.add(part.core) for part in xbus.iter_log(data, block_bytes=block)]


@pytest.mark.parametrize("block", [300, 5000, 1 << 20])
@pytest.mark.parametrize(
    "data",
    [
        Path(WALK).read_bytes(),
        Path(FIELD).read_bytes(),
        gnssins(300),
        dirty(300),
        b"".join(mtdata2(counter(i), fine(9 * i), bid=1 + i // 90) for i in range(300)),
        b"".join(mtdata2(counter(i)) for i in range(90)) + frame(0x3E) + gnssins(50),
        b"".join(mtdata2(counter(i), fine(9 * i), bid=(1, 0xFF)[i % 3 > 0]) for i in range(300)),
    ],
    ids=["walk", "field", "with position", "dirty", "two devices", "restart", "two BIDs"],
)
def test_a_part_of_one_run_adds_the_same(
    data: bytes, block: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    fast, parts = runs_in_parts(data, block)
    monkeypatch.setattr("xbus.log.runs._is_one_run", lambda *_: False)
    plain, expected = runs_in_parts(data, block)
    assert fast.rows.tobytes() == plain.rows.tobytes()
    for one, other in zip(parts, expected, strict=True):
        assert one.run.tolist() == other.run.tolist()
        assert one.lost.tolist() == other.lost.tolist()
        assert one.present == other.present


@pytest.mark.parametrize("bids", [[], [1], [0xFF, 1], [1, 0xFF, 1], [3, 1, 3, 0xFF, 2], [9] * 40])
def test_devices_of_a_part(bids: list[int]) -> None:
    """A device has the BID of its first sample; FF and 1 are one. Longer runs take the fast path."""
    for times in (1, 7):
        sent = [bid for bid in bids for _ in range(times)]
        part = xbus.read_log(b"".join(mtdata2(counter(0), bid=bid) for bid in sent)).core
        first = {1 if bid == 0xFF else bid: bid for bid in reversed(sent)}
        counts = {bid: [1 if bid == 0xFF else bid for bid in sent].count(bid) for bid in first}
        order = dict.fromkeys(1 if bid == 0xFF else bid for bid in sent)
        assert part.devices == [(first[device], counts[device]) for device in order]


@pytest.mark.parametrize("ticks", [[], [5], [5, 5, 9], [9, 5, 7], [None], [None, 5], [5, None, 9]])
def test_span_of_the_times_of_a_part(ticks: list[int | None]) -> None:
    samples = [counter(i) + (b"" if tick is None else fine(tick)) for i, tick in enumerate(ticks)]
    part = xbus.read_log(b"".join(mtdata2(packets) for packets in samples)).core
    known = part.time[~np.isnan(part.time)]
    earliest, latest, count, is_ascending = part.time_span
    assert count == len(known)
    assert is_ascending == (len(known) == len(ticks) and bool((np.diff(known) >= 0).all()))
    expected = [known.min(), known.max()] if count else [math.nan, math.nan]
    np.testing.assert_array_equal([earliest, latest], expected)
