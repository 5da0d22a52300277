"""The settings of a device as one value: read, written as TOML, compared and applied."""

from xbus.device.settings.apply import Applied, ApplyError
from xbus.device.settings.model import Change, Settings

__all__ = ["Applied", "ApplyError", "Change", "Settings"]
