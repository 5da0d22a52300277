"""Counts, sizes, losses and other texts to print. Imports nothing, so that commands start fast."""

from __future__ import annotations

__all__ = [
    "describe_damage",
    "describe_losses",
    "device_name",
    "format_count",
    "format_size",
    "printable",
]


def format_count(number: int, noun: str, plural: str | None = None) -> str:
    """Returns a number and a noun, in the plural unless the number is one.

    Args:
        number: The number.
        noun: The noun in the singular.
        plural: Its plural; None if it ends with an additional s.

    >>> format_count(1, "gap"), format_count(1200, "sample")
    ('1 gap', '1,200 samples')
    """
    return f"{number:,} {noun if number == 1 else plural or noun + 's'}"


def format_size(number: int) -> str:
    """Returns a number of bytes in the largest unit that leaves one digit before the point.

    >>> format_size(999), format_size(2_400_000)
    ('999 bytes', '2.4 MB')
    """
    for unit, size in (("GB", 1_000_000_000), ("MB", 1_000_000), ("kB", 1_000)):
        if number >= size:
            return f"{number / size:.1f} {unit}"
    return f"{number} bytes"


def describe_losses(samples: int, gaps: int, *, has_counter: bool) -> str:
    """Returns what is known about lost samples.

    Args:
        samples: Number of lost samples.
        gaps: Number of places at which samples are missing.
        has_counter: Whether samples have a packet counter, without which losses are not detected.

    >>> describe_losses(3, 2, has_counter=True), describe_losses(0, 0, has_counter=False)
    ('3 samples lost in 2 gaps', 'no packet counter to detect losses')
    """
    if samples:
        return f"{format_count(samples, 'sample')} lost in {format_count(gaps, 'gap')}"
    return "no samples lost" if has_counter else "no packet counter to detect losses"


def describe_damage(length: int, places: int) -> str:
    """Returns how many bytes are damaged, and in how many places.

    >>> describe_damage(1816, 12), describe_damage(0, 0)
    ('1,816 bytes of damage in 12 places', 'no damage')
    """
    if not length:
        return "no damage"
    return f"{format_count(length, 'byte')} of damage in {format_count(places, 'place')}"


def device_name(number: int) -> str:
    """Returns a device identifier as printed on the device: 8 digits, 10 from the 600-series on."""
    return f"{number:010X}" if number >> 31 else f"{number:08X}"


def printable(text: str) -> str:
    r"""Returns text without characters that break lines or control a terminal: they are escaped.

    >>> printable("gone\x1b[2J")
    'gone\\x1b[2J'
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)
