"""Xsens MTi motion trackers: logs as numpy arrays, tables and files, live devices, and virtual ones.

>>> import xbus
>>> log = xbus.read_log("tests/captures/walk.mtb")
>>> log["acceleration"].values.shape
(1000, 3)
"""

from __future__ import annotations

from importlib import import_module

TYPE_CHECKING = False  # as in `typing`, whose import takes longer than this package's
if TYPE_CHECKING:
    from typing import Any

    from xbus import (
        can,
        dask,
        describe,
        device,
        errors,
        geometry,
        log,
        mtssp,
        protocol,
        report,
        rtk,
        sim,
        wire,
    )
    from xbus._core import __version__
    from xbus.can import read_can
    from xbus.device import (
        ApplyError,
        Device,
        Sample,
        Session,
        Settings,
        connect,
        find_ports,
        restore_communication,
    )
    from xbus.errors import (
        DecodeError,
        DeviceError,
        Disconnected,
        StateError,
        XbusError,
        XbusTimeout,
    )
    from xbus.log import (
        Column,
        HostClock,
        Log,
        LogPart,
        Stats,
        iter_log,
        log_batches,
        read_log,
        scan_log,
        split_log,
    )
    from xbus.protocol.configuration import Configuration, Firmware
    from xbus.protocol.ids import Coordinates, DataId, MessageId, Precision
    from xbus.protocol.values import StringType
    from xbus.sim import Faults, SimulatedDevice
    from xbus.wire.codec import Scanner, encode_frame, encode_packet, encode_sample
    from xbus.wire.hextext import from_hex
    from xbus.wire.message import Message
    from xbus.wire.strings import String, encode_string, parse_string

#: The module of each public name. Modules are imported when a name is first used, so that ``import xbus``
#: and ``xbus --help`` do not wait for numpy.
_MODULES = {
    "_core": ("__version__",),
    "can": ("read_can",),
    "device": (
        "ApplyError",
        "Device",
        "Sample",
        "Session",
        "Settings",
        "connect",
        "find_ports",
        "restore_communication",
    ),
    "errors": (
        "DecodeError",
        "DeviceError",
        "Disconnected",
        "StateError",
        "XbusError",
        "XbusTimeout",
    ),
    "log": (
        "Column",
        "HostClock",
        "Log",
        "LogPart",
        "Stats",
        "iter_log",
        "log_batches",
        "read_log",
        "scan_log",
        "split_log",
    ),
    "protocol.configuration": ("Configuration", "Firmware"),
    "protocol.ids": ("Coordinates", "DataId", "MessageId", "Precision"),
    "protocol.values": ("StringType",),
    "sim": ("Faults", "SimulatedDevice"),
    "wire.codec": ("Scanner", "encode_frame", "encode_packet", "encode_sample"),
    "wire.hextext": ("from_hex",),
    "wire.message": ("Message",),
    "wire.strings": ("String", "encode_string", "parse_string"),
}
_PACKAGES = (
    "can",
    "dask",
    "describe",
    "device",
    "errors",
    "geometry",
    "log",
    "mtssp",
    "protocol",
    "report",
    "rtk",
    "sim",
    "wire",
)

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
    "LogPart",
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
    "can",
    "connect",
    "dask",
    "describe",
    "device",
    "encode_frame",
    "encode_packet",
    "encode_sample",
    "encode_string",
    "errors",
    "find_ports",
    "from_hex",
    "geometry",
    "iter_log",
    "log",
    "log_batches",
    "mtssp",
    "parse_string",
    "protocol",
    "read_can",
    "read_log",
    "report",
    "restore_communication",
    "rtk",
    "scan_log",
    "sim",
    "split_log",
    "wire",
]


def __getattr__(name: str) -> Any:
    if name in _PACKAGES:
        return import_module(f"xbus.{name}")
    for module, names in _MODULES.items():
        if name in names:
            value = getattr(import_module(f"xbus.{module}"), name)
            globals()[name] = value
            return value
    raise AttributeError(f"module 'xbus' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
