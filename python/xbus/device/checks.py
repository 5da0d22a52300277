"""Checks of the value of a command before it is sent: a table of checks by command."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from datetime import date
from enum import IntEnum
from typing import Any

from xbus.device.can_output import check_can_outputs, check_can_products
from xbus.protocol.ids import Coordinates
from xbus.protocol.products import Support
from xbus.protocol.values import (
    CAN_BAUD_CODES,
    ERROR_MODES,
    EVERY,
    PERIODS,
    PULSE_OFFSETS,
    SYNC_DELAYS,
    SYNC_OUT_FUNCTIONS,
    TRANSMIT_DELAYS,
    Alignment,
    AlignmentRotation,
    CanConfig,
    ExtOutputMode,
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
    StringOutput,
    StringType,
    SyncFunction,
    SyncLine,
    SyncSetting,
    UtcTime,
    baudrate,
    known,
)

__all__ = ["check"]


def check(name: str, value: Any, support: Support | None) -> None:
    """Checks that the value of a command is valid, for the product if it is known.

    Raises:
        ValueError: The value is not valid; the message says what is.
    """
    if name in GENERAL_CHECKS:
        GENERAL_CHECKS[name](value)
    if support is not None and name in PRODUCT_CHECKS:
        PRODUCT_CHECKS[name](value, support)


# For any product


def _between(name: str, least: float, most: float, unit: str = "") -> Callable[[float], None]:
    def check_number(value: float) -> None:
        if not least <= value <= most:
            raise ValueError(f"{name} must be from {least} to {most}{unit}, not {value}")

    return check_number


def _within(name: str, numbers: range, unit: str = "") -> Callable[[float], None]:
    return _between(name, numbers[0], numbers[-1], unit)


def _check_position(position: LatLonAlt) -> None:
    _between("lat", -90, 90, " degrees")(position.lat)
    _between("lon", -180, 180, " degrees")(position.lon)


def _check_utc(time: UtcTime) -> None:
    _between("ns", 0, 999_999_999)(time.ns)
    _between("year", 1999, 2099)(time.year)
    _between("month", 1, 12)(time.month)
    _between("day", 1, 31)(time.day)
    _between("hour", 0, 23)(time.hour)
    _between("minute", 0, 59)(time.minute)
    _between("second", 0, 59)(time.second)
    try:
        date(time.year, time.month, time.day)
    except ValueError:
        day = f"{time.year}-{time.month:02}-{time.day:02}"
        raise ValueError(f"there is no {day}") from None


def _member_of(kind: type[IntEnum]) -> Callable[[int], None]:
    def check_number(number: int) -> None:
        if number not in list(kind):
            members = ", ".join(f"{member.name} {member:d}" for member in kind)
            raise ValueError(f"{number} is not one of {members}")

    return check_number


def _check_can_config(config: CanConfig) -> None:
    if config.baudrate is None:
        codes = ", ".join(f"{code} ({rate:,})" for code, rate in CAN_BAUD_CODES.items())
        raise ValueError(f"no CAN baud rate has the code {config.baud_code}; the codes are {codes}")


def _check_rotation(rotation: AlignmentRotation) -> None:
    _member_of(Alignment)(-1 if rotation.parameter is None else rotation.parameter)
    norm = sum(q * q for q in rotation.quaternion) ** 0.5
    if not 0.99 <= norm <= 1.01:
        raise ValueError(
            f"a rotation is a quaternion of length 1, and {rotation.quaternion} has length {norm:.3f}"
        )


def _check_offsets(settings: Iterable[SyncSetting]) -> None:
    for setting in settings:
        offsets = PULSE_OFFSETS if setting.function in SYNC_OUT_FUNCTIONS else SYNC_DELAYS
        _within("the offset", offsets, " x 0.1 ms")(setting.offset)


def _check_period(period: int) -> None:
    slowest = PERIODS[-1]
    if period > slowest and period % slowest:
        raise ValueError(f"a period above {slowest} must be a multiple of it, not {period}")
    if period < PERIODS[0]:
        raise ValueError(f"the period must be at least {PERIODS[0]}, not {period}")


#: Limits that the manual gives for the message itself.
GENERAL_CHECKS: dict[str, Callable[[Any], None]] = {
    "SetNoRotation": _between("the duration", 1, 65_535, " s"),
    "ResetOrientation": _member_of(ResetCode),
    "ReqAlignmentRotation": _member_of(Alignment),
    "SetCanConfig": _check_can_config,
    "SetCanOutputConfig": check_can_outputs,
    "SetPeriod": _check_period,
    "SetSyncSettings": _check_offsets,
    "SetTransmitDelay": _within("the delay", TRANSMIT_DELAYS, " ticks"),
    "SetErrorMode": _within("the error mode", ERROR_MODES),
    "SetInitialHeading": _between("the heading", -180, 180, " degrees"),
    "SetLatLonAlt": _check_position,
    "SetUTCTime": _check_utc,
    "SetAlignmentRotation": _check_rotation,
}

# For one product


def _names(values: Iterable[Any]) -> str:
    return ", ".join(getattr(value, "name", None) or str(value) for value in values) or "none"


def _check_outputs(outputs: Iterable[Output], support: Support) -> None:
    product = support.product.name
    for output in outputs:
        name = output.quantity or f"0x{output.data_id:04X}"
        rates = support.rates_of(name)
        if not rates:
            raise ValueError(f"the {product} has no output {name}; it has {_names(support.rates)}")
        if output.coordinates is not None and output.coordinates not in list(Coordinates):
            raise ValueError(
                f"0x{output.data_id:04X}: the coordinate bits of {name} have no meaning; use ENU, NED or NWU"
            )
        frequency = output.frequency
        if frequency in (0, EVERY, *rates) or rates == (EVERY,):
            continue
        lower = max((rate for rate in rates if rate < frequency), default=rates[-1])
        higher = min((rate for rate in rates if rate > frequency), default=rates[0])
        near = f"rate is {lower} Hz" if lower == higher else f"rates are {lower} and {higher} Hz"
        raise ValueError(f"the {product} cannot send {name} at {frequency} Hz; the nearest {near}")


def _beyond(flags: int, allowed: int) -> int:
    """Returns the bits that are set and not allowed; `~` of a flag would drop those without a name."""
    return int(flags) & ~int(allowed)


def _check_flags(flags: OptionFlags, support: Support) -> None:
    if unknown := _beyond(flags.set, support.option_flags):
        product, known_flags = support.product.name, _names(support.option_flags)
        flag = OptionFlag(unknown).name
        raise ValueError(f"the {product} has no option flag {flag}; it has {known_flags}")


def _check_sync(settings: Iterable[SyncSetting], support: Support) -> None:
    product = support.product.name
    for setting in settings:
        if setting.polarity == Polarity.DISABLED:
            continue
        lines_of = {int(function): lines for function, lines in support.sync.items()}
        lines = lines_of.get(int(setting.function))
        function = _names([known(SyncFunction, setting.function)])
        if lines is None:
            raise ValueError(
                f"the {product} has no sync function {function}; it has {_names(support.sync)}"
            )
        if setting.line not in lines:
            line = _names([known(SyncLine, setting.line)])
            raise ValueError(f"the {product} has {function} on {_names(lines)}, not on {line}")


def _check_strings(strings: StringOutput, support: Support) -> None:
    product = support.product
    if unknown := _beyond(strings.types, support.string_types):
        string, known_strings = StringType(unknown).name, _names(support.string_types)
        raise ValueError(f"the {product.name} has no string {string}; it has {known_strings}")
    has_rate = support.strings_have_rate
    if has_rate != (strings.frequency is not None):
        how = (
            "takes the rate with the types"
            if has_rate
            else "takes the rate by SetPeriod and SetOutputSkipFactor"
        )
        raise ValueError(f"the {product.name} {how}")
    most = support.base_rate
    if has_rate and strings.types and not 1 <= (strings.frequency or 0) <= most:
        raise ValueError(
            f"the {product.name} sends strings at 1 to {most} Hz, not at {strings.frequency} Hz"
        )


def _check_profile(number: int, support: Support) -> None:
    profiles = {profile.type: profile.label for profile in support.filter_profiles}
    if number not in profiles:
        choices = ", ".join(f"{kind} {label}" for kind, label in profiles.items())
        product = support.product.name
        raise ValueError(f"the {product} has no filter profile {number}; it has {choices}")


def _check_profile_names(text: str, support: Support) -> None:
    product = support.product.name
    kinds = {profile.label: profile.type for profile in support.filter_profiles}
    names = text.split("/")
    for name in names:
        if name not in kinds:
            raise ValueError(
                f"the {product} has no filter profile {name!r}; it has {', '.join(kinds)}"
            )
    chosen = [kinds[name] for name in names]
    if len(set(chosen)) < len(chosen):
        raise ValueError(
            f"{text!r} names two profiles of one kind; combine one profile with one heading behaviour"
        )


def _check_ports(ports: Iterable[PortConfig], support: Support) -> None:
    defaults = support.port_config
    for number, (port, default) in enumerate(zip(ports, defaults, strict=False), 1):
        if port.protocol == PortProtocol.NONE:
            continue
        if default.protocol == PortProtocol.NONE:
            raise ValueError(
                f"the {support.product.name} has no port {number}; its protocol must be none"
            )
        _member_of(PortProtocol)(port.protocol)
        _check_baudrate(port.baud_code, support)


def _check_baudrate(code: int, support: Support) -> None:
    rate = baudrate(code)
    if rate not in support.baudrates:
        rates = ", ".join(f"{known_rate:,}" for known_rate in support.baudrates)
        raise ValueError(
            f"the {support.product.name} does not support {rate or f'code {code}'} baud; it supports {rates}"
        )


def _check_output_mode(mode: int, support: Support) -> None:
    if unknown := _beyond(mode, support.output_modes):
        product, modes = support.product.name, _names(support.output_modes)
        raise ValueError(
            f"the {product} has no output mode {OutputMode(unknown).name or hex(unknown)}; it has {modes}"
        )


def _check_output_settings(settings: OutputSettings | int, _: Support) -> None:
    if isinstance(settings, int):
        settings = OutputSettings.from_word(settings)
    if not settings.is_explained:
        raise ValueError(f"no source explains all of these output settings: {settings}")


def _check_reset(code: int, support: Support) -> None:
    resets = support.orientation_resets
    if code not in resets:
        choices = ", ".join(f"{reset.name} {reset:d}" for reset in resets)
        raise ValueError(
            f"{int(code)} is not one of {choices}, which the {support.product.name} has"
        )


def _check_ext_output_mode(mode: int, support: Support) -> None:
    analog = ExtOutputMode.ANALOG_EULER_ANGLES
    if bool(int(mode) & analog) and not support.is_legacy:
        raise ValueError(
            f"the {support.product.name} has no {analog.name}; only legacy products have it"
        )


#: What the product can do.
PRODUCT_CHECKS: dict[str, Callable[[Any, Support], None]] = {
    "SetCanOutputConfig": lambda outputs, support: check_can_products(outputs, support.product),
    "SetOutputConfiguration": _check_outputs,
    "SetOptionFlags": _check_flags,
    "SetSyncSettings": _check_sync,
    "SetStringOutputType": _check_strings,
    "SetFilterProfile": _check_profile,
    "SetFilterProfileModern": _check_profile_names,
    "SetBaudrate": _check_baudrate,
    "SetPortConfig": _check_ports,
    "SetOutputMode": _check_output_mode,
    "SetOutputSettings": _check_output_settings,
    "ResetOrientation": _check_reset,
    "SetExtOutputMode": _check_ext_output_mode,
}
