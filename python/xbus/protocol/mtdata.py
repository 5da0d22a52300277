"""MTData, the output of older devices: its items, which OutputMode and OutputSettings select."""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

from xbus import _core

__all__ = ["MTDATA_ITEMS", "MtDataItem", "describe_output", "outputs_of_size", "remedy_of_size"]


class MtDataItem(NamedTuple):
    """An item of an MTData message. It has no identifier: the settings decide whether and where it is.

    Attributes:
        mode: The bit of OutputMode that it needs; 0 if OutputSettings alone decides.
        mask: Bits of OutputSettings.
        value: The value that these bits must have.
        quantity: Name of the quantity that a log has of it.
        step: If it is a U2 that counts steps of the quantity's unit: the size of one. Otherwise None.
    """

    mode: int
    mask: int
    value: int
    quantity: str
    step: int | None


#: The items in the order of the wire.
MTDATA_ITEMS = tuple(MtDataItem(**row) for row in _core.mtdata_items())

#: OutputMode and OutputSettings that were seen with devices, the factory settings first.
_SEEN = (
    (0x0004, 0x00000001),
    (0x0006, 0x00000001),
    (0x0006, 0x00000044),
    (0x0006, 0x00000009),
    (0x080F, 0x80000005),
    (0x4000, 0x00000001),
    (0x0004, 0x00000105),
    (0x1836, 0x80000C05),
    (0x0837, 0x00000046),
)
#: What else devices are often set to: with and without temperature, sensors, orientation and status; with and
#: without a counter; in each form of the orientation.
_MODES = (0x0002, 0x0004, 0x0006, 0x0003, 0x0005, 0x0007, 0x0806, 0x0807, 0x0036, 0x0836)
_SETTINGS = (0x00000001, 0x00000005, 0x00000009, 0x00000000, 0x00000004, 0x00000008)
#: Most suggestions in a sentence.
_MAX_SUGGESTED = 3


def describe_output(mode: int, settings: int) -> str:
    """Returns settings of MTData as users write them.

    >>> describe_output(0x0006, 0x0000_0001)
    '0006:00000001'
    """
    return f"{mode:04X}:{settings:08X}"


@cache
def outputs_of_size(size: int) -> tuple[str, ...]:
    """Returns settings with which a payload has this length: those seen with devices, then usual ones.

    >>> outputs_of_size(22)
    ('4000:00000001', '0005:00000001')
    """
    known = dict.fromkeys((*_SEEN, *((mode, bits) for mode in _MODES for bits in _SETTINGS)))
    fitting = [pair for pair in known if _size_of(*pair) == size]
    return tuple(describe_output(*pair) for pair in fitting)


def _size_of(mode: int, settings: int) -> int:
    return sum(item.size for item in _core.mtdata_layout(mode, settings))


def remedy_of_size(size: int) -> str:
    """Returns what to do with MTData of this length that does not fit the settings in force.

    >>> print(remedy_of_size(18))
    no OutputMode and OutputSettings for 18 bytes; 0004:00000001 or 0005:00000005 fits; pass it with legacy=
    """
    fitting = outputs_of_size(size)
    problem = f"no OutputMode and OutputSettings for {size} bytes"
    if not fitting:
        return f"{problem}; pass those of the device with legacy="
    shown = " or ".join(fitting[:_MAX_SUGGESTED])
    return f"{problem}; {shown} fits; pass it with legacy="
