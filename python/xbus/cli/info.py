"""``xbus info``: the content of a log."""

from __future__ import annotations

from typing import Any

import click

from xbus.cli.failure import Failure
from xbus.cli.inputs import Input, label, no_frame, reading_task, strings_option
from xbus.cli.printing import print_json, print_line
from xbus.cli.progress import Progress

__all__ = ["info"]


@click.command(epilog="Example: xbus info walk.mtb")
@click.argument(
    "files", type=click.Path(readable=False), metavar="FILE...", nargs=-1, required=True
)
@strings_option
@click.option(
    "--json", "as_json", is_flag=True, help="Print a JSON list with an object for each FILE."
)
def info(files: tuple[str, ...], strings: tuple[str, ...], as_json: bool) -> None:
    """Describes a log: device, times, quantities, gaps, damage.

    Each FILE is described separately; - is standard input. Sizes and offsets are in bytes, times in seconds,
    rates as measured. The JSON lists every gap, place of damage and error, and has null for unknown values.
    An unreadable FILE has the keys "file" and "error".
    """
    from xbus.cli.info_text import info_text
    from xbus.describe.log_summary import LogSummary
    from xbus.log.read import iter_log

    results: list[dict[str, Any]] = []
    failures = 0
    for file in files:
        try:
            with Progress(reading_task(file)) as progress, Input([file], progress) as source:
                summary = LogSummary(iter_log(source, strings=strings))
            if not summary.stats.frames and not summary.stats.strings:
                raise no_frame([file], summary.stats.bytes)
        except Failure as failure:
            failure.show()
            failures += 1
            results.append({"file": file, "error": failure.message})
            continue
        results.append(summary.to_dict(file))
        if not as_json:
            end = "\n" if len(files) > 1 else ""
            print_line(info_text(label(file), summary) + end, flush=True)
    if as_json:
        print_json(results)
    if failures:
        raise click.exceptions.Exit(1)
