"""What each message says: a layout for every row of the table of messages, by its name there.

Lengths, states and products of a message are in `xbus.tables.MESSAGES`; here is what its bytes mean. A row
serves both sides: what the host writes a virtual device reads, and the other way round.
"""

from __future__ import annotations

import struct
from dataclasses import replace
from typing import Any

from xbus import _core
from xbus.configuration import Configuration, Firmware
from xbus.protocol import values as v
from xbus.protocol.layout import (
    NOTHING,
    RAW,
    Layout,
    by_length,
    field,
    mapped,
    number,
    record,
    repeated,
    text,
)
from xbus.tables import MESSAGES, MessageRow

__all__ = ["LAYOUTS", "ROWS", "decode", "encode"]

#: The rows of the table by name.
ROWS: dict[str, MessageRow] = {it.name: it for it in MESSAGES}

# One number

_device_id = by_length(
    {4: number("device_id", "I"), 8: number("device_id", "Q")}, lambda it: 8 if it >> 31 else 4
)
#: Seen from devices whose second half means something else, see `xbus._core.device_id`.
DEVICE_ID = replace(
    _device_id, decode=lambda payload: _core.device_id(payload) or _device_id.decode(payload)
)
BAUDRATE = number("code", "B")
PERIOD = number("period", "H")
SKIP_FACTOR = number("skip_factor", "H")
DELAY = number("delay", "H")
MODE = number("mode", "H")
OPTION_FLAGS = number("flags", "I", v.OptionFlag)
PLATFORM = number("platform", "H", v.GnssPlatform)
LOCATION_ID = number("location_id", "H")

# Records

_version = record(
    Firmware,
    major=field("B"),
    minor=field("B"),
    revision=field("B"),
    build=field("I"),
    scm=field("I"),
)
_old_version = record(Firmware, major=field("B"), minor=field("B"), revision=field("B"))
FIRMWARE = by_length({11: _version, 3: _old_version}, lambda it: 3 if it.build is None else 11)
HARDWARE = record(v.HardwareVersion, major=field("B"), minor=field("B"))
UTC_TIME = record(
    v.UtcTime,
    ns=field("I"),
    year=field("H"),
    month=field("B"),
    day=field("B"),
    hour=field("B"),
    minute=field("B"),
    second=field("B"),
    valid=field("B"),
)
LAT_LON_ALT = by_length(
    {
        24: record(
            v.LatLonAlt, lat=field("d", float), lon=field("d", float), alt=field("d", float)
        ),
        12: record(
            v.LatLonAlt, lat=field("f", float), lon=field("f", float), alt=field("f", float)
        ),
    },
    lambda _: 24,
)
LEVER_ARM = record(v.GnssLeverArm, x=field("f", float), y=field("f", float), z=field("f", float))
RECEIVER = record(
    v.GnssReceiverSettings,
    receiver=field("H", v.GnssReceiver),
    baud_code=field("H"),
    rate=field("H"),
    options=field("I"),
)
FILTER_PROFILE = record(v.FilterProfile, version=field("B"), profile=field("B"))
CAN_CONFIG = mapped(number("word", "I"), v.CanConfig.from_word, int)

# Lists

OUTPUTS = repeated(record(v.Output, data_id=field("H"), frequency=field("H")), 4, 32)
PORTS = repeated(mapped(number("word", "I"), v.PortConfig.from_word, int), 4, 3)
CAN_OUTPUTS = repeated(
    record(
        v.CanOutput,
        data_id=field("B", v.CanDataId),
        extended=field("B", bool),
        can_id=field("I"),
        frequency=field("H"),
    ),
    8,
    16,
)
PROFILES = repeated(
    record(v.AvailableProfile, type=field("B"), version=field("B"), label=field("20s", str)), 22, 10
)


def _signed(it: v.SyncSetting) -> v.SyncSetting:
    """Offsets of pulses that go out have a sign (Table 10); delays and clock periods have none (Table 9)."""
    if it.function in v.SYNC_OUT_FUNCTIONS and it.offset >= 1 << 15:
        return replace(it, offset=it.offset - (1 << 16))
    return it


def _unsigned(it: v.SyncSetting) -> v.SyncSetting:
    signed = it.function in v.SYNC_OUT_FUNCTIONS and -(1 << 15) <= it.offset < 0
    return replace(it, offset=it.offset + (1 << 16)) if signed else it


_sync_setting = record(
    v.SyncSetting,
    function=field("B", v.SyncFunction),
    line=field("B", v.SyncLine),
    polarity=field("B", v.Polarity),
    trigger_once=field("B", bool),
    skip_first=field("H"),
    skip_factor=field("H"),
    pulse_width=field("H"),
    offset=field("H"),
)
SYNC_SETTINGS = repeated(mapped(_sync_setting, _signed, _unsigned), 12, 10)

# Those that tell by their length what they are

STRINGS = by_length(
    {
        2: record(v.StringOutput, types=field("H", v.StringType)),
        6: record(v.StringOutput, types=field("I", v.StringType), frequency=field("H")),
    },
    lambda it: 2 if it.frequency is None else 6,
)


def _encode_rotation(it: v.AlignmentRotation) -> bytes:
    parameter = b"" if it.parameter is None else bytes([it.parameter])
    return parameter + struct.pack(">4f", *it.quaternion)


def _decode_rotation(payload: bytes) -> v.AlignmentRotation:
    if len(payload) not in (16, 17):
        raise ValueError(f"it has {len(payload)} bytes, not 17, or 16 of old firmware")
    *parameter, q0, q1, q2, q3 = struct.unpack(">B4f" if len(payload) == 17 else ">4f", payload)
    which = v.known(v.Alignment, parameter[0]) if parameter else None
    return v.AlignmentRotation(which, (q0, q1, q2, q3))


def _quaternion(word: str) -> tuple[float, ...]:
    numbers = tuple(map(float, word.split(",")))
    if len(numbers) != 4:
        raise ValueError(f"{word!r} is not four numbers with commas between")
    return numbers


ROTATION = Layout(
    _encode_rotation,
    _decode_rotation,
    {"parameter": field("B", v.Alignment).read, "quaternion": _quaternion},
    v.AlignmentRotation,
)


def _encode_icc(it: v.IccReply) -> bytes:
    if it.result is not None:
        return struct.pack(">BfBB", it.command, *it.result)
    return bytes([it.command]) if it.active is None else bytes([it.command, it.active])


def _decode_icc(payload: bytes) -> v.IccReply:
    if len(payload) not in (1, 2, 7):
        raise ValueError(f"it has {len(payload)} bytes, not 1, 2 or 7")
    command = v.known(v.IccCommand, payload[0])
    if len(payload) == 7:
        _, ddt, dimension, status = struct.unpack(">BfBB", payload)
        return v.IccReply(command, v.IccResult(ddt, dimension, v.IccStatus(status)))
    return v.IccReply(command, active=bool(payload[1]) if len(payload) == 2 else None)


ICC_REPLY = Layout(_encode_icc, _decode_icc)


def _decode_error(payload: bytes) -> v.DeviceErrorInfo:
    if not payload:
        raise ValueError("it has no code")
    return v.DeviceErrorInfo(payload[0], payload[1:])


def _decode_warning(payload: bytes) -> v.DeviceWarning:
    if len(payload) < 4:
        raise ValueError(f"it has {len(payload)} bytes, not the four of its code")
    code = int.from_bytes(payload[:4], "big")
    return v.DeviceWarning(code, payload[4:].decode("ascii", "replace").rstrip("\0 "))


ERROR = Layout(lambda it: bytes([it.code]) + it.extra, _decode_error)
WARNING = Layout(lambda it: struct.pack(">I", it.code) + it.text.encode("ascii"), _decode_warning)


def _decode_configuration(payload: bytes) -> Configuration:
    if (configuration := Configuration.read(payload)) is None:
        raise ValueError(f"it has {len(payload)} bytes, not the 118 of Table 13")
    return configuration


def _encode_configuration(it: Configuration) -> bytes:
    """Tables 13 and 14, the tail as devices fill it (`rust/src/device.rs` reads the same)."""
    if it.device_id >> 31:
        # Eight bytes stand with their halves exchanged, against the DeviceID message.
        identity = struct.pack(">II", it.device_id & 0xFFFF_FFFF, it.device_id >> 32)
        head, device = identity, identity + bytes(4)
    else:
        head = struct.pack(
            ">IHH", it.device_id, it.sampling_period or 0, it.output_skip_factor or 0
        )
        device = struct.pack(">IHHI", it.device_id, 0, it.output_mode or 0, it.output_settings or 0)
    date, time = ((text or "").encode("ascii").ljust(8, b"\0") for text in (it.date, it.time))
    code = (it.product_code or "").encode("ascii").ljust(20 if it.product_code else 0)
    host = code.ljust(32, b"\0") + bytes(32)
    kind = (it.filter_type or "\0").encode("ascii")
    versions = (*it.firmware[:3], kind, *it.filter_version)
    tail = struct.pack(">H3BcBB", it.filter_profile, *versions)
    return head + bytes(8) + date + time + host + struct.pack(">H", it.devices) + device + tail


CONFIGURATION = Layout(_encode_configuration, _decode_configuration)

#: Layouts by name; messages that carry nothing, or nobody knows what, need no line.
LAYOUTS: dict[str, Layout] = {
    "DeviceID": DEVICE_ID,
    "InitBusResults": repeated(number("device_id", "I"), 4, 8),
    "SetPeriod": PERIOD,
    "ReqPeriodAck": PERIOD,
    "DataLength": number("length", "H"),
    "Configuration": CONFIGURATION,
    "FirmwareRev": FIRMWARE,
    "SetBaudrate": BAUDRATE,
    "ReqBaudrateAck": BAUDRATE,
    "ProductCode": text(20, filled=20),
    "HardwareVersion": HARDWARE,
    "SetProcessingFlags": number("flags", "B"),
    "SetNoRotation": number("duration", "H"),
    "SelftestResults": number("results", "H", v.Selftest),
    "SetSyncSettings": SYNC_SETTINGS,
    "ReqSyncSettingsAck": SYNC_SETTINGS,
    "Error": ERROR,
    "Warning": WARNING,
    "SetOptionFlags": record(
        v.OptionFlags, set=field("I", v.OptionFlag), clear=field("I", v.OptionFlag)
    ),
    "ReqOptionFlagsAck": OPTION_FLAGS,
    "SetUTCTime": UTC_TIME,
    "UTCTime": UTC_TIME,
    "AvailableFilterProfiles": PROFILES,
    "SetFilterProfile": number("profile", "H"),
    "SetFilterProfileModern": text(62),
    "ReqFilterProfileAck": FILTER_PROFILE,
    "ReqFilterProfileAckModern": text(62),
    "SetGravityMagnitude": number("gravity", "f", float),
    "SetGnssLeverArm": LEVER_ARM,
    "ReqGnssLeverArmAck": LEVER_ARM,
    "SetLatLonAlt": LAT_LON_ALT,
    "ReqLatLonAltAck": LAT_LON_ALT,
    "IccCommand": number("command", "B", v.IccCommand),
    "IccCommandAck": ICC_REPLY,
    "SetGnssPlatform": PLATFORM,
    "ReqGnssPlatformAck": PLATFORM,
    "SetHeading": number("heading", "f", float),
    "SetLocationID": LOCATION_ID,
    "ReqLocationIDAck": LOCATION_ID,
    "SetExtOutputMode": number("mode", "H", v.ExtOutputMode),
    "ExtOutputMode": number("mode", "H", v.ExtOutputMode),
    "SetPortConfig": PORTS,
    "PortConfig": PORTS,
    "SetStringOutputType": STRINGS,
    "ReqStringOutputTypeAck": STRINGS,
    "ReqEmts": RAW,
    "SetAmd": number("setting", "H"),
    "ResetOrientation": number("code", "H", v.ResetCode),
    "AdjustUTCTime": number("ticks", "i"),
    "SetGnssReceiverSettings": RECEIVER,
    "GnssReceiverSettings": RECEIVER,
    "SetOutputConfiguration": OUTPUTS,
    "ReqOutputConfigurationAck": OUTPUTS,
    "SetOutputConfigurationAck": OUTPUTS,
    "SetOutputMode": MODE,
    "ReqOutputModeAck": MODE,
    "SetOutputSettings": number("settings", "I"),
    "ReqOutputSettingsAck": number("settings", "I"),
    "SetOutputSkipFactor": SKIP_FACTOR,
    "ReqOutputSkipFactorAck": SKIP_FACTOR,
    "SetInitialHeading": number("heading", "f", float),
    "SetErrorMode": MODE,
    "ReqErrorModeAck": MODE,
    "SetTransmitDelay": DELAY,
    "ReqTransmitDelayAck": DELAY,
    "ForwardGnssData": RAW,
    "SetCanConfig": CAN_CONFIG,
    "CanConfig": CAN_CONFIG,
    "SetCanOutputConfig": CAN_OUTPUTS,
    "CanOutputConfig": CAN_OUTPUTS,
    "SetCanOutputConfigAck": CAN_OUTPUTS,
    "ReqAlignmentRotation": number("parameter", "B", v.Alignment),
    "SetAlignmentRotation": ROTATION,
    "ReqAlignmentRotationAck": ROTATION,
}
LAYOUTS.update(
    {
        it.name: NOTHING if it.payload == "empty" else RAW
        for it in MESSAGES
        if it.name not in LAYOUTS
    }
)


def encode(name: str, value: Any = None) -> bytes:
    """The payload of a message.

    Args:
        name: Name of the message, as in `xbus.tables.MESSAGES`.
        value: What it is to say, of the type that its layout has; None where it carries nothing.

    Raises:
        KeyError: No message is called that.
        ValueError: The value does not fit.

    >>> from xbus.protocol import OptionFlag, OptionFlags, encode
    >>> encode("SetOptionFlags", OptionFlags(set=OptionFlag.ENABLE_AHS)).hex()
    '0000001000000000'
    """
    payload = LAYOUTS[name].encode(value)
    row = ROWS[name]
    if row.direction == "to device" and row.lengths is not None and len(payload) not in row.lengths:
        raise ValueError(f"{name} carries {row.payload}, not {len(payload)} bytes")
    return payload


def decode(name: str, payload: bytes) -> Any:
    """What the payload of a message says; None where it carries nothing.

    Raises:
        KeyError: No message is called that.
        ValueError: The payload has the wrong length.

    >>> from xbus.protocol import decode
    >>> decode("HardwareVersion", bytes([2, 0]))
    HardwareVersion(major=2, minor=0)
    """
    return LAYOUTS[name].decode(payload)
