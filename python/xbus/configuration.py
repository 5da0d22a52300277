"""What a device says about itself."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

from xbus import _core
from xbus.ids import MessageId

if TYPE_CHECKING:
    from xbus.log import Message

__all__ = ["TELLING", "Configuration", "Firmware", "Identity"]


class Firmware(NamedTuple):
    """A firmware revision (Table 4); build and scm are None where only a Configuration tells it."""

    major: int
    minor: int
    revision: int
    build: int | None = None
    scm: int | None = None

    def __str__(self) -> str:
        return f"{self.major}.{self.minor}.{self.revision}"


@dataclass(frozen=True)
class Configuration:
    """The Configuration message (Tables 13 and 14).

    Attributes:
        device_id: Device identifier.
        product_code: Product code, where the message carries one.
        sampling_period: In 1/115200 s; None on devices with 8-byte identifiers.
        output_skip_factor: None on devices with 8-byte identifiers.
        date: ``YYYYMMDD`` as the recording host has set it, or None.
        time: ``HHMMSSHH`` as the recording host has set it, or None; the last two are hundredths.
        devices: Number of devices on the bus.
        filter_profile: Number of the filter profile.
        firmware: Firmware revision.
        output_mode: Output mode of the older MTData; None on devices with 8-byte identifiers.
        output_settings: Output settings of the older MTData; None on devices with 8-byte identifiers.
        filter_type: Letter of the kind of filter, or None.
        filter_version: Major and minor version of the filter.
    """

    device_id: int
    product_code: str | None
    sampling_period: int | None
    output_skip_factor: int | None
    date: str | None
    time: str | None
    devices: int
    filter_profile: int
    firmware: Firmware
    output_mode: int | None = None
    output_settings: int | None = None
    filter_type: str | None = None
    filter_version: tuple[int, int] = (0, 0)

    @classmethod
    def read(cls, payload: bytes) -> Configuration | None:
        """What a payload of 118 bytes says; None for one that is shorter."""
        if (fields := _core.configuration(payload)) is None:
            return None
        return cls(**{**fields, "firmware": Firmware(*fields["firmware"])})


#: The messages that say something about the device.
TELLING = (
    MessageId.DeviceID,
    MessageId.Configuration,
    MessageId.FirmwareRev,
    MessageId.ProductCode,
)


@dataclass(frozen=True)
class Identity:
    """What the messages of a log say about the device; the first to say it counts."""

    device_id: int | None = None
    product_code: str | None = None
    firmware: Firmware | None = None
    configuration: Configuration | None = None

    def updated(self, messages: Iterable[Message]) -> Identity:
        """The same, with what it lacks filled in from ``messages``; those of `TELLING` are enough."""
        told = self
        for message in messages:
            told = told._merged(_said(message))
        return told

    def _merged(self, other: Identity) -> Identity:
        known = {key: value for key, value in vars(self).items() if value is not None}
        # A FirmwareRev message tells more than a Configuration.
        if self.firmware and self.firmware.build is None and other.firmware:
            known["firmware"] = other.firmware
        return replace(other, **known)


def _said(message: Message) -> Identity:
    payload = message.payload
    match message.name:
        case "DeviceID":
            return Identity(device_id=_core.device_id(payload))
        case "ProductCode":
            return Identity(product_code=_core.product_code(payload))
        case "FirmwareRev" if len(payload) >= 3:
            return Identity(firmware=_firmware(payload))
        case "Configuration" if (it := Configuration.read(payload)) is not None:
            return Identity(it.device_id, it.product_code, it.firmware, it)
    return Identity()


def _firmware(payload: bytes) -> Firmware:
    major, minor, revision = payload[:3]
    if len(payload) < 11:
        return Firmware(major, minor, revision)
    build, scm = (int.from_bytes(payload[at : at + 4], "big") for at in (3, 7))
    return Firmware(major, minor, revision, build, scm)
