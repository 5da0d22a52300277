"""The requests that read and write the settings of a virtual device.

A handler gets the board and the value of the request, and returns the payload of the reply. States, products
and lengths are checked before.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import takewhile
from typing import Any, NamedTuple, TypeAlias

from xbus.protocol.messages import encode
from xbus.protocol.products import BASE, HEADING
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
    CanConfig,
    CanDataId,
    CanOutput,
    ErrorCode,
    ExtOutputMode,
    FilterProfile,
    GnssLeverArm,
    GnssPlatform,
    GnssReceiver,
    GnssReceiverSettings,
    LatLonAlt,
    OptionFlag,
    OptionFlags,
    Output,
    OutputMode,
    OutputSettings,
    Polarity,
    PortConfig,
    PortProtocol,
    StringOutput,
    SyncFunction,
    SyncSetting,
    baudrate,
)
from xbus.sim.board import Board
from xbus.sim.memory import factory_settings
from xbus.sim.sync import SyncInputs

__all__ = ["SETTING_COMMANDS", "Refused", "reply_with", "require"]

Handler: TypeAlias = Callable[[Board, Any], bytes]

#: Slots in AvailableFilterProfiles; those after the last profile are empty (Table 29).
PROFILE_SLOTS = 5
#: The value of the two coordinate bits that names no coordinate system (Table 17).
NO_COORDINATES = 0xC
#: The bits of Table 21.
EXT_OUTPUT_MODES = ExtOutputMode.ALTERNATIVE_UART | ExtOutputMode.USB_LOW_LATENCY
#: The setting of each rotation.
ROTATIONS = {Alignment.ROT_SENSOR: "rot_sensor", Alignment.ROT_LOCAL: "rot_local"}


class Refused(Exception):  # noqa: N818 - a refusal is a reply
    """The device replies with an Error message.

    Attributes:
        code: Error code (Table 5).
    """

    def __init__(self, code: ErrorCode) -> None:
        super().__init__(code)
        self.code = code


def require(is_valid: object, code: ErrorCode = ErrorCode.PARAMETER) -> None:
    """Raises Refused unless a value is valid."""
    if not is_valid:
        raise Refused(code)


def reply_with(reply: str, read: Callable[[Board], Any]) -> Handler:
    """Returns a handler whose reply has the value that ``read`` returns."""
    return lambda board, _: encode(reply, read(board))


def _is_within(flags: int, mask: int) -> bool:
    """Returns whether all bits are in the mask. An IntFlag's own `~` ignores bits without a name."""
    return not int(flags) & ~int(mask)


# Settings with special rules


def _set_baudrate(board: Board, code: int) -> bytes:
    require(baudrate(code) in board.support.baudrates, ErrorCode.BAUDRATE)
    changed = board.settings.with_baud_code(code)
    board.memory.change(baud_code=changed.baud_code, port_config=changed.port_config)
    return b""


def _set_option_flags(board: Board, flags: OptionFlags) -> bytes:
    require(_is_within(flags.set, board.support.option_flags))
    kept = int(board.settings.option_flags) & ~int(flags.clear)
    board.memory.change(option_flags=OptionFlag(kept | flags.set))
    return b""


def _set_output_configuration(board: Board, outputs: tuple[Output, ...]) -> bytes:
    effective = []
    for output in outputs:
        acknowledged = board.support.acknowledged(output)
        has_coordinates = output.data_id & NO_COORDINATES != NO_COORDINATES
        if acknowledged is not None and has_coordinates:
            effective.append(acknowledged)
        else:
            require(not board.strict_outputs)
    board.memory.change(output_configuration=tuple(effective))
    return encode("SetOutputConfigurationAck", effective)


def _set_string_output_type(board: Board, strings: StringOutput) -> bytes:
    require(_is_within(strings.types, board.support.string_types))
    if board.support.strings_have_rate:
        # The form with two bytes and no rate is accepted too: the manual uses it to disable strings, and
        # does not limit it to some products.
        strings = StringOutput(strings.types, strings.frequency or 0)
        require(not strings.types or 1 <= (strings.frequency or 0) <= board.support.base_rate)
    else:
        require(strings.frequency is None)
    board.memory.change(string_output_type=strings)
    return b""


def _set_period(board: Board, period: int) -> bytes:
    slowest = PERIODS[-1]
    if period > slowest:
        # Rates below 100 Hz skip samples.
        require(period % slowest == 0, ErrorCode.PERIOD)
        board.memory.change(period=slowest, output_skip_factor=period // slowest - 1)
    else:
        require(period in PERIODS, ErrorCode.PERIOD)
        board.memory.change(period=period)
    return b""


def _set_sync_settings(board: Board, settings: tuple[SyncSetting, ...]) -> bytes:
    enabled = tuple(takewhile(lambda setting: setting.polarity != Polarity.DISABLED, settings))
    for setting in enabled:
        function = setting.function
        require(isinstance(function, SyncFunction) and isinstance(setting.polarity, Polarity))
        require(setting.line in board.support.sync.get(SyncFunction(function), ()))
        require(
            setting.offset in (PULSE_OFFSETS if function in SYNC_OUT_FUNCTIONS else SYNC_DELAYS)
        )
    board.memory.change(sync_settings=enabled)
    board.sync_inputs = SyncInputs(enabled)
    return b""


def _read_alignment_rotation(board: Board, rotation: Alignment | int) -> bytes:
    require(isinstance(rotation, Alignment))
    setting = ROTATIONS[Alignment(rotation)]
    return encode("ReqAlignmentRotationAck", getattr(board.settings, setting))


def _set_alignment_rotation(board: Board, rotation: AlignmentRotation) -> bytes:
    require(rotation.parameter in ROTATIONS)
    require(0 < math.hypot(*rotation.quaternion) < math.inf)
    board.memory.change(**{ROTATIONS[Alignment(rotation.parameter)]: rotation})  # type: ignore[arg-type]
    # The rotations of an earlier orientation reset are obsolete.
    board.rotations = None
    return b""


def _set_port_config(board: Board, ports: tuple[PortConfig, ...]) -> bytes:
    for port, default in zip(ports, board.support.port_config, strict=True):
        is_missing = default.protocol == PortProtocol.NONE
        require(isinstance(port.protocol, PortProtocol) and not (is_missing and int(port)))
    for port in ports:
        is_used = port.protocol != PortProtocol.NONE
        require(not is_used or port.baudrate in board.support.baudrates, ErrorCode.BAUDRATE)
    board.memory.change(port_config=ports)
    return b""


def _set_output_mode(board: Board, mode: OutputMode) -> bytes:
    require(_is_within(mode, board.support.output_modes))
    board.memory.change(output_mode=mode)
    return b""


def _set_output_settings(board: Board, settings: OutputSettings) -> bytes:
    require(settings.is_explained)
    board.memory.change(output_settings=settings)
    return b""


def _set_heading(board: Board, heading: float) -> bytes:
    require(math.isfinite(heading))
    board.memory.change(heading=heading)
    return b""


def _set_ext_output_mode(board: Board, mode: ExtOutputMode) -> bytes:
    legacy = ExtOutputMode.ANALOG_EULER_ANGLES
    require(_is_within(mode, legacy if board.support.is_legacy else EXT_OUTPUT_MODES))
    board.memory.change(ext_output_mode=mode)
    return b""


def _read_available_filter_profiles(board: Board, _: None) -> bytes:
    profiles = list(board.support.filter_profiles)
    empty = [AvailableProfile(0, 0, "")] * (PROFILE_SLOTS - len(profiles))
    return encode("AvailableFilterProfiles", profiles + empty)


def _read_filter_profile(board: Board, _: None) -> bytes:
    current = board.settings.filter_profile
    if isinstance(current, str):
        return encode("ReqFilterProfileAckModern", current)
    row = next(profile for profile in board.support.filter_profiles if profile.type == current)
    return encode("ReqFilterProfileAck", FilterProfile(row.version, row.type))


def _set_filter_profile(board: Board, number: int) -> bytes:
    require(number in (profile.type for profile in board.support.filter_profiles))
    board.memory.change(filter_profile=number)
    return b""


def _set_filter_profile_names(board: Board, text: str) -> bytes:
    types = {profile.label: profile.type for profile in board.support.filter_profiles}
    names = text.split("/")
    require(all(name in types for name in names))
    chosen = [types[name] for name in names]
    require(chosen.count(BASE) <= 1 and chosen.count(HEADING) <= 1)
    board.memory.change(filter_profile=text)
    return b""


def _set_initial_heading(board: Board, heading: float) -> bytes:
    require(-180 <= heading <= 180)
    board.memory.change(initial_heading=heading)
    return b""


def _restore_factory_settings(board: Board, _: None) -> bytes:
    board.memory.overwrite(factory_settings(board.support))
    board.sync_inputs = SyncInputs(board.settings.sync_settings)
    return b""


# Settings whose only rule is a valid value


def _is_place(place: LatLonAlt) -> bool:
    return abs(place.lat) <= 90 and abs(place.lon) <= 180 and math.isfinite(place.alt)


def _is_receiver(settings: GnssReceiverSettings) -> bool:
    return isinstance(settings.receiver, GnssReceiver) and baudrate(settings.baud_code) is not None


def _are_can_outputs(outputs: tuple[CanOutput, ...]) -> bool:
    return all(isinstance(output.data_id, CanDataId) for output in outputs)


def _is_can_config(config: CanConfig) -> bool:
    return config.baudrate is not None


def _is_platform(platform: GnssPlatform | int) -> bool:
    return isinstance(platform, GnssPlatform)


def _is_lever_arm(lever_arm: GnssLeverArm) -> bool:
    return all(map(math.isfinite, lever_arm))


def _is_any(_: Any) -> bool:
    return True


class _Setting(NamedTuple):
    """A setting that ``Req`` and ``Set`` messages read and write without further effect.

    Attributes:
        message: Name of the messages, without ``Req`` and ``Set``.
        name: Name of the setting.
        is_valid: Whether the device accepts a value.
        code: Error code for a value that it refuses.
    """

    message: str
    name: str
    is_valid: Callable[[Any], bool]
    code: ErrorCode = ErrorCode.PARAMETER

    def reader(self) -> Handler:
        """Returns the handler of the ``Req`` message."""
        acknowledgement = f"Req{self.message}Ack"
        reply = acknowledgement if acknowledgement in MESSAGES else self.message
        return reply_with(reply, lambda board: getattr(board.settings, self.name))

    def writer(self) -> Handler:
        """Returns the handler of the ``Set`` message. The reply has the value if its layout has one."""
        reply = f"Set{self.message}Ack"
        has_value = MESSAGES[reply].kind != "empty"

        def write(board: Board, value: Any) -> bytes:
            require(self.is_valid(value), self.code)
            board.memory.change(**{self.name: value})
            return encode(reply, value if has_value else None)

        return write


_SETTINGS = (
    _Setting("LocationID", "location_id", _is_any),
    _Setting("TransmitDelay", "transmit_delay", TRANSMIT_DELAYS.__contains__),
    _Setting("ErrorMode", "error_mode", ERROR_MODES.__contains__),
    _Setting("OutputSkipFactor", "output_skip_factor", _is_any),
    _Setting("CanConfig", "can_config", _is_can_config, ErrorCode.BAUDRATE),
    _Setting("CanOutputConfig", "can_output_config", _are_can_outputs),
    _Setting("LatLonAlt", "lat_lon_alt", _is_place),
    _Setting("GnssPlatform", "gnss_platform", _is_platform),
    _Setting("GnssLeverArm", "gnss_lever_arm", _is_lever_arm),
    _Setting("GnssReceiverSettings", "gnss_receiver_settings", _is_receiver),
)

#: The handlers by name of the message in `xbus.protocol.tables.MESSAGES`.
SETTING_COMMANDS: dict[str, Handler] = {
    "ReqBaudrate": reply_with("ReqBaudrateAck", lambda board: board.settings.host_baud_code),
    "SetBaudrate": _set_baudrate,
    "ReqOptionFlags": reply_with("ReqOptionFlagsAck", lambda board: board.settings.option_flags),
    "SetOptionFlags": _set_option_flags,
    "RestoreFactoryDef": _restore_factory_settings,
    "ReqSyncSettings": reply_with("ReqSyncSettingsAck", lambda board: board.settings.sync_settings),
    "SetSyncSettings": _set_sync_settings,
    "ReqOutputConfiguration": reply_with(
        "ReqOutputConfigurationAck", lambda board: board.settings.output_configuration
    ),
    "SetOutputConfiguration": _set_output_configuration,
    "ReqStringOutputType": reply_with(
        "ReqStringOutputTypeAck", lambda board: board.settings.string_output_type
    ),
    "SetStringOutputType": _set_string_output_type,
    "ReqPeriod": reply_with("ReqPeriodAck", lambda board: board.settings.period),
    "SetPeriod": _set_period,
    "ReqOutputMode": reply_with("ReqOutputModeAck", lambda board: board.settings.output_mode),
    "SetOutputMode": _set_output_mode,
    "ReqOutputSettings": reply_with(
        "ReqOutputSettingsAck", lambda board: board.settings.output_settings
    ),
    "SetOutputSettings": _set_output_settings,
    "ReqHeading": reply_with("HeadingAck", lambda board: board.settings.heading),
    "SetHeading": _set_heading,
    "ReqExtOutputMode": reply_with("ExtOutputMode", lambda board: board.settings.ext_output_mode),
    "SetExtOutputMode": _set_ext_output_mode,
    "ReqAlignmentRotation": _read_alignment_rotation,
    "SetAlignmentRotation": _set_alignment_rotation,
    "ReqPortConfig": reply_with("PortConfig", lambda board: board.settings.port_config),
    "SetPortConfig": _set_port_config,
    "ReqAvailableFilterProfiles": _read_available_filter_profiles,
    "ReqFilterProfile": _read_filter_profile,
    "SetFilterProfile": _set_filter_profile,
    "SetFilterProfileModern": _set_filter_profile_names,
    "SetInitialHeading": _set_initial_heading,
    **{f"Req{setting.message}": setting.reader() for setting in _SETTINGS},
    **{f"Set{setting.message}": setting.writer() for setting in _SETTINGS},
}
