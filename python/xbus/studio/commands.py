"""Commands that the studio shows, or runs as a user would, such as ``xbus record`` and ``xbus info``."""

from __future__ import annotations

import asyncio
import json
import os
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from xbus.describe.log_summary import LogSummary
from xbus.device.rotation import parse_rotation
from xbus.files import is_plain
from xbus.log.read import iter_log
from xbus.studio.library import Entry, FileCache, remember_recordings

__all__ = [
    "CommandError",
    "Facts",
    "command_line",
    "describe",
    "facts_of",
    "number_text",
    "part_options",
    "record_commands",
    "run_command",
    "small_facts",
]


class CommandError(Exception):
    """A command failed; the text is its sentence."""


def command_line(*words: str) -> str:
    """Returns a command as a shell takes it, as printable text."""
    return os.fsencode(shlex.join(["xbus", *words])).decode("utf-8", "replace")


def number_text(number: float) -> str:
    """Returns a number as a word of a command, with all of its digits.

    >>> number_text(10.0), number_text(100_000.25)
    ('10', '100000.25')
    """
    return f"{number:.15g}"


def record_commands(
    ports: Sequence[str], folder: Path, duration: float | None, rotation: str
) -> tuple[str, str]:
    """Returns what records devices at the same time, in a shell and in Python.

    Args:
        ports: The devices.
        folder: Where the files go.
        duration: Seconds after which the recordings stop; None for no limit.
        rotation: As for ``xbus record --rotate``; empty for one file.

    >>> for text in record_commands(["COM3", "COM4"], Path(), None, ""):
    ...     print(text)
    xbus record COM3 -o walk_1.mtb & xbus record COM4 -o walk_2.mtb
    with device_1.record("walk_1.mtb"), device_2.record("walk_2.mtb"): ...
    >>> for text in record_commands(["COM3"], Path(), 60, "1h"):
    ...     print(text)
    xbus record COM3 -o walk.mtb --duration 60 --rotate 1h
    with device.record("walk.mtb", rotate_seconds=3600): time.sleep(60)
    """
    ends = [""] if len(ports) == 1 else [f"_{number}" for number in range(1, len(ports) + 1)]
    words = [] if duration is None else ["--duration", number_text(duration)]
    words += ["--rotate", rotation] if rotation else []
    shell = [
        command_line("record", port, "-o", str(folder / f"walk{end}.mtb"), *words)
        for port, end in zip(ports, ends, strict=True)
    ]
    options = parse_rotation(rotation) if rotation else {}
    arguments = "".join(f", {name}={number_text(value)}" for name, value in options.items())
    python = ", ".join(f'device{end}.record("walk{end}.mtb"{arguments})' for end in ends)
    body = "..." if duration is None else f"time.sleep({number_text(duration)})"
    return " & ".join(shell), f"with {python}: {body}"


def part_options(begin: float, end: float, duration: float) -> list[str]:
    """Returns the options of ``xbus cut`` for a part of a recording.

    A part ends before the sample at its end. Up to the end of the recording, it has the last sample too.

    Args:
        begin: Seconds since the first sample.
        end: Seconds since the first sample, rounded to 0.01 s.
        duration: Seconds of the recording.

    >>> part_options(2.0, 5.0, 10.394), part_options(2.0, 10.39, 10.394)
    (['--from', '2', '--to', '5'], ['--from', '2'])
    """
    options = ["--from", number_text(begin)]
    return options if end >= round(duration, 2) else [*options, "--to", number_text(end)]


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


class Facts(NamedTuple):
    """What is known about a recording, from ``xbus info --json``.

    Attributes:
        devices: Their names.
        duration: Seconds; None without time stamps.
        samples, lost_samples, gaps: Numbers of samples and gaps.
        skipped_bytes, places: Bytes of damage, and where they are.
        has_counter: Whether lost samples are detected.
        quantities: Names of the quantities.
    """

    devices: tuple[str, ...]
    duration: float | None
    samples: int
    lost_samples: int
    gaps: int
    skipped_bytes: int
    places: int
    has_counter: bool
    quantities: tuple[str, ...]


#: Tasks that find the facts about recordings, or have found them.
_facts: FileCache[asyncio.Task[Facts]] = FileCache()
#: Up to this size, in bytes, a recording is read in this process: to start another one takes longer.
SMALL = 4 << 20
#: From this size on, in bytes, a recording is large: one of them is read at a time, and others do not wait.
LARGE = 200_000_000
#: Commands that run at the same time for small recordings, and for large ones.
_gates = {False: asyncio.Semaphore(2), True: asyncio.Semaphore(1)}


async def describe(entry: Entry) -> Facts:
    """Returns the facts about a recording; as long as it does not change, it is read once.

    Raises:
        CommandError: It cannot be read.
        OSError: It is gone.
    """
    key = FileCache.key(entry.files)
    task = _facts.get(key)
    if task is None:
        task = asyncio.create_task(_read_facts(entry))
        # Without a page that waits, a failure is shown to none; asyncio would print it.
        task.add_done_callback(lambda done: done.cancelled() or done.exception())
        _facts.put(key, task)
    try:
        # A page that is closed does not end what another one waits for.
        return await asyncio.shield(task)
    except (CommandError, OSError):
        _facts.forget(key)
        raise


async def _read_facts(entry: Entry) -> Facts:
    async with _gates[entry.size >= LARGE]:
        if (found := await asyncio.to_thread(small_facts, entry)) is not None:
            return found
        # With many gaps, the text is long.
        return await asyncio.to_thread(
            facts_of, await run_command("info", "--json", *entry.arguments)
        )


def small_facts(entry: Entry) -> Facts | None:
    """Returns the facts about a small recording; None if ``xbus info`` must find them, or what is wrong."""
    files = [str(file) for file in entry.files]
    if entry.size > SMALL or not all(map(is_plain, files)):
        return None
    try:
        parts = iter_log(files if len(files) > 1 else files[0], block_bytes=SMALL)
        summary = LogSummary(parts)
    except (OSError, ValueError):
        return None
    if not summary.stats.frames and not summary.stats.strings:
        return None
    return _from_info(summary.to_dict(files[0]))


def facts_of(text: str) -> Facts:
    """Returns the facts in the output of ``xbus info --json`` about one recording.

    Raises:
        CommandError: The files are several recordings.
    """
    found = json.loads(text)
    if len(found) > 1:
        remember_recordings([each["files"] for each in found])
        raise CommandError(f"these files are {len(found)} recordings; read the folder again")
    return _from_info(found[0])


def _from_info(info: dict[str, Any]) -> Facts:
    devices, names = info["devices"], tuple(row["name"] for row in info["quantities"])

    def unknown(bid: int) -> str:
        return f"BID {bid}" if len(devices) > 1 else "unknown product"

    return Facts(
        tuple((device["product_code"] or unknown(device["bid"])).strip() for device in devices),
        info["duration_s"],
        info["samples"],
        info["lost_samples"],
        info["totals"]["gaps"],
        info["skipped_bytes"],
        info["totals"]["damage"],
        "packet_counter" in names,
        names,
    )
