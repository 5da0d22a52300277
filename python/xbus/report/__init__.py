"""A recording on one page: `write_report` makes HTML that needs nothing else, neither network nor xbus."""

from __future__ import annotations

import os
from collections.abc import Iterable

import numpy as np

from xbus.extras import require
from xbus.log.export import replacing
from xbus.log.read import iter_log
from xbus.log.source import Source
from xbus.protocol.values import StringType
from xbus.report.gather import Gathered
from xbus.report.page import page

__all__ = ["gather", "plotly_js", "write_page", "write_report"]

#: Bytes of input that are in memory at a time.
BLOCK = 16 << 20


def write_report(
    source: Source,
    path: str | os.PathLike[str],
    *,
    title: str | None = None,
    strings: Iterable[StringType | str] = (),
) -> None:
    """Writes a page about a log: what it is of, what is missing, plots, track, status, noise.

    The log is read in parts and need not fit into memory; the page does not grow with its length.

    Args:
        source: As in `xbus.read_log`.
        path: The HTML file, which appears whole or not at all.
        title: What stands above it; if None, the name of a file, else "recording".
        strings: As in `xbus.read_log`.

    Raises:
        ImportError: The extra ``report`` is not installed.
        OSError: The log cannot be read, or the page not be written.

    >>> import tempfile
    >>> from pathlib import Path
    >>> from xbus.report import write_report
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_report("tests/captures/walk.mtb", f"{folder}/walk.html")
    ...     Path(folder, "walk.html").read_text("utf-8")[:15]
    '<!doctype html>'
    """
    plotly = plotly_js()
    if title is None:
        title = "recording"
        if isinstance(source, str | os.PathLike):
            title = os.path.basename(os.fspath(source))  # noqa: PTH119 - pathlib is slow to import
    write_page(gather(source, strings), path, title=title, plotly=plotly)


def plotly_js() -> str:
    """The JavaScript of plotly.

    Raises:
        ImportError: The extra ``report`` is not installed.
    """
    require("plotly", "report", "to write a report")
    from plotly.offline import get_plotlyjs

    script: str = get_plotlyjs()
    return script


def gather(source: Source, strings: Iterable[StringType | str] = ()) -> Gathered:
    """Reads a log for a report."""
    # A log may hold any number; what gets too large is shown as inf.
    with np.errstate(over="ignore", invalid="ignore"):
        return Gathered(iter_log(source, block_bytes=BLOCK, strings=strings))


def write_page(
    gathered: Gathered, path: str | os.PathLike[str], *, title: str, plotly: str
) -> None:
    """Writes what was read as a page."""
    text = page(title, gathered, plotly)
    with replacing(path) as out:
        out.write(text.encode("utf-8", "backslashreplace"))
