"""The page of a report: one HTML file that needs no other, with tables that need no JavaScript."""

from __future__ import annotations

import numpy as np

from xbus._core import __version__
from xbus.describe.log_text import format_utc, log_rows
from xbus.formatting import format_count
from xbus.report import html
from xbus.report.blocks import Plot
from xbus.report.data import ReportData
from xbus.report.findings import Finding, findings
from xbus.report.sections import sections

__all__ = ["page"]


def page(title: str, data: ReportData, plotly: str) -> str:
    """Returns the HTML.

    Args:
        title: Title of the page.
        data: Content of the report.
        plotly: JavaScript of plotly.
    """
    with np.errstate(over="ignore", invalid="ignore"):  # as in `gather`
        content = sections(data)
        found = findings(data)
    blocks = [block for section in content for block in section.blocks]
    figures = [block.figure for block in blocks if isinstance(block, Plot)]
    created = f"Created by xbus {__version__}. This file is complete: it needs no other file and no network."
    body = [
        html.header(title, _verdict(data, found), found, _facts(data), content),
        html.main(content),
        html.footer(created),
    ]
    return html.document(title, body, figures, plotly)


def _verdict(data: ReportData, found: list[Finding]) -> tuple[str, str]:
    if bad := sum(finding.is_bad for finding in found):
        # The list below has both.
        notes = len(found) - bad
        and_notes = f" and {format_count(notes, 'note')}" if notes else ""
        return "bad", f"{format_count(bad, 'problem')}{and_notes} in this recording"
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
