"""A whole terminal: keys as they are pressed, and lines, written where they have changed.

The only place that knows how a system does it.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from types import TracebackType

from xbus.cli.monitor.rows import ASCII, UNICODE, Glyphs, Span, Style, safe

__all__ = ["Keyboard", "Terminal", "glyphs_of", "is_there"]

#: What the terminal is told: another screen, without cursor and line wrap; and all of it back.
ENTER = "\x1b[?1049h\x1b[?25l\x1b[?7l\x1b[2J"
LEAVE = "\x1b[0m\x1b[?7h\x1b[?25h\x1b[?1049l"
#: How text looks, with colours and without.
LOOKS = {
    Style.PLAIN: ("", ""),
    Style.HEAD: ("1", "1"),
    Style.DIM: ("2", "2"),
    Style.BAR: ("7", "7"),
    Style.GOOD: ("32", ""),
    Style.WARN: ("33", "1"),
    Style.BAD: ("1;31", "1"),
    Style.PICTURE: ("33;44", ""),
    Style.ON_SKY: ("1;37;44", ""),
    Style.ON_GROUND: ("1;37;43", "7"),
}
#: Keys that send more than a character.
NAMES = {
    "\x1b[A": "up",
    "\x1b[B": "down",
    "\x1bOA": "up",
    "\x1bOB": "down",
    "\x1b[5~": "page up",
    "\x1b[6~": "page down",
    "\x1b": "escape",
    "\r": "enter",
    "\n": "enter",
    "\x7f": "backspace",
    "\b": "backspace",
}
#: Seconds in which the rest of such a key comes.
REST = 0.03


def is_there() -> bool:
    """Whether a person sits at both ends, before a terminal that has a screen."""
    is_terminal = all(it is not None and it.isatty() for it in (sys.stdin, sys.stdout))
    return is_terminal and os.environ.get("TERM") != "dumb"


def glyphs_of(encoding: str | None) -> Glyphs:
    """Characters that an encoding has."""
    try:
        "".join(UNICODE).encode(encoding or "ascii")
    except (LookupError, UnicodeEncodeError):
        return ASCII
    return UNICODE


class Terminal:
    """The terminal of this process, for the length of a ``with`` block; then it is as it was.

    Attributes:
        glyphs: Characters that it has.
    """

    def __init__(self) -> None:
        self.glyphs = glyphs_of(sys.stdout.encoding)
        self._coloured = not os.environ.get("NO_COLOR")
        self._drawn: list[str] = []
        self._size = (0, 0)
        self._keyboard = Keyboard()

    def __enter__(self) -> Terminal:
        self._keyboard.__enter__()
        try:
            self._write(ENTER)
        except BaseException:
            self._keyboard.__exit__()
            raise
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        try:
            with suppress(OSError):  # it may be gone
                self._write(LEAVE)
        finally:
            self._keyboard.__exit__()

    @property
    def size(self) -> tuple[int, int]:
        """Columns and lines, now."""
        size = os.get_terminal_size(sys.stdout.fileno())
        # One that does not know its size says 0.
        return size.columns or 80, size.lines or 24

    def keys(self, timeout: float) -> list[str]:
        """The keys that were pressed; waits for one, but no longer than so many seconds."""
        return self._keyboard.read(timeout)

    def show(self, lines: Sequence[Sequence[Span]]) -> None:
        """Shows the lines; only those that have changed are written."""
        told = [self._told(it) for it in lines]
        text = ""
        if self._size != self.size:
            self._size, self._drawn, text = self.size, [], "\x1b[2J"
        for at, line in enumerate(told):
            if at >= len(self._drawn) or self._drawn[at] != line:
                text += f"\x1b[{at + 1};1H{line}\x1b[K"
        self._drawn = told
        if text:
            self._write(text)

    def _told(self, line: Sequence[Span]) -> str:
        """A line as the terminal is told it, with nothing from elsewhere that it would obey."""
        told, look = "", ""
        for text, style in line:
            wanted = LOOKS[style][0 if self._coloured else 1]
            if wanted != look:
                told += f"\x1b[0;{wanted}m" if wanted else "\x1b[0m"
                look = wanted
            told += safe(text)
        return f"{told}\x1b[0m" if look else told

    def _write(self, text: str) -> None:
        sys.stdout.write(text)
        sys.stdout.flush()


def keys_in(text: str) -> list[str]:
    r"""The keys that somebody pressed to send this text.

    >>> keys_in("ab\x1b[A\x1b")
    ['a', 'b', 'up', 'escape']
    """
    keys = []
    while text:
        name = max((it for it in NAMES if text.startswith(it)), key=len, default=text[0])
        if name == "\x1b" and len(text) > 1:
            # A key that means nothing here: it is not to be taken for the letters that it is made of.
            end = next((at for at, it in enumerate(text[2:], 3) if it.isalpha() or it == "~"), 2)
            text = text[end:]
            continue
        keys.append(NAMES.get(name, name))
        text = text[len(name) :]
    return keys


if sys.platform == "win32":
    import ctypes
    import msvcrt

    #: The console of Windows obeys what terminals do only when it is asked to.
    PROCESSED, WRAPPED, OBEYING, OUTPUT = 1, 2, 4, -11
    WINDOWS_NAMES = {"H": "up", "P": "down", "I": "page up", "Q": "page down"}

    class Keyboard:
        """The keys of the console."""

        def __enter__(self) -> Keyboard:
            console = ctypes.windll.kernel32
            self._handle = console.GetStdHandle(OUTPUT)
            self._before = ctypes.c_ulong()
            console.GetConsoleMode(self._handle, ctypes.byref(self._before))
            console.SetConsoleMode(self._handle, PROCESSED | WRAPPED | OBEYING)
            return self

        def __exit__(self, *_: object) -> None:
            ctypes.windll.kernel32.SetConsoleMode(self._handle, self._before)

        def read(self, timeout: float) -> list[str]:
            """The keys that were pressed within so many seconds."""
            until = time.monotonic() + timeout
            while not msvcrt.kbhit() and time.monotonic() < until:
                time.sleep(0.01)
            keys = []
            while msvcrt.kbhit():
                key = msvcrt.getwch()
                if key in "\0\xe0":
                    keys.append(WINDOWS_NAMES.get(msvcrt.getwch(), ""))
                else:
                    keys += keys_in(key)
            return [it for it in keys if it]

else:
    import select
    import termios

    class Keyboard:
        """The keys of the terminal."""

        def __enter__(self) -> Keyboard:
            self._number = sys.stdin.fileno()
            self._before = termios.tcgetattr(self._number)
            mode = termios.tcgetattr(self._number)
            # Neither whole lines nor an echo; Ctrl-C stays a signal, Ctrl-Z would leave the screen as it is.
            mode[3] &= ~(termios.ICANON | termios.ECHO)
            mode[6][termios.VMIN], mode[6][termios.VTIME] = 1, 0
            mode[6][termios.VSUSP] = b"\0"
            termios.tcsetattr(self._number, termios.TCSANOW, mode)
            return self

        def __exit__(self, *_: object) -> None:
            with suppress(termios.error):
                termios.tcsetattr(self._number, termios.TCSANOW, self._before)

        def read(self, timeout: float) -> list[str]:
            """The keys that were pressed; waits for one, but no longer than so many seconds.

            Raises:
                EOFError: The terminal is gone.
            """
            if not self._has_more(timeout):
                return []
            text = self._text()
            if text.endswith("\x1b") and self._has_more(REST):
                text += self._text()
            return keys_in(text)

        def _has_more(self, timeout: float) -> bool:
            return bool(select.select([self._number], [], [], max(0.0, timeout))[0])

        def _text(self) -> str:
            try:
                data = os.read(self._number, 1024)
            except OSError as error:
                raise EOFError from error
            if not data:
                raise EOFError
            return data.decode(errors="ignore")
