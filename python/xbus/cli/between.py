"""``--between``: a recording between two moments."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import TYPE_CHECKING

from xbus.cli.failure import Failure
from xbus.cli.input_options import InputOptions
from xbus.cli.inputs import Input
from xbus.cli.moments import Content, bounds_of
from xbus.cli.recordings import Recording
from xbus.cli.stored import Stored, stored_cut

if TYPE_CHECKING:
    from xbus.cli.progress import ShowsProgress
    from xbus.log.moments import Between

__all__ = ["CutRecording"]


class CutRecording:
    """The bytes of a recording between two moments, as `xbus cut` writes them.

    Args:
        between: The moments.
        inputs: How to read the recording.
        recording: The recording.
        source: The same, opened.
        progress: The progress bar to update.

    Attributes:
        source: The bytes, as an input of `read_log`. They have only the device that is wanted.

    Raises:
        Failure: The moments are not known.
    """

    def __init__(
        self,
        between: Between,
        inputs: InputOptions,
        recording: Recording,
        source: Input,
        progress: ShowsProgress,
    ) -> None:
        from xbus.log.cut_source import CutSource

        self._inputs, self._recording, self._input = inputs, recording, source
        self._content = Content(inputs)
        with self._errors():
            start, end = bounds_of(between, self._content, inputs, recording, progress)
        arrivals = source.arrivals()
        self._times_fault = None if arrivals is None else arrivals.fault
        self.source = CutSource(
            source,
            self._content.parts,
            start,
            end,
            bid=inputs.bid,
            arrivals=arrivals,
            is_owned=False,
        )

    @contextlib.contextmanager
    def _errors(self) -> Iterator[None]:
        from xbus.errors import DecodeError

        try:
            yield
        except DecodeError:
            raise
        except ValueError as error:
            raise Failure(f"{self._recording.heading}: {error}") from error

    @contextlib.contextmanager
    def reading(self) -> Iterator[None]:
        """Returns a context in which `source` is read.

        Raises:
            Failure: There are no frames, no times, or no samples between the moments.
        """
        with self._errors(), self._content.checked(self._input, self._recording.files):
            yield
            if not self.source.size:
                self._content.check()
                raise Failure(f"{self._recording.heading} has no samples between these times")

    @contextlib.contextmanager
    def stored(self) -> Iterator[Stored]:
        """Yields a temporary copy of the bytes, which can be read twice."""
        with contextlib.ExitStack() as stack:
            with self.reading():
                copy = stored_cut(
                    self.source,
                    rate=self._inputs.rate,
                    strings=self._inputs.strings,
                    legacy=self._inputs.legacy,
                    times_fault=self._times_fault,
                )
                found = stack.enter_context(copy)
            yield found
