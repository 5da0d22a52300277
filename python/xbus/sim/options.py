"""Options of a virtual device as text: for ``xbus sim`` and for ``sim:PRODUCT?NAME=VALUE&...``."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from datetime import UTC, datetime
from typing import Any
from urllib.parse import parse_qsl

import numpy as np

from xbus.protocol.configuration import Firmware
from xbus.sim.device import SimulatedDevice
from xbus.sim.faults import Faults

__all__ = ["OPTIONS", "device_of", "parse_options"]

#: Years that UTC messages can have (section 5.3.7).
YEARS = range(1999, 2100)


def _whole(text: str) -> int:
    number = int(text)
    if number < 0:
        raise ValueError(text)
    return number


def _amount(text: str) -> float:
    number = float(text)
    if not 0 <= number < math.inf:
        raise ValueError(text)
    return number


def _device_id(text: str) -> int:
    number = int(text, 16)
    if not 0 <= number < 1 << 64:
        raise ValueError(text)
    return number


def _firmware(text: str) -> Firmware:
    numbers = [_whole(part) for part in text.split(".")]
    if len(numbers) != 3 or max(numbers) > 0xFF:
        raise ValueError(text)
    return Firmware(*numbers)


def _truth(text: str) -> bool:
    return {"true": True, "false": False}[text.lower()]


def _utc(text: str) -> np.datetime64:
    time = datetime.fromisoformat(text)
    if time.year not in YEARS:
        raise ValueError(text)
    return np.datetime64(time.astimezone(UTC).replace(tzinfo=None) if time.tzinfo else time, "ns")


#: How the text of each option is parsed, and what it should be. Apart from ``fault``, the names are those
#: of the arguments of `SimulatedDevice`.
OPTIONS: dict[str, tuple[Callable[[str], Any], str]] = {
    "baudrate": (_whole, "a number of bits per second"),
    "can": (str, "a CAN bus such as virtual:drive"),
    "device_id": (_device_id, "a hexadecimal number such as 8000A1B2"),
    "fault": (str, "a fault such as flip=1e-5"),
    "firmware": (_firmware, "MAJOR.MINOR.REVISION, such as 1.8.0"),
    "noise": (_amount, "a number, 0 or more"),
    "seed": (_whole, "a whole number, 0 or more"),
    "strict_outputs": (_truth, "true or false"),
    "time_to_fix": (_amount, "seconds, 0 or more"),
    "trajectory": (str, "the name of a trajectory"),
    "utc": (_utc, "a date and time from 1999 to 2099, such as 2026-11-28T12:00:00"),
}


def parse_options(pairs: Iterable[tuple[str, str]]) -> dict[str, Any]:
    """Returns options of a virtual device as arguments of `SimulatedDevice`.

    Args:
        pairs: Names from `OPTIONS` with values as text. ``fault`` may be repeated.

    Raises:
        ValueError: An unknown name, a name that is repeated, or a value that is not valid.

    >>> parse_options([("device_id", "80004001"), ("noise", "0.5")])
    {'device_id': 2147500033, 'noise': 0.5}
    >>> parse_options([("nosie", "1")])
    Traceback (most recent call last):
    ValueError: a virtual device has no option nosie; its options are baudrate, can, device_id, fault, \
firmware, noise, seed, strict_outputs, time_to_fix, trajectory, utc
    """
    found: dict[str, Any] = {}
    faults = []
    for name, text in pairs:
        if name not in OPTIONS:
            raise ValueError(
                f"a virtual device has no option {name}; its options are {', '.join(OPTIONS)}"
            )
        if name in found:
            raise ValueError(f"the option {name} is given twice")
        parse, meaning = OPTIONS[name]
        try:
            value = parse(text)
        except (KeyError, ValueError):
            raise ValueError(f"{name} must be {meaning}, not {text!r}") from None
        if name == "fault":
            faults.append(value)
        else:
            found[name] = value
    if faults:
        found["faults"] = Faults.parse(faults, found.get("seed", 0))
    return found


def device_of(name: str, **defaults: Any) -> SimulatedDevice:
    """Returns the virtual device that a port name describes.

    Args:
        name: ``sim:PRODUCT``, or ``sim:PRODUCT?NAME=VALUE&...`` with names from `OPTIONS`. As in any URL,
            ``%26`` is an ampersand and ``+`` a space.
        **defaults: Arguments of `SimulatedDevice` that the options replace.

    Raises:
        ValueError: No such product or option, or a value that is not valid.

    >>> device_of("sim:MTi-630?device_id=80001234&trajectory=still").identity.device_id
    2147488308
    """
    product, _, query = name.removeprefix("sim:").partition("?")
    options = parse_options(parse_qsl(query, keep_blank_values=True))
    return SimulatedDevice(product, **(defaults | options))
