"""The CAN bus of a virtual device: a bus of python-can."""

from __future__ import annotations

import weakref
from collections.abc import Sequence

from xbus.can.address import SCHEME, open_bus, parse_address
from xbus.extras import require
from xbus.sim.can_stream import CanFrame

__all__ = ["CanBus"]


class CanBus:
    """Sends frames on a bus of python-can.

    Args:
        address: The bus: ``virtual:NAME`` in this process, ``udp_multicast:239.74.163.2`` for all processes
            of a network, ``socketcan:vcan0``.

    Raises:
        ImportError: The extra ``can`` is not installed.
        OSError: The bus cannot be opened.
        ValueError: There is no such interface.
    """

    def __init__(self, address: str) -> None:
        self._can = require("can", "can", "to send on a CAN bus")
        self._bus = open_bus(parse_address(SCHEME + address.removeprefix(SCHEME)))
        weakref.finalize(self, self._bus.shutdown)

    def __call__(self, frames: Sequence[CanFrame]) -> None:
        """Sends frames. Those that the bus of the computer has no room for are lost, as on a real bus."""
        for frame in frames:
            message = self._can.Message(
                arbitration_id=frame.can_id, is_extended_id=frame.extended, data=frame.data
            )
            try:
                self._bus.send(message)
            except self._can.CanOperationError:
                return
