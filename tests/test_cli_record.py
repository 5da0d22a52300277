"""``xbus record``: every byte of a virtual device into a file."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

import xbus
from test_cli import PROGRAM, run, sentence, start
from test_recording import LONG, parted, wait_until
from xbus import Faults, SimulatedDevice
from xbus.protocol import State
from xbus.sim import PtyServer, serve, serving

posix = pytest.mark.skipif(os.name != "posix", reason="needs pseudo-terminals and signals")


@contextmanager
def recording(port: str, path: Path, *args: str) -> Iterator[subprocess.Popen[bytes]]:
    """Yields the running command, once some bytes are recorded."""
    with start("record", port, "-o", str(path), *args) as child:
        try:
            wait_until(lambda: path.exists() and path.stat().st_size > 3000)
            yield child
        finally:
            child.kill()


def end(child: subprocess.Popen[bytes]) -> tuple[int, str]:
    """Returns the exit code and the last line of stderr."""
    _, printed = child.communicate(timeout=LONG)
    return child.returncode, printed.decode().splitlines()[-1]


# Recordings


def test_duration_in_seconds(tmp_path: Path) -> None:
    path = tmp_path / "log.mtb"
    result = run("record", "sim:MTi-630", "-o", str(path), "--duration", "3")
    assert result.exit_code == 0
    size = len(parted(path)[1])
    log = xbus.read_log(path)
    assert result.stderr == (
        f"{path}: 3.0 s, {len(log)} samples, {size / 1000:.1f} kB; no samples lost\n"
    )
    assert result.stdout == ""
    assert len(log) == pytest.approx(300, abs=2)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["log.mtb", "log.mtb.times"]


def test_outputs(tmp_path: Path) -> None:
    path = tmp_path / "log.mtb"
    outputs = ["acceleration=200", "quaternion:NED:Fp1632=50", "sample_time_fine"]
    args = [word for output in outputs for word in ("--output", output)]
    result = run("record", "sim:MTi-630", "-o", str(path), "--duration", "2", "--no-times", *args)
    assert result.exit_code == 0
    assert result.stderr.endswith("; no packet counter to detect losses\n")
    log = xbus.read_log(path)
    assert set(log) == {"sample_time_fine", "quaternion", "acceleration"}
    assert len(log["acceleration"]) == pytest.approx(400, abs=4)
    assert (log["quaternion"].coordinates, log["quaternion"].precision) == ("NED", "Fp1632")
    assert [path.name for path in tmp_path.iterdir()] == ["log.mtb"]


@pytest.mark.parametrize(
    ("rotate", "files"), [("10kB", 2), ("0.005 MB", 4), ("1h", 1), ("30min", 1)]
)
def test_rotation(tmp_path: Path, rotate: str, files: int) -> None:
    path = tmp_path / "log.mtb"
    result = run("record", "sim:MTi-630", "-o", str(path), "--duration", "3", "--rotate", rotate)
    assert result.exit_code == 0
    assert len(list(tmp_path.glob("*.mtb"))) == files
    if files > 1:
        assert result.stderr.startswith(f"{path} to {tmp_path}/log-000{files - 1}.mtb: 3.0 s, ")
    bodies = b"".join(parted(path)[1] for path in sorted(tmp_path.glob("*.mtb"), key=str))
    assert xbus.read_log(bodies).stats.lost_samples == 0


def test_losses_are_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    device = xbus.connect(SimulatedDevice("MTi-630", faults=Faults.parse(["drop=0.0005"], 1)))
    monkeypatch.setattr("xbus.device.connect", lambda *_, **__: device)
    result = run("record", "sim", "-o", str(tmp_path / "log.mtb"), "--duration", "10")
    assert result.exit_code == 0
    stats = xbus.read_log(tmp_path / "log.mtb").stats
    assert stats.lost_samples > 5
    assert result.stderr.partition(" s, ")[2].startswith(f"{stats.samples:,} samples, ")
    assert result.stderr.partition("; ")[2] == (
        f"{stats.lost_samples} samples lost in {stats.gaps} gaps,"
        f" {stats.skipped_bytes:,} bytes damaged\n"
    )


def test_the_device_is_left_as_it_was_found(tmp_path: Path) -> None:
    virtual = SimulatedDevice("MTi-630")
    with serving(virtual, tcp=True) as port:
        with xbus.connect(port) as device:
            device.go_to_config()
        result = run("record", port, "-o", str(tmp_path / "log.mtb"), "--duration", "0.5")
        assert result.exit_code == 0
        assert virtual.state == State.CONFIG
    assert len(xbus.read_log(tmp_path / "log.mtb")) > 10


# The end


@posix
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_the_recording(tmp_path: Path, number: int) -> None:
    path = tmp_path / "log.mtb"
    with serving(SimulatedDevice("MTi-680G")) as port, recording(port, path, "--fsync") as child:
        child.send_signal(number)
        code, line = end(child)
    log = xbus.read_log(path)
    assert code == 0
    assert line.startswith(f"{path}: ")
    assert f" s, {len(log):,} samples, " in line
    assert line.endswith("; no samples lost")
    assert (log.stats.lost_samples, log.stats.skipped_bytes) == (0, 0)


@posix
def test_a_pulled_plug_ends_the_recording(tmp_path: Path) -> None:
    path = tmp_path / "log.mtb"
    virtual = SimulatedDevice("MTi-680G")
    with serving(virtual) as port, recording(port, path) as child:
        virtual.unplug()
        code, line = end(child)
    assert code == 1
    assert line.startswith(f"xbus: {port}: the port is gone: unplugged")
    log = xbus.read_log(path)
    assert f"; {path}: " in line
    assert f" s, {len(log):,} samples, " in line


@contextmanager
def in_a_thread(server: PtyServer) -> Iterator[None]:
    """Serves in a thread; the port keeps its name when the device is unplugged and plugged in again."""
    done = threading.Event()
    with ThreadPoolExecutor(1) as pool:
        pool.submit(serve, server, done.is_set)
        try:
            yield
        finally:
            done.set()


@posix
def test_reconnect_continues_the_same_file(tmp_path: Path) -> None:
    """After a reconnection, the same file continues."""
    path = tmp_path / "log.mtb"
    virtual = SimulatedDevice("MTi-680G")
    port = str(tmp_path / "mti")
    with (
        PtyServer(virtual, link=port) as server,
        in_a_thread(server),
        recording(port, path, "--reconnect") as child,
    ):
        assert child.stderr is not None
        virtual.unplug()
        pulled = virtual.time
        lines = [child.stderr.readline().decode()]
        away = virtual.time - pulled
        virtual.plug()
        lines.append(child.stderr.readline().decode())
        size = path.stat().st_size
        wait_until(lambda: path.stat().st_size > size + 5000)
        child.send_signal(signal.SIGINT)
        code, line = end(child)
    assert code == 0
    assert lines[0].startswith(f"xbus: {port}: the port is gone: unplugged")
    assert lines[0].endswith("; waiting for the port\n")
    assert lines[1] == f"xbus: {port} is back\n"
    log = xbus.read_log(path)
    assert f" s, {len(log):,} samples, " in line
    assert away <= np.diff(log.time).max() <= virtual.time - pulled + 1


FULL = """
import resource, sys
resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))
from xbus.cli import main
main(sys.argv[1:])
"""


@posix
def test_a_full_disk(tmp_path: Path) -> None:
    path = tmp_path / "log.mtb"
    command = [sys.executable, "-c", FULL, "record", "sim:MTi-630", "-o", str(path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=LONG, check=False)  # noqa: S603
    assert done.returncode == 1
    assert done.stderr.startswith(f"xbus: {path}: File too large")
    assert f"the recording ends with the last whole frame; {path}: " in done.stderr
    assert done.stderr.count("\n") == 1
    assert xbus.read_log(path).stats.skipped_bytes == 0


def test_a_silent_device_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("xbus.cli.recording_job.MAX_SILENCE", 0.3)
    with serving(SimulatedDevice("MTi-630"), tcp=True) as port:
        with xbus.connect(port) as device, device.configure():
            device.set_output_configuration([])
        printed = sentence(run("record", port, "-o", str(tmp_path / "log.mtb")))
    assert printed == (
        f"{port} sends nothing: it waits for a trigger, or has no outputs; xbus config dump"
        f" {port} shows the output configuration"
    )


def test_a_pause_is_reported(tmp_path: Path, behind: Callable[[SimulatedDevice], str]) -> None:
    virtual = SimulatedDevice("MTi-630", faults=Faults.parse(["stall=10:8"], 0))
    result = run("record", behind(virtual), "-o", str(tmp_path / "log.mtb"), "--duration", "20")
    assert result.exit_code == 0
    assert result.stderr.startswith("xbus: no data for 5 s; the recording continues\n")
    assert result.stderr.count("\n") == 2


@posix
def test_a_terminal_has_one_status_line(tmp_path: Path) -> None:
    from test_cli_terminal import on_terminal

    path = tmp_path / "log.mtb"
    with serving(SimulatedDevice("MTi-680G")) as port:
        command = [*PROGRAM, "record", port, "-o", str(path)]
        with on_terminal(command) as (child, terminal):
            terminal.wait_for("0:00:01  ")
            terminal.wait_for(" queued")
            child.send_signal(signal.SIGINT)
            *shown, last = terminal.wait_for_the_end().strip().split("\r")
            assert child.wait() == 0
    assert any(
        re.fullmatch(
            r"0:00:01  [0-9.]+ kB  [0-9]+ samples/s  no samples lost  [0-9.]+ (kB|bytes) queued *",
            item,
        )
        for item in shown
    )
    assert max(map(len, shown)) < 80
    assert last.startswith(f"{path}: ")


# Wrong calls


@pytest.mark.parametrize(
    ("args", "printed"),
    [
        (["--rotate", "100"], "'100' is neither a size (100MB, 2GB) nor a time (90s, 30min, 1h)"),
        (["--rotate", "0MB"], "'0MB' is neither a size"),
        (["--rotate", "1 day"], "'1 day' is neither a size"),
        (["--rotate", ""], "'' is neither a size"),
        (["--rotate", f"{9 * 10**400}MB"], "is neither a size"),
        (["--output", "acceleration=fast"], "a rate is a whole number of Hz"),
        (["--output", "accelerations=1"], "no quantity is called 'accelerations'"),
        (["--output", "quaternion:UP=1"], "UP"),
        (["--duration", "0"], "--duration"),
    ],
)
def test_wrong_calls(tmp_path: Path, args: list[str], printed: str) -> None:
    result = run("record", "sim:MTi-630", "-o", str(tmp_path / "log.mtb"), *args)
    assert result.exit_code == 2
    assert printed in result.stderr
    assert list(tmp_path.iterdir()) == []


def test_outputs_that_the_product_lacks_are_refused(tmp_path: Path) -> None:
    path = str(tmp_path / "log.mtb")
    printed = sentence(run("record", "sim:MTi-630", "-o", path, "--output", "lat_lon=100"))
    assert printed.startswith("the MTi-630 ")
    assert printed.endswith("; nothing was recorded")


def test_no_such_folder(tmp_path: Path) -> None:
    path = str(tmp_path / "no" / "log.mtb")
    printed = sentence(run("record", "sim:MTi-630", "-o", path))
    assert printed == f"cannot write {path}: No such file or directory; check the path"


def test_an_existing_recording_is_not_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "log.mtb"
    path.write_bytes(b"yesterday's")
    result = run("record", "sim:MTi-3", "-o", str(path), "--duration", "1")
    assert result.exit_code == 1
    assert sentence(result) == f"{path} exists; choose another name, or add --overwrite"
    assert path.read_bytes() == b"yesterday's"
    assert (
        run("record", "sim:MTi-3", "-o", str(path), "--duration", "1", "--overwrite").exit_code == 0
    )
    assert xbus.read_log(path).stats.skipped_bytes == 0


@posix
def test_a_pipe_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "pipe"
    os.mkfifo(path)
    result = run("record", "sim:MTi-3", "-o", str(path))
    assert sentence(result) == f"{path} is a pipe; a recording needs a file"
    with xbus.connect("sim:MTi-3") as device, pytest.raises(OSError, match="Illegal seek"):
        device.record(path)


def test_an_existing_recording_survives_a_failed_side_file(tmp_path: Path) -> None:
    path = tmp_path / "log.mtb"
    path.write_bytes(b"yesterday's")
    Path(f"{path}.times").mkdir()
    result = run("record", "sim:MTi-3", "-o", str(path), "--overwrite")
    assert result.exit_code == 1
    assert path.read_bytes() == b"yesterday's"
    path.unlink()
    assert run("record", "sim:MTi-3", "-o", str(path)).exit_code == 1
    assert not path.exists()


def test_a_failed_recording_leaves_the_device_in_config_state(
    tmp_path: Path, behind: Callable[[SimulatedDevice], str]
) -> None:
    virtual = SimulatedDevice("MTi-630")
    with xbus.connect(virtual) as device:
        device.go_to_config()
        device.set_output_configuration({})
    result = run("record", behind(virtual), "-o", str(tmp_path / "log.mtb"))
    assert sentence(result).startswith("sim:MTi-630 sends nothing")
    assert virtual.state == State.CONFIG
