"""The command line: ``xbus COMMAND``.

Commands import what they need when they run, so ``xbus --help`` loads neither numpy nor rich.
"""

from __future__ import annotations

import atexit
import gc
import os
from importlib import import_module
from typing import Any

import click

from xbus._core import __version__
from xbus.cli.failure import handle_errors

__all__ = ["main"]

#: The module of each command, in the order of the help text.
COMMANDS = {
    "info": "info",
    "decode": "decode",
    "report": "report",
    "cut": "cut",
    "split": "cut",
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
    "studio": "studio",
    "view": "view",
    "stream": "stream",
    "serve": "serve",
    "ntrip": "ntrip",
    "sim": "sim",
    "can": "can",
    "demo": "demo",
    "doctor": "doctor",
    "completion": "completion",
}
# No command multiplies large matrices, and numpy would start a thread for that on every processor.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# At its end, Python looks for cycles in the objects of all modules: a sixth of the time of a short command.
atexit.register(gc.freeze)


class Commands(click.Group):
    """A group that imports a command when it is used, and converts errors to messages and exit status."""

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002 - click's signature
        """Returns the names of the commands."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:  # noqa: ARG002
        """Returns the command with this name."""
        if cmd_name not in COMMANDS:
            return None
        command = getattr(import_module(f"xbus.cli.{COMMANDS[cmd_name]}"), cmd_name)
        assert isinstance(command, click.Command)  # noqa: S101 - see COMMANDS
        return command

    def make_context(self, *args: Any, **kwargs: Any) -> click.Context:
        """Parses the arguments; ``--help`` and ``--version`` print here."""
        with handle_errors():
            return super().make_context(*args, **kwargs)

    def invoke(self, ctx: click.Context) -> Any:
        """Runs the command."""
        with handle_errors():
            return super().invoke(ctx)


@click.group(
    cls=Commands,
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog="Example: xbus info walk.mtb. Exit status: 0 success, 1 failure, 2 wrong usage, 130 Ctrl-C.",
)
@click.version_option(__version__, prog_name="xbus", message="%(prog)s %(version)s")
def main() -> None:
    """Decodes recordings of Xsens MTi motion trackers; records, configures and simulates devices."""
