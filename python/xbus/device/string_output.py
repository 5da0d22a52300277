"""String outputs in the user's words: which, how often, and what that takes."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from xbus.device.output_configuration import BITS_PER_BYTE, overload_message
from xbus.protocol.products import Support
from xbus.protocol.strings import LAYOUTS
from xbus.protocol.values import ON_DEMAND, PERIOD_TICKS, PERIODS, StringOutput, StringType
from xbus.wire.strings import string_types

__all__ = [
    "UNFRAMED_STRINGS",
    "StringPlan",
    "check_strings_fit",
    "frequency_of",
    "period_and_skip_factor",
    "plan_strings",
]

#: The strings that have neither checksum nor end of line.
UNFRAMED_STRINGS = StringType.EM1000


@dataclass(frozen=True)
class StringPlan:
    """The settings that make strings come.

    Attributes:
        output: Which, and on the 600-series how often.
        period: Sampling period in 1/115200 s, or None to leave it.
        skip_factor: How many are left out between two, or None to leave it.
        frequency: The rate in Hz; None where they come when they are asked for, or never.
    """

    output: StringOutput
    period: int | None = None
    skip_factor: int | None = None
    frequency: float | None = None

    @property
    def messages(self) -> list[tuple[str, Any]]:
        """The messages that set it, and what they say."""
        said = [("SetPeriod", self.period), ("SetOutputSkipFactor", self.skip_factor)]
        return [*(it for it in said if it[1] is not None), ("SetStringOutputType", self.output)]


def frequency_of(period: int, skip_factor: int) -> float | None:
    """The rate in Hz that a sampling period and a skip factor make (section 5.3.5); None: on demand.

    >>> frequency_of(1152, 1), frequency_of(768, 1)
    (50.0, 75.0)
    """
    return None if skip_factor == ON_DEMAND else PERIOD_TICKS / (period * (skip_factor + 1))


def period_and_skip_factor(frequency: float) -> tuple[int, int]:
    """The sampling period and the skip factor that make a rate, with as few left out as can be.

    Raises:
        ValueError: None do; the message says which rates are near.

    >>> period_and_skip_factor(75)
    (768, 1)
    """
    ticks = PERIOD_TICKS / frequency if frequency > 0 else 0.0
    if not PERIODS[0] <= ticks <= PERIODS[-1] * ON_DEMAND:
        least, most = PERIOD_TICKS / PERIODS[-1] / ON_DEMAND, PERIOD_TICKS // PERIODS[0]
        raise ValueError(f"strings come at {least:.4f} to {most} Hz, not at {frequency:g} Hz")
    exact, below = round(ticks), int(ticks)
    # A rate that was written with a few digits is meant, too.
    if abs(ticks - exact) <= 1e-6 * ticks and (found := _factors(exact)) is not None:
        return found
    faster = next(it for it in range(below, 0, -1) if _factors(it))
    slower = next(it for it in range(below + 1, PERIODS[-1] * ON_DEMAND + 1) if _factors(it))
    rates = f"{PERIOD_TICKS / slower:.6g} and {PERIOD_TICKS / faster:.6g} Hz"
    raise ValueError(f"no period and skip factor make {frequency:g} Hz; the nearest are {rates}")


def _factors(ticks: int) -> tuple[int, int] | None:
    """Period and skip factor of so many ticks in all."""
    least = -(-ticks // PERIODS[-1])
    for times in range(least, ticks // PERIODS[0] + 1):
        if ticks % times == 0 and times <= ON_DEMAND:
            return ticks // times, times - 1
    return None


def plan_strings(
    strings: Iterable[StringType | str], frequency: float | None, support: Support | None
) -> StringPlan:
    """The settings for these strings at this rate.

    Raises:
        ValueError: The product cannot do that.
    """
    if support is None:
        raise ValueError(
            "the product is none that the manual describes, so how it takes its rate is not known;"
            " set_string_output_type, set_period and set_output_skip_factor set it"
        )
    types = StringType(0)
    for it in string_types(strings):
        types |= it
    is_600 = support.product.series == "600-series"
    if not types:
        if frequency is not None:
            raise ValueError(f"{frequency:g} Hz of what? No string is named")
        return StringPlan(StringOutput(types, 0 if is_600 else None))
    if is_600:
        name, most = support.product.name, support.rates["acceleration"]
        if frequency is None:
            raise ValueError(
                f"the {name} sends no strings on demand: a rate is needed, from 1 to {most} Hz"
            )
        if frequency not in range(1, most + 1):
            raise ValueError(
                f"the {name} sends strings at whole numbers of Hz, from 1 to {most}, not at {frequency:g} Hz"
            )
        return StringPlan(StringOutput(types, int(frequency)), frequency=int(frequency))
    if frequency is None:
        return StringPlan(StringOutput(types), skip_factor=ON_DEMAND)
    period, skip_factor = period_and_skip_factor(frequency)
    return StringPlan(StringOutput(types), period, skip_factor, frequency_of(period, skip_factor))


def check_strings_fit(plan: StringPlan, support: Support, baudrate: int) -> None:
    """Whether a serial line carries these strings.

    Raises:
        ValueError: It does not; the message says which baud rate would do.
    """
    each = sum(LAYOUTS[it].length for it in plan.output.types)
    needed = round(each * (plan.frequency or 0))
    if needed > baudrate // BITS_PER_BYTE:
        raise ValueError(overload_message("strings", needed, baudrate, support))
