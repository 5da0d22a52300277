"""The command line: ``xbus COMMAND``.

What a command works with is imported when it runs: ``xbus --help`` waits for neither numpy nor rich.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

import click

from xbus._core import __version__
from xbus.cli.failure import guarded

__all__ = ["main"]

#: The module of each command, in the order in which help lists them.
COMMANDS = {
    "info": "info",
    "decode": "decode",
    "report": "report",
    "dump": "dump",
    "quantities": "tables",
    "messages": "tables",
    "ports": "ports",
    "identify": "identify",
    "send": "send",
    "config": "config",
    "baudrate": "baudrate",
    "reset": "reset",
    "restore": "restore",
    "record": "record",
    "monitor": "monitor",
    "ntrip": "ntrip",
    "sim": "sim",
    "demo": "demo",
}


class Commands(click.Group):
    """Commands that are imported when they are asked for, and end in order whatever happens."""

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002 - click's signature
        """The names of the commands."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:  # noqa: ARG002
        """The command of this name."""
        if cmd_name not in COMMANDS:
            return None
        command = getattr(import_module(f"xbus.cli.{COMMANDS[cmd_name]}"), cmd_name)
        assert isinstance(command, click.Command)  # noqa: S101 - the table above is ours
        return command

    def make_context(self, *args: Any, **kwargs: Any) -> click.Context:
        """Reads the arguments; ``--help`` and ``--version`` print here."""
        with guarded():
            return super().make_context(*args, **kwargs)

    def invoke(self, ctx: click.Context) -> Any:
        """Runs the command."""
        with guarded():
            return super().invoke(ctx)


@click.group(
    cls=Commands,
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog="Example: xbus info walk.mtb. Exit status: 0 done, 1 the work failed, 2 a wrong call, "
    "130 stopped with Ctrl-C.",
)
@click.version_option(__version__, prog_name="xbus", message="%(prog)s %(version)s")
def main() -> None:
    """Xsens MTi motion trackers: reads their logs (.mtb files, raw bytes), and talks to devices."""
