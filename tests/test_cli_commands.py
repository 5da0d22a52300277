"""``xbus identify``, ``baudrate``, ``reset`` and ``restore``: what other commands recommend for a device."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from click.testing import Result

from test_cli import run, sentence
from xbus import Device, SimulatedDevice, XbusTimeout, connect
from xbus.protocol import State
from xbus.protocol.configuration import Firmware
from xbus.protocol.messages import encode
from xbus.protocol.values import ErrorCode, OptionFlag, Selftest
from xbus.sim import serving
from xbus.sim.commands import COMMANDS
from xbus.sim.setting_commands import Refused

NINE = [
    f"{sensor}_{axis}"
    for sensor in ("accelerometer", "gyroscope", "magnetometer")
    for axis in "xyz"
]


@contextmanager
def served(product: str, **options: Any) -> Iterator[tuple[str, SimulatedDevice]]:
    """Yields the port of a device that measures, and the device."""
    device = SimulatedDevice(product, **options)
    device.advance(1)
    device.read()
    with serving(device) as port:
        yield port, device


def done(result: Result) -> str:
    """Returns the stderr of a command that succeeds."""
    assert (result.exit_code, result.stdout) == (0, ""), result.output
    return result.stderr


def wait_until(state: State, device: SimulatedDevice) -> None:
    for _ in range(500):
        if device.state == state:
            return
        time.sleep(0.01)
    raise AssertionError(f"the device is in {device.state}")


# identify


def test_a_device_is_identified() -> None:
    options = {"device_id": 0x0388ABCD, "firmware": Firmware(1, 2, 3, 45, 6), "baudrate": 460800}
    with served("MTi-3", **options) as (port, device):
        result = run("identify", port)
        facts = json.loads(run("identify", port, "--json").stdout)
        wait_until(State.MEASUREMENT, device)
    assert (result.exit_code, result.stderr) == (0, "")
    rows = [line.split(maxsplit=1) for line in result.stdout.splitlines()]
    assert rows[:7] == [
        ["port", f"{port} at 460,800 baud"],
        ["product", "MTi-3 AHRS"],
        ["code", "MTi-3-8A7G6"],
        ["id", "0388ABCD"],
        ["firmware", "1.2.3 build 45"],
        ["hardware", "2.0"],
        ["self-test", "passed"],
    ]
    assert result.stdout.count(" passed\n") == 10
    assert facts == {
        "port": port,
        "baudrate": 460800,
        "product": "MTi-3 AHRS",
        "product_code": "MTi-3-8A7G6",
        "device_id": "0388ABCD",
        "firmware": "1.2.3",
        "build": 45,
        "hardware": "2.0",
        "selftest": dict.fromkeys(NINE, True)
        | dict.fromkeys(["baro", "gnss", "battery", "flash", "button", "sync"]),
    }


def test_a_failed_component_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    flags = Selftest(0x1FF) & ~Selftest.GYR_Y & ~Selftest.MAG_Z
    monkeypatch.setitem(COMMANDS, "RunSelftest", lambda *_: encode("SelftestResults", flags))
    result = run("identify", "sim:MTi-630")
    assert sentence(result).startswith(
        "the self-test of sim:MTi-630 failed: gyroscope y, magnetometer z; "
    )
    lines = [line.split() for line in result.stdout.splitlines()]
    assert ["self-test", "failed"] in lines
    assert ["gyroscope", "y", "failed"] in lines
    assert ["gyroscope", "x", "passed"] in lines
    result = run("identify", "sim:MTi-630", "--json")
    assert result.exit_code == 1
    tested = json.loads(result.stdout)["selftest"]
    assert [name for name, passed in tested.items() if passed is False] == [
        "gyroscope_y",
        "magnetometer_z",
    ]


def test_a_refused_self_test_has_no_result(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> bytes:
        raise Refused(ErrorCode.MESSAGE)

    monkeypatch.setitem(COMMANDS, "RunSelftest", refuse)
    result = run("identify", "sim:MTi-630")
    assert result.exit_code == 0
    assert "self-test  no result: " in result.stdout
    assert json.loads(run("identify", "sim:MTi-630", "--json").stdout)["selftest"] is None


# baudrate


@pytest.mark.parametrize("product", ["MTi-300", "MTi-630"])
def test_the_baud_rate_is_changed_and_stays(product: str) -> None:
    with served(product, baudrate=115200) as (port, device):
        shown = done(run("baudrate", port, "921600"))
        assert shown == f"xbus: {port} uses 921,600 baud now, before 115,200\n"
        wait_until(State.MEASUREMENT, device)
        device.power_cycle()
        wait_until(State.MEASUREMENT, device)
        assert device.baudrate == 921600
        done(run("baudrate", port, "57600", "--from", "921600"))
        assert device.baudrate == 57600


def test_a_missed_wake_up_is_no_failure(monkeypatch: pytest.MonkeyPatch) -> None:
    """A slow computer changes the rate of its port when the device has already started to measure."""
    with served("MTi-300", baudrate=115200) as (port, virtual):

        def miss(device: Device, timeout: float = 2.0) -> None:
            wait_until(State.MEASUREMENT, virtual)
            raise XbusTimeout("no WakeUp", "WakeUpAck", timeout)

        with connect(port, 115200) as device:
            device.go_to_config()
            monkeypatch.setattr(Device, "wake_up", miss)
            device.set_baudrate(57600)
            assert (virtual.baudrate, device.link.baudrate) == (57600, 57600)
            assert (virtual.state, device.state) == (State.CONFIG, State.CONFIG)


@pytest.mark.parametrize(
    ("action", "command"),
    [
        (lambda device: device.set_baudrate(57600), "SetBaudrate"),
        (lambda device: device.restore_factory_settings(), "RestoreFactoryDef"),
    ],
)
def test_a_device_that_is_lost_by_a_restart_names_the_command(
    action: Any, command: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def miss(device: Device, *_: object) -> None:
        raise XbusTimeout("nothing came", "WakeUpAck", 1.0)

    with served("MTi-300", baudrate=921600) as (port, _), connect(port, 921600) as device:
        device.go_to_config()
        monkeypatch.setattr(Device, "wake_up", miss)
        monkeypatch.setattr(Device, "find_baudrate", miss)
        with pytest.raises(XbusTimeout, match=r"neither at \d+ nor at 921600 baud") as caught:
            action(device)
        assert caught.value.command == command


def test_an_unsupported_rate_changes_nothing() -> None:
    with served("MTi-300", baudrate=115200) as (port, device):
        shown = sentence(run("baudrate", port, "4000000"))
        assert shown.startswith("the MTi-300 does not support 4000000 baud")
        assert shown.endswith("; nothing was changed")
        wait_until(State.MEASUREMENT, device)
        assert device.baudrate == 115200
    assert run("baudrate", "sim:MTi-300", "0").exit_code == 2


# reset


def test_a_device_restarts() -> None:
    with served("MTi-630") as (port, device):
        with connect(port) as connected:
            connected.go_to_config()
        sent = device.sent
        shown = done(run("reset", port))
        assert shown == f"xbus: {port} has restarted; its state is measurement\n"
        assert device.sent > sent
        wait_until(State.MEASUREMENT, device)
        assert done(run("reset", port, "--config")).endswith("its state is config\n")
        assert device.state == State.CONFIG


def test_a_device_without_auto_measurement_stays_in_config_state() -> None:
    with served("MTi-3") as (port, device):
        with connect(port) as connected, connected.configure():
            connected.commands.set_option_flags(OptionFlag.DISABLE_AUTO_MEASUREMENT)
        assert done(run("reset", port)).endswith("its state is config\n")
        assert device.state == State.CONFIG


# restore


def test_communication_is_restored_when_the_device_is_power_cycled() -> None:
    with served("MTi-300", baudrate=460800) as (port, device):
        stopped = threading.Event()

        def switch() -> None:
            while not stopped.wait(0.3):
                device.power_cycle()

        thread = threading.Thread(target=switch)
        thread.start()
        try:
            shown = done(run("restore", port, "--timeout", "30"))
        finally:
            stopped.set()
            thread.join()
    lines = shown.splitlines()
    assert lines[0] == "xbus: switch the device off and on now, within 30 s"
    assert lines[1].startswith(f"xbus: {port} answers at 115,200 baud")


def test_restore_times_out_without_a_power_cycle() -> None:
    with served("MTi-300", baudrate=460800) as (port, _):
        result = run("restore", port, "--timeout", "0.5")
    assert result.exit_code == 1
    assert "no device woke up within 0.5 s" in result.stderr


# All four commands


@pytest.mark.parametrize("command", [["identify"], ["baudrate", "115200"], ["reset"], ["restore"]])
def test_no_port(command: list[str]) -> None:
    name, *rest = command
    shown = sentence(run(name, "/dev/nowhere", *rest))
    assert shown.startswith("cannot open /dev/nowhere: No such file or directory")
    assert run(name, "sim:MTi-5", *rest).exit_code == 2


# quantities


def test_quantities_state_their_axes() -> None:
    rows = {row["name"]: row for row in json.loads(run("quantities", "--json").stdout)}
    assert rows["acceleration"]["axes"] == "sensor"
    assert rows["free_acceleration"]["axes"] == rows["velocity_xyz"]["axes"] == "local"
    assert rows["quaternion"]["axes"] == "sensor to local"
    assert rows["lat_lon"]["axes"] == "earth"
    assert rows["temperature"]["axes"] is None
    assert all(row["axes"] for row in rows.values() if row["coordinates"])
    head, *lines = run("quantities", "acceleration").stdout.splitlines()
    at = head.index("axes")
    assert [line[at:].split()[0] for line in lines] == ["sensor", "local", "sensor"]
