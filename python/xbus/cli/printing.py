"""Output of commands on stdout."""

from __future__ import annotations

import errno
import json
import os
import sys
from collections.abc import Iterable, Sequence
from typing import Any

import click

__all__ = [
    "align",
    "bold",
    "find_name",
    "is_terminal",
    "print_json",
    "print_json_rows",
    "print_line",
    "print_table",
    "suggestion",
]

#: Width of a terminal, in columns, that shows all columns of a table.
WIDE = 140


def print_line(text: str, *, flush: bool = False) -> None:
    """Prints text and a line feed."""
    _write(text + "\n")
    if flush:
        sys.stdout.flush()


def _write(text: str) -> None:
    if sys.stdout is None:  # the caller has closed it
        raise OSError(errno.EBADF, os.strerror(errno.EBADF))
    sys.stdout.write(text)


def print_json(value: Any) -> None:
    """Prints indented JSON, piece by piece."""
    from xbus.describe.json_text import json_pieces

    for piece in json_pieces(value):
        _write(piece)
    _write("\n")


def print_json_rows(rows: Sequence[Any]) -> None:
    """Prints a JSON list, one row per line."""
    print_line("[" + ",\n ".join(json.dumps(row, allow_nan=False) for row in rows) + "]")


def is_terminal() -> bool:
    """Returns whether stdout is a terminal."""
    return sys.stdout is not None and sys.stdout.isatty()


def bold(text: str) -> str:
    """Returns the text in bold if stdout is a terminal."""
    return f"\x1b[1m{text}\x1b[0m" if is_terminal() and os.environ.get("TERM") != "dumb" else text


def align(rows: Sequence[Sequence[str]], *, right: Sequence[int] = ()) -> list[str]:
    """Returns rows as lines with aligned columns; the columns in ``right`` are aligned right."""
    widths = [max(map(len, cells)) for cells in zip(*rows, strict=True)]
    lines = []
    for row in rows:
        cells = [
            f"{cell:>{width}}" if at in right else f"{cell:<{width}}"
            for at, (cell, width) in enumerate(zip(row, widths, strict=True))
        ]
        lines.append("  ".join(cells).rstrip())
    return lines


def suggestion(text: str, names: Iterable[str], command: str) -> str:
    """Returns the remedy for a misspelled name: the nearest name, or ``xbus command`` that lists them."""
    import difflib

    by_lower = {name.lower(): name for name in names}
    near = [lower for lower in by_lower if lower.startswith(text.lower())]
    near = near or difflib.get_close_matches(text.lower(), by_lower, n=1)
    return f"did you mean {by_lower[near[0]]}?" if near else f"xbus {command} lists them"


def find_name(text: str, names: Iterable[str], kind: str, command: str) -> str:
    """Returns the name that equals ``text``, ignoring case.

    Args:
        text: What the user wrote.
        names: The valid names.
        kind: What the names stand for, for the error message.
        command: The command that lists the names.

    Raises:
        BadParameter: No name matches.
    """
    by_lower = {name.lower(): name for name in names}
    if (name := by_lower.get(text.lower())) is None:
        remedy = suggestion(text, by_lower.values(), command)
        raise click.BadParameter(f"no {kind} is called {text!r}; {remedy}")
    return name


def print_table(
    head: Sequence[str], rows: Sequence[Sequence[str]], *, optional: Sequence[str]
) -> None:
    """Prints a table: wrapped to the width of a terminal, or one line per row if stdout is not one.

    Args:
        head: Column names. The first two columns are never wrapped.
        rows: Cells.
        optional: Columns that a narrow terminal leaves out.
    """
    if not is_terminal():
        print_line("\n".join(align([head, *rows])))
        return
    from rich import box
    from rich.console import Console
    from rich.table import Table

    console = Console(markup=False, highlight=False)
    is_narrow = console.width < WIDE
    columns = [at for at, name in enumerate(head) if not (is_narrow and name in optional)]
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for at in columns:
        table.add_column(head[at], no_wrap=at < 2, overflow="fold")
    for row in rows:
        table.add_row(*(row[at] for at in columns))
    console.print(table)
    if is_narrow:
        console.print(f"A wider terminal or a pipe also shows {', '.join(optional)}.")
