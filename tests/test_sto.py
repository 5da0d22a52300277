"""Orientations for OpenSim. OpenSim itself reads them where its package is installed."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import xbus
from test_cli import WALK, run, sentence
from xbus import MessageId, encode_frame, encode_sample
from xbus.export.format import export
from xbus.export.sto import Sto
from xbus.geometry import quaternion
from xbus.log.part_file import export_parts

LOG = xbus.read_log(WALK)
PELVIS, TORSO = "0080001E", "0080001F"
IDS = b"".join(
    encode_frame(MessageId.DeviceID, bytes.fromhex(name), bid=bid)
    for bid, name in ((1, PELVIS), (2, TORSO))
)


@pytest.fixture(autouse=True)
def _folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def read(path: str = "out.sto") -> tuple[list[str], Any, Any]:
    """Labels, times (n,) and quaternions (n, devices, 4), by the rules of OpenSim's reader."""
    head, table = Path(path).read_text().split("endheader\n")
    assert dict(line.split("=") for line in head.splitlines())["DataType"] == "Quaternion"
    labels, *rows = (line.split("\t") for line in table.splitlines())
    time = np.array([float(row[0]) for row in rows])
    return (
        labels,
        time,
        np.array([[list(map(float, q.split(","))) for q in row[1:]] for row in rows]),
    )


def oriented(at: int, bid: int = 1, *, late: int = 0, **quantities: Any) -> bytes:
    """A sample every 10 ms; late is in units of 0.1 ms."""
    time = {"packet_counter": at, "sample_time_fine": 500 + 100 * at + late}
    values = quantities or {"quaternion": quaternion.from_euler([0, 0, at + 100 * bid])}
    return encode_sample(time | values, bid=bid)


def pair(count: int, *, lost: tuple[int, ...] = ()) -> bytes:
    """Two devices on one bus, of which the second loses samples."""
    samples = [oriented(at, bid, late=3 * bid) for at in range(count) for bid in (1, 2)]
    return IDS + b"".join(data for at, data in enumerate(samples) if at not in lost)


def test_values() -> None:
    LOG.to_sto("out.sto")
    labels, time, q = read()
    assert labels == ["time", "008000A1B2_imu"]
    column = LOG["quaternion"]
    np.testing.assert_array_equal(q[:, 0], column.values.astype("f8"))
    np.testing.assert_allclose(time, column.time - column.time[0], atol=1e-6)
    assert time[0] == 0


def test_opensim_reads_the_file() -> None:
    pytest.importorskip("opensim", reason="the package opensim has 90 MB")
    opensim = importlib.import_module("opensim")
    xbus.read_log(pair(20)).to_sto("out.sto", names={PELVIS: "pelvis", TORSO: "torso"})
    table = opensim.TimeSeriesTableQuaternion("out.sto")
    assert table.getColumnLabels() == ("pelvis_imu", "torso_imu")
    assert list(table.getIndependentColumn()) == read()[1].tolist()
    row = table.getRowAtIndex(5)
    found = [[row.getElt(0, device).get(at) for at in range(4)] for device in range(2)]
    np.testing.assert_allclose(found, read()[2][5], atol=1e-7)


@pytest.mark.parametrize("system", ["ENU", "NED", "NWU"])
@pytest.mark.parametrize("name", ["quaternion", "rotation_matrix", "euler_angles"])
def test_all_orientations_become_quaternions_in_enu(name: str, system: str) -> None:
    turned = quaternion.from_euler([[10.0, 20.0, 30.0]])
    to_local = {"ENU": [1, 0, 0, 0], "NED": [0, -1, -1, 0], "NWU": [1, 0, 0, -1]}[system]
    local = quaternion.multiply(np.array(to_local) / np.linalg.norm(to_local), turned)[0]
    values = {
        "quaternion": local,
        "rotation_matrix": quaternion.to_matrix(local),
        "euler_angles": quaternion.to_euler(local),
    }
    sample: dict[Any, Any] = {"sample_time_fine": 5, (name, system, "Float64"): values[name]}
    xbus.read_log(encode_sample(sample)).to_sto("out.sto")
    found = read()[2][0, 0]
    assert abs(found @ turned[0]) == pytest.approx(1)


def test_rows_of_several_devices() -> None:
    """A row needs a sample of every device; one that is lost costs its row and no other."""
    log = xbus.read_log(pair(20, lost=(7, 20)))
    log.to_sto("out.sto", names={PELVIS: "pelvis"})
    labels, time, q = read()
    assert labels == ["time", "pelvis_imu", f"{TORSO}_imu"]
    # Of the sample 3 the second device is missing, of 10 the first.
    kept = [at for at in range(20) if at not in (3, 10)]
    np.testing.assert_allclose(time, np.array(kept) / 100, atol=1e-9)
    np.testing.assert_allclose(
        quaternion.to_euler(q)[:, :, 2], [[(100 + at), (at - 160)] for at in kept], atol=1e-4
    )


def test_the_parts_of_a_log_give_the_same_bytes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("xbus.export.sto.REACH", 20)
    data = pair(300, lost=(*range(40, 120), 7, 301, 302, 400, *range(431, 470, 2), 505))
    log, parts = xbus.read_log(data), xbus.split_log(data, block_bytes=400)
    counts = export(Sto(), log, [log], "whole")
    assert counts["row"] > 200
    assert counts["incomplete row"] > 10
    assert export_parts(parts, "parts", Sto()) == counts
    assert Path("whole").read_bytes() == Path("parts").read_bytes()


def test_orientations_that_are_no_rotations_are_counted() -> None:
    kinds: list[Any] = [[1.0, 0, 0, 0], [float("nan")] * 4, [0.0, 0, 0, 0], [0.0, 1, 0, 0]]
    Path("log.mtb").write_bytes(b"".join(oriented(at, quaternion=q) for at, q in enumerate(kinds)))
    assert "2 rows, 2 omitted orientations; " in run("decode", "log.mtb", "-o", "out.sto").stderr


@pytest.mark.parametrize(
    ("data", "arguments", "message"),
    [
        (encode_sample({"temperature": 1.0}), [], "an .sto file needs orientation"),
        (encode_sample({"quaternion": [1.0, 0, 0, 0]}), [], "--rate HZ gives times"),
        (oriented(0, quaternion=[0.0, 0, 0, 0]), [], "is a rotation, neither zeros nor NaN"),
        (
            pair(3),
            ["--sto-names", "77=a"],
            "no device 77 to be named; the log has 0080001E, ",
        ),
        (
            oriented(0) + encode_frame(MessageId.WakeUp) + oriented(0),
            [],
            "a device restarts at sample 1, ",
        ),
        (
            oriented(0, 1) + oriented(5, 2) + oriented(1, 1),
            [],
            "do they share a clock? --bid chooses one",
        ),
    ],
    ids=["no orientation", "no time", "no rotation", "no device", "restart", "no common time"],
)
def test_refusals(data: bytes, arguments: list[str], message: str) -> None:
    Path("log.mtb").write_bytes(data)
    assert message in sentence(run("decode", "log.mtb", "-o", "out.sto", *arguments))
    assert not Path("out.sto").exists()


@pytest.mark.parametrize("names", ["pelvis", "1=a b", "1=a,2=a", "1=,2=a", "=a_"])
def test_wrong_names(names: str) -> None:
    result = run("decode", WALK, "-o", "out.sto", "--sto-names", names)
    assert result.exit_code == 2
    assert "name" in result.stderr
