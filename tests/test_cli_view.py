"""``xbus view``, with a file in the place of the viewer."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path
from typing import Any

import pytest

import xbus
from test_cli import FIELD, WALK, run
from test_rerun import rrd_rows, values
from xbus.cli import live_input, view

rerun = pytest.importorskip("rerun")


@pytest.fixture
def shown(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The file that receives what the viewer would."""
    path = tmp_path / "shown.rrd"

    def opened(port: int, memory_limit: str) -> Any:
        recording = rerun.RecordingStream("xbus")
        recording.save(path)
        return recording

    monkeypatch.setattr(view, "open_viewer", opened)
    return path


def test_a_recording_is_shown_as_its_file(shown: Path, tmp_path: Path) -> None:
    result = run("view", FIELD)
    assert result.exit_code == 0, result.stderr
    assert result.stderr == f"{FIELD}: 1,016 samples, 26 events shown\n"
    xbus.read_log(FIELD).to_rrd(tmp_path / "file.rrd")
    assert repr(rrd_rows(shown)) == repr(rrd_rows(tmp_path / "file.rrd"))


def test_a_device_is_shown_at_its_full_rate(shown: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # The clock of a virtual device runs ahead: the command ends after two seconds on it.
    monkeypatch.setattr(live_input.LiveInput, "run", _until(2.0))
    result = run("view", "sim:MTi-680G")
    assert result.exit_code == 0, result.stderr
    rows = rrd_rows(shown)
    path = next(path for path in rows if path.endswith("/quaternion_enu"))
    samples = values(rows[path], "sample")
    assert len(samples) >= 190
    assert samples == list(range(samples[0], samples[0] + len(samples)))
    assert f"{len(samples):,} samples" in result.stderr


def _until(seconds: float) -> Any:
    run_all = live_input.LiveInput.run

    def run_until(self: Any, *args: Any, **options: Any) -> None:
        run_all(self, *args, **{**options, "duration": seconds})

    return run_until


def test_a_viewer_that_is_closed_ends_the_command(
    shown: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(self: Any, *, timeout_sec: float) -> None:
        raise RuntimeError("gRPC connection severed")

    monkeypatch.setattr(rerun.RecordingStream, "flush", refused)
    result = run("view", "sim:MTi-630")
    assert result.exit_code == 0
    assert "no samples lost" in result.stderr
    result = run("view", WALK)
    assert result.exit_code == 1
    assert result.stderr == (
        "xbus: the viewer on port 9876 does not receive data: it was closed, or another program uses the "
        "port; --viewer-port chooses another one\n"
    )


def test_a_viewer_that_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr(shutil, "which", lambda *_, **__: "/nowhere/rerun")
    result = run("view", WALK, "--viewer-port", "9895")
    assert result.exit_code == 1
    assert result.stderr.startswith("xbus: cannot start the viewer on port 9895: ")
    assert result.stderr.endswith("xbus decode -o FILE.rrd writes a file for a viewer elsewhere\n")
    assert result.stderr.count("\n") == 1


@pytest.mark.skipif(sys.platform != "linux", reason="other systems always have a display")
def test_no_display(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"):
        monkeypatch.delenv(name, raising=False)
    result = run("view", WALK, "--viewer-port", "9895")
    assert result.exit_code == 1
    assert "this session has no display; xbus decode -o FILE.rrd" in result.stderr


def test_wrong_calls(tmp_path: Path) -> None:
    result = run("view", WALK, "--baudrate", "115200")
    assert result.exit_code == 2
    assert "is a recording; --baudrate is for a port" in result.stderr
    result = run("view", "/dev/nonexistent")
    assert result.exit_code == 1
    assert "cannot open /dev/nonexistent" in result.stderr
