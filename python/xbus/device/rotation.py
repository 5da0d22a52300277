"""Sizes and times at which a recording continues in the next file, as text."""

from __future__ import annotations

import math
import re
from typing import Any

__all__ = ["BYTES", "parse_rotation"]

#: Units of sizes and times.
BYTES = {"kb": 10**3, "mb": 10**6, "gb": 10**9, "tb": 10**12}
SECONDS = {"s": 1, "min": 60, "h": 3600}


def parse_rotation(text: str) -> dict[str, Any]:
    """Returns the arguments of `Device.record` that rotate files.

    Raises:
        ValueError: The text is neither a size nor a time.

    >>> parse_rotation("100MB"), parse_rotation("30min")
    ({'rotate_bytes': 100000000}, {'rotate_seconds': 1800.0})
    """
    if found := re.fullmatch(r"([0-9]+(?:\.[0-9]+)?) *([a-z]+)", text.lower()):
        number, unit = float(found[1]), found[2]
        if unit in BYTES and 0 < (size := number * BYTES[unit]) < math.inf:
            return {"rotate_bytes": math.ceil(size)}
        if unit in SECONDS and 0 < (seconds := number * SECONDS[unit]) < math.inf:
            return {"rotate_seconds": seconds}
    raise ValueError(f"{text!r} is neither a size (100MB, 2GB) nor a time (90s, 30min, 1h)")
