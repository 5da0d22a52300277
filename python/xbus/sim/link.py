"""The link to a virtual device in the same process."""

from __future__ import annotations

import threading
from typing import Unpack

from xbus import _core
from xbus.sim.device import SimulatedDevice
from xbus.sim.options import device_of
from xbus.wire.link import Need

__all__ = ["SimLink"]


class SimLink:
    """A `xbus.wire.link.Link` to a virtual device in this process.

    The device's time advances while the host waits for it.

    Args:
        device: The device, or its product as in ``sim:MTi-630``.
        bid: Bus identifier of the device whose frames are handed out; 0xFF for all.
        bound: Maximum number of bytes of samples that wait to be read.
        strings: Bits of the string types without a checksum to look for.
    """

    #: Seconds of device time between two checks for new bytes.
    POLL_TIME = 0.005
    #: The shortest advance in seconds: a wait ends in spite of rounding.
    SHORTEST_ADVANCE = 1e-6
    is_line = True
    trouble = None
    refusal = None

    def __init__(
        self,
        device: str | SimulatedDevice,
        *,
        bid: int = 0xFF,
        bound: int = 24_000_000,
        strings: int = 0,
    ) -> None:
        if isinstance(device, str):
            device = device_of(device)
        self.device = device
        self.name = f"sim:{device.product.name}"
        self.baudrate: int | None = device.baudrate
        #: Bytes are pushed in the order in which the device sends them.
        self._stepping = threading.Lock()
        self._bid, self._bound, self._strings = bid, bound, strings
        self.restart()

    def restart(self) -> None:
        """Begins a new acquisition."""
        # The device's clock starts in 1970, so the times of samples are reproducible.
        self.acquisition = _core.Acquisition(
            None, bid=self._bid, bound=self._bound, strings=self._strings, epoch=0
        )

    def wait(self, timeout: float, **need: Unpack[Need]) -> bool:
        """Waits up to ``timeout`` seconds of device time: see `_core.Acquisition.wait`."""
        until = self.device.time + max(timeout, self.SHORTEST_ADVANCE)
        while not self.acquisition.wait(0, **need):
            left = until - self.device.time
            if left < self.SHORTEST_ADVANCE / 2:
                return False
            with self._stepping:
                if not self._receive():
                    self.device.advance(min(self.POLL_TIME, left))
                    self._receive()
        return True

    def _receive(self) -> bool:
        """Passes on what the device has sent; returns whether there was anything."""
        if not self.device.plugged:
            self.acquisition.end(f"{self.name} was unplugged")
            return True
        data = self.device.read(self.baudrate)
        self.acquisition.push(data, self.device.time)
        return bool(data)

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
        until = self.device.time + seconds
        while (left := until - self.device.time) >= self.SHORTEST_ADVANCE / 2:
            with self._stepping:
                self.device.advance(min(self.POLL_TIME, left))
                self._receive()

    def reopen(self) -> None:
        """Continues after the device is plugged in again.

        Raises:
            ConnectionResetError: It is not.
        """
        self._check()
        if self.acquisition.ended is not None:
            self.acquisition.resume()

    def close(self) -> None:
        """Stops the acquisition; the device remains in its state."""
        self.acquisition.close()

    def abandon(self) -> None:
        """Does nothing: a forked process has a copy of the device."""
