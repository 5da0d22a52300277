"""The link to a virtual device in the same process."""

from __future__ import annotations

from xbus import _core
from xbus.sim.device import SimulatedDevice
from xbus.sim.options import device_of
from xbus.wire.link import NOTHING_RECEIVED, Received

__all__ = ["SimLink"]


class SimLink:
    """A virtual device in this process, whose time moves while one waits for it."""

    #: Seconds of device time between two looks at what it has sent.
    STEP = 0.005
    #: Seconds that pass at least, so that a wait comes to its end whatever rounding leaves of it.
    LEAST = 1e-6
    is_line = True
    #: Its clock begins in 1970, so that what is measured is the same every time.
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
        """What has come."""
        until = self.device.time + max(timeout, self.LEAST)
        while True:
            self._check()
            if data := self.device.read(self.baudrate):
                self.acquisition.push(data)
                self.acquisition.read(
                    0
                )  # it counts and records them; nobody has to wait for them here
                return Received.at(data, self.device.time)
            left = until - self.device.time
            if left < self.LEAST / 2:
                return NOTHING_RECEIVED
            self.device.advance(min(self.STEP, left))

    def write(self, data: bytes) -> None:
        """Sends."""
        self._check()
        self.device.write(data, self.baudrate)

    def _check(self) -> None:
        if not self.device.plugged:
            raise ConnectionResetError(f"{self.name} was unplugged")

    def clock(self) -> float:
        """Seconds."""
        return self.device.time

    def pause(self, seconds: float) -> None:
        """Lets time pass."""
        self.device.advance(seconds)

    def reopen(self) -> None:
        """Looks whether the plug is in again."""
        self._check()

    def close(self) -> None:
        """Leaves the device as it is."""
        self.acquisition.close()
