"""The identity of the device that sent a log, from its messages."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

from xbus import _core
from xbus.protocol.configuration import Configuration, Firmware
from xbus.protocol.ids import MessageId
from xbus.wire.message import Message

__all__ = ["IDENTITY_MESSAGES", "Identity"]

#: The messages that identify the device.
IDENTITY_MESSAGES = (
    MessageId.DeviceID,
    MessageId.Configuration,
    MessageId.FirmwareRev,
    MessageId.ProductCode,
)


@dataclass(frozen=True)
class Identity:
    """Identifier, product code, firmware and configuration of a device.

    The first message that has one of them counts.
    """

    device_id: int | None = None
    product_code: str | None = None
    firmware: Firmware | None = None
    configuration: Configuration | None = None

    def updated(self, messages: Iterable[Message]) -> Identity:
        """Returns this identity with its gaps filled in from ``messages``.

        Only messages of `IDENTITY_MESSAGES` contribute.
        """
        identity = self
        for message in messages:
            identity = identity._merged(_identity_of(message))
        return identity

    def _merged(self, other: Identity) -> Identity:
        known = {key: value for key, value in vars(self).items() if value is not None}
        # FirmwareRev has the build, which Configuration lacks.
        if self.firmware and self.firmware.build is None and other.firmware:
            known["firmware"] = other.firmware
        return replace(other, **known)


def _identity_of(message: Message) -> Identity:
    payload = message.payload
    match message.name:
        case "DeviceID":
            return Identity(device_id=_core.device_id(payload))
        case "ProductCode":
            return Identity(product_code=_core.product_code(payload))
        case "FirmwareRev" if len(payload) >= 3:
            return Identity(firmware=_firmware(payload))
        case "Configuration" if (read := Configuration.read(payload)) is not None:
            return Identity(read.device_id, read.product_code, read.firmware, read)
    return Identity()


def _firmware(payload: bytes) -> Firmware:
    major, minor, revision = payload[:3]
    if len(payload) < 11:
        return Firmware(major, minor, revision)
    build, scm = (int.from_bytes(payload[at : at + 4], "big") for at in (3, 7))
    return Firmware(major, minor, revision, build, scm)
