"""Settings on a page: the draft, its differences, and messages between computer and device."""

from __future__ import annotations

from dataclasses import replace
from enum import IntFlag
from typing import Any

import pytest

import xbus
from xbus.device.settings.table import SETTINGS
from xbus.errors import DeviceError, Disconnected, XbusTimeout
from xbus.protocol.products import support
from xbus.protocol.tables import LEGACY_PRODUCTS, PRODUCTS
from xbus.protocol.values import EVERY, OptionFlag, State, baud_code
from xbus.sim import SimulatedDevice
from xbus.studio.device_settings import DeviceSettings, SettingsChanged
from xbus.studio.exchange import Exchange
from xbus.studio.setting_fields import (
    TABS,
    choices,
    entry_kind,
    fields_of,
    flags,
    help_of,
    is_record,
    message_choices,
)
from xbus.studio.settings_draft import Draft


@pytest.fixture
def device() -> Any:
    with xbus.connect("sim:MTi-630") as device:
        yield device


@pytest.fixture
def draft(device: Any) -> Draft:
    return draft_of(device)


def draft_of(device: Any) -> Draft:
    settings = DeviceSettings(device, Exchange(), check_baudrate=False)
    return Draft(device.settings(), device.support, settings.plan)


class Pages:
    """A device, and what two pages of it show."""

    def __init__(self, sim: SimulatedDevice) -> None:
        self.sim, self.device = sim, xbus.connect(sim)
        exchange = Exchange()
        self.device.trace(exchange)
        self.settings = DeviceSettings(self.device, exchange, check_baudrate=False)
        found = self.settings.read().settings
        assert self.device.support is not None
        self.first, self.second = (
            Draft(found, self.device.support, self.settings.plan) for _ in range(2)
        )

    def apply(self, draft: Draft) -> Any:
        return self.settings.apply(draft.settings, draft.device)


@pytest.fixture
def pages() -> Pages:
    return Pages(SimulatedDevice("MTi-630"))


def test_the_second_page_sees_a_change_and_keeps_its_own(pages: Pages) -> None:
    pages.first.set(location_id=7)
    pages.second.set(option_flags=OptionFlag.ENABLE_CONFIG_MESSAGE_AT_STARTUP)
    before = pages.settings.reading
    pages.apply(pages.first)
    reading = pages.settings.reading
    assert reading is not None
    assert reading is not before
    pages.second.enter("location_id", lambda: 70_000)
    pages.second.rebase(reading.settings)
    assert pages.second.problems == []
    assert pages.second.settings.location_id == 7
    assert pages.second.names_that_differ == ["option_flags"]
    pages.apply(pages.second)
    found = pages.device.settings()
    assert found.location_id == 7
    assert found.option_flags == OptionFlag.ENABLE_CONFIG_MESSAGE_AT_STARTUP


def test_an_outdated_reading_is_noticed_and_nothing_is_sent(pages: Pages) -> None:
    with pages.device.configure() as cfg:
        cfg.commands.set_location_id(5)
    assert pages.settings.is_outdated
    pages.first.set(option_flags=OptionFlag.ENABLE_CONFIG_MESSAGE_AT_STARTUP)
    with pytest.raises(SettingsChanged, match="location_id changed on the device meanwhile"):
        pages.apply(pages.first)
    assert pages.device.settings().option_flags == OptionFlag(0)
    reading = pages.settings.reading
    assert reading is not None
    assert reading.settings.location_id == 5
    assert not pages.settings.is_outdated


def test_a_port_that_disappears_while_the_device_is_configured(pages: Pages) -> None:
    pages.first.set(location_id=7)
    pages.sim.unplug()
    with pytest.raises(Disconnected, match=r"was lost .*; check the cable"):
        pages.apply(pages.first)
    assert pages.first.names_that_differ == ["location_id"]
    pages.sim.plug()
    pages.apply(pages.first)
    assert pages.device.settings().location_id == 7


def test_a_device_that_does_not_answer(pages: Pages, monkeypatch: Any) -> None:
    pages.first.set(location_id=7)
    monkeypatch.setattr(pages.sim, "write", lambda data, baudrate=None: None)
    with pytest.raises(XbusTimeout, match="; "):
        pages.apply(pages.first)
    monkeypatch.undo()
    assert pages.device.settings().location_id == 0


def test_a_device_that_refuses_a_setting(pages: Pages, monkeypatch: Any) -> None:
    pages.first.set(location_id=7, option_flags=OptionFlag.ENABLE_CONFIG_MESSAGE_AT_STARTUP)
    command = pages.device.command

    def refusing(name: str, value: Any = None) -> Any:
        if name == "SetOptionFlags":
            raise DeviceError("the device answered SetOptionFlags with Error 33", 33, name)
        return command(name, value)

    monkeypatch.setattr(pages.device, "command", refusing)
    with pytest.raises(xbus.ApplyError, match="applied: location_id; not applied: option_flags"):
        pages.apply(pages.first)
    reading = pages.settings.reading
    assert reading is not None
    assert reading.settings.location_id == 7
    pages.first.rebase(reading.settings)
    assert pages.first.names_that_differ == ["option_flags"]


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        ("location_id", 70_000, "location_id: location_id cannot be 70000: it must be an integer"),
        ("rot_local", (2.0, 0.0, 0.0, 0.0), "rot_local: a rotation is a quaternion of length 1"),
        ("filter_profile", "Fast", "filter_profile: the MTi-630 has no filter profile 'Fast'"),
        ("gnss_lever_arm", (0, 0, 1), "gnss_lever_arm: the MTi-630 does not have this setting"),
    ],
)
def test_a_value_out_of_range(pages: Pages, name: Any, value: Any, reason: str) -> None:
    pages.first.enter(name, lambda: value)
    (problem,) = pages.first.problems
    assert problem.startswith(reason)
    assert pages.first.problems_of(name) == [problem]
    assert pages.first.problems_of("lat_lon_alt") == []
    pages.first.revert()
    assert pages.first.problems == []


def test_a_file_for_another_product(pages: Pages) -> None:
    other = xbus.connect("sim:MTi-300").settings()
    pages.first.load(xbus.Settings.from_toml(other.to_toml()))
    assert pages.first.problems == []
    assert any("filter profile" in text for text in pages.first.skipped)


@pytest.mark.parametrize("product", ["MTi-3", "MTi-630"])
def test_the_baud_rate_is_followed(product: str) -> None:
    pages = Pages(SimulatedDevice(product, baudrate=115_200))
    pages.settings.set_baudrate(460_800)
    assert pages.device.link.baudrate == pages.sim.baudrate == 460_800
    pages.settings.restore_factory_settings()
    assert pages.device.link.baudrate == pages.sim.baudrate == 115_200
    assert not pages.settings.is_outdated
    assert pages.sim.state == State.MEASUREMENT


@pytest.mark.parametrize("port", [0, 1])
def test_a_restart_after_which_a_port_has_another_rate(port: int) -> None:
    """The host cannot ask to which of the ports it is connected; the virtual line is the first one."""
    pages = Pages(SimulatedDevice("MTi-630", baudrate=115_200))
    ports = list(pages.first.settings.port_config or ())
    ports[port] = replace(ports[port], baud_code=baud_code(921_600))
    pages.first.set(port_config=tuple(ports))
    assert pages.apply(pages.first).needs_reset
    pages.settings.restart()
    expected = 921_600 if port == 0 else 115_200
    assert pages.device.link.baudrate == pages.sim.baudrate == expected


# Fields of a form


def test_every_setting_is_on_one_tab() -> None:
    names = [name for names in TABS.values() for name in names]
    assert sorted([*names, "output_configuration", "baudrate"]) == sorted(SETTINGS)


@pytest.mark.parametrize(
    "name", [*PRODUCTS.values(), *LEGACY_PRODUCTS.values()], ids=lambda row: row.name
)
def test_the_fields_of_each_setting_have_its_value_among_their_choices(name: Any) -> None:
    known = support(name)
    settings = xbus.connect(f"sim:{name.name}").settings()
    for setting in (name for names in TABS.values() for name in names):
        value = getattr(settings, setting)
        if value is None or setting in ("filter_profile", "rot_sensor", "rot_local"):
            continue
        assert help_of(setting)
        entries = value if entry_kind(setting)[1] else [value]
        for entry in entries:
            for field in fields_of(setting):
                present = getattr(entry, field.name) if is_record(setting) else entry
                if present is None:
                    continue
                assert isinstance(present, field.kind), field
                if (options := choices(setting, field, known, entry)) is not None:
                    assert int(present) in options, field
                elif issubclass(field.kind, IntFlag):
                    assert int(present) & ~sum(flags(field, known)) == 0


@pytest.mark.parametrize("product", ["MTi-3", "MTi-630", "MTi-680G", "MTi-300"])
def test_a_message_has_the_rates_of_the_product(product: str) -> None:
    has = support(product)
    expected = {baud_code(rate): f"{rate:,} baud" for rate in has.baudrates}
    for message, field in {
        "SetBaudrate": "code",
        "SetPortConfig": "baud_code",
        "SetGnssReceiverSettings": "baud_code",
    }.items():
        assert message_choices(message, field, has) == expected
    assert message_choices("SetLocationID", "location_id", has) is None
    assert message_choices("SetNoRotation", "duration", has) is None


def test_a_draft_begins_as_the_device_has_it(draft: Draft) -> None:
    assert draft.names_that_differ == draft.differences == []
    assert draft.settings == draft.device


def test_an_output_is_added_changed_and_removed(device: Any, draft: Draft) -> None:
    draft.set_output("acceleration", 50, "Fp1632", None)
    assert draft.names_that_differ == ["output_configuration"]
    assert draft.differences == [
        '+  { quantity = "acceleration", precision = "Fp1632", frequency = 50 },'
    ]
    draft.set_output("acceleration", 100, "Float32", None)
    draft.set_output("quaternion", None, None, None)
    device.apply(draft.settings)
    taken = draft_of(device)
    assert taken.settings.output_configuration == draft.settings.output_configuration
    acceleration = taken.output("acceleration")
    assert acceleration is not None
    assert acceleration.frequency == 100
    assert taken.output("quaternion") is None
    counter = taken.output("packet_counter")
    assert counter is not None
    assert counter.frequency == EVERY


def test_text_and_controls_are_one_draft(draft: Draft) -> None:
    draft.edit(draft.text.replace("location_id = 0", "location_id = 7"))
    assert draft.problems == []
    assert draft.settings.location_id == 7
    draft.set(location_id=8)
    assert "location_id = 8" in draft.text
    draft.revert()
    assert draft.names_that_differ == []


def test_wrong_text_keeps_the_last_valid_draft(draft: Draft) -> None:
    draft.set(location_id=7)
    draft.edit("location_id = 70000")
    assert draft.problems_of("location_id") == draft.problems
    assert draft.problems[0].startswith("line 1, location_id")
    assert draft.settings.location_id == 7
    with pytest.raises(ValueError, match="location_id"):
        draft.set(location_id=-1)
    assert draft.settings.location_id == 7


def test_the_load_of_the_line(draft: Draft) -> None:
    assert draft.overload(115_200) is None
    for name in ("acceleration", "rate_of_turn", "quaternion", "free_acceleration"):
        coordinates = "ENU" if name == "quaternion" else None
        draft.set_output(name, 400, "Float64", coordinates)
    needed, capacity = draft.line_load(115_200)
    assert capacity == 11_520 < needed
    assert "use at least" in (draft.overload(115_200) or "")
    assert draft.line_load(None)[1] is None


def test_messages_are_kept_in_order(device: Any) -> None:
    exchange = Exchange()
    device.trace(exchange)
    with device.configure() as cfg:
        cfg.commands.set_location_id(7)
    names = [(entry.is_sent, entry.name) for entry in exchange.entries]
    assert (True, "SetLocationID") in names
    assert names.index((False, "SetLocationIDAck")) > names.index((True, "SetLocationID"))
    sent = next(entry for entry in exchange.entries if entry.name == "SetLocationID")
    assert sent.frame.hex() == "faff84020007" + f"{-(0xFF + 0x84 + 2 + 7) & 0xFF:02x}"
    assert exchange.count == len(exchange.entries)
