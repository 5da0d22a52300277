"""Corrections sent to the GNSS receiver of a device.

Corrections are RTCM 3 frames from a base station, which a caster distributes (`xbus.rtk.caster`). Only
complete frames are sent, because the receiver could take other bytes for its settings.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Protocol

from xbus.errors import XbusTimeout
from xbus.rtk.rtcm import rtcm_frames

__all__ = ["Forwarder"]

#: Messages in a row without an answer after which forwarding ends. Corrections repeat about every second, and
#: the answer may be lost where the correction is not.
MAX_UNANSWERED = 5


class GnssDevice(Protocol):
    """A device with a GNSS receiver that accepts corrections; `xbus.Device` is one."""

    def command(self, name: str, value: bytes) -> object:
        """Sends a command by the manual's name and waits for the acknowledgement."""
        ...


class Forwarder:
    """Sends corrections to the GNSS receiver of a device, and counts them.

    Args:
        device: A device in Measurement State.

    Attributes:
        messages: RTCM 3 frames that were sent.
        bytes: Their bytes.
        unanswered: Messages that the device did not acknowledge.
    """

    def __init__(self, device: GnssDevice) -> None:
        self.messages = 0
        self.bytes = 0
        self.unanswered = 0
        self._device = device
        self._unanswered_in_a_row = 0

    def forward(self, chunks: Iterable[bytes]) -> None:
        """Sends each RTCM 3 frame as a ForwardGnssData message (0xE2), until `chunks` ends.

        Args:
            chunks: Bytes, in pieces of any size, such as a generator that waits for them. Bytes outside
                RTCM 3 frames are not sent.

        Raises:
            StateError: The device is in Config State, or its product does not have the message.
            DeviceError: The device refused a message.
            XbusTimeout: Five messages in a row were not answered.
            Disconnected: The port is gone.
            ImportError: The extra ``rtk`` is not installed.
        """
        for frame in rtcm_frames(chunks):
            self.messages += 1
            self.bytes += len(frame)
            try:
                self._device.command("ForwardGnssData", frame)
                self._unanswered_in_a_row = 0
            except XbusTimeout:
                self.unanswered += 1
                self._unanswered_in_a_row += 1
                if self._unanswered_in_a_row >= MAX_UNANSWERED:
                    raise

    def __repr__(self) -> str:
        return f"<Forwarder {self.messages} messages, {self.bytes} bytes, {self.unanswered} unanswered>"
