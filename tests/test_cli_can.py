"""CAN captures on the command line, and the DBC file."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import polars as pl
import pytest

import xbus
from test_can import CODES, GOOD, arrays, can, group, read, write
from test_cli import WALK, run, sentence
from xbus.can.dbc import dbc_text

SENT = [frame for n in range(200) if n != 70 for frame in group(n, *CODES)]
ODD = [*GOOD, (0x34, bytes(4)), (0x123, b"")]


@pytest.fixture(autouse=True)
def _folder_with_captures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    write(Path("drive.blf"), SENT)
    write(Path("odd.blf"), ODD)
    write(Path("offset.log"), [(0x100 + key, data) for key, data in SENT])


def test_a_capture_is_decoded_like_any_log() -> None:
    result = run("decode", "drive.blf", "-o", "drive.parquet")
    table = pl.read_parquet("drive.parquet")
    assert (result.exit_code, len(table)) == (0, 199)
    assert result.stderr == (
        "drive.parquet: 199 rows, 21 columns; 0.50 s, 1 sample lost in 1 gap\n"
    )
    log = xbus.read_can(arrays(SENT))
    np.testing.assert_array_equal(table["velocity_xyz_z"], log["velocity_xyz"]["z"])
    np.testing.assert_array_equal(table["time"], log.time)


@pytest.mark.parametrize(
    ("args", "out", "rows"),
    [
        (["offset.log", "--ids", "0x100"], "out.csv", 199),
        (["drive.blf", "--ids", "0", "--ids", "0x100"], "out.csv", 199),
        (["drive.blf", "--ids", "SampleTime=5,acceleration=0x34"], "out.csv", 199),
        (["drive.blf", "--quantity", "acceleration"], "out.arrow", 199),
        (["drive.blf", "--rate-out", "100"], "out.csv", 50),
        (["drive.blf", "--bid", "1", "--channel", "0"], "out.csv", 199),
    ],
)
def test_options_of_captures(args: list[str], out: str, rows: int) -> None:
    assert run("decode", *args, "-o", out, "-q").exit_code == 0
    table = pl.read_csv(out) if out.endswith("csv") else pl.read_ipc(out)
    assert len(table) == rows


def test_a_capture_as_a_folder_and_the_device_of_a_part(tmp_path: Path) -> None:
    """Parts are read from a temporary file: with one device, and one that starts late."""
    late = [frame for n in range(400) for frame in group(n, 0x34)]
    late += [(0x100 + key, data) for key, data in late[-60:]]
    write(Path("late.log"), late)
    ids = ["--ids", "0", "--ids", "0x100"]
    assert run("decode", "late.log", *ids, "-o", "late/", "-q").exit_code == 0
    log = xbus.read_can("late.log", [0, 0x100])
    assert pl.read_parquet("late/*.parquet")["bid"].to_list() == log.bid.tolist()
    assert run("decode", "late.log", *ids, "--bid", "2", "-o", "two.csv", "-q").exit_code == 0
    np.testing.assert_array_equal(pl.read_csv("two.csv")["time"], log.device(2).time)
    failed = run("decode", "late.log", *ids, "--bid", "3", "-o", "three.csv")
    assert "no samples of device 3" in sentence(failed)


def test_several_captures_and_npz() -> None:
    result = run("decode", "drive.blf", "odd.blf", "--out-dir", "out", "--suffix", ".npz")
    assert (result.exit_code, len(list(Path("out").iterdir()))) == (0, 2)
    with np.load("out/odd.npz") as saved:
        np.testing.assert_array_equal(saved["acceleration"], read(GOOD)["acceleration"])


def test_findings_are_shown() -> None:
    findings = list(read(ODD).traffic.findings)
    assert len(findings) == 2
    decoded = run("decode", "odd.blf", "-o", "odd.csv", "--json")
    assert decoded.stderr.splitlines()[1:] == findings
    assert json.loads(decoded.stdout)["findings"] == findings
    shown = run("info", "odd.blf").stdout
    assert "findings\n1 frame of Acceleration (034) with 4 bytes instead of 6" in shown
    assert json.loads(run("info", "odd.blf", "--json").stdout)[0]["findings"] == findings
    assert "\nframes    300 of MTi devices\n" in shown
    assert "no damage" not in shown + decoded.stderr
    assert json.loads(run("info", WALK, "--json").stdout)[0]["findings"] == []
    reported = run("report", "odd.blf", "-o", "odd.html")
    assert reported.stderr.splitlines()[:-1] == [f"xbus: {finding}" for finding in findings]
    page = Path("odd.html").read_text()
    assert all(finding in page for finding in findings)
    assert "no damage" not in page


@pytest.mark.parametrize(
    ("args", "text"),
    [
        (["decode", "offset.log", "-o", "o.csv"], "offset.log has no samples of an MTi: 1,592 frames"),
        (["decode", "offset.log", "-o", "o.csv"], "an MTi with the offset 0x100; try ids=0x100 (--ids)"),
        (["info", "none.blf"], "cannot read none.blf: No such file or directory; check the path"),
        (["info", "empty.blf"], "empty.blf is no .blf capture"),
        (["decode", "odd.blf", "-o", "o.csv", "--strict"], "frame 300 (034, 4 bytes) cannot be decoded"),
        (["decode", "drive.blf", "-o", "o.csv", "--bid", "7"], "drive.blf: no samples of device 7"),
        (["decode", "drive.blf", "-o", "o.csv", "--quantity", "temperature"], "no temperature in drive.blf"),
        (["decode", "odd.blf", "-o", "o.gpx"], "odd.blf: a GPX file needs lat_lon"),
        (["decode", "drive.blf", "-o", "o.csv", "--between", "0", "1"], "to which --between does not apply"),
        (["decode", "drive.blf", "-o", "o.csv", "--channel", "9"], "the capture has no channel 9; it has 0"),
        (["cut", "drive.blf", "--from", "1", "-o", "o.mtb"], "a CAN capture; xbus info, decode and report"),
        (["can", "dbc", "-o", "/dev/full"], "cannot write /dev/full"),
        (["identify", "can:socketcan:none0"], "sudo ip link set none0 up type can bitrate 250000"),
        (["sim", "--can", "socketcan:none0", "--product", "MTi-680"], "cannot open can:socketcan:none0"),
    ],
)  # fmt: skip
def test_failures(args: list[str], text: str) -> None:
    Path("empty.blf").touch()
    assert text in sentence(run(*args))
    assert not Path("o.csv").exists()


@pytest.mark.parametrize(
    ("args", "text"),
    [
        (["info", WALK, "--ids", "0x100"], "--ids and --channel apply to CAN captures only"),
        (["info", "drive.blf", "--ids", "100x"], "'100x' is no identifier; write a number"),
        (["info", "drive.blf", "--ids", "Accel=1"], "no CAN message is called 'Accel'"),
        (
            ["info", "drive.blf", "--ids", "0", "--ids", "1"],
            "002 is Warning of device 1 and Error of device 2",
        ),
        (["info", "drive.blf", "--string", "EM1000"], "--string does not apply to CAN captures"),
        (
            ["decode", "drive.blf", "odd.blf", "-o", "o.csv"],
            "a CAN capture is one recording per file",
        ),
    ],
)
def test_wrong_calls(args: list[str], text: str) -> None:
    result = run(*args)
    assert result.exit_code == 2
    assert text in result.stderr


def test_the_dbc_file() -> None:
    result = run("can", "dbc", "-o", "mti600.dbc")
    assert (result.exit_code, result.stderr) == (0, "mti600.dbc: 26 messages\n")
    assert Path("mti600.dbc").read_bytes().decode() == dbc_text().replace("\n", "\r\n")
    assert run("can", "dbc", "--ids", "0x100").stdout.rstrip() == dbc_text(0x100).rstrip()


# A live bus


@pytest.fixture
def bus(monkeypatch: pytest.MonkeyPatch) -> str:
    """A virtual bus on which frames come as soon as it is opened."""
    channel = "cli-bus"
    sender = can.Bus(interface="virtual", channel=channel)
    original = can.Bus

    def opened(*args: object, **options: object) -> can.BusABC:
        found = original(*args, **options)
        for key, data in SENT:
            sender.send(can.Message(arbitration_id=key, data=data, is_extended_id=False))
        return found

    monkeypatch.setattr(can, "Bus", opened)
    return f"can:virtual:{channel}"


def test_a_bus_is_recorded(bus: str) -> None:
    result = run("record", bus, "-o", "live.blf", "--duration", "0.3")
    assert result.exit_code == 0
    assert "samples" in result.stderr
    assert len(xbus.read_can("live.blf")) <= 199


def test_a_bus_is_monitored(bus: str) -> None:
    result = run("monitor", bus, "--once", "0.3", "--json")
    assert result.exit_code == 0
    assert json.loads(result.stdout)["quantities"]


@pytest.mark.parametrize(
    ("args", "status", "text"),
    [
        (["record", "-o", "live.mtb"], 2, "a CAN bus is recorded as .asc, .blf"),
        (["record", "-o", "live.blf", "--output", "acceleration"], 2, "and CAN is read only"),
        (["config", "dump"], 1, "cannot be configured over it"),
        (["reset"], 1, "cannot be configured over it"),
        (["dump", "--follow"], 1, "has CAN frames and no bytes; xbus record"),
    ],
)
def test_what_a_bus_cannot_do(bus: str, args: list[str], status: int, text: str) -> None:
    command, *rest = args
    where = [*args, bus] if command == "config" else [command, bus, *rest]
    result = run(*where)
    assert (result.exit_code, text in result.stderr) == (status, True), result.stderr
