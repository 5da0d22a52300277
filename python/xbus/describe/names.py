"""Names of files as printable text."""

from __future__ import annotations

import os

from xbus.formatting import printable

__all__ = ["file_label"]


def file_label(name: str) -> str:
    r"""Returns a printable file name: control characters, which break lines, are escaped.

    >>> file_label("walk\n1.mtb")
    'walk\\n1.mtb'
    """
    return printable(os.fsencode(name).decode("utf-8", "replace"))
