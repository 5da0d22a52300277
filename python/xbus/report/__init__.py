"""Reports: a recording on one HTML page that needs no other file, no network and no xbus."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence

import numpy as np

from xbus.export.replacing import replacing
from xbus.extras import require
from xbus.log.legacy import Legacy
from xbus.log.log import Log
from xbus.log.read import iter_log
from xbus.log.source import Source
from xbus.protocol.values import StringType
from xbus.report.data import Options, ReportData
from xbus.report.field_quality import FieldQuality, Quality, magnetic_field_quality
from xbus.report.page import page

__all__ = [
    "BLOCK",
    "FieldQuality",
    "Options",
    "Quality",
    "gather",
    "gather_parts",
    "magnetic_field_quality",
    "plotly_js",
    "write_page",
    "write_report",
]

#: Bytes of input in memory at a time.
BLOCK = 4 << 20
#: A report without anything on request.
NOTHING_MORE = Options()


def write_report(
    source: Source,
    path: str | os.PathLike[str],
    *,
    title: str | None = None,
    bid: int | None = None,
    rate: float | None = None,
    strings: Iterable[StringType | str] = (),
    legacy: Legacy | None = None,
    spectrum: bool = False,
    spectrogram: bool = False,
    base_map: bool = False,
) -> None:
    """Writes a report about a log: its device, losses, plots, track, status and sensor noise.

    The log is read in parts and need not fit into memory; the size of the page is limited.

    Args:
        source: As in `xbus.read_log`.
        path: The HTML file. It appears complete or not at all.
        title: Title of the page. Default: the name of the file, or "recording" if there is none.
        bid: As in `xbus.read_log`.
        rate: As in `xbus.read_log`.
        strings: As in `xbus.read_log`.
        legacy: As in `xbus.read_log`.
        spectrum: Whether the page has the spectrum of acceleration and rate of turn.
        spectrogram: Whether it has their spectrum over time.
        base_map: Whether it has a map below the track. A browser loads the map from basemaps.cartocdn.com;
            without one, the page requests nothing.

    Raises:
        ImportError: The extra ``report`` is not installed.
        MissingDeviceError: The log has no samples of the device ``bid``.
        OSError: The log cannot be read, or the page cannot be written.

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
    options = Options(spectrum, spectrogram, base_map)
    data = gather(source, bid=bid, rate=rate, strings=strings, legacy=legacy, options=options)
    write_page([(title, data)], path, title=title, plotly=plotly)


def plotly_js() -> str:
    """Returns the JavaScript of plotly.

    Raises:
        ImportError: The extra ``report`` is not installed.
    """
    require("plotly", "report", "to write a report")
    from plotly.offline import get_plotlyjs

    script: str = get_plotlyjs()
    return script


def gather(
    source: Source,
    *,
    bid: int | None = None,
    rate: float | None = None,
    strings: Iterable[StringType | str] = (),
    legacy: Legacy | None = None,
    options: Options = NOTHING_MORE,
) -> ReportData:
    """Reads a log and returns the content of its report.

    Args:
        source: As in `xbus.read_log`.
        bid: As in `xbus.read_log`.
        rate: As in `xbus.read_log`.
        strings: As in `xbus.read_log`.
        legacy: As in `xbus.read_log`.
        options: What the report has on request.
    """
    parts = iter_log(source, block_bytes=BLOCK, bid=bid, rate=rate, strings=strings, legacy=legacy)
    return gather_parts(parts, options)


def gather_parts(parts: Iterable[Log], options: Options = NOTHING_MORE) -> ReportData:
    """Returns the content of the report about a log in parts."""
    # Numbers in a log can have any size; they are shown as inf if they overflow.
    with np.errstate(over="ignore", invalid="ignore"):
        return ReportData(parts, options)


def write_page(
    reports: Sequence[tuple[str, ReportData]],
    path: str | os.PathLike[str],
    *,
    title: str,
    plotly: str,
) -> None:
    """Writes a report.

    Args:
        reports: Name of each recording, and content of its report; several stand side by side.
        path: The HTML file. It appears complete or not at all.
        title: Title of the page.
        plotly: JavaScript of plotly.
    """
    text = page(title, reports, plotly)
    with replacing(path) as out:
        out.write(text.encode("utf-8", "backslashreplace"))
