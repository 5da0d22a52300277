"""``--memory``: how many threads may work at once."""

from __future__ import annotations

import os
from typing import NamedTuple

import click

from xbus.cli.rotation import parse_size

__all__ = ["Workers", "memory_option", "workers_within"]

#: Bytes that the interpreter and its libraries take.
PROCESS = 60_000_000
#: Bytes that a decode takes, and in addition each of its threads: a part of the log with its table, half a
#: chunk of the file, and what the allocator keeps. Measured on a recording of 0.5 GB with 1 to 16 threads.
DECODE, THREAD = 140_000_000, 31_000_000
#: The least that suffices: what one thread takes, and a third more.
LEAST = 205_000_000


class Workers(NamedTuple):
    """How much is done at once.

    Attributes:
        jobs: Number of recordings.
        threads: Number of threads for each.
    """

    jobs: int
    threads: int


def _memory(
    ctx: click.Context,  # noqa: ARG001 - click's signature
    param: click.Parameter,  # noqa: ARG001
    value: str,
) -> int:
    memory = parse_size(value)
    if memory < LEAST:
        raise click.BadParameter(f"{value} is too little; decode needs {LEAST // 10**6}MB")
    return memory


#: The option.
memory_option = click.option(
    "--memory",
    default="512MB",
    show_default=True,
    callback=_memory,
    metavar="SIZE",
    help="Use about this much memory, at least 205MB. More lets more cores work. --rate-out, --tracker, "
    "strings and .npz files take as much as the whole log needs.",
)


def workers_within(memory: int, recordings: int, jobs: int | None) -> Workers:
    """Returns how much can be done at once.

    Args:
        memory: Bytes that are allowed.
        recordings: Number of recordings.
        jobs: Number of recordings at once that is asked for, or None.

    >>> workers_within(10**12, recordings=1, jobs=None).threads == os.cpu_count()
    True
    >>> workers_within(LEAST, recordings=9, jobs=4)
    Workers(jobs=1, threads=1)
    """
    cores = os.cpu_count() or 1
    available = memory - PROCESS
    most = available // (DECODE + THREAD)
    together = max(1, min(jobs or cores, recordings, most))
    threads = (available // together - DECODE) // THREAD
    return Workers(together, max(1, min(threads, cores // together)))
