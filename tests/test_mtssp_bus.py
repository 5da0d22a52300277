"""Devices on I²C and SPI: virtual buses, the host, the link, and what goes wrong."""

from __future__ import annotations

import errno
import gc
import os
import re
import sys
import tempfile
import threading
from collections.abc import Callable
from itertools import islice
from pathlib import Path
from typing import Any
from unittest.mock import create_autospec

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st

import xbus
from xbus import Device, Disconnected, MessageId, SimulatedDevice, encode_frame
from xbus.cli import main
from xbus.device.bus_link import BusLink
from xbus.device.bus_port import open_bus_port, parse_bus_port
from xbus.device.pins import GpioDataReady, GpioReset
from xbus.errors import BusError
from xbus.mtssp import (
    DataReady,
    FtdiI2cBus,
    FtdiSpiBus,
    Opcode,
    PipeStatus,
    i2c_request,
    reduce,
)
from xbus.protocol import State
from xbus.protocol.products import find_product, support
from xbus.protocol.tables import PRODUCTS, QUANTITIES
from xbus.sim import BusFaults, I2cMessage, SimI2c, SimSpi
from xbus.sim.bus_link import BusSimLink, host_bus
from xbus.sim.module import PIPE_BYTES

smbus2 = pytest.importorskip("smbus2")
i2c_msg = smbus2.i2c_msg

ADDRESS = 0x6B
WAKE_UP, GO_TO_CONFIG, GO_TO_CONFIG_ACK = (bytes.fromhex(h) for h in ("3E00C3", "3000D1", "3100D0"))
OVERFLOW = bytes.fromhex("42012995")
#: Quantities that differ from wire to wire, because the measurement begins a little later.
TIMED = ("sample_time_fine", "sample_time_coarse", "utc_time", "temperature")
#: Groups that come with every message.
EVERY_GROUPS = ("Timestamp", "Status")
ONE_SERIES = [row.name for row in PRODUCTS.values() if row.series == "1-series"]


def i2c_read(bus: SimI2c, opcode: int, size: int) -> bytes:
    """Reads as a program with smbus2 does."""
    reply = i2c_msg.read(ADDRESS, size)
    bus.i2c_rdwr(i2c_msg.write(ADDRESS, [opcode]), reply)
    return bytes(reply)


def i2c_write(bus: SimI2c, opcode: int, data: bytes) -> None:
    bus.i2c_rdwr(i2c_msg.write(ADDRESS, i2c_request(opcode, data)))


def awake(product: str = "MTi-3", **options: Any) -> SimI2c:
    """A bus with a device whose WakeUp has been read."""
    bus = SimI2c(product, **options)
    bus.device.advance(0.1)
    assert i2c_read(bus, Opcode.NOTIFICATION_PIPE, 3) == WAKE_UP
    return bus


def status(bus: SimI2c) -> PipeStatus:
    return PipeStatus.parse(i2c_read(bus, Opcode.PIPE_STATUS, 4))


# The virtual module


def test_a_session_byte_by_byte() -> None:
    bus = SimI2c("MTi-3")
    bus.device.advance(0.1)
    assert i2c_read(bus, 0x04, 4) == bytes.fromhex("03000000")
    assert i2c_read(bus, 0x05, 3) == WAKE_UP
    assert status(bus) == (0, 0)
    i2c_write(bus, 0x03, GO_TO_CONFIG)
    assert i2c_read(bus, 0x04, 4) == bytes.fromhex("03000000")
    assert i2c_read(bus, 0x05, 3) == GO_TO_CONFIG_ACK
    i2c_write(bus, 0x03, reduce(encode_frame(MessageId.GoToMeasurement)))
    bus.device.advance(0.015)
    assert status(bus).notification == 3
    size = status(bus).measurement
    sample = i2c_read(bus, 0x06, size)
    assert "packet_counter" in xbus.read_log(b"\xfa\xff" + sample)


def test_a_session_on_spi_byte_by_byte() -> None:
    spi = SimSpi("MTi-3")
    spi.mode, spi.max_speed_hz = 3, 2_000_000
    spi.device.advance(0.1)
    assert bytes(spi.xfer2([4, 255, 255, 255, 0, 0, 0, 0])) == bytes.fromhex("FAFFFFFF03000000")
    assert bytes(spi.xfer2([5, 0, 1, 2, 0, 0, 0])) == bytes.fromhex("FAFFFFFF") + WAKE_UP
    received = spi.xfer2([3, 255, 255, 255, *GO_TO_CONFIG])
    assert bytes(received[:4]) == bytes.fromhex("FAFFFFFF")
    assert bytes(spi.xfer2([5, 0, 0, 0, 0, 0, 0])[4:]) == GO_TO_CONFIG_ACK
    # A frame as it is: the preamble is no opcode, and nothing is understood.
    assert bytes(spi.xfer2(list(bytes.fromhex("FAFF3000D1")))) == bytes.fromhex("FAFFFFFF00")
    assert spi.xfer2([4, 0, 0, 0, 0, 0, 0, 0])[4:] == [0, 0, 0, 0]


def test_opcode_and_read_in_two_transfers() -> None:
    bus = awake()
    bus.i2c_rdwr(i2c_msg.write(ADDRESS, [0x01]))
    reply = i2c_msg.read(ADDRESS, 2)
    bus.i2c_rdwr(reply)
    assert bytes(reply) == b"\x01\x0c"


def test_reading_too_much_begins_the_message_again() -> None:
    bus = SimI2c("MTi-3")
    bus.device.advance(0.1)
    assert i2c_read(bus, 0x05, 8) == (3 * WAKE_UP)[:8]
    assert status(bus) == (0, 0)


def test_a_message_that_is_not_read_to_its_end_stays() -> None:
    bus = SimI2c("MTi-3")
    bus.device.advance(0.1)
    assert i2c_read(bus, 0x05, 2) == WAKE_UP[:2]
    assert status(bus).notification == 3


def test_empty_pipes_and_unknown_opcodes_read_zeros() -> None:
    bus = awake()
    assert i2c_read(bus, 0x06, 4) == i2c_read(bus, 0x77, 4) == bytes(4)


def test_the_input_takes_512_bytes() -> None:
    bus = awake("MTi-7")
    fits = reduce(encode_frame(0x30, bytes(512 - 5)))  # with the long header
    assert len(fits) == 512
    # A longer message resets the buffer: only the bytes beyond 512 are left.
    i2c_write(bus, 0x03, bytes(512) + GO_TO_CONFIG)
    assert i2c_read(bus, 0x05, 3) == GO_TO_CONFIG_ACK
    i2c_write(bus, 0x03, bytes(1024) + GO_TO_CONFIG)
    assert i2c_read(bus, 0x05, 3) == GO_TO_CONFIG_ACK
    i2c_write(bus, 0x03, bytes(509) + GO_TO_CONFIG)
    assert status(bus) == (0, 0)


def test_a_full_pipe_drops_the_newest() -> None:
    bus = awake()
    bus.device.advance(10)
    counters = []
    errors = 0
    while any(sizes := status(bus)):
        if sizes.notification:
            errors += i2c_read(bus, 0x05, sizes.notification) == OVERFLOW
        if sizes.measurement:
            sample = i2c_read(bus, 0x06, sizes.measurement)
            counters.append(int(xbus.read_log(b"\xfa\xff" + sample)["packet_counter"].values[0]))
    assert errors == 1
    kept = PIPE_BYTES // len(sample)
    assert counters[:kept] == list(range(counters[0], counters[0] + kept))
    assert counters[kept] > counters[kept - 1] + 1


@pytest.mark.parametrize(
    ("configuration", "levels"),
    [
        (DataReady.NOTIFICATIONS | DataReady.MEASUREMENTS, (False, True, True)),
        (DataReady.NOTIFICATIONS, (False, True, False)),
        (DataReady.MEASUREMENTS | DataReady.IDLE_HIGH, (True, True, False)),
        (DataReady(0), (False, False, False)),
    ],
)
def test_data_ready(configuration: DataReady, levels: tuple[bool, bool, bool]) -> None:
    """The level while the pipes are empty, with a notification, and with a measurement."""
    bus = awake()
    i2c_write(bus, 0x02, bytes([configuration]))
    assert i2c_read(bus, 0x01, 2)[1] == configuration
    i2c_write(bus, 0x03, GO_TO_CONFIG)
    notified = bus.drdy
    assert i2c_read(bus, 0x05, 3) == GO_TO_CONFIG_ACK
    idle = bus.drdy
    i2c_write(bus, 0x03, reduce(encode_frame(MessageId.GoToMeasurement)))
    i2c_read(bus, 0x05, 3)
    bus.device.advance(0.1)
    assert (idle, notified, bus.drdy) == levels


def test_a_reset_clears_pipes_and_configuration() -> None:
    bus = awake()
    i2c_write(bus, 0x02, b"\x01")
    i2c_write(bus, 0x03, GO_TO_CONFIG)
    bus.reset()
    with pytest.raises(OSError) as caught:  # it starts
        status(bus)
    assert caught.value.errno == errno.EREMOTEIO
    bus.device.advance(0.1)
    assert status(bus) == (3, 0)
    assert i2c_read(bus, 0x05, 3) == WAKE_UP
    assert i2c_read(bus, 0x01, 2)[1] == 0x0C


def test_transfers_take_time() -> None:
    bus = awake(frequency=400_000)
    before = bus.device.time
    status(bus)
    assert bus.device.time - before == pytest.approx(66 / 400_000)
    spi = SimSpi("MTi-3")
    spi.max_speed_hz = 1_000_000
    spi.xfer2([4] + [0] * 7)
    assert spi.device.time == pytest.approx(64 / 1_000_000)


@pytest.mark.parametrize("change", [{"mode": 0}, {"max_speed_hz": 4_000_000}, {"lsbfirst": True}])
def test_spi_that_is_set_wrong_reads_ff(change: dict[str, Any]) -> None:
    spi = SimSpi("MTi-3")
    spi.mode = 3
    spi.device.advance(0.1)
    for name, value in change.items():
        setattr(spi, name, value)
    assert spi.xfer2([4] + [0] * 7) == [0xFF] * 8


def test_limits_of_the_kernel() -> None:
    with pytest.raises(OSError, match="Invalid argument"):
        i2c_read(awake(), 0x06, 8193)
    with pytest.raises(OverflowError):
        SimSpi("MTi-3").xfer2([4] * 4097)
    bus = awake()
    bus.close()
    with pytest.raises(OSError, match="Bad file descriptor"):
        status(bus)


def test_another_address_does_not_answer() -> None:
    bus = SimI2c("MTi-3", address=0x1D)
    bus.device.advance(0.1)
    with pytest.raises(OSError) as caught:
        status(bus)
    assert caught.value.errno == errno.EREMOTEIO


def test_only_the_1_series_without_a_line() -> None:
    with pytest.raises(
        ValueError, match="the MTi-630 has neither I²C nor SPI; MTi-1, MTi-2, MTi-3, MTi-7 have"
    ):
        SimI2c("MTi-630")
    with pytest.raises(ValueError, match="has no baud rate, and other faults: BusFaults"):
        SimSpi(SimulatedDevice("MTi-3", baudrate=115_200))


@pytest.mark.parametrize(
    ("texts", "message"),
    [
        (["nack=2"], "nack is a probability, from 0 to 1, not 2.0"),
        (["nack=x"], "'nack=x' is not a fault of a bus: use nack=P, timeout=P"),
        (["burst=1"], "'burst=1' is not a fault of a bus"),
        (["absent=-1"], "the times of absent must be 0 seconds or more"),
        (["stuck=100"], "stuck is a byte"),
        (["flip=0", "flip=0"], "flip is given twice"),
    ],
)
def test_faults_that_do_not_exist(texts: list[str], message: str) -> None:
    with pytest.raises(ValueError, match=re.escape(message)):
        BusFaults.parse(texts)


# The same results on every wire


def wires(product: str) -> list[Any]:
    """Equal devices: on a line, on I²C whose transfers take no time, and on both buses."""
    sims = [SimulatedDevice(product, trajectory="still", time_to_fix=0) for _ in range(4)]
    return [sims[0], SimI2c(sims[1], frequency=None), SimI2c(sims[2]), SimSpi(sims[3])]


@st.composite
def configurations(draw: st.DrawFn) -> tuple[str, dict[str, Any], dict[str, Any]]:
    """A product, outputs and settings."""
    product = find_product(draw(st.sampled_from(ONE_SERIES)))
    names = sorted(
        row.name
        for row in QUANTITIES.values()
        if product.number in row.products and row.name not in TIMED and row.group != "GNSS"
    )
    chosen = draw(st.lists(st.sampled_from(names), min_size=1, max_size=6, unique=True))
    changes = {
        "SetLocationID": draw(st.integers(0, 0xFFFF)),
        "SetTransmitDelay": draw(st.integers(590, 0xFFFF)),
        "SetErrorMode": draw(st.integers(0, 3)),
    }
    known = support(product).messages
    changes = {name: value for name, value in changes.items() if name in known}
    outputs = {name: None if QUANTITIES[name].group in EVERY_GROUPS else 50 for name in chosen}
    return product.name, {"packet_counter": None} | outputs, changes


@settings(max_examples=6, deadline=None)
@given(configurations())
def test_results_are_those_of_a_serial_line(
    configuration: tuple[str, dict[str, Any], dict[str, Any]],
) -> None:
    product, outputs, changes = configuration
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "recording.mtb"
        (answers, first), *others = [
            measured(port, outputs, changes, path) for port in wires(product)
        ]
    for found, log in others:
        assert found == answers
        assert set(log) == set(first)  # which of several messages is the first depends on the time
        assert len(log.damage) == 0
        for name in set(first):
            count = min(len(log[name]), len(first[name]))
            assert count >= 1
            np.testing.assert_array_equal(log[name].values[:count], first[name].values[:count])


def measured(
    port: Any, outputs: dict[str, Any], changes: dict[str, Any], path: Path
) -> tuple[list[Any], xbus.Log]:
    """Configures a device and records it. Returns all answers, and the log."""
    with xbus.connect(port) as device:
        with device.configure(outputs, check_baudrate=False) as cfg:
            answers: list[Any] = [cfg.command(name, value).value for name, value in changes.items()]
            answers += [cfg.device_id, cfg.product_code, cfg.firmware]
            answers.append(cfg.commands.run_selftest())
        answers.append(device.settings())
        recording = device.record(path, overwrite=True)
        assert len(list(islice(device, 20))) == 20
        recording.stop()
        stats = device.stats
        assert (stats.lost_samples, stats.skipped_bytes, stats.overruns or 0) == (0, 0, 0)
    return answers, xbus.read_log(path)


# Losses and faults


@pytest.mark.parametrize("bus", ["i2c", "spi"])
def test_a_pause_of_the_host_is_counted(bus: str) -> None:
    device = measuring(bus)
    list(islice(device, 10))
    before = device.stats
    assert (before.overruns, before.lost_samples) == (0, 0)
    device.link.device.advance(10)  # type: ignore[attr-defined]
    counters = [int(sample["packet_counter"]) for sample in islice(device, 200)]
    stats = device.stats
    assert stats.overruns == 1
    assert stats.lost_samples > 800
    assert counters[-1] - counters[0] + 1 == len(counters) + stats.lost_samples
    assert stats.last_error == "Error 41: more data than the baud rate can carry"


def measuring(bus: str, product: str = "MTi-3") -> xbus.Device:
    device = xbus.connect(f"sim:{product}?bus={bus}")
    with device.configure({"packet_counter": None, "acceleration": 100}):
        pass
    return device


def faulty(device: xbus.Device, faults: BusFaults) -> None:
    device.link._bus._bus.faults = faults  # type: ignore[attr-defined]


def faulty_spi(device: xbus.Device, faults: BusFaults) -> None:
    device.link._bus._spi.faults = faults  # type: ignore[attr-defined]


FAULTY: dict[str, Callable[[xbus.Device, BusFaults], None]] = {"i2c": faulty, "spi": faulty_spi}


@pytest.mark.parametrize("bus", ["i2c", "spi"])
@pytest.mark.parametrize("fault", ["nack", "timeout", "garbage"])
def test_transfers_that_fail_are_repeated(bus: str, fault: str) -> None:
    """Nothing is lost: what was not read stays in the device."""
    if (bus, fault) == ("spi", "timeout"):
        pytest.skip("SPI has no clock stretching")
    device = measuring(bus)
    failed = device.stats.transfer_errors
    chance = 0.02 if fault == "timeout" else 0.2  # a timeout takes the time of three samples
    FAULTY[bus](device, BusFaults(**{fault: chance}, seed=1))  # type: ignore[arg-type]
    assert len(list(islice(device, 100))) == 100
    with device.configure() as cfg:
        assert cfg.commands.req_did() == cfg.device_id
    stats = device.stats
    assert (stats.lost_samples, stats.skipped_bytes, stats.overruns) == (0, 0, 0)
    assert stats.transfer_errors is not None
    assert stats.transfer_errors > (failed or 0)


@pytest.mark.parametrize("bus", ["i2c", "spi"])
@pytest.mark.parametrize("fault", ["short", "flip", "drop"])
def test_damage_is_counted_and_ends(bus: str, fault: str) -> None:
    device = measuring(bus)
    chance = {"short": 0.1, "flip": 2e-4, "drop": 0.1}[fault]
    FAULTY[bus](device, BusFaults(**{fault: chance}, seed=2))  # type: ignore[arg-type]
    samples = list(islice(device, 300))
    FAULTY[bus](device, BusFaults())
    samples += islice(device, 20)
    stats = device.stats
    counters = [int(sample["packet_counter"]) for sample in samples]
    assert counters[-1] - counters[0] + 1 == len(counters) + stats.lost_samples
    if fault == "drop":
        assert stats.lost_samples > 10
    else:
        assert stats.checksum_errors > 0
        assert stats.skipped_bytes > 0
    if fault == "short":
        assert stats.lost_samples == 0  # the message was read again
    before = stats
    list(islice(device, 50))
    assert device.stats.skipped_bytes == before.skipped_bytes
    assert device.stats.lost_samples == before.lost_samples


@given(
    faults=st.builds(
        BusFaults,
        nack=st.floats(0, 0.3),
        timeout=st.floats(0, 0.1),
        short=st.floats(0, 0.3),
        garbage=st.floats(0, 0.3),
        flip=st.floats(0, 0.01),
        drop=st.floats(0, 0.3),
        seed=st.integers(0, 1000),
    ),
    bus=st.sampled_from(["i2c", "spi"]),
)
@settings(max_examples=10, deadline=None)
def test_no_fault_stops_the_link_or_makes_a_wrong_sample(faults: BusFaults, bus: str) -> None:
    device = measuring(bus)
    FAULTY[bus](device, faults)
    device.listen(1.0)
    FAULTY[bus](device, BusFaults())
    device.listen(0.5)
    before = device.stats
    assert len(list(islice(device, before.unread_samples + 20))) == before.unread_samples + 20
    assert device.stats.skipped_bytes == before.skipped_bytes
    with device.configure() as cfg:
        assert cfg.commands.req_did() == cfg.device_id


@pytest.mark.parametrize(
    ("bus", "faults", "seen"),
    [
        ("i2c", BusFaults(absent=(0.0, None)), "nothing answers at this address (no acknowledge); check"),
        ("i2c", BusFaults(timeout=1), "the transfer timed out: the clock was held low for too long; check"),
        ("i2c", BusFaults(garbage=1), "the pipe status is FF FF FF FF: a notification of 65,535 bytes"),
        ("spi", BusFaults(absent=(0.0, None)), "nothing but FF was received, as from a line"),
        ("spi", BusFaults(stuck=0x00), "nothing but 00 was received, as from a line"),
        ("spi", BusFaults(stuck=0x7D), "the transfer begins with 7D 7D 7D 7D, not with FA FF FF FF; check"),
    ],
)  # fmt: skip
def test_a_device_that_does_not_answer_is_lost_and_comes_back(
    bus: str, faults: BusFaults, seen: str
) -> None:
    device = measuring(bus)
    list(islice(device, 5))
    FAULTY[bus](device, faults)
    with pytest.raises(Disconnected, match=re.escape(seen)):
        list(islice(device, 200))
    with pytest.raises(Disconnected, match=re.escape(seen)):
        device.go_to_config()
    FAULTY[bus](device, BusFaults())
    device.go_to_config()
    device.go_to_measurement()
    assert len(list(islice(device, 20))) == 20


def test_a_device_that_is_away_for_a_moment_is_waited_for() -> None:
    device = Device(BusSimLink(SimI2c("MTi-3")), reconnect=True)
    with device.configure({"packet_counter": None, "acceleration": 100}):
        pass
    faulty(device, BusFaults(absent=(device.link.clock() + 0.5, 3.0)))
    assert len(list(islice(device, 200))) == 200
    assert [notice.name for notice in device.notices][-1] == "Reconnected"


def test_a_reset_is_followed() -> None:
    for bus in ("i2c", "spi"):
        device = measuring(bus)
        device.reset(config=True)
        assert repr(device).endswith("config>")
        device.reset()
        device.link.pause(1.0)
        assert repr(device).endswith("measurement>")
        assert len(list(islice(device, 20))) == 20


def test_what_the_host_refuses() -> None:
    device = measuring("i2c")
    with pytest.raises(
        ValueError, match="exceeds the 512 bytes that an MTi accepts on I²C and SPI; nothing"
    ):
        device.send(encode_frame(MessageId.ForwardGnssData, bytes(508)))
    for data in (b"\xde", b"\xfa\xff\x30\x00", encode_frame(0x30) + b"\0"):
        with pytest.raises(ValueError, match="I²C and SPI carry whole messages, and"):
            device.send(data)
    with (
        pytest.raises(ValueError, match="has no baud rate; commands"),
        device.configure() as cfg,
    ):
        cfg.set_baudrate(115_200)
    with pytest.raises(ValueError, match="has no baud rate to restore"):
        device.restore_communication()
    with pytest.raises(ValueError, match="has no baud rate; leave it out"):
        xbus.connect("sim:MTi-3?bus=i2c", 115_200)
    assert repr(device) == "<Device sim:MTi-3?bus=i2c, MTi-3-8A7G6, measurement>"
    with pytest.raises(ValueError, match="bus must be i2c or spi, once, not can"):
        xbus.connect("sim:MTi-3?bus=can")


# A real bus: a thread, and real time


def names_of_threads() -> list[str]:
    return [thread.name for thread in threading.enumerate() if thread.name.startswith("xbus ")]


@pytest.mark.parametrize("bus", [SimI2c, SimSpi])
def test_a_thread_reads_the_pipes(bus: type[SimI2c | SimSpi], tmp_path: Path) -> None:
    virtual = bus("MTi-3", live=True)
    with xbus.connect(virtual) as device:
        with device.configure({"packet_counter": None, "acceleration": 100}) as cfg:
            cfg.commands.set_location_id(7)
            assert cfg.commands.req_location_id() == 7
        with device.record(tmp_path / "walk.mtb"):
            assert len(list(islice(device, 30))) == 30
        assert len(names_of_threads()) == 1
        stats = device.stats
        assert (stats.lost_samples, stats.overruns) == (0, 0)
        virtual.faults = BusFaults(absent=(virtual.device.time, None))
        with pytest.raises(Disconnected, match="was lost while listening"):
            list(islice(device, 200))
        virtual.faults = BusFaults()
        device.go_to_config()
        device.go_to_measurement()
        assert len(list(islice(device, 10))) == 10
    assert names_of_threads() == []
    log = xbus.read_log(tmp_path / "walk.mtb")
    assert len(log.damage) == 0
    with pytest.raises(Disconnected, match="was closed"):
        device.go_to_config()
    virtual.xfer2([4] * 8) if isinstance(virtual, SimSpi) else status(virtual)  # still open


def test_a_device_that_is_dropped_ends_its_thread() -> None:
    device = xbus.connect(SimI2c("MTi-3", live=True))
    (thread,) = [thread for thread in threading.enumerate() if thread.name.startswith("xbus ")]
    del device
    gc.collect()
    thread.join(5)
    assert not thread.is_alive()


class Pin:
    """The pin DRDY of a virtual bus."""

    def __init__(self, bus: SimI2c | None, level: bool = True) -> None:
        self.bus, self.level = bus, level
        self.waits = 0
        self.is_closed = False

    def is_active(self) -> bool:
        return self.level if self.bus is None else self.bus.drdy

    def wait(self, timeout: float) -> None:
        self.waits += 1
        threading.Event().wait(min(timeout, 0.003))

    def close(self) -> None:
        self.is_closed = True


class Reset:
    def __init__(self, bus: SimI2c) -> None:
        self.bus = bus
        self.pulses = 0

    def pulse(self) -> None:
        self.pulses += 1
        self.bus.faults = BusFaults()
        self.bus.reset()

    def close(self) -> None:
        pass


def test_a_pin_is_read_during_transfers() -> None:
    """One thread waits for DRDY, another one sends a command."""
    bus, stop = SimI2c("MTi-3", live=True), threading.Event()
    bus.device.advance(0.1)  # it has started
    errors: list[BaseException] = []

    def watch() -> None:
        try:
            while not stop.is_set():
                bus.drdy  # noqa: B018 - reading it is the test
        except BaseException as error:
            errors.append(error)

    threads = [threading.Thread(target=watch) for _ in range(3)]
    for thread in threads:
        thread.start()
    try:
        for _ in range(3000):
            status = I2cMessage.read(0x6B, 4)
            bus.i2c_rdwr(I2cMessage.write(0x6B, [0x04]), status)
    finally:
        stop.set()
        for thread in threads:
            thread.join()
    assert errors == []


def test_data_ready_replaces_polling() -> None:
    bus = SimI2c("MTi-3", live=True)
    pin = Pin(bus)
    device = Device(BusLink(lambda: host_bus(bus), "i2c:1", data_ready=pin))
    device.find_baudrate((None,))
    with device.configure({"packet_counter": None, "acceleration": 100}):
        pass
    device.reset(config=True)  # its configuration is lost, and set again
    device.go_to_measurement()
    assert len(list(islice(device, 20))) == 20
    assert device.stats.lost_samples == 0
    assert pin.waits > 10
    device.close()
    assert pin.is_closed


@pytest.mark.parametrize(
    ("level", "seen"),
    [
        (False, "DRDY is low, but the device has messages"),
        (True, "DRDY is high, but the device has no"),
    ],
)
def test_a_wrong_line_is_found(level: bool, seen: str) -> None:
    bus = SimI2c("MTi-3", live=True)
    bus.device.advance(0.1)
    if level:
        i2c_read(bus, 0x05, 3)
        i2c_write(bus, 0x03, GO_TO_CONFIG)
        i2c_read(bus, 0x05, 3)
    with pytest.raises(BusError, match=seen):
        BusLink(lambda: host_bus(bus), "i2c:1", data_ready=Pin(None, level))


def test_a_device_that_hangs_is_reset() -> None:
    bus = SimI2c("MTi-3", live=True, faults=BusFaults(stuck=0xFF))
    reset = Reset(bus)
    link = BusLink(lambda: host_bus(bus), "i2c:1", reset=reset)
    assert reset.pulses == 1
    device = Device(link)
    device.wake_up()
    assert device.state == State.CONFIG
    device.close()


# Names of ports


def test_names() -> None:
    port = parse_bus_port("i2c:/dev/i2c-3@0x1d?drdy=24&reset=GPIO25&chip=/dev/gpiochip4&poll=0.001")
    assert (port.bus, port.address, port.drdy, port.reset) == ("/dev/i2c-3", 0x1D, "24", "GPIO25")
    assert (port.chip, port.poll, port.speed) == ("/dev/gpiochip4", 0.001, None)
    assert parse_bus_port("i2c:1")[1:3] == ("/dev/i2c-1", 0x6B)
    assert parse_bus_port("spi:0.1?speed=2000000")[1::2][:2] == ("/dev/spidev0.1", 2_000_000)
    assert parse_bus_port("spi:/dev/spidev0.0").speed == 1_000_000
    port = parse_bus_port("ftdi-i2c:ftdi://ftdi:232h/1@107?speed=100000")
    assert (port.bus, port.address, port.speed) == ("ftdi://ftdi:232h/1", 0x6B, 100_000)
    port = parse_bus_port("ftdi-spi:ftdi://ftdi:232h/1?cs=2")
    assert (port.bus, port.cs, port.speed) == ("ftdi://ftdi:232h/1", 2, 1_000_000)


@pytest.mark.parametrize(
    ("name", "problem"),
    [
        ("i2c:", "i2c: names no bus; use i2c:/dev/i2c-1@0x6b"),
        ("i2c:1@0x10", "no MTi has the I²C address 0x10; the pins ADD2 to ADD0 give 0x1D"),
        ("i2c:1@six", "the address must be a whole number, not 'six'"),
        ("i2c:1?speed=400000", "i2c: has no option speed: Linux sets the clock of I²C"),
        ("spi:0.0?cs=1", "spi: has no option cs; its options are speed, drdy, reset, chip, poll"),
        ("spi:0.0?speed=3000000", "the speed must be from 1 to 2,000,000 Hz, not 3,000,000"),
        ("spi:0.0?speed=fast", "speed must be a whole number, not 'fast'"),
        ("spi:0.0?poll=0", "poll must be from 0.0001 to 1 seconds, not '0'"),
        ("spi:0.0?poll=nan", "poll must be from 0.0001 to 1 seconds, not 'nan'"),
        ("spi:0.0?drdy=", "drdy is empty"),
        ("spi:0.0?drdy=1&drdy=2", "the option drdy is given twice"),
        ("spi:0.0?chip=x", "the option chip is for drdy and reset"),
        ("ftdi-spi:ftdi:///1?cs=5", "cs must be from 0 to 4, not 5"),
    ],
)
def test_names_that_are_wrong(name: str, problem: str) -> None:
    with pytest.raises(ValueError, match=re.escape(problem)):
        parse_bus_port(name)


# What the libraries do


@pytest.mark.parametrize(
    ("number", "seen"),
    [
        (errno.ENOENT, "cannot open i2c:9: there is no such bus; switch it on, on a Raspberry Pi with raspi"),
        (errno.EACCES, "permission denied; become a member of the group i2c: sudo usermod -aG i2c $USER"),
        (errno.EBUSY, "it is in use; close the program that uses it"),
        (errno.EIO, "cannot open i2c:9: Input/output error"),
    ],
)  # fmt: skip
def test_an_i2c_bus_that_cannot_be_opened(
    monkeypatch: pytest.MonkeyPatch, number: int, seen: str
) -> None:
    def refuse(*arguments: Any) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(smbus2, "SMBus", refuse)
    with pytest.raises(BusError, match=re.escape(seen)) as caught:
        xbus.connect("i2c:9")
    assert caught.value.errno == number
    result = CliRunner().invoke(main, ["identify", "i2c:9"])
    assert (result.exit_code, result.stdout) == (1, "")
    assert seen in result.stderr
    assert result.stderr.count("\n") == 1


def test_a_bus_that_does_not_exist() -> None:
    with pytest.raises(BusError, match="there is no such bus"):
        xbus.connect("i2c:/dev/i2c-does-not-exist")


@pytest.mark.parametrize(
    ("port", "module", "extra"),
    [("i2c:1", "smbus2", "i2c"), ("spi:0.0", "spidev", "spi"), ("i2c:1?drdy=2", "gpiod", "i2c"),
     ("ftdi-i2c:ftdi:///1", "pyftdi", "ftdi"), ("ftdi-spi:ftdi:///1", "pyftdi", "ftdi")],
)  # fmt: skip
def test_a_missing_library_is_named(
    monkeypatch: pytest.MonkeyPatch, port: str, module: str, extra: str
) -> None:
    for name in [name for name in sys.modules if name.split(".")[0] == module]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(ImportError, match=re.escape(f'pip install "xbus-mti[{extra}]"')):
        xbus.connect(port)


class OpenedI2c(SimI2c):
    """An smbus2.SMBus that was opened by its path."""

    funcs = smbus2.smbus2.I2cFunc.I2C

    def __init__(self, path: str) -> None:
        assert path == "/dev/i2c-1"
        super().__init__("MTi-3", live=True)


def test_a_port_on_i2c(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(smbus2, "SMBus", OpenedI2c)
    with xbus.connect("i2c:/dev/i2c-1@0x6b") as device:
        assert repr(device) == "<Device i2c:/dev/i2c-1@0x6b, product not read yet, measurement>"
        with device.configure():
            assert device.product_code == "MTi-3-8A7G6"
        assert len(list(islice(device, 5))) == 5
    monkeypatch.setattr(OpenedI2c, "funcs", smbus2.smbus2.I2cFunc.SMBUS_BYTE)
    with pytest.raises(
        BusError, match="the adapter has SMBus only; MTSSP needs plain I²C transfers"
    ):
        xbus.connect("i2c:1")


def test_a_port_on_i2c_without_a_device(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(smbus2, "SMBus", OpenedI2c)
    with pytest.raises(BusError, match="cannot open i2c:1@0x1d: nothing answers at this address"):
        xbus.connect("i2c:1@0x1d")


def test_a_port_on_spi(monkeypatch: pytest.MonkeyPatch) -> None:
    spidev = pytest.importorskip("spidev", reason="spidev needs a compiler to install")
    opened: list[SimSpi] = []

    class Opened(SimSpi):
        def __init__(self) -> None:
            super().__init__("MTi-3", live=True)

        def open_path(self, path: str) -> None:
            assert path == "/dev/spidev0.0"
            opened.append(self)

    assert {"mode", "max_speed_hz", "open_path", "xfer2", "close"} <= set(dir(spidev.SpiDev))
    assert {"mode", "max_speed_hz", "bits_per_word", "lsbfirst"} <= set(vars(SimSpi("MTi-3")))
    monkeypatch.setattr(spidev, "SpiDev", Opened)
    with xbus.connect("spi:/dev/spidev0.0?speed=2000000") as device:
        assert (opened[0].mode, opened[0].max_speed_hz) == (3, 2_000_000)
        with device.configure():
            assert device.product_code == "MTi-3-8A7G6"


def test_ftdi_i2c() -> None:
    i2c = pytest.importorskip("pyftdi.i2c")
    virtual = SimI2c("MTi-3", live=True)

    def exchange(out: bytes, size: int) -> bytes:
        reply = I2cMessage.read(ADDRESS, size)
        virtual.i2c_rdwr(I2cMessage.write(ADDRESS, out), reply)
        return bytes(reply)

    controller = create_autospec(i2c.I2cController, instance=True)
    port = create_autospec(i2c.I2cPort, instance=True)
    controller.get_port.return_value = port
    port.exchange.side_effect = exchange
    port.write.side_effect = lambda out: virtual.i2c_rdwr(I2cMessage.write(ADDRESS, out))
    bus = FtdiI2cBus(controller, ADDRESS, name="ftdi-i2c:ftdi:///1")
    with xbus.connect(bus) as device, device.configure():
        assert device.product_code == "MTi-3-8A7G6"
    controller.get_port.assert_called_once_with(ADDRESS)
    port.exchange.side_effect = i2c.I2cNackError("NACK from slave")
    with pytest.raises(
        BusError, match=r"nothing answers at this address.*a wire connects AD7 to AD0"
    ):
        xbus.connect(bus)
    bus.close()
    controller.close.assert_called_once_with()


def test_ftdi_spi() -> None:
    spi = pytest.importorskip("pyftdi.spi")
    virtual = SimSpi("MTi-3", live=True)
    virtual.mode = 3

    def exchange(out: bytes, duplex: bool) -> bytes:
        assert duplex
        return bytes(virtual.xfer2(list(out)))

    controller = create_autospec(spi.SpiController, instance=True)
    port = create_autospec(spi.SpiPort, instance=True)
    controller.get_port.return_value = port
    port.exchange.side_effect = exchange
    bus = FtdiSpiBus(controller, 0, 2_000_000, name="ftdi-spi:ftdi:///1")
    with xbus.connect(bus) as device, device.configure():
        assert device.product_code == "MTi-3-8A7G6"
    controller.get_port.assert_called_once_with(cs=0, freq=2_000_000, mode=3)


@pytest.mark.parametrize("port", ["ftdi-i2c:ftdi://ftdi:232h/1", "ftdi-spi:ftdi://ftdi:232h/1"])
def test_an_adapter_that_is_not_there(port: str) -> None:
    pytest.importorskip("pyftdi")
    with pytest.raises(BusError, match="libusb must be installed; ftdi_urls"):
        xbus.connect(port)


def test_pins(monkeypatch: pytest.MonkeyPatch) -> None:
    gpiod = pytest.importorskip("gpiod")
    request = create_autospec(gpiod.LineRequest, instance=True)
    calls: list[Any] = []

    def request_lines(path: str, **arguments: Any) -> Any:
        calls.append((path, arguments))
        return request

    requested = create_autospec(gpiod.request_lines, side_effect=request_lines)
    requested = create_autospec(gpiod.request_lines, side_effect=request_lines)
    monkeypatch.setattr(gpiod, "request_lines", requested)
    pin = GpioDataReady("/dev/gpiochip0", "24")
    ((path, arguments),) = calls
    ((line, wanted),) = arguments["config"].items()
    assert (path, line, wanted.edge_detection) == ("/dev/gpiochip0", 24, gpiod.line.Edge.RISING)
    request.get_value.return_value = gpiod.line.Value.ACTIVE
    assert pin.is_active()
    request.get_value.return_value = gpiod.line.Value.INACTIVE
    assert not pin.is_active()
    request.wait_edge_events.return_value = False
    pin.wait(0.1)
    request.read_edge_events.assert_not_called()
    request.wait_edge_events.return_value = True
    pin.wait(0.1)
    request.read_edge_events.assert_called_once_with()
    reset = GpioReset("/dev/gpiochip0", "GPIO25")
    wanted = calls[1][1]["config"]["GPIO25"]
    assert (wanted.drive, wanted.output_value) == (
        gpiod.line.Drive.OPEN_DRAIN,
        gpiod.line.Value.ACTIVE,
    )
    reset.pulse()
    values = [call.args for call in request.set_value.call_args_list]
    assert values == [("GPIO25", gpiod.line.Value.INACTIVE), ("GPIO25", gpiod.line.Value.ACTIVE)]
    reset.close()
    request.release.assert_called_once_with()


def test_a_line_that_cannot_be_used() -> None:
    pytest.importorskip("gpiod")
    with pytest.raises(
        BusError, match=r"the line 24 of /dev/no-chip cannot be used: .*; gpioinfo lists"
    ):
        open_bus_port("i2c:1?drdy=24&chip=/dev/no-chip", bid=0xFF, bound=1000)


# Commands


def run(*arguments: str) -> str:
    result = CliRunner().invoke(main, list(arguments), catch_exceptions=False)
    assert result.exit_code == 0, result.stderr
    return result.stdout + result.stderr


@pytest.mark.parametrize("bus", ["i2c", "spi"])
def test_commands(bus: str, tmp_path: Path) -> None:
    port = f"sim:MTi-3?bus={bus}"
    assert re.search(rf"^port +{re.escape(port)}$", run("identify", port), re.MULTILINE)
    assert '"baudrate": null' in run("identify", port, "--json")
    path = tmp_path / "walk.mtb"
    assert "no samples lost" in run("record", port, "-o", str(path), "--duration", "1")
    assert len(xbus.read_log(path).damage) == 0
    settings_file = tmp_path / "settings.toml"
    settings_file.write_text(run("config", "dump", port))
    assert "no differences" in run("config", "apply", port, str(settings_file))
    assert "GoToConfigAck" in run("send", port, "GoToConfig")
