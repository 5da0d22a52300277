"""The settings of a device as one value: read, written as TOML, compared and applied."""

from xbus.device.settings.apply import Applied, ApplyError, apply_plan
from xbus.device.settings.model import Change, Settings
from xbus.device.settings.plan import Plan, plan_settings, read_settings

__all__ = [
    "Applied",
    "ApplyError",
    "Change",
    "Plan",
    "Settings",
    "apply_plan",
    "plan_settings",
    "read_settings",
]
