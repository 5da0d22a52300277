"""CAN of the 600-series: captures, the DBC file, and frames one at a time."""

from xbus.can.ids import EXTENDED
from xbus.can.read import CanLog, iter_can, read_can
from xbus.can.traffic import Traffic
from xbus.protocol.can import CAN_MESSAGES, CanMessage, CanSignal, can_message

__all__ = [
    "CAN_MESSAGES",
    "EXTENDED",
    "CanLog",
    "CanMessage",
    "CanSignal",
    "Traffic",
    "can_message",
    "iter_can",
    "read_can",
]
