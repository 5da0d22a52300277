"""What a device sends, in words."""

from __future__ import annotations

from collections.abc import Mapping

from xbus.protocol.undecoded import output_mids, undecoded_output

__all__ = ["describe_outputs", "describe_rates"]

#: Maximum number of quantities in a sentence.
MAX_NAMED = 6


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
