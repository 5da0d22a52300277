"""Recordings that can be read twice: the files themselves, or a temporary copy of what a stream holds."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

from xbus.cli.failure import Failure, cannot
from xbus.cli.inputs import Input

__all__ = ["Stored", "stored"]

#: Bytes that are copied at a time.
STEP = 1 << 20


@dataclass(frozen=True)
class Stored:
    """A recording that can be read twice.

    Attributes:
        source: A path, or those of the pieces, as `split_log` takes them.
        size: Its size in bytes.
        times_fault: What is wrong with the side file of arrivals of the original, or None.
    """

    source: str | list[str]
    size: int
    times_fault: str | None = None


@contextmanager
def stored(source: Input, files: Sequence[str]) -> Iterator[Stored]:
    """Yields a recording that can be read twice.

    Standard input, pipes, URLs, compressed files and hex text are copied to a temporary file, with their
    arrivals beside it. It is deleted in the end.

    Args:
        source: The recording, which is not read if its files can be read twice.
        files: Its files.

    Raises:
        Failure: An input cannot be read, or the temporary file cannot be written.
    """
    if source.total is not None:
        yield Stored(files[0] if len(files) == 1 else list(files), source.total)
        return
    import tempfile

    try:
        folder = tempfile.TemporaryDirectory(prefix="xbus-", ignore_cleanup_errors=True)
    except OSError as error:
        raise _no_copy(tempfile.gettempdir(), error) from error
    with folder as name:
        yield _copy(source, name)


def _no_copy(folder: str, error: OSError) -> Failure:
    return cannot(f"copy the input to a temporary file in {folder} (set TMPDIR to another)", error)


def _copy(source: Input, folder: str) -> Stored:
    path = os.path.join(folder, "copy.mtb")  # noqa: PTH118 - pathlib is slow to import
    arrivals = source.arrivals()
    try:
        with open(path, "wb", buffering=0) as copy:  # noqa: PTH123
            while data := source.read(STEP):
                view = memoryview(data)
                while view:
                    view = view[copy.write(view) :]
        if arrivals is not None:
            from xbus.log.arrivals import SUFFIX

            with open(path + SUFFIX, "wb") as side:  # noqa: PTH123
                side.write(arrivals.to_bytes())
    except OSError as error:
        raise _no_copy(os.path.dirname(folder), error) from error  # noqa: PTH120
    return Stored(path, source.size, None if arrivals is None else arrivals.fault)
