"""Settings read from a device, and applied to it: only what differs, checked, in a safe order, read back."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

from xbus.device.checks import check
from xbus.device.output_configuration import check_outputs_fit
from xbus.device.settings.model import Change, Settings
from xbus.device.settings.toml import ROTATIONS, ROWS
from xbus.device.string_output import StringPlan, check_strings_fit, frequency_of
from xbus.errors import DeviceError, XbusError
from xbus.protocol import values as v
from xbus.protocol.products import Support

if TYPE_CHECKING:
    from xbus.device.device import Device

__all__ = ["Applied", "ApplyError", "Plan", "apply_settings", "compared", "plan", "read_settings"]

#: What is applied last: what changes who answers, and at which rate.
LAST = ("option_flags", "port_config")
#: What decides how much is sent, and how fast.
SENDING = (
    "output_configuration",
    "string_output_type",
    "period",
    "output_skip_factor",
    "port_config",
)

Ports = tuple[v.PortConfig, ...] | None


class ApplyError(XbusError):
    """Settings were applied in part: the device refused one, or is gone. Its cause is the error behind it.

    Attributes:
        reason: What happened.
        applied: What was set and read back.
        failed: What was under way.
        not_applied: What was still to come.
        before: All settings as they were; applying these goes back.
        is_open: Whether nobody knows if the one under way was applied.
    """

    def __init__(
        self,
        reason: str,
        applied: tuple[Change, ...],
        failed: Change,
        not_applied: tuple[Change, ...],
        before: Settings,
        is_open: bool,
    ) -> None:
        super().__init__(reason, applied, failed, not_applied, before, is_open)
        self.reason = reason
        self.applied = applied
        self.failed = failed
        self.not_applied = not_applied
        self.before = before
        self.is_open = is_open

    @property
    def summary(self) -> str:
        """What happened, what was applied and what not."""
        done = ", ".join(it.name for it in self.applied) or "nothing"
        rest = [it.name for it in self.not_applied]
        if self.is_open:
            text = f"{self.reason}; applied: {done}; not known: {self.failed.name}"
            return f"{text}; not applied: {', '.join(rest) or 'nothing else'}"
        return (
            f"{self.reason}; applied: {done}; not applied: {', '.join([self.failed.name, *rest])}"
        )

    def __str__(self) -> str:
        return f"{self.summary}; apply the same again to go on, or apply(error.before) to go back"


def read_settings(device: Device) -> Settings:
    """All settings of a device that is in Config State; see `Device.settings`."""
    known = device.support
    product = known.product.name if known else device.product_code
    found = {key: _ask(device, key) for key in ROWS if known is None or _has(known, key)}
    if found.get("port_config") is not None:
        found["baudrate"] = None  # each port has its own
    return Settings(product=product, **found)


def _has(known: Support, key: str) -> bool:
    if key == "filter_profile":
        return bool(known.filter_profiles)
    return f"Req{ROWS[key].message}" in known.messages


def _ask(device: Device, key: str) -> Any:
    """A setting; None where the firmware does not know it."""
    try:
        if key in ROTATIONS:
            return device.commands.req_alignment_rotation(ROTATIONS[key]).quaternion
        if key == "baudrate":
            return device.commands.req_baudrate()
        value = device.command(f"Req{ROWS[key].message}").value
    except DeviceError as error:
        if error.code == v.ErrorCode.MESSAGE:
            return None
        raise
    if isinstance(value, v.FilterProfile):
        return _label(value.profile, device.support)
    return value


def _label(profile: int | str, known: Support | None) -> int | str:
    """The name of a filter profile, as the product writes it."""
    if known is not None and "SetFilterProfileModern" not in known.messages:
        for it in known.filter_profiles:
            if profile == it.type or str(profile).lower() == it.label.lower():
                return it.label
    return profile


class Plan(NamedTuple):
    """What has to be done so that a device has some settings.

    Attributes:
        before: What it has.
        changes: What would be set, in this order.
        impossible: What cannot be, and why: a sentence each.
    """

    before: Settings
    changes: tuple[Change, ...]
    impossible: tuple[str, ...]


@dataclass(frozen=True)
class Applied:
    """What was applied, or would be.

    Attributes:
        changes: What was set, each read back; of a dry run, what would be.
        rounded: Where the device has made something else of it: asked for, and in effect.
    """

    changes: tuple[Change, ...]
    rounded: tuple[Change, ...] = ()

    @property
    def needs_reset(self) -> bool:
        """Whether something takes effect at the next reset only."""
        return any(it.name in ("port_config", "can_config") for it in self.changes)


def plan(device: Device, settings: Settings, *, check_baudrate: bool = True) -> Plan:
    """What `apply_settings` would do; nothing is set. The device is in Config State."""
    before = read_settings(device)
    changes, impossible = [], []
    for change in _in_order(_differences(before, settings, device.support)):
        try:
            _check(device, change, settings)
            changes.append(change)
        except ValueError as error:
            impossible.append(str(error))
    after = replace(before, **{it.name: it.after for it in changes})
    strings = after.string_output_type
    is_silent = settings.output_configuration is not None and settings.string_output_type is None
    if is_silent and strings is not None and strings.types:
        on = ", ".join(str(it.name) for it in strings.types)
        impossible.append(
            f"{_head(settings, 'output_configuration')}strings are on ({on}), and overrule it; add"
            " string_output_type = { types = [] }"
        )
    if check_baudrate and not impossible and any(it.name in SENDING for it in changes):
        try:
            _check_line(device, before, after, settings)
        except ValueError as error:
            impossible.append(str(error))
    return Plan(before, tuple(changes), tuple(impossible))


def compared(device: Device, settings: Settings) -> tuple[Change, ...]:
    """What is otherwise than on a device that is in Config State."""
    return _differences(read_settings(device), settings, device.support)


def _differences(before: Settings, settings: Settings, known: Support | None) -> tuple[Change, ...]:
    changes = before.diff(_effective(settings, known))
    return tuple(it for it in changes if not _is_in_effect(it, known))


def _is_in_effect(change: Change, known: Support | None) -> bool:
    """Whether these outputs would change nothing: of some quantities nobody can choose the rate."""
    if change.name != "output_configuration" or known is None:
        return False
    made = (
        known.acknowledged(it) if len(known.rates_of(it.quantity or "")) == 1 else it
        for it in change.after
    )
    return bool(tuple(made) == change.before)


def _effective(settings: Settings, known: Support | None) -> Settings:
    """The same in the words of the product, so that equal means equal."""
    if known is None:
        return settings
    changed: dict[str, Any] = {}
    if settings.filter_profile is not None:
        changed["filter_profile"] = _label(settings.filter_profile, known)
    if settings.output_configuration is not None:
        changed["output_configuration"] = tuple(
            known.acknowledged(it) or it if it.frequency in (0, v.EVERY) else it
            for it in settings.output_configuration
        )
    return replace(settings, **changed)


def _in_order(changes: Iterable[Change]) -> list[Change]:
    """The safe order: what changes who answers, and at which rate, comes last."""

    def place(change: Change) -> int:
        # While this flag is set nothing is stored.
        if change.name == "option_flags" and change.before and _stores_again(change):
            return -1
        return LAST.index(change.name) + 1 if change.name in LAST else 0

    return sorted(changes, key=place)


def _stores_again(change: Change) -> bool:
    flag = int(v.OptionFlag.DISABLE_AUTO_STORE)
    return bool(int(change.before) & ~int(change.after) & flag)


def _check(device: Device, change: Change, settings: Settings) -> None:
    """Whether the product can do it.

    Raises:
        ValueError: It cannot; the message says in which line.
    """
    key, value, known = change.name, change.after, device.support
    lines, head = settings.lines.get(key, ()), _head(settings, key)
    product = known.product.name if known else device.product_code or "device"
    if change.before is None:
        raise ValueError(f"{head}the {product} does not have it")
    if key == "period" and value not in v.PERIODS:
        # The device would make a skip factor of it, which is a setting of its own.
        least, most = v.PERIODS[0], v.PERIODS[-1]
        raise ValueError(
            f"{head}it must be from {least} to {most}, not {value}; output_skip_factor makes strings rarer"
        )
    if key == "baudrate":
        raise ValueError(f"{head}applying does not change it; set_baudrate({value}) does")
    try:
        name, sent = _message(change, known)
        if isinstance(sent, tuple) and not hasattr(sent, "_fields"):
            for line, it in zip(lines[1:], sent, strict=False):
                head = f"line {line}, {key}: "
                check(name, (it,), known)
            head = _head(settings, key)
        device.session.validate(name, sent)
    except ValueError as error:
        raise ValueError(f"{head}{error}") from None


def _head(settings: Settings, key: str) -> str:
    """Where a sentence about a setting points."""
    lines = settings.lines.get(key, ())
    return f"line {lines[0]}, {key}: " if lines else f"{key}: "


def _check_line(device: Device, before: Settings, after: Settings, settings: Settings) -> None:
    """Whether the line carries what the device would send, at the rate that its port would have.

    Raises:
        ValueError: It does not.
    """
    known, strings = device.support, after.string_output_type
    if known is None or not device.link.is_line:
        return
    baudrate = _baudrate(device.link.baudrate, before.port_config, after.port_config)
    key = "output_configuration"
    try:
        if strings is not None and strings.types:  # which overrule the outputs
            key = "string_output_type"
            rate: float | None = strings.frequency
            if after.period is not None and after.output_skip_factor is not None:
                rate = frequency_of(after.period, after.output_skip_factor)
            check_strings_fit(StringPlan(strings, frequency=rate), known, baudrate)
        elif after.output_configuration is not None:
            check_outputs_fit(after.output_configuration, known, baudrate)
    except ValueError as error:
        raise ValueError(f"{_head(settings, key)}{error}") from None


def _baudrate(now: int, before: Ports, after: Ports) -> int:
    """The rate of the port in use after the next reset: of those that speak Xbus at the present one."""
    pairs = zip(before or (), after or (), strict=False)
    rates = [new.baudrate for old, new in pairs if old.baudrate == now and _speak_xbus(old, new)]
    return min((it for it in rates if it), default=now)


def _speak_xbus(*ports: v.PortConfig) -> bool:
    return all(it.protocol == v.PortProtocol.XBUS for it in ports)


def _message(change: Change, known: Support | None) -> tuple[str, Any]:
    """Name and value of the message that makes the change."""
    key, value = change.name, change.after
    if key in ROTATIONS:
        value = v.AlignmentRotation(ROTATIONS[key], value)
    elif key == "option_flags":
        value = v.OptionFlags(
            v.OptionFlag(int(value) & ~int(change.before)),
            v.OptionFlag(int(change.before) & ~int(value)),
        )
    elif key == "filter_profile" and known is not None:
        if "SetFilterProfileModern" in known.messages:
            return "SetFilterProfileModern", str(value)
        numbers = {it.label: it.type for it in known.filter_profiles}
        if isinstance(value, str) and value not in numbers:
            raise ValueError(
                f"the {known.product.name} has no filter profile {value!r}; it has {', '.join(numbers)}"
            )
        value = numbers.get(value, value)
    return f"Set{ROWS[key].message}", value


def apply_settings(
    device: Device, settings: Settings, *, dry_run: bool = False, check_baudrate: bool = True
) -> Applied:
    """Sets what differs on a device that is in Config State; see `Device.apply`."""
    planned = plan(device, settings, check_baudrate=check_baudrate)
    if planned.impossible:
        raise ValueError("\n".join(planned.impossible))
    if dry_run:
        return Applied(planned.changes)
    rounded: list[Change] = []
    for done, change in enumerate(planned.changes):
        parts = planned.changes[:done], change, planned.changes[done + 1 :], planned.before
        try:
            name, value = _message(change, device.support)
            device.command(name, value)
            found = _ask(device, change.name)
        except XbusError as error:
            raise ApplyError(
                str(error), *parts, is_open=not isinstance(error, DeviceError)
            ) from error
        except BaseException as error:  # Ctrl-C
            error.add_note(str(ApplyError("interrupted", *parts, is_open=True)))
            raise
        if found == change.before:
            text = f"the device acknowledged {change.name} and kept what it had"
            raise ApplyError(text, *parts, is_open=False)
        if found != change.after:
            rounded.append(Change(change.name, change.after, found))
        if change.name == "output_configuration":
            device.output_configuration = found
    return Applied(planned.changes, tuple(rounded))
