"""What a device sends, in words."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from xbus.protocol.ids import MessageId
from xbus.protocol.tables import MESSAGES

__all__ = ["describe_outputs", "describe_rates", "output_mids", "output_name", "undecoded_output"]

#: Maximum number of quantities in a sentence.
MAX_NAMED = 6
_LISTED_MIDS = frozenset(row.mid for row in MESSAGES.values())


def output_mids(mids: Iterable[int]) -> list[int]:
    """Returns the messages among these that a device sends as output, and that are no samples.

    These are the legacy MTData, and messages that the manual does not list.

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
    'MTData (0x32), the legacy output, which xbus records but does not decode'
    """
    if mid == MessageId.MTData:
        return f"{output_name(mid)}, the legacy output, which xbus records but does not decode"
    return f"message {output_name(mid)}, which the manual does not list"


def describe_rates(rates: Mapping[str, float]) -> str:
    """Returns the quantities and strings that arrive, with their rates in Hz.

    >>> describe_rates({"acceleration": 100.0, "temperature": 0.984, "baro_pressure": 0})
    'acceleration (100 Hz), temperature (0.984 Hz)'
    """
    active = {name or "other strings": rate for name, rate in rates.items() if rate > 0}
    named = [f"{name} ({rate:.3g} Hz)" for name, rate in list(active.items())[:MAX_NAMED]]
    if (more := len(active) - len(named)) > 0:
        named[-1] += f" and {more} more"
    return ", ".join(named)


def describe_outputs(rates: Mapping[str, float], message_rates: Mapping[int, float]) -> str:
    """Returns what a device sends now; an empty string if it sends nothing.

    Args:
        rates: Rates in Hz of quantities and strings by name.
        message_rates: Rates in Hz of other messages by message identifier.

    >>> describe_outputs({"HEHDT": 10.0}, {0x08: 1.0})
    'HEHDT (10 Hz), message 0x08, which the manual does not list'
    """
    active = output_mids(mid for mid, rate in message_rates.items() if rate > 0)
    return ", ".join(filter(None, [describe_rates(rates), *map(undecoded_output, active)]))
