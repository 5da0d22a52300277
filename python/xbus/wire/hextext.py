"""Hex text as people paste it, from MT Manager, issue trackers and terminals."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator

from xbus.protocol.tables import PREAMBLE
from xbus.wire.codec import encode_frame

__all__ = ["frame_from_hex", "from_hex"]

#: Colours of a terminal.
ESCAPES = re.compile(r"\x1b\[[0-9;]*[A-Za-z]")
#: A line of xxd: offset, groups of digits, and after two spaces the characters.
XXD = re.compile(r"\s*([0-9A-Fa-f]{4,16}):\s((?:\s?[0-9A-Fa-f]{2,})+)(?:\s{2}.*)?")
#: A line of hexdump -C.
HEXDUMP = re.compile(r"\s*([0-9A-Fa-f]{7,16})((?:\s+[0-9A-Fa-f]{2})+)\s+\|.*\|\s*")
#: A line of Wireshark and other dumps: offset, two spaces, bytes, and after three spaces perhaps characters.
OFFSET = re.compile(
    r"\s*([0-9A-Fa-f]{4,16})\s{2,}((?:[0-9A-Fa-f]{2}\s{1,2})*[0-9A-Fa-f]{2})(?:\s{3}.*)?\s*"
)
PYTHON_BYTES = re.compile(r"""\bb('(?:\\.|[^'\\])*'|"(?:\\.|[^"\\])*")""")
COMMENT = re.compile(r"//.*|#.*|/\*.*?\*/")
TIME = re.compile(r"[0-2]?[0-9]:[0-5][0-9]:[0-5][0-9]([.,][0-9]+)?")
#: What can stand between bytes.
SEPARATORS = re.compile(r"[\s,;{}()\[\]\"'`|]+")
#: Dashes need five bytes, the shortest frame: fewer can be a date.
BYTES = re.compile(r"[0-9A-Fa-f]+(?::[0-9A-Fa-f]{2})*|[0-9A-Fa-f]{2}(?:-[0-9A-Fa-f]{2}){4,}")


def from_hex(text: str) -> bytes:
    r"""Returns the bytes in hex text.

    Digits can be separated or not, and have prefixes (``0xFA``, ``\xFA``). Labels and times before the bytes
    of a line, comments, C arrays, bytes of Python, and the output of ``xxd`` and ``hexdump -C`` are
    understood.

    Raises:
        ValueError: Something after the first byte of a line is not hex, or there is no byte.

    >>> import xbus
    >>> xbus.from_hex("[12:00:01.250] Sent: FA FF 30 00 D1  // GoToConfig").hex()
    'faff3000d1'
    """
    data = b""
    text = ESCAPES.sub(
        "", text.removeprefix("\ufeff")
    )  # the mark at the start of a file of Windows
    for number, line in enumerate(text.splitlines(), 1):
        try:
            data += _line(line, len(data))
        except ValueError as error:
            raise ValueError(f"line {number} of the hex text: {error}") from None
    if not data:
        raise ValueError("no byte in the hex text; write bytes such as FA FF 30 00 D1")
    return data


def frame_from_hex(text: str, *, bid: int = 0xFF) -> bytes:
    """Returns the frame to send that a text in hex is, or whose MID and payload it has.

    Args:
        text: A complete frame, which begins with FA, or a MID and its payload.
        bid: Bus identifier of a frame that is made of a MID.

    Raises:
        ValueError: The text is not hex, or has no byte.

    Examples:
        >>> frame_from_hex("30").hex(" ").upper()
        'FA FF 30 00 D1'
    """
    try:
        data = bytes.fromhex(text.lower().replace("0x", "").replace(",", " "))
    except ValueError:
        data = b""
    if not data:
        raise ValueError(f"{text!r} is not hex; write bytes, such as FA FF 30 00 D1")
    return data if data[0] == PREAMBLE else encode_frame(data[0], data[1:], bid=bid)


def _line(line: str, offset: int) -> bytes:
    for dump in (HEXDUMP, XXD, OFFSET):
        if (found := dump.fullmatch(line)) and int(found[1], 16) == offset:
            return bytes.fromhex(found[2])
    if literals := PYTHON_BYTES.findall(line):
        return b"".join(_literal(literal) for literal in literals)
    line = line.strip()
    if len(line) in (7, 8) and offset and _number(line) == offset:
        return b""  # the last line of hexdump: its size
    if line == "*":
        raise ValueError("hexdump left out equal lines; use hexdump -v")
    return b"".join(_bytes(_without_label(list(_tokens(line)))))


def _literal(literal: str) -> bytes:
    try:
        value = ast.literal_eval("b" + literal)
    except SyntaxError:
        raise ValueError(f"b{literal} is not bytes of Python") from None
    assert isinstance(value, bytes)  # noqa: S101 - it begins with b
    return value


def _number(text: str) -> int | None:
    try:
        return int(text, 16)
    except ValueError:
        return None


def _tokens(line: str) -> Iterator[str]:
    text = COMMENT.sub(" ", line).replace("\\x", " 0x")
    for token in SEPARATORS.split(text):
        if token:
            yield token


def _digits(token: str) -> str:
    token = token.lower()
    return token.removeprefix("0x") if token.startswith("0x") else token.removesuffix("h")


def _without_label(tokens: list[str]) -> list[str]:
    """Returns the tokens from the first byte on."""
    for at, token in enumerate(tokens):
        is_time = TIME.fullmatch(token) is not None and at + 1 < len(tokens)
        if BYTES.fullmatch(_digits(token)) and not is_time and not _is_declaration(tokens, at):
            return tokens[at:]
    return []


def _is_declaration(tokens: list[str], at: int) -> bool:
    """Returns whether a token belongs to ``uint8_t data[5] =``."""
    return "=" in tokens[at:]


def _bytes(tokens: list[str]) -> Iterator[bytes]:
    for token in tokens:
        digits = _digits(token).replace(":", "")
        if not BYTES.fullmatch(digits):
            raise ValueError(f"{token!r} is not hex")
        digits = digits.replace("-", "")
        if len(digits) == 1:
            digits = "0" + digits  # as Arduino prints it
        if len(digits) % 2:
            raise ValueError(f"{token!r} has an odd number of digits")
        yield bytes.fromhex(digits)
