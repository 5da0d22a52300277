"""Which identifiers the devices on a bus have."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from xbus import _core
from xbus.protocol.can import CAN_MESSAGES, CanMessage, can_message

__all__ = [
    "EXTENDED",
    "STANDARD_IDS",
    "DeviceIds",
    "Ids",
    "core_entries",
    "device_ids",
    "id_text",
    "parse_ids",
]

#: Added to an identifier, marks one of 29 bits; needed only below 0x800. DBC files have the same mark.
EXTENDED = _core.CAN_EXTENDED
STANDARD_IDS = 1 << 11
EXTENDED_IDS = 1 << 29

DeviceIds = int | Mapping[str | int, int]
#: The identifiers of one device or, in a list, of several: see `xbus.read_can`.
Ids = DeviceIds | Sequence[DeviceIds]


def device_ids(ids: Ids | None) -> list[dict[int, CanMessage]]:
    """Returns the messages of each device by identifier, with `EXTENDED`.

    Args:
        ids: As in `xbus.read_can`.

    Raises:
        TypeError: The identifiers are not of a type that `Ids` lists.
        ValueError: An identifier is out of range or stands for two messages, or a message does not exist.

    >>> [f"{key:X}: {row.name}" for key, row in device_ids(0x19FF0000)[0].items()][:3]
    ['99FF0001: Error', '99FF0002: Warning', '99FF0005: SampleTime']
    """
    several = ids if isinstance(ids, Sequence) and not isinstance(ids, str) else [ids]
    if not several:
        raise ValueError("ids is an empty list; it needs the identifiers of one device at least")
    devices = [_device(one) for one in several]
    known: dict[int, tuple[int, CanMessage]] = {}
    for number, device in enumerate(devices, 1):
        for key, message in device.items():
            if key in known:
                other, row = known[key]
                raise ValueError(
                    f"the identifier {id_text(key)} is {row.name} of device {other} and {message.name} of "
                    f"device {number}; give each device its own identifiers"
                )
            known[key] = number, message
    return devices


def _device(ids: DeviceIds | None) -> dict[int, CanMessage]:
    if ids is None:
        ids = 0
    if isinstance(ids, int) and not isinstance(ids, bool):
        offset, mark = ids & ~EXTENDED, ids & EXTENDED
        pairs = [(offset + code, message) for code, message in CAN_MESSAGES.items()]
        if offset >= STANDARD_IDS:
            mark = EXTENDED
        elif not mark and offset + max(CAN_MESSAGES) >= STANDARD_IDS:
            raise ValueError(
                f"the offset 0x{offset:X} leads beyond the identifiers of 11 bits; add 0x{EXTENDED:X} "
                "for 29 bits"
            )
        return {_checked(number | mark): message for number, message in pairs}
    if not isinstance(ids, Mapping):
        raise TypeError(
            f"ids is an offset, a mapping from message to identifier, or a list of these, not {ids!r}"
        )
    found: dict[int, CanMessage] = {}
    for name, key in ids.items():
        message, key = can_message(name), _checked(key)
        if key in found:
            raise ValueError(
                f"the identifier {id_text(key)} is both {found[key].name} and {message.name}"
            )
        found[key] = message
    return found


def _checked(key: int) -> int:
    """Returns an identifier with its mark."""
    if not isinstance(key, int) or isinstance(key, bool):
        raise TypeError(f"an identifier is a number, not {key!r}")
    number = key & ~EXTENDED
    if key < 0 or number >= EXTENDED_IDS:
        raise ValueError(f"0x{key:X} is no CAN identifier; one has 11 or 29 bits")
    return key if number < STANDARD_IDS else number | EXTENDED


def parse_ids(text: str) -> DeviceIds:
    """Returns the identifiers of a device that are written as text.

    Args:
        text: An offset (``0x100``), or identifiers by message (``SampleTime=0x10,Acceleration=0x11``).

    Raises:
        ValueError: A number cannot be read.

    >>> parse_ids("0x100"), parse_ids("SampleTime=0x10,Acceleration=0x11")
    (256, {'SampleTime': 16, 'Acceleration': 17})
    """
    if "=" not in text:
        return _number(text)
    pairs = [pair.partition("=") for pair in text.split(",")]
    return {name.strip(): _number(number) for name, _, number in pairs}


def _number(text: str) -> int:
    try:
        return int(text, 0)
    except ValueError as error:
        raise ValueError(
            f"{text!r} is no identifier; write a number, such as 0x100, or MESSAGE=NUMBER,..."
        ) from error


def core_entries(devices: Sequence[Mapping[int, CanMessage]]) -> list[tuple[int, int, int]]:
    """Returns the messages of devices as the core takes them: identifier, bus identifier and code of each."""
    return [
        (key, bid, message.code)
        for bid, device in enumerate(devices, 1)
        for key, message in device.items()
    ]


def id_text(key: int) -> str:
    """Returns an identifier as text: three digits for 11 bits, eight for 29.

    >>> id_text(0x34), id_text(0x34 | EXTENDED)
    ('034', '00000034')
    """
    return f"{key & ~EXTENDED:08X}" if key & EXTENDED else f"{key:03X}"
