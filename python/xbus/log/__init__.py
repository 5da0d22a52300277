"""Logs: recordings decoded into columns, whole or in parts."""

from xbus.log.batches import log_batches
from xbus.log.column import Column
from xbus.log.hostclock import HostClock
from xbus.log.log import Log, LogDevice, MissingDeviceError
from xbus.log.messages import Messages, Unknown
from xbus.log.parts import LogChangedError, LogPart, split_log
from xbus.log.read import iter_log, read_log
from xbus.log.resample import Resampled
from xbus.log.scan import scan_log
from xbus.log.stats import Stats
from xbus.log.strings import Strings
from xbus.log.trackers import Tracker

__all__ = [
    "Column",
    "HostClock",
    "Log",
    "LogChangedError",
    "LogDevice",
    "LogPart",
    "Messages",
    "MissingDeviceError",
    "Resampled",
    "Stats",
    "Strings",
    "Tracker",
    "Unknown",
    "iter_log",
    "log_batches",
    "read_log",
    "scan_log",
    "split_log",
]
