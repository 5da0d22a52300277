"""What can be known to be wrong with a setting before it is sent: a table of commands and what to look at."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from datetime import date
from enum import IntEnum
from typing import Any

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
    LatLonAlt,
    OptionFlag,
    OptionFlags,
    Output,
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
    """Whether the value of a command makes sense, and whether the product can do it, once that is known.

    Raises:
        ValueError: It does not; the message says what would.
    """
    if name in GENERAL:
        GENERAL[name](value)
    if support is not None and name in OF_PRODUCT:
        OF_PRODUCT[name](value, support)


# Of any product


def _between(what: str, least: float, most: float, unit: str = "") -> Callable[[float], None]:
    def check_number(value: float) -> None:
        if not least <= value <= most:
            raise ValueError(f"{what} must be from {least} to {most}{unit}, not {value}")

    return check_number


def _within(what: str, numbers: range, unit: str = "") -> Callable[[float], None]:
    return _between(what, numbers[0], numbers[-1], unit)


def _place(it: LatLonAlt) -> None:
    if not math.isfinite(it.alt):
        raise ValueError(f"alt must be a number of metres, not {it.alt}")
    _between("lat", -90, 90, " degrees")(it.lat)
    _between("lon", -180, 180, " degrees")(it.lon)


def _time(it: UtcTime) -> None:
    _between("ns", 0, 999_999_999)(it.ns)
    _between("year", 1999, 2099)(it.year)
    _between("month", 1, 12)(it.month)
    _between("day", 1, 31)(it.day)
    _between("hour", 0, 23)(it.hour)
    _between("minute", 0, 59)(it.minute)
    _between("second", 0, 59)(it.second)
    try:
        date(it.year, it.month, it.day)
    except ValueError:
        raise ValueError(f"there is no {it.year}-{it.month:02}-{it.day:02}") from None


def _code(kind: type[IntEnum]) -> Callable[[int], None]:
    def check_number(number: int) -> None:
        if number not in list(kind):
            members = ", ".join(f"{it.name} {it:d}" for it in kind)
            raise ValueError(f"{number} is none of {members}")

    return check_number


def _can_rate(it: CanConfig) -> None:
    if it.baudrate is None:
        rates = ", ".join(f"{code} ({rate:,})" for code, rate in CAN_BAUD_CODES.items())
        raise ValueError(f"no CAN baud rate has the code {it.baud_code}; there are {rates}")


def _unit(it: AlignmentRotation) -> None:
    _code(Alignment)(-1 if it.parameter is None else it.parameter)
    norm = sum(q * q for q in it.quaternion) ** 0.5
    if not 0.99 <= norm <= 1.01:
        raise ValueError(
            f"a rotation is a quaternion of length 1, and {it.quaternion} has length {norm:.3f}"
        )


def _offsets(settings: Iterable[SyncSetting]) -> None:
    for it in settings:
        out = it.function in SYNC_OUT_FUNCTIONS
        _within("the offset", PULSE_OFFSETS if out else SYNC_DELAYS, " x 0.1 ms")(it.offset)


def _period(period: int) -> None:
    slowest = PERIODS[-1]
    if period > slowest and period % slowest:
        raise ValueError(f"a period above {slowest} must be a multiple of it, not {period}")
    if period < PERIODS[0]:
        raise ValueError(f"the period must be at least {PERIODS[0]}, not {period}")


#: Limits that the manual gives for the message itself.
GENERAL: dict[str, Callable[[Any], None]] = {
    "SetNoRotation": _between("the duration", 1, 65_535, " s"),
    "ResetOrientation": _code(ResetCode),
    "ReqAlignmentRotation": _code(Alignment),
    "SetCanConfig": _can_rate,
    "SetPeriod": _period,
    "SetSyncSettings": _offsets,
    "SetTransmitDelay": _within("the delay", TRANSMIT_DELAYS, " ticks"),
    "SetErrorMode": _within("the error mode", ERROR_MODES),
    "SetInitialHeading": _between("the heading", -180, 180, " degrees"),
    "SetLatLonAlt": _place,
    "SetUTCTime": _time,
    "SetAlignmentRotation": _unit,
}

# Of one product


def _names(values: Iterable[Any]) -> str:
    return ", ".join(getattr(it, "name", None) or str(it) for it in values) or "none"


def _check_outputs(outputs: Iterable[Output], support: Support) -> None:
    product = support.product.name
    for it in outputs:
        name = it.quantity or f"0x{it.data_id:04X}"
        rates = support.rates_of(name)
        if not rates:
            raise ValueError(f"the {product} has no output {name}; it has {_names(support.rates)}")
        if it.coordinates is not None and it.coordinates not in list(Coordinates):
            raise ValueError(f"0x{it.data_id:04X}: the coordinate bits of {name} mean nothing")
        if it.frequency in (0, EVERY, *rates) or rates == (EVERY,):
            continue
        lower = max((rate for rate in rates if rate < it.frequency), default=rates[-1])
        higher = min((rate for rate in rates if rate > it.frequency), default=rates[0])
        near = f"{lower} Hz" if lower == higher else f"{lower} and {higher} Hz"
        raise ValueError(
            f"the {product} cannot do {name} at {it.frequency} Hz; the nearest is {near}"
        )


def _beyond(flags: int, allowed: int) -> int:
    """The bits that are set and not allowed; `~` of a flag would forget those without a name."""
    return int(flags) & ~int(allowed)


def _check_flags(flags: OptionFlags, support: Support) -> None:
    if unknown := _beyond(flags.set, support.option_flags):
        product, flags_there = support.product.name, _names(support.option_flags)
        flag = OptionFlag(unknown).name
        raise ValueError(f"the {product} has no option flag {flag}; it has {flags_there}")


def _check_sync(settings: Iterable[SyncSetting], support: Support) -> None:
    product = support.product.name
    for it in settings:
        if it.polarity == Polarity.DISABLED:
            continue
        lines = next((on for key, on in support.sync.items() if key == it.function), None)
        function = _names([known(SyncFunction, it.function)])
        if lines is None:
            raise ValueError(
                f"the {product} has no sync function {function}; it has {_names(support.sync)}"
            )
        if it.line not in lines:
            line = _names([known(SyncLine, it.line)])
            raise ValueError(f"the {product} has {function} on {_names(lines)}, not on {line}")


def _check_strings(strings: StringOutput, support: Support) -> None:
    product = support.product
    if unknown := _beyond(strings.types, support.string_types):
        string, strings_there = StringType(unknown).name, _names(support.string_types)
        raise ValueError(f"the {product.name} has no string {string}; it has {strings_there}")
    has_rate = product.series == "600-series"
    if has_rate != (strings.frequency is not None):
        how = (
            "takes the rate with the types"
            if has_rate
            else "takes the rate by SetPeriod and SetOutputSkipFactor"
        )
        raise ValueError(f"the {product.name} {how}")
    most = support.rates["acceleration"]
    if has_rate and strings.types and not 1 <= (strings.frequency or 0) <= most:
        raise ValueError(
            f"the {product.name} sends strings at 1 to {most} Hz, not at {strings.frequency} Hz"
        )


def _check_profile(number: int, support: Support) -> None:
    if number not in (it.type for it in support.filter_profiles):
        profiles = ", ".join(f"{it.type} {it.label}" for it in support.filter_profiles)
        raise ValueError(
            f"the {support.product.name} has no filter profile {number}; it has {profiles}"
        )


def _check_profile_names(text: str, support: Support) -> None:
    product = support.product.name
    kinds = {it.label: it.type for it in support.filter_profiles}
    names = text.split("/")
    for name in names:
        if name not in kinds:
            raise ValueError(
                f"the {product} has no filter profile {name!r}; it has {', '.join(kinds)}"
            )
    chosen = [kinds[it] for it in names]
    if len(set(chosen)) < len(chosen):
        raise ValueError(
            f"{text!r} names two profiles of one kind; one and a heading behaviour go together"
        )


def _check_ports(ports: Iterable[PortConfig], support: Support) -> None:
    for it in ports:
        if it.protocol != PortProtocol.NONE:
            _code(PortProtocol)(it.protocol)
            _check_baudrate(it.baud_code, support)


def _check_baudrate(code: int, support: Support) -> None:
    rate = baudrate(code)
    if rate not in support.baudrates:
        rates = ", ".join(f"{it:,}" for it in support.baudrates)
        raise ValueError(
            f"the {support.product.name} cannot talk at {rate or f'code {code}'} baud; it can at {rates}"
        )


OF_PRODUCT: dict[str, Callable[[Any, Support], None]] = {
    "SetOutputConfiguration": _check_outputs,
    "SetOptionFlags": _check_flags,
    "SetSyncSettings": _check_sync,
    "SetStringOutputType": _check_strings,
    "SetFilterProfile": _check_profile,
    "SetFilterProfileModern": _check_profile_names,
    "SetBaudrate": _check_baudrate,
    "SetPortConfig": _check_ports,
}
