"""Message payloads: decoding to values, and encoding.

The payloads are the manual's own, those of real devices and of MT Manager where one was published, and else
made by hand from the manual's tables.
"""

from __future__ import annotations

import contextlib
import dataclasses
import math
import random
import re
from typing import Any, cast

import pytest
from hypothesis import given
from hypothesis import strategies as st

from conftest import shared
from xbus import Configuration, Message, Scanner
from xbus.describe.text import describe_message, value_text
from xbus.protocol import (
    EVERY,
    Alignment,
    AlignmentRotation,
    AvailableProfile,
    CanConfig,
    CanDataId,
    CanOutput,
    DeviceErrorInfo,
    DeviceWarning,
    ExtOutputMode,
    FilterProfile,
    GnssChannel,
    GnssLeverArm,
    GnssPlatform,
    GnssReceiver,
    GnssReceiverSettings,
    HardwareVersion,
    IccCommand,
    IccReply,
    IccResult,
    IccStatus,
    LatLonAlt,
    OptionFlag,
    OptionFlags,
    Output,
    OutputMode,
    OutputSettings,
    Polarity,
    PortConfig,
    PortProtocol,
    ResetCode,
    Selftest,
    StringOutput,
    StringType,
    SyncFunction,
    SyncLine,
    SyncSetting,
    UtcTime,
    baud_code,
    baudrate,
    decode,
    encode,
)
from xbus.protocol.configuration import Firmware
from xbus.protocol.layout import NOTHING, RAW
from xbus.protocol.messages import LAYOUTS
from xbus.protocol.tables import MESSAGES
from xbus.protocol.values import BAUD_CODES, CAN_BAUD_CODES

# ---------------------------------------------------------------------------------------------
# The value of each message
# ---------------------------------------------------------------------------------------------

#: MTi-630 of a public log, as recorded by the host; the manual calls the end reserved.
CONFIGURATION_630 = Configuration(
    device_id=0x8000_40D2, product_code="MTi-630-8A1G6", sampling_period=None, output_skip_factor=None,
    date="20240211", time="13285700", devices=1, filter_profile=0, firmware=Firmware(1, 6, 0),
)  # fmt: skip
CONFIGURATION_300 = Configuration(
    device_id=0x0370_03F8, product_code=None, sampling_period=1152, output_skip_factor=0, date=None,
    time=None, devices=1, filter_profile=39, firmware=Firmware(1, 8, 2), output_mode=0,
    output_settings=1, filter_type="I", filter_version=(5, 1),
)  # fmt: skip
CONFIGURATION_30 = dataclasses.replace(
    CONFIGURATION_300, device_id=0x0360_048E, sampling_period=576, firmware=Firmware(1, 4, 1),
    output_mode=6, output_settings=0, filter_version=(2, 0),
)  # fmt: skip
CONFIGURATION_710 = dataclasses.replace(
    CONFIGURATION_300, device_id=0x0770_10E6, filter_profile=4, firmware=Firmware(1, 4, 12),
    output_mode=0x36, output_settings=3, filter_type="7", filter_version=(4, 1),
)  # fmt: skip
CONFIGURATION_700 = dataclasses.replace(
    CONFIGURATION_300, device_id=0x0770_045E, filter_profile=1, firmware=Firmware(1, 4, 5),
    filter_type="7", filter_version=(3, 0),
)  # fmt: skip
CONFIGURATION_7 = dataclasses.replace(
    CONFIGURATION_300, device_id=0x0788_1322, sampling_period=0, date="20210828", time="10004300",
    filter_profile=13, firmware=Firmware(1, 14, 0), output_settings=0, filter_type=None,
    filter_version=(0, 0),
)  # fmt: skip

#: What the manual's section 6 asks for.
OUTPUTS = (
    Output(0x1020), Output(0x1060), Output(0x2010, 100), Output(0x4020, 400), Output(0x8020, 400),
    Output(0xC020, 100), Output(0xE020), Output(0x5042, 100), Output(0x5022, 100), Output(0xD012, 100),
)  # fmt: skip
OUTPUTS_HEX = (
    """1020FFFF 1060FFFF 20100064 40200190 80200190 C0200064 E020FFFF 50420064 50220064 D0120064"""
)
#: A configuration that was sent to an MTi-630, and its reply.
ASKED = (
    *(Output(value, 400) for value in (0x1060, 0x4020, 0x8020, 0x2030, 0xE020)),
    Output(0x4810),
)
GIVEN = tuple(
    item._replace(frequency=EVERY) if item.data_id in (0x1060, 0xE020) else item for item in ASKED
)
#: The sync settings of an MTi-7: its receiver's clock, and 50 ms pulses.
SYNC_7 = (
    SyncSetting(SyncFunction.CLOCK_BIAS_ESTIMATION, SyncLine.GNSS_CLOCK_IN, offset=1000),
    SyncSetting(SyncFunction.GNSS_1PPS, SyncLine.GNSS_1PPS, pulse_width=500),
)
SYNC_7_HEX = "09010100 0000 0000 0000 03E8 0E080100 0000 0000 01F4 0000"
PULSE = SyncSetting(
    SyncFunction.INTERVAL_TRANSITION_MEASUREMENT, SyncLine.SYNC_OUT, Polarity.BOTH,
    trigger_once=True, skip_first=1, skip_factor=3, pulse_width=10, offset=-300,
)  # fmt: skip
DELAYED = SyncSetting(SyncFunction.SEND_LATEST, SyncLine.IN1, Polarity.FALLING, offset=60_000)
XBUS_921600 = PortConfig(PortProtocol.XBUS, 0x80)
NO_PORT = PortConfig(PortProtocol.NONE, 0)
#: The ports of a published MTi-680G: Xbus with flow control, nothing, corrections.
PORTS_680 = (
    PortConfig(PortProtocol.XBUS, 2, flow_control=True), NO_PORT, PortConfig(PortProtocol.RTCM, 5),
)  # fmt: skip
CAN = (
    CanOutput(CanDataId.QUATERNION, extended=False, can_id=0x21, frequency=100),
    CanOutput(CanDataId.UTC_TIME, extended=True, can_id=0x1ABC_DEF0, frequency=0x7FF),
)
CAN_HEX = "21 00 00000021 0064  07 01 1ABCDEF0 07FF"
NOON = UtcTime(500_000_000, 2026, 11, 22, 12, 0, 59, 7)
NOON_HEX = "1DCD6500 07EA 0B 16 0C 00 3B 07"
HERE = LatLonAlt(52.24049169408207, 6.838216771186439, 0)
HERE_HEX = "404A1EC86E8C8564 401B5A557F4CD161 0000000000000000"
IDENTITY = AlignmentRotation(Alignment.ROT_SENSOR, (1, 0, 0, 0))
LOCAL = AlignmentRotation(Alignment.ROT_LOCAL, (1, 0, 0, 0))
ONE_AND_ZEROS = "3F800000 00000000 00000000 00000000"
ARM = GnssLeverArm(0.5, -1, 0.25)
#: What a published MTi-680G was set to.
ZED = GnssReceiverSettings(GnssReceiver.ZED_F9P, 1, 4)
ROBUST_VRU = "52 6F 62 75 73 74 2F 56 52 55"
PROFILES_300 = tuple(
    AvailableProfile(number, 15, label)
    for number, label in [
        (39, "general"), (40, "high_mag_dep"), (41, "dynamic"), (42, "low_mag_dep"), (43, "vru_general"),
    ]
)  # fmt: skip
PROFILES_300_HEX = "".join(
    f"{item.type:02X} 0F {item.label.ljust(20).encode().hex()}" for item in PROFILES_300
)


def configuration_hex(head: str, date: bytes, code: bytes, device: str, tail: str) -> str:
    """Returns a payload of Table 13: the given fields, and zeros elsewhere."""
    texts = f"{date.ljust(16, bytes(1)).hex()} {code.ljust(64, bytes(1)).hex()}"
    return f"{head} {16 * '0'} {texts} 0001 {device} {tail}"


NAME_630 = b"MTi-630-8A1G6       "

#: Message, value, payload.
VALUES: list[tuple[str, Any, str]] = [
    # 5.3.2
    ("DeviceID", 0x0370_03F8, "037003F8"),
    ("DeviceID", 0x8000_5BF5, "00000000 80005BF5"),
    ("InitBusResults", (0x0370_03F8,), "037003F8"),
    ("ProductCode", "MTi-30-2A5G4", b"MTi-30-2A5G4        ".hex()),
    ("HardwareVersion", HardwareVersion(2, 1), "02 01"),
    ("FirmwareRev", Firmware(1, 8, 2, 37, 70964), "010802 00000025 00011534"),
    ("FirmwareRev", Firmware(1, 8, 2), "010802"),
    ("SelftestResults", Selftest(0x1FF), "01FF"),
    ("SelftestResults", Selftest.ACC_X | Selftest.BARO | Selftest.SYNC, "4201"),
    ("Error", DeviceErrorInfo(33), "21"),
    ("Error", DeviceErrorInfo(40, bytes([0, 0, 0, 6])), "28 00000006"),
    ("Warning", DeviceWarning(401, "refused"), "00000191" + b"refused".hex()),
    ("Warning", DeviceWarning(402), "00000192"),
    # 5.3.3
    ("SetBaudrate", 0x80, "80"),
    ("ReqBaudrateAck", 2, "02"),
    ("SetOptionFlags", OptionFlags(OptionFlag(1), OptionFlag(2)), "00000001 00000002"),
    ("SetOptionFlags", OptionFlags(set=OptionFlag.ENABLE_AHS), "00000010 00000000"),
    ("SetOptionFlags", OptionFlags(clear=OptionFlag(0xFFFF_FFFF)), "00000000 FFFFFFFF"),
    ("ReqOptionFlagsAck", OptionFlag.ENABLE_CONFIG_MESSAGE_AT_STARTUP | OptionFlag(1), "00000201"),
    ("SetLocationID", 0, "0000"),
    ("ReqLocationIDAck", 0xBEEF, "BEEF"),
    ("SetTransmitDelay", 590, "024E"),
    ("ReqTransmitDelayAck", 65535, "FFFF"),
    ("SetErrorMode", 1, "0001"),
    ("ReqErrorModeAck", 3, "0003"),
    # 5.3.4
    ("SetSyncSettings", SYNC_7, SYNC_7_HEX),
    ("SetSyncSettings", (), 24 * "0"),
    ("ReqSyncSettingsAck", SYNC_7, SYNC_7_HEX),
    ("ReqSyncSettingsAck", (PULSE, DELAYED),
     "04070301 0001 0003 000A FED4 08020200 0000 0000 0000 EA60"),
    # 5.3.5
    ("Configuration", CONFIGURATION_300,
     configuration_hex("037003F8 0480 0000", b"", b"", "037003F8 0000 0000 00000001", "0027 010802 49 0501")),
    ("Configuration", CONFIGURATION_30,
     configuration_hex("0360048E 0240 0000", b"", b"", "0360048E 0000 0006 00000000", "0027 010401 49 0200")),
    ("Configuration", CONFIGURATION_710,
     configuration_hex("077010E6 0480 0000", b"", b"", "077010E6 0000 0036 00000003", "0004 01040C 37 0401")),
    ("Configuration", CONFIGURATION_700,
     configuration_hex("0770045E 0480 0000", b"", b"", "0770045E 0000 0000 00000001", "0001 010405 37 0300")),
    ("Configuration", CONFIGURATION_7,
     configuration_hex("07881322 0000 0000", b"2021082810004300", b"",
                       "07881322 0000 0000 00000000", "000D 010E00 00 0000")),
    ("Configuration", CONFIGURATION_630,
     configuration_hex("800040D2 00000000", b"2024021113285700", NAME_630,
                       "800040D2 00000000 00000000", "0000 010600 00 0000")),
    ("SetOutputConfiguration", OUTPUTS, OUTPUTS_HEX),
    ("SetOutputConfiguration", ASKED, "10600190 40200190 80200190 20300190 E0200190 4810FFFF"),
    ("SetOutputConfigurationAck", GIVEN, "1060FFFF 40200190 80200190 20300190 E020FFFF 4810FFFF"),
    ("SetOutputConfiguration", (), "00000000"),
    ("ReqOutputConfigurationAck", (Output(0x1020), Output(0x1060)), "1020FFFF 1060FFFF"),
    ("SetStringOutputType", StringOutput(StringType(0)), "0000"),
    ("SetStringOutputType", StringOutput(StringType.GPGGA | StringType.HCHDM, 10), "00000401 000A"),
    ("ReqStringOutputTypeAck", StringOutput(StringType.GPRMC, 0), "00004000 0000"),
    ("SetPeriod", 1152, "0480"),
    ("ReqPeriodAck", 225, "00E1"),
    ("SetOutputSkipFactor", 65535, "FFFF"),
    ("ReqOutputSkipFactorAck", 0, "0000"),
    ("ReqAlignmentRotation", Alignment.ROT_LOCAL, "01"),
    ("SetAlignmentRotation", IDENTITY, "00" + ONE_AND_ZEROS),
    ("SetAlignmentRotation", LOCAL, "01" + ONE_AND_ZEROS),
    ("ReqAlignmentRotationAck", dataclasses.replace(IDENTITY, parameter=None), ONE_AND_ZEROS),
    ("SetExtOutputMode", ExtOutputMode.USB_LOW_LATENCY, "0020"),
    ("ExtOutputMode", ExtOutputMode.ALTERNATIVE_UART | ExtOutputMode.USB_LOW_LATENCY, "0030"),
    ("SetPortConfig", (XBUS_921600, XBUS_921600, NO_PORT), "00010080 00010080 00000000"),
    ("SetPortConfig", PORTS_680, "00010102 00000000 00060005"),
    ("PortConfig", (PortConfig(PortProtocol.NMEA, 0x0A, two_stop_bits=True, parity=True, parity_even=True),),
     "00050E0A"),
    ("SetCanConfig", CanConfig(0x0C), "0000010C"),
    ("CanConfig", CanConfig(0, enabled=False, reserved=0x800), "00000800"),
    ("SetCanOutputConfig", CAN, CAN_HEX),
    ("SetCanOutputConfig", (), 16 * "0"),
    ("CanOutputConfig", CAN[:1], CAN_HEX[:19]),
    ("SetCanOutputConfigAck", CAN, CAN_HEX),
    ("SetOutputMode", OutputMode.CALIBRATED | OutputMode.ORIENTATION, "0006"),
    ("ReqOutputModeAck", OutputMode(0x36), "0036"),
    ("SetOutputSettings", OutputSettings(), "00000001"),
    ("ReqOutputSettingsAck", OutputSettings(utc_time=True), "00000003"),
    # 5.3.7
    ("SetLatLonAlt", HERE, HERE_HEX),
    ("ReqLatLonAltAck", HERE, HERE_HEX),
    ("AvailableFilterProfiles", PROFILES_300, PROFILES_300_HEX),
    ("SetFilterProfile", 2, "0002"),
    ("ReqFilterProfileAck", FilterProfile(15, 39), "0F 27"),
    ("SetFilterProfileModern", "Robust/VRU", ROBUST_VRU),
    ("ReqFilterProfileAckModern", "Robust/VRU", ROBUST_VRU),
    ("SetGnssPlatform", GnssPlatform.PORTABLE, "0000"),
    ("ReqGnssPlatformAck", GnssPlatform.AIRBORNE_4G, "0008"),
    ("SetGnssLeverArm", ARM, "3F000000 BF800000 3E800000"),
    ("ReqGnssLeverArmAck", ARM, "3F000000 BF800000 3E800000"),
    ("ResetOrientation", ResetCode.ALIGNMENT, "0004"),
    ("SetNoRotation", 6, "0006"),
    ("SetUTCTime", NOON, NOON_HEX),
    ("UTCTime", NOON, NOON_HEX),
    ("AdjustUTCTime", 1, "00000001"),
    ("AdjustUTCTime", 10_000, "00002710"),
    ("AdjustUTCTime", -10_000, "FFFFD8F0"),
    ("IccCommand", IccCommand.STOP, "01"),
    ("IccCommandAck", IccReply(IccCommand.START), "00"),
    ("IccCommandAck", IccReply(IccCommand.STATE, active=True), "03 01"),
    ("IccCommandAck", IccReply(IccCommand.STOP, IccResult(4.007143497467041, 2, IccStatus(0))),
     "01 40803A85 02 00"),
    ("SetInitialHeading", -180.0, "C3340000"),
    # Not in this revision of the manual, but requested or seen.
    ("SetGnssReceiverSettings", GnssReceiverSettings(GnssReceiver.NMEA, 2, 10, 1), "0001 0002 000A 00000001"),
    ("SetGnssReceiverSettings", GnssReceiverSettings(GnssReceiver.UBLOX, 2, 4), "0006 0002 0004 00000000"),
    ("GnssReceiverSettings", ZED, "0003 0001 0004 00000000"),
    ("ReqEmts", b"\x00\xff", "00FF"),
    ("DataLength", 54, "0036"),
    ("SetProcessingFlags", 3, "03"),
    ("SetGravityMagnitude", 9.8125, "411D0000"),
    ("SetHeading", 0.5, "3F000000"),
    ("HeadingAck", 0.5, "3F000000"),
    ("GnssStatus", (GnssChannel(1, 9, 5, -1, 40),), "01 01 09 05 FF 28"),
    ("SetAmd", 1, "0001"),
]  # fmt: skip


@pytest.mark.parametrize(("name", "value", "payload"), VALUES, ids=[value[0] for value in VALUES])
def test_values(name: str, value: Any, payload: str) -> None:
    data = bytes.fromhex(payload)
    assert encode(name, value).hex() == data.hex()
    found = decode(name, data)
    assert found == value
    assert type(found) is type(value)


def test_configurations_match_real_devices() -> None:
    """The tables above match published bytes."""
    published = {
        decode("Configuration", output) for name, output in frames() if name == "Configuration"
    }
    assert published >= {
        CONFIGURATION_300, CONFIGURATION_30, CONFIGURATION_710, CONFIGURATION_7, CONFIGURATION_630,
    }  # fmt: skip


def test_every_message_has_a_layout() -> None:
    assert LAYOUTS.keys() == MESSAGES.keys()
    for name, layout in LAYOUTS.items():
        assert (layout is NOTHING) == (MESSAGES[name].kind == "empty"), name


def test_every_field_has_a_type_and_few_messages_are_bytes() -> None:
    """What a form takes in hex: data that no source describes, and bytes for others."""
    sent = [name for name, row in MESSAGES.items() if row.direction != "to host"]
    assert [name for name in sent if list(LAYOUTS[name].kinds) != list(LAYOUTS[name].fields)] == []
    kinds = LAYOUTS["SetSyncSettings"].kinds
    assert (kinds["line"], kinds["trigger_once"], kinds["offset"]) == (SyncLine, bool, int)
    described = {
        name: MESSAGES[name].payload
        for name in sent
        if bytes in LAYOUTS[name].kinds.values()
        and MESSAGES[name].payload not in ("unknown", "opaque")
    }
    assert described == {
        "ReqEmts": "00 FF",
        "SetObjectAlignment": "F4 matrix of 3 by 3",
        "ForwardGnssData": "bytes for the GNSS receiver",
        "SetDeviceIdContext": "device id",
    }


def test_every_layout_is_tested() -> None:
    known = {name for name, output in LAYOUTS.items() if output not in (NOTHING, RAW)}
    assert known == {name for name, _, _ in VALUES} - {"ReqEmts"}


#: Payloads that stay bytes: blobs, output data, and undocumented payloads.
BYTES = {
    "EmtsData", "ReqEmts", "ForwardGnssData", "MTData", "MTData2", "SetObjectAlignment",
    "ObjectAlignmentAck", "GravityMagnitudeAck", "ProcessingFlagsAck",
    "SetDeviceIdContext", "MasterIndication",
}  # fmt: skip


def test_other_payloads_stay_bytes() -> None:
    raw = {name for name, output in LAYOUTS.items() if output is RAW}
    assert raw >= BYTES
    assert {MESSAGES[byte].payload for byte in raw - BYTES} == {"unknown", "opaque"}
    for name in raw:
        lengths = MESSAGES[name].lengths
        data = bytes(lengths[0] if lengths else 3)
        assert encode(name, data) == data == decode(name, data)


def test_empty_payloads() -> None:
    for name, layout in LAYOUTS.items():
        if layout is NOTHING:
            assert encode(name) == b""
            assert decode(name, b"") is None
            with pytest.raises(ValueError, match="has 2 bytes"):
                decode(name, b"ab")
            with pytest.raises(ValueError, match="has no payload"):
                encode(name, 1)


def test_unknown_messages_are_rejected() -> None:
    with pytest.raises(KeyError):
        encode("SetWings")
    with pytest.raises(KeyError):
        decode("SetWings", b"")


# ---------------------------------------------------------------------------------------------
# Published frames
# ---------------------------------------------------------------------------------------------


def frames() -> list[tuple[str, bytes]]:
    """Returns name and payload of the published frames, except output data."""
    found = []
    for line in shared("spec/frames.txt").read_text(encoding="utf-8").splitlines():
        if line.startswith("#"):
            continue
        scanner = Scanner()
        (message,) = scanner.feed(bytes.fromhex(line.partition("#")[0])) + scanner.close()
        assert isinstance(message, Message)
        if message.name not in ("MTData2", "MTData"):
            found.append((message.name, message.payload))
    return found


def test_published_frames() -> None:
    assert len(frames()) == 81
    for name, payload in frames():
        if len(payload) == 65:
            # MT Manager writes the profile of its settings file with the bytes that follow in its memory.
            assert (name, decode("SetFilterProfileModern", payload)) == (
                "SetFilterProfile",
                "General_RTK",
            )
        else:
            assert encode(name, decode(name, payload)).hex() == payload.hex(), name


# ---------------------------------------------------------------------------------------------
# Unknown values are preserved, impossible values are rejected
# ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "payload", "value"),
    [
        ("ResetOrientation", "0063", 99),
        ("ReqGnssPlatformAck", "000A", 10),
        ("IccCommand", "09", 9),
        ("IccCommandAck", "09", IccReply(cast("IccCommand", 9))),
        ("ReqAlignmentRotation", "07", 7),
        ("ReqAlignmentRotationAck", "07" + ONE_AND_ZEROS, AlignmentRotation(7, (1, 0, 0, 0))),
        ("ReqBaudrateAck", "FF", 255),
        ("ReqOptionFlagsAck", "80004001", OptionFlag(0x8000_4001)),
        ("SelftestResults", "8000", Selftest(0x8000)),
        ("ExtOutputMode", "FFCF", ExtOutputMode(0xFFCF)),
        ("ReqStringOutputTypeAck", "8001", StringOutput(StringType(0x8001))),
        ("ReqStringOutputTypeAck", "80000001 0001", StringOutput(StringType(0x8000_0001), 1)),
        ("IccCommandAck", "01 3F800000 05 C0", IccReply(IccCommand.STOP, IccResult(1, 5, IccStatus(0xC0)))),
        ("PortConfig", "FFF2F0FF", (PortConfig(2, 0xFF, reserved=0xFFF0_F000),)),
        ("CanConfig", "FFFFFEFF", CanConfig(0xFF, enabled=False, reserved=0xFFFF_FE00)),
        ("CanOutputConfig", "EE 01 FFFFFFFF FFFF", (CanOutput(0xEE, True, 0xFFFF_FFFF, 0xFFFF),)),
        ("ReqSyncSettingsAck", "63 64 65 00 0001 0002 0003 FFFF",
         (SyncSetting(99, 100, 101, False, 1, 2, 3, 0xFFFF),)),
        ("GnssReceiverSettings", "0063 00FF FFFF 80000001",
         GnssReceiverSettings(99, 255, 0xFFFF, 0x8000_0001)),
        ("GnssReceiverSettings", "FFFF 0000 0000 00000000", GnssReceiverSettings(GnssReceiver.NONE, 0, 0)),
        ("ReqOutputConfigurationAck", "C2A0FFFE", (Output(0xC2A0, 0xFFFE),)),
        ("Error", "FE 0102", DeviceErrorInfo(0xFE, b"\x01\x02")),
        ("Warning", "FFFFFFFF", DeviceWarning(0xFFFF_FFFF)),
        ("UTCTime", "FFFFFFFF FFFF FF FF FF FF FF 37",
         UtcTime(2**32 - 1, 65535, 255, 255, 255, 255, 255, 0x37)),
        ("AvailableFilterProfiles", "C5 02" + 20 * "7A", (AvailableProfile(197, 2, 20 * "z"),)),
    ],
)  # fmt: skip
def test_unknown_numbers_are_preserved(name: str, payload: str, value: Any) -> None:
    data = bytes.fromhex(payload)
    assert decode(name, data) == value
    assert encode(name, value) == data


@pytest.mark.parametrize(
    ("name", "payload", "value"),
    [
        # Texts end where some firmware pads them.
        ("ProductCode", b"MTi-3\0\0\0\0\0".hex(), "MTi-3"),
        ("ReqFilterProfileAckModern", b"General_RTK".ljust(62).hex(), "General_RTK"),
        ("Warning", b"\0\0\1\x91lost".ljust(132, b"\0").hex(), DeviceWarning(401, "lost")),
        ("Warning", b"\0\0\1\x91l\xffst".hex(), DeviceWarning(401, "l\ufffdst")),
        # Eight bytes that are an identifier of four, and something else.
        ("DeviceID", "037003F8 00000001", 0x0370_03F8),
        # Old firmware.
        ("ReqLatLonAltAck", "42500000 40C00000 BF800000", LatLonAlt(52, 6, -1)),
        # An empty payload has no entry, as an entry of zeros.
        ("ReqSyncSettingsAck", "", ()),
        ("ReqOutputConfigurationAck", "", ()),
        ("PortConfig", "", ()),
        # Any number but zero is true.
        ("IccCommandAck", "03 02", IccReply(IccCommand.STATE, active=True)),
        # Against the manual's order of the halves, as no device is known to.
        ("Configuration", configuration_hex("00000000 800040D2", b"2024021113285700", NAME_630,
                                            "00000000 800040D2 00000000", "0000 010600 00 0000"),
         CONFIGURATION_630),
    ],
)  # fmt: skip
def test_decoded_but_never_encoded(name: str, payload: str, value: Any) -> None:
    assert decode(name, bytes.fromhex(payload)) == value


@pytest.mark.parametrize(
    ("name", "size", "error"),
    [
        ("DeviceID", 5, "5 bytes, not 4 or 8"),
        ("InitBusResults", 6, "6 bytes, not entries of 4"),
        ("HardwareVersion", 3, "3 bytes, not 2"),
        ("FirmwareRev", 4, "4 bytes, not 3 or 11"),
        ("SelftestResults", 1, "1 bytes, not 2"),
        ("Error", 0, "0 bytes, not at least 1"),
        ("Warning", 3, "3 bytes, not at least 4"),
        ("ReqBaudrateAck", 0, "0 bytes, not 1"),
        ("SetOptionFlags", 4, "4 bytes, not 8"),
        ("ReqSyncSettingsAck", 13, "13 bytes, not entries of 12"),
        ("Configuration", 117, "117 bytes, not 118"),
        ("ReqOutputConfigurationAck", 7, "7 bytes, not entries of 4"),
        ("ReqStringOutputTypeAck", 4, "4 bytes, not 2 or 6"),
        ("ReqAlignmentRotationAck", 18, "18 bytes, not 16 or 17"),
        ("PortConfig", 10, "10 bytes, not entries of 4"),
        ("CanConfig", 2, "2 bytes, not 4"),
        ("CanOutputConfig", 9, "9 bytes, not entries of 8"),
        ("ReqLatLonAltAck", 23, "23 bytes, not 12 or 24"),
        ("AvailableFilterProfiles", 21, "21 bytes, not entries of 22"),
        ("ReqFilterProfileAck", 3, "3 bytes, not 2"),
        ("UTCTime", 11, "11 bytes, not 12"),
        ("IccCommandAck", 6, "6 bytes, not 1 or 2 or 7"),
        ("GnssReceiverSettings", 9, "9 bytes, not 10"),
    ],
)
def test_wrong_lengths(name: str, size: int, error: str) -> None:
    with pytest.raises(ValueError, match=error):
        decode(name, bytes(size))


def changed(value: Any, **changes: Any) -> Any:
    return dataclasses.replace(value, **changes)


@pytest.mark.parametrize(
    ("name", "value", "error"),
    [
        ("SetPeriod", 65536, "period cannot be 65536: it must be an integer from 0 to 65535"),
        ("SetPeriod", -1, "period cannot be -1"),
        ("SetPeriod", 1.5, "period cannot be 1.5"),
        ("SetPeriod", "1152", "period cannot be '1152'"),
        ("SetPeriod", None, "period cannot be None"),
        ("AdjustUTCTime", 2**31, "ticks .* from -2147483648 to 2147483647"),
        ("SetBaudrate", 115_200, "code .* from 0 to 255"),
        ("DeviceID", 2**64, "device_id"),
        ("SetInitialHeading", "north", "heading cannot be 'north': it must be a finite"),
        ("SetInitialHeading", 1e39, "heading"),
        ("SetOptionFlags", OptionFlags(clear=OptionFlag(1 << 32)), "clear"),
        ("SetOptionFlags", None, "set cannot be None"),
        ("SetGnssPlatform", None, "platform"),
        ("SetLatLonAlt", LatLonAlt(1, cast("float", "east"), 3), "lon"),
        ("SetUTCTime", changed(NOON, month=256), "month"),
        ("SetUTCTime", changed(NOON, ns=1 << 32), "ns"),
        ("SetGnssLeverArm", GnssLeverArm(0, 0, 1e39), "z cannot"),
        ("SetGnssReceiverSettings", changed(ZED, rate=-1), "rate"),
        ("HardwareVersion", HardwareVersion(2, 256), "minor"),
        ("FirmwareRev", Firmware(1, 2, 3, -1, 0), "build"),
        ("ProductCode", 21 * "x", "1 to 20"),
        ("ProductCode", "", "1 to 20"),
        ("ProductCode", "MTi 3", "no space"),
        ("SetFilterProfileModern", 63 * "x", "1 to 62"),
        ("SetFilterProfileModern", "Rob\u00fcst", "ASCII"),
        ("SetFilterProfileModern", "Robust\n", "ASCII"),
        ("SetFilterProfileModern", 2, "text cannot be 2"),
        ("AvailableFilterProfiles", [AvailableProfile(39, 15, 21 * "x")], "label .* 20 characters"),
        ("AvailableFilterProfiles", [AvailableProfile(39, 15, "\u00fc")], "label"),
        ("AvailableFilterProfiles", 11 * [AvailableProfile(39, 15, "x")], "11 entries.*holds 10"),
        ("SetOutputConfiguration", 33 * [Output(0x2010, 100)], "33 entries.*holds 32"),
        ("SetOutputConfiguration", [Output(0x12010, 100)], "data_id"),
        ("SetOutputConfiguration", [Output(0x2010, 65536)], "frequency"),
        ("SetSyncSettings", [changed(PULSE, offset=32768)], "offset .* from -32768 to 32767"),
        ("SetSyncSettings", [changed(DELAYED, offset=-1)], "offset .* from 0 to 65535"),
        ("SetSyncSettings", [changed(DELAYED, line=256)], "line"),
        ("SetSyncSettings", 11 * [PULSE], "11 entries"),
        ("SetStringOutputType", StringOutput(StringType(1 << 16)), "types"),
        ("SetStringOutputType", StringOutput(StringType.GPGGA, 65536), "frequency"),
        (
            "SetAlignmentRotation",
            changed(IDENTITY, quaternion=(1, 0, 0)),
            "quaternion cannot .* 4 finite numbers",
        ),
        ("SetAlignmentRotation", changed(IDENTITY, quaternion=(1, 0, 0, 1e39)), "quaternion"),
        ("SetAlignmentRotation", changed(IDENTITY, quaternion=(1, 0, 0, True)), "quaternion"),
        ("SetPeriod", True, "period cannot be True"),
        ("SetInitialHeading", math.nan, "heading cannot be nan"),
        ("SetInitialHeading", math.inf, "heading cannot be inf"),
        ("SetLatLonAlt", LatLonAlt(1, 2, math.inf), "alt cannot be inf"),
        ("SetGnssLeverArm", GnssLeverArm(math.nan, 0, 0), "x cannot be nan"),
        ("SetSyncSettings", [changed(PULSE, trigger_once=2)], "trigger_once .* true or false"),
        ("SetSyncSettings", [changed(PULSE, function=[])], r"function cannot be \[\]"),
        ("SetSyncSettings", [5], "function cannot be None"),
        ("SetSyncSettings", 5, "5 is not a list"),
        ("SetCanConfig", 5, "5 is not a CanConfig"),
        ("SetCanConfig", changed(CanConfig(0), enabled=5.5), "enabled .* true or false"),
        ("SetCanConfig", CanConfig(cast("int", 5.5)), "baud_code .* integer"),
        ("SetPortConfig", [0x00010080] * 3, "65664 is not a PortConfig"),
        ("SetPortConfig", [changed(XBUS_921600, parity="no")] * 3, "parity cannot be 'no'"),
        ("DeviceID", 1 << 32, "device_id cannot be 0x100000000: .* bit 31"),
        ("Configuration", changed(CONFIGURATION_630, device_id=0x80000000 << 32), "device_id"),
        ("SetAlignmentRotation", changed(IDENTITY, parameter=None), "parameter cannot be None"),
        ("SetPortConfig", [changed(XBUS_921600, baud_code=256)] * 3, "baud_code"),
        ("SetPortConfig", [changed(XBUS_921600, protocol=16)] * 3, "protocol"),
        ("SetPortConfig", [changed(XBUS_921600, reserved=1)] * 3, "reserved"),
        ("SetPortConfig", [XBUS_921600], "3 times .U4 word .* not 4 bytes"),
        ("SetPortConfig", 4 * [XBUS_921600], "4 entries"),
        ("SetCanConfig", CanConfig(256), "baud_code"),
        ("SetCanConfig", CanConfig(0, reserved=0x100), "reserved"),
        ("SetCanOutputConfig", [changed(CAN[0], can_id=1 << 32)], "can_id"),
        ("IccCommandAck", IccReply(IccCommand.STOP, IccResult(1, 256, IccStatus(0))), "dimension"),
        ("Error", DeviceErrorInfo(256), "code"),
        ("Error", DeviceErrorInfo(40, bytes(8)), "extra .* at most 7 bytes"),
        ("Warning", DeviceWarning(-1), "code"),
        ("Warning", DeviceWarning(401, 129 * "x"), "text .* at most 128 characters"),
        ("Configuration", changed(CONFIGURATION_300, date="2026-11-22"), "date"),
        ("Configuration", changed(CONFIGURATION_300, product_code=21 * "x"), "product_code"),
        ("Configuration", changed(CONFIGURATION_300, filter_profile=65536), "filter_profile"),
        ("Configuration", changed(CONFIGURATION_300, filter_type="II"), "filter_type"),
        (
            "Configuration",
            changed(CONFIGURATION_630, device_id=1 << 64 | 1 << 31),
            "device_id .* eight",
        ),
        ("ReqEmts", 2, "data cannot be 2"),
        ("ReqEmts", b"\x00", "00 FF, not 1 bytes"),
        ("ForwardGnssData", b"", "not 0 bytes"),
        ("SetObjectAlignment", bytes(35), "3 by 3, not 35 bytes"),
    ],
)
def test_values_that_do_not_fit_are_rejected(name: str, value: Any, error: str) -> None:
    with pytest.raises(ValueError, match=error):
        encode(name, value)


# ---------------------------------------------------------------------------------------------
# Any value
# ---------------------------------------------------------------------------------------------


def whole(bits: int) -> st.SearchStrategy[int]:
    return st.integers(0, (1 << bits) - 1)


U1, U2, U4 = whole(8), whole(16), whole(32)
I1 = st.integers(-128, 127)
F4 = st.floats(width=32, allow_nan=False, allow_infinity=False)
F8 = st.floats(allow_nan=False, allow_infinity=False)
BOOL = st.booleans()
WORD = st.text(st.characters(min_codepoint=33, max_codepoint=126), min_size=1, max_size=20)
LABEL = st.text(st.characters(min_codepoint=32, max_codepoint=126), max_size=20).map(str.rstrip)
DIGITS = st.none() | whole(26).map("{:08d}".format)
SYNC_OUT = (SyncFunction.INTERVAL_TRANSITION_MEASUREMENT, SyncFunction.GNSS_1PPS)
SYNC = st.builds(SyncSetting, U1, U1, U1, BOOL, U2, U2, U2, U2).map(
    lambda item: changed(item, offset=item.offset - 32768) if item.function in SYNC_OUT else item
)
PORT = st.builds(
    PortConfig, whole(4), U1, BOOL, BOOL, BOOL, BOOL, U4.map(lambda item: item & 0xFFF0_F000)
)
OUTPUT = st.builds(Output, U2, U2)
CAN_OUTPUT = st.builds(CanOutput, U1, BOOL, U4, U2)
PLACE, TIME = st.builds(LatLonAlt, F8, F8, F8), st.builds(UtcTime, U4, U2, U1, U1, U1, U1, U1, U1)
ROTATION = st.tuples(F4, F4, F4, F4)
STRINGS = st.builds(StringOutput, U2.map(StringType), st.none()) | st.builds(
    StringOutput, U4.map(StringType), U2
)
OLD_FIRMWARE = st.builds(Firmware, U1, U1, U1, st.none(), st.none())
NARROW = st.builds(
    Configuration, st.integers(1, 2**31 - 1), st.none() | WORD, U2, U2, DIGITS, DIGITS, U2, U2,
    OLD_FIRMWARE, U2, U4, st.none() | WORD.map(lambda item: item[0]), st.tuples(U1, U1),
)  # fmt: skip
WIDE = st.builds(
    lambda item, high: changed(
        item, device_id=item.device_id | 1 << 31 | high << 32, sampling_period=None,
        output_skip_factor=None, output_mode=None, output_settings=None,
    ),
    NARROW, U4,
)  # fmt: skip
ICC = (
    st.builds(IccReply, U1)
    | st.builds(IccReply, U1, active=BOOL)
    | st.builds(IccReply, U1, st.builds(IccResult, F4, U1, U1.map(IccStatus)))
)


def several(entry: st.SearchStrategy[Any], most: int, least: int = 0) -> st.SearchStrategy[Any]:
    """Draws lists, except a single entry of zeros, which counts as no entry."""
    lists = st.lists(entry, min_size=least, max_size=most).map(tuple)
    return lists.filter(lambda item: len(item) != 1 or any(_numbers(item[0])))


def _numbers(entry: Any) -> list[Any]:
    if isinstance(entry, int):
        return [entry]
    return list(vars(entry).values() if dataclasses.is_dataclass(entry) else entry)


#: Values of each layout.
STRATEGIES: dict[str, st.SearchStrategy[Any]] = {
    "DeviceID": whole(31)
    | whole(32).map(lambda item: item | 1 << 31)
    | whole(64).filter(lambda item: item >> 31 & 0x1_0000_0001),
    "InitBusResults": several(U4, 8),
    "ProductCode": WORD,
    "HardwareVersion": st.builds(HardwareVersion, U1, U1),
    "FirmwareRev": st.builds(Firmware, U1, U1, U1, U4, U4) | OLD_FIRMWARE,
    "SelftestResults": U2.map(Selftest),
    "Error": st.builds(DeviceErrorInfo, U1, st.binary(max_size=7)),
    "Warning": st.builds(DeviceWarning, U4, LABEL),
    "SetOptionFlags": st.builds(OptionFlags, U4.map(OptionFlag), U4.map(OptionFlag)),
    "ReqOptionFlagsAck": U4.map(OptionFlag),
    "SetSyncSettings": several(SYNC, 10),
    "ReqSyncSettingsAck": several(SYNC, 10),
    "Configuration": NARROW | WIDE,
    "SetOutputConfiguration": several(OUTPUT, 32),
    "SetOutputConfigurationAck": several(OUTPUT, 32),
    "ReqOutputConfigurationAck": several(OUTPUT, 32),
    "SetStringOutputType": STRINGS,
    "ReqStringOutputTypeAck": STRINGS,
    "SetAlignmentRotation": st.builds(AlignmentRotation, U1, ROTATION),
    "ReqAlignmentRotationAck": st.builds(AlignmentRotation, st.none() | U1, ROTATION),
    "SetExtOutputMode": U2.map(ExtOutputMode),
    "ExtOutputMode": U2.map(ExtOutputMode),
    "SetPortConfig": several(PORT, 3, 3),
    "PortConfig": several(PORT, 3).filter(lambda item: [*map(int, item)] != [0]),
    "SetCanConfig": U4.map(CanConfig.from_word),
    "CanConfig": U4.map(CanConfig.from_word),
    "SetCanOutputConfig": several(CAN_OUTPUT, 16),
    "CanOutputConfig": several(CAN_OUTPUT, 16),
    "SetCanOutputConfigAck": several(CAN_OUTPUT, 16),
    "SetLatLonAlt": PLACE,
    "ReqLatLonAltAck": PLACE,
    "AvailableFilterProfiles": several(st.builds(AvailableProfile, U1, U1, LABEL), 10),
    "ReqFilterProfileAck": st.builds(FilterProfile, U1, U1),
    "SetFilterProfileModern": WORD,
    "ReqFilterProfileAckModern": WORD,
    "SetGnssLeverArm": st.builds(GnssLeverArm, F4, F4, F4),
    "ReqGnssLeverArmAck": st.builds(GnssLeverArm, F4, F4, F4),
    "SetUTCTime": TIME,
    "UTCTime": TIME,
    "IccCommandAck": ICC,
    "SetGnssReceiverSettings": st.builds(GnssReceiverSettings, U2, U2, U2, U4),
    "GnssReceiverSettings": st.builds(GnssReceiverSettings, U2, U2, U2, U4),
    "SetInitialHeading": F4,
    "SetGravityMagnitude": F4,
    "SetHeading": F4,
    "HeadingAck": F4,
    "GnssStatus": st.lists(st.builds(GnssChannel, U1, U1, U1, I1, I1), max_size=16).map(tuple),
    "AdjustUTCTime": U4.map(lambda item: item - 2**31),
}
STRATEGIES |= dict.fromkeys(
    ["SetBaudrate", "ReqBaudrateAck", "ReqAlignmentRotation", "IccCommand", "SetProcessingFlags"],
    U1,
)
STRATEGIES |= dict.fromkeys(
    ["SetOutputSettings", "ReqOutputSettingsAck"], U4.map(OutputSettings.from_word)
)
STRATEGIES |= dict.fromkeys(["SetOutputMode", "ReqOutputModeAck"], U2.map(OutputMode))
STRATEGIES |= dict.fromkeys(
    [
        name
        for name, output in LAYOUTS.items()
        if output not in (NOTHING, RAW) and name not in STRATEGIES
    ],
    U2,
)


#: The messages that have the same values: most of the time goes into drawing these.
ALIKE: dict[st.SearchStrategy[Any], list[str]] = {}
for _name, _strategy in STRATEGIES.items():
    ALIKE.setdefault(_strategy, []).append(_name)


@given(st.data())
@pytest.mark.parametrize("names", ALIKE.values(), ids=" ".join)
def test_encoded_values_decode_to_themselves(names: list[str], data: st.DataObject) -> None:
    value = data.draw(STRATEGIES[names[0]])
    for name in names:
        payload = encode(name, value)
        lengths = MESSAGES[name].lengths
        assert lengths is None or len(payload) in lengths
        assert decode(name, payload) == value
        assert encode(name, decode(name, payload)) == payload


@given(st.binary(max_size=140))
def test_any_payload_is_decoded_or_rejected(payload: bytes) -> None:
    for name in LAYOUTS:
        try:
            value = decode(name, payload)
        except ValueError:
            continue
        value_text(value)


#: Text that is not ASCII is shown, and cannot be written.
TEXTS = {
    "ProductCode", "Warning", "SetFilterProfileModern", "ReqFilterProfileAckModern",
    "AvailableFilterProfiles", "Configuration",
}  # fmt: skip
#: Their row has the lengths of the text that other products have under the same MID.
SHARED = {"ReqFilterProfileAck"}


@given(st.integers(0, 2**32 - 1))
def test_payloads_of_valid_length_are_decoded(seed: int) -> None:
    """Any bytes of a valid length are decoded, and the value survives encoding and decoding."""
    rng = random.Random(seed)
    for name, layout in LAYOUTS.items():
        lengths = [item for item in MESSAGES[name].lengths or () if item]
        if not lengths or layout in (NOTHING, RAW) or name in SHARED:
            continue
        value = decode(name, rng.randbytes(rng.choice(lengths)))
        if name not in TEXTS and not re.search(r"\b(nan|inf)\b", repr(value)):
            assert repr(decode(name, encode(name, value))) == repr(value), name


JUNK = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text() | st.binary(),
    lambda item: st.lists(item, max_size=4) | st.dictionaries(st.text(), item, max_size=3),
    max_leaves=6,
)


@given(JUNK)
def test_a_value_of_any_type_is_encoded_or_rejected(value: Any) -> None:
    for name in LAYOUTS:
        with contextlib.suppress(ValueError):
            encode(name, value)


# ---------------------------------------------------------------------------------------------
# Words
# ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "words", "value"),
    [
        ("GoToConfig", "", None),
        ("SetPeriod", "1152", 1152),
        ("SetPeriod", "period=0x480", 1152),
        ("AdjustUTCTime", "-10000", -10_000),
        ("SetInitialHeading", "-12.5", -12.5),
        ("SetBaudrate", "code=0x80", 128),
        ("ResetOrientation", "heading", ResetCode.HEADING),
        ("ResetOrientation", "code=Alignment", ResetCode.ALIGNMENT),
        ("ResetOrientation", "99", 99),
        ("IccCommand", "start", IccCommand.START),
        ("ReqAlignmentRotation", "rot_local", Alignment.ROT_LOCAL),
        ("SetGnssPlatform", "8", GnssPlatform.AIRBORNE_4G),
        ("SetOptionFlags", "set=enable_ahs|DISABLE_GPS", OptionFlags(OptionFlag(0x18))),
        ("SetOptionFlags", "clear=0xFFFFFFFF", OptionFlags(clear=OptionFlag(0xFFFF_FFFF))),
        ("SetOptionFlags", "set=enable_ahs|0x8000|enable_ahs", OptionFlags(OptionFlag(0x8010))),
        ("SetOptionFlags", "", OptionFlags()),
        ("SetExtOutputMode", "mode=usb_low_latency", ExtOutputMode.USB_LOW_LATENCY),
        ("SetLatLonAlt", "lat=52.1 lon=6.8 alt=30", LatLonAlt(52.1, 6.8, 30)),
        ("SetGnssLeverArm", "x=1 y=0 z=-0.5", GnssLeverArm(1, 0, -0.5)),
        ("SetUTCTime", "ns=500000000 year=2026 month=11 day=22 hour=12 minute=0 second=59 valid=7", NOON),
        ("SetFilterProfileModern", "Robust/VRU", "Robust/VRU"),
        ("SetFilterProfileModern", "text=Robust/VRU", "Robust/VRU"),
        ("ReqEmts", "00FF", b"\x00\xff"),
        ("ForwardGnssData", "data=D30001", b"\xd3\x00\x01"),
        ("SetAlignmentRotation", "parameter=rot_sensor quaternion=1,0,0,0", IDENTITY),
        ("SetStringOutputType", "types=gpgga|hchdm frequency=10",
         StringOutput(StringType.GPGGA | StringType.HCHDM, 10)),
        ("SetStringOutputType", "types=0", StringOutput(StringType(0))),
        ("SetOutputConfiguration", "data_id=0x1020 data_id=0x2010,frequency=100",
         (Output(0x1020), Output(0x2010, 100))),
        ("SetOutputConfiguration", "data_id=quaternion|ned|Fp1632,frequency=100", (Output(0x2016, 100),)),
        ("SetOutputConfiguration", "", ()),
        ("SetSyncSettings",
         "function=clock_bias_estimation,line=gnss_clock_in,offset=1000 function=14,line=8,pulse_width=500",
         SYNC_7),
        ("SetSyncSettings", "function=send_latest,line=in1,polarity=falling,offset=60000", (DELAYED,)),
        ("SetSyncSettings",
         "function=4,line=sync_out,polarity=both,trigger_once=true,skip_first=1,skip_factor=3,"
         "pulse_width=10,offset=-300", (PULSE,)),
        ("SetPortConfig", "protocol=xbus,baud_code=2,flow_control=1 protocol=0,baud_code=0 "
         "protocol=rtcm,baud_code=5", PORTS_680),
        ("SetCanConfig", "baud_code=0x0c", CanConfig(0x0C)),
        ("SetCanConfig", "baudrate=1000000", CanConfig(0x0C)),
        ("SetPortConfig", "protocol=xbus,baudrate=115200,flow_control=1 protocol=0,baud_code=0 "
         "protocol=rtcm,baudrate=38400", PORTS_680),
        ("SetBaudrate", "baudrate=921600", 0x80),
        ("SetCanConfig", "baud_code=12 enabled=false", CanConfig(0x0C, enabled=False)),
        ("SetCanOutputConfig", "data_id=quaternion,extended=false,can_id=0x21,frequency=100", CAN[:1]),
        ("SetGnssReceiverSettings", "receiver=zed_f9p baud_code=1 rate=4", ZED),
    ],
)  # fmt: skip
def test_parse_words(name: str, words: str, value: Any) -> None:
    found = LAYOUTS[name].read(words.split())
    assert found == value
    assert type(found) is type(value)


@pytest.mark.parametrize(
    ("name", "words", "error"),
    [
        ("GoToConfig", "now", "no field is called 'now'; there are: none"),
        ("SetPeriod", "", "fields are missing: period"),
        ("SetPeriod", "speed=3", "no field is called 'speed'; there are: period"),
        ("SetPeriod", "100Hz", "period: '100Hz' is not a number"),
        ("SetPeriod", "1 2", "period is given twice"),
        ("SetLatLonAlt", "lat=1", "fields are missing: lon, alt"),
        ("SetLatLonAlt", "1 2 3", "no field is called '1'; there are: lat, lon, alt"),
        ("SetLatLonAlt", "lat=north lon=0 alt=0", "lat: .*north"),
        ("ResetOrientation", "sideways", "code: 'sideways' is not one of STORE, HEADING, "),
        ("ResetOrientation", "heading|alignment", "the field takes one name, not several"),
        (
            "SetOptionFlags",
            "set=enable_ahs|enable_wings",
            "set: 'enable_wings' is not one of DISABLE_AUTO_",
        ),
        ("SetOptionFlags", "enable_ahs", "no field is called 'enable_ahs'; there are: set, clear"),
        ("SetAlignmentRotation", "parameter=0 quaternion=1,0,0", "quaternion: .* not 4 numbers"),
        ("SetSyncSettings", "function=send_latest", "fields are missing: line$"),
        (
            "SetSyncSettings",
            "function=send_latest,line=in1,trigger_once=maybe",
            "neither true nor false",
        ),
        ("SetOutputConfiguration", "frequency=100", "fields are missing: data_id$"),
        ("SetOutputConfiguration", "data_id=wings", "data_id: 'wings' is not one of "),
        (
            "SetOutputConfiguration",
            "data_id=quaternion|west",
            "data_id: 'west' is not one of Float32, ",
        ),
        (
            "SetPortConfig",
            "0x00010080",
            "no field is called '0x00010080'; there are: protocol, .*, baudrate$",
        ),
        (
            "SetPortConfig",
            "protocol=xbus,baudrate=1234",
            "baudrate: '1234' is not one of 4800, 9600, ",
        ),
        ("SetPortConfig", "protocol=xbus,baud_code=2,baudrate=9600", "baud_code is given twice"),
        ("ReqEmts", "data=xyz", "data: "),
        ("SetUTCTime", "ns=0 year=2026", "missing: month, day, hour, minute, second$"),
    ],
)
def test_invalid_words_are_rejected(name: str, words: str, error: str) -> None:
    with pytest.raises(ValueError, match=error):
        LAYOUTS[name].read(words.split())


def test_formatted_words_parse_to_the_same_value() -> None:
    """`xbus send` accepts the text that `xbus dump` shows for a message to the device."""
    for name, value, payload in VALUES:
        if MESSAGES[name].direction == "to device" and not isinstance(value, bytes):
            words = [] if value == () else value_text(value).split()
            assert encode(name, LAYOUTS[name].read(words)) == bytes.fromhex(payload), words


@pytest.mark.parametrize(
    ("name", "payload", "words"),
    [
        ("SetOptionFlags", "00000010 FFFFC002", "set=enable_ahs clear=disable_auto_measurement|0xffffc000"),
        ("SetSyncSettings", SYNC_7_HEX,
         "function=clock_bias_estimation,line=gnss_clock_in,polarity=rising,offset=1000 "
         "function=gnss_1pps,line=gnss_1pps,polarity=rising,pulse_width=500"),
        ("SetOutputConfiguration", "1020FFFF 20160064 3013000A C2A00001 201C0001",
         "data_id=PacketCounter,frequency=65535 data_id=Quaternion|Fp1632|NED,frequency=100 "
         "data_id=0x3013,frequency=10 data_id=0xC2A0,frequency=1 data_id=0x201C,frequency=1"),
        ("SetOutputConfiguration", "00000000", "none"),
        ("IccCommandAck", "01 40803A85 02 00", "command=stop ddt=4.0071435 dimension=2 status=0"),
        ("IccCommandAck", "03 00", "command=state active=false"),
        ("SetLatLonAlt", HERE_HEX, "lat=52.24049169408207 lon=6.838216771186439 alt=0"),
        ("ReqOptionFlagsAck", "00000000", "0"),
        ("ReqEmts", "00FF", "2 bytes"),
        # 0x0A is not the usual code of its rate.
        ("SetPortConfig", "00010102 0000000A 00060099",
         "protocol=xbus,baudrate=115200,flow_control=true protocol=none,baud_code=10 "
         "protocol=rtcm,baud_code=153"),
        ("SetCanConfig", "00000100", "baudrate=250000 enabled=true"),
        ("GnssReceiverSettings", "0003 0001 0004 00000000", "receiver=zed_f9p baudrate=230400 rate=4"),
    ],
)  # fmt: skip
def test_format_words(name: str, payload: str, words: str) -> None:
    assert value_text(decode(name, bytes.fromhex(payload))) == words


@pytest.mark.parametrize(("code", "text"), [(0x80, "baudrate=921600"), (0x0A, "10"), (0x55, "85")])
def test_a_baud_code_is_described_by_its_rate(code: int, text: str) -> None:
    """`xbus send` accepts the text, and sends the same code."""
    message = Message(0x18, "SetBaudrate", 0xFF, bytes([code]), 0, 0)
    assert describe_message(message) == text
    assert LAYOUTS["SetBaudrate"].read([text]) == code


# ---------------------------------------------------------------------------------------------
# Properties of values
# ---------------------------------------------------------------------------------------------

#: Code and rate: Table 7, "76k6" as what it means.
TABLE_7 = """
    0D 4000000   80 921600   02 115200   06 28800   0B 4800
    0E 3686400   0A 921600   03  76800   07 19200
    0C 2000000   00 460800   04  57600   08 14400
                 01 230400   05  38400   09  9600
"""


def test_table_7() -> None:
    words = TABLE_7.split()
    table = {int(code, 16): int(rate) for code, rate in zip(words[::2], words[1::2], strict=True)}
    assert table == BAUD_CODES
    for code, rate in table.items():
        assert baudrate(code) == rate
        assert baud_code(rate) == (0x80 if code == 0x0A else code)
    assert baudrate(0xFF) is None
    with pytest.raises(
        ValueError, match=r"no device talks at 76,600 baud; there are 4,800, .* 4,000,000"
    ):
        baud_code(76_600)


def test_can_baud_codes() -> None:
    """CAN baud codes differ from those of Table 7."""
    assert CAN_BAUD_CODES[0x0C] == 1_000_000
    assert (CanConfig(0x00).baudrate, CanConfig(0x0D).baudrate) == (250_000, None)
    assert sorted(CAN_BAUD_CODES) == sorted(set(range(13)))


def test_ports() -> None:
    assert (XBUS_921600.baudrate, changed(XBUS_921600, baud_code=0xFF).baudrate) == (921_600, None)


def test_selftest() -> None:
    assert Selftest(0x1FF).passed
    assert Selftest(0x7FF).passed
    assert not Selftest(0x1FE).passed


@pytest.mark.parametrize(
    ("data_id", "quantity", "precision", "coordinates"),
    [
        (0x2010, "quaternion", 0, 0),
        (0x2016, "quaternion", 2, 4),
        (0x201C, "quaternion", 0, 12),
        (0x402B, "acceleration", 3, None),
        (0x3013, "baro_pressure", None, None),
        (0x1020, "packet_counter", None, None),
        (0xC2A0, None, None, None),
    ],
)
def test_output_properties(
    data_id: int, quantity: str | None, precision: int | None, coordinates: int | None
) -> None:
    output = Output(data_id)
    assert (output.quantity, output.precision, output.coordinates) == (
        quantity,
        precision,
        coordinates,
    )
    assert output.frequency == EVERY
