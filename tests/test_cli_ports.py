"""``xbus ports``: where a device may be."""

from __future__ import annotations

import json
from typing import Any

import pytest
from serial.tools.list_ports_common import ListPortInfo

from test_cli import run
from xbus import Device, SimulatedDevice, XbusTimeout, connect
from xbus.sim import serving


def port(device: str, vid: int | None = None, pid: int | None = None, **more: Any) -> ListPortInfo:
    """Returns a port as pyserial describes it."""
    info = ListPortInfo(device)
    info.vid, info.pid = vid, pid
    for key, value in more.items():
        setattr(info, key, value)
    return info


BUILT_IN = port("/dev/ttyS0")
OTHERS = port("/dev/ttyUSB0", 0x0403, 0x6001, description="FT232R USB UART", serial_number="A5")
CONVERTER = port(
    "/dev/ttyUSB1", 0x0403, 0xD38B, description="Xsens USB converter", serial_number="XSU7"
)
MTI = port("/dev/ttyUSB2", 0x2639, 0x0017, description="MTi-300")


@pytest.fixture
def machine(monkeypatch: pytest.MonkeyPatch) -> list[ListPortInfo]:
    """Returns the list of ports of this machine, which is empty at first."""
    found: list[ListPortInfo] = []
    monkeypatch.setattr("serial.tools.list_ports.comports", lambda: found)
    return found


def ports(*args: str) -> list[dict[str, Any]]:
    result = run("ports", "--json", *args)
    assert (result.exit_code, result.stderr) == (0, "")
    rows: list[dict[str, Any]] = json.loads(result.stdout)
    return rows


def test_no_port(machine: list[ListPortInfo]) -> None:
    assert machine == []
    assert ports() == ports("--identify") == []
    for args in ([], ["--identify"]):
        result = run("ports", *args)
        assert (result.exit_code, result.stdout) == (
            0,
            "no serial port; check the cable\n",
        )


def test_xsens_ports_come_first(machine: list[ListPortInfo]) -> None:
    machine += [BUILT_IN, OTHERS, MTI, CONVERTER]
    assert run("ports").stdout.splitlines() == [
        "port          Xsens  description          serial number",
        "/dev/ttyUSB1  yes    Xsens USB converter  XSU7",
        "/dev/ttyUSB2  yes    MTi-300",
        "/dev/ttyS0           n/a",
        "/dev/ttyUSB0         FT232R USB UART      A5",
    ]
    assert ports()[0] == {
        "port": "/dev/ttyUSB1",
        "likely": True,
        "description": "Xsens USB converter",
        "serial_number": "XSU7",
    }
    assert [item["likely"] for item in ports()] == [True, True, False, False]


@pytest.mark.parametrize(
    ("vid", "pid", "likely"),
    [
        (0x0403, 0xD387, False),
        (0x0403, 0xD388, True),
        (0x0403, 0xD38F, True),
        (0x0403, 0xD390, False),
        (0x2639, 0x0001, True),
        (0x2638, 0xD388, False),
        (None, None, False),
    ],
)
def test_xsens_ports_are_known_by_their_usb_identifiers(
    vid: int | None, pid: int | None, likely: bool, machine: list[ListPortInfo]
) -> None:
    machine.append(port("COM3", vid, pid))
    assert ports()[0]["likely"] is likely


def test_identify_asks_only_xsens_ports(machine: list[ListPortInfo]) -> None:
    """Only ports with an Xsens identifier are opened, and the device measures again afterwards."""
    sim = SimulatedDevice("MTi-680G")
    with serving(sim) as path:
        machine += [BUILT_IN, port(path, 0x2639, 1)]
        lines = run("ports", "--identify").stdout.splitlines()
        output = ports("--identify")
    assert [line.split("  ")[-1].strip() for line in lines] == [
        "device",
        "MTi-680G-8A1G6 008000A1B2, firmware 1.8.0, 115200 baud",
        "not identified",
    ]
    assert output[0] | {"port": "", "description": ""} == {
        "port": "",
        "likely": True,
        "description": "",
        "serial_number": None,
        "product_code": "MTi-680G-8A1G6",
        "device_id": "008000A1B2",
        "firmware": "1.8.0",
        "baudrate": 115200,
    }
    assert list(output[1]) == ["port", "likely", "description", "serial_number"]
    assert sim.state == "measurement"


def test_identify_asks_all_ports_without_an_xsens_port(
    machine: list[ListPortInfo], monkeypatch: pytest.MonkeyPatch
) -> None:
    def silent(name: str, *args: Any, **more: Any) -> Device:
        if name == "/dev/ttyS0":
            raise XbusTimeout("nothing was heard on /dev/ttyS0 at any rate", None, 5.0)
        return connect(name, *args, **more)

    monkeypatch.setattr("xbus.device.connect", silent)
    machine += [BUILT_IN, port("/dev/nowhere")]
    with serving(SimulatedDevice("MTi-3")) as path:
        machine.append(port(path))
        output = {item["port"]: item for item in ports("--identify")}
        table = run("ports", "--identify").stdout
    assert output[path]["product_code"] == "MTi-3-8A7G6"
    assert output["/dev/ttyS0"]["problem"] == "no answer"
    assert output["/dev/nowhere"]["problem"].startswith(
        "cannot open /dev/nowhere: No such file or "
    )
    assert table.count("no answer") == 1
