"""Moments in a recording on the command line, and the recording between two of them."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import click

from xbus.cli.failure import Failure
from xbus.cli.input_options import InputOptions
from xbus.cli.inputs import STDIN, Input, no_frame
from xbus.cli.recordings import Recording

if TYPE_CHECKING:
    from xbus.cli.progress import ShowsProgress
    from xbus.log.arrivals import Arrivals
    from xbus.log.log import Log
    from xbus.log.moments import Between, Moment
    from xbus.log.source import Readable

__all__ = ["Content", "arrivals_of", "bounds_of", "moment", "time_errors"]


def moment(
    ctx: click.Context,  # noqa: ARG001 - click's signature
    param: click.Parameter,  # noqa: ARG001
    value: str | None,
) -> Moment | None:
    """Returns a moment: seconds, or UTC as text."""
    from xbus.log.moments import parse_moment

    if value is None:
        return None
    found: Moment = value
    with contextlib.suppress(ValueError):
        found = float(value)
    try:
        parse_moment(found)
    except ValueError as error:
        raise click.BadParameter(str(error)) from error
    return found


class Content:
    """Reads the parts of a recording, and counts its frames and strings."""

    def __init__(self, inputs: InputOptions) -> None:
        self._inputs = inputs
        self._found = 0

    def parts(self, source: Readable, bid: int | None = None) -> Iterator[Log]:
        """Yields the parts, of one device or of all."""
        from xbus.log.read import cut_parts

        options = self._inputs
        for part in cut_parts(
            source, rate=options.rate, strings=options.strings, legacy=options.legacy, bid=bid
        ):
            self._found += part.stats.frames + part.stats.strings
            yield part

    @contextlib.contextmanager
    def checked(self, source: Input, files: Sequence[str]) -> Iterator[None]:
        """Replaces the error of a recording in which nothing was found."""
        try:
            yield
        except ValueError as error:
            if self._found:
                raise
            raise no_frame(files, source.size, source.head) from error

    def check(self) -> None:
        """Raises ValueError if nothing was found so far."""
        if not self._found:
            raise ValueError("nothing was found")


def bounds_of(
    between: Between,
    content: Content,
    inputs: InputOptions,
    recording: Recording,
    progress: ShowsProgress,
) -> tuple[float, float]:
    """Returns moments as seconds since the first sample. For UTC, the recording is read.

    Raises:
        OrderError: The second moment is not after the first.
        ValueError: The recording has no valid UTC, or can be read only once.
    """
    from xbus.log.moments import seconds_of

    files = recording.files

    def parts() -> Iterator[Log]:
        if STDIN in files:
            raise ValueError(
                "UTC needs an input that can be read twice; save it to a file first, or use seconds"
            )
        with inputs.opened(files, progress) as source, content.checked(source, files):
            yield from content.parts(source, bid=inputs.bid)
            content.check()

    return seconds_of(between, parts)


def arrivals_of(source: Input) -> Arrivals | None:
    """Returns the arrivals of the bytes of a recording, and prints what is wrong with a side file."""
    arrivals = source.arrivals()
    if arrivals is not None and arrivals.fault:
        click.echo(f"xbus: {arrivals.fault}", err=True)
    return arrivals


@contextlib.contextmanager
def time_errors(recording: Recording) -> Iterator[None]:
    """Converts the error of a wrong time to a UsageError, and that of an unknown time to a Failure."""
    from xbus.log.moments import OrderError

    try:
        yield
    except OrderError as error:
        raise click.UsageError(str(error)) from error
    except ValueError as error:
        raise Failure(f"{recording.heading}: {error}") from error
