"""``xbus info``: the content of a log."""

from __future__ import annotations

from typing import Any

import click

from xbus.cli import batch
from xbus.cli.can_options import CanOptions, can_options
from xbus.cli.export_target import quality_text, writing
from xbus.cli.input_options import InputOptions, input_options
from xbus.cli.inputs import no_frame
from xbus.cli.printing import print_json, print_line
from xbus.cli.progress import ShowsProgress

__all__ = ["info"]

#: Bytes of input in memory at a time. Hostile input needs up to 30 times as much memory.
BLOCK = 4 << 20


@click.command(epilog="Example: xbus info walk.mtb")
@input_options()
@can_options
@batch.batch_options
@click.option("-q", "--quiet", is_flag=True, help="Show no progress.")
@click.option(
    "--json", "as_json", is_flag=True, help="Print a JSON list with an object for each recording."
)
def info(
    inputs: InputOptions,
    can: CanOptions,
    out_dir: str | None,
    skip_existing: bool,
    jobs: int | None,
    quiet: bool,
    as_json: bool,
) -> None:
    """Describes logs: device, times, quantities, gaps, damage.

    IN is a file, a folder, a pattern ("*.mtb"), a URL, or - for standard input. The pieces of one recording
    (walk.mtb, walk-0001.mtb, ...) are described together, other files separately. Sizes and offsets are in
    bytes, times in seconds, rates as measured. The JSON lists gaps, places of damage, errors and runs, the
    first 100,000 of each; "totals" has the number of all. Unknown values are null. An unreadable IN has the
    keys "file" and "error". A recording of any length fits into memory.

    IN can also be a CAN capture: .asc, .blf, .trc, .mf4, .log of candump, or .csv of python-can. "findings"
    lists what is unusual in it, and "bytes" is the number of data bytes of its frames.

    With --out-dir, the JSON object of each recording is written to a file, and a summary has one line each.
    """
    from xbus.cli.info_text import info_text
    from xbus.describe.log_summary import LogSummary
    from xbus.log.read import iter_log

    def describe(job: batch.Job, progress: ShowsProgress) -> tuple[str, dict[str, Any]]:
        files = job.recording.files
        with inputs.checked_rate(job.recording) as use:
            if can.check(inputs, files):
                found: list[str] = []
                summary = LogSummary(use.watch(can.parts(inputs, files, progress, found)))
                summary.capture_findings = tuple(found)
            else:
                with inputs.opened(files, progress) as source:
                    parts = iter_log(source, block_bytes=BLOCK, **inputs.for_log)
                    summary = LogSummary(use.watch(parts))
                if not summary.stats.frames and not summary.stats.strings:
                    raise no_frame(files, summary.stats.bytes, source.head)
        if job.out is None and not as_json:
            return info_text(job.recording.heading, summary), {}
        findings = list(summary.capture_findings or ())
        values = summary.to_dict(files[0]) | {"files": files, "findings": findings}
        if job.out is None:
            return "", values
        from xbus.describe.json_text import json_pieces
        from xbus.export.replacing import replacing

        with writing(job.out), replacing(job.out) as file:
            for piece in json_pieces(values):
                file.write(piece.encode())
            file.write(b"\n")
        is_capture = summary.capture_findings is not None
        return quality_text(summary, is_capture=is_capture), values if as_json else {}

    if skip_existing and out_dir is None:
        raise click.UsageError("--skip-existing needs --out-dir")
    recordings = inputs.recordings()
    if out_dir is None:
        work = [batch.Job(recording, None) for recording in recordings]
    else:
        work = batch.plan(recordings, out_dir, ".json")
    outcomes = batch.run(work, describe, workers=jobs, skip_existing=skip_existing, quiet=quiet)
    if out_dir is not None:
        batch.finish(outcomes, quiet=quiet, as_json=as_json)
        return
    for outcome in outcomes:
        outcome.show_problems()
        if outcome.failure is None and not as_json:
            end = "\n" if len(outcomes) > 1 else ""
            print_line(outcome.text + end, flush=True)
    if as_json:
        print_json(
            [{"file": outcome.job.recording.files[0]} | outcome.values for outcome in outcomes]
        )
    batch.check_failures(outcomes)
