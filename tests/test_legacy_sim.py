"""Virtual devices that send MTData: legacy products, and the 10- and 100-series in legacy mode."""

from __future__ import annotations

import struct
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import xbus
from xbus import Coordinates, MessageId, Precision, Scanner, SimulatedDevice, encode_frame
from xbus.protocol import OrientationForm, Output, OutputMode, OutputSettings, decode, encode
from xbus.protocol.products import support
from xbus.protocol.tables import LEGACY_PRODUCTS, MESSAGES
from xbus.sim.mtdata import mtdata_size
from xbus.sim.sensors import Sensors, Ticks
from xbus.sim.trajectories import trajectory
from xbus.wire.mtdata import decode_mtdata, mtdata_layout

_M = OutputMode
LEGACY = list(LEGACY_PRODUCTS)
#: Of the 10- and 100-series: an IMU, an AHRS, a GNSS/INS.
LATER = ["MTi-10", "MTi-300", "MTi-G-710"]


def asked(device: SimulatedDevice, name: str, value: Any = None) -> xbus.Message:
    """Returns the answer to a request."""
    device.write(encode_frame(MESSAGES[name].mid, encode(name, value)))
    return received(device)[0]


def received(device: SimulatedDevice) -> list[xbus.Message]:
    scanner = Scanner()
    found = scanner.feed(device.read()) + scanner.close()
    assert all(isinstance(item, xbus.Message) for item in found)
    return [item for item in found if isinstance(item, xbus.Message)]


def in_config(product: str, **options: Any) -> SimulatedDevice:
    """Returns a device in Config State, and in legacy mode."""
    device = SimulatedDevice(product, **options)
    device.advance(0.1)
    device.read()
    asked(device, "GoToConfig")
    if product in LATER:
        assert (
            asked(device, "SetOutputConfiguration", ()).mid == MessageId.SetOutputConfigurationAck
        )
    return device


def measured(device: SimulatedDevice, seconds: float) -> list[xbus.Message]:
    """Returns what a device sends after GoToMeasurement."""
    assert asked(device, "GoToMeasurement").mid == MessageId.GoToMeasurementAck
    device.advance(seconds)
    return received(device)


@pytest.mark.parametrize("product", LEGACY)
def test_a_new_device_sends_the_quaternion_and_the_counter_at_100_hz(product: str) -> None:
    device = in_config(product)
    configuration, *data = measured(device, 0.1)
    assert configuration.name == "Configuration"
    value = decode("Configuration", configuration.payload)
    assert (value.output_mode, value.output_settings, value.data_length) == (4, 1, 18)
    assert (value.sampling_period, value.output_skip_factor) == (1152, 0)
    assert value.device_id == support(product).identity.device_id
    assert [message.mid for message in data] == [MessageId.MTData] * 10
    assert [message.payload[-1] for message in data] == list(range(10))


@pytest.mark.parametrize("product", LEGACY)
def test_mtdata2_and_strings_are_unknown_messages(product: str) -> None:
    device = in_config(product)
    for name in ("ReqOutputConfiguration", "ReqStringOutputType"):
        assert asked(device, name).payload == b"\x04"


@pytest.mark.parametrize("product", LATER)
def test_legacy_mode_begins_with_an_empty_output_configuration(product: str) -> None:
    device = SimulatedDevice(product)
    device.advance(0.1)
    device.read()
    asked(device, "GoToConfig")
    assert asked(device, "ReqOutputMode").payload == b"\x04"
    asked(device, "SetOutputConfiguration", ())
    assert asked(device, "ReqDataLength").payload == b"\0\0"
    assert asked(device, "SetOutputMode", _M.CALIBRATED).mid == MessageId.SetOutputModeAck
    assert asked(device, "ReqDataLength").payload == bytes([0, 38])
    configuration, *data = measured(device, 0.05)
    assert decode("Configuration", configuration.payload).data_length == 38
    assert [len(message.payload) for message in data] == [38] * 5
    asked(device, "GoToConfig")
    asked(device, "SetOutputConfiguration", [Output(0x1020)])
    assert asked(device, "ReqOutputMode").payload == b"\x04"
    assert {message.name for message in measured(device, 0.05)} == {"MTData2"}


def test_an_imu_has_no_orientation() -> None:
    assert asked(in_config("MTi-10"), "SetOutputMode", _M.ORIENTATION).payload == bytes([33])


@pytest.mark.parametrize(
    ("period", "skip", "rate"), [(1152, 0, 100), (225, 0, 512), (576, 3, 50), (1152, 99, 1)]
)
def test_rates(period: int, skip: int, rate: int) -> None:
    device = in_config("MTi")
    asked(device, "SetPeriod", period)
    asked(device, "SetOutputSkipFactor", skip)
    _, *data = measured(device, 2)
    assert len(data) == 2 * rate


def test_a_long_period_sets_the_skip_factor() -> None:
    device = in_config("MTx")
    assert asked(device, "SetPeriod", 2304).mid == MessageId.SetPeriodAck
    assert asked(device, "ReqPeriod").payload == struct.pack(">H", 1152)
    assert asked(device, "ReqOutputSkipFactor").payload == struct.pack(">H", 1)
    assert asked(device, "SetPeriod", 2305).payload == b"\x03"
    assert asked(device, "SetPeriod", 224).payload == b"\x03"


def test_the_counter_wraps() -> None:
    device = in_config("MTi")
    asked(device, "SetPeriod", 225)
    _, *data = measured(device, 65_540 / 512)
    assert len(data) == 65_540
    assert [message.payload[-2:] for message in data[65_535:65_537]] == [b"\xff\xff", b"\0\0"]


def test_on_request_the_device_is_silent_until_req_data() -> None:
    device = in_config("MTi")
    asked(device, "SetOutputSkipFactor", 0xFFFF)
    assert [message.name for message in measured(device, 5)] == ["Configuration"]
    for number in range(3):
        device.write(bytes.fromhex("FA013400CB"))
        (message,) = received(device)
        assert (message.mid, message.payload[-2:]) == (MessageId.MTData, bytes([0, number]))


PRECISIONS = st.sampled_from(Precision)
SETTINGS = st.builds(
    OutputSettings,
    *[st.booleans()] * 2,
    st.sampled_from(OrientationForm),
    *[st.booleans()] * 4,
    PRECISIONS,
    *[st.booleans()] * 5,
    st.sampled_from([Coordinates.NED, Coordinates.NWU]),
)
#: Digits that each format keeps of numbers of the size of latitudes.
TOLERANCE = {
    Precision.Float32: 1e-5,
    Precision.Fp1220: 1e-6,
    Precision.Fp1632: 1e-9,
    Precision.Float64: 0,
}


@settings(max_examples=25)
@given(st.sampled_from(LEGACY + LATER), st.integers(1, 0x7FFF), SETTINGS)
def test_random_settings(product: str, bits: int, form: OutputSettings) -> None:
    """Every item has the values of the sensors, in every format."""
    mode = OutputMode(bits) & support(product).output_modes or _M.TEMPERATURE
    device = in_config(product, trajectory="sail", time_to_fix=0.0)
    assert asked(device, "SetOutputMode", mode).payload == b""
    assert asked(device, "SetOutputSettings", form).payload == b""
    assert decode("ReqOutputModeAck", asked(device, "ReqOutputMode").payload) == mode
    assert decode("ReqOutputSettingsAck", asked(device, "ReqOutputSettings").payload) == form
    size = mtdata_size(mode, form)
    assert asked(device, "ReqDataLength").payload == struct.pack(">H", size)
    configuration, *data = measured(device, 0.05)
    value = decode("Configuration", configuration.payload)
    assert (value.output_mode, value.output_settings, value.data_length) == (mode, int(form), size)
    assert len(data) == 5
    sensors = Sensors(trajectory("sail"), LEGACY_PRODUCTS["MTi-G"])
    # Time starts at power-up, so that the first message after 0.1 s is that of instant 11.
    for instant, message in enumerate(data, 11):
        found = decode_mtdata(message.payload, mode, int(form))
        for item in mtdata_layout(mode, int(form)).items:
            if item.name in (
                "acceleration",
                "quaternion",
                "euler_angles",
                "lat_lon",
                "velocity_xyz",
            ):
                ticks = Ticks(instant, 1, 100)
                truth = sensors.read(item.name, ticks, item.coordinates or "ENU")[0]
                tolerance = TOLERANCE[form.precision] * max(1, np.abs(truth).max())
                assert np.abs(found[item.name] - truth).max() <= tolerance, item.name
        if form.packet_counter:
            assert found["packet_counter"] == instant - 11
        if _M.GPS_PVT in mode:
            assert found["pressure_age"] < 3
            assert (
                abs(found["baro_pressure"] - sensors.read("baro_pressure", Ticks(5, 1, 50))[0]) < 50
            )


def test_gps_pvt_of_an_mti_g() -> None:
    """Before the fix its age is invalid; then it counts messages since the last solution, of 4 a second."""
    device = in_config("MTi-G", time_to_fix=0.5)
    asked(device, "SetOutputMode", _M.GPS_PVT)
    _, *data = measured(device, 2.0)
    rows = [decode_mtdata(message.payload, _M.GPS_PVT, 1) for message in data]
    ages = [row["gnss_age"] for row in rows]
    assert ages[:39] == [255] * 39
    assert set(ages[40:]) == set(range(25))
    for before, row in pairwise(rows[50:]):
        assert row["gnss_age"] == 0 or row["gps_pvt_data"] == before["gps_pvt_data"]
    assert abs(rows[-1]["gps_pvt_data"].scaled["lat"] - 52.24) < 0.01
    assert [row["pressure_age"] for row in rows[-4:]] == [1, 0, 1, 0]


def test_replies_to_the_gps_receivers_channels() -> None:
    channels = decode("GnssStatus", asked(in_config("MTi-G"), "ReqGnssStatus").payload)
    assert len(channels) == 20
    assert asked(in_config("MTi"), "ReqGnssStatus").payload == b"\x04"
