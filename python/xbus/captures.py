"""CAN captures, which are no logs: how their files begin."""

from __future__ import annotations

import os
import re

from xbus import _core
from xbus.errors import XbusError
from xbus.files import is_url, local_name, open_file

__all__ = [
    "BINARY",
    "CAPTURE_SUFFIXES",
    "HEAD_SIZE",
    "CaptureError",
    "capture_format",
    "check_no_capture",
    "has_frame",
    "is_capture",
]

#: How the captures of each suffix begin: those of Vector, candump, PEAK, python-can and ASAM. The start of
#: BLF includes the size of its header.
STARTS = {
    ".asc": rb"(//[^\n]*\n\s*)*(date\s+\S+\s+\S+\s+\d|base\s+(hex|dec)\s)",
    ".blf": rb"LOGG.\0\0\0",
    ".log": rb"\(\d+\.\d+\)\s+\S+\s+[0-9A-Fa-f]+#",
    ".trc": rb";(\$(FILEVERSION|STARTTIME|COLUMNS)=|#{8})",
    ".csv": rb"timestamp,arbitration_id",
    ".mf4": rb"(MDF     |UnFinMF )",
}
#: The suffixes of captures. A file ``.log`` or ``.csv`` may also be something else.
CAPTURE_SUFFIXES = tuple(STARTS)
#: The suffixes of captures that are not text.
BINARY = (".blf", ".mf4")
#: Suffixes that only captures have.
OWN_SUFFIXES = (".asc", ".blf", ".trc", ".mf4", ".asc.gz", ".trc.gz")
#: Bytes at the start of a file that show what it is.
HEAD_SIZE = 4096


class CaptureError(XbusError, ValueError):
    """A CAN capture was given in place of a log.

    Attributes:
        name: Name of the file, or what the input is.
    """

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.name = name

    def __str__(self) -> str:
        return f"{self.name} is a CAN capture and no Xbus log; read it with xbus.read_can"


def capture_format(head: bytes) -> str:
    """Returns the suffix of a CAN capture by its first bytes; empty for other data.

    >>> capture_format(b"(1436509052.249713) can0 005#000186A0")
    '.log'
    """
    head = head[:HEAD_SIZE]
    text = head.lstrip()
    found = next((suffix for suffix, start in STARTS.items() if re.match(start, text)), "")
    # A log may begin with a line of text, but no text contains a frame.
    return "" if found and found not in BINARY and has_frame(head) else found


def check_no_capture(head: bytes, name: str) -> None:
    """Raises `CaptureError` for the first bytes of a capture, in which a log would have only damage."""
    if capture_format(head):
        raise CaptureError(name)


def has_frame(head: bytes) -> bool:
    """Returns whether there is an Xbus frame in the first bytes of a file."""
    found = _core.Scanner(len(head), 0).feed(head, True)
    return any(isinstance(item, _core.ScannedFrame) for item in found)


def is_capture(name: str) -> bool:
    """Returns whether a file is a CAN capture, by its first bytes, or else by its suffix.

    >>> is_capture("drive.blf"), is_capture("tests/captures/walk.mtb")
    (True, False)
    """
    is_named = name.lower().endswith(OWN_SUFFIXES)
    path = local_name(name)
    if is_url(name) or not os.path.isfile(path):  # noqa: PTH113 - a pipe can be read once
        return is_named
    try:
        file = open_file(path)
        try:
            head = file.read(HEAD_SIZE)
        finally:
            file.close()
    except (ImportError, OSError):
        return is_named  # reading it reports the error
    return bool(capture_format(head)) or (is_named and not has_frame(head))
