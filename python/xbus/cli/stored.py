"""Recordings that can be read twice: the files themselves, or a temporary copy of what a stream holds."""

from __future__ import annotations

import functools
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

from xbus.cli.failure import Failure, cannot
from xbus.cli.inputs import Input

if TYPE_CHECKING:
    from xbus.log.cut_source import CutSource
    from xbus.log.parts import LogPart

__all__ = ["Stored", "stored", "stored_cut"]

#: Bytes that are copied at a time.
STEP = 1 << 20


@dataclass(frozen=True)
class Stored:
    """A recording that can be read twice.

    Attributes:
        source: A path, or those of the pieces, as `split_log` takes them.
        size: Its size in bytes.
        split: Returns its parts, as `split_log` with the same options.
        times_fault: What is wrong with the side file of arrivals of the original, or None.
    """

    source: str | list[str]
    size: int
    split: Callable[..., list[LogPart]]
    times_fault: str | None = None

    @classmethod
    def of(cls, source: str | list[str], size: int, times_fault: str | None = None) -> Stored:
        """Returns a recording in files."""
        from xbus.log.parts import split_log

        return cls(source, size, functools.partial(split_log, source), times_fault)


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
        yield Stored.of(files[0] if len(files) == 1 else list(files), source.total)
        return
    with _temporary_folder() as folder:
        yield _copy(source, folder)


@contextmanager
def stored_cut(
    cut: CutSource,
    *,
    rate: float | None,
    strings: Sequence[str],
    legacy: Sequence[tuple[int, int]],
    times_fault: str | None,
) -> Iterator[Stored]:
    """Yields a recording between two times, which is copied to a temporary file that is deleted in the end.

    Args:
        cut: The bytes between the times.
        rate: As in `read_log`.
        strings: As in `read_log`.
        legacy: As in `read_log`.
        times_fault: As for `Stored`.

    Raises:
        Failure: The temporary file cannot be written.
        ValueError: As `xbus.log.cutting.cut`.
    """
    from xbus.log.cut_parts import copy_cut

    with _temporary_folder() as folder:
        path = os.path.join(folder, "cut.mtb")  # noqa: PTH118 - pathlib is slow to import
        try:
            copy = copy_cut(cut, path, rate=rate, strings=strings, legacy=legacy)
        except OSError as error:
            raise _no_copy(os.path.dirname(folder), error) from error  # noqa: PTH120
        yield Stored(path, copy.size, copy.split, times_fault)


@contextmanager
def _temporary_folder() -> Iterator[str]:
    import tempfile

    try:
        folder = tempfile.TemporaryDirectory(prefix="xbus-", ignore_cleanup_errors=True)
    except OSError as error:
        raise _no_copy(tempfile.gettempdir(), error) from error
    with folder as name:
        yield name


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
                side.writelines(arrivals.blocks())
    except OSError as error:
        raise _no_copy(os.path.dirname(folder), error) from error  # noqa: PTH120
    return Stored.of(path, source.size, None if arrivals is None else arrivals.fault)
