"""Pictures of terminals and pages, for the scripts that draw the pictures of the documentation.

Needs the extra ``test``, a pseudo-terminal, and chromium on the PATH for pictures of pages.
"""

from __future__ import annotations

import fcntl
import os
import pty
import re
import shutil
import struct
import subprocess
import sys
import termios
import threading
from io import StringIO
from itertools import groupby
from pathlib import Path

import pyte
from rich.console import Console
from rich.style import Style
from rich.terminal_theme import DIMMED_MONOKAI
from rich.text import Text

#: Colors that pyte and rich name differently.
COLORS = {"brown": "yellow", "brightbrown": "bright_yellow"}


def color(name: str) -> str | None:
    """Returns the color of pyte as rich spells it; None for the default."""
    if name == "default":
        return None
    if re.fullmatch("[0-9a-f]{6}", name):
        return f"#{name}"
    return COLORS.get(name, re.sub("^bright(?!_)", "bright_", name))


def style_of(char: pyte.screens.Char) -> Style:
    foreground, background = color(char.fg), color(char.bg)
    return Style(color=foreground, bgcolor=background, bold=char.bold, reverse=char.reverse)


def terminal(
    command: list[str], folder: Path, *, columns: int, lines: int, seconds: float
) -> pyte.Screen:
    """Returns the screen of a terminal after a command has run in it for some seconds, or to its end."""
    screen = pyte.Screen(columns, lines)
    stream = pyte.ByteStream(screen)
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("4H", lines, columns, 0, 0))
    process = subprocess.Popen(  # noqa: S603 - our own commands
        command,
        stdin=theirs,
        stdout=theirs,
        stderr=theirs,
        cwd=folder,
        env=os.environ | {"TERM": "xterm-256color", "COLORTERM": "truecolor"},
    )
    os.close(theirs)
    last_screen = threading.Timer(seconds, process.kill)
    last_screen.start()
    try:
        while data := os.read(ours, 65536):
            stream.feed(data)
    except OSError:  # Linux reports the closed side of a pseudo-terminal as an error.
        pass
    finally:
        last_screen.cancel()
        process.wait()
        os.close(ours)
    return screen


def svg(screen: pyte.Screen, title: str) -> str:
    """Returns the screen as an SVG picture of a terminal window."""
    rows = []
    for number in range(screen.lines):
        row = Text()
        line = [screen.buffer[number][column] for column in range(screen.columns)]
        for style, chars in groupby(line, style_of):
            row.append("".join(char.data for char in chars), style)
        row.rstrip()
        rows.append(row)
    while rows and not rows[-1].plain:
        rows.pop()
    console = Console(width=screen.columns, record=True, file=StringIO(), color_system="truecolor")
    console.print(Text("\n").join(rows), no_wrap=True, crop=False)
    return console.export_svg(title=title, theme=DIMMED_MONOKAI, unique_id="gallery")


def chromium() -> str:
    """Returns the path of the browser."""
    browser = shutil.which("chromium") or shutil.which("google-chrome")
    if browser is None:
        sys.exit("a picture of a page needs chromium on the PATH; install chromium")
    return browser


def screenshot(page: Path, picture: Path, *, width: int, height: int) -> None:
    """Writes a picture of a page as a browser shows it."""
    subprocess.run(  # noqa: S603 - our own page
        [
            chromium(),
            "--headless",
            "--no-sandbox",
            "--hide-scrollbars",
            "--virtual-time-budget=10000",
            f"--window-size={width},{height}",
            f"--screenshot={picture}",
            page.as_uri(),
        ],
        check=True,
        capture_output=True,
    )
