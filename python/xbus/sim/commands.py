"""What a virtual device does when it is asked: a table of requests and handlers.

A handler gets the device and the value that the request carries, and returns the payload of the reply.
States, products and lengths were looked at before.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import takewhile
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from xbus.protocol.messages import encode
from xbus.protocol.products import BASE, HEADING, Support
from xbus.protocol.tables import MESSAGES
from xbus.protocol.values import (
    ERROR_MODES,
    PERIODS,
    PULSE_OFFSETS,
    SYNC_DELAYS,
    SYNC_OUT_FUNCTIONS,
    TRANSMIT_DELAYS,
    Alignment,
    AlignmentRotation,
    AvailableProfile,
    CanDataId,
    CanOutput,
    ErrorCode,
    ExtOutputMode,
    FilterProfile,
    GnssPlatform,
    GnssReceiver,
    GnssReceiverSettings,
    IccCommand,
    IccReply,
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
    SyncFunction,
    SyncSetting,
    UtcTime,
    baudrate,
)
from xbus.sim.memory import factory_settings
from xbus.sim.sync import SyncInputs

if TYPE_CHECKING:
    from xbus.sim.unit import Unit

__all__ = ["COMMANDS", "Command", "Refused"]

Command: TypeAlias = "Callable[[Unit, Any], bytes]"

#: Slots in AvailableFilterProfiles; those behind the last profile are empty (Table 29).
PROFILE_SLOTS = 5
#: The bits of Table 21.
EXT_MODES = ExtOutputMode.ALTERNATIVE_UART | ExtOutputMode.USB_LOW_LATENCY
#: Ticks of AdjustUTCTime, in ns.
UTC_TICK = 100_000


class Refused(Exception):  # noqa: N818 - it is an answer
    """The device answers with an Error message.

    Attributes:
        code: Which one (Table 5).
    """

    def __init__(self, code: ErrorCode) -> None:
        super().__init__(code)
        self.code = code


def _require(is_valid: object, code: ErrorCode = ErrorCode.PARAMETER) -> None:
    if not is_valid:
        raise Refused(code)


def _is_within(flags: int, mask: int) -> bool:
    """Whether all bits that are set are among these, which of them have names or not."""
    return not int(flags) & ~int(mask)


# States


def _go_to_config(unit: Unit, _: None) -> bytes:
    unit.go_to_config()
    return b""


def _go_to_measurement(unit: Unit, _: None) -> bytes:
    unit.go_to_measurement()
    return b""


def _reset(unit: Unit, _: None) -> bytes:
    unit.restart()
    return b""


# The device


def _selftest(unit: Unit, _: None) -> bytes:
    nine = Selftest((Selftest.MAG_Z << 1) - 1)
    more = Selftest.BARO | Selftest.GNSS if unit.product.number == 7 else Selftest(0)
    return encode("SelftestResults", nine | more)


def _set_baudrate(unit: Unit, code: int) -> bytes:
    _require(baudrate(code) in unit.support.baudrates, ErrorCode.BAUDRATE)
    changed = unit.settings.with_baud_code(code)
    unit.memory.change(baud_code=changed.baud_code, port_config=changed.port_config)
    return b""


def _set_option_flags(unit: Unit, flags: OptionFlags) -> bytes:
    _require(_is_within(flags.set, unit.support.option_flags))
    kept = int(unit.settings.option_flags) & ~int(flags.clear)
    unit.memory.change(option_flags=OptionFlag(kept | flags.set))
    return b""


def _restore_factory_settings(unit: Unit, _: None) -> bytes:
    unit.memory.overwrite(factory_settings(unit.support))
    unit.sync_inputs = SyncInputs(unit.settings.sync_settings)
    return b""


# Configuration


def _set_outputs(unit: Unit, outputs: tuple[Output, ...]) -> bytes:
    effective = []
    for it in outputs:
        acknowledged = unit.support.acknowledged(it)
        # One of the four codes for coordinates is none.
        if acknowledged is not None and it.data_id & 0xC != 0xC:
            effective.append(acknowledged)
        else:
            _require(not unit.strict_outputs)
    unit.memory.change(output_configuration=tuple(effective))
    return encode("SetOutputConfigurationAck", effective)


def _set_strings(unit: Unit, strings: StringOutput) -> bytes:
    _require(_is_within(strings.types, unit.support.string_types))
    if unit.product.series == "600-series":
        # Also two bytes are taken: the manual's way to switch strings off names no product.
        strings = StringOutput(strings.types, strings.frequency or 0)
        fastest = unit.support.rates["acceleration"]
        _require(not strings.types or 1 <= (strings.frequency or 0) <= fastest)
    _require(unit.product.series == "600-series" or strings.frequency is None)
    unit.memory.change(string_output_type=strings)
    return b""


def _set_period(unit: Unit, period: int) -> bytes:
    slowest = PERIODS[-1]
    if period > slowest:
        # Slower than 100 Hz is done by leaving out.
        _require(period % slowest == 0, ErrorCode.PERIOD)
        unit.memory.change(period=slowest, output_skip_factor=period // slowest - 1)
    else:
        _require(period in PERIODS, ErrorCode.PERIOD)
        unit.memory.change(period=period)
    return b""


def _set_sync(unit: Unit, settings: tuple[SyncSetting, ...]) -> bytes:
    settings = tuple(takewhile(lambda it: it.polarity != Polarity.DISABLED, settings))
    for it in settings:
        _require(isinstance(it.function, SyncFunction) and isinstance(it.polarity, Polarity))
        _require(it.line in unit.support.sync.get(SyncFunction(it.function), ()))
        _require(it.offset in (PULSE_OFFSETS if it.function in SYNC_OUT_FUNCTIONS else SYNC_DELAYS))
    unit.memory.change(sync_settings=settings)
    unit.sync_inputs = SyncInputs(settings)
    return b""


def _rotation(unit: Unit, which: Alignment | int) -> bytes:
    _require(isinstance(which, Alignment))
    return encode("ReqAlignmentRotationAck", getattr(unit.settings, _ROTATIONS[Alignment(which)]))


def _set_rotation(unit: Unit, rotation: AlignmentRotation) -> bytes:
    _require(rotation.parameter in _ROTATIONS)
    _require(0 < math.hypot(*rotation.quaternion) < math.inf)
    unit.memory.change(**{_ROTATIONS[Alignment(rotation.parameter)]: rotation})  # type: ignore[arg-type]
    # What an orientation reset has left is out of date.
    unit.reset_rotations = None
    return b""


_ROTATIONS = {Alignment.ROT_SENSOR: "rot_sensor", Alignment.ROT_LOCAL: "rot_local"}


def _are_ports(ports: tuple[PortConfig, ...], support: Support) -> bool:
    has = factory_settings(support).port_config
    return all(
        isinstance(it.protocol, PortProtocol) and (own.protocol or not int(it))
        for it, own in zip(ports, has, strict=True)
    )


def _set_ports(unit: Unit, ports: tuple[PortConfig, ...]) -> bytes:
    _require(_are_ports(ports, unit.support))
    for it in ports:
        _require(not it.protocol or it.baudrate in unit.support.baudrates, ErrorCode.BAUDRATE)
    unit.memory.change(port_config=ports)
    return b""


# Filters


def _profiles(unit: Unit, _: None) -> bytes:
    profiles = list(unit.support.filter_profiles)
    empty = [AvailableProfile(0, 0, "")] * (PROFILE_SLOTS - len(profiles))
    return encode("AvailableFilterProfiles", profiles + empty)


def _profile(unit: Unit, _: None) -> bytes:
    profile = unit.settings.filter_profile
    if isinstance(profile, str):
        return encode("ReqFilterProfileAckModern", profile)
    found = next(it for it in unit.support.filter_profiles if it.type == profile)
    return encode("ReqFilterProfileAck", FilterProfile(found.version, found.type))


def _set_profile(unit: Unit, number: int) -> bytes:
    _require(number in (it.type for it in unit.support.filter_profiles))
    unit.memory.change(filter_profile=number)
    return b""


def _set_profile_names(unit: Unit, text: str) -> bytes:
    kinds = {it.label: it.type for it in unit.support.filter_profiles}
    names = text.split("/")
    _require(all(it in kinds for it in names))
    chosen = [kinds[it] for it in names]
    _require(chosen.count(BASE) <= 1 and chosen.count(HEADING) <= 1)
    unit.memory.change(filter_profile=text)
    return b""


def _reset_orientation(unit: Unit, code: ResetCode | int) -> bytes:
    _require(isinstance(code, ResetCode))
    # Only one of the codes is for Config, and that only for Config.
    _require((code == ResetCode.STORE) == (unit.state is State.CONFIG), ErrorCode.MESSAGE)
    if unit.measurement is not None:
        _require(code != ResetCode.HEADING or unit.product.kind != "GNSS/INS")
        unit.measurement.reset_orientation(ResetCode(code))
    elif unit.reset_rotations is not None:
        rot_sensor, rot_local = unit.reset_rotations
        unit.memory.change(
            rot_sensor=AlignmentRotation(Alignment.ROT_SENSOR, rot_sensor),
            rot_local=AlignmentRotation(Alignment.ROT_LOCAL, rot_local),
        )
    return b""


def _set_no_rotation(unit: Unit, seconds: int) -> bytes:
    _require(seconds > 0)
    if unit.measurement is not None:
        unit.measurement.update_no_rotation(seconds)
    return b""


def _set_utc_time(unit: Unit, it: UtcTime) -> bytes:
    _require(1999 <= it.year <= 2099 and it.ns <= 10**9)
    date = f"{it.year}-{it.month:02}-{it.day:02}T{it.hour:02}:{it.minute:02}:{it.second:02}"
    try:
        utc = np.datetime64(date, "ns")
    except ValueError:
        raise Refused(ErrorCode.PARAMETER) from None
    unit.set_utc(utc + np.timedelta64(it.ns, "ns"))
    return b""


def _adjust_utc_time(unit: Unit, ticks: int) -> bytes:
    unit.set_utc(unit.utc + np.timedelta64(ticks * UTC_TICK, "ns"))
    return b""


def _icc(unit: Unit, command: IccCommand | int) -> bytes:
    _require(command in (IccCommand.START, IccCommand.STOP, IccCommand.STORE, IccCommand.STATE))
    # Table 36 has one command for Config.
    _require((command == IccCommand.STORE) == (unit.state is State.CONFIG), ErrorCode.MESSAGE)
    if unit.measurement is None:
        return encode("IccCommandAck", IccReply(command))
    reply = unit.measurement.icc(IccCommand(command))
    _require(reply is not None, ErrorCode.MESSAGE)
    return encode("IccCommandAck", reply)


def _set_initial_heading(unit: Unit, heading: float) -> bytes:
    _require(-180 <= heading <= 180)
    unit.memory.change(initial_heading=heading)
    return b""


def _forward_gnss_data(unit: Unit, data: bytes) -> bytes:
    unit.receiver.correct(data)
    return b""


# Data


def _send_latest(unit: Unit, _: None) -> bytes:
    if unit.measurement is not None:
        unit.measurement.send_latest()
    return b""


# Settings that a request reads and another one writes


def _is_place(it: LatLonAlt, _: Support) -> bool:
    return abs(it.lat) <= 90 and abs(it.lon) <= 180 and math.isfinite(it.alt)


def _is_receiver(it: GnssReceiverSettings, _: Support) -> bool:
    return isinstance(it.receiver, GnssReceiver) and baudrate(it.baud_code) is not None


def _are_can_outputs(outputs: tuple[CanOutput, ...], _: Support) -> bool:
    return all(isinstance(it.data_id, CanDataId) for it in outputs)


def _ask(reply: str, read: Callable[[Unit], Any]) -> Command:
    return lambda unit, _: encode(reply, read(unit))


def _reader(message: str, setting: str) -> tuple[str, Command]:
    """The request for a setting."""
    reply = f"Req{message}Ack" if f"Req{message}Ack" in MESSAGES else message
    return f"Req{message}", _ask(reply, lambda unit: getattr(unit.settings, setting))


def _writer(
    message: str, setting: str, is_valid: Callable[[Any, Support], bool], code: ErrorCode
) -> tuple[str, Command]:
    """The message that sets a setting; the reply is empty but for a list of outputs."""

    def write(unit: Unit, value: Any) -> bytes:
        _require(is_valid(value, unit.support), code)
        unit.memory.change(**{setting: value})
        return encode(f"Set{message}Ack", value) if message == "CanOutputConfig" else b""

    return f"Set{message}", write


#: Settings without a handler of their own: message, setting, what is valid, and the error code otherwise.
_SETTINGS: tuple[tuple[str, str, Callable[[Any, Support], bool], ErrorCode], ...] = (
    ("LocationID", "location_id", lambda _, __: True, ErrorCode.PARAMETER),
    ("TransmitDelay", "transmit_delay", lambda it, _: it in TRANSMIT_DELAYS, ErrorCode.PARAMETER),
    ("ErrorMode", "error_mode", lambda it, _: it in ERROR_MODES, ErrorCode.PARAMETER),
    ("OutputSkipFactor", "output_skip_factor", lambda _, __: True, ErrorCode.PARAMETER),
    (
        "ExtOutputMode",
        "ext_output_mode",
        lambda it, _: _is_within(it, EXT_MODES),
        ErrorCode.PARAMETER,
    ),
    ("CanConfig", "can_config", lambda it, _: it.baudrate is not None, ErrorCode.BAUDRATE),
    ("CanOutputConfig", "can_output_config", _are_can_outputs, ErrorCode.PARAMETER),
    ("LatLonAlt", "lat_lon_alt", _is_place, ErrorCode.PARAMETER),
    (
        "GnssPlatform",
        "gnss_platform",
        lambda it, _: isinstance(it, GnssPlatform),
        ErrorCode.PARAMETER,
    ),
    (
        "GnssLeverArm",
        "gnss_lever_arm",
        lambda it, _: all(map(math.isfinite, it)),
        ErrorCode.PARAMETER,
    ),
    ("GnssReceiverSettings", "gnss_receiver_settings", _is_receiver, ErrorCode.PARAMETER),
)

#: Every request that some product knows, by its name in `xbus.protocol.tables.MESSAGES`.
COMMANDS: dict[str, Command] = {
    # 5.3.1
    "WakeUpAck": _go_to_config,
    "GoToConfig": _go_to_config,
    "GoToMeasurement": _go_to_measurement,
    "Reset": _reset,
    # 5.3.2
    "ReqDID": _ask("DeviceID", lambda unit: unit.identity.device_id),
    "InitBus": _ask("InitBusResults", lambda unit: [unit.identity.device_id & 0xFFFF_FFFF]),
    "ReqProductCode": _ask("ProductCode", lambda unit: unit.identity.product_code),
    "ReqHardwareVersion": _ask("HardwareVersion", lambda unit: unit.identity.hardware),
    "ReqFWRev": _ask("FirmwareRev", lambda unit: unit.identity.firmware),
    "RunSelftest": _selftest,
    # 5.3.3
    "ReqBaudrate": _ask("ReqBaudrateAck", lambda unit: unit.settings.host_baud_code),
    "SetBaudrate": _set_baudrate,
    "ReqOptionFlags": _ask("ReqOptionFlagsAck", lambda unit: unit.settings.option_flags),
    "SetOptionFlags": _set_option_flags,
    "RestoreFactoryDef": _restore_factory_settings,
    # 5.3.4
    "ReqSyncSettings": _ask("ReqSyncSettingsAck", lambda unit: unit.settings.sync_settings),
    "SetSyncSettings": _set_sync,
    # 5.3.5
    "ReqConfiguration": lambda unit, _: unit.configuration(),
    "ReqEmts": lambda unit, _: unit.emts,
    "ReqOutputConfiguration": _ask(
        "ReqOutputConfigurationAck", lambda unit: unit.settings.output_configuration
    ),
    "SetOutputConfiguration": _set_outputs,
    "ReqStringOutputType": _ask(
        "ReqStringOutputTypeAck", lambda unit: unit.settings.string_output_type
    ),
    "SetStringOutputType": _set_strings,
    "ReqPeriod": _ask("ReqPeriodAck", lambda unit: unit.settings.period),
    "SetPeriod": _set_period,
    "ReqAlignmentRotation": _rotation,
    "SetAlignmentRotation": _set_rotation,
    "ReqPortConfig": _ask("PortConfig", lambda unit: unit.settings.port_config),
    "SetPortConfig": _set_ports,
    # 5.3.6
    "ReqData": _send_latest,
    # 5.3.7
    "ReqAvailableFilterProfiles": _profiles,
    "ReqFilterProfile": _profile,
    "SetFilterProfile": _set_profile,
    "SetFilterProfileModern": _set_profile_names,
    "ResetOrientation": _reset_orientation,
    # What a filter knows is not kept here.
    "StoreFilterState": lambda _, __: b"",
    "SetNoRotation": _set_no_rotation,
    "ReqUTCTime": _ask("UTCTime", lambda unit: unit.utc_time()),
    "SetUTCTime": _set_utc_time,
    "AdjustUTCTime": _adjust_utc_time,
    "IccCommand": _icc,
    "SetInitialHeading": _set_initial_heading,
    "ForwardGnssData": _forward_gnss_data,
    **dict(_reader(message, setting) for message, setting, _, _ in _SETTINGS),
    **dict(_writer(*row) for row in _SETTINGS),
}
