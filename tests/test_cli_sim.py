"""``xbus sim``: a virtual device for other programs."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NoReturn

import numpy as np
import pytest
import serial

from conftest import OWN_CAPTURES
from streams import frame
from test_cli import run, sentence, start
from test_recording import LONG
from test_sim_serve import needs_ipv6
from xbus.protocol.configuration import Firmware
from xbus.sim.faults import Faults
from xbus.sim.options import OPTIONS
from xbus.sim.replay import Replay
from xbus.sim.trajectories import TRAJECTORIES

WALK = str(OWN_CAPTURES / "walk.mtb")
GO_TO_CONFIG, GO_TO_CONFIG_ACK = frame(0x30), frame(0x31)
REQ_DID, REQ_PRODUCT_CODE = frame(0x00), frame(0x1C)


def first_line(child: subprocess.Popen[bytes]) -> str:
    """Returns the port that the command prints when it is ready."""
    assert child.stdout is not None
    output = child.stdout.readline().decode()
    assert output.startswith("port: ")
    assert output.endswith("\n")
    return output[len("port: ") : -1]


@contextmanager
def simulated(
    *args: str, product: str = "MTi-680G"
) -> Iterator[tuple[str, subprocess.Popen[bytes]]]:
    """Yields the port of a running command, and the command, which must end quietly."""
    named = ["--product", product] if product else []
    with start("sim", *named, *args) as child:
        try:
            yield first_line(child), child
            child.send_signal(signal.SIGINT)
            out, err = child.communicate(timeout=LONG)
            assert (child.returncode, out, err) == (0, b"", b"")
        finally:
            child.kill()


def answer(port: serial.Serial, request: bytes, beginning: bytes) -> bytes:
    """Sends a request, skips to the frame with this beginning, and returns the payload of that frame."""
    port.write(request)
    port.read_until(beginning)
    size = port.read(1)[0]
    return port.read(size + 1)[:-1]


def config(port: serial.Serial) -> None:
    answer(port, GO_TO_CONFIG, GO_TO_CONFIG_ACK[:3])


def product_code(port: serial.Serial) -> str:
    config(port)
    return answer(port, REQ_PRODUCT_CODE, b"\xfa\xff\x1d").decode().strip()


def test_on_a_pseudo_terminal() -> None:
    with simulated() as (path, _), serial.Serial(path, 115200, timeout=LONG) as port:
        assert product_code(port).startswith("MTi-680G")


@pytest.mark.parametrize("where", ["0", "127.0.0.1:0", pytest.param("[::1]:0", marks=needs_ipv6)])
def test_on_tcp(where: str) -> None:
    with simulated("--tcp", where, product="MTi-3") as (url, _):
        assert url.startswith("socket://[::1]:" if "::" in where else "socket://127.0.0.1:")
        with serial.serial_for_url(url, timeout=LONG) as port:
            assert product_code(port).startswith("MTi-3")


def test_a_serial_device_answers_at_one_rate_only() -> None:
    with simulated("--baudrate", "921600") as (path, _):
        with serial.Serial(path, 921600, timeout=LONG) as port:
            assert product_code(port).startswith("MTi-680G")
        with serial.Serial(path, 115200, timeout=0.2) as port:
            port.write(REQ_PRODUCT_CODE)
            assert b"MTi-680G" not in port.read(1000)


def test_a_link_leads_to_the_port(tmp_path: Path) -> None:
    link = tmp_path / "mti"
    with simulated("--link", str(link)) as (path, _):
        assert path == str(link)
        with serial.Serial(path, timeout=LONG) as port:
            config(port)
    assert not link.is_symlink()


def test_a_recording_is_sent() -> None:
    with (
        simulated("--replay", WALK, product="") as (path, _),
        serial.Serial(path, timeout=LONG) as port,
    ):
        assert product_code(port) == "MTi-680G-8A1G6"
        sent = b"".join(data for _, data in Replay(WALK).play(0.0).take(0.5))
        port.write(frame(0x10))
        port.read_until(frame(0x11))
        assert port.read(len(sent)) == sent


def read_forever(port: serial.Serial) -> NoReturn:
    while True:
        port.read(1000)


def test_a_replugged_device_has_a_new_port() -> None:
    with simulated("--fault", "unplug=3:0.1") as (path, child):
        with (
            serial.Serial(path, timeout=LONG) as port,
            pytest.raises((serial.SerialException, OSError)),
        ):
            read_forever(port)
        with serial.Serial(first_line(child), timeout=LONG) as port:
            config(port)


def test_options_reach_the_device(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[tuple[object, dict[str, object]]] = []

    def device(product: object, **options: object) -> NoReturn:
        made.append((product, options))
        raise ValueError("enough")

    monkeypatch.setattr("xbus.sim.device.SimulatedDevice", device)
    args = (
        "--trajectory fly --noise 0.5 --seed 7 --baudrate 460800 --fault drop=0.1 --fault burst=1 "
        "--device-id 0388ABCD --firmware 1.2.3 --utc 2026-11-28T12:00 --time-to-fix 0 --no-strict-outputs"
    )
    assert run("sim", "--product", "MTi-3", *args.split()).exit_code == 2
    assert run("sim", "--product", "MTi-3").exit_code == 2
    assert made == [
        (
            "MTi-3",
            {
                "trajectory": "fly",
                "noise": 0.5,
                "seed": 7,
                "baudrate": 460800,
                "faults": Faults(drop=0.1, burst=1, seed=7),
                "device_id": 0x0388ABCD,
                "firmware": Firmware(1, 2, 3),
                "utc": np.datetime64("2026-11-28T12:00", "ns"),
                "time_to_fix": 0,
                "strict_outputs": False,
                "replay": None,
            },
        ),
        ("MTi-3", {"replay": None}),
    ]


def test_help_has_every_option_of_a_device() -> None:
    words = run("sim", "--help").stdout
    for option in OPTIONS:
        assert f"--{option.replace('_', '-')} " in words


def test_faster_than_real_time() -> None:
    began = time.monotonic()
    result = run("sim", "--product", "MTi-630", "--speed", "1000", "--duration", "100")
    assert result.exit_code == 0
    assert time.monotonic() - began < 50


def test_an_idle_client_is_disconnected() -> None:
    with (
        simulated("--tcp", "0", "--idle-timeout", "0.2") as (url, _),
        serial.serial_for_url(url, timeout=LONG) as port,
    ):
        config(port)
        with pytest.raises(serial.SerialException):
            port.read(1)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_the_simulation_quietly(tmp_path: Path, number: int) -> None:
    link = tmp_path / "mti"  # another process may use the name of the port again
    with start("sim", "--product", "MTi-630", "--link", str(link)) as child:
        assert first_line(child) == str(link)
        child.send_signal(number)
        out, err = child.communicate(timeout=LONG)
    assert (child.returncode, out, err) == (0, b"", b"")
    assert not link.is_symlink()


def test_duration_ends_the_simulation() -> None:
    result = run("sim", "--product", "MTi-630", "--duration", "0.05")
    assert result.exit_code == 0
    assert result.stdout.startswith("port: /dev/")
    assert result.stdout.count("\n") == 1
    assert result.stderr == ""


@pytest.mark.parametrize(
    ("args", "output"),
    [
        ([], "--product is missing; choose from MTi-1, MTi-2"),
        (["--product", "MTi-5"], "MTi-1, MTi-2"),
        (["--product", "MTi-3", "--trajectory", "loop"], "still, turn, tumble"),
        (["--product", "MTi-3", "--baudrate", "12345"], "does not support 12,345 baud"),
        (["--product", "MTi-3", "--noise", "-1"], "-1"),
        (["--product", "MTi-3", "--fault", "flop=1"], "'flop=1' is not a fault: use flip=P"),
        (["--product", "MTi-3", "--fault", "flip=2"], "flip is a probability"),
        (["--product", "MTi-3", "--device-id", "x"], "device_id must be a hexadecimal number"),
        (["--product", "MTi-3", "--firmware", "1.2"], "firmware must be MAJOR.MINOR.REVISION"),
        (["--product", "MTi-3", "--utc", "noon"], "utc must be a date and time"),
        (["--product", "MTi-3", "--time-to-fix", "-1"], "time_to_fix must be seconds, 0 or more"),
        (["--product", "MTi-3", "--speed", "0"], "--speed"),
        (["--product", "MTi-3", "--idle-timeout", "1"], "--idle-timeout is for --tcp"),
        (["--product", "MTi-3", "--tcp", "0", "--link", "x"], "--link"),
        (["--product", "MTi-3", "--tcp", "here"], "--tcp takes [HOST:]PORT"),
        (["--product", "MTi-3", "--tcp", "1:70000"], "--tcp takes [HOST:]PORT"),
        (["--replay", str(OWN_CAPTURES / "field.mtb")], "field.mtb has no product; choose a --product"),
    ],
)  # fmt: skip
def test_wrong_calls(args: list[str], output: str) -> None:
    result = run("sim", *args)
    assert result.exit_code == 2
    assert output in result.stderr
    assert result.stdout == ""


def test_failures_are_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    product = ["sim", "--product", "MTi-3"]
    (tmp_path / "text").write_text("no frame")
    assert "nowhere.mtb: No such file" in sentence(run(*product, "--replay", "nowhere.mtb"))
    assert "no Xbus frame in" in sentence(run(*product, "--replay", str(tmp_path / "text")))
    assert "text: the path exists and is not a symbolic link" in sentence(
        run(*product, "--link", str(tmp_path / "text"))
    )
    assert "no/mti" in sentence(run(*product, "--link", str(tmp_path / "no" / "mti")))
    assert "cannot listen on 192.0.2.1:0: " in sentence(run(*product, "--tcp", "192.0.2.1:0"))
    monkeypatch.delattr(os, "openpty")
    assert "--tcp 0" in sentence(run(*product))


def test_help_names_the_trajectories() -> None:
    words = " ".join(run("sim", "--help").stdout.split())
    *most, last = TRAJECTORIES
    assert f"{', '.join(most)} or {last}." in words
