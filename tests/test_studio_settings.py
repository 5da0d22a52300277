"""Settings on a page: the draft, its differences, and messages between computer and device."""

from __future__ import annotations

from typing import Any

import pytest

import xbus
from xbus.protocol.values import EVERY
from xbus.studio.device_settings import DeviceSettings
from xbus.studio.exchange import Exchange
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
