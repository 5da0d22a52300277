"""The examples in the pages of the documentation."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

BLOCK = re.compile(r"^```([^\n`]*)\n(.*?)^```$", re.DOTALL | re.MULTILINE)


def blocks(page: Path, language: str) -> list[str]:
    """Returns the blocks of a page in one language."""
    return [text for found, text in BLOCK.findall(page.read_text("utf-8")) if found == language]


def commands(block: str) -> Iterator[str]:
    r"""Yields the commands of a ``console`` block: its lines that begin with ``$ ``, without it.

    A command goes on after a backslash at the end of a line:

        >>> list(commands("$ xbus record \\\n    -o a.mtb\noutput\n$ xbus info a.mtb\n"))
        ['xbus record \\\n    -o a.mtb', 'xbus info a.mtb']
    """
    lines = iter(block.splitlines())
    for line in lines:
        if line.startswith("$ "):
            command = line[2:]
            while command.endswith("\\"):
                command += f"\n{next(lines)}"
            yield command


def page_commands(page: Path) -> list[str]:
    """Returns the commands of all ``console`` blocks of a page, in order."""
    return [command for block in blocks(page, "console") for command in commands(block)]
