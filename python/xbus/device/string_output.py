"""String outputs: the settings for a choice of strings and a rate."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from xbus.device.output_configuration import overload_message
from xbus.protocol.products import Support
from xbus.protocol.strings import STRING_FIELDS
from xbus.protocol.values import (
    BITS_PER_BYTE,
    ON_DEMAND,
    PERIOD_TICKS,
    PERIODS,
    StringOutput,
    StringType,
)
from xbus.wire.strings import string_types

__all__ = [
    "UNFRAMED_STRINGS",
    "StringPlan",
    "check_strings_fit",
    "frequency_of",
    "period_and_skip_factor",
    "plan_strings",
]

#: The strings that have neither checksum nor end of line, so that only their length identifies them.
UNFRAMED_STRINGS = StringType.EM1000


@dataclass(frozen=True)
class StringPlan:
    """The settings for a choice of strings.

    Attributes:
        output: The types, and on the 600-series the rate.
        period: Sampling period in 1/115200 s; None leaves it unchanged.
        skip_factor: Strings skipped between two; None leaves it unchanged.
        frequency: The rate in Hz; None if strings come on request, or never.
    """

    output: StringOutput
    period: int | None = None
    skip_factor: int | None = None
    frequency: float | None = None

    @property
    def messages(self) -> list[tuple[str, Any]]:
        """Name and value of each message, in the order in which they are sent."""
        rate = [("SetPeriod", self.period), ("SetOutputSkipFactor", self.skip_factor)]
        return [
            *((name, value) for name, value in rate if value is not None),
            ("SetStringOutputType", self.output),
        ]


def frequency_of(period: int, skip_factor: int) -> float | None:
    """Returns the rate in Hz for a sampling period and a skip factor (section 5.3.5); None: on request.

    >>> frequency_of(1152, 1), frequency_of(768, 1)
    (50.0, 75.0)
    """
    return None if skip_factor == ON_DEMAND else PERIOD_TICKS / (period * (skip_factor + 1))


def period_and_skip_factor(frequency: float) -> tuple[int, int]:
    """Returns the sampling period and the skip factor for a rate in Hz, with the lowest possible skip factor.

    Raises:
        ValueError: There are none; the message names the nearest rates.

    >>> period_and_skip_factor(75)
    (768, 1)
    """
    ticks = PERIOD_TICKS / frequency if frequency > 0 else 0.0
    if not PERIODS[0] <= ticks <= PERIODS[-1] * ON_DEMAND:
        least, most = PERIOD_TICKS / PERIODS[-1] / ON_DEMAND, PERIOD_TICKS // PERIODS[0]
        raise ValueError(f"the rate must be from {least:.4f} to {most} Hz, not {frequency:g} Hz")
    exact, below = round(ticks), int(ticks)
    # A rate given with a few digits, such as 100.964, means the exact one.
    if abs(ticks - exact) <= 1e-6 * ticks and (found := _factors(exact)) is not None:
        return found
    faster = next(count for count in range(below, 0, -1) if _factors(count))
    longest = PERIODS[-1] * ON_DEMAND
    slower = next(count for count in range(below + 1, longest + 1) if _factors(count))
    rates = f"{PERIOD_TICKS / slower:.6g} and {PERIOD_TICKS / faster:.6g} Hz"
    raise ValueError(f"no period and skip factor give {frequency:g} Hz; the nearest are {rates}")


def _factors(ticks: int) -> tuple[int, int] | None:
    """Returns the period and the skip factor whose product is `ticks`, or None."""
    fewest = -(-ticks // PERIODS[-1])
    for periods in range(fewest, ticks // PERIODS[0] + 1):
        if ticks % periods == 0 and periods <= ON_DEMAND:
            return ticks // periods, periods - 1
    return None


def plan_strings(
    strings: Iterable[StringType | str], frequency: float | None, support: Support | None
) -> StringPlan:
    """Returns the settings for some strings at a rate in Hz; None: on request.

    Raises:
        ValueError: The product does not have the strings or the rate, or is not known.
    """
    if support is None:
        raise ValueError(
            "the product is not in the manual, so it is not known how to set the rate of its strings; use the"
            " messages SetStringOutputType, SetPeriod and SetOutputSkipFactor"
        )
    types = StringType(0)
    for kind in string_types(strings):
        types |= kind
    if not types:
        if frequency is not None:
            raise ValueError(f"a rate of {frequency:g} Hz needs at least one string")
        return StringPlan(StringOutput(types, 0 if support.strings_have_rate else None))
    if support.strings_have_rate:
        name, most = support.product.name, support.base_rate
        if frequency is None:
            raise ValueError(
                f"the {name} does not send strings on request; give a rate from 1 to {most} Hz"
            )
        if frequency not in range(1, most + 1):
            raise ValueError(
                f"the {name} sends strings at a whole number of Hz from 1 to {most}, not at {frequency:g} Hz"
            )
        return StringPlan(StringOutput(types, int(frequency)), frequency=int(frequency))
    if frequency is None:
        return StringPlan(StringOutput(types), skip_factor=ON_DEMAND)
    period, skip_factor = period_and_skip_factor(frequency)
    return StringPlan(StringOutput(types), period, skip_factor, frequency_of(period, skip_factor))


def check_strings_fit(plan: StringPlan, support: Support, baudrate: int) -> None:
    """Checks that a serial line carries these strings.

    Raises:
        ValueError: It does not; the message names a sufficient baud rate.
    """
    characters = sum(STRING_FIELDS[kind].length for kind in plan.output.types)
    needed = round(characters * (plan.frequency or 0))
    if needed > baudrate // BITS_PER_BYTE:
        raise ValueError(overload_message("strings", needed, baudrate, support))
