"""Output that xbus keeps verbatim and does not decode, in words."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

from xbus.formatting import format_count, format_size
from xbus.protocol.ids import MessageId
from xbus.protocol.mtdata import remedy_of_size
from xbus.protocol.tables import MESSAGES

__all__ = [
    "NO_ORIENTATION",
    "Undecoded",
    "describe_undecoded",
    "output_mids",
    "output_name",
    "undecoded_output",
]

#: What recordings of Awinda trackers lack.
NO_ORIENTATION = (
    "Awinda trackers send increments, from which the vendor's software computes the orientation: the file "
    "holds none"
)
#: Maximum number of items in a sentence.
MAX_NAMED = 3
_LISTED_MIDS = frozenset(row.mid for row in MESSAGES.values())


class Undecoded(NamedTuple):
    """Messages or packets of one identifier that are kept verbatim and not decoded.

    Attributes:
        kind: ``"message"`` or ``"packet"``.
        id: Message identifier, or data identifier as received.
        number: How many there are.
        size: Bytes of their payloads.
        reason: Why they are not decoded.

    >>> print(Undecoded("packet", 0xA080, 1200, 48000, "its layout is not published"))
    1,200 packets 0xA080, 48.0 kB: its layout is not published
    """

    kind: str
    id: int
    number: int
    size: int
    reason: str

    @classmethod
    def messages(cls, mid: int, number: int, size: int) -> Undecoded:
        """Returns the messages with an identifier of `output_mids`."""
        return cls("message", mid, number, size, _reason(mid))

    @classmethod
    def mtdata(cls, length: int, number: int) -> Undecoded:
        """Returns MTData messages with a payload of this length, which does not fit their settings."""
        return cls("message", MessageId.MTData, number, number * length, remedy_of_size(length))

    @classmethod
    def packets(cls, data_id: int, number: int, size: int) -> Undecoded:
        """Returns the packets with an identifier, or of a size, that the tables do not list."""
        reason = "xbus knows no layout for this identifier and size"
        return cls("packet", data_id, number, size, reason)

    @property
    def name(self) -> str:
        """Name and identifier: ``"MTData (0x32)"``."""
        return output_name(self.id) if self.kind == "message" else f"0x{self.id:04X}"

    def to_dict(self) -> dict[str, Any]:
        """Returns it as plain values for JSON, with `name` in place of `id`."""
        return {
            "kind": self.kind,
            "name": self.name,
            **dict(zip(self._fields[2:], self[2:], strict=True)),
        }

    @property
    def key(self) -> tuple[str, int, str]:
        """What two have in common that `plus` adds."""
        return self.kind, self.id, self.reason

    def plus(self, other: Undecoded) -> Undecoded:
        """Returns the sum of two with the same `key`."""
        return self._replace(number=self.number + other.number, size=self.size + other.size)

    def __str__(self) -> str:
        return f"{format_count(self.number, self.kind)} {self.name}, {format_size(self.size)}: {self.reason}"


def describe_undecoded(items: Iterable[Undecoded]) -> str:
    """Returns the first `MAX_NAMED` items in words, and the number of the others."""
    texts = list(map(str, items))
    more = len(texts) - MAX_NAMED
    return "; ".join([*texts[:MAX_NAMED], f"and {more:,} more"] if more > 0 else texts)


def output_mids(mids: Iterable[int]) -> list[int]:
    """Returns the messages among these that a device sends as output, and that are no samples.

    These are MTData that does not fit its settings, and messages that the manual does not list.

    Args:
        mids: Message identifiers.

    >>> output_mids([0x3E, 0x32, 0x08])
    [50, 8]
    """
    return [mid for mid in mids if mid == MessageId.MTData or mid not in _LISTED_MIDS]


def output_name(mid: int) -> str:
    """Returns the name of a message of `output_mids`.

    >>> output_name(0x32), output_name(0x08)
    ('MTData (0x32)', '0x08')
    """
    return "MTData (0x32)" if mid == MessageId.MTData else f"0x{mid:02X}"


def undecoded_output(mid: int) -> str:
    """Returns what a message of `output_mids` is.

    >>> undecoded_output(0x32)
    'MTData (0x32), the legacy output, whose OutputMode and OutputSettings are not known'
    """
    what = output_name(mid) if mid == MessageId.MTData else f"message {output_name(mid)}"
    return f"{what}, {_reason(mid)}"


def _reason(mid: int) -> str:
    if mid == MessageId.MTData:
        return "the legacy output, whose OutputMode and OutputSettings are not known"
    return "which the manual does not list"
