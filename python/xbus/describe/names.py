"""Names of files as printable text."""

from __future__ import annotations

import os

__all__ = ["file_label"]


def file_label(name: str) -> str:
    r"""Returns a printable file name: control characters, which break lines, are escaped.

    >>> file_label("walk\n1.mtb")
    'walk\\n1.mtb'
    """
    text = os.fsencode(name).decode("utf-8", "replace")
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)
