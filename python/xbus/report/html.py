"""All HTML of a report. Every text is escaped here and nowhere else."""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Iterable, Sequence
from html import escape
from importlib import resources
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from xbus.formatting import printable
from xbus.report.blocks import Block, Columns, Heading, Paragraph, Plot, Section, Table
from xbus.report.findings import Finding

__all__ = ["Summary", "document", "footer", "header", "main"]


def document(title: str, body: Iterable[str], figures: Any, plotly: str, server: str = "") -> str:
    """Returns the page around a body.

    Args:
        title: Title of the page.
        body: HTML of its parts.
        figures: Figures for the plots in the body, in the same order.
        plotly: JavaScript of plotly.
        server: The only server whose pictures the page may show; none if it is empty.
    """
    scripts = [plotly, _resource("page.js")]
    # The page fetches nothing and runs no other script, whatever a file name or a device contains.
    hashes = " ".join(f"'sha256-{_digest(script)}'" for script in scripts)
    policy = (
        f"default-src 'none'; script-src {hashes}; style-src 'unsafe-inline'; img-src data: blob:"
    )
    if server:
        policy += f" {server}"
    # "<" could end the script element around the JSON.
    data = json.dumps(figures, default=_numbers, allow_nan=False, separators=(",", ":")).replace(
        "<", "\\u003c"
    )
    return "".join(
        [
            '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n',
            f'<meta http-equiv="Content-Security-Policy" content="{policy}">\n',
            '<meta name="viewport" content="width=device-width, initial-scale=1">\n',
            f'<link rel="icon" href="data:,">\n<title>{_text(title)}</title>\n',
            f"<style>\n{_resource('page.css')}</style>\n</head>\n<body>\n",
            *body,
            f'<script type="application/json" id="figures">{data}</script>\n',
            *(f"<script>{script}</script>\n" for script in scripts),
            "</body>\n</html>\n",
        ]
    )


class Summary(NamedTuple):
    """The most important facts about a recording.

    Attributes:
        name: Its name.
        verdict: Class of its style (good, bad or note), and text.
        findings: What the verdict lists.
        facts: Names and texts.
    """

    name: str
    verdict: tuple[str, str]
    findings: Sequence[Finding]
    facts: Sequence[tuple[str, str]]


def header(title: str, summaries: Sequence[Summary], sections: Sequence[Section]) -> str:
    """Returns the top of the page.

    Args:
        title: Title of the page.
        summaries: About each recording.
        sections: Targets of the navigation.
    """
    found = list(map(_summary, summaries))
    if len(found) > 1:
        found = [_columns([summary.name for summary in summaries], found)]
    navigation = [_link(section.anchor, section.title) + "\n" for section in sections]
    return (
        f"<header>\n<h1>{_text(title)}</h1>\n{''.join(found)}"
        f"<nav>{''.join(navigation)}</nav>\n</header>\n"
    )


def _summary(summary: Summary) -> str:
    style, sentence = summary.verdict
    links = [f"<li>{_link(found.section, found.text)}</li>\n" for found in summary.findings]
    rows = [f"<dt>{_text(name)}</dt><dd>{_text(text)}</dd>\n" for name, text in summary.facts]
    return (
        f'<div class="verdict {style}"><strong>{_text(sentence)}</strong>\n'
        + (f"<ul>\n{''.join(links)}</ul>\n" if links else "")
        + f"</div>\n<dl>\n{''.join(rows)}</dl>\n"
    )


def _columns(names: Sequence[str], cells: Sequence[str]) -> str:
    """Returns texts about several recordings side by side."""
    found = [
        f'<div><p class="of">{_text(name)}</p>\n{cell}</div>\n'
        for name, cell in zip(names, cells, strict=True)
    ]
    return f'<div class="columns">\n{"".join(found)}</div>\n'


def main(sections: Iterable[Section]) -> str:
    """Returns the sections."""
    note = "<noscript><p>The plots need JavaScript; the tables do not.</p></noscript>\n"
    return f"<main>\n{note}{''.join(map(_section, sections))}</main>\n"


def footer(text: str) -> str:
    """Returns the end of the page."""
    return f"<footer>{_block(Paragraph(text, is_note=True))}</footer>\n"


def _section(section: Section) -> str:
    blocks = "".join(map(_block, section.blocks))
    return f"<section>\n{_heading(2, section.anchor, section.title)}{blocks}</section>\n"


def _block(block: Block) -> str:
    match block:
        case Paragraph(text, is_note):
            return f"<p{' class=soft' if is_note else ''}>{_text(text)}</p>\n"
        case Heading(anchor, title):
            return _heading(3, anchor, title)
        case Plot(figure):
            height = figure["layout"]["height"]
            return f'<figure><div class="plot" style="height:{height}px"></div></figure>\n'
        case Table():
            return _table(block)
        case Columns(names, cells):
            return _columns(names, ["".join(map(_block, cell)) for cell in cells])


def _table(table: Table) -> str:
    def row(cells: Sequence[str], tag: str, anchor: str = "") -> str:
        texts = [_text(cell) for cell in cells]
        if anchor:
            texts[0] = _link(anchor, cells[0])
        styles = [" class=n" if at in table.numeric else "" for at in range(len(texts))]
        pairs = zip(styles, texts, strict=True)
        return f"<tr>{''.join(f'<{tag}{style}>{text}</{tag}>' for style, text in pairs)}</tr>\n"

    rows = [row(cells, "td", table.links.get(at, "")) for at, cells in enumerate(table.rows)]
    return f'<div class="wide"><table>\n{row(table.head, "th")}{"".join(rows)}</table></div>\n'


def _heading(level: int, anchor: str, title: str) -> str:
    return f'<h{level} id="{_text(anchor)}">{_link(anchor, title)}</h{level}>\n'


def _link(anchor: str, text: str) -> str:
    return f'<a href="#{_text(anchor)}">{_text(text)}</a>'


def _text(text: str) -> str:
    """Escapes HTML and control characters, for example one that reverses the direction of a line."""
    return escape(printable(text))


def _numbers(values: npt.NDArray[Any]) -> dict[str, str]:
    """Returns an array in the binary form of plotly; NaN is a gap."""
    short = values.dtype == np.float32
    data = np.asarray(values, "<f4" if short else "<f8")
    shape = {"shape": ", ".join(map(str, data.shape))} if data.ndim > 1 else {}
    encoded = base64.b64encode(data.tobytes()).decode()
    return {"dtype": "f4" if short else "f8", "bdata": encoded, **shape}


def _resource(name: str) -> str:
    return resources.files("xbus.report").joinpath(name).read_text("utf-8")


def _digest(script: str) -> str:
    return base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
