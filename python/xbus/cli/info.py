"""``xbus info``: what is in a log."""

from __future__ import annotations

from typing import Any

import click

from xbus.cli.failure import Failure
from xbus.cli.inputs import Input, label, no_frame, strings_option, task
from xbus.cli.printing import print_json, print_line
from xbus.cli.progress import Progress

__all__ = ["info"]


@click.command(epilog="Example: xbus info walk.mtb")
@click.argument(
    "files", type=click.Path(readable=False), metavar="FILE...", nargs=-1, required=True
)
@strings_option
@click.option("--json", "as_json", is_flag=True, help="A JSON list with one object for each FILE.")
def info(files: tuple[str, ...], strings: tuple[str, ...], as_json: bool) -> None:
    """What is in a log: device, times, quantities, gaps, damage.

    Each FILE gets a page of its own; - is standard input. Sizes and offsets are in bytes, times in
    seconds, rates as measured. The JSON says all that the page says, and lists every gap, stretch of
    damage and error; null stands for what the log does not tell. An unreadable FILE has the keys
    "file" and "error".
    """
    from xbus.cli.page import page
    from xbus.describe.log_summary import LogSummary
    from xbus.log.read import iter_log

    said: list[dict[str, Any]] = []
    failures = 0
    for file in files:
        try:
            with Progress(task(file)) as progress, Input([file], progress) as source:
                facts = LogSummary(iter_log(source, strings=strings))
            if not facts.stats.frames and not facts.stats.strings:
                raise no_frame([file], facts.stats.bytes)
        except Failure as failure:
            failure.show()
            failures += 1
            said.append({"file": file, "error": failure.message})
            continue
        said.append(facts.to_dict(file))
        if not as_json:
            print_line(page(label(file), facts) + ("\n" if len(files) > 1 else ""), now=True)
    if as_json:
        print_json(said)
    if failures:
        raise click.exceptions.Exit(1)
