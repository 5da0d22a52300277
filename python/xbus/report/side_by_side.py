"""The sections of several recordings, side by side."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from xbus.report.blocks import Block, Columns, Heading, Paragraph, Section

__all__ = ["side_by_side"]

#: What stands where a recording has nothing to show.
NOTHING = Paragraph("Not in this recording.", is_note=True)


def side_by_side(names: Sequence[str], reports: Sequence[Sequence[Section]]) -> list[Section]:
    """Returns sections in which each part is about all recordings.

    Args:
        names: Names of the recordings.
        reports: The same sections of each recording, also those without content.

    >>> from xbus.report.blocks import Heading, Paragraph, Section
    >>> one = Section("plots", "Plots", [Heading("acceleration", "acceleration"), Paragraph("1")])
    >>> two = Section("plots", "Plots", [])
    >>> (section,) = side_by_side(["a.mtb", "b.mtb"], [[one], [two]])
    >>> heading, columns = section.blocks
    >>> heading.title, [cell[0].text for cell in columns.cells]
    ('acceleration', ['1', 'Not in this recording.'])
    """
    return [
        Section(found[0].anchor, found[0].title, list(_joined(names, found)))
        for found in zip(*reports, strict=True)
    ]


def _joined(names: Sequence[str], sections: Sequence[Section]) -> Iterable[Block]:
    """Yields the blocks of a section of each recording: those below the same heading together."""
    parts: dict[Heading | None, list[list[Block]]] = {}
    for number, section in enumerate(sections):
        heading: Heading | None = None
        for block in section.blocks:
            if isinstance(block, Heading):
                heading = block
            cells = parts.setdefault(heading, [[] for _ in sections])
            if block is not heading:
                cells[number].append(block)
    for heading, cells in parts.items():
        if heading is not None:
            yield heading
        # Paragraphs that all recordings share stand above them.
        while all(cells) and isinstance(cells[0][0], Paragraph):
            if any(cell[0] != cells[0][0] for cell in cells):
                break
            yield cells[0][0]
            cells = [cell[1:] for cell in cells]
        if any(cells):
            yield Columns(names, [cell or [NOTHING] for cell in cells])
