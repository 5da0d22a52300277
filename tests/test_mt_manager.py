"""The text of MT Manager. scikit-kinematics and OpenSim read it where their packages are installed."""

from __future__ import annotations

import importlib
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import xbus
from conftest import counter
from streams import mtdata2, real
from test_cli import WALK, run, sentence
from test_decode_parts import LOGS
from xbus import MessageId, encode_frame, encode_sample
from xbus.export.format import export
from xbus.export.mt_manager import MtManager
from xbus.log.part_file import export_parts

LOG = xbus.read_log(WALK)
#: Lines of comments by generation, and the one with the rate.
HEADS = {"2022": 12, "4.8": 5, "4.x": 4, "3.x": 4}
RATES = {
    "4.8": "// Update Rate: 100.0Hz",
    "4.x": "// Update Rate: 100.0Hz",
    "3.x": "// Sample rate: 100.0Hz",
}


@pytest.fixture(autouse=True)
def _folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def read(path: str = "out.txt", mtm: str = "2022", sep: str = "\t") -> Any:
    """The table, as users' scripts read it."""
    return pd.read_csv(path, skiprows=HEADS[mtm], sep=sep)


def sample(at: int, bid: int = 0xFF, **quantities: Any) -> bytes:
    """A sample every 10 ms, with an acceleration of its number."""
    time = {"packet_counter": at % 65536, "sample_time_fine": 100 * at}
    return encode_sample(time | (quantities or {"acceleration": [at, 0, 9.5]}), bid=bid)


def log_of(*samples: bytes) -> xbus.Log:
    return xbus.read_log(b"".join(samples))


@pytest.mark.parametrize("mtm", HEADS)
def test_generations(mtm: Any) -> None:
    LOG.to_mt_manager("out.txt", mtm=mtm)
    text = Path("out.txt").read_text()
    lines = text.splitlines()
    assert [line.startswith("//") for line in lines[: HEADS[mtm] + 1]] == [True] * HEADS[mtm] + [
        False
    ]
    assert mtm not in RATES or lines[1] == RATES[mtm]
    assert ("written by xbus" in text) == (mtm == "2022")
    table = read(mtm=mtm)
    is_old = mtm == "3.x"
    assert text.splitlines()[HEADS[mtm]].endswith("\t") == is_old
    for name, labels in {
        "acceleration": ["Acc_X", "Acc_Y", "Acc_Z"],
        "rate_of_turn": ["Gyr_X", "Gyr_Y", "Gyr_Z"],
        "magnetic_field": ["Mag_X", "Mag_Y", "Mag_Z"],
        "quaternion": [f"Quat_{end}" for end in ("wxyz" if is_old else ("q0", "q1", "q2", "q3"))],
        "euler_angles": ["Roll", "Pitch", "Yaw"],
        "lat_lon": ["Latitude", "Longitude"],
        "altitude_ellipsoid": ["Altitude"],
        "velocity_xyz": [f"Vel_{end}" for end in ("ENU" if mtm == "2022" else "XYZ")],
    }.items():
        expected = LOG[name].values.reshape(len(table), -1)
        np.testing.assert_allclose(table[labels], expected, rtol=0, atol=5.1e-7, err_msg=name)
    counters = LOG["packet_counter"].values[
        np.isin(LOG["packet_counter"].sample, LOG["acceleration"].sample)
    ]
    assert table["Counter" if is_old else "PacketCounter"].tolist() == counters.tolist()


def test_lines_of_2022() -> None:
    matrix = np.arange(9).reshape(3, 3) / 8
    data = encode_frame(MessageId.DeviceID, bytes.fromhex("00B42D4B"))
    data += sample(472, rotation_matrix=matrix, free_acceleration=[1, 2, 3], status_word=7)
    data += sample(473, free_acceleration=[1, 2, 3])
    xbus.read_log(data).to_mt_manager("out.txt")
    lines = Path("out.txt").read_text().splitlines()
    assert lines[0] == "// General information: "
    assert lines[4] == "//  DeviceId: 00B42D4B"
    assert lines[11] == "// Coordinate system: ENU"
    labels = (
        "PacketCounter SampleTimeFine FreeAcc_E FreeAcc_N FreeAcc_U Mat[1][1] Mat[2][1] Mat[3][1]"
    )
    assert lines[12].split("\t")[:8] == labels.split()
    free = ["1.000000", "2.000000", "3.000000"]
    assert lines[13].split("\t")[:9] == [
        "00472",
        "47200",
        *free,
        "0.000000",
        "0.375000",
        "0.750000",
        "0.125000",
    ]
    assert lines[13].split("\t")[-1] == "7"
    assert lines[14].split("\t") == ["00473", "47300", *free, *["NaN"] * 10]


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({}, "00001\t100\t1.500000\tNaN"),
        ({"separator": "comma"}, "00001,100,1.500000,NaN"),
        ({"mtm": "4.x"}, "00001\t100\t1.500000\t"),
        ({"mtm": "4.x", "separator": "semicolon"}, "00001;100;1.500000;"),
        ({"mtm": "4.x", "separator": "space", "missing": "NaN"}, "00001 100 1.500000 NaN"),
        ({"mtm": "3.x", "missing": "0"}, "    1\t1.500000\t0\t"),
    ],
    ids=str,
)
def test_separators_and_missing_values(options: dict[str, Any], expected: str) -> None:
    log = log_of(sample(1, temperature=1.5), sample(2, baro_pressure=100_000))
    log.to_mt_manager("out.txt", **options)
    assert Path("out.txt").read_text().splitlines()[-2] == expected


def test_names_have_the_letters_of_the_coordinates() -> None:
    log_of(mtdata2(counter(1), real(0x4034, 1, 2, 3), real(0xD018, 4, 5, 6))).to_mt_manager(
        "out.txt"
    )
    names = Path("out.txt").read_text().splitlines()[12].split("\t")[1:]
    assert names == ["FreeAcc_N", "FreeAcc_E", "FreeAcc_D", "Vel_N", "Vel_W", "Vel_U"]


def test_lost_samples_have_rows() -> None:
    """So no row is shifted. Counters wrap as on the wire."""
    numbers = [*range(65530, 65534), *range(65540, 65544)]
    log_of(*map(sample, numbers)).to_mt_manager("out.txt")
    table = read()
    assert (table["PacketCounter"] == np.arange(65530, 65544) % 65536).all()
    assert table["Acc_X"].isna().tolist() == [False] * 4 + [True] * 6 + [False] * 4
    assert table["Acc_X"].dropna().tolist() == numbers


def test_samples_without_a_column_have_no_row() -> None:
    """Such as those of the GNSS receiver. A loss among them has the rows that its time has."""
    others = [sample(2, temperature=1.0), *map(sample, (3, 4, 9, 10))]
    gnss = encode_sample({"packet_counter": 5, "sample_time_fine": 499, "gnss_pvt_pulse": 1})
    log_of(*others[:3], gnss, *others[3:]).to_mt_manager("out.txt")
    assert read()["PacketCounter"].tolist()[:3] == [2, 3, 4]
    assert read()["PacketCounter"].tolist()[-2:] == [9, 10]
    assert read()["PacketCounter"].isna().sum() == len(read()) - 5 == 3


def test_no_rows_for_a_gap_without_times_or_across_a_restart() -> None:
    data = [encode_sample({"packet_counter": at, "temperature": 1.0}) for at in (1, 2, 9)]
    log_of(*data).to_mt_manager("out.txt")
    assert read()["PacketCounter"].tolist() == [1, 2, 9]
    log_of(sample(1), sample(2), encode_frame(MessageId.WakeUp), sample(9)).to_mt_manager("out.txt")
    assert read()["PacketCounter"].tolist() == [1, 2, 9]


def devices() -> bytes:
    ids = [encode_frame(MessageId.DeviceID, bytes.fromhex("0080001E"), bid=1)]
    samples = [sample(at, bid) for at in range(300) for bid in (1, 2) if at % 37 > 3 * bid]
    samples.insert(200, encode_frame(MessageId.WakeUp, bid=2))
    return b"".join(ids + samples)


def test_devices_have_a_file_each() -> None:
    Path("log.mtb").write_bytes(devices())
    Path("out_BID2.txt").write_text("old")
    result = run("decode", "log.mtb", "-o", "out.txt", "--mtm", "4.x")
    assert ", 2 files; " in result.stderr
    assert {path.name for path in Path().iterdir()} == {
        "log.mtb",
        "out_0080001E.txt",
        "out_BID2.txt",
    }
    log = xbus.read_log("log.mtb")
    for bid, name in ((1, "0080001E"), (2, "BID2")):
        found = read(f"out_{name}.txt", "4.x")["Acc_X"].dropna()
        assert found.tolist() == log.device(bid)["acceleration"].values[:, 0].tolist()


def test_all_files_or_none(monkeypatch: pytest.MonkeyPatch) -> None:
    """Here the second file cannot appear, since it is a folder."""
    Path("log.mtb").write_bytes(devices())
    Path("out_0080001E.txt").write_text("old")
    Path("out_BID2.txt").mkdir()
    assert "cannot write out.txt" in sentence(run("decode", "log.mtb", "-o", "out.txt"))
    assert Path("out_0080001E.txt").read_text() == "old"
    assert len(list(Path().iterdir())) == 3


@pytest.mark.parametrize("name", ["devices", "dirty", "late columns", "random 1"])
@pytest.mark.parametrize("mtm", ["2022", "4.x"])
def test_the_parts_of_a_log_give_the_same_bytes(name: str, mtm: Any) -> None:
    data = devices() if name == "devices" else LOGS[name]
    results = []
    for folder in ("whole", "parts"):
        Path(folder).mkdir()
        try:
            if folder == "whole":
                log = xbus.read_log(data)
                counts = export(MtManager(mtm), log, [log], "whole/out.txt")
            else:
                parts = xbus.split_log(data, block_bytes=700)
                counts = export_parts(parts, "parts/out.txt", MtManager(mtm))
        except ValueError as error:
            counts = {str(error): 0}
        results.append((counts, {path.name: path.read_bytes() for path in Path(folder).iterdir()}))
    assert results[0] == results[1]


@pytest.mark.parametrize("mtm", ["4.x", "3.x"])
def test_scikit_kinematics(mtm: Any) -> None:
    pytest.importorskip("skinematics", reason="scikit-kinematics needs pygame and sympy, 120 MB")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        sensors = importlib.import_module("skinematics.sensors.xsens")
        log = xbus.read_log(
            WALK, quantities=["acceleration", "rate_of_turn", "magnetic_field", "sample_time_fine"]
        )
        log.to_mt_manager("out.txt", mtm=mtm)
        found = sensors.XSens(in_file="out.txt", R_init=np.eye(3), q_type=None)
    assert found.rate == 100
    np.testing.assert_allclose(found.acc, log["acceleration"].values, atol=5.1e-7)
    np.testing.assert_allclose(found.omega, log["rate_of_turn"].values, atol=5.1e-7)
    np.testing.assert_allclose(found.mag, log["magnetic_field"].values, atol=5.1e-7)


@pytest.mark.parametrize("mtm", ["2022", "4.x"])
def test_opensim(mtm: Any) -> None:
    pytest.importorskip("opensim", reason="the package opensim has 90 MB")
    opensim = importlib.import_module("opensim")
    LOG.to_mt_manager("walk_A1.txt", mtm=mtm)
    settings = opensim.XsensDataReaderSettings()
    settings.set_data_folder("./")
    settings.set_trial_prefix("walk")
    settings.append_ExperimentalSensors(opensim.ExperimentalSensor("_A1", "pelvis_imu"))
    tables = opensim.XsensDataReader(settings).read("./")
    table = opensim.XsensDataReader.getOrientationsTable(tables)
    assert table.getNumRows() == 1000


@pytest.mark.parametrize(
    ("data", "arguments", "message"),
    [
        (encode_sample({"packet_counter": 1}), [], "MT Manager's text needs one of acceleration, "),
        (
            encode_sample({("quaternion", "NED"): [1, 0, 0, 0]})
            + encode_sample({"quaternion": [1, 0, 0, 0]}),
            [],
            "choose --quantity quaternion:NED or quaternion:ENU, and the other quantities",
        ),
        (encode_sample({"temperature": 1.0}), ["--mtm", "4.x"], "--rate HZ gives times"),
    ],
    ids=["nothing", "coordinates", "no rate"],
)
def test_refusals(data: bytes, arguments: list[str], message: str) -> None:
    Path("log.mtb").write_bytes(data)
    assert message in sentence(run("decode", "log.mtb", "-o", "out.txt", *arguments))
    assert not Path("out.txt").exists()


@pytest.mark.parametrize(
    "options",
    [["--separator", "comma", "--missing", "a,b"], ["--separator", "space", "--mtm", "4.x"]],
)
def test_wrong_options(options: list[str]) -> None:
    result = run("decode", WALK, "-o", "out.txt", *options)
    assert result.exit_code == 2
    assert "missing value" in result.stderr
