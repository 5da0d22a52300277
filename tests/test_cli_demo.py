"""``xbus demo``: the first command that new users run."""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path

import pytest

import xbus
from test_cli import run, sentence, start


def test_demo(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    result = run("demo", "--folder", str(tmp_path / "new"), "--seconds", "1")
    assert result.exit_code == 0
    assert result.stderr == ""
    lines = result.stdout.splitlines()
    assert re.fullmatch("connected:  MTi-680G-8A1G6, virtual, on /dev/.+|.+//.+", lines[0])
    assert lines[1] == "configured: 15 quantities at their highest rates"
    assert re.fullmatch(r"recorded:   [0-9,]+ bytes in 1 s", lines[2])
    assert "acceleration_hr, m/s2" in lines
    assert sum("█" in line and "▁" in line for line in lines) == 6
    # Paths can have any length.
    assert max(len(line) for line in lines[1:-2] if str(tmp_path) not in line) <= 80
    files = [tmp_path / "new" / name for name in ("demo.mtb", "demo.parquet")]
    assert lines[-2:] == [f"wrote {file}" for file in files]
    log = xbus.read_log(files[0])
    for name, rate in (("acceleration_hr", 2000), ("rate_of_turn_hr", 1600)):
        times = log[name].time
        assert (len(times) - 1) / (times[-1] - times[0]) == pytest.approx(rate, rel=0.005)
    assert (log.stats.lost_samples, log.stats.skipped_bytes) == (0, 0)
    assert log["lat_lon"].precision == "Fp1632"


def test_demo_writes_a_picture(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    result = run("demo", "--folder", str(tmp_path), "--seconds", "0.5", "--product", "MTi-3")
    assert result.exit_code == 0
    assert result.stdout.endswith(f"wrote {tmp_path / 'demo.png'}\n")
    assert "█" not in result.stdout
    assert (tmp_path / "demo.png").read_bytes().startswith(b"\x89PNG")


def test_without_pyarrow(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The table needs no extra."""
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    result = run("demo", "--folder", str(tmp_path), "--seconds", "0.5", "--product", "mti-1")
    assert result.exit_code == 0
    assert (tmp_path / "demo.parquet").read_bytes().startswith(b"PAR1")
    assert f"wrote {tmp_path / 'demo.parquet'}" in result.stdout


def test_the_reader_of_the_output_has_seen_enough(tmp_path: Path) -> None:
    ours, theirs = os.pipe()
    os.close(ours)
    with start("demo", "--folder", str(tmp_path), "--seconds", "0.5", stdout=theirs) as child:
        os.close(theirs)
        _, shown = child.communicate()
    assert (child.returncode, shown) == (0, b"")


def test_no_such_product() -> None:
    result = run("demo", "--product", "MTi-9")
    assert result.exit_code == 2
    assert "MTi-9" in result.stderr


def test_a_folder_that_is_a_file(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    output = sentence(run("demo", "--folder", str(tmp_path / "file")))
    assert output == f"cannot write to {tmp_path / 'file'}: File exists; choose another name"
