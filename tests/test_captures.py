"""Recordings of a real device, and recordings that the project generates."""

from __future__ import annotations

from pathlib import Path

import pytest

import make_captures
import reference
import xbus
from conftest import OWN_CAPTURES, differences, facts, facts_of, read, shared

OWN = make_captures.captures()
REAL = [f"mtig710-{i}" for i in range(1, 6)]


@pytest.mark.parametrize("name", OWN)
def test_own_captures_match_their_program(name: str) -> None:
    """``python tests/make_captures.py`` writes the captures; they are not edited by hand."""
    assert (OWN_CAPTURES / name).read_bytes() == OWN[name]


def test_there_are_no_other_captures() -> None:
    assert {path.name for path in OWN_CAPTURES.iterdir()} == set(OWN)


def assert_capture_matches_reference(path: Path) -> xbus.Log:
    """Compares columns bit by bit; sample, offset, BID, time, counter; messages, damage, counts."""
    log = xbus.read_log(path)
    expected = facts_of(reference.decode(path.read_bytes()))
    assert differences(facts(log), expected) == []
    assert differences(facts(read(path.read_bytes(), fast=False)), expected) == []
    return log


@pytest.mark.parametrize("name", OWN)
def test_own_captures(name: str) -> None:
    assert_capture_matches_reference(OWN_CAPTURES / name)


@pytest.mark.parametrize("name", REAL)
def test_real_captures(name: str) -> None:
    log = assert_capture_matches_reference(shared(f"captures/{name}/raw.bin"))
    assert len(log) == 100
    assert (log.stats.skipped_bytes, log.stats.lost_samples, len(log.unknown)) == (0, 0, 0)


@pytest.mark.parametrize(
    ("name", "precision", "dtype"),
    [
        ("mtig710-1", "Float32", "f4"),
        ("mtig710-2", "Fp1220", "f8"),
        ("mtig710-3", "Fp1632", "f8"),
        ("mtig710-4", "Float64", "f8"),
    ],
)
def test_real_precisions(name: str, precision: str, dtype: str) -> None:
    """The device was configured to one precision, which all its real numbers have."""
    log = xbus.read_log(shared(f"captures/{name}/raw.bin"))
    reals = {item for item in log if log[item].precision is not None}
    assert reals == {
        *("acceleration", "delta_v", "rate_of_turn", "delta_q"),
        *("euler_angles", "lat_lon", "altitude_ellipsoid", "velocity_xyz"),
    }
    formats = {(log[real].precision, log[real].values.dtype.str[1:]) for real in reals}
    assert formats == {(precision, dtype)}


def test_walk_capture() -> None:
    """Ten seconds at 100 Hz, with GNSS data four times a second."""
    log = xbus.read_log(OWN_CAPTURES / "walk.mtb")
    assert len(log) == 1040
    rows = {item: len(log[item]) for item in log}
    assert rows == {
        **dict.fromkeys(["packet_counter", "sample_time_fine", "utc_time"], 1040),
        **dict.fromkeys(["quaternion", "euler_angles", "acceleration", "rate_of_turn"], 1000),
        **dict.fromkeys(["magnetic_field", "lat_lon", "altitude_ellipsoid"], 1000),
        **dict.fromkeys(["velocity_xyz", "status_word"], 1000),
        "baro_pressure": 100,
        "temperature": 10,
        "gnss_pvt_data": 40,
    }
    assert [message.name for message in log.messages] == ["Configuration", "FirmwareRev"]
    assert (log.device_id, log.product_code) == (0x8000A1B2, "MTi-680G-8A1G6")
    assert str(log.firmware) == "1.12.0"
    # Counter and clock wrap within the capture, without effect.
    assert log.packet_counter.tolist() == list(range(65001, 65001 + 1040))
    acceleration = log["acceleration"]
    assert acceleration.time[0] == pytest.approx((2**32 - 50_000) / 1e4)
    assert acceleration.time[-1] - acceleration.time[0] == pytest.approx(9.99)
    assert acceleration.rate == pytest.approx(100)
    assert log.stats.skipped_bytes == log.stats.lost_samples == 0


def test_field_capture() -> None:
    """Thirteen samples were never received and ten are damaged."""
    log = xbus.read_log(OWN_CAPTURES / "field.mtb")
    sound = xbus.read_log(OWN_CAPTURES / "walk.mtb")
    assert len(log) == 1016
    assert [message.name for message in log.messages] == ["FirmwareRev", "Error"]
    assert (log.device_id, log.configuration) == (None, None)
    # One sample is cut off at the end, where the counter cannot know.
    assert log.stats.lost_samples == len(sound) - len(log) - 1
    assert set(log.packet_counter) < set(sound.packet_counter)
    same = set(log.packet_counter).__contains__
    kept = [i for i, count in enumerate(sound.packet_counter) if same(count)]
    assert log.time.tolist() == sound.time[kept].tolist()
    assert log.stats.skipped_bytes == log.damage["length"].sum()
