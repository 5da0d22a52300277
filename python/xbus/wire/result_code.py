"""Result codes of Error and Warning messages."""

from __future__ import annotations

from typing import NamedTuple

from xbus.formatting import printable
from xbus.protocol.tables import RESULT_CODES
from xbus.wire.message import Message

__all__ = ["ResultCode", "read_result_code"]


class ResultCode(NamedTuple):
    """The result code of an Error or Warning message, and its meaning.

    Attributes:
        code: The number; None if the payload is too short for one.
        text: Meaning of the number, and text that the device adds.
        detail: The bytes after the code of an error, in hex; None without any.
    """

    code: int | None
    text: str
    detail: str | None

    def __str__(self) -> str:
        code = "" if self.code is None else f"{self.code}: "
        return f"{code}{self.text}" + (f" (detail {self.detail})" if self.detail else "")


def read_result_code(message: Message) -> ResultCode:
    """Returns the result code of an Error or Warning message."""
    wide = 4 if message.name == "Warning" else 1
    if len(message.payload) < wide:
        return ResultCode(None, "without a code", None)
    code, rest = int.from_bytes(message.payload[:wide], "big"), message.payload[wide:]
    text = RESULT_CODES.get(code, "a code that xbus does not know")
    if message.name == "Warning":
        words = printable(rest.decode("ascii", "backslashreplace").strip("\0 \r\n"))
        return ResultCode(code, f"{text} ({words})" if words else text, None)
    return ResultCode(code, text, rest.hex(" ").upper() or None)
