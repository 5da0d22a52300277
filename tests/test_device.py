"""Devices: opened, configured, read and lost. The time of virtual devices advances during waits."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import xbus
from conftest import AlteredDevice
from xbus import (
    DecodeError,
    Device,
    DeviceError,
    Disconnected,
    MessageId,
    SimulatedDevice,
    StateError,
    XbusTimeout,
    _core,
    connect,
    encode_frame,
)
from xbus.device.output_configuration import (
    bytes_per_second,
    check_outputs_fit,
    parse_output_configuration,
)
from xbus.protocol import OptionFlag, Output, State, StringType
from xbus.protocol.products import support
from xbus.protocol.tables import MESSAGES, PRODUCTS
from xbus.sim.link import SimLink

PRODUCT_NAMES = [product.name for product in PRODUCTS.values()]


def opened(
    product: str = "MTi-630", state: State = State.CONFIG, **settings: Any
) -> tuple[Device, AlteredDevice]:
    sim = AlteredDevice(product, **settings)
    device = Device(SimLink(sim))
    device.go_to_config()
    if state == State.MEASUREMENT:
        device.go_to_measurement()
    sim.written.clear()
    return device, sim


# Opening


def test_connect_sends_nothing_if_the_device_sends() -> None:
    sim = AlteredDevice("MTi-630")
    device = Device(SimLink(sim))
    device.find_baudrate([115_200])
    assert (device.state, sim.written) == (State.MEASUREMENT, [])


@pytest.mark.parametrize("state", [State.CONFIG, State.MEASUREMENT])
@pytest.mark.parametrize("product", PRODUCT_NAMES)
def test_a_device_is_left_in_the_state_it_was_found_in(product: str, state: State) -> None:
    sim = SimulatedDevice(product)
    first = connect(sim)
    if state == State.CONFIG:
        first.go_to_config()
    first.close()
    with connect(sim) as device:
        assert (device.state, sim.state, device.product) == (state, state, None)
        with device.configure() as cfg:
            assert cfg.state == sim.state == State.CONFIG
            assert cfg.product is not None
            assert cfg.product.name == product
            assert cfg.device_id == support(product).identity.device_id
            assert cfg.firmware == support(product).identity.firmware
        assert (device.state, sim.state) == (state, state)


def test_a_silent_measuring_device_is_detected() -> None:
    sim = SimulatedDevice("MTi-630")
    with connect(sim) as device, device.configure() as cfg:
        cfg.commands.set_sync_settings([xbus.protocol.SyncSetting(8, 6)])
    with connect(sim) as device:
        assert device.state == sim.state == State.MEASUREMENT
        device.commands.req_data()
        assert "quaternion" in device.read_sample()


def test_configure_restores_the_state_after_an_exception() -> None:
    sim = SimulatedDevice("MTi-630")
    device = connect(sim)
    with pytest.raises(ZeroDivisionError), device.configure():
        1 / 0  # noqa: B018
    assert sim.state == State.MEASUREMENT


@pytest.mark.parametrize("rate", [115_200, 921_600, 9_600])
def test_the_baud_rate_is_found_by_trying(rate: int) -> None:
    device = connect(SimulatedDevice("MTi-300", baudrate=rate))
    assert (device.link.baudrate, device.state) == (rate, State.MEASUREMENT)


@pytest.mark.parametrize(
    ("is_silent", "error"),
    [
        (True, "^nothing was heard on sim:MTi-300 at 9600 baud; check that the device is powered"),
        (
            False,
            "^[1-9][0-9]* bytes arrived on sim:MTi-300 at 9600 baud, but no message; 9600 baud is probably"
            " not the rate of the device: leave the baud rate out",
        ),
    ],
)
def test_a_wrong_baud_rate_is_reported(is_silent: bool, error: str) -> None:
    sim = AlteredDevice("MTi-300", baudrate=115_200)
    if is_silent:
        sim.alter = lambda _: b""
    with pytest.raises(XbusTimeout, match=error) as caught:
        connect(sim, 9_600)
    assert caught.value.command is None
    assert caught.value.waited > 0


@pytest.mark.parametrize(
    ("port", "kind", "error"),
    [
        ("sim:MTi-4", ValueError, "no product is called 'MTi-4'"),
        ("/dev/no-such-port", OSError, "no-such-port"),
        ("nonsense://x", ValueError, "nonsense"),
    ],
)
def test_ports_that_do_not_exist(port: str, kind: type[Exception], error: str) -> None:
    with pytest.raises(kind, match=error):
        connect(port)


@pytest.mark.parametrize("bid", [0xFF, 1])
def test_both_bus_identifiers_reach_the_device(bid: int) -> None:
    with connect("sim:MTi-30", bid=bid) as device, device.configure() as cfg:
        assert cfg.product is not None


# Output


# outputs, acknowledged: rates as acknowledged, whatever was requested for stamps and status
ACKNOWLEDGED = [
    ("MTi-3", {"acceleration": 50, "packet_counter": 100}, [(0x4020, 50), (0x1020, 0xFFFF)]),
    ("MTi-630", {"acceleration": None, "status_word": None}, [(0x4020, 400), (0xE020, 0xFFFF)]),
    ("MTi-630", {("quaternion", "NED", "Fp1632"): 100}, [(0x2016, 100)]),
    ("MTi-G-710", {"gnss_pvt_data": None, "lat_lon": 0}, [(0x7010, 4), (0x5040, 400)]),
    ("MTi-630", [Output(0x1060, 400), Output(0x4020, 0)], [(0x1060, 0xFFFF), (0x4020, 400)]),
    ("MTi-630", {}, []),
]


@pytest.mark.parametrize(("product", "outputs", "acknowledged"), ACKNOWLEDGED)
def test_the_acknowledged_rates_are_kept(product: str, outputs: Any, acknowledged: Any) -> None:
    with connect(f"sim:{product}") as device, device.configure() as cfg:
        lines = cfg.set_output_configuration(outputs)
        assert lines == cfg.output_configuration == tuple(acknowledged)
        assert lines == cfg.commands.req_output_configuration()


def test_strings_are_switched_off_first() -> None:
    device, sim = opened("MTi-300")
    device.commands.set_string_output_type(StringType.PSONCMS)
    with device.configure() as cfg:
        cfg.set_output_configuration({"acceleration": 100})
    sent = [frame[2] for frame in sim.written]
    assert sent[-2:] == [0x8E, 0xC0]
    assert device.commands.req_string_output_type().types == 0


@pytest.mark.parametrize(
    ("outputs", "error"),
    [
        ({"nothing": 100}, "no quantity is called 'nothing'"),
        ({"acceleration": 99.5}, "whole number of Hz"),
        ({("packet_counter", "Fp1632"): None}, "packet_counter has no precision"),
        (
            [Output(0x4020, 100), Output(0x4020, 50)],
            "acceleration is in the output configuration twice",
        ),
        (
            {"acceleration": 300},
            "cannot send acceleration at 300 Hz; the nearest rates are 200 and 400 Hz",
        ),
        ({"lat_lon": 100}, "the MTi-630 has no output lat_lon"),
    ],
)
def test_invalid_outputs_are_rejected(outputs: Any, error: str) -> None:
    device, sim = opened("MTi-630")
    with device.configure() as cfg:
        sim.written.clear()
        with pytest.raises(ValueError, match=error):
            cfg.set_output_configuration(outputs)
        assert sim.written == []


HIGH_RATE = {"acceleration_hr": 2000, "rate_of_turn_hr": 1600}


def test_too_much_output_is_rejected_with_a_sufficient_baud_rate() -> None:
    device, sim = opened("MTi-630")
    with device.configure() as cfg:
        sim.written.clear()
        with pytest.raises(
            ValueError, match="115,200 baud carry 11,520; use at least 921,600 baud"
        ):
            cfg.set_output_configuration(HIGH_RATE)
        assert sim.written == []
        cfg.set_output_configuration(HIGH_RATE, check_baudrate=False)


# outputs, bytes of one second of a virtual device, tolerance
SIZES = [
    (
        "MTi-630",
        {"packet_counter": None, "sample_time_fine": None, "quaternion": 100, "status_word": None},
        0.01,
    ),
    (
        "MTi-630",
        {"sample_time_fine": None, "acceleration": 400, "quaternion": 100, "baro_pressure": 20},
        0.01,
    ),
    (
        "MTi-3",
        {"acceleration": 100, "magnetic_field": 25, "euler_angles": 20, "status_word": None},
        0.01,
    ),
    ("MTi-630", {"packet_counter": None, **HIGH_RATE}, 0.01),
    ("MTi-G-710", {"lat_lon": 100, "gnss_pvt_data": 4, "packet_counter": None}, 0.02),
]


@pytest.mark.parametrize(("product", "outputs", "within"), SIZES)
def test_bytes_per_second_match_the_device(product: str, outputs: Any, within: float) -> None:
    sim = SimulatedDevice(product)
    with connect(sim) as device, device.configure() as cfg:
        cfg.set_output_configuration(outputs, check_baudrate=False)
    sim.advance(6)  # the fix comes after five seconds
    sim.read()
    sim.advance(10)
    found = len(sim.read()) / 10
    assert bytes_per_second(parse_output_configuration(outputs), support(product)) == pytest.approx(
        found, rel=within
    )


def test_check_fits_reports_that_no_rate_is_sufficient() -> None:
    outputs = [
        Output(0x4043, 1000),
        Output(0x8043, 1000),
        Output(0xA010, 2000),
        Output(0x2023, 400),
    ]
    with pytest.raises(
        ValueError, match="no baud rate of this product is sufficient; at 921,600 baud"
    ):
        check_outputs_fit(outputs, support("MTi-300"), 921_600)


# Samples


def test_samples_match_a_log() -> None:
    sim = SimulatedDevice("MTi-680G")
    outputs = {
        "packet_counter": None, "sample_time_fine": None, "utc_time": None, ("quaternion", "NED"): 100,
        "rotation_matrix": 100, ("acceleration", "Fp1632"): 100, "baro_pressure": 100, "status_word": None,
        "gnss_pvt_data": 4, "gnss_sat_info": 4,
    }  # fmt: skip
    with connect(sim) as device:
        with device.configure() as cfg:
            cfg.set_output_configuration(outputs, check_baudrate=False)
        samples = [device.read_sample() for _ in range(300)]
    log = xbus.read_log(b"".join(encode_frame(0x36, sample.payload) for sample in samples))
    assert set(log) == set().union(*samples)
    for key in log:
        column = log[key]
        for row, at in enumerate(column.sample):
            found = samples[at][key]
            if isinstance(found, dict):
                satellites = found.pop("satellites", None)
                assert tuple(found.values()) == column.values[row].item()
                if satellites is not None:
                    first, last = column.offsets[row : row + 2]
                    rows = [tuple(satellite.values()) for satellite in satellites]
                    assert rows == column.satellites[first:last].tolist()
            else:
                assert np.array_equal(found, column.values[row])
                if isinstance(found, np.ndarray):
                    assert found.dtype == column.values.dtype


def test_samples_received_during_a_command_are_kept() -> None:
    device, _ = opened("MTi-630", State.MEASUREMENT)
    first = [device.read_sample()["packet_counter"] for _ in range(3)]
    device.commands.set_no_rotation(2)
    device.commands.icc_command(3)
    after = [device.read_sample()["packet_counter"] for _ in range(50)]
    assert np.unique(np.diff(first + after)).tolist() == [1]


def test_config_state_has_no_samples() -> None:
    device, _ = opened()
    with pytest.raises(StateError, match="the device is in Config State"):
        for _ in device:  # samples received before are returned first
            pass


def test_a_silent_device_raises() -> None:
    device, _ = opened()
    device.set_output_configuration({})
    device.go_to_measurement()
    with pytest.raises(XbusTimeout, match="no sample from sim:MTi-630 within 2 s") as caught:
        device.read_sample(2)
    assert (caught.value.command, caught.value.waited) == (None, 2)


#: A sample that looks as if the answer to GoToConfig were in it.
TREACHEROUS = encode_frame(0x36, b"\x99\x90\x0c" + encode_frame(0x31) + bytes(7))


@pytest.mark.parametrize("seconds", [0.05, 0.3, 3.0])
@pytest.mark.parametrize("cut", [1, 4, 13, len(TREACHEROUS) - 1])
def test_silence_inside_a_frame_loses_nothing(seconds: float, cut: int) -> None:
    """The rest of a frame may come at any time."""
    device, _ = opened()
    device.set_output_configuration({})
    device.go_to_measurement()
    before = device.stats
    push, clock = device.link.acquisition.push, device.link.clock
    push(TREACHEROUS[:cut], clock())
    device.listen(seconds)
    assert device.stats.unread_samples == 0
    push(TREACHEROUS[cut:], clock())
    sample, after = device.read_sample(0), device.stats
    assert (sample.frame, sample.arrival) == (TREACHEROUS, clock())
    assert after.samples - before.samples == 1
    assert after.messages == before.messages
    lost = (after.skipped_bytes, after.checksum_errors, after.lost_samples, after.dropped_samples)
    assert (*lost, after.unread_samples) == (0, 0, 0, 0, 0)


class Heard:
    """Counts the messages from the device, by MID."""

    def __init__(self) -> None:
        self.mids: list[int] = []
        self.damaged = 0

    def sent(self, data: bytes) -> None:
        pass

    def received(self, item: _core.ScannedFrame | _core.ScannedDamage) -> None:
        if isinstance(item, _core.ScannedDamage):
            self.damaged += item.length
        else:
            self.mids.append(item.mid)


@pytest.mark.parametrize("seconds", [0.0, 0.05, 0.3, 3.0])
def test_a_command_is_answered_behind_half_a_frame(seconds: float) -> None:
    """The answer comes in time and once, although the frame may still turn out to be longer."""
    device, _ = opened()
    heard = Heard()
    device.trace(heard)
    half = encode_frame(0x36, bytes(200))[:50]
    device.link.acquisition.push(half, device.link.clock())
    device.listen(seconds)
    began, before, notices = device.link.clock(), device.stats.messages, list(device.notices)
    assert device.commands.req_did() == device.commands.req_did()
    assert device.link.clock() - began < 0.5
    assert heard.mids == [MessageId.DeviceID] * 2
    assert device.stats.messages == before, "the answers are not decided yet"
    # What follows shows that the half is damage. The answers behind it are not handed out again.
    device.link.acquisition.push(TREACHEROUS * 20, device.link.clock())
    assert device.read_sample(0).frame == TREACHEROUS
    device.listen(0)
    assert heard.mids == [MessageId.DeviceID] * 2
    assert heard.damaged == device.stats.skipped_bytes == len(half)
    assert device.stats.messages == before + 2
    assert list(device.notices) == notices


# Faults during every command

REQUESTS = [
    row for row in MESSAGES.values()
    if row.direction == "to device" and row.reply is not None
    if 680 in row.products and "config" in row.states
]  # fmt: skip
#: Requests whose reply has a known length, so that a wrong length can be sent.
MEASURED = [
    request
    for request in REQUESTS
    if all(row.lengths for row in MESSAGES.values() if row.mid == request.reply)
]


def value_for(name: str, device: Device) -> Any:
    """Returns a valid value; for a setting the current value of the device."""
    values = {
        "SetOptionFlags": xbus.protocol.OptionFlags(), "SetBaudrate": 2, "SetInitialHeading": 0.0,
        "SetFilterProfileModern": "General_RTK", "ReqAlignmentRotation": 0, "ReqEmts": b"\0\xff",
        "SetUTCTime": xbus.protocol.UtcTime(0, 2026, 1, 1, 0, 0, 0), "AdjustUTCTime": 0,
        "ResetOrientation": 0, "IccCommand": 2,
        "SetAlignmentRotation": xbus.protocol.AlignmentRotation(0, (1, 0, 0, 0)),
    }  # fmt: skip
    if name in values or not name.startswith("Set"):
        return values.get(name)
    return device.command(f"Req{name[3:]}").value


def identified(**settings: Any) -> tuple[Device, AlteredDevice]:
    device, sim = opened("MTi-680G", **settings)
    with device.configure():
        pass
    return device, sim


def works_again(device: Device) -> None:
    """Asserts that the state is known or can be found, and that the next command is answered."""
    device.go_to_config()
    assert device.state == State.CONFIG
    assert device.commands.req_did() == device.device_id


@pytest.mark.parametrize("row", REQUESTS, ids=lambda row: row.name)
def test_no_answer(row: xbus.protocol.tables.MessageRow) -> None:
    device, sim = identified()
    value = value_for(row.name, device)
    sim.alter = lambda _: b""
    with pytest.raises(XbusTimeout, match=row.name) as caught:
        device.command(row.name, value)
    assert caught.value.command == row.name
    sim.alter = lambda data: data
    works_again(device)


@pytest.mark.parametrize("row", REQUESTS, ids=lambda row: row.name)
def test_ctrl_c(row: xbus.protocol.tables.MessageRow) -> None:
    device, sim = identified()
    value = value_for(row.name, device)

    def interrupt(_: bytes) -> bytes:
        sim.alter = lambda data: data
        raise KeyboardInterrupt

    sim.alter = interrupt
    with pytest.raises(KeyboardInterrupt):
        device.command(row.name, value)
    works_again(device)


def test_ctrl_c_inside_configure_restores_the_state() -> None:
    device, sim = opened(state=State.MEASUREMENT)

    def interrupt(data: bytes) -> bytes:
        if sim.written[-1][2] == MessageId.ReqOptionFlags:
            raise KeyboardInterrupt
        return data

    sim.alter = interrupt
    with pytest.raises(KeyboardInterrupt), device.configure():
        device.commands.req_option_flags()
    assert device.state == sim.state == State.MEASUREMENT


@pytest.mark.parametrize("row", REQUESTS, ids=lambda row: row.name)
def test_an_unplugged_device_raises(row: xbus.protocol.tables.MessageRow) -> None:
    device, sim = identified()
    value = value_for(row.name, device)

    def pull(_: bytes) -> bytes:
        sim.unplug()
        return b""

    sim.alter = pull
    with pytest.raises(Disconnected, match=f"was lost during {row.name}:") as caught:
        device.command(row.name, value)
    assert caught.value.command == row.name
    assert device.state == State.UNKNOWN
    sim.alter = lambda data: data
    with pytest.raises(Disconnected):
        device.commands.req_did()
    sim.plug()
    works_again(device)


@pytest.mark.parametrize("row", REQUESTS, ids=lambda row: row.name)
def test_error_replies(row: xbus.protocol.tables.MessageRow) -> None:
    device, sim = identified()
    value = value_for(row.name, device)
    sim.alter = lambda data: encode_frame(0x42, b"\x21") if data else b""
    with pytest.raises(DeviceError, match=row.name) as caught:
        device.command(row.name, value)
    assert (caught.value.code, caught.value.command) == (0x21, row.name)
    sim.alter = lambda data: data
    works_again(device)


@pytest.mark.parametrize("row", MEASURED, ids=lambda row: row.name)
def test_an_answer_of_the_wrong_length(row: xbus.protocol.tables.MessageRow) -> None:
    device, sim = identified()
    value = value_for(row.name, device)
    rows = [reply for reply in MESSAGES.values() if reply.mid == row.reply]
    wrong = next(n for n in range(300) if not any(n in (row.lengths or ()) for row in rows))
    assert row.reply is not None
    frame = encode_frame(row.reply, bytes(wrong))
    sim.alter = lambda data: frame if data else b""
    with pytest.raises(DecodeError, match=row.name) as caught:
        device.command(row.name, value)
    assert caught.value.command == row.name
    sim.alter = lambda data: data
    works_again(device)


@pytest.mark.parametrize("row", MEASURED, ids=lambda row: row.name)
def test_garbage_before_the_answer(row: xbus.protocol.tables.MessageRow) -> None:
    """A header that claims too many bytes delays the reply at most until the device is silent."""
    device, sim = identified()
    value = value_for(row.name, device)
    sim.alter = lambda data: b"\x00\xfa\xff\x36\x80\xfa\xfa" + data if data else b""
    device.command(row.name, value)
    sim.alter = lambda data: data
    works_again(device)


# Baud rate, reset, restore


@pytest.mark.parametrize("product", ["MTi-3", "MTi-300", "MTi-630", "MTi-680G"])
def test_set_baudrate_follows_the_device(product: str) -> None:
    sim = SimulatedDevice(product, baudrate=115_200)
    device = connect(sim)
    with device.configure() as cfg:
        cfg.set_baudrate(921_600)
        assert (sim.baudrate, cfg.link.baudrate, cfg.state) == (921_600, 921_600, State.CONFIG)
        assert cfg.commands.req_did() == cfg.device_id
    assert sim.state == State.MEASUREMENT
    assert len(device.read_sample()) > 0
    sim.power_cycle()
    assert connect(sim).link.baudrate == 921_600


@pytest.mark.parametrize("product", ["MTi-3", "MTi-300", "MTi-630", "MTi"])
def test_factory_settings_at_the_factory_baud_rate(product: str) -> None:
    sim = SimulatedDevice(product, baudrate=460_800)
    device = connect(sim)
    factory = connect(product_port := SimulatedDevice(product, baudrate=115_200)).settings()
    with device.configure() as cfg:
        cfg.commands.set_location_id(7)
        cfg.restore_factory_settings()
        assert (sim.baudrate, cfg.link.baudrate, cfg.state) == (115_200, 115_200, State.CONFIG)
        assert cfg.settings() == factory
    assert sim.state == State.MEASUREMENT == product_port.state


def test_unsupported_baud_rates_are_rejected() -> None:
    device, sim = opened("MTi-300")
    with device.configure() as cfg:
        sim.written.clear()
        with pytest.raises(ValueError, match="does not support 4000000 baud"):
            cfg.set_baudrate(4_000_000)
        with pytest.raises(ValueError, match="no device talks at 12,345 baud"):
            cfg.set_baudrate(12_345)
        assert sim.written == []


def test_reset_to_config() -> None:
    device, sim = opened()
    device.reset(config=True)
    assert device.state == sim.state == State.CONFIG


def test_restore_communication() -> None:
    """Section 7.2: the baud rate of the device is unknown."""
    sim = SimulatedDevice("MTi-300", baudrate=38_400)
    with connect(sim, 38_400) as device, device.configure() as cfg:
        cfg.set_output_configuration({"acceleration": 10})

    class Plugged(SimLink):
        """A link whose device is plugged in after a while."""

        written = 0

        def write(self, data: bytes) -> None:
            self.written += 1
            if self.written == 100:
                self.device.power_cycle()
            super().write(data)

    link = Plugged(sim)
    device = Device(link)
    device.restore_communication()
    assert (link.baudrate, sim.baudrate, device.state) == (115_200, 115_200, State.CONFIG)
    assert device.commands.req_output_configuration() == support("MTi-300").output_configuration


def test_restore_communication_without_a_device() -> None:
    device, _ = opened()
    with pytest.raises(XbusTimeout, match=r"no device woke up within 0\.5 s"):
        device.restore_communication(0.5)


def test_option_flags_with_names() -> None:
    device, _ = opened("MTi-3")
    device.commands.set_option_flags(OptionFlag.ENABLE_AHS | OptionFlag.DISABLE_AUTO_STORE)
    device.commands.set_option_flags(clear=OptionFlag.ENABLE_AHS)
    assert device.commands.req_option_flags() == OptionFlag.DISABLE_AUTO_STORE
