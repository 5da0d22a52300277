"""The CAN output configuration: rates by quantity, and the load of the bus."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import pytest

import xbus
from xbus.can import CAN_MESSAGES, EXTENDED
from xbus.device.can_output import (
    bus_load,
    can_baud_code,
    parse_can_configuration,
)
from xbus.protocol import decode, encode
from xbus.protocol.can import frame_bits
from xbus.protocol.values import CAN_BAUD_CODES, CAN_EVERY, EVERY, CanConfig, CanDataId, CanOutput


@pytest.fixture
def device() -> Iterator[xbus.Device]:
    with xbus.connect("sim:MTi-680") as device, device.configure() as cfg:
        yield cfg


def test_codes_are_those_of_the_table() -> None:
    assert list(CAN_MESSAGES) == [int(code) for code in CanDataId]


@pytest.mark.parametrize(
    ("rates", "ids", "payload"),
    [
        ({"sample_time_fine": None, "acceleration": 100}, None, "05000000000507FF 3400000000340064"),
        ({"quaternion": 100, "SampleTime": None, 0x34: 100}, None,
         "05000000000507FF 2100000000210064 3400000000340064"),
        ({"acceleration": 400}, {"Acceleration": 0x19FF0034}, "340119FF00340190"),
        ({"position_ecef": 10}, 0x100, "730000000173000A 740000000174000A 750000000175000A"),
        ({"StatusWord": None}, EXTENDED, "11010000001107FF"),
    ],
)  # fmt: skip
def test_rates_by_quantity(rates: Any, ids: Any, payload: str) -> None:
    outputs = parse_can_configuration(rates, ids)
    assert encode("SetCanOutputConfig", outputs) == bytes.fromhex(payload)
    assert parse_can_configuration(outputs) == outputs


def test_four_frames_of_eight_bytes_fit_at_400_hz_and_five_do_not() -> None:
    """The arithmetic of classic CAN: 135 bits each, of 625 bits for a group at 250 kbit/s."""
    assert frame_bits(8, is_extended=False) == 135
    rates = dict.fromkeys(["quaternion", "delta_q", "lat_lon"], 400)
    four = parse_can_configuration(rates | {"UtcTime": None})
    assert bus_load(four, 250_000) == pytest.approx(4 * 135 / 625)
    five = parse_can_configuration(rates | {"UtcTime": None, "GnssReceiverDop": None})
    assert bus_load(five, 250_000) == pytest.approx(5 * 135 / 625)


def test_the_vendors_frequency_for_every_group_is_understood(device: xbus.Device) -> None:
    """Figure 4 of MT1604P: 11 bits of a frequency, which software of the vendor sets to FFFF."""
    payload = bytes.fromhex("05000000 0005 FFFF 21000000 0021 0064 34000000 0034 0064")
    outputs = decode("SetCanOutputConfig", payload)
    assert [output.rate for output in outputs] == [None, 100, 100]
    assert encode("SetCanOutputConfig", outputs) == payload
    assert bus_load(outputs, 250_000) == bus_load(
        parse_can_configuration({"SampleTime": None, "quaternion": 100, "acceleration": 100}),
        250_000,
    )
    assert device.set_can_output_configuration(outputs) == outputs


def test_a_device_is_configured_in_the_terms_of_the_output_configuration(
    device: xbus.Device,
) -> None:
    rates = {"sample_time_fine": None, "packet_counter": None, "acceleration": 100}
    found = device.set_can_output_configuration(rates, ids=0x100)
    assert found == parse_can_configuration(rates, 0x100)
    assert device.commands.req_can_output_config() == found
    assert device.commands.req_can_config() == CanConfig(0, enabled=True)
    device.set_can_output_configuration({"acceleration": 400}, baudrate=1_000_000)
    assert device.commands.req_can_config() == CanConfig(can_baud_code(1_000_000), enabled=True)
    assert device.set_can_output_configuration({}) == ()
    assert not device.commands.req_can_config().enabled


FULL = dict.fromkeys(["quaternion", "delta_q", "lat_lon", "rate_of_turn", "acceleration"], 400)


@pytest.mark.parametrize(
    ("rates", "options", "error"),
    [
        (FULL, {}, "take up to 102% of a CAN bus with 250,000 bit/s; use at least 500,000 bit/s"),
        (FULL, {"baudrate": 5_000}, "bit/s; use at least 500,000 bit/s, or lower the rates"),
        ({"acceleration": 401}, {}, "Acceleration has at most 400 Hz, not 401"),
        ({"acceleration": 1.5}, {}, "a rate is a whole number of Hz, not 1.5"),
        ({"accel": 1}, {}, "no CAN message is called 'accel'"),
        ({"acceleration": 1, 0x34: 1}, {}, "Acceleration is in the CAN output configuration twice"),
        (
            {"acceleration": 1},
            {"ids": {"SampleTime": 5}},
            "Acceleration has no CAN identifier in ids",
        ),
        ({"acceleration": 1}, {"baudrate": 300_000}, "CAN has no 300,000 bit/s; choose from 5,000"),
        ([CanOutput(0x51, extended=False, can_id=1, frequency=EVERY - 1)], {}, "at most 2046 Hz"),
        (
            {"altitude_ellipsoid": 1, "position_ecef": 1},
            {},
            "or as PositionEcef, not both; choose one",
        ),
        ([CanOutput(0x99, extended=False, can_id=1, frequency=CAN_EVERY)], {}, "called 0x99"),
    ],
)
def test_what_does_not_fit_is_not_sent(
    device: xbus.Device, rates: Any, options: dict[str, Any], error: str
) -> None:
    before = device.commands.req_can_output_config(), device.commands.req_can_config()
    with pytest.raises(ValueError, match=re.escape(error)):
        device.set_can_output_configuration(rates, **options)
    assert (device.commands.req_can_output_config(), device.commands.req_can_config()) == before


def test_products_without_the_message_or_without_can() -> None:
    refused = pytest.raises(ValueError, match="the MTi-610 does not have Quaternion on CAN")
    with xbus.connect("sim:MTi-610") as device, device.configure() as cfg, refused:
        cfg.set_can_output_configuration({"quaternion": 100})
    refused_too = pytest.raises(xbus.StateError, match="does not support ReqCanConfig")
    with xbus.connect("sim:MTi-30") as device, device.configure() as cfg, refused_too:
        cfg.set_can_output_configuration({"acceleration": 100})


def test_every_bit_rate_has_its_code() -> None:
    assert [can_baud_code(rate) for rate in CAN_BAUD_CODES.values()] == list(CAN_BAUD_CODES)
