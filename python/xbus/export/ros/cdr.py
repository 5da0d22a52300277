"""How messages are laid out in bytes: XCDR1, little-endian.

A message is a head, the same for all messages of a topic but for the time stamp, and a body. Numbers are
aligned to their sizes, counted from the end of the encapsulation; so where a body begins and how it is padded
depends on the length of the frame id.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

__all__ = ["DOUBLES", "Head", "Layout", "bare", "stamped", "transform"]

#: Little-endian XCDR1, which alignment does not count.
ENCAPSULATION = bytes([0, 1, 0, 0])
#: Where a header that begins a message has its time stamp.
STAMP = len(ENCAPSULATION)

#: Names, types and shapes of the fields of a body, in order.
Fields = Sequence[tuple[str, str, tuple[int, ...]]]


class Head(NamedTuple):
    """What all messages of a topic begin with.

    Attributes:
        data: The bytes.
        stamp: Where they have the time stamp; None without one.
    """

    data: bytes
    stamp: int | None


class Layout(NamedTuple):
    """The layout of a body.

    Attributes:
        head: The head, padded to where the body begins.
        dtype: The type of a body.
    """

    head: Head
    dtype: np.dtype[Any]

    @classmethod
    def of(cls, head: Head, fields: Fields) -> Layout:
        """Returns the layout of fields that follow a head.

        >>> layout = Layout.of(stamped("imu_link"), [("status", "i1", ()), ("service", "<u2", ())])
        >>> len(layout.head.data), layout.dtype.fields["service"]
        (25, (dtype('uint16'), 1))
        """
        ends = len(head.data) - len(ENCAPSULATION)
        offsets = []
        for _, kind, shape in fields:
            size = np.dtype(kind).itemsize
            ends += -ends % size
            offsets.append(ends)
            ends += size * int(np.prod(shape))
        begins = offsets[0]
        padding = bytes(begins + len(ENCAPSULATION) - len(head.data))
        dtype: np.dtype[Any] = np.dtype(
            {
                "names": [name for name, _, _ in fields],
                "formats": [(kind, shape) for _, kind, shape in fields],
                "offsets": [offset - begins for offset in offsets],
                "itemsize": ends - begins,
            }
        )
        return cls(Head(head.data + padding, head.stamp), dtype)

    def bodies(self, rows: int) -> npt.NDArray[Any]:
        """Returns bodies of zeros, ``(rows,)``."""
        return np.zeros(rows, self.dtype)


#: A body of nothing but numbers.
DOUBLES = "<f8"


def _string(text: str) -> bytes:
    data = text.encode() + b"\0"
    return struct.pack("<I", len(data)) + data


def bare() -> Head:
    """Returns the head of messages without a header."""
    return Head(ENCAPSULATION, None)


def stamped(frame: str) -> Head:
    """Returns the head of messages that begin with a header."""
    return Head(ENCAPSULATION + bytes(8) + _string(frame), STAMP)


def transform(parent: str, child: str) -> Head:
    """Returns the head of messages with one transform, up to the translation."""
    count = struct.pack("<I", 1)
    data = ENCAPSULATION + count + bytes(8) + _string(parent)
    data += bytes(-(len(data) - len(ENCAPSULATION)) % 4)
    return Head(data + _string(child), STAMP + len(count))
