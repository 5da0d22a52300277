"""The layout of each message, and `encode` and `decode`, which use it.

Fields, lengths, states and products of a message are in its row of the table, `MESSAGES`. This module
adds what a row cannot express: the types of the values, and the few payloads whose values are more than their
fields. Host and virtual device use the same layouts.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields, replace
from types import SimpleNamespace
from typing import Any

from xbus import _core
from xbus.protocol import values as v
from xbus.protocol.configuration import Configuration, Firmware
from xbus.protocol.ids import Coordinates, DataId, Precision
from xbus.protocol.layout import (
    FieldLayout,
    Form,
    Layout,
    kinds_of,
    layout_of,
    mapped,
    record,
    repeated,
)
from xbus.protocol.tables import MESSAGES, MessageRow

__all__ = ["LAYOUTS", "decode", "encode"]

#: Types of values, and the messages that have them: enumerations of a single number, classes of records.
_TYPES: tuple[tuple[type, str], ...] = (
    (Firmware, "FirmwareRev"),
    (v.HardwareVersion, "HardwareVersion"),
    (v.Selftest, "SelftestResults"),
    (v.DeviceErrorInfo, "Error"),
    (v.DeviceWarning, "Warning"),
    (v.OptionFlags, "SetOptionFlags"),
    (v.OptionFlag, "ReqOptionFlagsAck"),
    (v.StringOutput, "SetStringOutputType ReqStringOutputTypeAck"),
    (v.Alignment, "ReqAlignmentRotation"),
    (v.AlignmentRotation, "SetAlignmentRotation ReqAlignmentRotationAck"),
    (v.ExtOutputMode, "SetExtOutputMode ExtOutputMode"),
    (v.OutputMode, "SetOutputMode ReqOutputModeAck"),
    (v.CanOutput, "SetCanOutputConfig CanOutputConfig SetCanOutputConfigAck"),
    (v.LatLonAlt, "SetLatLonAlt ReqLatLonAltAck"),
    (v.AvailableProfile, "AvailableFilterProfiles"),
    (v.FilterProfile, "ReqFilterProfileAck"),
    (v.GnssPlatform, "SetGnssPlatform ReqGnssPlatformAck"),
    (v.GnssLeverArm, "SetGnssLeverArm ReqGnssLeverArmAck"),
    (v.ResetCode, "ResetOrientation"),
    (v.UtcTime, "SetUTCTime UTCTime"),
    (v.IccCommand, "IccCommand"),
)
_TYPE_OF = {name: kind for kind, names in _TYPES for name in names.split()}


# Payloads whose values are more than their fields


def _check_type(value: Any, kind: type) -> None:
    if not isinstance(value, kind):
        raise ValueError(f"{value!r} is not a {kind.__name__}")  # noqa: TRY004 - every misfit is a ValueError


def _device_id(row: MessageRow) -> Layout:
    layout = layout_of(row)
    wide, narrow = (Form([FieldLayout(field) for field in form]) for form in row.forms)

    def encode(number: Any) -> bytes:
        # Identifiers from the 600-series on have bit 31 set, and eight bytes.
        is_wide = isinstance(number, int) and number >> 31
        payload = (wide if is_wide else narrow).encode({"device_id": number})
        if is_wide and _core.device_id(payload) != number:
            raise ValueError(
                f"device_id cannot be 0x{number:X}: beyond four bytes, bit 31 must be set"
            )
        return payload

    def decode(payload: bytes) -> int:
        # Some firmware leaves other bytes in the second half.
        number = _core.device_id(payload)
        return int(layout.decode(payload)) if number is None else number

    return replace(layout, encode=encode, decode=decode)


_FORMATS = {**Precision.__members__, **Coordinates.__members__}


def _outputs(row: MessageRow) -> Layout:
    layout = layout_of(row, v.Output)
    data_id = FieldLayout(row.forms[0][0], DataId)

    def read(word: str) -> int:
        """Returns the identifier of ``0x2014``, or of the manual's name with a format: ``Quaternion|NED``."""
        name, *formats = word.split("|")
        known = {name.upper(): bits for name, bits in _FORMATS.items()}
        if unknown := [name for name in formats if name.upper() not in known]:
            raise ValueError(f"{unknown[0]!r} is not one of {', '.join(_FORMATS)}")
        return int(data_id.read(name)) + sum(known[name.upper()] for name in formats)

    return replace(
        layout,
        fields={**layout.fields, "data_id": read},
        kinds={**layout.kinds, "data_id": DataId},
    )


def _sync_settings(row: MessageRow) -> Layout:
    # Delays and clock periods are unsigned (Table 9), offsets of output pulses are signed (Table 10).
    *others, offset = row.forms[0]
    unsigned = record([row.forms[0]], v.SyncSetting)
    signed = record([(*others, offset._replace(type="i2"))], v.SyncSetting)

    def by_function(function: Any) -> Layout:
        is_signed = isinstance(function, int) and function in v.SYNC_OUT_FUNCTIONS
        return signed if is_signed else unsigned

    entry = replace(
        unsigned,
        encode=lambda setting: by_function(getattr(setting, "function", None)).encode(setting),
        decode=lambda payload: by_function(payload[0]).decode(payload),
    )
    return repeated(entry, row)


def _word(row: MessageRow, kind: type[v.PortConfig | v.CanConfig | v.OutputSettings]) -> Layout:
    """Returns the layout of words of bits; on a command line each part of a word is a field."""
    kinds = kinds_of(kind)
    names = [part.name for part in fields(kind) if part.name != "reserved"]
    parts = [
        FieldLayout(row.forms[0][0]._replace(name=name), kinds.get(name, int)) for name in names
    ]

    def to_word(value: Any) -> int:
        _check_type(value, kind)
        return int(value)

    word = mapped(record(row.forms, int), kind.from_word, to_word)
    word = replace(
        word,
        fields={part.name: part.read for part in parts},
        make=kind,
        kinds={part.name: part.kind for part in parts},
    )
    return repeated(word, row) if row.kind == "list" else word


def _icc_reply(row: MessageRow) -> Layout:
    kinds: dict[str, type] = {"command": v.IccCommand, "status": v.IccStatus, "active": bool}

    def to_reply(fields: SimpleNamespace) -> v.IccReply:
        result = (
            None if fields.ddt is None else v.IccResult(fields.ddt, fields.dimension, fields.status)
        )
        return v.IccReply(fields.command, result, fields.active)

    def to_fields(reply: v.IccReply) -> SimpleNamespace:
        _check_type(reply, v.IccReply)
        result = {} if reply.result is None else reply.result._asdict()
        return SimpleNamespace(command=reply.command, active=reply.active, **result)

    return mapped(record(row.forms, SimpleNamespace, kinds), to_reply, to_fields)


def _configuration(row: MessageRow) -> Layout:
    (form,) = row.forms
    wire = Form([FieldLayout(field) for field in form])

    def encode(value: Configuration) -> bytes:
        _check_type(value, Configuration)
        # The halves of an identifier of eight bytes are in the opposite order of the DeviceID message. They
        # occupy fields that only devices with four bytes use.
        low, high = value.device_id & 0xFFFF_FFFF, value.device_id >> 32
        wide = value.device_id >> 31
        # Without bit 31 in the low half, the identifier would be taken for one of four bytes.
        if not 0 <= value.device_id < 1 << 64 or (wide and not wide & 1):
            raise ValueError(
                f"device_id cannot be 0x{value.device_id:X}: it must fit eight bytes with bit 31 set, or four"
            )
        major, minor, revision, *_ = value.firmware
        filter_major, filter_minor = value.filter_version
        return wire.encode(
            {
                "device_id": low,
                "sampling_period": high >> 16 if wide else value.sampling_period or 0,
                "output_skip_factor": high & 0xFFFF if wide else value.output_skip_factor or 0,
                "date": (value.date or "").encode("ascii"),
                "time": (value.time or "").encode("ascii"),
                "product_code": value.product_code.encode("ascii").ljust(20)
                if value.product_code
                else b"",
                **dict.fromkeys(("sync_in", "host", "client"), b""),
                "devices": value.devices,
                "first_device_id": low,
                "data_length": high >> 16 if wide else value.data_length,
                "output_mode": high & 0xFFFF if wide else value.output_mode or 0,
                "output_settings": 0 if wide else value.output_settings or 0,
                "filter_profile": value.filter_profile,
                "major": major,
                "minor": minor,
                "revision": revision,
                "filter_type": (value.filter_type or "").encode("ascii"),
                "filter_major": filter_major,
                "filter_minor": filter_minor,
            }
        )

    def decode(payload: bytes) -> Configuration:
        if (configuration := Configuration.read(payload)) is None:
            raise ValueError(f"the payload has {len(payload)} bytes, not {wire.size}")
        return configuration

    return Layout(encode, decode)


def _with_baudrate(layout: Layout, field: str, rates: Mapping[int, int]) -> Layout:
    """Returns the layout with ``baudrate``, bits per second, as another name of a field with a code."""
    codes = v.usual_codes(rates)

    def read(word: str) -> int:
        if not word.isdecimal() or int(word) not in codes:
            raise ValueError(f"{word!r} is not one of {', '.join(map(str, sorted(codes)))}")
        return codes[int(word)]

    return replace(layout, aliases={"baudrate": (field, read)})


def _baudrate(row: MessageRow) -> Layout:
    return _with_baudrate(layout_of(row), "code", v.BAUD_CODES)


def _ports(row: MessageRow) -> Layout:
    return _with_baudrate(_word(row, v.PortConfig), "baud_code", v.BAUD_CODES)


def _can(row: MessageRow) -> Layout:
    return _with_baudrate(_word(row, v.CanConfig), "baud_code", v.CAN_BAUD_CODES)


def _gnss_receiver(row: MessageRow) -> Layout:
    return _with_baudrate(layout_of(row, v.GnssReceiverSettings), "baud_code", v.BAUD_CODES)


def _output_settings(row: MessageRow) -> Layout:
    word, number = _word(row, v.OutputSettings), record(row.forms, int)

    def encode(value: Any) -> bytes:
        # Other software has the settings as a number.
        return (number if type(value) is int else word).encode(value)

    return replace(word, encode=encode)


#: A channel in GnssStatus: channel, satellite, flags, quality, carrier-to-noise ratio.
_CHANNEL = struct.Struct(">BBBbb")


def _gnss_status(_: MessageRow) -> Layout:
    def encode(channels: Any) -> bytes:
        try:
            rows = [_CHANNEL.pack(*channel) for channel in channels]
            return bytes([len(rows)]) + b"".join(rows)
        except (struct.error, TypeError, ValueError) as error:
            raise ValueError(f"{channels!r} are not at most 255 channels: {error}") from None

    def decode(payload: bytes) -> tuple[v.GnssChannel, ...]:
        count = payload[0] if payload else 0
        if len(payload) != 1 + count * _CHANNEL.size:
            raise ValueError(
                f"the payload has {len(payload)} bytes, which do not fit {count} channels"
            )
        return tuple(map(v.GnssChannel._make, _CHANNEL.iter_unpack(payload[1:])))

    return Layout(encode, decode)


_SPECIAL: dict[str, Callable[[MessageRow], Layout]] = {
    "DeviceID": _device_id,
    "SetSyncSettings": _sync_settings,
    "ReqSyncSettingsAck": _sync_settings,
    "Configuration": _configuration,
    "SetOutputConfiguration": _outputs,
    "ReqOutputConfigurationAck": _outputs,
    "SetOutputConfigurationAck": _outputs,
    "SetBaudrate": _baudrate,
    "ReqBaudrateAck": _baudrate,
    "SetGnssReceiverSettings": _gnss_receiver,
    "GnssReceiverSettings": _gnss_receiver,
    "SetPortConfig": _ports,
    "PortConfig": _ports,
    "SetCanConfig": _can,
    "CanConfig": _can,
    "IccCommandAck": _icc_reply,
    "SetOutputSettings": _output_settings,
    "ReqOutputSettingsAck": _output_settings,
    "GnssStatus": _gnss_status,
}


class _Layouts(Mapping[str, Layout]):
    """Layouts by name, made on first access: a program needs few of them, and all take 5 ms."""

    def __init__(self) -> None:
        self._made: dict[str, Layout] = {}

    def __getitem__(self, name: str) -> Layout:
        if name not in self._made:
            row = MESSAGES[name]
            special = _SPECIAL.get(name)
            self._made[name] = special(row) if special else layout_of(row, _TYPE_OF.get(name, int))
        return self._made[name]

    def __iter__(self) -> Iterator[str]:
        return iter(MESSAGES)

    def __len__(self) -> int:
        return len(MESSAGES)


#: The layout of each message, by its name.
LAYOUTS = _Layouts()


def encode(name: str, value: Any = None) -> bytes:
    """Returns the payload of a message.

    Args:
        name: Name of the message, as in `xbus.protocol.tables.MESSAGES`.
        value: The value, of the type that the layout has; None for a message without a payload.

    Raises:
        KeyError: No message has this name.
        ValueError: The value does not fit.

    >>> from xbus.protocol import OptionFlag, OptionFlags, encode
    >>> encode("SetOptionFlags", OptionFlags(set=OptionFlag.ENABLE_AHS)).hex()
    '0000001000000000'
    """
    payload = LAYOUTS[name].encode(value)
    row = MESSAGES[name]
    if row.lengths is not None and len(payload) not in row.lengths:
        raise ValueError(f"the payload of {name} is {row.payload}, not {len(payload)} bytes")
    return payload


def decode(name: str, payload: bytes) -> Any:
    """Returns the value of a payload; None for a message without a payload.

    Raises:
        KeyError: No message has this name.
        ValueError: The payload has the wrong length.

    >>> from xbus.protocol import decode
    >>> decode("HardwareVersion", bytes([2, 0]))
    HardwareVersion(major=2, minor=0)
    """
    return LAYOUTS[name].decode(payload)
