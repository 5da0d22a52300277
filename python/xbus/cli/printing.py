"""What commands print."""

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
    "hint",
    "is_terminal",
    "print_json",
    "print_json_rows",
    "print_line",
    "print_table",
]

#: Columns of a terminal from which a table shows all of its own.
WIDE = 140


def print_line(text: str, *, now: bool = False) -> None:
    """Prints text and a line feed on stdout; ``now`` does not wait for more."""
    if sys.stdout is None:  # the caller has closed it
        raise OSError(errno.EBADF, os.strerror(errno.EBADF))
    sys.stdout.write(text + "\n")
    if now:
        sys.stdout.flush()


def print_json(facts: Any) -> None:
    """Prints JSON that a person can read as well."""
    print_line(json.dumps(facts, indent=2, allow_nan=False))


def print_json_rows(rows: Sequence[Any]) -> None:
    """Prints a JSON list, a row a line."""
    print_line("[" + ",\n ".join(json.dumps(it, allow_nan=False) for it in rows) + "]")


def is_terminal() -> bool:
    """Whether stdout is a terminal."""
    return sys.stdout is not None and sys.stdout.isatty()


def bold(text: str) -> str:
    """A heading, where stdout is a terminal."""
    return f"\x1b[1m{text}\x1b[0m" if is_terminal() and os.environ.get("TERM") != "dumb" else text


def align(rows: Sequence[Sequence[str]], *, right: Sequence[int] = ()) -> list[str]:
    """Rows as lines, each column as wide as its widest cell; those in ``right`` end together."""
    widths = [max(map(len, cells)) for cells in zip(*rows, strict=True)]
    lines = []
    for row in rows:
        cells = [
            f"{cell:>{width}}" if at in right else f"{cell:<{width}}"
            for at, (cell, width) in enumerate(zip(row, widths, strict=True))
        ]
        lines.append("  ".join(cells).rstrip())
    return lines


def hint(text: str, names: Iterable[str], command: str) -> str:
    """What somebody meant who wrote ``text`` for one of the names that ``xbus command`` lists."""
    import difflib

    by_lower = {it.lower(): it for it in names}
    near = [it for it in by_lower if it.startswith(text.lower())]
    near = near or difflib.get_close_matches(text.lower(), by_lower, n=1)
    return f"did you mean {by_lower[near[0]]}?" if near else f"xbus {command} lists them"


def find_name(text: str, names: Iterable[str], what: str, command: str) -> str:
    """The one of the names that is ``text``, in whichever case; ``xbus command`` lists them.

    Raises:
        BadParameter: None is.
    """
    by_lower = {it.lower(): it for it in names}
    if (name := by_lower.get(text.lower())) is None:
        advice = hint(text, by_lower.values(), command)
        raise click.BadParameter(f"no {what} is called {text!r}; {advice}")
    return name


def print_table(
    head: Sequence[str], rows: Sequence[Sequence[str]], *, optional: Sequence[str]
) -> None:
    """Prints a table: folded to the width of a terminal, a line a row for everything else.

    The first two columns are never folded; a narrow terminal does without the ``optional`` ones.
    """
    if not is_terminal():
        print_line("\n".join(align([head, *rows])))
        return
    from rich import box
    from rich.console import Console
    from rich.table import Table

    console = Console(markup=False, highlight=False)
    narrow = console.width < WIDE
    shown = [at for at, name in enumerate(head) if not (narrow and name in optional)]
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for at in shown:
        table.add_column(head[at], no_wrap=at < 2, overflow="fold")
    for row in rows:
        table.add_row(*(row[at] for at in shown))
    console.print(table)
    if narrow:
        console.print(f"A wider terminal or a pipe shows {', '.join(optional)} too.")
