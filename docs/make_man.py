"""Writes the manual page xbus(1) from the commands. tests/test_man.py runs it.

python docs/make_man.py
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import click

from xbus import __version__
from xbus.cli import main

#: maturin installs what is in `xbus.data/data` below the prefix of the environment.
PAGE = (
    Path(__file__).resolve().parents[1] / "xbus.data" / "data" / "share" / "man" / "man1" / "xbus.1"
)
SECTIONS = {
    "EXIT STATUS": [
        "0 on success; 1 if the work failed, an input cannot be read, or nothing could be decoded; 2 for a"
        " wrong call; 130 after Ctrl-C."
    ],
    "BUGS": ["A bug report needs the output of xbus doctor --json."],
}


def page() -> str:
    """Returns the page."""
    context = click.Context(main, info_name="xbus", **main.context_settings)
    lines = [
        f'.TH XBUS 1 "" "xbus {__version__}" "User Commands"',
        ".SH NAME",
        escaped(
            "xbus - decodes recordings of Xsens MTi trackers; records, configures and simulates devices"
        ),
        ".SH SYNOPSIS",
        bold("xbus") + " [OPTIONS] COMMAND [ARGS]...",
        ".SH DESCRIPTION",
        *described(main, context),
        ".SH COMMANDS",
        *subcommands(main, context),
    ]
    for title, texts in SECTIONS.items():
        lines += [f".SH {title}", *map(escaped, texts)]
    return "\n".join(lines) + "\n"


def subcommands(group: click.Group, context: click.Context) -> Iterator[str]:
    """Yields a subsection for each command, those of a group after the group."""
    for name in group.list_commands(context):
        if (command := group.get_command(context, name)) is None:
            raise KeyError(name)
        inner = click.Context(command, info_name=name, parent=context)
        yield f".SS {escaped(f'{inner.command_path} ' + ' '.join(command.collect_usage_pieces(inner)))}"
        yield from described(command, inner)
        if isinstance(command, click.Group):
            yield from subcommands(command, inner)


def described(command: click.Command, context: click.Context) -> Iterator[str]:
    """Yields what a command does, its options, and the example."""
    for number, paragraph in enumerate(re.split(r"\n\s*\n", (command.help or "").strip())):
        if number:
            yield ".PP"
        yield escaped(" ".join(paragraph.split()))
    for param in command.get_params(context):
        record = param.get_help_record(context) if isinstance(param, click.Option) else None
        if record is not None and ("--help" not in param.opts or context.parent is None):
            option, text = record
            yield from (".TP", bold(option), escaped(" ".join(text.split())))
    if command.epilog:
        yield from (".PP", escaped(" ".join(command.epilog.split())))


def escaped(text: str) -> str:
    """Returns text that roff prints as it is."""
    text = text.replace("\\", "\\e").replace("-", "\\-")
    return f"\\&{text}" if text.startswith((".", "'")) else text


def bold(text: str) -> str:
    return f"\\fB{escaped(text)}\\fR"


if __name__ == "__main__":
    PAGE.parent.mkdir(parents=True, exist_ok=True)
    PAGE.write_text(page(), "utf-8")
