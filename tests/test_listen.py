"""Ports that are opened only to listen: no command with ``--listen`` sends a byte."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from pathlib import Path

import pytest

import xbus
from conftest import AlteredDevice
from test_cli import run, sentence
from test_cli_record import end, in_a_thread, recording
from test_recording import wait_until
from xbus import SimulatedDevice
from xbus.protocol import State
from xbus.sim import PtyServer, serving

pytestmark = pytest.mark.skipif(os.name != "posix", reason="needs pseudo-terminals and signals")


def measuring(product: str = "MTi-630", **options: object) -> AlteredDevice:
    """Returns a device that has sent everything that it sends after power-up."""
    device = AlteredDevice(product, **options)
    device.advance(1)
    device.read()
    return device


# Recordings


def test_a_recording_sends_nothing(tmp_path: Path) -> None:
    sim, path = measuring(), tmp_path / "log.mtb"
    with serving(sim) as port, recording(port, path, "--listen") as child:
        child.send_signal(signal.SIGINT)
        code, line = end(child)
    assert sim.written == []
    log = xbus.read_log(path)
    assert code == 0
    assert line.startswith(f"{path}: ")
    assert f" s, {len(log):,} samples, " in line
    assert len(log) > 10
    assert (log.stats.lost_samples, log.stats.skipped_bytes) == (0, 0)
    assert sim.state == State.MEASUREMENT


def test_nothing_is_sent_when_the_port_comes_back(tmp_path: Path) -> None:
    path, port = tmp_path / "log.mtb", str(tmp_path / "mti")
    sim = AlteredDevice("MTi-630")
    with (
        PtyServer(sim, link=port) as server,
        in_a_thread(server),
        recording(port, path, "--listen", "--reconnect") as child,
    ):
        assert child.stderr is not None
        sim.unplug()
        lines = [child.stderr.readline().decode()]
        sim.plug()
        lines.append(child.stderr.readline().decode())
        size = path.stat().st_size
        wait_until(lambda: path.stat().st_size > size + 5000)
        child.send_signal(signal.SIGINT)
        code, _ = end(child)
    assert code == 0
    assert lines[0].endswith("; waiting for the port\n")
    assert lines[1] == f"xbus: {port} is back\n"
    assert sim.written == []


def test_the_file_starts_with_the_identity_that_was_heard(tmp_path: Path) -> None:
    path = tmp_path / "log.mtb"
    sim = AlteredDevice("MTi-630")
    with serving(sim) as port:  # from power-up, when the device sends Configuration
        result = run("record", port, "-o", str(path), "--listen", "--duration", "1")
    assert result.exit_code == 0
    assert sim.written == []
    log = xbus.read_log(path)
    assert log.product_code == sim.identity.product_code
    assert log.device_id == sim.identity.device_id
    first = next(iter(log.messages))
    assert (first.name, first.offset) == ("Configuration", 0)
    shown = run("info", str(path))
    assert shown.exit_code == 0
    assert f"device    {sim.identity.product_code}, id " in shown.stdout


def test_a_file_without_an_identity_is_valid(tmp_path: Path) -> None:
    path = tmp_path / "log.mtb"
    with serving(measuring()) as port:
        assert run("record", port, "-o", str(path), "--listen", "--duration", "1").exit_code == 0
    assert "not named in this log" in run("info", str(path)).stdout


def test_a_silent_line_is_no_error(
    tmp_path: Path, behind: Callable[[SimulatedDevice], str]
) -> None:
    path, sim = tmp_path / "log.mtb", measuring()
    sim.alter = lambda data: data if sim.time > 10 else b""
    args = ["--listen", "--baudrate", "115200", "--duration", "12"]
    result = run("record", behind(sim), "-o", str(path), *args)
    assert result.exit_code == 0
    first, last = result.stderr.splitlines()
    assert first == "xbus: no data for 5 s; the recording continues"
    assert last.startswith(f"{path}: 12.0 s, ")
    assert len(xbus.read_log(path)) > 10
    assert sim.written == []


def test_a_silent_connection_is_no_error(tmp_path: Path) -> None:
    sim = measuring()
    sim.alter = lambda data: data if sim.time > 2 else b""
    with serving(sim, tcp=True) as port:
        result = run("record", port, "-o", str(tmp_path / "log.mtb"), "--listen", "--duration", "2")
    assert result.exit_code == 0
    assert len(xbus.read_log(tmp_path / "log.mtb")) > 10
    assert sim.written == []


def test_a_silent_line_without_a_baud_rate(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("xbus.device.channel.SLOWEST_SECONDS", 0.02)
    sim = measuring()
    sim.alter = lambda _: b""
    with serving(sim) as port:
        printed = sentence(run("record", port, "-o", str(tmp_path / "log.mtb"), "--listen"))
    assert printed.startswith(f"nothing was heard on {port} at 115200, 2000000, ")
    assert printed.endswith(
        "; with a baud rate (--baudrate) xbus waits for a device that is silent now"
    )
    assert sim.written == []


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("--output", "acceleration=100"),
        ("--config", "settings.toml"),
        ("--caster", "caster.example"),
    ],
)
def test_options_that_send_something_are_refused(tmp_path: Path, option: str, value: str) -> None:
    result = run("record", "sim:MTi-3", "-o", str(tmp_path / "a.mtb"), "--listen", option, value)
    assert result.exit_code == 2
    assert f"{option} sends messages to the device, and --listen sends nothing" in result.stderr


# The monitor


def test_the_monitor_sends_nothing() -> None:
    sim = measuring()
    with serving(sim) as port:
        result = run("monitor", port, "--listen", "--once", "1")
    assert result.exit_code == 0
    assert f"{port}  Measurement State, only listening  " in result.stdout
    assert "packet_counter" in result.stdout
    assert sim.written == []


def test_keys_that_need_commands_say_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("pyte")
    from test_cli_monitor_terminal import monitoring

    monkeypatch.chdir(tmp_path)
    sim, port = measuring(), str(tmp_path / "mti")
    with (
        PtyServer(sim, link=port) as server,
        in_a_thread(server),
        monitoring(port, "--listen", size=(120, 30)) as (seen, _),
    ):
        seen.wait_for("packet_counter", "only listening")
        seen.press("m")
        seen.wait_for("no command is sent: --listen")
        seen.press("r")
        seen.wait_for("REC ", "recording to xbus-")
        seen.press("r")
        seen.wait_for("recorded ")
        seen.press("q")
    assert sim.written == []
    (path,) = tmp_path.glob("xbus-*.mtb")
    assert xbus.read_log(path).stats.skipped_bytes == 0


def test_a_recording_with_the_monitor_sends_nothing(tmp_path: Path) -> None:
    pytest.importorskip("pyte")
    from test_cli_monitor_terminal import LEFT, monitoring

    sim, path = measuring(), tmp_path / "log.mtb"
    args = ["-o", str(path), "--listen", "--monitor"]
    with serving(sim) as port, monitoring(port, *args, command="record") as (seen, _):
        seen.wait_for("packet_counter", "only listening", "REC ")
        seen.press("mq")
        seen.wait_until(lambda _: LEFT in seen.bytes, "the end")
    assert sim.written == []
    assert xbus.read_log(path).stats.skipped_bytes == 0


def test_the_monitor_sends_nothing_when_the_port_comes_back(tmp_path: Path) -> None:
    pytest.importorskip("pyte")
    from test_cli_monitor_terminal import monitoring

    port = str(tmp_path / "mti")
    sim = AlteredDevice("MTi-630")
    with (
        PtyServer(sim, link=port) as server,
        in_a_thread(server),
        monitoring(port, "--listen", size=(120, 30)) as (seen, _),
    ):
        seen.wait_for("packet_counter")
        sim.unplug()
        seen.wait_for("port lost, waiting for it")
        sim.plug()
        seen.wait_for("the port is back")
        seen.wait_until(lambda text: "Measurement State" in text and "stopped" not in text)
        seen.press("q")
    assert sim.written == []


def test_a_recording_has_no_port_to_listen_to() -> None:
    result = run("monitor", "tests/captures/walk.mtb", "--listen", "--once", "1")
    assert result.exit_code == 2


# In Python


def test_a_line_that_is_silent_at_first() -> None:
    sim = SimulatedDevice("MTi-630")
    with xbus.connect(sim, 115200, listen=True) as device:
        assert device.is_listening
        assert device.read_sample() is not None
        with pytest.raises(xbus.StateError, match="opened only to listen"):
            device.go_to_config()
