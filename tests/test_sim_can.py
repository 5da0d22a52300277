"""The virtual MTi-600 on CAN, seen by python-can, cantools with our DBC file, and our own readers."""

from __future__ import annotations

import os
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

import xbus
from xbus.can import EXTENDED, CanLog, can_message
from xbus.can.dbc import dbc_text
from xbus.protocol.can import CAN_MESSAGES
from xbus.sim.can_stream import CanFrame, deltav_exponent

can = pytest.importorskip("can")
cantools = pytest.importorskip("cantools.database")

STAMPS: dict[Any, int | None] = {"sample_time_fine": None, "packet_counter": None}
RATES = {
    "quaternion": 100, "euler_angles": 100, "delta_v": 100, "rate_of_turn": 100, "delta_q": 100,
    "acceleration": 100, "free_acceleration": 100, "magnetic_field": 100, "temperature": 100,
    "lat_lon": 100, "altitude_ellipsoid": 100, "velocity_xyz": 100, "position_ecef": 100,
}  # fmt: skip


def configured(
    outputs: dict[Any, int | None],
    *,
    seconds: float = 1.0,
    baudrate: int = 1_000_000,
    ids: Any = None,
    serial: dict[Any, int | None] | None = None,
    **options: Any,
) -> tuple[list[CanFrame], list[bytes]]:
    """The frames and the bytes that a device sends within some seconds."""
    frames: list[CanFrame] = []
    product = options.pop("product", "MTi-680G")
    device = xbus.SimulatedDevice(product, can=frames.extend, time_to_fix=0.0, **options)
    with xbus.connect(device) as host:
        with host.configure() as cfg:
            cfg.set_output_configuration(serial or {"acceleration": 100}, check_baudrate=False)
            cfg.set_can_output_configuration(outputs, baudrate=baudrate, ids=ids)
        host.reset(config=True)  # the bit rate takes effect
        frames.clear()
        host.go_to_measurement()
        host.discard()
        sent = []
        until = device.time + seconds
        while device.time < until:
            host.listen(0.1)
            while host.stats.unread_samples:
                sent.append(host.read_sample().frame)
    return frames, sent


def log_of(frames: Sequence[CanFrame], ids: Any = None) -> CanLog:
    messages = [
        can.Message(frame.time, frame.can_id, is_extended_id=frame.extended, data=frame.data)
        for frame in frames
    ]
    return xbus.read_can(messages, ids)


@pytest.mark.parametrize("names", [list(RATES)[:7], list(RATES)[7:-1], ["position_ecef"]])
def test_cantools_sees_the_trajectory_within_half_a_digit(names: list[str]) -> None:
    """Xbus sends the same instants as Float64."""
    serial: dict[Any, int | None] = STAMPS | {(name, "Float64"): 100 for name in names}
    frames, sent = configured(STAMPS | dict.fromkeys(names, 100), serial=serial, trajectory="fly")
    log = xbus.read_log(b"".join(sent))
    database = cantools.load_string(dbc_text(), "dbc")
    rows = {tick: row for row, tick in enumerate(log["sample_time_fine"].values.tolist())}
    tick, compared = -1, dict.fromkeys(names, 0)
    for frame in frames:
        row = CAN_MESSAGES[frame.can_id]
        values: Any = database.decode_message(frame.can_id, frame.data, decode_choices=False)
        if row.name == "SampleTime":
            tick = round(values["ticks"] * 10_000)
        if row.quantity not in names or tick not in rows:
            continue
        column = log[row.quantity]
        true = np.atleast_1d(column.values[rows[tick]])
        if row.kind == "component":
            true = true[["XYZ".index(row.name[-1])]]
        if row.kind == "scaled":
            assert values.pop("exponent") == 15
            units = [2.0**-15] * 3
        else:
            units = [1 / signal.per_unit for signal in row.signals]
        for value, expected, unit in zip(values.values(), true.tolist(), units, strict=True):
            assert abs(value - expected) <= unit * 0.5000001
        compared[row.quantity] += 1
    assert min(compared.values()) > 80


def test_the_pressure_has_fractions_of_a_pascal() -> None:
    log = log_of(configured(STAMPS | {"baro_pressure": 50}, trajectory="fly")[0])
    values = log["baro_pressure"].values
    assert np.ptp(values % 1) > 0.1
    assert np.all((values > 90_000) & (values < 110_000))


def test_groups_have_rising_identifiers_and_rates() -> None:
    rates: dict[Any, int | None] = {
        "quaternion": 100,
        "acceleration": 200,
        "lat_lon": 50,
        "temperature": 1,
    }
    frames, _ = configured(STAMPS | {"status_word": None} | rates)
    log = log_of(frames)
    assert log.traffic.findings == ()
    assert log.stats.lost_samples == 0
    assert np.diff(log.packet_counter).tolist() == [1] * (len(log) - 1)
    np.testing.assert_allclose(np.diff(log.time), 0.005, atol=1e-9)
    np.testing.assert_allclose(np.diff(log["lat_lon"].time), 0.02, atol=1e-9)
    starts = [at for at, frame in enumerate(frames) if frame.can_id == 0x05]
    for start, end in pairwise(starts):
        ids = [frame.can_id for frame in frames[start:end]]
        assert ids == sorted(ids)
        assert ids[:3] == [0x05, 0x06, 0x11]
    assert all(a.time < b.time for a, b in pairwise(frames))


def test_utc_and_position_only_with_a_fix() -> None:
    frames: list[CanFrame] = []
    device = xbus.SimulatedDevice(
        "MTi-670", can=frames.extend, time_to_fix=2.0, utc=np.datetime64("2026-11-28T12:00")
    )
    with xbus.connect(device) as host:
        with host.configure() as cfg:
            cfg.set_can_output_configuration(
                STAMPS | {"UtcTime": None, "lat_lon": 50, "GnssReceiverStatus": 4}
            )
        host.listen(3)
    log = log_of(frames)
    no_fix = log.time < 2.0
    assert 0 < np.count_nonzero(no_fix) < len(log)
    for name in ("utc_time", "lat_lon"):
        assert np.all(log.time[log[name].sample] >= 2.0)
    assert len(log["utc_time"]) == np.count_nonzero(~no_fix)
    assert log.utc[-1] == np.datetime64("2026-11-28T12:00", "ns") + round(log.time[-1] * 1e9)
    fix = log["gnss_receiver_status"]["fixtype"]
    assert (fix[0], fix[-1]) == (0, 3)


@pytest.mark.parametrize("rate", [400, 200, 100, 50, 10, 1])
def test_the_exponent_of_delta_v_follows_its_rate(rate: int) -> None:
    frames, _ = configured({"delta_v": rate}, trajectory="still")
    assert {frame.data[-1] for frame in frames} == {deltav_exponent(rate)}
    found = log_of(frames)["delta_v"].values
    np.testing.assert_allclose(found[:, 2], 9.81 / rate, rtol=0.01)


def test_every_rate_of_the_document_has_its_exponent() -> None:
    rates = (400, 200, 100, 80, 50, 40, 25, 20, 16, 10, 8, 5, 4, 2, 1)
    exponents = [17, 16, 15, 14, 14, 13, 13, 12, 12, 11, 11, 10, 10, 9, 8]
    assert list(map(deltav_exponent, rates)) == exponents


def test_a_full_bus_drops_the_rest_of_the_group() -> None:
    """At 250 kbit/s and 400 Hz, four frames of eight bytes fit, and five do not."""
    four = ["quaternion", "delta_q", "lat_lon", "gnss_receiver_dop"]
    with pytest.raises(ValueError, match="of a CAN bus"):
        configured(dict.fromkeys([*four, "UtcTime"], 400), baudrate=250_000)
    frames: list[CanFrame] = []
    device = xbus.SimulatedDevice("MTi-680G", can=frames.extend, time_to_fix=0.0)
    with xbus.connect(device) as host:
        with host.configure() as cfg:
            for names in (four, [*four, "UtcTime"]):
                outputs = cfg.set_can_output_configuration(
                    dict.fromkeys(names, 400), baudrate=1_000_000
                )
            cfg.commands.set_can_output_config(outputs)
            cfg.commands.set_can_config(xbus.protocol.CanConfig(0, enabled=True))
            del frames[:]
        host.reset()
        host.listen(2)
    ids = [frame.can_id for frame in frames]
    assert ids[:5] == [0x07, 0x21, 0x33, 0x71, 0x01]
    assert ids.count(0x01) == ids.count(0x21) > 100
    log = log_of(frames)
    assert "gnss_receiver_dop" not in log
    assert "reports" in "\n".join(log.traffic.findings)
    assert {code for *_, code in log.traffic.events.tolist()} == {1}


def test_identifiers_of_29_bits_and_several_devices() -> None:
    ids = {"sample_time_fine": EXTENDED | 0x11, "packet_counter": 0x12, "quaternion": 0x1ABCDEF}
    outputs: dict[Any, int | None] = STAMPS | {"quaternion": 100}
    frames, _ = configured(outputs, ids=ids)
    assert {(frame.can_id, frame.extended) for frame in frames} == {
        (0x11, True), (0x12, False), (0x1ABCDEF, True)
    }  # fmt: skip
    log = log_of(frames, ids)
    assert log.traffic.findings == ()
    assert len(log["quaternion"]) == len(log) > 80
    # The bus sends 0x11 with 29 bits first: its first eleven bits are zero.
    assert frames[0].extended


def test_the_number_of_calls_has_no_effect() -> None:
    found = []
    for step in (0.0173, 1.0):
        frames: list[CanFrame] = []
        device = xbus.SimulatedDevice("MTi-680G", can=frames.extend, noise=1.0)
        with xbus.connect(device) as host, host.configure() as cfg:
            cfg.set_can_output_configuration(
                STAMPS | dict.fromkeys([*RATES][:12], 100), baudrate=1_000_000
            )
        until = device.time + 1.5
        while device.time < until:
            device.advance(min(step, until - device.time))
        found.append(frames)
    assert found[0] == found[1]


def test_can_is_off_until_it_is_configured() -> None:
    frames: list[CanFrame] = []
    device = xbus.SimulatedDevice("MTi-630", can=frames.extend)
    device.advance(2)
    assert frames == []
    with pytest.raises(ValueError, match="the MTi-30 has no CAN; only MTi-600 devices have"):
        xbus.SimulatedDevice("MTi-30", can=frames.extend)
    with pytest.raises(ValueError, match="python-can has no interface 'none'"):
        xbus.SimulatedDevice("MTi-630", can="none:1")


#: A group of this process, because other tests may run beside it.
GROUP = f"239.74.{os.getpid() >> 8 & 0xFF}.{os.getpid() & 0xFF}"


@pytest.mark.parametrize(
    ("interface", "channel"),
    [("virtual", "bus600"), ("udp_multicast", GROUP)],
    ids=["virtual", "udp_multicast"],
)
def test_a_device_on_a_bus_of_python_can(interface: str, channel: str) -> None:
    """Configured over its serial port, and read live on the bus."""
    try:
        other = can.Bus(interface=interface, channel=channel)
    except OSError as error:
        pytest.skip(f"no multicast here: {error}")
    with (
        other,
        xbus.connect(f"sim:MTi-680G?can={interface}:{channel}&time_to_fix=0") as serial,
        xbus.connect(f"can:{interface}:{channel}", listen=True) as live,
    ):
        with serial.configure() as cfg:
            cfg.set_can_output_configuration(STAMPS | {"acceleration": 100, "quaternion": 100})
        serial.listen(0.5)
        samples = [live.read_sample() for _ in range(40)]
        assert [sample["packet_counter"] for sample in samples] == list(range(40))
        message = other.recv(1)
        assert message.arbitration_id == 0x05
        assert can_message("SampleTime").decode(message.data)["ticks"] == samples[0].time
        assert live.stats.lost_samples == 0
        assert live.findings == ()
