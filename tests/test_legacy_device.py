"""Devices that send MTData: recognised, configured in the terms of MTData2, read live and recorded."""

from __future__ import annotations

import pickle
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import xbus
from xbus import Session, SimulatedDevice, StateError, XbusTimeout, connect
from xbus.device.events import Reply
from xbus.device.mtdata_output import plan_mtdata
from xbus.protocol import EVERY, OrientationForm, Output, OutputMode, OutputSettings, State
from xbus.protocol.mtdata import MTDATA_ITEMS
from xbus.protocol.products import support
from xbus.protocol.tables import LEGACY_PRODUCTS
from xbus.wire.mtdata import mtdata_layout

LEGACY = list(LEGACY_PRODUCTS)
#: Of the 10- and 100-series, in legacy mode.
LATER = ["MTi-30", "MTi-100", "MTi-G-710"]
_M = OutputMode


def in_legacy_mode(product: str) -> xbus.Device:
    """Returns a device that sends calibrated data and the temperature as MTData."""
    device = connect(SimulatedDevice(product))
    with device.configure():
        if product in LATER:
            device.command("SetOutputConfiguration", ())
        device.commands.set_output_mode(_M.CALIBRATED | _M.TEMPERATURE)
    return device


@pytest.mark.parametrize("product", LEGACY)
def test_a_legacy_device_is_recognised(product: str) -> None:
    device = connect(f"sim:{product}")
    with device.configure():
        assert device.product is LEGACY_PRODUCTS[product]
    assert device.device_id == support(product).identity.device_id
    assert device.state is State.MEASUREMENT


def test_a_device_id_of_an_unknown_kind_is_no_legacy_product() -> None:
    """Error 4 alone is not enough: without the product, nothing is checked."""
    device = connect(SimulatedDevice("MTi", device_id=0x00100001, product_code="XM-B-28"))
    with device.configure():
        assert device.product is None
        assert device.commands.req_output_mode() == _M.ORIENTATION


@pytest.mark.parametrize("product", LEGACY + LATER)
def test_from_configuration_to_log(product: str, tmp_path: Path) -> None:
    """What is read live is what `read_log` reads from the recording."""
    device = in_legacy_mode(product)
    path = tmp_path / "legacy.mtb"
    with device.record(path):
        samples = [device.read_sample() for _ in range(60)]
        block = next(device.blocks(samples=40))
    log = xbus.read_log(path)
    keys = ["temperature", "acceleration", "rate_of_turn", "magnetic_field", "packet_counter"]
    assert list(log) == list(block) == list(samples[0]) == keys
    assert len(log) >= 100
    assert log.stats.unfit == log.stats.lost_samples == 0
    for key in keys:
        live = np.array([sample[key] for sample in samples])
        assert np.array_equal(live, log[key].values[:60]), key
        assert np.array_equal(block[key].values, log[key].values[60:100]), key
    assert device.stats.samples >= 100
    assert device.stats.quantities["acceleration"] >= 100
    assert (
        xbus.read_log(b"".join(s.frame for s in samples), legacy=(3, 1))["acceleration"] is not None
    )
    assert pickle.loads(pickle.dumps(samples[0])) == samples[0]  # noqa: S301 - our own


CONFIGURATIONS: list[tuple[dict[Any, int | None], OutputMode, OutputSettings, tuple[int, int]]] = [
    ({"quaternion": 100, "packet_counter": None}, _M.ORIENTATION, OutputSettings(), (1152, 0)),
    (
        {"acceleration": 50, "rate_of_turn": 50},
        _M.CALIBRATED,
        OutputSettings(packet_counter=False, magnetic_field=False),
        (1152, 1),
    ),
    (
        {("euler_angles", "NED", "Fp1632"): 512, "utc_time": None, "analog_in2": None},
        _M.ORIENTATION | _M.AUXILIARY,
        OutputSettings.from_word(0x8000_0606),
        (225, 0),
    ),
    ({"rotation_matrix": None}, _M.ORIENTATION, OutputSettings.from_word(8), (225, 0)),
    (
        {"status_word": None, "sample_time_fine": None},
        _M.STATUS, OutputSettings.from_word(0x0200_0080), (225, 0),
    ),
    (
        {"baro_pressure": 100, "pressure_age": 100},
        _M.GPS_PVT, OutputSettings.from_word(0x0008_0000), (1152, 0),
    ),
    (
        {"gps_pvt_data": 100},
        _M.GPS_PVT, OutputSettings.from_word(0), (1152, 0),
    ),
    (
        {"lat_lon": 100, ("velocity_xyz", "NWU"): 100},
        _M.POSITION | _M.VELOCITY, OutputSettings.from_word(0), (1152, 0),
    ),
]  # fmt: skip


@pytest.mark.parametrize("product", LEGACY + LATER)
def test_all_that_is_wanted_is_sent(product: str) -> None:
    """Of the GPS receiver of an MTi-G, one bit leaves out both the data and their age."""
    known = support(product)
    names = {row.quantity for row in MTDATA_ITEMS if OutputMode(row.mode) in known.output_modes}
    forms = {"quaternion", "euler_angles", "rotation_matrix"}, {"status_byte", "status_word"}
    for pair in map(set, combinations(sorted(names), 2)):
        if not any(pair <= form for form in forms):
            plan = plan_mtdata(dict.fromkeys(pair, 100), known)
            layout = mtdata_layout(int(plan.mode), int(plan.settings))
            assert pair <= {item.name for item in layout.items}


@pytest.mark.parametrize(("wanted", "mode", "form", "rate"), CONFIGURATIONS)
def test_names_rates_and_formats_become_mode_and_settings(
    wanted: dict[Any, int | None], mode: OutputMode, form: OutputSettings, rate: tuple[int, int]
) -> None:
    device = connect("sim:MTi-G")
    with device.configure(wanted, check_baudrate=False) as cfg:
        assert cfg.commands.req_output_mode() == mode
        assert cfg.commands.req_output_settings() == form
        assert (cfg.commands.req_period(), cfg.commands.req_output_skip_factor()) == rate
    names = [key[0] if isinstance(key, tuple) else key for key in wanted]
    assert set(names) <= set(device.read_sample())
    in_effect = {output.quantity: output.frequency for output in device.output_configuration or ()}
    for name, asked in zip(names, wanted.values(), strict=True):
        assert in_effect[name] in (asked or 512, EVERY)


@pytest.mark.parametrize(
    ("wanted", "error"),
    [
        ({"acceleration": 100, "rate_of_turn": 50}, "at one rate, not acceleration at 100 Hz"),
        ({"quaternion": 100, "euler_angles": 100}, "quaternion or euler_angles, not both"),
        ({"status_word": None, "status_byte": None}, "status_byte or status_word, not both"),
        ({("quaternion", "ENU"): 100}, "NWU and NED, not ENU"),
        ({("quaternion", "NED"): 100, ("velocity_xyz", "NWU"): 100}, "in one coordinate system"),
        ({("acceleration", "Fp1632"): 100, ("temperature", "Float64"): 100}, "in one precision"),
        ({"free_acceleration": 100}, "the MTi-G has no output free_acceleration; it has "),
        ({"acceleration": 99}, "the nearest are 98.9"),
        ({"acceleration": 513}, "to 512 Hz"),
        ({"acceleration": 512, "quaternion": None}, "at least 230,400 baud"),
        ([Output(0x2010, 100)], "NWU and NED, not ENU"),
    ],
)  # fmt: skip
def test_what_mtdata_cannot_hold_is_refused(wanted: Any, error: str) -> None:
    sim = SimulatedDevice("MTi-G", baudrate=115_200)
    device = connect(sim)
    with device.configure() as cfg:
        before = sim.settings
        with pytest.raises(ValueError, match=error):
            cfg.set_output_configuration(wanted)
        assert sim.settings == before


def test_an_mti_has_no_position() -> None:
    device = connect("sim:MTi")
    with device.configure() as cfg:
        with pytest.raises(ValueError, match="the MTi has no output lat_lon"):
            cfg.set_output_configuration({"lat_lon": 100})
        with pytest.raises(
            ValueError, match="the MTi has no output mode POSITION; it has TEMPERATURE"
        ):
            cfg.commands.set_output_mode(_M.POSITION)
        with pytest.raises(ValueError, match="no source explains all"):
            cfg.commands.set_output_settings(OutputSettings(orientation=3))
        with pytest.raises(StateError, match="the MTi does not support SetStringOutputType"):
            cfg.commands.set_string_output_type(1)


def test_later_devices_know_the_settings_in_legacy_mode_only() -> None:
    device = connect("sim:MTi-30")
    with device.configure() as cfg:
        with pytest.raises(StateError, match="while it sends MTData2"):
            cfg.commands.set_output_mode(_M.CALIBRATED)
        cfg.command("SetOutputConfiguration", ())
        cfg.commands.set_output_mode(_M.CALIBRATED)
    again = connect(device.link.device)  # type: ignore[attr-defined]
    with again.configure() as cfg:
        assert cfg.commands.req_output_mode() == _M.CALIBRATED


def test_settings_that_change_are_followed() -> None:
    device = connect("sim:MTx")
    assert list(device.read_sample()) == ["quaternion", "packet_counter"]
    with device.configure({"euler_angles": 100}):
        pass
    assert list(device.read_sample()) == ["euler_angles"]
    blocks = device.blocks(samples=3)
    assert list(next(blocks)) == ["euler_angles"]
    with device.configure({("euler_angles", "NED", "Float64"): 100}):
        pass
    found = next(blocks)["euler_angles"]
    assert (found.precision, found.coordinates) == ("Float64", "NED")


def test_whoever_listens_only_gives_the_settings() -> None:
    sim = SimulatedDevice("MTi")
    sim.advance(2)
    sim.read()
    silent = connect(sim, listen=True)
    with pytest.raises(XbusTimeout, match=r"MTData \(0x32\)"):
        silent.read_sample(1)
    device = connect(sim, listen=True, legacy=(_M.ORIENTATION, OutputSettings()))
    assert list(device.read_sample()) == ["quaternion", "packet_counter"]


def test_a_recording_that_only_listens_begins_with_the_settings_in_force(tmp_path: Path) -> None:
    """Another program sets them: acknowledgements without requests are heard, then the Configuration."""
    sim = SimulatedDevice("MTi")
    device = connect(sim, listen=True)
    for mid, payload in ((0x30, ""), (0xD0, "0001"), (0xD2, "00000001"), (0x10, "")):
        sim.write(xbus.encode_frame(mid, bytes.fromhex(payload)))
        device.listen(0.1)
    with device.record(tmp_path / "heard.mtb"):
        device.listen(0.5)
    log = xbus.read_log(tmp_path / "heard.mtb")
    assert (log.stats.unfit, list(log)) == (0, ["temperature", "packet_counter"])


def test_on_request() -> None:
    device = connect("sim:MTi")
    with device.configure() as cfg:
        cfg.commands.set_output_skip_factor(65535)
    for number in range(3):
        device.commands.req_data()
        assert device.read_sample()["packet_counter"] == number
    with pytest.raises(XbusTimeout, match="no sample"):
        device.read_sample(1)


FORMS = st.builds(
    OutputSettings,
    packet_counter=st.just(True),
    orientation=st.sampled_from(OrientationForm),
    precision=st.sampled_from(xbus.Precision),
    coordinates=st.sampled_from([xbus.Coordinates.NED, xbus.Coordinates.NWU]),
    status_word=st.booleans(),
    utc_time=st.booleans(),
    magnetic_field=st.booleans(),
)


@settings(max_examples=20)
@given(st.integers(1, 0x7FFF), FORMS, st.lists(st.integers(1, 40), max_size=30))
def test_a_session_gives_the_samples_of_the_log(
    bits: int, form: OutputSettings, cuts: list[int]
) -> None:
    """Without link and thread: the acknowledged settings are in force, however the bytes are cut."""
    sim, session = SimulatedDevice("MTi-G", time_to_fix=0.0), Session()
    sim.advance(0.1)
    sim.read()
    received = b""

    def ask(name: str, value: Any = None) -> None:
        nonlocal received
        sim.write(session.request(name, value))
        received += (data := sim.read())
        assert isinstance((session.receive(data) + session.quiet())[0], Reply)

    mode = OutputMode(bits) & support("MTi-G").output_modes or _M.CALIBRATED
    for name, value in (
        ("GoToConfig", None), ("SetOutputMode", mode), ("SetOutputSettings", form),
        ("GoToMeasurement", None),
    ):  # fmt: skip
        ask(name, value)
    sim.advance(0.1)
    data = sim.read()
    samples = []
    for size in [*cuts, len(data)]:
        samples += [e for e in session.receive(data[:size]) if isinstance(e, xbus.Sample)]
        data = data[size:]
    assert len(samples) == 10
    assert samples[0].output == (mode, int(form))
    assert [sample["packet_counter"] for sample in samples] == list(range(10))
