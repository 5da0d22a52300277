"""Commands that the studio runs as a user would: ``xbus info``, ``decode``, ``report``."""

from __future__ import annotations

import asyncio
import json
import shlex
import sys
from pathlib import Path
from typing import Any

__all__ = ["CommandError", "command_line", "describe", "run_command"]


class CommandError(Exception):
    """A command failed; the text is its sentence."""


def command_line(*words: str) -> str:
    """Returns a command as a shell takes it."""
    return shlex.join(["xbus", *words])


async def run_command(*words: str) -> str:
    """Runs a command in another process, and returns what it prints.

    A page stays responsive, whatever the size of a recording, and a cancelled task ends the process.

    Raises:
        CommandError: It failed.
    """
    process = await asyncio.create_subprocess_exec(
        sys.executable,
        "-m",
        "xbus",
        *words,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
    )
    try:
        output, errors = await process.communicate()
    except asyncio.CancelledError:
        process.terminate()
        raise
    if process.returncode:
        lines = errors.decode("utf-8", "replace").strip().splitlines()
        raise CommandError(
            lines[-1].removeprefix("xbus: ") if lines else f"exit status {process.returncode}"
        )
    return output.decode("utf-8", "replace")


#: What `describe` found, by path, size and time of the last change.
_known: dict[tuple[Path, int, int], dict[str, Any]] = {}


async def describe(path: Path) -> dict[str, Any]:
    """Returns what ``xbus info --json`` prints about a recording; an unchanged file is read once.

    Raises:
        CommandError: It cannot be read.
        OSError: It is gone.
    """
    state = path.stat()
    key = (path, state.st_size, state.st_mtime_ns)
    if key not in _known:
        # The command prints a list with one object for each recording.
        (_known[key],) = json.loads(await run_command("info", "--json", str(path)))
    return _known[key]
