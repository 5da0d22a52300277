"""``xbus report``: HTML reports about recordings."""

from __future__ import annotations

import os
from dataclasses import asdict
from typing import Any

import click

from xbus.cli import batch
from xbus.cli.export_target import check_output, quality_text, writing
from xbus.cli.input_options import InputOptions, input_options
from xbus.cli.inputs import label, no_frame, reading_task
from xbus.cli.printing import print_json
from xbus.cli.progress import Progress, ShowsProgress
from xbus.cli.undecoded import check_decoded

__all__ = ["report"]


def _out(
    ctx: click.Context,  # noqa: ARG001 - click's signature
    param: click.Parameter,  # noqa: ARG001
    value: str | None,
) -> str | None:
    """Returns a path with the suffix of an HTML page."""
    if value is not None and not value.lower().endswith((".html", ".htm")):
        raise click.BadParameter(f"{value!r} must end in .html")
    return value


@click.command(epilog="Example: xbus report walk.mtb -o walk.html")
@input_options()
@click.option("-o", "out", callback=_out, metavar="OUT", help="HTML file to write.")
@batch.batch_options
@click.option("--title", metavar="TEXT", help="Title of the page. Default: the names of the files.")
@click.option("-q", "--quiet", is_flag=True, help="Show no progress and no summary on stderr.")
@click.option(
    "--json",
    "as_json",
    is_flag=True,
    help="Print the summary on stdout: a JSON object, or a list of them with --out-dir.",
)
def report(
    inputs: InputOptions,
    out: str | None,
    out_dir: str | None,
    skip_existing: bool,
    jobs: int | None,
    title: str | None,
    quiet: bool,
    as_json: bool,
) -> None:
    """Creates HTML reports about recordings.

    IN is a file, a folder, a pattern ("*.mtb"), a URL, or - for standard input. The pieces of one recording
    (walk.mtb, walk-0001.mtb, ...) are joined in their order. Different recordings are never joined: --out-dir
    writes one report for each.

    Problems come first: lost samples, damage, errors, clipping, no fix. Below are a timeline, status, track,
    plots of every quantity, sensor noise, and the tables of xbus info. The report is one HTML file that needs
    no network. A recording of any length fits into memory: plots of long recordings show the minimum and
    maximum of each interval.

    An existing OUT is replaced, and a failed run leaves no partial file. Requires the extra: pip install
    "xbus-mti[report]".
    """
    batch.check_targets(out, out_dir)
    from xbus.log.read import iter_log
    from xbus.report import BLOCK, gather_parts, plotly_js, write_page

    plotly = plotly_js()

    def write(job: batch.Job, progress: ShowsProgress) -> tuple[str, dict[str, Any]]:
        files, target = job.recording.files, job.out
        assert target is not None  # noqa: S101 - jobs of this command write files
        check_output(files, target)
        with inputs.opened(files, progress) as source, inputs.checked_rate(job.recording) as use:
            data = gather_parts(use.watch(iter_log(source, block_bytes=BLOCK, **inputs.for_log)))
        stats = data.summary.stats
        if not stats.frames and not stats.strings:
            raise no_frame(files, stats.bytes, source.head)
        check_decoded(data.summary, ", ".join(map(label, files)))
        progress.update(f"writing {label(os.path.basename(target))}")  # noqa: PTH119 - pathlib is slow
        heading = job.recording.title if title is None else title
        with writing(target):
            write_page(data, target, title=heading, plotly=plotly)
        return quality_text(data.summary), asdict(stats) | {"damage": len(data.summary.damage)}

    if out_dir is not None:
        work = batch.plan(inputs.recordings(), out_dir, ".html")
        outcomes = batch.run(work, write, workers=jobs, skip_existing=skip_existing, quiet=quiet)
        batch.finish(outcomes, quiet=quiet, as_json=as_json)
        return
    assert out is not None  # noqa: S101 - see `check_targets`
    recording = inputs.recording()
    recording.show_notes()
    with Progress(reading_task(recording.files[0]), shown=not quiet) as progress:
        text, values = write(batch.Job(recording, out), progress)
    recording.show_notes()
    if as_json:
        print_json({"files": recording.files, "out": out} | values)
    if not quiet:
        click.echo(f"{label(out)}: {text}", err=True)
