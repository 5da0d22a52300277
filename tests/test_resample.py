"""Resampling, compared with scipy and with values worked out by hand."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow.parquet as pq
import pytest
from scipy.interpolate import interp1d
from scipy.spatial.transform import Rotation, Slerp

import xbus
from xbus import MessageId, encode_frame, encode_sample
from xbus.protocol.tables import QUANTITIES

RANDOM = np.random.default_rng(13)
#: Ticks of SampleTimeFine at 100 Hz with jitter: no two steps are the same.
TICKS = np.arange(400) * 100 + RANDOM.integers(-30, 30, 400) + 5000
TURNS = Rotation.from_rotvec(np.cumsum(RANDOM.normal(0, 0.2, (400, 3)), axis=0))


def log_of(columns: dict[Any, Iterable[Any]], ticks: Iterable[int] = TICKS) -> xbus.Log:
    """Returns a log with one sample for each tick."""
    return xbus.read_log(stream(columns, ticks))


def stream(
    columns: dict[Any, Iterable[Any]], ticks: Iterable[int] = TICKS, bid: int = 0xFF
) -> bytes:
    rows = zip(*columns.values(), strict=True)
    return b"".join(
        encode_sample(
            {
                "packet_counter": at,
                "sample_time_fine": int(tick),
                **dict(zip(columns, row, strict=True)),
            },
            bid=bid,
        )
        for at, (tick, row) in enumerate(zip(ticks, rows, strict=True))
    )


def scalar_first(turns: Rotation) -> npt.NDArray[np.float64]:
    return np.asarray(turns.as_quat()[:, [3, 0, 1, 2]])


def test_vectors_are_linear() -> None:
    values = RANDOM.normal(size=(400, 3))
    log = log_of({("acceleration", "Float64"): values})
    found = log.resample(237, ["acceleration"])
    expected = interp1d(log.time, values, axis=0)(np.minimum(found.time, log.time[-1]))
    np.testing.assert_allclose(found["acceleration"], expected, rtol=0, atol=1e-12)
    assert found["acceleration"].dtype == np.float64


def test_times_are_constant_steps_from_the_first_stamp() -> None:
    log = log_of({"temperature": np.zeros(400)})
    found = log.resample(100)
    assert found.time[0] == log.time[0]
    assert np.array_equal(found.time, log.time[0] + np.arange(len(found.time)) / 100)
    assert log.time[-1] - 0.01 < found.time[-1] <= log.time[-1] + 1e-6


@pytest.mark.parametrize("rate", [50, 100, 333.3])
def test_quaternions_are_slerped(rate: float) -> None:
    signs = RANDOM.choice([-1, 1], (400, 1))  # both signs are the same rotation
    log = log_of({("quaternion", "Float64"): scalar_first(TURNS) * signs})
    found = log.resample(rate, "quaternion")
    expected = Slerp(log.time, TURNS)(np.minimum(found.time, log.time[-1]))
    q = found["quaternion"]
    np.testing.assert_allclose(np.linalg.norm(q, axis=1), 1, atol=1e-12)
    error = expected.inv() * Rotation.from_quat(q[:, [1, 2, 3, 0]])
    assert error.magnitude().max() < 1e-9


def test_matrices_turn_as_quaternions() -> None:
    log = log_of(
        {
            ("quaternion", "Float64"): scalar_first(TURNS),
            ("rotation_matrix", "Float64"): TURNS.as_matrix(),
        }
    )
    found = log.resample(130, ["quaternion", "rotation_matrix"])
    expected = Rotation.from_quat(found["quaternion"][:, [1, 2, 3, 0]]).as_matrix()
    np.testing.assert_allclose(found["rotation_matrix"], expected, atol=1e-9)
    table = found.to_arrow()
    assert np.array_equal(table["rotation_matrix_m21"], found["rotation_matrix"][:, 1, 0])


def test_angles_cross_180_degrees() -> None:
    yaw = np.arange(400) * 7.3
    wrapped = (yaw + 180) % 360 - 180
    euler = np.stack([wrapped, np.sin(yaw), wrapped[::-1]], axis=1)
    log = log_of({("euler_angles", "Float64"): euler})
    found = log.resample(400, ["euler_angles"])
    smooth = interp1d(log.time, np.unwrap(euler, axis=0, period=360), axis=0)
    expected = (smooth(np.minimum(found.time, log.time[-1])) + 180) % 360 - 180
    np.testing.assert_allclose(found["euler_angles"], expected, atol=1e-9)


def test_longitude_crosses_the_date_line() -> None:
    columns: dict[Any, Any] = {("lat_lon", "Float64"): [(10, 179.5), (11, -179.5)]}
    found = log_of(columns, [0, 100]).resample(1000, "lat_lon")["lat_lon"]
    np.testing.assert_allclose(found[[2, 8]], [[10.2, 179.7], [10.8, -179.7]], atol=1e-9)


def test_status_keeps_the_previous_value() -> None:
    log = log_of({"status_word": RANDOM.integers(0, 2**32, 400)})
    found = log.resample(1000, ["status_word"])
    held = interp1d(log.time, np.arange(400), kind="previous")
    rows = held(np.minimum(found.time + 1e-7, log.time[-1])).astype(int)
    assert np.array_equal(found["status_word"], log["status_word"].values[rows])
    assert found["status_word"].dtype == np.uint32


def test_gaps_are_not_bridged() -> None:
    ticks = [0, 100, 200, 400, 500, 800, 900]  # one sample is lost at 400, two before 800
    log = log_of({"temperature": range(7), "status_byte": range(7)}, ticks)
    found = log.resample(100)
    nan = np.nan
    assert np.array_equal(
        found["temperature"], [0, 1, 2, 2.5, 3, 4, nan, nan, 5, 6], equal_nan=True
    )
    assert found["status_byte"].tolist() == [0, 1, 2, 2, 3, 4, 4, 4, 5, 6]
    assert np.isnan(log.resample(100, max_gap=0.015)["temperature"][3])
    assert log.resample(100, max_gap=0.005)["status_byte"].tolist()[3] is None
    wide = log.resample(100, max_gap=0.03)
    np.testing.assert_allclose(wide["temperature"][5:8], [4, 4 + 1 / 3, 4 + 2 / 3])
    table = found.to_arrow()
    assert table["temperature"].null_count == 2
    assert table["temperature"][6].as_py() is None


def test_values_are_unknown_before_the_first_row() -> None:
    parts = [
        encode_sample(
            {"sample_time_fine": 100 * at} | ({"baro_pressure": at} if at % 4 == 2 else {})
        )
        for at in range(12)
    ]
    found = xbus.read_log(b"".join(parts)).resample(100)["baro_pressure"]
    np.testing.assert_allclose(found, [np.nan, np.nan, *range(2, 11), np.nan], atol=1e-9)


def test_runs_are_not_mixed() -> None:
    first = stream({"temperature": [0, 1, 2]}, [1000, 1100, 1200])
    second = stream({"temperature": [50, 60]}, [0, 100])
    log = xbus.read_log(first + encode_frame(MessageId.WakeUp) + second)
    found = log.resample(200)
    np.testing.assert_allclose(found["temperature"], [0, 0.5, 1, 1.5, 2, 50, 55, 60])
    assert found.run.tolist() == [0] * 5 + [1] * 3
    assert found.to_arrow().column_names == ["time", "run", "temperature"]


def test_devices_are_not_mixed() -> None:
    ticks = np.arange(50) * 100
    values = {bid: RANDOM.normal(size=50).astype(np.float32) for bid in (1, 2)}
    alone = {bid: stream({"temperature": values[bid]}, ticks + 7 * bid, bid) for bid in (1, 2)}
    size = len(alone[1]) // 50
    both = b"".join(
        alone[bid][at : at + size] for at in range(0, len(alone[1]), size) for bid in (1, 2)
    )
    found = xbus.read_log(both).resample(130)
    for bid in (1, 2):
        single = xbus.read_log(alone[bid]).resample(130)
        rows = found.bid == bid
        assert np.array_equal(found["temperature"][rows], single["temperature"])
        assert np.array_equal(found.time[rows], single.time)
    assert "bid" in found.to_arrow().column_names


def test_positions_of_the_receiver_are_interpolated_in_units() -> None:
    fields = QUANTITIES["gnss_pvt_data"].fields
    records = [
        dict.fromkeys((field.name for field in fields), 0) | changed
        for changed in (
            {"lat": 520000000, "headMot": 35900000, "numSV": 7},
            {"lat": 520000100, "headMot": 100000, "numSV": 9},
        )
    ]
    log = log_of({"temperature": [1, 2], "gnss_pvt_data": records}, [0, 2500])
    found = log.resample(8)["gnss_pvt_data"]
    np.testing.assert_allclose(found["lat"], [52, 52.000005, 52.00001], rtol=0, atol=1e-12)
    np.testing.assert_allclose(found["headMot"], [359, 360, 1])
    assert found["numSV"].tolist() == [7, 7, 9]


def test_a_value_on_a_row_does_not_depend_on_the_next() -> None:
    log = log_of({"temperature": [1, np.nan, 3, np.inf, 5]}, [0, 100, 200, 300, 400])
    found = log.resample(100)["temperature"]
    assert np.array_equal(found, [1, np.nan, 3, np.inf, 5], equal_nan=True)


@pytest.mark.parametrize("name", ["packet_counter", "sample_time_fine", "delta_v"])
def test_counters_stamps_and_increments_are_refused(name: str) -> None:
    log = log_of({"delta_v": np.zeros((2, 3))}, [0, 100])
    assert name not in log.resample(100)
    with pytest.raises(ValueError, match=f"{name} has no values between samples"):
        log.resample(100, [name])


@pytest.mark.parametrize("rate", [0, -1, float("nan"), float("inf")])
def test_wrong_rates(rate: float) -> None:
    with pytest.raises(ValueError, match="rate must be a positive number"):
        log_of({"temperature": [1]}, [0]).resample(rate)


def test_a_log_without_time_stamps() -> None:
    log = xbus.read_log(encode_sample({"temperature": 1.0}))
    with pytest.raises(ValueError, match="no time stamps"):
        log.resample(100)


def test_files(tmp_path: Path) -> None:
    log = log_of({"temperature": range(4), "status_byte": range(4)}, [0, 100, 200, 700])
    found = log.resample(100)
    table = found.to_arrow()
    found.to_parquet(tmp_path / "x.parquet")
    assert pq.read_table(tmp_path / "x.parquet").equals(table)
    assert table.schema.field("temperature").metadata[b"unit"] == b"degC"
    assert found.to_polars().columns == table.column_names == ["time", "temperature", "status_byte"]
    assert found.to_pandas().shape == (8, 3)
    found.to_csv(tmp_path / "x.csv")
    assert len((tmp_path / "x.csv").read_text().splitlines()) == 9
    found.to_npz(tmp_path / "x.npz")
    with np.load(tmp_path / "x.npz") as arrays:
        assert np.array_equal(arrays["temperature"], found["temperature"], equal_nan=True)
        assert arrays["status_byte.known"].tolist() == [True] * 5 + [False] * 2 + [True]


def test_every_quantity_of_a_recording_is_resampled_or_left_out_on_purpose(tmp_path: Path) -> None:
    log = xbus.read_log("tests/captures/walk.mtb")
    found = log.resample(25)
    left_out = {"packet_counter", "sample_time_fine", "utc_time"}
    assert set(found) == set(log) - left_out
    with pytest.raises(ValueError, match="read-only"):
        found["acceleration"][0] = 0
    first = int(np.searchsorted(found.time, log["gnss_pvt_data"].time[0]))
    found.to_npz(tmp_path / "walk.npz")
    with np.load(tmp_path / "walk.npz") as arrays:
        known = arrays["gnss_pvt_data.known"]["numSV"]
    assert known.tolist() == [False] * first + [True] * (len(found) - first)


def test_utc_is_interpolated() -> None:
    log = xbus.read_log("tests/captures/walk.mtb")
    known = ~np.isnat(log.utc)
    found = log.resample(250, ["acceleration", "utc_time"], max_gap=2)
    assert found.utc.dtype == "datetime64[ns]"
    # UTC runs as fast as the clock of the device, and no value is outside the known ones.
    origin = log.utc[known][0] - (log.time[known][0] * 1e9).astype("timedelta64[ns]")
    error = (found.utc - origin).astype(float) / 1e9 - found.time
    is_known = ~np.isnat(found.utc)
    assert np.abs(error[is_known]).max() < 2e-4
    assert is_known.sum() > 2000
    assert found.utc[is_known].min() >= log.utc[known].min()
    table = found.to_arrow()
    assert table["utc"].null_count == np.isnat(found.utc).sum()
    assert table.column_names[:3] == ["time", "utc", "acceleration_x"]
    assert "utc" not in log.resample(250, "acceleration").to_arrow().column_names
    assert str(table.schema.field("utc").type) == "timestamp[ns, tz=UTC]"


def test_a_log_without_utc_has_no_such_column() -> None:
    found = log_of({"temperature": [1, 2]}, [0, 100]).resample(100)
    assert np.isnat(found.utc).all()
    assert found.to_arrow().column_names == ["time", "temperature"]


def test_later_parts() -> None:
    data = stream({"temperature": np.arange(400.0)})
    *_, last = xbus.iter_log(data, block_bytes=4000)
    assert last.first_sample > 0
    found = last.resample(100)["temperature"]
    assert found[0] == last["temperature"].values[0]
    assert np.isfinite(found).all()
