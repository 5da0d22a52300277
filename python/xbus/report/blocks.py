"""The content of a report: sections of paragraphs, headings, plots and tables, without HTML."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from xbus.report.data import MAX_ROWS
from xbus.report.figures import Figure

__all__ = [
    "Block",
    "Columns",
    "Heading",
    "Paragraph",
    "Plot",
    "Section",
    "Table",
    "figures_of",
    "table_of_first",
]


@dataclass(frozen=True)
class Paragraph:
    """Text; a note is smaller."""

    text: str
    is_note: bool = False


@dataclass(frozen=True)
class Heading:
    """The heading of a part of a section; `anchor` is the target of links."""

    anchor: str
    title: str


@dataclass(frozen=True)
class Plot:
    """A plot."""

    figure: Figure


@dataclass(frozen=True)
class Table:
    """A table.

    Attributes:
        head: Column names.
        rows: Cells.
        numeric: Indices of the columns that hold numbers.
        links: Anchors that the first cells of rows link to, by row.
    """

    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    numeric: Sequence[int] = ()
    links: Mapping[int, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Columns:
    """The same about several recordings, side by side: their names, and blocks about each."""

    names: Sequence[str]
    cells: Sequence[Sequence[Block]]


Block = Paragraph | Heading | Plot | Table | Columns


@dataclass(frozen=True)
class Section:
    """A section; `anchor` is the target of links."""

    anchor: str
    title: str
    blocks: Sequence[Block]


def figures_of(blocks: Iterable[Block]) -> Iterator[Figure]:
    """Yields the figures in blocks, in order."""
    for block in blocks:
        if isinstance(block, Plot):
            yield block.figure
        elif isinstance(block, Columns):
            for cell in block.cells:
                yield from figures_of(cell)


def table_of_first(
    head: Sequence[str],
    rows: Sequence[Sequence[str]],
    numeric: Sequence[int],
    total: int,
    things: str,
) -> Iterable[Block]:
    """Yields a table of the first rows of ``total``, and a note about the rest."""
    yield Table(head, rows[:MAX_ROWS], numeric)
    if total > MAX_ROWS:
        text = f"… and {total - MAX_ROWS:,} more {things}; xbus info --json lists more."
        yield Paragraph(text, is_note=True)
