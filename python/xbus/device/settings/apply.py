"""Settings applied to a device: one after the other, each read back."""

from __future__ import annotations

from dataclasses import dataclass

from xbus.device.configurable import Configurable
from xbus.device.settings.model import Change, Settings
from xbus.device.settings.plan import Plan, command_of, read_setting
from xbus.errors import DeviceError, XbusError

__all__ = ["Applied", "ApplyError", "apply_plan"]


class ApplyError(XbusError):
    """Settings were applied in part: the device refused one, or is gone. ``__cause__`` is that error.

    Attributes:
        reason: What happened.
        applied: The settings that were set and read back.
        failed: The setting that was being set.
        not_applied: The settings that were still to come.
        before: All settings as they were. Apply these to go back.
        is_open: Whether it is unknown if the failed setting was applied.

    >>> import xbus
    >>> device = xbus.connect("sim:MTi-630")
    >>> try:
    ...     applied = device.apply(xbus.Settings(location_id=7))
    ... except xbus.ApplyError as error:
    ...     applied = device.apply(error.before)  # go back
    >>> [change.name for change in applied.changes]
    ['location_id']
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
        applied = ", ".join(change.name for change in self.applied) or "nothing"
        rest = [change.name for change in self.not_applied]
        if self.is_open:
            text = f"{self.reason}; applied: {applied}; unknown: {self.failed.name}"
            return f"{text}; not applied: {', '.join(rest) or 'nothing else'}"
        not_applied = ", ".join([self.failed.name, *rest])
        return f"{self.reason}; applied: {applied}; not applied: {not_applied}"

    def __str__(self) -> str:
        return f"{self.summary}; apply the same settings again to go on, or apply(error.before) to go back"


@dataclass(frozen=True)
class Applied:
    """What was applied, or in a dry run would be.

    Attributes:
        changes: The settings that were set and read back; in a dry run, those that would be set.
        rounded: Settings for which the device took another value: the requested one, and the one in effect.
        skipped: With ``force``, what was left out, and why: one sentence each.
    """

    changes: tuple[Change, ...]
    rounded: tuple[Change, ...] = ()
    skipped: tuple[str, ...] = ()

    @property
    def needs_reset(self) -> bool:
        """Whether a change takes effect at the next reset only."""
        return any(change.name in ("port_config", "can_config") for change in self.changes)


def apply_plan(device: Configurable, plan: Plan) -> Applied:
    """Makes the changes of a plan on a device that is in Config State; see `Device.apply`.

    Args:
        device: The device for which the plan was made.
        plan: A plan without problems, made while the settings were as they are now.

    Raises:
        ApplyError: The device refused a setting, or is gone.
    """
    rounded: list[Change] = []
    for done, change in enumerate(plan.changes):
        progress = plan.changes[:done], change, plan.changes[done + 1 :], plan.before
        try:
            device.command(*command_of(change, device.support))
            found = read_setting(device, change.name)
        except XbusError as error:
            is_open = not isinstance(error, DeviceError)
            raise ApplyError(str(error), *progress, is_open=is_open) from error
        except BaseException as error:  # Ctrl-C
            error.add_note(str(ApplyError("interrupted", *progress, is_open=True)))
            raise
        if found == change.before:
            text = f"the device acknowledged {change.name} and did not change it"
            raise ApplyError(text, *progress, is_open=False)
        if found != change.after:
            rounded.append(Change(change.name, change.after, found))
        if change.name == "output_configuration":
            device.output_configuration = found
    return Applied(plan.changes, tuple(rounded), plan.skipped)
