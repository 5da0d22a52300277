"""``xbus report``: a recording on one page."""

from __future__ import annotations

import os

import click

from xbus.cli.export_target import check, summary, writing
from xbus.cli.inputs import Input, label, no_frame, strings_option, task
from xbus.cli.progress import Progress

__all__ = ["report"]


def _out(ctx: click.Context, param: click.Parameter, value: str) -> str:  # noqa: ARG001 - click's
    """A path that a browser takes for a page."""
    if not value.lower().endswith((".html", ".htm")):
        raise click.BadParameter(f"{value!r} must end in .html")
    return value


@click.command(epilog="Example: xbus report walk.mtb -o walk.html")
@click.argument(
    "files", type=click.Path(readable=False), metavar="FILE...", nargs=-1, required=True
)
@click.option(
    "-o", "out", callback=_out, metavar="OUT", required=True, help="The page to write: .html."
)
@click.option("--title", metavar="TEXT", help="What stands above it, instead of the names.")
@strings_option
@click.option("-q", "--quiet", is_flag=True, help="No progress and no summary on stderr.")
def report(
    files: tuple[str, ...], out: str, title: str | None, strings: tuple[str, ...], quiet: bool
) -> None:
    """A page that shows whether a recording is good.

    Several FILEs are one recording that was split, joined in the given order; - is standard input.

    What is wrong comes first: lost samples, damage, errors, clipping, no fix. Below it timeline, status,
    track, a plot of every quantity, the noise of the sensors, and the tables of xbus info. The page is one
    file that needs nothing else, no network either. Log and page may be of any length and stay within
    bounded memory: of long stretches the extremes are drawn.

    OUT replaces what is there, and appears whole or not at all. It takes plotly, the extra report.
    """
    check(files, out)
    from xbus.report import gather, plotly_js, write_page

    plotly = plotly_js()
    with Progress(task(files[0]), shown=not quiet) as progress:
        with Input(files, progress) as source:
            gathered = gather(source, strings)
        facts = gathered.facts
        if not facts.stats.frames and not facts.stats.strings:
            raise no_frame(files, facts.stats.bytes)
        progress.update(f"writing {label(os.path.basename(out))}")  # noqa: PTH119 - pathlib is slow
        names = ", ".join(label(os.path.basename(it)) for it in files)  # noqa: PTH119
        with writing(out):
            write_page(gathered, out, title=names if title is None else title, plotly=plotly)
    if not quiet:
        click.echo(f"{label(out)}: {summary(facts)}", err=True)
