"""Work on many recordings: in parallel, with one progress bar and a summary of all."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import click
from click.core import ParameterSource

from xbus.cli.failure import Failure, cannot, failure_of
from xbus.cli.inputs import STDIN, label
from xbus.cli.printing import align, print_json
from xbus.cli.progress import Progress, ShowsProgress
from xbus.cli.recordings import Recording
from xbus.files import is_url, local_name, uncompressed_name
from xbus.formatting import format_count

__all__ = [
    "Job",
    "Outcome",
    "batch_options",
    "check_targets",
    "finish",
    "jobs_option",
    "plan",
    "run",
]

jobs_option = click.option(
    "--jobs",
    type=click.IntRange(min=1),
    metavar="N",
    help="Number of recordings to work on at once. Default: one per core.",
)


def batch_options(command: Callable[..., None]) -> Callable[..., None]:
    """Adds the options of commands that write one file for each recording."""
    for option in (
        jobs_option,
        click.option(
            "--skip-existing", is_flag=True, help="Leave out recordings whose output file exists."
        ),
        click.option(
            "--out-dir",
            metavar="DIR",
            help="Write one file for each recording to this folder, which is created if necessary.",
        ),
    ):
        command = option(command)
    return command


def check_targets(out: str | None, out_dir: str | None) -> None:
    """Checks the options about output files.

    Raises:
        UsageError: None or both are given, or an option that only --out-dir has.
    """
    if out is not None and out_dir is not None:
        raise click.UsageError(
            "-o writes one file and --out-dir one for each recording; remove one"
        )
    if out is None and out_dir is None:
        raise click.UsageError(
            "the output is missing; add -o OUT, or --out-dir DIR for several files"
        )
    if out_dir is None:
        ctx = click.get_current_context()
        for param in ctx.command.params:
            if (
                param.name in ("jobs", "skip_existing", "suffix")
                and not (param.name == "suffix" and out is not None and out.endswith(("/", os.sep)))
                and ctx.get_parameter_source(param.name) == ParameterSource.COMMANDLINE
            ):
                raise click.UsageError(f"{param.opts[-1]} needs --out-dir")


@dataclass(frozen=True)
class Job:
    """A recording and the file to write; `out` is None if nothing is written."""

    recording: Recording
    out: str | None


@dataclass
class Outcome:
    """How a job ended.

    Attributes:
        job: The job.
        text: What was written, or why not, in a few words.
        values: The same as values for JSON.
        failure: Why it failed, or None.
    """

    job: Job
    text: str = ""
    values: dict[str, Any] = field(default_factory=dict)
    failure: Failure | None = None
    is_skipped: bool = False

    def show_problems(self) -> None:
        """Prints what is unusual about the pieces, and the failure, on stderr."""
        self.job.recording.show_notes()
        if self.failure is not None:
            self.failure.show()


#: Does a job, and returns its text and its values.
Work = Callable[[Job, ShowsProgress], tuple[str, dict[str, Any]]]


def plan(recordings: Sequence[Recording], folder: str, suffix: str) -> list[Job]:
    """Returns the jobs that write a file for each recording.

    Recordings of several folders are written to subfolders of the same names.

    Args:
        recordings: The recordings.
        folder: The folder to write to. It is created.
        suffix: The suffix of the files; a slash if each recording is written to a folder.

    Raises:
        Failure: The folder cannot be created.
        UsageError: Two recordings have the same output file.
    """
    paths = [local_name(recording.files[0]) for recording in recordings]
    local = [path for path in paths if path != STDIN and not is_url(path)]
    folders = [os.path.dirname(os.path.abspath(path)) for path in local]  # noqa: PTH100, PTH120
    common = os.path.commonpath(folders) if folders else ""
    outs: dict[str, str] = {}
    jobs = []
    for path, recording in zip(paths, recordings, strict=True):
        name = "standard-input" if path == STDIN else os.path.basename(path.rstrip("/"))  # noqa: PTH119
        stem, _ = os.path.splitext(uncompressed_name(name))  # noqa: PTH122
        subfolder = ""
        if path in local:
            subfolder = os.path.relpath(os.path.dirname(os.path.abspath(path)), common)  # noqa: PTH100, PTH120
        out = os.path.normpath(os.path.join(folder, subfolder, stem + suffix))  # noqa: PTH118
        if out in outs:
            raise click.UsageError(
                f"{label(outs[out])} and {recording.name} would both be written to {label(out)}; use a "
                "folder for each"
            )
        outs[out] = recording.files[0]
        jobs.append(Job(recording, out))
    for out in outs:
        try:
            os.makedirs(os.path.dirname(out) or ".", exist_ok=True)  # noqa: PTH103, PTH120
        except OSError as error:
            raise cannot(f"create the folder {label(os.path.dirname(out))}", error) from error  # noqa: PTH120
    return jobs


class _Interrupted(BaseException):
    """Ends a job because the command was interrupted."""


class _SharedProgress:
    """Adds up the progress of several jobs: reading is the first half of each, writing the second."""

    def __init__(self, bar: Progress, jobs: Sequence[Job]) -> None:
        self._bar, self._lock = bar, threading.Lock()
        self._sizes = [_size(job.recording) for job in jobs]
        self._done = [0.0] * len(jobs)
        self._finished = 0
        self.is_stopped = False

    def finish(self, number: int) -> None:
        """Counts a job as finished."""
        with self._lock:
            self._done[number] = self._sizes[number]
            self._finished += 1
            self._show()

    def update(self, number: int, *, is_writing: bool, share: float) -> None:
        """Sets how much of the reading or writing of a job is done, from 0 to 1."""
        if self.is_stopped:
            raise _Interrupted
        with self._lock:
            self._done[number] = self._sizes[number] * (share + is_writing) / 2
            self._show()

    def _show(self) -> None:
        count = f"{self._finished:,} of {format_count(len(self._sizes), 'recording')}"
        self._bar.update(count, int(sum(self._done)), sum(self._sizes) or None)


class _JobProgress:
    """The progress of one of several jobs."""

    def __init__(self, shared: _SharedProgress, number: int) -> None:
        self._shared, self._number = shared, number

    def update(self, task: str, done: int = 0, total: int | None = None) -> None:
        """Sets what is being done, and how far that is."""
        share = min(done / total, 1.0) if total else 0.0
        self._shared.update(self._number, is_writing=task.startswith("writing "), share=share)


def _size(recording: Recording) -> int:
    """Returns the size of the local files in bytes."""
    size = 0
    for file in recording.files:
        try:
            size += 0 if file == STDIN or is_url(file) else os.stat(local_name(file)).st_size  # noqa: PTH116
        except OSError:
            continue  # reading reports the error
    return size


def run(
    jobs: Sequence[Job], work: Work, *, workers: int | None, skip_existing: bool, quiet: bool
) -> list[Outcome]:
    """Does jobs in parallel and returns how each ended, in order. One that fails does not stop the others.

    Args:
        jobs: The jobs.
        work: Does a job.
        workers: Number of jobs at once; None for one per core.
        skip_existing: Leave out jobs whose output file exists.
        quiet: Show no progress.
    """
    from concurrent.futures import ThreadPoolExecutor, as_completed

    outcomes = [Outcome(job) for job in jobs]
    for outcome in outcomes:
        out = outcome.job.out
        if skip_existing and out is not None and os.path.exists(out):  # noqa: PTH110
            outcome.is_skipped, outcome.text, outcome.values = True, "skipped", {"skipped": True}
    waiting = [at for at, outcome in enumerate(outcomes) if not outcome.is_skipped]
    with Progress("", shown=not quiet) as bar:
        if len(waiting) == 1:  # in this thread, which Ctrl-C interrupts
            _attempt(outcomes[waiting[0]], work, bar)
            return outcomes
        shared = _SharedProgress(bar, [jobs[at] for at in waiting])
        with ThreadPoolExecutor(workers or os.cpu_count()) as pool:
            futures = {
                pool.submit(_attempt, outcomes[at], work, _JobProgress(shared, number)): number
                for number, at in enumerate(waiting)
            }
            try:
                for future in as_completed(futures):
                    future.result()
                    shared.finish(futures[future])
            except BaseException:
                shared.is_stopped = True
                pool.shutdown(wait=False, cancel_futures=True)
                raise
    return outcomes


def _attempt(outcome: Outcome, work: Work, progress: ShowsProgress) -> None:
    try:
        outcome.text, outcome.values = work(outcome.job, progress)
    except Exception as error:
        outcome.failure = failure_of(error)
        if outcome.failure is None:
            raise
        outcome.text, outcome.values = "failed", {"error": outcome.failure.message}


def finish(outcomes: Sequence[Outcome], *, quiet: bool, as_json: bool) -> None:
    """Prints the failures and a summary of all jobs.

    Raises:
        Exit: A job failed.
    """
    for outcome in outcomes:
        outcome.show_problems()
    if as_json:
        print_json(
            [
                {"files": outcome.job.recording.files, "out": outcome.job.out} | outcome.values
                for outcome in outcomes
            ]
        )
    if not quiet:
        for line in _summary(outcomes):
            click.echo(line, err=True)
    check_failures(outcomes)


def check_failures(outcomes: Sequence[Outcome]) -> None:
    """Ends the command if a job failed.

    Raises:
        Exit: A job failed.
    """
    if any(outcome.failure is not None for outcome in outcomes):
        raise click.exceptions.Exit(1)


def _summary(outcomes: Sequence[Outcome]) -> Iterator[str]:
    rows = [(outcome.job.recording.name, outcome.text.replace("\n", "; ")) for outcome in outcomes]
    yield from align([("recording", "result"), *rows])
    failed = sum(outcome.failure is not None for outcome in outcomes)
    skipped = sum(outcome.is_skipped for outcome in outcomes)
    parts = [f"{format_count(len(outcomes) - failed - skipped, 'recording')} done"]
    parts += [f"{skipped:,} skipped"] if skipped else []
    parts += [f"{failed:,} failed"] if failed else []
    yield ", ".join(parts)
