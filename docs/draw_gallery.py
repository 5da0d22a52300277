"""Draws the pictures of docs/gallery.md: ``python docs/draw_gallery.py`` writes docs/gallery.

Needs the extra ``test``, a pseudo-terminal, and chromium on the PATH for the picture of the report.
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
import tempfile
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

DOCS = Path(__file__).resolve().parent
RECORDING = DOCS.parent / "tests" / "captures" / "field.mtb"
GALLERY = DOCS / "gallery"
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


def draw_terminals(folder: Path) -> None:
    xbus = [sys.executable, "-m", "xbus"]
    shutil.copy(RECORDING, folder)
    monitor = [*xbus, "monitor", RECORDING.name, "--speed", "5"]
    screen = terminal(monitor, folder, columns=100, lines=28, seconds=6)
    (GALLERY / "monitor.svg").write_text(svg(screen, "xbus monitor field.mtb"), "utf-8")
    screen = terminal([*xbus, "demo"], folder, columns=90, lines=50, seconds=60)
    (GALLERY / "demo.svg").write_text(svg(screen, "xbus demo"), "utf-8")


def draw_report(folder: Path) -> None:
    from xbus.report import write_report

    browser = shutil.which("chromium") or shutil.which("google-chrome")
    if browser is None:
        sys.exit("draw_gallery.py needs chromium for the picture of the report; install chromium")
    page = folder / "report.html"
    write_report(RECORDING, page)
    subprocess.run(  # noqa: S603 - our own page
        [
            browser,
            "--headless",
            "--no-sandbox",
            "--hide-scrollbars",
            "--virtual-time-budget=10000",
            "--window-size=1000,2900",
            f"--screenshot={GALLERY / 'report.png'}",
            page.as_uri(),
        ],
        check=True,
        capture_output=True,
    )


def draw_plots() -> None:
    from matplotlib.figure import Figure

    import xbus
    from xbus import SimulatedDevice

    log = xbus.read_log(RECORDING)
    figure = Figure(figsize=(9, 8), layout="constrained")
    axes = figure.subplots(4, sharex=True)
    log.plot(["acceleration", "magnetic_field", "lat_lon"], time="utc", ax=axes)
    figure.savefig(GALLERY / "plots.png", dpi=80)

    virtual = SimulatedDevice("MTi-630", trajectory="still", noise=1)
    outputs = {"packet_counter": None, "sample_time_fine": None, "acceleration_hr": 2000}
    with xbus.connect(virtual) as device, device.configure() as cfg:
        cfg.set_output_configuration(outputs, check_baudrate=False)
    virtual.advance(200)
    data = bytes(virtual.read())
    knock = xbus.encode_sample({"acceleration_hr": [0, 6, 9.8]})
    virtual.advance(100)
    log = xbus.read_log(data + knock + virtual.read())
    figure = Figure(figsize=(9, 3.2), layout="constrained")
    log["acceleration_hr"].plot(ax=figure.subplots())
    figure.savefig(GALLERY / "spike.png", dpi=80)


def main() -> None:
    GALLERY.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        draw_terminals(Path(folder))
        draw_report(Path(folder))
    draw_plots()


if __name__ == "__main__":
    main()
