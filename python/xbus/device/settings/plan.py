"""What has to change so that a device has some settings: compared, put in a safe order, and checked."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable
from dataclasses import replace
from typing import Any, NamedTuple

from xbus.device.can_output import check_bus_load
from xbus.device.checks import check
from xbus.device.configurable import Configurable
from xbus.device.filter_profile import filter_profile_command, filter_profile_label
from xbus.device.mtdata_output import MtDataPlan, check_mtdata_fits
from xbus.device.output_configuration import check_outputs_fit
from xbus.device.settings.model import Change, Settings
from xbus.device.settings.table import ROTATIONS, SETTINGS
from xbus.device.settings.toml import format_value, shortened
from xbus.device.string_output import StringPlan, check_strings_fit, frequency_of
from xbus.errors import DeviceError
from xbus.protocol import values as v
from xbus.protocol.products import Support, find_product
from xbus.wire.link import line_rate

__all__ = ["Plan", "command_of", "plan_settings", "read_setting", "read_settings"]

#: Applied last, because they change which port answers, and at which rate.
LAST = ("option_flags", "port_config")
#: Settings that determine how much the device sends, and how fast.
AFFECTS_LINE = (
    "output_configuration",
    "output_mode",
    "output_settings",
    "string_output_type",
    "period",
    "output_skip_factor",
    "port_config",
)


class Plan(NamedTuple):
    """What has to be done so that a device has some settings.

    Attributes:
        before: All settings of the device.
        changes: The settings that differ, in the order in which they are applied.
        problems: What cannot be applied, and why: one sentence each.
        skipped: What is left out, and why, where what fits is applied.
        is_other_product: Whether the settings are those of another product.
    """

    before: Settings
    changes: tuple[Change, ...]
    problems: tuple[str, ...]
    skipped: tuple[str, ...]
    is_other_product: bool


# Reading


def read_settings(device: Configurable) -> Settings:
    """Returns all settings of a device that is in Config State; see `Device.settings`."""
    support = device.support
    product = support.product.name if support else device.product_code
    values = {
        name: read_setting(device, name)
        for name in SETTINGS
        if support is None or _is_readable(device, support, name)
    }
    if values.get("port_config") is not None:
        values["baudrate"] = None  # port_config has the rate of each port
    return Settings(product=product, **values)


def _is_readable(device: Configurable, support: Support, name: str) -> bool:
    if name == "filter_profile":
        return bool(support.filter_profiles)
    request = f"Req{SETTINGS[name].message}"
    # The output configuration, which is read first, shows whether the device is in legacy mode.
    in_legacy_mode = device.session.is_in_legacy_mode and request in support.legacy_messages
    return request in support.messages or in_legacy_mode


def read_setting(device: Configurable, name: str) -> Any:
    """Returns a setting of a device; None if its firmware does not know the request."""
    try:
        if name in ROTATIONS:
            return device.commands.req_alignment_rotation(ROTATIONS[name]).quaternion
        if name == "baudrate":
            return device.commands.req_baudrate()
        value = device.command(f"Req{SETTINGS[name].message}").value
    except DeviceError as error:
        if error.code == v.ErrorCode.MESSAGE:
            return None
        raise
    if isinstance(value, v.FilterProfile):
        return filter_profile_label(value.profile, device.support)
    return value


# Planning


def plan_settings(
    device: Configurable,
    settings: Settings,
    *,
    before: Settings | None = None,
    check_baudrate: bool = True,
    force: bool = False,
) -> Plan:
    """Returns what has to change on a device. Nothing is changed.

    Args:
        device: The device.
        settings: The settings that it should have.
        before: The settings that it has; None to read them, which needs Config State.
        check_baudrate: Whether the line must carry what the device would send.
        force: Whether to accept settings of another product, and to leave out those that the device cannot
            have.
    """
    if before is None:
        before = read_settings(device)
    other_product = list(_check_product(before, settings))
    problems: list[str] = [] if force else list(other_product)
    skipped: list[str] = []
    changes = []
    for change in _in_order(_differences(before, settings, device.support)):
        try:
            _check(device, change, settings)
            changes.append(change)
        except ValueError as error:
            if force:
                skipped.append(str(error))
            else:
                problems.append(str(error))
                changes.append(change)
    after = replace(before, **{change.name: change.after for change in changes})
    problems.extend(_check_strings_off(before, settings))
    problems.extend(_check_can_bus(changes, after, settings))
    if check_baudrate and not problems and any(change.name in AFFECTS_LINE for change in changes):
        try:
            _check_line(device, before, after, settings)
        except ValueError as error:
            problems.append(str(error))
    return Plan(before, tuple(changes), tuple(problems), tuple(skipped), bool(other_product))


def _differences(
    before: Settings, settings: Settings, support: Support | None
) -> tuple[Change, ...]:
    changes = before.diff(_as_acknowledged(settings, support))
    return tuple(change for change in changes if not _is_in_effect(change, support))


def _as_acknowledged(settings: Settings, support: Support | None) -> Settings:
    """Returns the settings in the form in which the product acknowledges them, so that equal means equal."""
    if support is None:
        return settings
    changed: dict[str, Any] = {}
    if settings.filter_profile is not None:
        changed["filter_profile"] = filter_profile_label(settings.filter_profile, support)
    if settings.output_configuration is not None:
        changed["output_configuration"] = tuple(
            support.acknowledged(output) or output if output.frequency in (0, v.EVERY) else output
            for output in settings.output_configuration
        )
    return replace(settings, **changed)


def _is_in_effect(change: Change, support: Support | None) -> bool:
    """Returns whether a change of outputs has no effect because the product has one rate for the quantity."""
    if change.name != "output_configuration" or support is None:
        return False
    acknowledged = (
        support.acknowledged(output)
        if len(support.rates_of(output.quantity or "")) == 1
        else output
        for output in change.after
    )
    return bool(tuple(acknowledged) == change.before)


def _in_order(changes: Iterable[Change]) -> list[Change]:
    """Returns changes in a safe order: those in `LAST` come last."""

    def position(change: Change) -> int:
        # Nothing is stored while this flag is set, so it is cleared first.
        if change.name == "option_flags" and change.before and _enables_storing(change):
            return -1
        return LAST.index(change.name) + 1 if change.name in LAST else 0

    return sorted(changes, key=position)


def _enables_storing(change: Change) -> bool:
    return bool(int(change.before) & ~int(change.after) & int(v.OptionFlag.DISABLE_AUTO_STORE))


def command_of(change: Change, support: Support | None) -> tuple[str, Any]:
    """Returns the name and the value of the command that makes a change.

    Raises:
        ValueError: The product has no filter profile of this name.
    """
    name, value = change.name, change.after
    if name == "filter_profile":
        return filter_profile_command(value, support)
    if name in ROTATIONS:
        value = v.AlignmentRotation(ROTATIONS[name], value)
    elif name == "option_flags":
        before, after = int(change.before), int(value)
        value = v.OptionFlags(v.OptionFlag(after & ~before), v.OptionFlag(before & ~after))
    return f"Set{SETTINGS[name].message}", value


# Checking


def _check_product(before: Settings, settings: Settings) -> Iterable[str]:
    """Yields a problem if the settings are those of another product."""
    if settings.product is None:
        return
    name = settings.product
    with contextlib.suppress(ValueError):
        name = find_product(name).name
    if name != before.product:
        given, place = shortened(format_value(settings.product)), _place(settings, "product")
        device = before.product or "unknown"
        yield f"{place}the settings are for {given}, and the product of the device is {device}"


def _check(device: Configurable, change: Change, settings: Settings) -> None:
    """Checks that the product can have a setting.

    Raises:
        ValueError: It cannot; the message begins with the line of the setting.
    """
    name, value, support = change.name, change.after, device.support
    place = _place(settings, name)
    if change.before is None:
        product = support.product.name if support else device.product_code or "device"
        raise ValueError(f"{place}the {product} does not have this setting")
    if name == "period" and value not in v.PERIODS:
        # The device would convert a longer period to a skip factor, which is another setting.
        shortest, longest = v.PERIODS[0], v.PERIODS[-1]
        raise ValueError(
            f"{place}the period must be from {shortest} to {longest}, not {value}; set output_skip_factor for"
            " lower rates"
        )
    if name == "baudrate":
        raise ValueError(f"{place}the baud rate is not changed with the settings; remove this key")
    try:
        command, sent = command_of(change, support)
        if isinstance(sent, tuple) and not hasattr(sent, "_fields"):
            for line, entry in zip(settings.lines.get(name, ())[1:], sent, strict=False):
                place = f"line {line}, {name}: "
                check(command, (entry,), support)
            place = _place(settings, name)
        device.session.validate(command, sent)
    except ValueError as error:
        raise ValueError(f"{place}{error}") from None


def _place(settings: Settings, name: str) -> str:
    """Returns the beginning of a message about a setting: its line, if it is from a file, and its name."""
    lines = settings.lines.get(name, ())
    return f"line {lines[0]}, {name}: " if lines else f"{name}: "


def _check_strings_off(before: Settings, settings: Settings) -> Iterable[str]:
    """Yields a problem if the device would send strings in place of the outputs that are set."""
    strings = before.string_output_type
    is_output_set = settings.output_configuration is not None
    if is_output_set and settings.string_output_type is None and strings and strings.types:
        names = ", ".join(str(kind.name) for kind in strings.types)
        yield (
            f"{_place(settings, 'output_configuration')}strings are on ({names}) and replace the outputs; add"
            " string_output_type = { types = [] }"
        )


def _check_can_bus(changes: Iterable[Change], after: Settings, settings: Settings) -> Iterable[str]:
    """Yields a problem if the CAN bus does not carry the outputs that the device would send on it."""
    names = [
        change.name for change in changes if change.name in ("can_config", "can_output_config")
    ]
    config, outputs = after.can_config, after.can_output_config or ()
    if not names or config is None or not config.enabled or config.baudrate is None:
        return
    known = [output for output in outputs if isinstance(output.data_id, v.CanDataId)]
    try:
        check_bus_load(known, config.baud_code)
    except ValueError as error:
        yield f"{_place(settings, names[-1])}{error}"


def _check_line(
    device: Configurable, before: Settings, after: Settings, settings: Settings
) -> None:
    """Checks that the line carries what the device would send, at the rate that its port will have.

    Raises:
        ValueError: It does not.
    """
    support, strings = device.support, after.string_output_type
    now = line_rate(device.link)
    if support is None or now is None:
        return
    baudrate = _baudrate_after_reset(now, before, after)
    name = "output_configuration"
    try:
        if strings is not None and strings.types:  # strings replace the outputs
            name = "string_output_type"
            rate: float | None = strings.frequency
            if after.period is not None and after.output_skip_factor is not None:
                rate = frequency_of(after.period, after.output_skip_factor)
            check_strings_fit(StringPlan(strings, frequency=rate), support, baudrate)
        elif after.output_mode and after.output_settings is not None:
            name = "output_mode"
            period, skip_factor = after.period or v.PERIODS[0], after.output_skip_factor or 0
            plan = MtDataPlan(after.output_mode, after.output_settings, period, skip_factor)
            check_mtdata_fits(plan, support, baudrate)
        elif after.output_configuration is not None:
            check_outputs_fit(after.output_configuration, support, baudrate)
    except ValueError as error:
        raise ValueError(f"{_place(settings, name)}{error}") from None


def _baudrate_after_reset(baudrate: int, before: Settings, after: Settings) -> int:
    """Returns the lowest rate that a port which now speaks Xbus at `baudrate` has after the next reset."""
    ports = zip(before.port_config or (), after.port_config or (), strict=False)
    rates = [
        new.baudrate
        for old, new in ports
        if old.protocol == new.protocol == v.PortProtocol.XBUS and old.baudrate == baudrate
    ]
    return min((rate for rate in rates if rate), default=baudrate)
