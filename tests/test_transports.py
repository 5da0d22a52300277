"""The whole command set against every virtual product: in this process, on a pseudo-terminal, and on TCP."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from typing import Any

import pytest

import xbus
from xbus import Device, SimulatedDevice, connect
from xbus.protocol import EVERY, Output, State
from xbus.protocol.products import support
from xbus.protocol.tables import MESSAGES, PRODUCTS
from xbus.sim import serving

#: Excluded here because they change the state; tested separately.
APART = ("GoToConfig", "GoToMeasurement", "Reset", "RestoreFactoryDef", "WakeUpAck", "ReqData")


@contextlib.contextmanager
def in_process(sim: SimulatedDevice) -> Iterator[Any]:
    yield sim


def on_a_pty(sim: SimulatedDevice) -> contextlib.AbstractContextManager[str]:
    return serving(sim)


def on_tcp(sim: SimulatedDevice) -> contextlib.AbstractContextManager[str]:
    return serving(sim, tcp=True)


def exercise_config(device: Device) -> list[tuple[str, Any]]:
    """Sends every request, and every setting with its current value. Returns the replies."""
    known = device.support
    assert known is not None
    answers: list[tuple[str, Any]] = []
    for row in MESSAGES.values():
        if row.name not in known.messages or row.direction != "to device" or row.name in APART:
            continue
        if "config" not in row.states:
            continue
        value = value_for(row.name, device)
        answer = device.command(row.name, value).value
        if row.name not in ("ReqUTCTime", "SetUTCTime"):  # time advances
            answers.append((row.name, answer))
        if row.name.startswith("Set"):
            read_back(device, row.name, value)
    return answers


def read_back(device: Device, name: str, value: Any) -> None:
    """Asserts that the setting can be read back."""
    assert device.support is not None
    request = f"Req{name[3:].removesuffix('Modern')}"
    if request not in device.support.messages or name in ("SetOptionFlags", "SetUTCTime"):
        return
    parameter = value.parameter if name == "SetAlignmentRotation" else None
    found = device.command(request, parameter).value
    assert (found.profile if name == "SetFilterProfile" else found) == value, name


def value_for(name: str, device: Device) -> Any:
    assert device.support is not None
    profile = device.support.filter_profile
    values = {
        "SetOptionFlags": xbus.protocol.OptionFlags(), "SetBaudrate": 2, "SetFilterProfile": profile,
        "SetFilterProfileModern": profile, "SetInitialHeading": 12.5, "ReqAlignmentRotation": 1,
        "SetAlignmentRotation": xbus.protocol.AlignmentRotation(0, (0, 1, 0, 0)), "ReqEmts": b"\0\xff",
        "SetUTCTime": xbus.protocol.UtcTime(0, 2026, 1, 1, 0, 0, 0), "AdjustUTCTime": 10_000,
        "ResetOrientation": 0, "IccCommand": 2, "SetLocationID": 4711, "SetTransmitDelay": 1000,
        "SetLatLonAlt": xbus.protocol.LatLonAlt(-33.9, 151.2, 20.5), "SetErrorMode": 2,
        "SetGnssLeverArm": xbus.protocol.GnssLeverArm(0.5, -0.25, 1.0), "SetPeriod": 576,
        "SetOutputSkipFactor": 3,
    }  # fmt: skip
    if name in values or not name.startswith("Set"):
        return values.get(name)
    return device.command(f"Req{name[3:]}").value


def exercise_measurement(device: Device) -> list[tuple[str, Any]]:
    known = device.support
    assert known is not None
    commands = {
        "SetNoRotation": 2,
        "IccCommand": 3,
        "ResetOrientation": 3,
        "ForwardGnssData": b"\xd3\0\0",
    }
    return [
        (command, device.command(command, value).value)
        for command, value in commands.items()
        if command in known.messages
    ]


def exercise(device: Device) -> list[tuple[str, Any]]:
    """Sends all commands. Returns the replies."""
    with device.configure() as cfg:
        answers = exercise_config(cfg)
        assert cfg.support is not None
        sync = [function for function in cfg.support.sync if 6 in cfg.support.sync[function]]
        cfg.commands.set_sync_settings(
            [xbus.protocol.SyncSetting(function, 6) for function in sync]
        )
        cfg.set_output_configuration([Output(0x1020), Output(0x4020, 50)])
        cfg.go_to_measurement()
        cfg.commands.req_data()
        answers.append(("ReqData", sorted(map(str, cfg.read_sample()))))
        cfg.go_to_config()
        cfg.commands.restore_factory_def()
        answers.append(("RestoreFactoryDef", cfg.commands.req_output_configuration()))
        cfg.reset(config=True)
    answers += exercise_measurement(device)
    for _ in range(3):
        assert "packet_counter" in device.read_sample()
    return answers


def awake(product: xbus.protocol.tables.Product) -> SimulatedDevice:
    """Returns a device that has been on for a while, so that no test waits for WakeUp."""
    sim = SimulatedDevice(product)
    sim.advance(1)
    return sim


@pytest.mark.parametrize("product", PRODUCTS.values(), ids=lambda product: product.name)
@pytest.mark.parametrize(
    "transport", [in_process, on_a_pty, on_tcp], ids=lambda transport: transport.__name__
)
def test_all_commands_on_all_transports(
    product: xbus.protocol.tables.Product,
    transport: Callable[..., contextlib.AbstractContextManager[Any]],
) -> None:
    with connect(awake(product)) as device:
        expected = exercise(device)
    with transport(awake(product)) as port, connect(port) as device:
        assert exercise(device) == expected
        assert device.state == State.MEASUREMENT
        outputs = dict(dict(expected)["RestoreFactoryDef"])
        assert outputs == dict(support(product).output_configuration)
        assert outputs[0x1020] == EVERY
