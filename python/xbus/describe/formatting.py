"""How much, in words. Imports nothing: commands need it before they know what they will need."""

from __future__ import annotations

__all__ = ["format_count", "format_size"]


def format_count(number: int, thing: str) -> str:
    """So many of a thing."""
    return f"{number:,} {thing}" + ("" if number == 1 else "s")


def format_size(number: int) -> str:
    """So many bytes."""
    for unit, one in (("GB", 1_000_000_000), ("MB", 1_000_000), ("kB", 1_000)):
        if number >= one:
            return f"{number / one:.1f} {unit}"
    return f"{number} bytes"
