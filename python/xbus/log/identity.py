"""The identity of the device that sent a log, from its messages."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from xbus import _core
from xbus.protocol.configuration import Configuration, Firmware
from xbus.protocol.ids import MessageId
from xbus.protocol.tables import MASTER, device_of
from xbus.wire.message import Message

__all__ = [
    "HEAD_MESSAGES",
    "IDENTITY_MESSAGES",
    "SETTINGS_MESSAGES",
    "Identity",
    "device_id_of",
    "has_mtdata",
    "identities_of",
    "identity_of",
]

#: The messages that identify the device.
IDENTITY_MESSAGES = (
    MessageId.DeviceID,
    MessageId.Configuration,
    MessageId.FirmwareRev,
    MessageId.ProductCode,
)
#: The messages with the settings of MTData, beside the Configuration.
SETTINGS_MESSAGES = (
    MessageId.SetOutputMode,
    MessageId.SetOutputModeAck,
    MessageId.SetOutputSettings,
    MessageId.SetOutputSettingsAck,
)
#: The messages at the start of a recording: they say what the device is and how it was set.
HEAD_MESSAGES = (
    *IDENTITY_MESSAGES,
    *SETTINGS_MESSAGES,
    MessageId.ReqStringOutputTypeAck,
    MessageId.EmtsData,
)


@dataclass(frozen=True)
class Identity:
    """Identifier, product code, firmware and configuration of a device.

    The first message that has one of them counts. Messages with another device identifier, as in files of
    several recordings, do not.
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
            identity = identity.merged(_identity_of(message))
        return identity

    def merged(self, other: Identity) -> Identity:
        """Returns this identity with its gaps filled in from another one of the same device."""
        if self.device_id is not None and other.device_id not in (None, self.device_id):
            return self
        known = {key: value for key, value in vars(self).items() if value is not None}
        # FirmwareRev has the build, which Configuration lacks.
        if self.firmware and self.firmware.build is None and other.firmware:
            known["firmware"] = other.firmware
        return replace(other, **known)


def identities_of(
    messages: Iterable[Message], earlier: Mapping[int, Identity] | None = None
) -> dict[int, Identity]:
    """Returns the identity of each device, by BID; 1 stands for FF too.

    Args:
        messages: Messages of all devices; only those of `IDENTITY_MESSAGES` contribute.
        earlier: What is known from earlier messages.
    """
    identities = dict(earlier or {})
    for message in messages:
        if trackers := _trackers(message):
            identities |= trackers
            continue
        device = device_of(message.bid)
        identities[device] = identities.get(device, Identity()).updated([message])
    return identities


def identity_of(
    identities: Mapping[int, Identity], bids: Sequence[int], bid: int | None = None
) -> Identity:
    """Returns the identity of one of the devices that sent samples.

    If it is the only one, messages of other BIDs describe it too.

    Args:
        identities: The identities by BID, as from `identities_of`.
        bids: The BIDs of the devices that sent samples.
        bid: The BID of the device; None for the first.
    """
    if bid is None:
        bid = bids[0] if bids else None
    identity = Identity() if bid is None else identities.get(device_of(bid), Identity())
    if len(bids) > 1:
        return identity
    for other in identities.values():
        identity = identity.merged(other)
    return identity


def device_id_of(message: Message) -> int | None:
    """Returns the device identifier in one of `IDENTITY_MESSAGES`, if it has one.

    The Configuration of an Xbus Master has those of its trackers: its own is of no device that sends samples.
    """
    return None if _trackers(message) else _identity_of(message).device_id


def has_mtdata(configuration: bytes) -> bool:
    """Returns whether a Configuration has settings of MTData in force: the length of a device is not 0."""
    return any(configuration[102::20]) or any(configuration[103::20])


def _trackers(message: Message) -> dict[int, Identity]:
    """Returns the identity of each tracker, by BID, if this is the Configuration of an Xbus Master."""
    if message.name != "Configuration" or message.bid != MASTER:
        return {}
    read = Configuration.read(message.payload)
    ids = enumerate(_core.tracker_ids(message.payload), 1)
    return {bid: Identity(device_id=device_id, configuration=read) for bid, device_id in ids}


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
