"""The page of a report: one HTML file that needs no other, with tables that need no JavaScript."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from xbus._core import __version__
from xbus.describe.log_text import format_utc, log_rows
from xbus.formatting import format_count
from xbus.report import html
from xbus.report.base_map import SERVER
from xbus.report.blocks import figures_of
from xbus.report.data import ReportData
from xbus.report.findings import Finding, findings
from xbus.report.sections import sections
from xbus.report.side_by_side import side_by_side

__all__ = ["page"]


def page(title: str, reports: Sequence[tuple[str, ReportData]], plotly: str) -> str:
    """Returns the HTML.

    Args:
        title: Title of the page.
        reports: Name of each recording, and content of its report; at least one.
        plotly: JavaScript of plotly.
    """
    with np.errstate(over="ignore", invalid="ignore"):  # as in `gather`
        contents = [sections(data) for _, data in reports]
        summaries = [
            html.Summary(name, _verdict(data, found), found, _facts(data))
            for name, data in reports
            for found in [findings(data)]
        ]
    for number, content in enumerate(contents):
        for figure in figures_of(block for section in content for block in section.blocks):
            figure["recording"] = number
    whole = (
        contents[0] if len(contents) == 1 else side_by_side([name for name, _ in reports], contents)
    )
    whole = [section for section in whole if section.blocks]
    figures = list(figures_of(block for section in whole for block in section.blocks))
    server = SERVER if any(figure["name"] == "map" for figure in figures) else ""
    needs = "network, except for the map" if server else "network"
    created = f"Created by xbus {__version__}. This file is complete: it needs no other file and no {needs}."
    body = [html.header(title, summaries, whole), html.main(whole), html.footer(created)]
    return html.document(title, body, figures, plotly, server)


def _verdict(data: ReportData, found: list[Finding]) -> tuple[str, str]:
    if bad := sum(finding.is_bad for finding in found):
        # The list below has both.
        notes = len(found) - bad
        and_notes = f" and {format_count(notes, 'note')}" if notes else ""
        return "bad", f"{format_count(bad, 'problem')}{and_notes} in this recording"
    if data.summary.capture_findings is not None:
        if found:
            return "note", f"{format_count(len(found), 'note')} about this recording"
        return ("good", "No sample lost") if data.has_counter else ("note", "No problem found")
    if data.has_counter:
        return "good", "No sample lost, no damage, no errors"
    return "note", "No damage, no errors"


def _facts(data: ReportData) -> list[tuple[str, str]]:
    """Returns the facts about the log as names and texts."""
    rows = list(log_rows(data.summary))
    if data.utc is not None:
        names = [name for name, _ in rows]
        at = names.index("UTC") + 1 if "UTC" in names else len(rows)
        rows.insert(at, ("0 s is", f"{format_utc(data.utc)} UTC"))
    return rows
