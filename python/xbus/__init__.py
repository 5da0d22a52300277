"""Xsens MTi motion trackers: logs as numpy arrays, tables and files, live devices, and virtual ones.

>>> import xbus
>>> log = xbus.read_log("tests/captures/walk.mtb")
>>> log["acceleration"].values.shape
(1000, 3)
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from xbus._core import __version__

if TYPE_CHECKING:
    from xbus.codec import Scanner, encode_frame, encode_packet, encode_sample
    from xbus.column import Column
    from xbus.configuration import Configuration, Firmware
    from xbus.device import (
        Device,
        Sample,
        Session,
        Settings,
        connect,
        find_ports,
        restore_communication,
    )
    from xbus.errors import (
        ApplyError,
        DecodeError,
        DeviceError,
        Disconnected,
        StateError,
        XbusError,
        XbusTimeout,
    )
    from xbus.hostclock import HostClock
    from xbus.ids import Coordinates, DataId, MessageId, Precision
    from xbus.log import Log, Message, Stats, iter_log, read_log
    from xbus.protocol.values import StringType
    from xbus.sim.device import SimulatedDevice
    from xbus.sim.faults import Faults
    from xbus.strings import String, encode_string, parse_string

__all__ = [
    "ApplyError",
    "Column",
    "Configuration",
    "Coordinates",
    "DataId",
    "DecodeError",
    "Device",
    "DeviceError",
    "Disconnected",
    "Faults",
    "Firmware",
    "HostClock",
    "Log",
    "Message",
    "MessageId",
    "Precision",
    "Sample",
    "Scanner",
    "Session",
    "Settings",
    "SimulatedDevice",
    "StateError",
    "Stats",
    "String",
    "StringType",
    "XbusError",
    "XbusTimeout",
    "__version__",
    "connect",
    "encode_frame",
    "encode_packet",
    "encode_sample",
    "encode_string",
    "find_ports",
    "iter_log",
    "parse_string",
    "read_log",
    "restore_communication",
]

#: What is imported when it is first asked for, so that ``xbus --help`` need not wait for numpy.
_MODULES = {
    "codec": ("Scanner", "encode_frame", "encode_packet", "encode_sample"),
    "column": ("Column",),
    "configuration": ("Configuration", "Firmware"),
    "device": (
        "Device",
        "Sample",
        "Session",
        "Settings",
        "connect",
        "find_ports",
        "restore_communication",
    ),
    "errors": (
        "ApplyError",
        "DecodeError",
        "DeviceError",
        "Disconnected",
        "StateError",
        "XbusError",
        "XbusTimeout",
    ),
    "export": (),
    "hostclock": ("HostClock",),
    "ids": ("Coordinates", "DataId", "MessageId", "Precision"),
    "log": ("Log", "Message", "Stats", "iter_log", "read_log"),
    "protocol": (),
    "protocol.values": ("StringType",),
    "sim.device": ("SimulatedDevice",),
    "sim.faults": ("Faults",),
    "source": (),
    "strings": ("String", "encode_string", "parse_string"),
    "tables": (),
}


def __getattr__(name: str) -> Any:
    for module, names in _MODULES.items():
        if name == module:
            return import_module(f"xbus.{module}")
        if name in names:
            value = getattr(import_module(f"xbus.{module}"), name)
            globals()[name] = value
            return value
    raise AttributeError(f"module 'xbus' has no attribute {name!r}")


def __dir__() -> list[str]:
    return [*globals(), *__all__, *_MODULES]
