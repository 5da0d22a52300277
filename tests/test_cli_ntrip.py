"""``xbus ntrip``: corrections from a caster on this machine to virtual devices."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pynmeagps
import pytest

from test_cli import run, sentence, start
from test_rtk import FRAMES, NMEA, LocalCaster, serving_caster
from xbus import SimulatedDevice, connect
from xbus.geometry.earth import ORIGIN
from xbus.protocol import State
from xbus.sim import serving
from xbus.sim.serve import PtyServer, serve

#: Devices run this much faster than the clock, so that 8 s to a fixed position take 1 s.
SPEED = 8


@contextmanager
def serving_fast(device: SimulatedDevice) -> Iterator[str]:
    done = threading.Event()
    with PtyServer(device, clock=lambda: SPEED * time.monotonic()) as server:
        thread = threading.Thread(target=serve, args=(server, done.is_set))
        thread.start()
        try:
            yield str(server.port)
        finally:
            done.set()
            thread.join()


def rover(**options: Any) -> SimulatedDevice:
    """Returns an MTi-680G that has a fix."""
    device = SimulatedDevice("MTi-680G", trajectory="still", **options)
    device.advance(5)
    device.read()
    return device


@pytest.fixture
def local() -> Iterator[LocalCaster]:
    with serving_caster() as caster:
        yield caster


@contextmanager
def started(
    port: str, local: LocalCaster, *args: str, **options: Any
) -> Iterator[subprocess.Popen[bytes]]:
    """Yields the running command, which must end quietly."""
    caster = ["--caster", local.address, "--mountpoint", "BASE"]
    with start("ntrip", port, *caster, *args, **options) as child:
        try:
            yield child
            child.send_signal(signal.SIGINT)
            child.communicate(timeout=10)
            assert child.returncode == 0
        finally:
            child.kill()


def statuses(child: subprocess.Popen[bytes]) -> Iterator[dict[str, Any]]:
    assert child.stdout is not None
    for line in child.stdout:
        yield json.loads(line)


def wanted(*args: str, port: str = "sim:MTi-680G", mountpoint: str = "BASE") -> str:
    return sentence(run("ntrip", port, *args, "--mountpoint", mountpoint))


# Corrections


def test_rtk_status_goes_from_none_over_float_to_fixed(local: LocalCaster) -> None:
    device = rover()
    with serving_fast(device) as port, started(port, local, "--json") as child:
        seen = []
        for status in statuses(child):
            seen.append(status)
            if status["rtk"] == "fixed":
                break
    assert list(dict.fromkeys(item["rtk"] for item in seen if item["rtk"])) == [
        "none",
        "float",
        "fixed",
    ]
    last = seen[-1]
    assert last["fix"] == "yes"
    assert last["caster"] == "streaming"
    assert last["problem"] is None
    assert last["messages"] > 5
    assert last["bytes"] >= last["messages"] * min(map(len, FRAMES))
    assert last["unanswered"] == 0
    assert last["age_s"] < 5
    assert device.state == State.MEASUREMENT


def test_only_rtcm_is_forwarded(local: LocalCaster) -> None:
    device = rover()
    written = bytearray()
    write = device.write

    def note(data: bytes, baudrate: int | None = None) -> None:
        written.extend(data)
        write(data, baudrate)

    device.write = note  # type: ignore[method-assign]
    local.sends = [NMEA, FRAMES[0]]
    with serving_fast(device) as port, started(port, local, "--json") as child:
        next(status for status in statuses(child) if status["rtk"] == "float")
    assert FRAMES[0] in written
    assert b"GPGGA" not in written


def test_the_caster_receives_the_position(local: LocalCaster) -> None:
    with serving_fast(rover()) as port, started(port, local, "--json", "--gga", "1") as child:
        assert next(status for status in statuses(child) if status["gga"])["gga"] == 1
        reported = pynmeagps.NMEAReader.parse(local.gga.get(timeout=10))
    assert (reported.lat, reported.lon) == pytest.approx((ORIGIN.lat, ORIGIN.lon), abs=1e-5)


def test_no_position_is_sent_before_the_first_fix(local: LocalCaster) -> None:
    device = rover(time_to_fix=12)
    with serving_fast(device) as port, started(port, local, "--json", "--gga", "1") as child:
        found = statuses(child)
        waiting = next(found)
        assert (waiting["caster"], waiting["messages"]) == ("no position", 0)
        assert next(item for item in found if item["caster"] == "streaming")["fix"] == "yes"
    assert "Ntrip-GGA" in local.requests[0]


def test_status_lines_are_readable(local: LocalCaster) -> None:
    with serving_fast(rover()) as port, started(port, local) as child:
        assert child.stderr is not None
        lines = iter(child.stderr.readline, b"")
        line = next(line.decode() for line in lines if b"RTK float" in line)
    words = line.split(", ")
    assert words[:2] == ["fix yes", "RTK float"]
    assert words[2].endswith(" messages")
    assert line.endswith(" s ago\n")


def test_a_terminal_has_one_status_line(local: LocalCaster) -> None:
    ours, theirs = os.openpty()
    try:
        with serving_fast(rover()) as port, started(port, local, stderr=theirs):
            output = b""
            while b"RTK float" not in output:
                output += os.read(ours, 1000)
    finally:
        os.close(ours)
        os.close(theirs)
    assert b"\n" not in output
    assert all(len(part) < 80 for part in output.split(b"\r")[1:])


def test_a_lost_caster_is_reported_and_reconnected(local: LocalCaster) -> None:
    local.once = True
    with serving_fast(rover()) as port, started(port, local, "--json") as child:
        found = statuses(child)
        lost = next(item for item in found if item["caster"] == "lost")
        assert lost["problem"].startswith(f"{local.address} has hung up")
        assert lost["messages"] > 0
        again = next(item for item in found if item["caster"] == "streaming")
        assert again["problem"] is None
    assert len(local.requests) >= 2


def test_a_flood_of_corrections_leaves_time_for_the_status(local: LocalCaster) -> None:
    local.PAUSE = 1e-6
    local.sends = [FRAMES[0] * 200]
    ours, theirs = os.openpty()
    try:
        with serving_fast(rover()) as port, started(port, local, stderr=theirs):
            output = b""
            while b"RTK float" not in output:
                output += os.read(ours, 1000)
            start, count = time.monotonic(), output.count(b"\r")
            while output.count(b"\r") < count + 10:
                output += os.read(ours, 1000)
            assert time.monotonic() - start < 15
    finally:
        os.close(ours)
        os.close(theirs)


def test_the_mountpoints_of_a_caster(local: LocalCaster) -> None:
    result = run("ntrip", "--caster", local.address, "--list")
    assert result.exit_code == 0
    head, first, second = result.stdout.splitlines()
    assert head.split()[0] == "mountpoint"
    assert first.split()[0] == "BASE"
    assert "52.24, 6.85" in first
    assert second.split()[0] == "OTHER"
    rows = json.loads(run("ntrip", "--caster", local.address, "--list", "--json").stdout)
    assert [(row["name"], row["needs_position"]) for row in rows] == [
        ("BASE", True),
        ("OTHER", False),
    ]
    local.style = "silent"
    failed = run("ntrip", "--caster", local.address, "--list")
    assert failed.exit_code == 1
    assert "hangs up without an answer" in failed.stderr


# Failures


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (["--mountpoint", "BASE"], "PORT is missing"),
        (["sim:MTi-680G"], "--mountpoint is missing; xbus ntrip --list"),
        (["sim:MTi-680G", "--mountpoint", "A\r\nB"], "mountpoint has a line break"),
        (["sim:MTi-680G", "--mountpoint", "A", "--user", "a\n"], "user has a line break"),
        (["--list", "--password", "a\n"], "password has a line break"),
    ],
)
def test_wrong_calls(args: list[str], message: str) -> None:
    result = run("ntrip", "--caster", "caster.example", *args)
    assert result.exit_code == 2
    assert message in result.stderr


def test_an_unknown_mountpoint(local: LocalCaster) -> None:
    output = wanted("--caster", local.address, mountpoint="NOWHERE")
    assert output == (
        f"{local.address} has no mountpoint NOWHERE; xbus ntrip --list prints those that it has"
    )


def test_a_wrong_password_is_reported(local: LocalCaster, monkeypatch: pytest.MonkeyPatch) -> None:
    local.account = ("me", "secret")
    monkeypatch.setenv("XBUS_NTRIP_PASSWORD", "wrong")
    output = wanted("--caster", local.address, "--user", "me")
    assert output == f"{local.address} does not let that user in (401); check user and password"
    assert "Authorization" in local.requests[0]


def test_no_caster_answers() -> None:
    with serving_caster() as gone:
        address = gone.address
    assert wanted("--caster", address) == f"cannot reach {address}: Connection refused"


def test_a_product_without_rtk(local: LocalCaster) -> None:
    output = wanted("--caster", local.address, port="sim:MTi-670")
    assert output.startswith("the MTi-670 does not support ForwardGnssData")
    assert "MTi-680G" in output
    assert local.requests == []


def test_a_device_that_does_not_measure(local: LocalCaster) -> None:
    with serving(rover()) as port:
        with connect(port) as device:
            device.go_to_config()
        output = wanted("--caster", local.address, port=port)
    assert output.startswith("the device is in Config State")
    assert f"xbus send {port} GoToMeasurement" in output


def test_a_device_without_a_position(local: LocalCaster) -> None:
    with serving(rover()) as port:
        with connect(port) as device, device.configure({"acceleration": 100}):
            pass
        output = wanted("--caster", local.address, "--gga", "5", port=port)
    assert "add gnss_pvt_data" in output


def test_no_port(local: LocalCaster) -> None:
    output = wanted("--caster", local.address, port="/dev/nowhere")
    assert output.startswith("cannot open /dev/nowhere")


def test_an_invalid_caster_address_is_a_wrong_call() -> None:
    result = run("ntrip", "sim:MTi-680G", "--caster", "ftp://a", "--mountpoint", "BASE")
    assert result.exit_code == 2
    assert "is not the address of a caster" in result.stderr


def test_without_the_extra(local: LocalCaster, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pygnssutils", None)
    output = wanted("--caster", local.address)
    assert output == (
        'to get corrections from a caster, pygnssutils is needed: pip install "xbus-mti[rtk]"'
    )
