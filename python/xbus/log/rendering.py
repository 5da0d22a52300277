"""Tables as text for a terminal and as HTML for a notebook."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

__all__ = ["html_table", "text_table"]


def text_table(title: str, rows: Sequence[Sequence[str]], align: str) -> str:
    """Returns the title and the rows, one per line, in columns.

    Args:
        title: The first line.
        rows: The cells of each row.
        align: For each column, ``<`` if its cells are aligned to the left, or ``>``.

    >>> print(text_table("<Log>", [("acceleration", "9"), ("quaternion", "10")], "<>"))
    <Log>
      acceleration   9
      quaternion    10
    """
    widths = [max(map(len, cells)) for cells in zip(*rows, strict=True)]
    lines = (
        "  ".join(
            f"{cell:{side}{width}}" for cell, side, width in zip(row, align, widths, strict=True)
        )
        for row in rows
    )
    return "\n".join([title, *(f"  {line}".rstrip() for line in lines)])


def html_table(
    title: str, head: Iterable[str], rows: Iterable[Iterable[str]], more: int = 0
) -> str:
    """Returns a table as HTML, after its title.

    Args:
        title: The title.
        head: The cells of the head.
        rows: The cells of each row.
        more: Number of further rows, which are not shown.
    """
    from html import escape  # takes 2 ms, and only notebooks need it

    def cells(tag: str, texts: Iterable[str]) -> str:
        return "".join(f"<{tag}>{escape(text)}</{tag}>" for text in texts)

    body = "".join(f"<tr>{cells('td', row)}</tr>" for row in rows)
    rest = f"<p>{more} more rows</p>" if more else ""
    return f"<p>{escape(title)}</p><table><tr>{cells('th', head)}</tr>{body}</table>{rest}"
