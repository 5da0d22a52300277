"""The output file of commands: ``-o OUT``."""

from __future__ import annotations

import contextlib
import errno
import math
import os
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import click

from xbus.cli.failure import cannot
from xbus.cli.inputs import STDIN, label
from xbus.formatting import describe_damage, describe_losses, format_count

if TYPE_CHECKING:
    from xbus.cli.decoded_totals import DecodedTotals
    from xbus.describe.log_summary import LogSummary
    from xbus.log.log import Log
    from xbus.log.trackers import Tracker

__all__ = ["check_output", "quality_text", "restart_count", "writing"]


def check_output(files: Sequence[str], out: str, *, is_folder: bool = False) -> None:
    """Raises the errors of OUT that can be known before reading, which may take long.

    Args:
        files: The input.
        out: The file to write, or the folder, which must be new.
        is_folder: Whether it is a folder.
    """
    if not out:
        raise click.UsageError("OUT is empty; give it a name")
    for file in files:
        with contextlib.suppress(OSError):
            if file != STDIN and os.path.samefile(file, out):  # noqa: PTH121 - pathlib is slow to import
                raise click.UsageError(f"OUT is the input {label(file)}; choose another name")
    with writing(out):
        folder = os.path.dirname(out) or "."  # noqa: PTH120
        os.stat(folder)  # noqa: PTH116
        number = None
        if is_folder and os.path.lexists(out):
            number = errno.EEXIST
        elif os.path.isdir(out):  # noqa: PTH112
            number = errno.EISDIR
        elif not os.access(folder, os.W_OK) and (os.path.isfile(out) or not os.path.exists(out)):  # noqa: PTH110, PTH113
            # OUT is written to a temporary file in its folder.
            number = errno.EROFS if _is_read_only(folder) else errno.EACCES
        if number is not None:
            raise OSError(number, os.strerror(number))


def _is_read_only(folder: str) -> bool:
    """Returns whether the file system of a folder is read-only."""
    return os.name == "posix" and bool(os.statvfs(folder).f_flag & os.ST_RDONLY)


@contextlib.contextmanager
def writing(out: str) -> Iterator[None]:
    """Converts an error of writing to a Failure."""
    try:
        yield
    except BrokenPipeError:
        raise
    except OSError as error:
        raise cannot(f"write {label(out)}", error) from error


def _is_counted(log: Log | LogSummary | DecodedTotals) -> bool:
    """Returns whether samples have a packet counter."""
    from xbus.log.log import Log

    return bool((log.packet_counter != -1).any()) if isinstance(log, Log) else log.has_counter


def _losses(log: Log | LogSummary | DecodedTotals, tracker: Tracker | None) -> str:
    if tracker is not None:
        return describe_losses(tracker.lost_samples, tracker.gaps, has_counter=True)
    if trackers := log.trackers:
        found = list(trackers.values()) if isinstance(trackers, dict) else trackers
        lost, gaps = (sum(getattr(t, name) for t in found) for name in ("lost_samples", "gaps"))
        return describe_losses(lost, gaps, has_counter=True)
    stats = log.stats
    return describe_losses(stats.lost_samples, stats.gaps, has_counter=_is_counted(log))


def _is_stamped(log: Log | LogSummary | DecodedTotals) -> bool:
    """Returns whether a sample has a time."""
    from xbus.log.log import Log

    return bool((log.time == log.time).any()) if isinstance(log, Log) else math.isfinite(log.start)


def restart_count(log: Log | LogSummary | DecodedTotals) -> int:
    """Returns how often devices restarted."""
    import numpy as np

    from xbus.log.log import Log

    bids = log.runs["bid"] if isinstance(log, Log) else log.runs.rows["bid"]
    return len(bids) - len(np.unique(bids))


def quality_text(
    log: Log | LogSummary | DecodedTotals,
    tracker: Tracker | None = None,
    *,
    is_capture: bool = False,
) -> str:
    """Returns duration, restarts, losses and damage as one line; losses of one tracker if it is given.

    A CAN capture has findings instead of damage.
    """
    stats = log.stats
    parts = [f"{log.duration:,.2f} s"] if math.isfinite(log.duration) else []
    if not stats.samples:
        parts.append("no samples")
    elif not _is_stamped(log):
        remedy = " (--rate HZ derives them from the packet counter)" if log.has_counter else ""
        parts.append(f"no time stamps{remedy}")
    if restarts := restart_count(log):
        parts.append("restarted once" if restarts == 1 else f"restarted {restarts:,} times")
    if stats.strings:
        parts.append(format_count(stats.strings, "string"))
    if stats.samples:
        parts.append(_losses(log, tracker))
    elif stats.messages:
        parts.append(format_count(stats.messages, "message"))
    if not is_capture:
        parts.append(describe_damage(stats.skipped_bytes, len(log.damage)))
    fault = getattr(log, "times_fault", None)
    return ", ".join([*parts, fault] if fault else parts)
