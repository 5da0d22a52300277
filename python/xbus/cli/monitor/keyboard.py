"""Keys, one by one as they are pressed. Only this module of the monitor depends on the operating system."""

from __future__ import annotations

import os
import sys
import time
from contextlib import suppress

__all__ = ["Keyboard", "has_terminal", "parse_keys"]

#: Keys that send more than one character, or one that is not printable.
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
#: Time to wait for the rest of an escape sequence, in seconds.
ESCAPE_TIMEOUT = 0.03


def has_terminal() -> bool:
    """Returns whether stdin and stdout are a terminal that can show a full screen."""
    is_terminal = all(stream is not None and stream.isatty() for stream in (sys.stdin, sys.stdout))
    return is_terminal and os.environ.get("TERM") != "dumb"


def parse_keys(text: str) -> list[str]:
    r"""Returns the keys in what a terminal sent; keys without a name here are dropped.

    >>> parse_keys("ab\x1b[A\x1b")
    ['a', 'b', 'up', 'escape']
    """
    keys = []
    while text:
        sequence = max(filter(text.startswith, NAMES), key=len, default=text[0])
        if sequence == "\x1b" and len(text) > 1:
            # An unknown escape sequence: its letters are not keys.
            end = next(
                (at for at, char in enumerate(text[2:], 3) if char.isalpha() or char == "~"), 2
            )
            text = text[end:]
            continue
        keys.append(NAMES.get(sequence, sequence))
        text = text[len(sequence) :]
    return keys


if sys.platform == "win32":
    import ctypes
    import msvcrt

    #: Console mode flags, and the handle of the console's output.
    PROCESSED, WRAPPED, VIRTUAL_TERMINAL, OUTPUT = 1, 2, 4, -11
    WINDOWS_NAMES = {"H": "up", "P": "down", "I": "page up", "Q": "page down"}

    class Keyboard:
        """Reads the keys of the console for the length of a ``with`` block."""

        def __enter__(self) -> Keyboard:
            # rich draws a full screen only on a console that interprets escape sequences.
            console = ctypes.windll.kernel32
            self._handle = console.GetStdHandle(OUTPUT)
            self._before = ctypes.c_ulong()
            console.GetConsoleMode(self._handle, ctypes.byref(self._before))
            console.SetConsoleMode(self._handle, PROCESSED | WRAPPED | VIRTUAL_TERMINAL)
            return self

        def __exit__(self, *_: object) -> None:
            ctypes.windll.kernel32.SetConsoleMode(self._handle, self._before)

        def read(self, timeout: float) -> list[str]:
            """Returns the pressed keys; waits for one for at most ``timeout`` seconds."""
            until = time.monotonic() + timeout
            while not msvcrt.kbhit() and time.monotonic() < until:
                time.sleep(0.01)
            keys = []
            while msvcrt.kbhit():
                key = msvcrt.getwch()
                if key in "\0\xe0":
                    keys.append(WINDOWS_NAMES.get(msvcrt.getwch(), ""))
                else:
                    keys += parse_keys(key)
            return [key for key in keys if key]

else:
    import select
    import termios

    class Keyboard:
        """Reads the keys of the terminal for the length of a ``with`` block, without echo."""

        def __enter__(self) -> Keyboard:
            self._number = sys.stdin.fileno()
            self._before = termios.tcgetattr(self._number)
            mode = termios.tcgetattr(self._number)
            # No line buffering, no echo. Ctrl-C stays a signal; Ctrl-Z would leave the screen in disorder.
            mode[3] &= ~(termios.ICANON | termios.ECHO)
            mode[6][termios.VMIN], mode[6][termios.VTIME] = 1, 0
            mode[6][termios.VSUSP] = b"\0"
            termios.tcsetattr(self._number, termios.TCSANOW, mode)
            return self

        def __exit__(self, *_: object) -> None:
            with suppress(termios.error):
                termios.tcsetattr(self._number, termios.TCSANOW, self._before)

        def read(self, timeout: float) -> list[str]:
            """Returns the pressed keys; waits for one for at most ``timeout`` seconds.

            Raises:
                EOFError: The terminal is gone.
            """
            if not self._is_ready(timeout):
                return []
            text = self._read_text()
            if text.endswith("\x1b") and self._is_ready(ESCAPE_TIMEOUT):
                text += self._read_text()
            return parse_keys(text)

        def _is_ready(self, timeout: float) -> bool:
            return bool(select.select([self._number], [], [], max(0.0, timeout))[0])

        def _read_text(self) -> str:
            try:
                data = os.read(self._number, 1024)
            except OSError as error:
                raise EOFError from error
            if not data:
                raise EOFError
            return data.decode(errors="ignore")
