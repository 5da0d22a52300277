"""What each message says: a layout for every row of the table of messages, by its name there.

Lengths, states and products of a message are in `xbus.protocol.tables.MESSAGES`; here is what its bytes
mean. A row serves both sides: what the host writes a virtual device reads, and the other way round.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from types import SimpleNamespace
from typing import Any

from xbus import _core
from xbus.protocol import values as v
from xbus.protocol.configuration import Configuration, Firmware
from xbus.protocol.ids import Coordinates, DataId, Precision
from xbus.protocol.layout import (
    NOTHING,
    RAW,
    Field,
    Layout,
    by_length,
    mapped,
    number,
    record,
    repeated,
    text,
)
from xbus.protocol.tables import MESSAGES, MessageRow

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
    major=Field("B"),
    minor=Field("B"),
    revision=Field("B"),
    build=Field("I"),
    scm=Field("I"),
)
_old_version = record(Firmware, major=Field("B"), minor=Field("B"), revision=Field("B"))
FIRMWARE = by_length({11: _version, 3: _old_version}, lambda it: 3 if it.build is None else 11)
HARDWARE = record(v.HardwareVersion, major=Field("B"), minor=Field("B"))
UTC_TIME = record(
    v.UtcTime,
    ns=Field("I"),
    year=Field("H"),
    month=Field("B"),
    day=Field("B"),
    hour=Field("B"),
    minute=Field("B"),
    second=Field("B"),
    valid=Field("B"),
)
LAT_LON_ALT = by_length(
    {
        24: record(
            v.LatLonAlt, lat=Field("d", float), lon=Field("d", float), alt=Field("d", float)
        ),
        12: record(
            v.LatLonAlt, lat=Field("f", float), lon=Field("f", float), alt=Field("f", float)
        ),
    },
    lambda _: 24,
)
LEVER_ARM = record(v.GnssLeverArm, x=Field("f", float), y=Field("f", float), z=Field("f", float))
RECEIVER = record(
    v.GnssReceiverSettings,
    receiver=Field("H", v.GnssReceiver),
    baud_code=Field("H"),
    rate=Field("H"),
    options=Field("I"),
)
FILTER_PROFILE = record(v.FilterProfile, version=Field("B"), profile=Field("B"))
CAN_CONFIG = replace(
    mapped(number("word", "I"), v.CanConfig.from_word, int),
    fields={"baud_code": Field("B").read, "enabled": Field("B", bool).read},
    make=v.CanConfig,
)

# Lists


def _data_id(word: str) -> int:
    """``0x2014``, or the manual's name with its format: ``Quaternion|NED``."""
    name, *formats = word.split("|")
    known = {it.upper(): format_ for it, format_ in _FORMATS.items()}
    if unknown := [it for it in formats if it.upper() not in known]:
        raise ValueError(f"{unknown[0]!r} is none of {', '.join(_FORMATS)}")
    return int(Field("H", DataId).read(name)) + sum(known[it.upper()] for it in formats)


_FORMATS = {**Precision.__members__, **Coordinates.__members__}
_output = record(v.Output, data_id=Field("H"), frequency=Field("H"))
_output = replace(_output, fields={**_output.fields, "data_id": _data_id})
OUTPUTS = repeated(_output, 4, 32)
_port = replace(
    mapped(number("word", "I"), v.PortConfig.from_word, int),
    fields={
        "protocol": Field("B", v.PortProtocol).read,
        "baud_code": Field("B").read,
        "flow_control": Field("B", bool).read,
        "two_stop_bits": Field("B", bool).read,
        "parity": Field("B", bool).read,
        "parity_even": Field("B", bool).read,
    },
    make=v.PortConfig,
)
PORTS = repeated(_port, 4, 3)
CAN_OUTPUTS = repeated(
    record(
        v.CanOutput,
        data_id=Field("B", v.CanDataId),
        extended=Field("B", bool),
        can_id=Field("I"),
        frequency=Field("H"),
    ),
    8,
    16,
)
PROFILES = repeated(
    record(v.AvailableProfile, type=Field("B"), version=Field("B"), label=Field("20s", str)), 22, 10
)


def _sync_setting(offset: Field) -> Layout:
    return record(
        v.SyncSetting,
        function=Field("B", v.SyncFunction),
        line=Field("B", v.SyncLine),
        polarity=Field("B", v.Polarity),
        trigger_once=Field("B", bool),
        skip_first=Field("H"),
        skip_factor=Field("H"),
        pulse_width=Field("H"),
        offset=offset,
    )


# Delays and clock periods have no sign (Table 9), offsets of pulses that go out have one (Table 10).
_sync_in, _sync_out = _sync_setting(Field("H")), _sync_setting(Field("h"))


def _sync(function: int) -> Layout:
    return _sync_out if function in v.SYNC_OUT_FUNCTIONS else _sync_in


SYNC_SETTINGS = repeated(
    replace(
        _sync_in,
        encode=lambda it: _sync(it.function).encode(it),
        decode=lambda payload: _sync(payload[0]).decode(payload),
    ),
    12,
    10,
)

# Those that tell by their length what they are

STRINGS = by_length(
    {
        6: record(v.StringOutput, types=Field("I", v.StringType), frequency=Field("H")),
        2: record(v.StringOutput, types=Field("H", v.StringType)),
    },
    lambda it: 2 if it.frequency is None else 6,
)

_four = {name: Field("f", float) for name in ("q0", "q1", "q2", "q3")}
_rotation = by_length(
    {
        17: record(SimpleNamespace, parameter=Field("B", v.Alignment), **_four),
        16: record(partial(SimpleNamespace, parameter=None), **_four),
    },
    lambda it: 16 if it.parameter is None else 17,
)


def _rotation_of(it: SimpleNamespace) -> v.AlignmentRotation:
    return v.AlignmentRotation(it.parameter, (it.q0, it.q1, it.q2, it.q3))


def _numbers_of(it: v.AlignmentRotation) -> SimpleNamespace:
    if len(it.quaternion) != len(_four):
        raise ValueError(f"quaternion cannot be {it.quaternion!r}: it must be four numbers")
    return SimpleNamespace(parameter=it.parameter, **dict(zip(_four, it.quaternion, strict=True)))


def _quaternion(word: str) -> tuple[float, ...]:
    numbers = tuple(map(float, word.split(",")))
    if len(numbers) != 4:
        raise ValueError(f"{word!r} is not four numbers with commas between")
    return numbers


ROTATION = replace(
    mapped(_rotation, _rotation_of, _numbers_of),
    fields={"parameter": Field("B", v.Alignment).read, "quaternion": _quaternion},
    make=v.AlignmentRotation,
)

_command = Field("B", v.IccCommand)
_icc_result = record(
    SimpleNamespace,
    command=_command,
    ddt=Field("f", float),
    dimension=Field("B"),
    status=Field("B", v.IccStatus),
)
ICC_REPLY = by_length(
    {
        1: record(v.IccReply, command=_command),
        2: record(v.IccReply, command=_command, active=Field("B", bool)),
        7: mapped(
            _icc_result,
            lambda it: v.IccReply(it.command, v.IccResult(it.ddt, it.dimension, it.status)),
            lambda it: SimpleNamespace(command=it.command, **it.result._asdict()),
        ),
    },
    lambda it: 7 if it.result is not None else 1 if it.active is None else 2,
)


def _decode_error(payload: bytes) -> v.DeviceErrorInfo:
    if not payload:
        raise ValueError("it has no code")
    return v.DeviceErrorInfo(payload[0], payload[1:])


def _decode_warning(payload: bytes) -> v.DeviceWarning:
    if len(payload) < 4:
        raise ValueError(f"it has {len(payload)} bytes, not the four of its code")
    code = int.from_bytes(payload[:4], "big")
    return v.DeviceWarning(code, payload[4:].decode("ascii", "replace").rstrip("\0 "))


_error_code, _warning_code = number("code", "B"), number("code", "I")
ERROR = Layout(lambda it: _error_code.encode(it.code) + it.extra, _decode_error)
WARNING = Layout(
    lambda it: _warning_code.encode(it.code) + it.text.encode("ascii"), _decode_warning
)

# Configuration: Tables 13 and 14, the tail as devices fill it (`rust/src/device.rs` reads the same)

_middle = {
    "sync_in": Field("8s", bytes),
    "date": Field("8s", bytes),
    "time": Field("8s", bytes),
    "product_code": Field("20s", bytes),
    "host": Field("12s", bytes),
    "client": Field("32s", bytes),
    "devices": Field("H"),
}
_tail = {
    "filter_profile": Field("H"),
    "major": Field("B"),
    "minor": Field("B"),
    "revision": Field("B"),
    "filter_type": Field("1s", bytes),
    "filter_major": Field("B"),
    "filter_minor": Field("B"),
}
_narrow = record(
    SimpleNamespace,
    device_id=Field("I"),
    sampling_period=Field("H"),
    output_skip_factor=Field("H"),
    **_middle,
    same_id=Field("I"),
    data_length=Field("H"),
    output_mode=Field("H"),
    output_settings=Field("I"),
    **_tail,
)
# Eight bytes of identifier stand with their halves exchanged, against the DeviceID message.
_wide = record(
    SimpleNamespace,
    low=Field("I"),
    high=Field("I"),
    **_middle,
    same_low=Field("I"),
    same_high=Field("I"),
    reserved=Field("4s", bytes),
    **_tail,
)


def _decode_configuration(payload: bytes) -> Configuration:
    if (configuration := Configuration.read(payload)) is None:
        raise ValueError(f"it has {len(payload)} bytes, not the 118 of Table 13")
    return configuration


def _encode_configuration(it: Configuration) -> bytes:
    low, high = it.device_id & 0xFFFF_FFFF, it.device_id >> 32
    major, minor, revision, *_ = it.firmware
    filter_major, filter_minor = it.filter_version
    wire = SimpleNamespace(
        device_id=it.device_id,
        same_id=it.device_id,
        low=low,
        high=high,
        same_low=low,
        same_high=high,
        sampling_period=it.sampling_period or 0,
        output_skip_factor=it.output_skip_factor or 0,
        date=(it.date or "").encode("ascii"),
        time=(it.time or "").encode("ascii"),
        product_code=it.product_code.encode("ascii").ljust(20) if it.product_code else b"",
        devices=it.devices,
        data_length=0,
        **dict.fromkeys(("sync_in", "host", "client", "reserved"), b""),
        output_mode=it.output_mode or 0,
        output_settings=it.output_settings or 0,
        filter_profile=it.filter_profile,
        major=major,
        minor=minor,
        revision=revision,
        filter_type=(it.filter_type or "").encode("ascii"),
        filter_major=filter_major,
        filter_minor=filter_minor,
    )
    return (_wide if it.device_id >> 31 else _narrow).encode(wire)


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
        v.OptionFlags, set=Field("I", v.OptionFlag), clear=Field("I", v.OptionFlag)
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
        name: Name of the message, as in `xbus.protocol.tables.MESSAGES`.
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
    if row.lengths is not None and len(payload) not in row.lengths:
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
