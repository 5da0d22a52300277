"""Sizes and times at which a recording continues in the next file."""

from __future__ import annotations

import math
import re
from typing import Any

import click

__all__ = ["parse_rotation", "parse_size"]

#: Units of sizes and times.
BYTES = {"kb": 10**3, "mb": 10**6, "gb": 10**9, "tb": 10**12}
SECONDS = {"s": 1, "min": 60, "h": 3600}


def parse_rotation(value: str) -> dict[str, Any]:
    """Returns the arguments of `Device.record` that rotate files.

    Raises:
        BadParameter: The text is neither a size nor a time.
    """
    if found := re.fullmatch(r"([0-9]+(?:\.[0-9]+)?) *([a-z]+)", value.lower()):
        number, unit = float(found[1]), found[2]
        if unit in BYTES and number > 0:
            return {"rotate_bytes": math.ceil(number * BYTES[unit])}
        if unit in SECONDS and number > 0:
            return {"rotate_seconds": number * SECONDS[unit]}
    raise click.BadParameter(
        f"{value!r} is neither a size (100MB, 2GB) nor a time (90s, 30min, 1h)"
    )


def parse_size(value: str) -> int:
    """Returns a size in bytes. A number without a unit is one of bytes.

    Raises:
        BadParameter: The text is no size.
    """
    found = re.fullmatch(r"([0-9]+(?:\.[0-9]+)?) *([kmgt]b)?", value.lower())
    if found is None:
        raise click.BadParameter(f"{value!r} is no size, such as 500MB or 2GB")
    return math.ceil(float(found[1]) * BYTES.get(found[2], 1))
