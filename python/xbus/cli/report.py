"""``xbus report``: an HTML report about a recording."""

from __future__ import annotations

import os

import click

from xbus.cli.export_target import check_output, quality_text, writing
from xbus.cli.inputs import Input, label, no_frame, reading_task, strings_option
from xbus.cli.progress import Progress

__all__ = ["report"]


def _out(ctx: click.Context, param: click.Parameter, value: str) -> str:  # noqa: ARG001 - click's
    """Returns a path with the suffix of an HTML page."""
    if not value.lower().endswith((".html", ".htm")):
        raise click.BadParameter(f"{value!r} must end in .html")
    return value


@click.command(epilog="Example: xbus report walk.mtb -o walk.html")
@click.argument(
    "files", type=click.Path(readable=False), metavar="FILE...", nargs=-1, required=True
)
@click.option("-o", "out", callback=_out, metavar="OUT", required=True, help="HTML file to write.")
@click.option("--title", metavar="TEXT", help="Title of the page. Default: the names of the files.")
@strings_option
@click.option("-q", "--quiet", is_flag=True, help="Show no progress and no summary on stderr.")
def report(
    files: tuple[str, ...], out: str, title: str | None, strings: tuple[str, ...], quiet: bool
) -> None:
    """Creates an HTML report about a recording.

    Several FILEs are joined in the given order, as pieces of one recording; - is standard input.

    Problems come first: lost samples, damage, errors, clipping, no fix. Below are a timeline, status, track,
    plots of every quantity, sensor noise, and the tables of xbus info. The report is one HTML file that needs
    no network. A recording of any length fits into memory: plots of long recordings show the minimum and
    maximum of each interval.

    An existing OUT is replaced, and a failed run leaves no partial file. Requires the extra: pip install
    "xbus-mti[report]".
    """
    check_output(files, out)
    from xbus.report import gather, plotly_js, write_page

    plotly = plotly_js()
    with Progress(reading_task(files[0]), shown=not quiet) as progress:
        with Input(files, progress) as source:
            data = gather(source, strings)
        stats = data.summary.stats
        if not stats.frames and not stats.strings:
            raise no_frame(files, stats.bytes)
        progress.update(f"writing {label(os.path.basename(out))}")  # noqa: PTH119 - pathlib is slow
        names = ", ".join(label(os.path.basename(file)) for file in files)  # noqa: PTH119
        with writing(out):
            write_page(data, out, title=names if title is None else title, plotly=plotly)
    if not quiet:
        click.echo(f"{label(out)}: {quality_text(data.summary)}", err=True)
