"""Settings: read, written as text, compared, and applied, on every virtual product."""

from __future__ import annotations

import pickle
import re
import sys
import tomllib
from collections.abc import Iterator
from dataclasses import replace
from itertools import count
from typing import Any

import hypothesis
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from xbus import (
    ApplyError,
    Device,
    DeviceError,
    Settings,
    SimulatedDevice,
    XbusTimeout,
    connect,
)
from xbus.device.settings.table import SETTINGS
from xbus.device.settings.toml import format_value, line_numbers
from xbus.protocol import (
    CanConfig,
    CanOutput,
    ExtOutputMode,
    GnssLeverArm,
    GnssPlatform,
    LatLonAlt,
    OptionFlag,
    Output,
    Polarity,
    PortConfig,
    State,
    StringOutput,
    StringType,
    SyncFunction,
    SyncSetting,
)
from xbus.protocol.products import support
from xbus.protocol.tables import PRODUCTS
from xbus.protocol.values import SYNC_OUT_FUNCTIONS
from xbus.sim.link import SimLink

FLAG = OptionFlag.ENABLE_IN_RUN_COMPASS_CALIBRATION


def changed(product: int) -> Settings:
    """Settings of a product that differ from the factory's in all that it has."""
    known, has = support(product), connect(SimulatedDevice(product)).settings()
    function, lines = next(iter(known.sync.items()))
    pulse = 5 if function in SYNC_OUT_FUNCTIONS else 0
    profiles = [profile.label for profile in known.filter_profiles]
    wanted: dict[str, Any] = {
        "output_configuration": (Output(0x1020), Output(0x4026, 50), Output(0x8020, 10)),
        "filter_profile": profiles[1] if len(profiles) > 1 else None,
        "option_flags": FLAG,
        "rot_sensor": (0.0, 1.0, 0.0, 0.0),
        "rot_local": (0.6000000238418579, 0.0, 0.0, 0.800000011920929),
        "sync_settings": (
            SyncSetting(function, lines[0], Polarity.BOTH, True, 1, 2, pulse, 300),
            SyncSetting(SyncFunction.SEND_LATEST, 6),
        ),
        "location_id": 4711,
        "string_output_type": StringOutput(StringType.PTCF | StringType.GPZDA, None),
        "period": 576,
        "output_skip_factor": 3,
        "lat_lon_alt": LatLonAlt(-33.1, 151.2, 12.5),
        "gnss_lever_arm": GnssLeverArm(0.10000000149011612, -0.25, 1.0),
        "gnss_platform": GnssPlatform.SEA,
        "can_config": CanConfig(0x0C),
        "can_output_config": (CanOutput(0x34, True, 0x123, 100),),
        "ext_output_mode": ExtOutputMode.USB_LOW_LATENCY,
        "transmit_delay": 600,
        "error_mode": 2,
    }
    if has.string_output_type and has.string_output_type.frequency is not None:
        wanted["string_output_type"] = StringOutput(StringType.PTCF, 20)
    if has.port_config:
        wanted["port_config"] = (
            replace(has.port_config[0], baud_code=0x80, flow_control=True),
            *has.port_config[1:],
        )
    if has.gnss_receiver_settings:
        wanted["gnss_receiver_settings"] = replace(has.gnss_receiver_settings, rate=1)
    there = {
        name: value for name, value in wanted.items() if getattr(has, name) is not None and value
    }
    return replace(has, **there)


# Read, written, compared


@pytest.mark.parametrize("product", PRODUCTS)
def test_dumped_reset_applied_and_dumped_again(product: int) -> None:
    sim = SimulatedDevice(product)
    device = connect(sim)
    factory, wanted = device.settings(), changed(product)
    applied = device.apply(wanted)
    assert {change.name for change in applied.changes} == {
        change.name for change in factory.diff(wanted)
    }
    assert not applied.rounded
    text = device.settings().to_toml()
    assert Settings.from_toml(text) == wanted
    with device.configure():
        device.commands.restore_factory_def()
    assert device.settings() == factory
    device.apply(Settings.from_toml(text))
    assert device.settings().to_toml() == text
    assert not device.apply(Settings.from_toml(text)).changes
    assert sim.state == State.MEASUREMENT


@pytest.mark.parametrize("product", PRODUCTS)
def test_all_that_can_be_read_is_there(product: int) -> None:
    """What the product has a message to read for; identifiers, times and procedures are no settings."""
    readable = {
        message[3:]
        for message in support(product).messages
        if message.startswith("Req") and f"Set{message[3:]}" in support(product).messages
    }
    readable = {name for name in readable if not name.endswith("Ack")} - {"UTCTime"}
    expected = {_attribute(name) for name in readable}
    if support(product).filter_profiles:  # the 600-series has another message to set it
        expected |= {"filter_profile"}
    settings = connect(SimulatedDevice(product)).settings()
    found = {key for key, setting in vars(settings).items() if setting is not None} - {
        "product",
        "lines",
    }
    rotations = {"rot_sensor", "rot_local"}
    optional = {"baudrate"} if "port_config" in expected else set()
    assert found - rotations == expected - {"alignment_rotation"} - optional
    assert rotations <= found


def _attribute(message: str) -> str:
    words = "".join(f"_{letter.lower()}" if letter.isupper() else letter for letter in message)
    return words.lstrip("_").replace("location_i_d", "location_id")


def test_unknown_numbers_come_back_as_they_are() -> None:
    settings = Settings(
        output_configuration=(Output(0x3013, 10), Output(0x201C, 100)),
        option_flags=OptionFlag(0x8000_0001),
        sync_settings=(SyncSetting(99, 77, 9),),
        port_config=(PortConfig(9, 0x0A), PortConfig(1, 0x55, reserved=0x1000), PortConfig(0, 0)),
        filter_profile=200,
    )
    text = settings.to_toml()
    assert "{ data_id = 12307, frequency = 10 }" in text
    assert Settings.from_toml(text) == settings


def test_what_is_left_out_stays() -> None:
    device = connect("sim:MTi-630")
    before = device.settings()
    applied = device.apply(Settings(location_id=7))
    assert [change.name for change in applied.changes] == ["location_id"]
    assert device.settings() == replace(before, location_id=7)


def test_a_change_in_words() -> None:
    device = connect("sim:MTi-630")
    outputs = (Output(0x1020), Output(0x4020, 100))
    applied = device.apply(Settings(output_configuration=outputs), dry_run=True)
    assert str(applied.changes[0]).splitlines() == [
        "  output_configuration",
        '-   { quantity = "sample_time_fine" },',
        '-   { quantity = "quaternion", coordinates = "ENU", precision = "Float32", frequency = 100 },',
        '+   { quantity = "acceleration", precision = "Float32", frequency = 100 },',
        '-   { quantity = "status_word" },',
    ]
    assert not device.apply(device.settings()).changes


def test_the_highest_rate_is_the_same_however_it_is_asked_for() -> None:
    device = connect(SimulatedDevice("MTi-630", baudrate=921_600))
    settings = Settings.from_toml('output_configuration = [{ quantity = "acceleration" }]')
    assert device.apply(settings).changes
    assert not device.apply(settings).changes


@pytest.mark.parametrize(
    "settings",
    [
        Settings(gnss_lever_arm=GnssLeverArm(0.1, 0.2, 0.3)),
        Settings(gnss_lever_arm=(0.1, 0.2, 0.3)),  # type: ignore[arg-type]
        Settings(rot_sensor=(0.8, 0, 0, 0.6)),
        Settings(rot_local=(0.36, 0.48, 0.48, 0.64)),
        Settings(lat_lon_alt=LatLonAlt(52.1, 6.7, 0.1)),
    ],
    ids=lambda settings: next(name for name in SETTINGS if getattr(settings, name) is not None),
)
def test_the_second_apply_finds_nothing_to_change(settings: Settings) -> None:
    device = connect("sim:MTi-680G")
    applied = device.apply(settings)
    assert applied.changes
    assert not applied.rounded
    assert not device.apply(settings).changes
    assert not device.apply(Settings.from_toml(settings.to_toml())).changes


@given(st.lists(st.floats(-100, 100), min_size=3, max_size=3))
def test_a_setting_has_the_precision_of_its_message(numbers: list[float]) -> None:
    rounded = np.array(numbers, np.float32).tolist()
    settings = Settings(gnss_lever_arm=GnssLeverArm(*numbers))
    assert settings.gnss_lever_arm == GnssLeverArm(*rounded)
    assert Settings.from_toml(settings.to_toml()) == settings


#: Values of the wrong type or size, and the error.
WRONG: list[tuple[str, Any, str]] = [
    ("product", 630, "product: 630 is not text"),
    ("output_configuration", 5, "output_configuration: 5 is not a list"),
    ("output_configuration", [5], "output_configuration: data_id cannot be None"),
    ("output_configuration", {"acceleration": "fast"}, "a rate is a whole number of Hz, not 'fast'"),
    ("output_configuration", {"acceleration": 1.5}, "a rate is a whole number of Hz, not 1.5"),
    ("output_configuration", {"x": 1}, "output_configuration: no quantity is called 'x'"),
    ("output_configuration", {None: 1}, "output_configuration: a key is a name"),
    ("filter_profile", True, "filter_profile: true is not a name or a number"),
    ("filter_profile", [39], "filter_profile: [39] is not a name or a number"),
    ("option_flags", 5.5, "option_flags: flags cannot be 5.5"),
    ("option_flags", -1, "option_flags: flags cannot be -1"),
    ("rot_sensor", (1, 0, 0), "rot_sensor: quaternion cannot be (1, 0, 0): it must be 4 finite"),
    ("rot_local", (1, 0, 0, 1e40), "rot_local: quaternion cannot be"),
    ("sync_settings", [5], "sync_settings: function cannot be None"),
    ("location_id", "7", "location_id: location_id cannot be '7'"),
    ("location_id", True, "location_id: location_id cannot be True"),
    ("string_output_type", 5, "string_output_type: types cannot be None"),
    ("lat_lon_alt", (1, 2), "lat_lon_alt: (1, 2) does not have the fields lat, lon, alt"),
    ("gnss_lever_arm", (1e40, 0.0, 0.0), "gnss_lever_arm: x cannot be 1e+40"),
    ("gnss_lever_arm", (0.0, float("nan"), 0.0), "gnss_lever_arm: y cannot be nan"),
    ("gnss_platform", "sea", "gnss_platform: platform cannot be 'sea'"),
    ("can_config", 5, "can_config: 5 is not a CanConfig"),
    ("port_config", [5], "port_config: 5 is not a PortConfig"),
    ("baudrate", "fast", 'baudrate: "fast" is not a whole number'),
]  # fmt: skip


@pytest.mark.parametrize(("name", "value", "says"), WRONG)
def test_a_wrong_value_is_refused_when_it_is_given(name: str, value: Any, says: str) -> None:
    with pytest.raises(ValueError, match=re.escape(says)) as caught:
        Settings(**{name: value})
    assert str(caught.value).startswith(f"{name}: ")


def test_outputs_as_rates_by_quantity() -> None:
    rates: Any = {"packet_counter": None, ("quaternion", "NED"): 100}
    settings = Settings(output_configuration=rates)
    assert settings.output_configuration == (Output(0x1020), Output(0x2014, 100))
    assert connect("sim:MTi-630").apply(settings).changes[0].after == settings.output_configuration


ANY = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats()
    | st.text()
    | st.binary()
    | st.builds(Output, st.integers(), st.floats())
    | st.builds(GnssLeverArm, st.floats(), st.floats(), st.text())
    | st.builds(CanConfig, st.integers(), st.text()),
    lambda item: st.lists(item, max_size=4) | st.dictionaries(st.text(), item, max_size=2)
    | st.tuples(item, item, item),
    max_leaves=6,
)  # fmt: skip


@hypothesis.settings(max_examples=200)
@given(ANY)
@example("line\nend\x1f")  # of a product, in the comment at the start
def test_a_value_of_any_type_is_refused_or_can_be_written(value: Any) -> None:
    for name in ("product", *SETTINGS):
        found, problem = None, ""
        try:
            found = Settings(**{name: value})
        except ValueError as error:
            problem = str(error)
        if found is None:
            assert problem.startswith(f"{name}: ")
        elif "\\ud" not in repr(value):  # a lone surrogate
            assert Settings.from_toml(found.to_toml()) == found


def test_a_profile_in_whichever_case_or_by_number() -> None:
    device = connect("sim:MTi-30")
    for profile in ("Dynamic", 41):
        device.apply(Settings(filter_profile=profile))
        assert device.settings().filter_profile == "dynamic"


# What comes first


def order(product: str, settings: Settings) -> list[str]:
    changes = connect(f"sim:{product}").apply(settings, dry_run=True).changes
    return [change.name for change in changes]


def test_ports_come_last_and_flags_before_them() -> None:
    names = order("MTi-680G", changed(680))
    assert names[-2:] == ["option_flags", "port_config"]


def test_storing_is_switched_on_before_anything_else_and_off_after_it() -> None:
    sim = SimulatedDevice("MTi-3")
    device, flag = connect(sim), OptionFlag.DISABLE_AUTO_STORE
    device.apply(Settings(option_flags=flag, location_id=1))
    device.apply(Settings(option_flags=OptionFlag(0), location_id=2))
    device.reset()
    assert device.settings().location_id == 2
    device.apply(Settings(option_flags=flag, location_id=3))
    device.reset()
    assert device.settings().location_id == 3


# What the line carries


FAST = Settings(output_configuration=(Output(0x4040, 2000),))
STRINGS = StringOutput(StringType.PSONCMS | StringType.GPGGA)


def test_outputs_are_checked_against_the_rate_that_the_ports_will_have() -> None:
    device = connect(SimulatedDevice("MTi-630", baudrate=115_200))
    with pytest.raises(ValueError, match=r"^output_configuration: .* 115,200 baud carry"):
        device.apply(FAST)
    ports = device.settings().port_config
    assert ports is not None
    faster = tuple(replace(port, baud_code=0x80) if port.protocol else port for port in ports)
    applied = device.apply(replace(FAST, port_config=faster))
    assert [change.name for change in applied.changes] == ["output_configuration", "port_config"]
    device.reset()
    slower = Settings(port_config=ports)
    device = connect(device.link.device)  # type: ignore[attr-defined]
    assert device.link.baudrate == 921_600
    with pytest.raises(ValueError, match="115,200 baud carry"):
        device.apply(slower)
    assert device.apply(slower, check_baudrate=False).changes


def test_strings_are_checked_and_not_the_outputs_that_they_overrule() -> None:
    device = connect(SimulatedDevice("MTi-710", baudrate=115_200))
    strings = Settings(string_output_type=STRINGS, period=1152, output_skip_factor=0)
    with pytest.raises(ValueError, match=r"^string_output_type: .* 21,400 bytes per second"):
        device.apply(strings)
    assert device.apply(replace(strings, output_skip_factor=9)).changes
    with pytest.raises(ValueError, match=r"^string_output_type: these strings"):
        device.apply(Settings(output_skip_factor=0))
    assert device.apply(Settings(output_skip_factor=0xFFFF)).changes
    off = StringOutput(StringType(0))
    many = Settings(
        output_configuration=tuple(Output(data_id, 400) for data_id in (0x2013, 0x4023, 0x8023))
    )
    with pytest.raises(
        ValueError,
        match=r"strings are on \(PSONCMS, GPGGA\) and replace the outputs; add string_out",
    ):
        device.apply(many)
    assert device.apply(replace(many, string_output_type=STRINGS)).changes
    with pytest.raises(ValueError, match=r"^output_configuration: these outputs make"):
        device.apply(Settings(string_output_type=off))


# What cannot be applied


def can_output(can_id: int, frequency: int, *names: str) -> str:
    rest = f"extended = false, can_id = {can_id}, frequency = {frequency}"
    entries = [f'{{ data_id = "{name}", {rest} }}' for name in names or ("acceleration",)]
    return f"can_output_config = [{', '.join(entries)}]"


XBUS_PORT = '{ protocol = "xbus", baudrate = 115200 }'
#: Product, text, and why it cannot be applied.
IMPOSSIBLE = [
    ("MTi-630", 'output_configuration = [\n  { quantity = "acceleration", frequency = 150 },\n]',
     "line 2, output_configuration: the MTi-630 cannot send acceleration at 150 Hz; the nearest rates are"),
    ("MTi-630", 'output_configuration = [\n { quantity = "packet_counter" },\n\n { quantity = "lat_lon" },]',
     "line 4, output_configuration: the MTi-630 has no output lat_lon"),
    ("MTi-630", "gnss_lever_arm = { x = 0, y = 0, z = 1 }",
     "line 1, gnss_lever_arm: the MTi-630 does not have this setting"),
    ("MTi-630", 'filter_profile = "General"', "line 1, filter_profile: the MTi-630 has no filter profile"),
    ("MTi-30", 'filter_profile = "General_RTK"', "line 1, filter_profile: the MTi-30 has no filter profile"),
    ("MTi-30", "filter_profile = 1", "line 1, filter_profile: the MTi-30 has no filter profile 1"),
    ("MTi-30", "baudrate = 921600", "line 1, baudrate: the baud rate is not changed"),
    ("MTi-30", 'option_flags = ["enable_continuous_zru"]', "line 1, option_flags: the MTi-30 has no option"),
    ("MTi-3", 'sync_settings = [{ function = "gnss_1pps", line = "in1" }]', "line 1, sync_settings: the MTi"),
    ("MTi-30", "string_output_type = { types = [\"GPGGA\"] }", "line 1, string_output_type: the MTi-30 has"),
    ("MTi-30", "period = 1", "line 1, period: the period must be from 225 to 1152, not 1; "),
    ("MTi-30", "\nrot_local = [1, 1, 0, 0]", "line 2, rot_local: a rotation is a quaternion of length 1"),
    ("MTi-630", 'output_configuration = [{ quantity = "acceleration", precision = "Float64" }]',
     "line 1, output_configuration: these outputs make about"),
    ("MTi-630", 'can_config = { baudrate = 250000 }\n[lat_lon_alt]\nlat = 91\nlon = 0\nalt = 0',
     "line 2, lat_lon_alt: lat must be from -90 to 90 degrees"),
    ("MTi-630", can_output(5000, 9),
     "line 1, can_output_config: Acceleration: the CAN identifier 0x1388 has more than 11 bits; use at most"),
    ("MTi-630", can_output(5, 1000), "line 1, can_output_config: Acceleration has at most 400 Hz, not 1000"),
    ("MTi-630", f"can_config = {{ baudrate = 5000 }}\n{can_output(5, 100)}",
     "line 2, can_output_config: these outputs take up to "),
    ("MTi-630", f"port_config = [{XBUS_PORT}, {XBUS_PORT}, {XBUS_PORT}]",
     "line 1, port_config: the MTi-630 has no port 3; its protocol must be none"),
    ("MTi-610", can_output(5, 100, "lat_lon"),
     "line 1, can_output_config: the MTi-610 does not have LatLong on CAN"),
    ("MTi-630", can_output(5, 100, "acceleration", "rate_of_turn"),
     "line 1, can_output_config: the CAN identifier 0x5 is both Acceleration and RateOfTurn"),
]  # fmt: skip


@pytest.mark.parametrize(("product", "text", "why"), IMPOSSIBLE)
def test_what_cannot_be_applied(product: str, text: str, why: str) -> None:
    device = connect(f"sim:{product}")
    before = device.settings()
    with pytest.raises(ValueError) as caught:
        device.apply(Settings.from_toml(f"{text}\n"))
    assert str(caught.value).startswith(why)
    assert "\n" not in str(caught.value)
    assert device.settings() == before
    assert device.state == State.MEASUREMENT


def test_a_file_for_another_product_says_all_that_cannot_be_applied() -> None:
    settings = connect("sim:MTi-680G").settings()
    with pytest.raises(ValueError) as caught:
        connect("sim:MTi-30").apply(settings)
    reasons = str(caught.value).splitlines()
    assert [reason.partition(":")[0] for reason in reasons] == [
        "product", "output_configuration", "filter_profile", "sync_settings", "string_output_type",
        "gnss_lever_arm", "gnss_receiver_settings", "can_config", "can_output_config", "port_config",
    ]  # fmt: skip
    assert reasons[0] == (
        'product: the settings are for "MTi-680G", and the product of the device is MTi-30'
    )
    assert reasons[5] == "gnss_lever_arm: the MTi-30 does not have this setting"


def test_what_fits_of_a_file_for_another_product() -> None:
    settings = replace(connect("sim:MTi-680G").settings(), location_id=7)
    device = connect("sim:MTi-30")
    before = device.settings()
    planned = device.apply(settings, force=True, dry_run=True)
    applied = device.apply(settings, force=True)
    assert [change.name for change in applied.changes] == ["location_id"]
    assert planned.changes == applied.changes
    assert planned.skipped == applied.skipped
    assert [reason.partition(":")[0] for reason in applied.skipped] == [
        "output_configuration", "filter_profile", "sync_settings", "string_output_type", "gnss_lever_arm",
        "gnss_receiver_settings", "can_config", "can_output_config", "port_config",
    ]  # fmt: skip
    assert device.settings() == replace(before, location_id=7)


@pytest.mark.parametrize("product", ["mti-630", "630", "MTi-630", None])
def test_a_product_has_several_names(product: str | None) -> None:
    device = connect("sim:MTi-630")
    assert device.apply(Settings(product=product, location_id=7)).changes


def test_a_product_that_does_not_exist() -> None:
    with pytest.raises(ValueError, match='line 1, product: the settings are for "MTi-5"'):
        connect("sim:MTi-630").apply(Settings.from_toml('product = "MTi-5"'))


# Texts that mean nothing


BAD = [
    ("location_id = ", "line 1: invalid value; this is not TOML"),
    ("location_id = 1\nlocation_id = 2", "line 2: cannot overwrite a value; this is not TOML"),
    ("a = [", "line 1: invalid value; this is not TOML"),
    ("\nlocation = 1", "line 2, location: there is no setting of this name; did you mean location_id?"),
    ("[x]\ny = 1", "line 1, x: there is no setting of this name; there are output_configuration, "),
    ("product = 630", "line 1, product: 630 is not text in quotes"),
    ("location_id = true", "line 1, location_id: true is not a whole number"),
    ("location_id = 1.5", "line 1, location_id: 1.5 is not a whole number"),
    ("location_id = 65536", "line 1, location_id: location_id cannot be 65536"),
    ('option_flags = "x"', 'line 1, option_flags: "x" is not a list'),
    ('option_flags = ["ahs"]', 'line 1, option_flags: "ahs" is not one of disable_auto_store, '),
    ("rot_local = [1, 0, 0]", "line 1, rot_local: [1, 0, 0] is not q0, q1, q2, q3"),
    ("rot_local = [1, 0, 0, true]", "line 1, rot_local: true is not a number"),
    ("filter_profile = 1.5", "line 1, filter_profile: 1.5 is not a name or a number"),
    ("lat_lon_alt = { lat = 1, lon = 2 }", "line 1, lat_lon_alt: alt is missing"),
    ("lat_lon_alt = { lat = 1, lon = 2, al = 3 }", "line 1, lat_lon_alt: there is no field al; the fields"),
    ("[lat_lon_alt]\nlat = 'x'", "line 1, lat_lon_alt: lat: \"x\" is not a number"),
    ("lat_lon_alt = 5", "line 1, lat_lon_alt: 5 is not a table, { key = value }"),
    ("output_configuration = [\n# one\n { frequency = 1 }]", "line 3, output_configuration: quantity is"),
    ('[[output_configuration]]\nquantity = "acceleration"\n[[output_configuration]]\nquantity = "x"',
     "line 3, output_configuration: no quantity is called 'x'"),
    ('output_configuration = [{ quantity = "quaternion", coordinates = "ned" }]',
     "line 1, output_configuration: coordinates: 'ned' is not one of ENU, NED, NWU"),
    ('output_configuration = [{ quantity = "quaternion", rate = 1 }]',
     "line 1, output_configuration: there is no field rate; the fields are quantity, coordinates"),
    ('output_configuration = [{ quantity = "quaternion", frequency = 100000 }]',
     "line 1, output_configuration: "),
    # A long list takes linear time.
    ("\noutput_configuration = [\n" + '{ quantity = "acceleration" },\n' * 20_000 + "{}]",
     "line 20003, output_configuration: quantity is missing"),
    ("output_configuration = [1]", "line 1, output_configuration: 1 is not a table"),
    ("gnss_lever_arm = { x = nan, y = 0, z = 1 }",
     "line 1, gnss_lever_arm: x: the number must be finite"),
    ("lat_lon_alt = { lat = 1" + "0" * 400 + ", lon = 0, alt = 0 }",
     "line 1, lat_lon_alt: lat: the number must be finite"),
    ("can_config = " + "[" * 5000, "lists or tables are nested too deeply"),
    ('port_config = [{ protocol = "xbus", baudrate = 5 }]', "line 1, port_config: baudrate: 5 is not one of"),
    ('port_config = [{ protocol = "xbus" }]', "line 1, port_config: baudrate is missing"),
    ('port_config = [{ protocol = "xbux", baudrate = 9600 }]', 'line 1, port_config: protocol: "xbux"'),
]  # fmt: skip


@pytest.mark.parametrize(("text", "says"), BAD, ids=[says for _, says in BAD])
def test_texts_that_mean_nothing(text: str, says: str) -> None:
    with pytest.raises(ValueError) as caught:
        Settings.from_toml(f"{text}\n")
    assert str(caught.value).startswith(says)
    assert "\n" not in str(caught.value)


def test_all_problems_of_a_text_are_reported_together() -> None:
    text = """\
        location_id = "seven"
        location = 1
        output_configuration = [
          { quantity = "acceleration", frequency = 100 },
          { quantity = "accelerations" },
          { quantity = "quaternion", rate = 1 },
        ]
        error_mode = 1
        rot_sensor = [1, 0, 0]
    """
    with pytest.raises(ValueError, match="line") as caught:
        Settings.from_toml(text)
    places = [problem.partition(":")[0] for problem in str(caught.value).splitlines()]
    assert places == [
        "line 1, location_id",
        "line 2, location",
        "line 5, output_configuration",
        "line 6, output_configuration",
        "line 9, rot_sensor",
    ]


def test_problems_without_end_are_counted() -> None:
    with pytest.raises(ValueError, match="line") as caught:
        Settings.from_toml("output_configuration = [\n" + "{},\n" * 50 + "]")
    lines = str(caught.value).splitlines()
    assert len(lines) == 21
    assert lines[-1] == "and 30 more problems"


LONG = 100_000


@pytest.mark.parametrize("name", SETTINGS)
@pytest.mark.parametrize(
    "value",
    [
        f'"{"x" * LONG}"',
        "1" * 4000,
        f"0x{'f' * LONG}",
        f"[{'1, ' * (LONG // 10)}]",
        f'["{"x" * LONG}"]',
        f"{{ {'x' * LONG} = 1 }}",
        f'[{{ quantity = "{"x" * LONG}" }}]',
    ],
    ids=["text", "decimal", "hexadecimal", "list", "text in a list", "key", "quantity"],
)
def test_a_long_wrong_value_has_a_short_message(name: str, value: str) -> None:
    with pytest.raises(ValueError) as caught:
        connect("sim:MTi-680G").apply(Settings.from_toml(f"{name} = {value}"))
    assert str(caught.value).startswith(f"line 1, {name}: ")
    assert len(str(caught.value)) < 700


def test_a_long_key_or_number_has_a_short_message() -> None:
    with pytest.raises(ValueError, match="there is no setting of this name") as caught:
        Settings.from_toml(f"{'x' * LONG} = 1")
    assert len(str(caught.value)) < 700
    with pytest.raises(ValueError, match="a number has too many digits"):
        Settings.from_toml(f"location_id = {'1' * LONG}")


def test_text_that_toml_cannot_hold() -> None:
    with pytest.raises(ValueError, match=r"lone surrogate '\\ud800'"):
        Settings(filter_profile="\ud800").to_toml()


@given(
    st.recursive(
        st.booleans() | st.integers(-(2**63), 2**63) | st.floats(allow_nan=False) | st.text(),
        lambda inner: (
            st.lists(inner) | st.dictionaries(st.from_regex(r"\A[A-Za-z0-9_-]+\Z"), inner)
        ),
        max_leaves=20,
    )
)
def test_what_is_written_as_toml_is_read_again(value: Any) -> None:
    assert tomllib.loads(f"key = {format_value(value)}") == {"key": value}


#: Text, and the line of each key and of each table in its list.
LINES: list[tuple[str, dict[str, list[int]]]] = [
    ("", {}),
    ("a = 1\n\n# b = 2\nc = 3", {"a": [1], "c": [4]}),
    (
        "a = [\n  { b = 1 }, { b = 2 },\n\n  { b = [{ c = 1 }] }\n]\nd = 1",
        {"a": [1, 2, 2, 4], "d": [6]},
    ),
    ('a = """\nb = 1\n[c]"""""\nd = \'\'\'\n\\\'\'\'\ne = 1', {"a": [1], "d": [4], "e": [6]}),
    ('a = "#\\"\\n[" # [\n"b c" = \'[\'\nd.e = 1\nd.f = 2', {"a": [1], "b c": [2], "d": [3, 4]}),
    ("[a] # [b]\nc = 1\n\n[[d]]\na = 2\n[[d]]\n[e.f]\na = 3", {"a": [1], "d": [4, 4, 6], "e": [7]}),
    ("a = [[1, 2],\r\n[3]]\r\n\r\nb = 1", {"a": [1], "b": [4]}),
]


@pytest.mark.parametrize(("text", "lines"), LINES)
def test_the_line_of_each_key(text: str, lines: dict[str, list[int]]) -> None:
    found = line_numbers(text)
    assert found == lines
    assert set(found) == set(tomllib.loads(text))


# Interrupted


class CutOff(SimulatedDevice):
    """A device that can no longer be reached from the message with this number on."""

    def __init__(self, product: int, last: int) -> None:
        super().__init__(product)
        self.left = last

    def write(self, data: bytes, baudrate: int | None = None) -> None:
        self.left -= 1
        if self.left >= 0:
            super().write(data, baudrate)

    def read(self, baudrate: int | None = None) -> bytes:
        data = super().read(baudrate)
        return data if self.left >= 0 else b""


def cuts(product: int) -> Iterator[tuple[SimulatedDevice, ApplyError | XbusTimeout | None]]:
    """The same settings applied again and again, the link cut after one message more each time."""
    wanted = changed(product)
    for last in count():
        sim = CutOff(product, last)
        device = Device(SimLink(sim))
        try:
            device.apply(wanted)
        except (ApplyError, XbusTimeout) as error:
            sim.left = sys.maxsize
            yield sim, error
            if not (isinstance(error, ApplyError) or device.session.state == State.UNKNOWN):
                continue
        else:
            sim.left = sys.maxsize
            yield sim, None
            return


@pytest.mark.parametrize("product", [3, 30, 680])
def test_the_link_cut_after_each_message_in_turn(product: int) -> None:
    wanted, seen = changed(product), set()
    factory = connect(SimulatedDevice(product)).settings()
    for sim, error in cuts(product):
        found = connect(sim).settings()
        if not isinstance(error, ApplyError):
            assert found in (factory, wanted)
            continue
        assert isinstance(error.__cause__, XbusTimeout)
        assert error.before == factory
        assert all(getattr(found, change.name) == change.after for change in error.applied)
        assert all(getattr(found, change.name) == change.before for change in error.not_applied)
        assert getattr(found, error.failed.name) in (error.failed.before, error.failed.after)
        names = {change.name for change in (*error.applied, error.failed, *error.not_applied)}
        assert names == {change.name for change in factory.diff(wanted)}
        assert f"unknown: {error.failed.name}" in str(error)
        seen.add(error.failed.name)
        again = connect(sim)
        again.apply(error.before)
        assert again.settings() == factory
    assert seen == {change.name for change in factory.diff(wanted)}


class Stubborn(Device):
    """A device that refuses one message, or acknowledges it and does nothing."""

    def __init__(self, message: str, *, says_so: bool) -> None:
        super().__init__(SimLink(SimulatedDevice("MTi-630")))
        self._message, self._says_so = message, says_so

    def command(self, name: str, value: Any = None) -> Any:
        if name != self._message:
            return super().command(name, value)
        if self._says_so:
            raise DeviceError(f"the device answered {name} with Error 33", 33, name)
        return super().command("ReqDID")


@pytest.mark.parametrize("says_so", [True, False])
def test_a_device_that_refuses_in_the_middle(says_so: bool) -> None:
    device = Stubborn("SetLocationID", says_so=says_so)
    place = LatLonAlt(1, 2, 3)
    wanted = Settings(location_id=7, lat_lon_alt=place, filter_profile="Robust/VRU")
    with pytest.raises(ApplyError) as caught:
        device.apply(wanted)
    assert str(pickle.loads(pickle.dumps(caught.value))) == str(caught.value)  # noqa: S301
    assert caught.value.summary.endswith(
        "; applied: filter_profile; not applied: location_id, lat_lon_alt"
    )
    assert device.settings().filter_profile == "Robust/VRU"
    assert device.state == State.MEASUREMENT
    device.apply(caught.value.before)
    assert device.settings() == caught.value.before


def test_ctrl_c_says_what_was_applied(monkeypatch: pytest.MonkeyPatch) -> None:
    device = connect("sim:MTi-630")

    def interrupted(name: str, value: Any = None) -> Any:
        if name == "SetLocationID":
            raise KeyboardInterrupt
        return Device.command(device, name, value)

    monkeypatch.setattr(device, "command", interrupted)
    with pytest.raises(KeyboardInterrupt) as caught:
        device.apply(Settings(location_id=7, filter_profile="Robust/VRU"))
    assert "applied: filter_profile; unknown: location_id" in caught.value.__notes__[0]


def test_rounded_settings_are_reported() -> None:
    """The receiver delivers when it delivers (Table 16)."""
    device = connect("sim:MTi-670")
    settings = Settings(output_configuration=(Output(0x7010, 4), Output(0x4020, 100)))
    (rounded,) = device.apply(settings).rounded
    assert rounded.after == (Output(0x7010, 0xFFFF), Output(0x4020, 100))
    assert not device.apply(settings).changes
