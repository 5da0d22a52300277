"""The link to a virtual device in the same process."""

from __future__ import annotations

from xbus import _core
from xbus.sim.device import SimulatedDevice
from xbus.sim.options import device_of
from xbus.wire.link import NOTHING_RECEIVED, Received

__all__ = ["SimLink"]


class SimLink:
    """A `xbus.wire.link.Link` to a virtual device in this process.

    The device's time advances while the host waits for it.

    Args:
        device: The device, or its product as in ``sim:MTi-630``.
        strings: Bits of the string types without a checksum to look for.
    """

    #: Seconds of device time between two checks for new bytes.
    POLL_TIME = 0.005
    #: The shortest advance in seconds: a wait ends in spite of rounding.
    SHORTEST_ADVANCE = 1e-6
    is_line = True
    #: The device's clock starts in 1970, so the times of samples are reproducible.
    epoch = 0
    trouble = None

    def __init__(self, device: str | SimulatedDevice, strings: int = 0) -> None:
        if isinstance(device, str):
            device = device_of(device)
        self.device = device
        self.name = f"sim:{device.product.name}"
        self.baudrate = device.baudrate
        self.acquisition = _core.Acquisition(None, strings=strings)

    def read(self, timeout: float) -> Received:
        """Returns what has arrived; waits for it at most ``timeout`` seconds of device time."""
        until = self.device.time + max(timeout, self.SHORTEST_ADVANCE)
        while True:
            self._check()
            if data := self.device.read(self.baudrate):
                self.acquisition.push(data)
                # The acquisition counts and records the bytes. They are returned from here, so its queue
                # is emptied.
                self.acquisition.read(0)
                return Received.at(data, self.device.time)
            left = until - self.device.time
            if left < self.SHORTEST_ADVANCE / 2:
                return NOTHING_RECEIVED
            self.device.advance(min(self.POLL_TIME, left))

    def write(self, data: bytes) -> None:
        """Sends bytes to the device."""
        self._check()
        self.device.write(data, self.baudrate)

    def _check(self) -> None:
        if not self.device.plugged:
            raise ConnectionResetError(f"{self.name} was unplugged")

    def clock(self) -> float:
        """Returns the device's time in seconds."""
        return self.device.time

    def pause(self, seconds: float) -> None:
        """Advances the device's time."""
        self.device.advance(seconds)

    def reopen(self) -> None:
        """Raises ConnectionResetError while the plug is out."""
        self._check()

    def close(self) -> None:
        """Stops the acquisition; the device remains in its state."""
        self.acquisition.close()
