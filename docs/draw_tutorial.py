"""Draws the pictures of docs/tutorial.md: ``python docs/draw_tutorial.py`` writes docs/tutorial.

The commands and the plot are those of the page.
"""

from __future__ import annotations

import doctest
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import matplotlib as mpl
from pictures import screenshot, svg, terminal

DOCS = Path(__file__).resolve().parent
PAGE = DOCS / "tutorial.md"
PICTURES = DOCS / "tutorial"

sys.path.insert(0, str(DOCS.parent / "tests"))
from doc_examples import page_commands  # noqa: E402


def main() -> None:
    PICTURES.mkdir(exist_ok=True)
    mpl.use("agg")
    mpl.rcParams["figure.dpi"] = 80
    programs = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        os.chdir(folder)
        for command in page_commands(PAGE):
            subprocess.run(  # noqa: S602 - the commands of our page
                command, shell=True, check=True, env=os.environ | {"PATH": programs}
            )
        doctest.testfile(str(PAGE), module_relative=False, raise_on_error=True)
        (folder / "first.png").rename(PICTURES / "plot.png")
        screenshot(folder / "first.html", PICTURES / "report.png", width=1000, height=1050)
        monitor = [sys.executable, "-m", "xbus", "monitor", "first.mtb", "--speed", "20"]
        screen = terminal(monitor, folder, columns=100, lines=24, seconds=6)
        (PICTURES / "monitor.svg").write_text(svg(screen, "xbus monitor first.mtb"), "utf-8")


if __name__ == "__main__":
    main()
