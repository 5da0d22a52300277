"""The virtual device: replies, effects of settings, and storage of settings."""

from __future__ import annotations

import struct
import tracemalloc
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import xbus
from conftest import OWN_CAPTURES, exchanges
from xbus import Faults, MessageId, Scanner, SimulatedDevice, encode_frame
from xbus.geometry import quaternion
from xbus.protocol import (
    EVERY,
    Alignment,
    AlignmentRotation,
    CanConfig,
    CanDataId,
    CanOutput,
    ExtOutputMode,
    GnssLeverArm,
    GnssPlatform,
    GnssReceiver,
    GnssReceiverSettings,
    HardwareVersion,
    IccCommand,
    IccReply,
    IccStatus,
    LatLonAlt,
    OptionFlag,
    OptionFlags,
    Output,
    Polarity,
    PortConfig,
    PortProtocol,
    ResetCode,
    Selftest,
    State,
    StringOutput,
    StringType,
    SyncFunction,
    SyncLine,
    SyncSetting,
    UtcTime,
    decode,
    encode,
)
from xbus.protocol.configuration import Configuration, Firmware
from xbus.protocol.ids import DataId
from xbus.protocol.products import support
from xbus.protocol.tables import MESSAGES, PRODUCTS, STATUS_FLAGS
from xbus.sim.replay import Replay
from xbus.sim.sensors import UTC
from xbus.sim.trajectories import trajectory
from xbus.wire.message import Message

WAKE_UP, ACK = bytes.fromhex("FAFF3E00C3"), bytes.fromhex("FAFF3F00C2")
PERIOD, MESSAGE, BAUDRATE, PARAMETER = 3, 4, 32, 33
RESTORE = b"\xde" * 20

IMU_NUMBERS = {product.number for product in PRODUCTS.values() if product.kind == "IMU"}
GNSS_NUMBERS = {product.number for product in PRODUCTS.values() if product.kind == "GNSS/INS"}


def frame(name: str, value: Any = None, **options: Any) -> bytes:
    # Bytes are a payload, of a value that the layout of the message does not write.
    payload = value if isinstance(value, bytes) else encode(name, value)
    return encode_frame(MESSAGES[name].mid, payload, **options)


def messages(data: bytes) -> list[Message]:
    """Returns the messages of bytes that consist of frames only."""
    scanner = Scanner()
    found = scanner.feed(data) + scanner.close()
    assert all(isinstance(message, Message) for message in found), found
    return [message for message in found if isinstance(message, Message)]


def mids(data: bytes) -> list[int]:
    return [message.mid for message in messages(data)]


def booted(product: str | int, **options: Any) -> SimulatedDevice:
    """Returns a device that has just sent WakeUp."""
    device = SimulatedDevice(product, **options)
    device.advance(0.1)
    assert device.read() == WAKE_UP
    return device


def configurable(product: str | int, **options: Any) -> SimulatedDevice:
    """Returns a device in Config."""
    device = booted(product, **options)
    device.write(ACK)
    assert device.state is State.CONFIG
    return device


def exchange(device: SimulatedDevice, data: bytes) -> bytes:
    """Returns the reply; on a serial line it takes some time."""
    device.write(data)
    if device.is_serial:
        device.advance(0.05)
    return device.read()


def ask(device: SimulatedDevice, name: str, value: Any = None) -> Any:
    """Returns the value of the reply to a request, or the error code."""
    found = messages(exchange(device, frame(name, value)))
    (reply,) = [message for message in found if message.mid != MessageId.MTData2]
    if reply.name == "Error":
        return f"error {reply.payload[0]}"
    assert reply.mid == MESSAGES[name].reply
    return decode(reply.name, reply.payload) if reply.payload else None


def reset(device: SimulatedDevice) -> None:
    """Resets a device and returns to Config."""
    assert ask(device, "Reset") is None
    device.advance(0.1)
    assert device.state is State.WAKEUP
    assert device.read(device.baudrate) == WAKE_UP
    device.write(ACK)


def measuring(device: SimulatedDevice, *outputs: Output | int) -> SimulatedDevice:
    """Returns a device in Measurement, with these outputs if any."""
    if outputs:
        full = [output if isinstance(output, Output) else Output(output) for output in outputs]
        ask(device, "SetOutputConfiguration", full)
    assert ask(device, "GoToMeasurement") is None
    return device


def log_of(device: SimulatedDevice, seconds: float) -> xbus.Log:
    device.advance(seconds)
    return xbus.read_log(device.read())


def flag(words: Any, name: str) -> list[int]:
    """Returns a field of status words."""
    row = STATUS_FLAGS[name]
    return [int(word) >> row.bit & (1 << row.width) - 1 for word in words]


# ---------------------------------------------------------------------------------------------
# Published exchanges
# ---------------------------------------------------------------------------------------------


EXCHANGES = exchanges()


@pytest.mark.parametrize("product", EXCHANGES)
@pytest.mark.parametrize("bid", [0xFF, 0x01])
def test_published_exchanges(product: str, bid: int) -> None:
    """A request with the other bus identifier gets a reply with that identifier."""
    device = configurable(product)
    lines = EXCHANGES[product]
    for request, reply in zip(lines[::2], lines[1::2], strict=True):
        found = exchange(device, readdressed(request, bid))
        assert found.hex(" ").upper() == readdressed(reply, bid).hex(" ").upper(), request


def readdressed(text: str, bid: int) -> bytes:
    """Returns a published frame with another bus identifier; its published checksum must be right."""
    data = bytes.fromhex(text)
    assert sum(data[1:]) % 256 == 0
    return data if bid == 0xFF else encode_frame(data[2], data[4:-1], bid=bid)


# ---------------------------------------------------------------------------------------------
# States, products and values
# ---------------------------------------------------------------------------------------------

REQUESTS = [row for row in MESSAGES.values() if row.direction == "to device"]


@pytest.mark.parametrize(
    ("wire", "code"),
    [
        ("FA FF 99 00 68", MESSAGE),  # unknown
        ("FA FF 36 00 CB", MESSAGE),  # sent by devices only
        ("FA FF 18 02 00 00 E7", PARAMETER),  # too long
        ("FA FF EC 00 15", PARAMETER),  # too short
    ],
)
def test_invalid_messages_are_refused(wire: str, code: int) -> None:
    found = exchange(configurable(630), bytes.fromhex(wire))
    assert found == encode_frame(MessageId.Error, bytes([code]))


@pytest.mark.parametrize("mid", [0x00, 0x02, 0x0C, 0x10, 0x12, 0x1C, 0x1E, 0x24, 0x30])
@pytest.mark.parametrize("data", [b"\0\xff", bytes(30)])
def test_the_payload_of_an_empty_message_is_ignored(mid: int, data: bytes) -> None:
    plain = exchange(configurable(630), encode_frame(mid))
    assert exchange(configurable(630), encode_frame(mid, data)) == plain
    assert plain[2] == mid + 1


def sync(function: int, line: int, polarity: int = 1, **options: Any) -> SyncSetting:
    return SyncSetting(function, line, polarity, **options)


CLOCK, TRIGGER, LATEST = (
    SyncFunction.CLOCK_BIAS_ESTIMATION,
    SyncFunction.TRIGGER_INDICATION,
    SyncFunction.SEND_LATEST,
)
ITM, PPS = SyncFunction.INTERVAL_TRANSITION_MEASUREMENT, SyncFunction.GNSS_1PPS

#: Product, message, value, error code.
REFUSED: list[tuple[str, str, Any, int]] = [
    ("MTi-300", "SetBaudrate", 0x0C, BAUDRATE),
    ("MTi-300", "SetBaudrate", 0x55, BAUDRATE),
    ("MTi-300", "SetPeriod", 224, PERIOD),
    ("MTi-300", "SetPeriod", 1153, PERIOD),
    ("MTi-300", "SetPeriod", 3455, PERIOD),
    ("MTi-300", "SetErrorMode", 4, PARAMETER),
    ("MTi-300", "SetTransmitDelay", 589, PARAMETER),
    ("MTi-300", "SetExtOutputMode", 0x40, PARAMETER),
    ("MTi-300", "SetOptionFlags", OptionFlags(set=OptionFlag.DISABLE_AUTO_STORE), PARAMETER),
    ("MTi-300", "SetFilterProfile", 50, PARAMETER),
    ("MTi-300", "SetStringOutputType", StringOutput(StringType.GPGGA), PARAMETER),
    ("MTi-300", "SetStringOutputType", StringOutput(StringType.HCHDM, 10), PARAMETER),
    ("MTi-300", "SetSyncSettings", [sync(TRIGGER, SyncLine.IN2)], PARAMETER),
    ("MTi-300", "SetSyncSettings", [sync(PPS, SyncLine.BI_OUT)], PARAMETER),
    ("MTi-300", "SetSyncSettings", [sync(99, SyncLine.IN1)], PARAMETER),
    ("MTi-300", "SetSyncSettings", [sync(TRIGGER, SyncLine.IN1, 4)], PARAMETER),
    ("MTi-300", "SetSyncSettings", [sync(TRIGGER, SyncLine.IN1, offset=60_001)], PARAMETER),
    ("MTi-300", "SetSyncSettings", [sync(ITM, SyncLine.BI_OUT, offset=-30_001)], PARAMETER),
    ("MTi-300", "SetOutputConfiguration", [Output(DataId.LatLon, 100)], PARAMETER),
    ("MTi-300", "SetOutputConfiguration", [Output(DataId.Quaternion | 0xC, 100)], PARAMETER),
    ("MTi-300", "SetOutputConfiguration", [Output(0x4050, 100)], PARAMETER),
    ("MTi-300", "ReqAlignmentRotation", 2, PARAMETER),
    ("MTi-300", "SetAlignmentRotation", AlignmentRotation(2, (1, 0, 0, 0)), PARAMETER),
    ("MTi-300", "SetAlignmentRotation", AlignmentRotation(0, (0, 0, 0, 0)), PARAMETER),
    ("MTi-300", "SetAlignmentRotation", struct.pack(">B4f", 0, np.nan, 0, 0, 0), PARAMETER),
    ("MTi-300", "SetLatLonAlt", LatLonAlt(90.1, 0, 0), PARAMETER),
    ("MTi-300", "SetLatLonAlt", LatLonAlt(0, -180.1, 0), PARAMETER),
    ("MTi-300", "SetLatLonAlt", struct.pack(">3d", 0, 0, np.inf), PARAMETER),
    ("MTi-300", "SetLatLonAlt", struct.pack(">3d", np.nan, 0, 0), PARAMETER),
    ("MTi-300", "SetUTCTime", UtcTime(0, 1998, 12, 31, 0, 0, 0), PARAMETER),
    ("MTi-300", "SetUTCTime", UtcTime(0, 2026, 2, 29, 0, 0, 0), PARAMETER),
    ("MTi-300", "SetUTCTime", UtcTime(0, 2026, 2, 28, 24, 0, 0), PARAMETER),
    ("MTi-300", "SetUTCTime", UtcTime(1_000_000_001, 2026, 2, 28, 0, 0, 0), PARAMETER),
    ("MTi-300", "ResetOrientation", ResetCode.HEADING, MESSAGE),
    ("MTi-300", "ResetOrientation", 2, PARAMETER),
    ("MTi-300", "IccCommand", IccCommand.START, MESSAGE),
    ("MTi-300", "IccCommand", 9, PARAMETER),
    ("MTi-7", "SetGnssPlatform", 77, PARAMETER),
    ("MTi-7", "SetGnssReceiverSettings", GnssReceiverSettings(77, 2, 4), PARAMETER),
    ("MTi-7", "SetGnssReceiverSettings", GnssReceiverSettings(0, 0x77, 4), PARAMETER),
    ("MTi-630", "SetFilterProfileModern", "robust/VRU", PARAMETER),
    ("MTi-630", "SetFilterProfileModern", "Robust/Responsive", PARAMETER),
    ("MTi-630", "SetFilterProfileModern", "Robust/VRU/VRUAHS", PARAMETER),
    ("MTi-630", "SetPortConfig", [PortConfig(1, 2), PortConfig(9, 2), PortConfig(0, 0)], PARAMETER),
    ("MTi-630", "SetPortConfig", [PortConfig(1, 2), PortConfig(1, 2), PortConfig(6, 2)], PARAMETER),
    (
        "MTi-630",
        "SetPortConfig",
        [PortConfig(1, 0x55), PortConfig(1, 2), PortConfig(0, 0)],
        BAUDRATE,
    ),
    (
        "MTi-680G",
        "SetPortConfig",
        [PortConfig(1, 2), PortConfig(1, 2), PortConfig(6, 2)],
        PARAMETER,
    ),
    ("MTi-630", "SetCanConfig", CanConfig(0x77), BAUDRATE),
    ("MTi-630", "SetCanOutputConfig", [CanOutput(0x99, False, 1, 100)], PARAMETER),
    ("MTi-680G", "SetInitialHeading", 180.1, PARAMETER),
    ("MTi-680G", "SetGnssLeverArm", struct.pack(">3f", np.inf, 0, 0), PARAMETER),
]


@pytest.mark.parametrize(("product", "name", "value", "code"), REFUSED)
def test_a_refused_value_changes_nothing(product: str, name: str, value: Any, code: int) -> None:
    device = configurable(product)
    before = device.settings
    assert ask(device, name, value) == f"error {code}"
    assert device.settings == before


def test_an_identifier_that_no_device_can_have() -> None:
    with pytest.raises(ValueError, match="0x100000000 is not a device identifier"):
        SimulatedDevice("MTi-630", device_id=1 << 32)


def test_too_many_outputs_are_refused() -> None:
    device = configurable(630)
    one = Output(DataId.PacketCounter)
    assert len(ask(device, "SetOutputConfiguration", [one] * 32)) == 32
    payload = encode("SetOutputConfiguration", [one] * 32) + bytes.fromhex("1020FFFF")
    device.write(encode_frame(MessageId.SetOutputConfiguration, payload))
    assert device.read() == encode_frame(MessageId.Error, bytes([PARAMETER]))
    assert len(device.settings.output_configuration) == 32


@pytest.mark.parametrize("product", PRODUCTS)
def test_every_quantity_at_every_rate(product: int) -> None:
    """The acknowledged rate is that of the table, and samples have this rate."""
    device, supported = configurable(product, time_to_fix=0.0), support(product)
    for name in supported.rates:
        for rate in {*supported.rates_of(name), 0, 1, 7, 10_000, EVERY}:
            output = Output(DataId.PacketCounter if name == "device_id" else quantity(name), rate)
            assert ask(device, "SetOutputConfiguration", [output]) == (
                supported.acknowledged(output),
            )
            measuring(device)
            device.advance(0.02)
            assert all(message.mid == MessageId.MTData2 for message in messages(device.read()))
            device.write(frame("GoToConfig"))
            assert device.read().endswith(frame("GoToConfigAck"))


def quantity(name: str) -> int:
    return xbus.protocol.tables.QUANTITIES[name].id


# ---------------------------------------------------------------------------------------------
# Settings
# ---------------------------------------------------------------------------------------------

Q = (0.5, -0.5, 0.5, 0.5)
#: Product, message without Set, value, and the value that is read back (None: the same value).
SETTINGS: list[tuple[str, str, Any, Any]] = [
    ("MTi-3", "LocationID", 0x1234, None),
    ("MTi-3", "LatLonAlt", LatLonAlt(-33.86, 151.2, 12.5), None),
    ("MTi-3", "FilterProfile", 53, (1, 53)),
    ("MTi-3", "OutputConfiguration", (Output(DataId.Acceleration, 30),), (Output(0x4020, 25),)),
    ("MTi-3", "OutputConfiguration", (), None),
    ("MTi-3", "OptionFlags", OptionFlags(set=OptionFlag.ENABLE_AHS), OptionFlag.ENABLE_AHS),
    ("MTi-3", "SyncSettings", (sync(LATEST, SyncLine.SOFTWARE),), None),
    ("MTi-3", "SyncSettings", (sync(LATEST, SyncLine.IN1), sync(99, 0, 0), sync(0, 0)),
     (sync(LATEST, SyncLine.IN1),)),
    ("MTi-300", "Baudrate", 0x0A, None),
    ("MTi-300", "Period", 225, None),
    ("MTi-300", "Period", 2304, 1152),
    ("MTi-300", "OutputSkipFactor", 0xFFFF, None),
    ("MTi-300", "ErrorMode", 3, None),
    ("MTi-300", "TransmitDelay", 65_535, None),
    ("MTi-300", "ExtOutputMode", ExtOutputMode.USB_LOW_LATENCY, None),
    ("MTi-300", "StringOutputType", StringOutput(StringType.HCHDM | StringType.TSS2), None),
    ("MTi-300", "SyncSettings", (sync(ITM, SyncLine.BI_OUT, offset=-30_000, pulse_width=9),), None),
    ("MTi-630", "StringOutputType", StringOutput(StringType.GPRMC, 20), None),
    ("MTi-630", "StringOutputType", StringOutput(StringType(0)), StringOutput(StringType(0), 0)),
    ("MTi-630", "Baudrate", 0x0C, None),
    ("MTi-630", "FilterProfile", "Robust/VRU", None),
    ("MTi-630", "FilterProfile", "Robust", None),
    ("MTi-630", "PortConfig", (PortConfig(PortProtocol.NMEA, 5), PortConfig(1, 2), PortConfig(0, 0)),
     None),
    ("MTi-630", "CanConfig", CanConfig(0x0A, True), None),
    ("MTi-630", "CanOutputConfig", (CanOutput(CanDataId.QUATERNION, True, 0x21, 0x7FF),), None),
    ("MTi-630", "CanOutputConfig", (), None),
    ("MTi-7", "GnssPlatform", GnssPlatform.AIRBORNE_4G, None),
    ("MTi-7", "GnssReceiverSettings", GnssReceiverSettings(GnssReceiver.NMEA, 2, 10, 1), None),
    ("MTi-680G", "GnssLeverArm", GnssLeverArm(0.5, -0.25, 1.0), None),
]  # fmt: skip


@pytest.mark.parametrize(("product", "name", "value", "answer"), SETTINGS)
def test_settings_are_read_back_and_persist(
    product: str, name: str, value: Any, answer: Any
) -> None:
    """Settings are in effect at once, after Reset and after a power cycle, until a factory reset."""
    device = configurable(product)
    before = ask(device, f"Req{name}")
    answer = value if answer is None else answer
    modern = "Modern" if isinstance(value, str) else ""
    assert ask(device, f"Set{name}{modern}", value) in (None, answer)
    assert ask(device, f"Req{name}") == answer
    reset(device)
    assert ask(device, f"Req{name}") == answer
    device.power_cycle()
    device.advance(0.1)
    device.read()
    device.write(ACK)
    assert ask(device, f"Req{name}") == answer
    assert ask(device, "RestoreFactoryDef") is None
    assert ask(device, f"Req{name}") == before
    reset(device)
    assert ask(device, f"Req{name}") == before


@pytest.mark.parametrize(
    ("product", "message", "value", "reply"),
    [
        # An empty list of synchronization settings has no bytes.
        ("MTi-3", "SyncSettings", (), "FA FF 2D 00 D4"),
        ("MTi-3", "SyncSettings", (sync(0, 0),), "FA FF 2D 00 D4"),
        # Empty lists of outputs are one entry of zeros, in the setting and in the reply (FACTS 2.5, 5.5).
        ("MTi-3", "OutputConfiguration", (), "FA FF C1 04 00 00 00 00 3C"),
        ("MTi-630", "CanOutputConfig", (), "FA FF E9 08 00 00 00 00 00 00 00 00 10"),
    ],
)
def test_empty_lists(product: str, message: str, value: Any, reply: str) -> None:
    device = configurable(product)
    ask(device, f"Set{message}", value)
    assert exchange(device, frame(f"Req{message}")) == bytes.fromhex(reply)


def test_other_lists_are_never_empty() -> None:
    """A device has an identifier, three ports, and slots for filter profiles."""
    lists = {name for name, row in MESSAGES.items() if row.kind == "list"}
    never_empty = {"InitBusResults": "InitBus", "PortConfig": "ReqPortConfig",
                   "AvailableFilterProfiles": "ReqAvailableFilterProfiles"}  # fmt: skip
    replies = {name for name in lists if MESSAGES[name].direction == "to host"}
    assert replies - set(never_empty) == {
        "ReqSyncSettingsAck", "ReqOutputConfigurationAck", "SetOutputConfigurationAck",
        "CanOutputConfig", "SetCanOutputConfigAck",
    }  # fmt: skip
    for request in never_empty.values():
        for product in MESSAGES[request].products:
            assert ask(configurable(product), request), product


def test_a_slow_period_becomes_a_skip_factor() -> None:
    """SetPeriod: 50 Hz is 100 Hz with every other sample skipped."""
    device = configurable(300)
    assert ask(device, "SetPeriod", 2304) is None
    assert (ask(device, "ReqPeriod"), ask(device, "ReqOutputSkipFactor")) == (1152, 1)
    assert ask(device, "SetPeriod", 768) is None
    assert (ask(device, "ReqPeriod"), ask(device, "ReqOutputSkipFactor")) == (768, 1)


def test_a_rotation_is_stored_unchanged() -> None:
    device = configurable(630)
    for which, q in [(Alignment.ROT_SENSOR, (2.0, 0.0, 0.0, 1.0)), (Alignment.ROT_LOCAL, Q)]:
        assert ask(device, "SetAlignmentRotation", AlignmentRotation(which, q)) is None
        assert ask(device, "ReqAlignmentRotation", which) == AlignmentRotation(which, q)


def test_filter_profiles_are_those_of_the_product() -> None:
    device = configurable(7)
    found = ask(device, "ReqAvailableFilterProfiles")
    assert [(profile.type, profile.label) for profile in found] == [
        (11, "General"), (12, "GeneralNoBaro"), (13, "GeneralMag"), (0, ""), (0, ""),
    ]  # fmt: skip
    assert ask(configurable(630), "ReqFilterProfile") == "Responsive/NorthReference"


def test_option_flags_are_set_and_cleared() -> None:
    """A flag in both masks is set. Clearing a flag that the product lacks is accepted."""
    device = configurable(3)
    a, b = OptionFlag.ENABLE_AHS, OptionFlag.ENABLE_IN_RUN_COMPASS_CALIBRATION
    for change, flags in [
        (OptionFlags(set=a), a),
        (OptionFlags(set=b), a | b),
        (OptionFlags(clear=a), b),
        (OptionFlags(set=a, clear=a | b), a),
        (OptionFlags(), a),
        (OptionFlags(clear=OptionFlag(0xFFFF_FFFF)), OptionFlag(0)),
    ]:
        assert ask(device, "SetOptionFlags", change) is None
        assert ask(device, "ReqOptionFlags") == flags


def test_disable_auto_store_loses_settings_at_a_restart() -> None:
    """Table 8: changes are lost, except for the flags themselves."""
    device = configurable(3)
    ask(device, "SetLocationID", 1)
    ask(device, "SetOptionFlags", OptionFlags(set=OptionFlag.DISABLE_AUTO_STORE))
    ask(device, "SetLocationID", 2)
    ask(device, "SetFilterProfile", 51)
    assert ask(device, "ReqLocationID") == 2
    reset(device)
    assert (ask(device, "ReqLocationID"), ask(device, "ReqFilterProfile")) == (1, (1, 50))
    assert ask(device, "ReqOptionFlags") == OptionFlag.DISABLE_AUTO_STORE
    ask(device, "SetLocationID", 3)
    ask(device, "SetOptionFlags", OptionFlags(clear=OptionFlag.DISABLE_AUTO_STORE))
    ask(device, "SetFilterProfile", 52)
    reset(device)
    assert (ask(device, "ReqLocationID"), ask(device, "ReqFilterProfile")) == (1, (1, 52))


# ---------------------------------------------------------------------------------------------
# Identity
# ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("product", PRODUCTS)
def test_the_identity_is_that_of_the_product(product: int) -> None:
    device, expected = configurable(product), support(product).identity
    assert device.identity == expected
    assert ask(device, "ReqDID") == expected.device_id
    assert ask(device, "InitBus") == (expected.device_id & 0xFFFF_FFFF,)
    assert ask(device, "ReqProductCode") == expected.product_code
    assert ask(device, "ReqHardwareVersion") == expected.hardware
    assert ask(device, "ReqFWRev") == expected.firmware
    assert ask(device, "RunSelftest") == Selftest(0x7FF if product == 7 else 0x1FF)
    configuration: Configuration = ask(device, "ReqConfiguration")
    assert configuration.device_id == expected.device_id
    assert configuration.firmware[:3] == expected.firmware[:3]


def test_the_identity_can_be_chosen() -> None:
    device = configurable(
        "MTi-3",
        device_id=0x0388_0042,
        product_code="MTi-3-5A",
        firmware=Firmware(1, 2, 3, 4, 5),
        hardware=HardwareVersion(3, 1),
    )
    assert ask(device, "ReqDID") == 0x0388_0042
    assert ask(device, "ReqProductCode") == "MTi-3-5A"
    assert ask(device, "ReqFWRev") == Firmware(1, 2, 3, 4, 5)
    assert ask(device, "ReqHardwareVersion") == HardwareVersion(3, 1)
    # Table 23: the highest rate depends on the hardware version.
    fast = [Output(DataId.AccelerationHR)]
    assert ask(device, "SetOutputConfiguration", fast) == (Output(DataId.AccelerationHR, 1000),)
    other = configurable("MTi-3")
    assert ask(other, "SetOutputConfiguration", fast) == (Output(DataId.AccelerationHR, 800),)


@pytest.mark.parametrize(
    ("product", "tail"),
    [
        ("MTi-630", "00 00 01 06 00 00 00 00"),
        ("MTi-7", "00 0B 01 0E 00 00 00 00"),
        ("MTi-G-710", "00 01 01 08 02 37 04 01"),
    ],
)
def test_configuration_matches_published_bytes(product: str, tail: str) -> None:
    (found,) = messages(exchange(configurable(product), frame("ReqConfiguration")))
    assert len(found.payload) == 118
    assert found.payload[-8:] == bytes.fromhex(tail)
    if product == "MTi-630":
        assert found.payload[:8] == found.payload[98:106] == bytes.fromhex("800040D2 00000000")
        assert found.payload[32:52] == b"MTi-630-8A1G6       "


def test_emts() -> None:
    device = configurable(300)
    wire = exchange(device, frame("ReqEmts", b"\0\xff"))
    assert wire[:6] == bytes.fromhex("FA FF 91 FF 05 28")  # as an MTi-300 does
    assert exchange(device, frame("ReqEmts", b"\0\xff")) == wire
    assert exchange(configurable(30), frame("ReqEmts", b"\0\xff")) != wire


# ---------------------------------------------------------------------------------------------
# Start
# ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("product", PRODUCTS)
def test_start_without_a_host(product: int) -> None:
    """Section 4: WakeUp, then Configuration and eMTS (not on the 1-series), and samples."""
    device = booted(product)
    device.advance(0.45)
    assert (device.read(), device.state) == (b"", State.WAKEUP)
    device.advance(0.25)
    assert device.state is State.MEASUREMENT
    found = messages(device.read())
    expected = [MessageId.Configuration, MessageId.EmtsData]
    if PRODUCTS[product].series == "1-series":
        assert {message.mid for message in found} == {MessageId.MTData2}
    else:
        assert [message.mid for message in found[:2]] == expected
        assert {message.mid for message in found[2:]} == {MessageId.MTData2}
    assert {message.bid for message in found} == {0xFF}


@pytest.mark.parametrize(
    ("request_", "reply"), [(ACK, b""), (frame("GoToConfig"), frame("GoToConfigAck"))]
)
def test_a_host_that_answers_wake_up_gets_config(request_: bytes, reply: bytes) -> None:
    device = booted(630)
    assert exchange(device, request_) == reply
    assert device.state is State.CONFIG
    device.advance(10)
    assert (device.state, device.read()) == (State.CONFIG, b"")


def test_a_late_host_gets_no_reply_to_wake_up_ack() -> None:
    device = booted(630)
    device.advance(0.5)
    device.read()
    assert exchange(device, ACK) == b""
    assert device.state is State.MEASUREMENT


def test_requests_during_boot_are_ignored() -> None:
    device = SimulatedDevice(630)
    assert exchange(device, frame("GoToConfig")) == b""
    device.advance(0.1)
    assert device.read() == WAKE_UP
    assert device.state is State.WAKEUP


def test_disable_auto_measurement_starts_in_config() -> None:
    device = configurable(3)
    ask(device, "SetOptionFlags", OptionFlags(set=OptionFlag.DISABLE_AUTO_MEASUREMENT))
    assert ask(device, "Reset") is None
    device.advance(5)
    assert (device.read(), device.state) == (WAKE_UP, State.CONFIG)
    # The example of Table 8: in one message with DisableAutoStore.
    ask(
        device,
        "SetOptionFlags",
        OptionFlags(OptionFlag.DISABLE_AUTO_STORE, OptionFlag.DISABLE_AUTO_MEASUREMENT),
    )
    device.power_cycle()
    device.advance(1)
    assert device.state is State.MEASUREMENT


def test_configuration_at_startup_of_the_1_series() -> None:
    device = configurable(3)
    ask(device, "SetOptionFlags", OptionFlags(set=OptionFlag.ENABLE_CONFIG_MESSAGE_AT_STARTUP))
    device.power_cycle()
    device.advance(0.6)
    assert mids(device.read())[:3] == [
        MessageId.WakeUp,
        MessageId.Configuration,
        MessageId.EmtsData,
    ]


def test_only_the_ack_comes_between_config_and_measurement() -> None:
    device = measuring(configurable(630))
    device.advance(0.02)
    assert mids(exchange(device, frame("GoToConfig"))) == [0x36, 0x36, MessageId.GoToConfigAck]
    device.advance(1)
    assert device.read() == b""


# ---------------------------------------------------------------------------------------------
# The bus and the line
# ---------------------------------------------------------------------------------------------


def test_messages_for_other_devices_are_ignored() -> None:
    device = configurable(630)
    for bid in (0, 2, 0xFE):
        assert exchange(device, frame("ReqDID", bid=bid)) == b""


def test_a_configurable_bus_id_is_used_in_every_message() -> None:
    """Table 8: all messages carry the bus identifier."""
    device = configurable(300, bus_id=7)
    assert exchange(device, frame("ReqDID", bid=7)) == b""
    flags = OptionFlags(set=OptionFlag.ENABLE_CONFIGURABLE_BUS_ID)
    assert messages(exchange(device, frame("SetOptionFlags", flags)))[0].bid == 0xFF
    for bid in (7, 0xFF):
        assert messages(exchange(device, frame("ReqDID", bid=bid)))[0].bid == 7
    assert exchange(device, frame("ReqDID", bid=1)) == b""
    device.power_cycle()
    device.advance(1)
    assert {message.bid for message in messages(device.read())} == {7}


def test_chunking_and_garbage_do_not_change_replies() -> None:
    wire = bytes.fromhex("00 FA 12 FA FF") + frame("ReqDID") + b"\xfa\xfa" + frame("GoToConfig")
    device = configurable(630)
    device.write(wire)
    device.advance(0.2)
    whole = device.read()
    assert mids(whole) == [MessageId.DeviceID, MessageId.GoToConfigAck]
    pieces = configurable(630)
    for byte in wire:
        pieces.write(bytes([byte]))
        pieces.advance(0.05)
    pieces.advance(0.1)
    assert pieces.read() == whole


def test_the_extended_length_is_accepted_for_any_payload() -> None:
    device = configurable(630)
    # Even if the short form is sufficient.
    assert mids(exchange(device, bytes.fromhex("FA FF 00 FF 00 00 02"))) == [MessageId.DeviceID]
    long = frame("ForwardGnssData", bytes(2000))
    device = measuring(configurable(680))
    assert mids(exchange(device, long)) == [MessageId.ForwardGnssDataAck]


@pytest.mark.parametrize("false", ["FA FF 00 FF 08 00", "FA FF 00 F0", "FA"])
def test_an_incomplete_frame_is_dropped_after_a_timeout(false: str) -> None:
    device = configurable(630)
    device.write(bytes.fromhex(false) + frame("GoToConfig"))
    device.advance(0.05)
    early = device.read()
    device.advance(0.06)
    assert early + device.read() == frame("GoToConfigAck")


@given(
    st.sampled_from(sorted(PRODUCTS)),
    st.lists(
        st.tuples(
            st.sampled_from([*REQUESTS, None]),
            st.binary(max_size=40),
            st.sampled_from([0.0, 0.01, 1.0]),
        )
    ),
)
def test_any_bytes_leave_the_device_working(
    product: int, sent: list[tuple[Any, bytes, float]]
) -> None:
    device = booted(product)
    for row, data, pause in sent:
        device.write(data if row is None else encode_frame(row.mid, data))
        device.advance(pause)
    device.advance(1.0)
    device.power_cycle()
    device.advance(0.1)
    device.read()
    assert mids(exchange(device, frame("GoToConfig"))) == [MessageId.GoToConfigAck]


#: Bytes that a host can send by mistake: noise, preambles, and incomplete frames.
GARBAGE = st.one_of(
    st.binary(min_size=1, max_size=300),
    st.integers(1, 300).map(lambda count: b"\xfa" * count),
    st.tuples(st.integers(0, 255), st.integers(0, 254)).map(
        lambda header: bytes([0xFA, 0xFF, *header])
    ),
    st.integers(0, 0xFFFF).map(lambda length: b"\xfa\xff\x36\xff" + length.to_bytes(2, "big")),
    st.sampled_from(REQUESTS).map(lambda row: encode_frame(row.mid, bytes(20))[:-1]),
)


@given(
    st.sampled_from(sorted(PRODUCTS)),
    st.sampled_from([None, 115_200]),
    st.sampled_from([0.1, 0.5, 1.0]),
    st.lists(st.tuples(GARBAGE, st.sampled_from([0.0, 0.001, 0.05, 0.2])), min_size=1),
)
def test_garbage_does_not_hide_a_later_request(
    product: int, rate: int | None, start: float, pieces: list[tuple[bytes, float]]
) -> None:
    """GoToConfig is answered a tenth of a second after garbage."""
    device = SimulatedDevice(product, baudrate=rate)
    device.advance(start)
    for data, pause in pieces:
        device.write(data)
        device.advance(pause)
    device.advance(0.1)
    device.read()
    device.write(frame("GoToConfig"))
    # EmtsData takes more than a tenth of a second.
    device.advance(0.3)
    found = mids(device.read())
    assert [mid for mid in found if mid != MessageId.MTData2][-1:] == [MessageId.GoToConfigAck]
    assert device.state is State.CONFIG


@pytest.mark.parametrize("size", [1, 7, 4096])
@pytest.mark.parametrize("pause", [0.0, 0.001])
def test_garbage_uses_no_memory(size: int, pause: float) -> None:
    """Memory use is bounded for any bytes in any pieces, incomplete frames included."""
    rng = np.random.default_rng(1)
    pieces = [rng.integers(0, 256, size, np.uint8).tobytes(), bytes.fromhex("FAFF00FF0800") * size]
    device = configurable(630)
    device.write(pieces[0])

    def run() -> None:
        for count in range(10_000 // size + 10):
            device.write(pieces[count % 2])
            device.advance(pause)
            device.read()

    tracemalloc.start()
    try:
        run()  # caches fill in the first run
        before, _ = tracemalloc.get_traced_memory()
        run()
        after, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert after - before < 10_000


def test_a_header_of_more_than_2048_bytes_is_skipped() -> None:
    wire = bytes.fromhex("FA FF 00 FF 08 01") + frame("GoToConfig")
    assert exchange(configurable(630), wire) == frame("GoToConfigAck")


def test_usb_works_at_any_rate() -> None:
    device = configurable(630)
    assert (device.is_serial, device.baudrate) == (False, 115_200)
    device.write(frame("GoToConfig"), baudrate=9600)
    assert device.read(baudrate=4800) == frame("GoToConfigAck")


def test_a_serial_line_needs_the_right_rate() -> None:
    device = configurable(630, baudrate=921_600)
    assert (device.is_serial, device.baudrate) == (True, 921_600)
    device.write(frame("GoToConfig"), baudrate=115_200)
    device.advance(0.2)
    assert device.read() == b""
    device.write(frame("GoToConfig"), baudrate=921_600)
    device.advance(0.01)
    heard = device.read(baudrate=115_200)
    assert heard != frame("GoToConfigAck")
    assert len(heard) == 5
    device.write(frame("GoToConfig"))
    device.advance(0.01)
    assert device.read(baudrate=921_600) == frame("GoToConfigAck")


@pytest.mark.parametrize("product", ["MTi-3", "MTi-300", "MTi-630", "MTi-680G"])
def test_a_new_rate_is_used_after_the_next_start(product: str) -> None:
    device = configurable(product, baudrate=115_200)
    assert ask(device, "SetBaudrate", 0x80) is None
    assert ask(device, "ReqBaudrate") == 0x80
    assert device.baudrate == 115_200
    # The reply comes at the old rate.
    device.write(frame("Reset"), baudrate=115_200)
    device.advance(0.01)
    assert device.read(baudrate=115_200) == frame("ResetAck")
    device.advance(0.1)
    assert device.baudrate == 921_600
    assert device.read(baudrate=921_600) == WAKE_UP


def test_a_port_setting_changes_the_rate() -> None:
    """On the 600-series the ports have rates, and SetBaudrate sets those of the Xbus ports."""
    device = configurable("MTi-680G", baudrate=115_200)
    ports = ask(device, "ReqPortConfig")
    assert [(port.protocol, port.baudrate) for port in ports] == [
        (1, 115_200),
        (0, 460_800),
        (6, 38_400),
    ]
    ask(device, "SetBaudrate", 0x80)
    changed = ask(device, "ReqPortConfig")
    assert [int(port) for port in changed] == [0x0001_0080, 0, 0x0006_0005]
    ask(device, "SetPortConfig", [PortConfig(PortProtocol.XBUS, 0x0C), *changed[1:]])
    assert ask(device, "ReqBaudrate") == 0x0C
    reset(device)
    assert device.baudrate == 2_000_000


def test_an_unsupported_rate_is_refused() -> None:
    with pytest.raises(
        ValueError, match="the MTi-300 does not support 2,000,000 baud; use one of 4,8"
    ):
        SimulatedDevice(300, baudrate=2_000_000)


def test_a_fast_line_loses_nothing() -> None:
    """115,200 baud are 11,520 bytes per second. A frame arrives with its last byte."""
    device = measuring(configurable(630, baudrate=115_200))
    device.read()
    device.advance(0.955)
    assert (device.lost, len(device.read()) % 43) == (0, 0)
    size = len(encode_frame(MessageId.MTData2, bytes(38)))
    device.advance(0.005 + 10 * (size - 1) / 115_200)
    assert device.read() == b""
    device.advance(10 / 115_200)
    assert len(device.read()) == size


def test_a_slow_line_loses_samples_and_reports_it() -> None:
    """Whole samples are lost, their counter shows it, and Error 41 is sent once a second."""
    device = measuring(configurable(630, baudrate=9600), DataId.PacketCounter, Output(0x4020, 400))
    device.read()
    device.advance(5)
    data = device.read()
    assert 4750 < len(data) < 4850
    log = xbus.read_log(data)
    assert log.stats.skipped_bytes < 25  # the frame at the end
    steps = np.diff(log["packet_counter"].values.astype(int))
    assert (steps.min(), steps.sum() > 1000) == (1, True)
    errors = log.messages
    assert {error.payload for error in errors} == {bytes([41])}
    assert 3 <= len(errors) <= 5
    assert device.lost > 1500


def test_restore_communication() -> None:
    """Section 7.2: the device then uses 115,200 baud, and the settings of Table 41 are restored."""
    device = configurable(3, baudrate=9600)
    ask(device, "SetOutputConfiguration", [Output(DataId.Acceleration, 10)])
    ask(device, "SetSyncSettings", [sync(LATEST, SyncLine.SOFTWARE)])
    ask(device, "SetLocationID", 5)
    device.power_cycle()
    for _ in range(60):
        device.write(b"\xde", baudrate=115_200)
        device.advance(0.0005)
    device.advance(0.1)
    assert device.read(baudrate=115_200) == WAKE_UP
    device.write(ACK, baudrate=115_200)
    assert ask(device, "ReqOutputConfiguration") == support(3).output_configuration
    assert ask(device, "ReqSyncSettings") is None  # no entries
    assert ask(device, "ReqBaudrate") == 2
    assert ask(device, "ReqLocationID") == 5


@pytest.mark.parametrize("rate", [9600, 921_600])
def test_restore_communication_at_another_rate(rate: int) -> None:
    device = configurable(3, baudrate=9600)
    device.power_cycle()
    device.write(RESTORE, baudrate=rate)
    device.advance(0.1)
    assert device.baudrate == 9600


def test_restore_communication_works_during_boot_only() -> None:
    device = configurable(300)
    ask(device, "SetPeriod", 500)
    assert exchange(device, RESTORE) == b""
    reset(device)
    assert ask(device, "ReqPeriod") == 500


def test_a_pulled_plug_loses_bytes() -> None:
    device = measuring(configurable(630))
    device.advance(0.1)
    device.unplug()
    assert (device.plugged, device.read()) == (False, b"")
    device.advance(0.1)
    device.write(frame("GoToConfig"))
    assert device.state is State.MEASUREMENT
    device.plug()
    device.advance(0.1)
    log = xbus.read_log(device.read())
    assert (device.plugged, log["packet_counter"].values[0]) == (True, 20)


def test_faults_damage_the_line() -> None:
    device = SimulatedDevice(630, faults=Faults(burst=0.016, unplug=(1.0, 1.0)))
    device.advance(0.6)
    device.read()
    sizes = []
    for _ in range(200):
        device.advance(0.001)
        sizes.append(len(device.read()))
    assert 11 <= sum(size > 0 for size in sizes) <= 13
    assert device.plugged
    device.advance(1)
    assert (device.plugged, device.read()) == (False, b"")
    device.advance(0.5)
    assert device.plugged
    device.read()
    device.advance(0.1)
    assert len(xbus.read_log(device.read())) in range(9, 13)


# ---------------------------------------------------------------------------------------------
# Measurement
# ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("product", PRODUCTS)
def test_the_default_outputs_are_sent(product: int) -> None:
    device = measuring(configurable(product, time_to_fix=0.0))
    log = log_of(device, 1.0)
    assert len(log) == 100
    assert set(log.keys()) >= {"packet_counter", "sample_time_fine", "status_word"}
    assert log["packet_counter"].values.tolist() == list(range(100))
    assert set(np.diff(log["sample_time_fine"].values.astype(int))) == {100}


def test_without_outputs_no_samples_are_sent() -> None:
    device = configurable(630)
    ask(device, "SetOutputConfiguration", [])
    measuring(device)
    device.advance(5)
    assert device.read() == b""


@pytest.mark.parametrize("product", ["MTi-300", "MTi-630"])
def test_strings_replace_samples(product: str) -> None:
    device = configurable(product)
    ask(
        device,
        "SetStringOutputType",
        StringOutput(StringType.HCMTW, 10 if product == "MTi-630" else None),
    )
    log = log_of(measuring(device), 1)
    assert len(log) == 0
    assert log.strings.counts == {"HCMTW": 10 if product == "MTi-630" else 100}
    ask(device, "GoToConfig")
    ask(device, "SetStringOutputType", StringOutput(StringType(0)))
    assert len(log_of(measuring(device), 1)) == 100


def test_sample_times_start_at_power_up() -> None:
    device = measuring(configurable(630))
    device.advance(5)
    device.power_cycle()
    device.advance(1)
    log = xbus.read_log(device.read()[-100:])
    assert log["sample_time_fine"].values[-1] == 10_000


def test_the_size_of_time_steps_has_no_effect() -> None:
    outputs: list[Output | int] = [
        DataId.PacketCounter, DataId.SampleTimeFine, DataId.UtcTime, Output(0x2010, 80),
        Output(0x4040, 2000), Output(DataId.GnssPvtData), DataId.StatusWord,
    ]  # fmt: skip

    def run(steps: Iterable[float], rate: int | None) -> bytes:
        device = configurable(680, noise=1.0, time_to_fix=0.5, baudrate=rate)
        measuring(device, *outputs)
        device.write(frame("SetNoRotation", 1))
        found = b""
        for step in steps:
            device.advance(step)
            found += device.read()
        return found

    for rate in (None, 115_200):
        whole = run([2.0], rate)
        assert run([0.01] * 200, rate) == whole
        assert run([0.0, 0.333_333_333, 0.000_000_001, 1.666_666_666], rate) == whole
        assert run([0.0007] * 2857 + [0.0001], rate) == whole


def test_time_cannot_go_back() -> None:
    with pytest.raises(ValueError, match="0 seconds or more, not -1"):
        SimulatedDevice(630).advance(-1)


@pytest.mark.parametrize("product", PRODUCTS)
def test_the_status_word_follows_the_product_and_the_fix(product: int) -> None:
    """Table 27, before and after the fix."""
    device = measuring(configurable(product, time_to_fix=1.0))
    words = log_of(device, 2.0)["status_word"].values
    numbers = {row.name: flag(words[[1, -1]], row.name) for row in STATUS_FLAGS.values()}
    flags = {name: value for name, value in numbers.items() if any(value)}
    expected = {} if PRODUCTS[product].series == "600-series" else {"selftest": [1, 1]}
    if product in GNSS_NUMBERS:
        fix = ["filter_valid", "gnss_fix", "clock_bias_estimation", "have_gnss_time_pulse"]
        expected |= {name: [0, 1] for name in fix} | {"filter_mode": [0, 3]}
    elif product not in IMU_NUMBERS:
        expected |= {"filter_valid": [1, 1]}
    assert flags == expected
    # In the first sample only.
    assert flag(words, "filter_input_start") == [1] + [0] * (len(words) - 1)


def test_alignment_rotations_rotate_measurements() -> None:
    device = configurable(630, trajectory="tumble")
    local, sensor = (0.6, 0.0, 0.8, 0.0), (0.0, 0.0, 0.6, -0.8)
    ask(device, "SetAlignmentRotation", AlignmentRotation(Alignment.ROT_LOCAL, local))
    ask(device, "SetAlignmentRotation", AlignmentRotation(Alignment.ROT_SENSOR, sensor))
    found = log_of(measuring(device), 1.0)["quaternion"].values
    plain = log_of(measuring(configurable(630, trajectory="tumble")), 1.0)["quaternion"].values
    turned = quaternion.multiply(np.array(local), quaternion.multiply(plain, np.array(sensor)))
    assert np.abs(np.abs((found * turned).sum(axis=1)) - 1).max() < 1e-6


def angles(device: SimulatedDevice) -> list[float]:
    """Returns roll, pitch and yaw of the next sample."""
    return [round(float(value), 3) for value in log_of(device, 0.01)["euler_angles"].values[0]]


class Tilted:
    """A trajectory at rest with roll 10, pitch 20 and yaw 30 degrees."""

    origin = LatLonAlt(52.0, 6.0, 0.0)

    def at(self, time: Any) -> Any:
        q = np.tile(quaternion.from_euler([10.0, 20.0, 30.0]), (len(time), 1))
        return replace(trajectory("still").at(time), orientation=q)


def tilted(product: str = "MTi-630") -> SimulatedDevice:
    device = configurable(product, trajectory=Tilted())
    return measuring(device, DataId.PacketCounter, Output(DataId.EulerAngles, 100))


@pytest.mark.parametrize(
    ("code", "after"),
    [
        (ResetCode.HEADING, [10, 20, 0]),
        (ResetCode.INCLINATION, [0, 0, 30]),
        (ResetCode.ALIGNMENT, [0, 0, 0]),
        (ResetCode.DEFAULT_HEADING, [10, 20, 30]),
    ],
)
def test_an_orientation_reset_changes_the_output(code: ResetCode, after: list[float]) -> None:
    """Table 33: a reset acts at once, until the next Measurement. Stored in Config it persists."""
    device = tilted()
    assert angles(device) == [10, 20, 30]
    assert ask(device, "ResetOrientation", code) is None
    assert angles(device) == after
    # The reset is discarded.
    ask(device, "GoToConfig")
    measuring(device)
    assert angles(device) == [10, 20, 30]
    # The reset is stored.
    ask(device, "ResetOrientation", code)
    device.advance(0.1)
    device.read()
    ask(device, "GoToConfig")
    assert ask(device, "ResetOrientation", ResetCode.STORE) is None
    reset(device)
    assert angles(measuring(device)) == after
    ask(device, "ResetOrientation", ResetCode.DEFAULT_ALIGNMENT)
    assert angles(device) == [10, 20, 30]


def test_resets_can_follow_each_other() -> None:
    device = tilted()
    for code, after in [
        (ResetCode.INCLINATION, [0, 0, 30]),
        (ResetCode.HEADING, [0, 0, 0]),
        (ResetCode.DEFAULT_HEADING, [0, 0, 30]),
        (ResetCode.ALIGNMENT, [0, 0, 0]),
        (ResetCode.DEFAULT_INCLINATION, [10, 20, 0]),
        (ResetCode.DEFAULT_ALIGNMENT, [10, 20, 30]),
    ]:
        ask(device, "ResetOrientation", code)
        assert angles(device) == after


def test_a_reset_is_not_stored_over_a_newer_setting() -> None:
    device = tilted()
    ask(device, "ResetOrientation", ResetCode.ALIGNMENT)
    ask(device, "GoToConfig")
    rotation = AlignmentRotation(Alignment.ROT_LOCAL, Q)
    ask(device, "SetAlignmentRotation", rotation)
    ask(device, "ResetOrientation", ResetCode.STORE)
    assert ask(device, "ReqAlignmentRotation", Alignment.ROT_LOCAL) == rotation


def test_invalid_resets_are_refused() -> None:
    device = tilted("MTi-670")
    assert ask(device, "ResetOrientation", ResetCode.HEADING) == f"error {PARAMETER}"
    assert ask(device, "ResetOrientation", ResetCode.STORE) == f"error {MESSAGE}"
    assert ask(device, "ResetOrientation", ResetCode.INCLINATION) is None


def test_storing_without_a_reset_changes_nothing() -> None:
    device = configurable(630)
    before = device.settings
    assert ask(device, "ResetOrientation", ResetCode.STORE) is None
    assert device.settings == before


@pytest.mark.parametrize(("trajectory", "outcome"), [("still", 0), ("turn", 2)])
def test_a_no_rotation_update_needs_a_device_at_rest(trajectory: str, outcome: int) -> None:
    """SetNoRotation is acknowledged at once; the status word has the result."""
    device = measuring(configurable(300, trajectory=trajectory))
    assert ask(device, "SetNoRotation", 2) is None
    found = flag(log_of(device, 4.0)["status_word"].values, "no_rotation_update_status")
    assert found == [3] * 200 + [outcome] * 200


def test_a_no_rotation_update_can_restart_or_end_early() -> None:
    device = measuring(configurable(300, trajectory="still"))
    ask(device, "SetNoRotation", 2)
    device.advance(1)
    ask(device, "SetNoRotation", 2)
    device.advance(1.5)
    assert device.read()
    assert set(flag(log_of(device, 0.4)["status_word"].values, "no_rotation_update_status")) == {3}
    ask(device, "GoToConfig")
    measuring(device)
    assert set(flag(log_of(device, 3)["status_word"].values, "no_rotation_update_status")) == {2}
    assert ask(device, "SetNoRotation", 0) == f"error {PARAMETER}"


def test_representative_motion_sets_its_flag() -> None:
    device = measuring(configurable(300, trajectory="tumble"))
    assert ask(device, "IccCommand", IccCommand.STATE) == IccReply(IccCommand.STATE, active=False)
    assert ask(device, "IccCommand", IccCommand.STOP) == f"error {MESSAGE}"
    assert ask(device, "IccCommand", IccCommand.STORE) == f"error {MESSAGE}"
    assert ask(device, "IccCommand", IccCommand.START) == IccReply(IccCommand.START)
    assert ask(device, "IccCommand", IccCommand.STATE) == IccReply(IccCommand.STATE, active=True)
    words = log_of(device, 30.0)["status_word"].values
    assert set(flag(words, "representative_motion")) == {1}
    result = ask(device, "IccCommand", IccCommand.STOP).result
    assert result.ddt > 1
    assert (result.dimension, result.status) == (3, IccStatus(0))
    words = log_of(device, 1.0)["status_word"].values
    assert set(flag(words, "representative_motion")) == {0}
    ask(device, "GoToConfig")
    assert ask(device, "IccCommand", IccCommand.STORE) == IccReply(IccCommand.STORE)


@pytest.mark.parametrize(
    ("trajectory", "seconds", "dimension", "status"),
    [
        ("turn", 20.0, 2, IccStatus(0)),
        ("turn", 5.0, 2, IccStatus.NOT_ENOUGH_DATA),
        ("still", 60.0, 2, IccStatus.NOT_ENOUGH_DATA),
    ],
)
def test_results_of_representative_motion_depend_on_the_motion(
    trajectory: str, seconds: float, dimension: int, status: IccStatus
) -> None:
    device = measuring(configurable(300, trajectory=trajectory))
    ask(device, "IccCommand", IccCommand.START)
    device.advance(seconds)
    device.read()
    result = ask(device, "IccCommand", IccCommand.STOP).result
    assert (result.dimension, result.status) == (dimension, status)


# ---------------------------------------------------------------------------------------------
# Synchronization
# ---------------------------------------------------------------------------------------------

SAMPLE = (DataId.PacketCounter, DataId.SampleTimeFine, Output(0x4020, 100), DataId.StatusWord)


def synced(
    product: int, *settings: SyncSetting, outputs: Any = SAMPLE, **options: Any
) -> SimulatedDevice:
    device = configurable(product, **options)
    assert ask(device, "SetSyncSettings", settings) is None
    return measuring(device, *outputs)


@pytest.mark.parametrize("product", [3, 300, 630])
def test_req_data_sends_the_newest_sample(product: int) -> None:
    """With SendLatest on the software line, samples are sent on request only."""
    device = synced(product, sync(LATEST, SyncLine.SOFTWARE))
    device.advance(1.0)
    assert device.read() == b""
    log = xbus.read_log(exchange(device, frame("ReqData") * 2))
    assert log["packet_counter"].values.tolist() == [0, 1]
    assert set(log["sample_time_fine"].values) == {11_000}
    assert flag(log["status_word"].values, "filter_input_start") == [1, 0]


def test_req_data_without_send_latest_sends_nothing() -> None:
    device = measuring(configurable(630))
    assert exchange(device, frame("ReqData")) == b""
    ask(device, "GoToConfig")
    assert ask(device, "ReqData") == f"error {MESSAGE}"


def test_pvt_data_is_sent_once() -> None:
    """Table 11."""
    outputs = (DataId.PacketCounter, Output(DataId.GnssPvtData))
    device = synced(670, sync(LATEST, SyncLine.SOFTWARE), outputs=outputs)
    device.advance(1.0)
    assert len(xbus.read_log(exchange(device, frame("ReqData") * 3))) == 1
    device.advance(0.25)
    assert len(xbus.read_log(exchange(device, frame("ReqData") * 3))) == 1


def test_an_edge_with_send_latest_sends_a_sample() -> None:
    """The sample is sent after the delay. Other edges and lines have no effect."""
    device = synced(630, sync(LATEST, SyncLine.IN2, Polarity.FALLING, offset=50))
    device.trigger(SyncLine.IN2)
    device.trigger(SyncLine.IN1, rising=False)
    device.advance(0.02)
    assert device.read() == b""
    device.trigger(SyncLine.IN2, rising=False)
    device.advance(0.0049)
    assert device.read() == b""
    assert len(log_of(device, 0.0002)) == 1


@pytest.mark.parametrize(
    ("options", "count"),
    [
        ({}, [0, 1, 2, 3, 4, 5, 6, 7, 8]),
        ({"skip_first": 2}, [2, 3, 4, 5, 6, 7, 8]),
        ({"skip_factor": 2}, [0, 3, 6]),
        ({"skip_first": 1, "skip_factor": 3}, [1, 5]),
        ({"trigger_once": True}, [0]),
        ({"trigger_once": True, "skip_first": 4}, [4]),
    ],
)
def test_the_setting_decides_which_edges_trigger(options: dict[str, Any], count: list[int]) -> None:
    """Table 9."""
    device = synced(300, sync(LATEST, SyncLine.IN1, Polarity.BOTH, **options))
    found = []
    for i in range(9):
        device.trigger(SyncLine.IN1, rising=bool(i % 2))
        device.advance(0.01)
        found += [i] * len(xbus.read_log(device.read()))
    assert found == count


def test_the_600_series_sends_triggers_as_data() -> None:
    """The trigger is a separate message, with microseconds and without a counter."""
    outputs = (*SAMPLE, DataId.TriggerIn1, DataId.TriggerIn2)
    device = synced(
        630,
        sync(TRIGGER, SyncLine.IN1),
        sync(TRIGGER, SyncLine.IN2, Polarity.BOTH),
        outputs=outputs,
    )
    device.advance(0.1052)
    device.trigger(SyncLine.IN1)
    device.trigger(SyncLine.IN1, rising=False)
    device.trigger(SyncLine.IN2, rising=False)
    device.advance(0.1)
    data = device.read()
    assert bytes.fromhex("FA FF 36 0B 48 10 08 02 01") in data
    log = xbus.read_log(data)
    assert log["packet_counter"].values.tolist() == list(range(20))
    assert [log[name].values[0].tolist() for name in ("trigger_in1", "trigger_in2")] == [
        (2, 1, 205_200, 0),
        (9, 0, 205_200, 0),
    ]


def test_a_trigger_that_is_not_an_output_is_not_sent() -> None:
    device = synced(630, sync(TRIGGER, SyncLine.IN1))
    device.trigger(SyncLine.IN1)
    device.trigger(99)
    assert "trigger_in1" not in log_of(device, 0.1)


def test_older_series_set_a_status_flag_for_a_trigger() -> None:
    """The next sample has the SyncIn marker."""
    device = synced(300, sync(TRIGGER, SyncLine.IN1))
    device.advance(0.1)
    device.read()
    device.trigger(SyncLine.IN1)
    assert flag(log_of(device, 0.05)["status_word"].values, "sync_in_marker") == [1, 0, 0, 0, 0]


def test_clock_bias_estimation_needs_a_reference_clock_on_time() -> None:
    """The reference clock must have the configured period within 0.5 %."""
    device = synced(630, sync(CLOCK, SyncLine.IN1, offset=100))
    found = []
    for pause in (0.1, 0.1, 0.1003, 0.11, 0.1, 0.1):
        device.trigger(SyncLine.IN1)
        words = log_of(device, pause)["status_word"].values
        found.append(flag(words, "clock_bias_estimation")[-1])
    assert found == [0, 1, 1, 1, 0, 1]
    words = log_of(device, 0.5)["status_word"].values
    assert flag(words, "clock_bias_estimation") == [1] * 10 + [0] * 40


# ---------------------------------------------------------------------------------------------
# Time and GNSS
# ---------------------------------------------------------------------------------------------


def utc_of(device: SimulatedDevice) -> str:
    utc = ask(device, "ReqUTCTime")
    date = f"{utc.year}-{utc.month:02}-{utc.day:02} {utc.hour:02}:{utc.minute:02}"
    return f"{date}:{utc.second + utc.ns / 1e9:07.4f} {utc.valid}"


def test_utc_without_gnss_is_that_of_the_calendar() -> None:
    """The calendar keeps the time that is set, until the next power-up."""
    device = configurable(630, utc=np.datetime64("2024-02-29T23:59:59", "ns"))
    assert utc_of(device) == "2024-02-29 23:59:59.1000 0"
    device.advance(1.5)
    assert utc_of(device) == "2024-03-01 00:00:00.6000 0"
    ask(device, "SetUTCTime", UtcTime(250_000_000, 2030, 12, 31, 23, 59, 59))
    assert utc_of(device) == "2030-12-31 23:59:59.2500 0"
    ask(device, "AdjustUTCTime", 10_000)
    assert utc_of(device) == "2031-01-01 00:00:00.2500 0"
    ask(device, "AdjustUTCTime", -1)
    assert utc_of(device) == "2031-01-01 00:00:00.2499 0"
    measuring(device, DataId.UtcTime, Output(0x4020, 100))
    row = log_of(device, 0.01)["utc_time"].values[0]
    assert row.tolist() == (259_900_000, 2031, 1, 1, 0, 0, 0, 0)
    device.power_cycle()
    device.advance(0.1)
    device.read()
    device.write(ACK)
    assert utc_of(device) == "2024-02-29 23:59:59.1000 0"


def test_utc_with_gnss_is_that_of_the_receiver() -> None:
    """GNSS corrects the calendar (SetUTCTime)."""
    device = configurable(670, utc=UTC, time_to_fix=2.0)
    ask(device, "SetUTCTime", UtcTime(0, 2040, 1, 1, 0, 0, 0))
    assert utc_of(device).startswith("2040-01-01")
    device.advance(2)
    assert utc_of(device).startswith("2020-01-01 00:00:02.1000 7")
    ask(device, "SetUTCTime", UtcTime(0, 2040, 1, 1, 0, 0, 0))
    assert utc_of(device).startswith("2020-01-01 00:00:02.1000 7")


def test_position_and_flags_need_a_fix() -> None:
    """Position comes with the fix. After a power cycle the fix takes the same time again."""
    device = measuring(configurable(710, time_to_fix=1.5))
    log = log_of(device, 2.9)
    assert (len(log), len(log["lat_lon"])) == (290, 151)
    device.power_cycle()
    device.advance(1.0)
    assert "lat_lon" not in xbus.read_log(device.read())
    assert "lat_lon" in log_of(device, 1.0)


def test_without_an_antenna_the_fix_is_lost() -> None:
    """Table 27: coasting for a minute, then without GNSS, until the next fix."""
    device = configurable(710, time_to_fix=1.0)
    measuring(
        device,
        DataId.PacketCounter,
        Output(0x2010, 10),
        Output(DataId.GnssPvtData),
        DataId.StatusWord,
    )
    device.advance(2.0)
    found = []
    for connected, seconds in [(True, 1.0), (False, 59.0), (False, 1.0), (True, 0.5), (True, 1.0)]:
        device.connect_antenna(connected)
        device.advance(seconds)
        device.read()
        log = log_of(device, 0.5)
        word = log["status_word"].values[-1:]
        fix_type = int(log["gnss_pvt_data"].values["fixtype"][-1])
        found.append((*flag(word, "gnss_fix"), *flag(word, "filter_mode"), fix_type))
    assert found == [(1, 3, 3), (0, 1, 0), (0, 0, 0), (0, 0, 0), (1, 3, 3)]


def test_there_is_no_fix_after_a_start_without_an_antenna() -> None:
    device = configurable(710)
    device.connect_antenna(False)
    device.power_cycle()
    log = log_of(device, 10.0)
    assert set(flag(log["status_word"].values, "filter_mode")) == {0}
    assert "lat_lon" not in log


RTCM = bytes.fromhex("D300133ED7D30202980EDEEF34B4BD62AC0941986F33360B98")


def rtk(device: SimulatedDevice, seconds: float) -> list[int]:
    """Returns the RTK status at the end of each second; the PVT data must have the same."""
    found = []
    for _ in range(round(seconds)):
        log = log_of(device, 1.0)
        found.append(flag(log["status_word"].values, "rtk_status")[-1])
        assert log["gnss_pvt_data"].values["flags"][-1] >> 6 == found[-1]
    return found


def test_corrections_lead_to_an_rtk_fix() -> None:
    """RTCM 3 leads to RTK float and then RTK fixed, as long as corrections arrive."""
    device = configurable(680, time_to_fix=0.0)
    measuring(
        device,
        DataId.PacketCounter,
        Output(0x2010, 100),
        Output(DataId.GnssPvtData),
        DataId.StatusWord,
    )
    assert rtk(device, 3) == [0, 0, 0]
    found = []
    for _ in range(12):
        # Corrections can arrive in any pieces, between other bytes.
        assert ask(device, "ForwardGnssData", b"\xb5\x62\xd3" + RTCM[:5]) is None
        assert ask(device, "ForwardGnssData", RTCM[5:]) is None
        found += rtk(device, 1)
    assert found == [0, 0, 1, 1, 1, 1, 1, 1, 2, 2, 2, 2]
    assert rtk(device, 12) == [2] * 9 + [0] * 3


def test_bytes_that_are_not_rtcm_have_no_effect() -> None:
    device = configurable(680, time_to_fix=0.0)
    measuring(
        device,
        DataId.PacketCounter,
        Output(0x2010, 100),
        Output(DataId.GnssPvtData),
        DataId.StatusWord,
    )
    for _ in range(5):
        ask(device, "ForwardGnssData", RTCM[:-1] + b"\0" + bytes(50))
        assert rtk(device, 1) == [0]


# ---------------------------------------------------------------------------------------------
# A recording
# ---------------------------------------------------------------------------------------------


def test_replay() -> None:
    recording = OWN_CAPTURES / "walk.mtb"
    device = configurable("MTi-680G", replay=Replay(recording))
    log = log_of(measuring(device), 20.0)
    whole = xbus.read_log(recording)
    assert (log["quaternion"].values == whole["quaternion"].values).all()
    device.write(frame("GoToConfig"))
    device.read()
    assert ask(device, "ReqProductCode") == whole.identity.product_code
    assert len(log_of(measuring(device), 1.0)) == pytest.approx(100, abs=10)
