"""Several jobs on one port: a recording with the monitor, with corrections from a caster, and with both."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pynmeagps
import pytest

import xbus
from conftest import AlteredDevice
from streams import frame
from test_cli import run, sentence, start
from test_cli_monitor_terminal import LEFT, Seen, monitoring
from test_cli_ntrip import rover, serving_fast
from test_cli_record import FULL, end, in_a_thread
from test_recording import parted, wait_until
from test_rtk import FRAMES, LocalCaster, serving_caster
from xbus import SimulatedDevice
from xbus.geometry.earth import ORIGIN
from xbus.rtk import Fix
from xbus.sim import PtyServer, serving
from xbus.watch.corrections import Corrections

pytestmark = pytest.mark.skipif(os.name != "posix", reason="needs pseudo-terminals and signals")

WIDE = (160, 40)


@pytest.fixture
def local() -> Iterator[LocalCaster]:
    with serving_caster() as caster:
        yield caster


def caster_of(local: LocalCaster) -> list[str]:
    return ["--caster", local.address, "--mountpoint", "BASE"]


def last_words(seen: Seen) -> list[str]:
    """Returns the lines after the restored screen."""
    return seen.bytes.rpartition(LEFT)[2].decode().splitlines()


def wait_for_the_end(seen: Seen) -> None:
    """Reads the terminal until the main screen is back; a program stops if its output is not read."""
    seen.wait_until(lambda _: LEFT in seen.bytes, "the end")


# With the monitor


@pytest.mark.parametrize("how", ["q", "SIGINT", "SIGTERM"])
def test_the_monitor_shows_a_recording(tmp_path: Path, how: str) -> None:
    path = tmp_path / "log.mtb"
    with (
        serving(SimulatedDevice("MTi-680G")) as port,
        monitoring(port, "-o", str(path), "--monitor", command="record") as (seen, child),
    ):
        seen.wait_for("packet_counter", "REC ", "Measurement State", "no samples lost")
        seen.wait_until(lambda _: path.stat().st_size > 20_000)
        if how == "q":
            seen.press("q")
        else:
            child.send_signal(getattr(signal, how))
        wait_for_the_end(seen)
    log = xbus.read_log(path)
    (line,) = last_words(seen)
    assert line.startswith(f"{path}: ")
    assert f" s, {len(log):,} samples, " in line
    assert line.endswith("; no samples lost")
    assert (log.stats.lost_samples, log.stats.skipped_bytes) == (0, 0)
    assert log.product_code == "MTi-680G-8A1G6"


def test_the_duration_ends_the_monitor_too(tmp_path: Path) -> None:
    path = tmp_path / "log.mtb"
    args = ["sim:MTi-3", "-o", str(path), "--monitor", "--duration", "2"]
    with monitoring(*args, command="record") as (seen, _):
        wait_for_the_end(seen)
    (line,) = last_words(seen)
    assert re.match(rf"{path}: 2\.\d s, 2\d\d samples, ", line)


def test_files_are_rotated_below_the_monitor(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    args = ["sim:MTi-3", "-o", "log.mtb", "--monitor", "--rotate", "5kB"]
    with monitoring(*args, size=WIDE, command="record") as (seen, _):
        seen.wait_until(lambda _: (tmp_path / "log-0002.mtb").exists())
        seen.press("r")
        seen.wait_for("recording to log-000", " until q")
        seen.press("q")
    (line,) = last_words(seen)
    assert line.startswith("log.mtb to log-000")
    files = sorted(tmp_path.glob("*.mtb"), key=lambda file: (len(file.name), file.name))
    log = xbus.read_log(b"".join(parted(file)[1] for file in files))
    assert (log.stats.lost_samples, log.stats.skipped_bytes) == (0, 0)


def test_a_recording_with_the_monitor_continues_after_a_reconnection(tmp_path: Path) -> None:
    path, port = tmp_path / "log.mtb", str(tmp_path / "mti")
    virtual = SimulatedDevice("MTi-680G")
    args = [port, "-o", str(path), "--monitor", "--reconnect"]
    with (
        PtyServer(virtual, link=port) as server,
        in_a_thread(server),
        monitoring(*args, size=WIDE, command="record") as (seen, _),
    ):
        seen.wait_for("packet_counter")
        virtual.unplug()
        pulled = virtual.time
        seen.wait_for("port lost, waiting for it", "the port is gone")
        away = virtual.time - pulled
        virtual.plug()
        seen.wait_for("the port is back")
        size = path.stat().st_size
        seen.wait_until(lambda _: path.stat().st_size > size + 5000)
        seen.press("q")
    log = xbus.read_log(path)
    (line,) = last_words(seen)
    assert f" s, {len(log):,} samples, " in line
    assert away <= np.diff(log.time).max() <= virtual.time - pulled + 1


def test_a_pulled_plug_ends_the_monitor_too(tmp_path: Path) -> None:
    path = tmp_path / "log.mtb"
    virtual = SimulatedDevice("MTi-680G")
    with (
        serving(virtual) as port,
        monitoring(port, "-o", str(path), "--monitor", command="record", code=1) as (seen, _),
    ):
        seen.wait_for("packet_counter")
        virtual.unplug()
        wait_for_the_end(seen)
    (line,) = last_words(seen)
    assert line.startswith(f"xbus: {port}: the port is gone: unplugged")
    assert f"; {path}: " in line
    assert f" s, {len(xbus.read_log(path)):,} samples, " in line


def test_a_full_disk_ends_the_monitor_too(tmp_path: Path) -> None:
    path = tmp_path / "log.mtb"
    args = ["sim:MTi-630", "-o", str(path), "--monitor"]
    program = [sys.executable, "-c", FULL]
    with monitoring(*args, program=program, command="record", code=1) as (seen, _):
        wait_for_the_end(seen)
    (line,) = last_words(seen)
    assert line.startswith(f"xbus: {path}: File too large")
    assert f"the recording ends with the last whole frame; {path}: " in line
    assert xbus.read_log(path).stats.skipped_bytes == 0


def test_the_monitor_needs_a_terminal(tmp_path: Path) -> None:
    result = run("record", "sim:MTi-3", "-o", str(tmp_path / "log.mtb"), "--monitor")
    assert result.exit_code == 2
    assert "--monitor needs a terminal" in result.stderr
    assert list(tmp_path.iterdir()) == []


# With corrections


def notes_until(child: subprocess.Popen[bytes], words: str) -> list[str]:
    """Returns the notes of a recording up to one with these words."""
    assert child.stderr is not None
    notes: list[str] = []
    while not notes or words not in notes[-1]:
        line = child.stderr.readline().decode()
        assert line, notes
        notes.append(line.rstrip("\n"))
    return notes


def test_corrections_are_forwarded_while_recording(tmp_path: Path, local: LocalCaster) -> None:
    path = tmp_path / "log.mtb"
    with (
        serving_fast(rover()) as port,
        start("record", port, "-o", str(path), *caster_of(local), "--gga", "1") as child,
    ):
        notes = notes_until(child, "RTK fixed")
        child.send_signal(signal.SIGINT)
        code, line = end(child)
    reported = pynmeagps.NMEAReader.parse(local.gga.get(timeout=10))
    assert (reported.lat, reported.lon) == pytest.approx((ORIGIN.lat, ORIGIN.lon), abs=1e-5)
    assert code == 0
    assert [note for note in notes if "RTK" in note] == [
        "xbus: RTK none",
        "xbus: RTK float",
        "xbus: RTK fixed",
    ]
    assert f"xbus: corrections arrive from {local.address}" in notes
    log = xbus.read_log(path)
    assert f" s, {len(log):,} samples, " in line
    assert re.search(r" \d+ corrections sent, ", line)
    assert line.endswith("; no samples lost")
    acknowledged = sum(message.name == "ForwardGnssDataAck" for message in log.messages)
    assert acknowledged > 5
    assert set(log["status_word"].flags["rtk_status"]) == {0, 1, 2}


def test_a_flood_of_corrections_starves_neither_recording_nor_status(
    tmp_path: Path, local: LocalCaster
) -> None:
    local.PAUSE = 1e-6
    local.sends = [FRAMES[0] * 200]
    path = tmp_path / "log.mtb"

    def acknowledged() -> int:
        messages = xbus.read_log(path).messages
        return sum(message.name == "ForwardGnssDataAck" for message in messages)

    ours, theirs = os.openpty()
    try:
        with (
            serving_fast(rover()) as port,
            start("record", port, "-o", str(path), *caster_of(local), stderr=theirs) as child,
        ):
            output = b""
            while b"RTK float" not in output:
                output += os.read(ours, 1000)
            began, count = time.monotonic(), output.count(b"\r")
            while output.count(b"\r") < count + 20:
                output += os.read(ours, 1000)
            assert time.monotonic() - began < 10
            while acknowledged() <= 100:
                output += os.read(ours, 1000)
            child.send_signal(signal.SIGINT)
            assert child.wait(timeout=20) == 0
    finally:
        os.close(ours)
        os.close(theirs)
    log = xbus.read_log(path)
    assert log.stats.skipped_bytes == 0
    assert log.stats.lost_samples == 0


def test_refused_corrections_do_not_end_the_recording(tmp_path: Path, local: LocalCaster) -> None:
    device, path = AlteredDevice("MTi-680G", trajectory="still"), tmp_path / "log.mtb"
    ack, refusal = frame(0xE3), frame(0x42, b"\x21")
    device.alter = lambda data: data.replace(ack, refusal)
    with (
        serving(device) as port,
        start("record", port, "-o", str(path), *caster_of(local)) as child,
    ):
        notes = notes_until(child, "Error 33")
        size = path.stat().st_size
        wait_until(lambda: path.stat().st_size > size + 10_000)
        child.send_signal(signal.SIGINT)
        _, printed = child.communicate(timeout=20)
    assert notes[-1].startswith(
        "xbus: corrections: the device answered ForwardGnssData with Error 33"
    )
    assert child.returncode == 0
    assert b"corrections: the device answered" not in printed, "it is reported once"
    log = xbus.read_log(path)
    assert log.stats.lost_samples == 0
    assert sum(message.name == "Error" for message in log.messages) > 5


def test_a_lost_caster_does_not_end_the_recording(tmp_path: Path, local: LocalCaster) -> None:
    local.once = True
    path = tmp_path / "log.mtb"
    with (
        serving_fast(rover()) as port,
        start("record", port, "-o", str(path), *caster_of(local)) as child,
    ):
        notes = notes_until(child, "xbus connects again")
        notes += notes_until(child, "corrections arrive")
        child.send_signal(signal.SIGINT)
        code, line = end(child)
    assert any(note.startswith(f"xbus: corrections: {local.address} has hung up") for note in notes)
    assert code == 0
    assert line.endswith("; no samples lost")


@pytest.mark.parametrize("is_reachable", [True, False])
def test_a_caster_that_refuses_does_not_end_the_recording(
    tmp_path: Path, is_reachable: bool
) -> None:
    path = tmp_path / "log.mtb"
    with serving_caster() as local:
        address = local.address
        caster = ["--caster", address, "--mountpoint", "NOWHERE"]
        if not is_reachable:
            local.shutdown()
            local.server_close()
        with (
            serving_fast(rover()) as port,
            start("record", port, "-o", str(path), *caster) as child,
        ):
            notes = notes_until(child, "corrections:")
            size = path.stat().st_size
            wait_until(lambda: path.stat().st_size > size + 10_000)
            began = time.monotonic()
            child.send_signal(signal.SIGINT)
            code, line = end(child)
            assert time.monotonic() - began < 3
    expected = "has no mountpoint NOWHERE" if is_reachable else "cannot reach"
    assert expected in notes[-1]
    assert notes[-1].endswith("; the next attempt follows in 60 s")
    assert code == 0
    assert " 0 corrections sent, " in line


def test_corrections_continue_after_the_port_was_lost(tmp_path: Path, local: LocalCaster) -> None:
    path, port = tmp_path / "log.mtb", str(tmp_path / "mti")
    virtual = SimulatedDevice("MTi-680G", trajectory="still")
    with (
        PtyServer(virtual, link=port) as server,
        in_a_thread(server),
        start("record", port, "-o", str(path), *caster_of(local), "--reconnect") as child,
    ):
        notes = notes_until(child, "corrections arrive")
        virtual.unplug()
        notes += notes_until(child, "waiting for the port")
        virtual.plug()
        notes += notes_until(child, "is back")

        def acknowledged() -> int:
            log = xbus.read_log(path)
            names = [message.name for message in log.messages]
            return names[::-1].index("GoToMeasurementAck") if "GoToMeasurementAck" in names else 0

        wait_until(lambda: acknowledged() > 5)
        child.send_signal(signal.SIGINT)
        code, _ = end(child)
    assert code == 0
    assert notes[-1] == f"xbus: {port} is back"


def test_monitor_and_corrections_together(tmp_path: Path, local: LocalCaster) -> None:
    path = tmp_path / "log.mtb"
    with serving_fast(rover()) as port:
        args = [port, "-o", str(path), "--monitor", *caster_of(local), "--gga", "1"]
        with monitoring(*args, size=WIDE, command="record") as (seen, _):
            seen.wait_for("packet_counter", "REC ", "caster")
            seen.wait_for("RTK float", " messages, ", "GGA")
            seen.wait_for("RTK fixed")
            seen.press("?")
            seen.wait_for(f"corrections arrive from {local.address}")
            seen.press("x")
            seen.press("q")
    reported = pynmeagps.NMEAReader.parse(local.gga.get(timeout=10))
    assert (reported.lat, reported.lon) == pytest.approx((ORIGIN.lat, ORIGIN.lon), abs=1e-5)
    (line,) = last_words(seen)
    log = xbus.read_log(path)
    assert f" s, {len(log):,} samples, " in line
    assert " corrections sent, " in line
    assert log.stats.lost_samples == 0


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (["--caster", "caster.example"], "--mountpoint is missing; xbus ntrip --list"),
        (["--mountpoint", "BASE"], "--mountpoint needs --caster"),
        (["--gga", "1"], "--gga needs --caster"),
        (["--ntrip", "1"], "--ntrip needs --caster"),
        (["--caster", "ftp://a", "--mountpoint", "B"], "is not the address of a caster"),
    ],
)
def test_wrong_calls(tmp_path: Path, args: list[str], message: str) -> None:
    result = run("record", "sim:MTi-680G", "-o", str(tmp_path / "log.mtb"), *args)
    assert result.exit_code == 2
    assert message in result.stderr
    assert list(tmp_path.iterdir()) == []


def test_user_and_password_of_the_environment_need_no_caster(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XBUS_NTRIP_USER", "me")
    monkeypatch.setenv("XBUS_NTRIP_PASSWORD", "secret")
    path = str(tmp_path / "log.mtb")
    assert run("record", "sim:MTi-3", "-o", path, "--duration", "1").exit_code == 0


@pytest.mark.parametrize(
    ("port", "args", "message"),
    [
        ("sim:MTi-670", [], "the MTi-670 does not support ForwardGnssData"),
        (
            "sim:MTi-680G",
            ["--gga", "5", "--output", "acceleration=100"],
            "the device outputs no position for --gga; add gnss_pvt_data to its outputs",
        ),
    ],
)
def test_a_device_that_cannot_use_corrections(
    tmp_path: Path, local: LocalCaster, port: str, args: list[str], message: str
) -> None:
    path = tmp_path / "log.mtb"
    printed = sentence(run("record", port, "-o", str(path), *caster_of(local), *args))
    assert printed.startswith(message)
    assert local.requests == []
    assert not path.exists()


class BrokenCaster:
    """A caster whose library fails."""

    host, state, problem, gga_sent = "caster.example:2101", "idle", None, 0

    def read(self, timeout: float) -> bytes:
        raise ZeroDivisionError(f"after {timeout}")

    def close(self) -> None:
        pass


@pytest.mark.parametrize("persistent", [True, False])
def test_a_failure_of_the_library_is_reported(persistent: bool) -> None:
    corrections = Corrections(BrokenCaster(), Fix(), persistent=persistent)
    device = xbus.connect(rover())
    news: list[tuple[str, bool]] = []

    def has_news() -> bool:
        news.extend(corrections.news())
        return bool(news)

    with corrections.forwarding(device):
        wait_until(has_news)
        if persistent:
            corrections.read(device, 0.1)
        else:
            with pytest.raises(ZeroDivisionError):
                corrections.read(device, 0.1)
    assert news[0] == ("corrections have ended: ZeroDivisionError('after 0.2')", True)


# In Python


def test_record_read_and_forward_in_three_threads(tmp_path: Path) -> None:
    path = tmp_path / "log.mtb"
    with serving(rover()) as port, xbus.connect(port) as device:
        done = threading.Event()

        def corrections() -> Iterator[bytes]:
            while not done.wait(0.02):
                yield FRAMES[0]

        with device.record(path) as recording:
            thread = threading.Thread(target=device.forward_gnss, args=(corrections(),))
            thread.start()
            device.discard()
            blocks = device.blocks(seconds=0.2)
            count = sum(len(next(blocks)) for _ in range(10))
            done.set()
            thread.join()
        assert count > 150
        assert recording.error is None
        assert device.stats.dropped_samples == 0
    log = xbus.read_log(path)
    assert len(log) >= count
    assert log.stats.lost_samples == 0
    assert sum(message.name == "ForwardGnssDataAck" for message in log.messages) > 20
