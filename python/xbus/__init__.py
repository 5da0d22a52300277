"""Logs of Xsens MTi motion trackers as numpy arrays, tables and files: the Xbus protocol, decoded exactly.

>>> import xbus
>>> log = xbus.read_log("tests/captures/walk.mtb")
>>> log["acceleration"].values.shape
(1000, 3)
"""

from xbus._core import __version__
from xbus.codec import Scanner, encode_frame, encode_packet, encode_sample
from xbus.column import Column
from xbus.configuration import Configuration, Firmware
from xbus.errors import DecodeError, DeviceError, StateError, XbusError, XbusTimeout
from xbus.ids import Coordinates, DataId, MessageId, Precision
from xbus.log import Log, Message, Stats, iter_log, read_log

__all__ = [
    "Column",
    "Configuration",
    "Coordinates",
    "DataId",
    "DecodeError",
    "DeviceError",
    "Firmware",
    "Log",
    "Message",
    "MessageId",
    "Precision",
    "Scanner",
    "StateError",
    "Stats",
    "XbusError",
    "XbusTimeout",
    "__version__",
    "encode_frame",
    "encode_packet",
    "encode_sample",
    "iter_log",
    "read_log",
]
