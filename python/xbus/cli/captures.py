"""Which inputs are CAN captures."""

from __future__ import annotations

import os

from xbus.files import is_url

__all__ = ["is_capture"]

#: Suffixes that only captures have.
SUFFIXES = (".asc", ".blf", ".trc", ".mf4", ".asc.gz", ".trc.gz")
#: The first bytes of captures whose suffixes other files have too: of candump and of python-can.
STARTS = {".log": b"(", ".csv": b"timestamp,arbitration_id"}


def is_capture(name: str) -> bool:
    """Returns whether a file is a CAN capture, by its suffix and, for .log and .csv, its first bytes.

    >>> is_capture("drive.blf"), is_capture("walk.mtb")
    (True, False)
    """
    lower = name.lower()
    if is_url(name) or lower.endswith(SUFFIXES):
        return lower.endswith(SUFFIXES)
    start = STARTS.get(os.path.splitext(lower)[1])  # noqa: PTH122 - pathlib is slow to import
    if start is None or not os.path.isfile(name):  # noqa: PTH113 - a pipe can be read once
        return False
    try:
        with open(name, "rb") as file:  # noqa: PTH123
            return file.read(len(start)) == start
    except OSError:
        return False  # reading it reports the error
