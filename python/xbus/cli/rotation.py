"""Sizes and times at which a recording continues in the next file."""

from __future__ import annotations

import math
import re
from typing import Any

import click

__all__ = ["parse_size", "rotation_limits"]


def rotation_limits(value: str) -> dict[str, Any]:
    """Returns the value of an option such as ``--rotate`` as the arguments of `Device.record`.

    Raises:
        BadParameter: The text is neither a size nor a time.
    """
    from xbus.device.rotation import parse_rotation

    try:
        return parse_rotation(value)
    except ValueError as error:
        raise click.BadParameter(str(error)) from None


def parse_size(value: str) -> int:
    """Returns a size in bytes. A number without a unit is one of bytes.

    Raises:
        BadParameter: The text is no size.
    """
    from xbus.device.rotation import BYTES

    found = re.fullmatch(r"([0-9]+(?:\.[0-9]+)?) *([kmgt]b)?", value.lower())
    if found is None:
        raise click.BadParameter(f"{value!r} is no size, such as 500MB or 2GB")
    return math.ceil(float(found[1]) * BYTES.get(found[2], 1))
