"""What a person enters as text."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

__all__ = ["problem_of"]


def problem_of(read: Callable[[str], Any], text: str | None) -> str | None:
    """Returns why a text has no value; None if it has one, or is empty.

    Args:
        read: Returns the value, or raises ValueError.
        text: What was entered.

    >>> problem_of(float, "1.5"), problem_of(float, " "), problem_of(float, "fast")
    (None, None, "could not convert string to float: 'fast'")
    """
    try:
        if text and text.strip():
            read(text.strip())
    except ValueError as error:
        return str(error)
    return None
