"""``xbus report``: HTML reports about recordings."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import click

from xbus.cli import batch
from xbus.cli.can_options import CanOptions, can_options
from xbus.cli.export_target import check_output, quality_text, writing
from xbus.cli.input_options import InputOptions, input_options
from xbus.cli.inputs import label, no_frame, reading_task
from xbus.cli.printing import print_json
from xbus.cli.progress import Progress, ShowsProgress
from xbus.cli.recordings import Recording
from xbus.cli.undecoded import check_decoded

if TYPE_CHECKING:
    from xbus.report.data import ReportData

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
@can_options
@click.option("-o", "out", callback=_out, metavar="OUT", help="HTML file to write.")
@batch.batch_options
@click.option("--spectrum", is_flag=True, help="Add the spectrum of acceleration and rate of turn.")
@click.option("--spectrogram", is_flag=True, help="Add their spectrum over time.")
@click.option(
    "--map",
    "base_map",
    is_flag=True,
    help="Add a map below the track. The browser of each reader loads it from basemaps.cartocdn.com.",
)
@click.option("--title", metavar="TEXT", help="Title of the page. Default: the names of the files.")
@click.option("-q", "--quiet", is_flag=True, help="Show no progress and no summary on stderr.")
@click.option(
    "--json",
    "as_json",
    is_flag=True,
    help="Print the summary on stdout: a JSON object, or a list of them for several recordings.",
)
def report(
    inputs: InputOptions,
    can: CanOptions,
    out: str | None,
    out_dir: str | None,
    skip_existing: bool,
    jobs: int | None,
    spectrum: bool,
    spectrogram: bool,
    base_map: bool,
    title: str | None,
    quiet: bool,
    as_json: bool,
) -> None:
    """Creates HTML reports about recordings.

    IN is a file, a folder, a pattern ("*.mtb"), a URL, or - for standard input. The pieces of one recording
    (walk.mtb, walk-0001.mtb, ...) are joined in their order. Different recordings are never joined: -o shows
    them side by side, and --out-dir writes one report for each.

    Problems come first: lost samples, damage, errors, clipping, no fix. Below are a timeline, status, track,
    plots of every quantity, sensor noise, and the tables of xbus info. The report is one HTML file that needs
    no network, except for --map. A recording of any length fits into memory: plots of long recordings show
    the minimum and maximum of each interval.

    An existing OUT is replaced, and a failed run leaves no partial file. Requires the extra: pip install
    "xbus-mti[report]".
    """
    batch.check_targets(out, out_dir)
    from xbus.log.read import iter_log
    from xbus.report import BLOCK, Options, gather_parts, plotly_js, write_page

    plotly = plotly_js()
    options = Options(spectrum, spectrogram, base_map)

    def read(recording: Recording, progress: ShowsProgress) -> ReportData:
        files = recording.files
        with inputs.checked_rate(recording) as use:
            if can.check(inputs, files):
                found: list[str] = []
                data = gather_parts(use.watch(can.parts(inputs, files, progress, found)), options)
                data.summary.capture_findings = tuple(found)
                recording.notes.extend(found)
                return data
            with inputs.opened(files, progress) as source:
                parts = use.watch(iter_log(source, block_bytes=BLOCK, **inputs.for_log))
                data = gather_parts(parts, options)
        stats = data.summary.stats
        if not stats.frames and not stats.strings:
            raise no_frame(files, stats.bytes, source.head)
        check_decoded(data.summary, ", ".join(map(label, files)))
        return data

    def write(
        reports: list[tuple[str, ReportData]], out: str, progress: ShowsProgress
    ) -> list[tuple[str, dict[str, Any]]]:
        progress.update(f"writing {label(os.path.basename(out))}")  # noqa: PTH119 - pathlib is slow
        heading = ", ".join(name for name, _ in reports) if title is None else title
        with writing(out):
            write_page(reports, out, title=heading, plotly=plotly)
        return [_outcome(data) for _, data in reports]

    def report_on(job: batch.Job, progress: ShowsProgress) -> tuple[str, dict[str, Any]]:
        assert job.out is not None  # noqa: S101 - jobs of this command write files
        check_output(job.recording.files, job.out)
        data = read(job.recording, progress)
        return write([(job.recording.title, data)], job.out, progress)[0]

    if out_dir is not None:
        work = batch.plan(inputs.recordings(), out_dir, ".html")
        outcomes = batch.run(
            work, report_on, workers=jobs, skip_existing=skip_existing, quiet=quiet
        )
        batch.finish(outcomes, quiet=quiet, as_json=as_json)
        return
    assert out is not None  # noqa: S101 - see `check_targets`
    recordings = inputs.joined_recordings()
    for recording in recordings:
        check_output(recording.files, out)
        recording.show_notes()
    with Progress(reading_task(recordings[0].files[0]), shown=not quiet) as progress:
        reports = [
            (name, read(recording, progress))
            for name, recording in zip(_names(recordings), recordings, strict=True)
        ]
        found = write(reports, out, progress)
    for recording in recordings:
        recording.show_notes()
    if as_json:
        values = [
            {"files": recording.files, "out": out} | outcome
            for recording, (_, outcome) in zip(recordings, found, strict=True)
        ]
        print_json(values if len(values) > 1 else values[0])
    if not quiet:
        for (name, _), (text, _) in zip(reports, found, strict=True):
            about = f"{name}: " if len(reports) > 1 else ""
            click.echo(f"{label(out)}: {about}{text}", err=True)


def _names(recordings: Sequence[Recording]) -> list[str]:
    """Returns names of recordings for a page, with folders if names without them are the same."""
    names = [recording.title for recording in recordings]
    return names if len(set(names)) == len(names) else [one.heading for one in recordings]


def _outcome(data: ReportData) -> tuple[str, dict[str, Any]]:
    """Returns what was read, in words and as values."""
    summary = data.summary
    is_capture = summary.capture_findings is not None
    return quality_text(summary, is_capture=is_capture), asdict(summary.stats) | {
        "damage": len(summary.damage)
    }
