"""A file format that is written part by part."""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from contextlib import AbstractContextManager
from typing import ClassVar, Protocol

from xbus.export.part import Part
from xbus.protocol.keys import EntryKey

__all__ = ["ExportError", "Format", "Survey", "Writer", "export"]


class ExportError(ValueError):
    """A log has nothing that a format can hold, or more than it can hold."""


class Writer(Protocol):
    """Writes the parts of a log to a file."""

    def write(self, part: Part) -> None:
        """Writes the next part.

        Raises:
            ExportError: The format cannot hold the part.
        """
        ...

    @property
    def counts(self) -> dict[str, int]:
        """What was written so far, by its name in the singular: ``{"point": 400, "segment": 1}``.

        Also when the file is complete.
        """
        ...


class Survey(Protocol):
    """Sees all parts of a log before the first one is written.

    Attributes:
        quantities: What it needs to see; the columns of others may be missing.
    """

    quantities: Sequence[EntryKey]

    def add(self, part: Part) -> None:
        """Adds the next part."""
        ...

    @property
    def format(self) -> Format:
        """The format that writes the log, with what was found."""
        ...


class Format(ABC):
    """A file format and its options, which are the attributes of the subclass.

    The same parts, however a log is divided, give the same file.

    Attributes:
        needs_samples: Whether a log without samples has nothing to write.
        most_samples: The most samples that a file can hold; None without a limit.
        always: Names of quantities that are read although others are chosen, because they decide which
            values count, and when.
    """

    needs_samples: ClassVar[bool] = True
    most_samples: ClassVar[int | None] = None
    always: ClassVar[tuple[str, ...]] = ()

    @abstractmethod
    def quantities(self, shape: Part) -> Sequence[EntryKey] | None:
        """Returns which quantities of a log the file needs, so that others need not be decoded; None for all.

        `Part.utc` needs `UTC_SOURCES`.

        Args:
            shape: The log, or one without samples that has its columns.

        Raises:
            ExportError: The log lacks what the format needs.
        """

    def survey(self, shape: Part) -> Survey | None:  # noqa: ARG002 - for formats that have one
        """Returns what has to see all parts before the first one is written; None if nothing has to.

        Args:
            shape: As in `quantities`.
        """
        return None

    def check(self, samples: int) -> None:
        """Raises ExportError if a log has more samples than the file can hold."""
        if self.most_samples is not None and samples > self.most_samples:
            raise ExportError(
                f"{samples:,} samples are more than the {self.most_samples:,} that the format can hold; "
                "choose a part with between=, or another format"
            )

    @abstractmethod
    def open(self, path: str | os.PathLike[str], shape: Part) -> AbstractContextManager[Writer]:
        """Returns a context that writes a file, or several.

        They appear when the context ends. If it ends with an error, nothing appears.

        Args:
            path: Path of the file.
            shape: As in `quantities`.
        """


def export(
    file_format: Format,
    shape: Part,
    parts: Iterable[Part],
    path: str | os.PathLike[str],
    *,
    surveyed: Iterable[Part] | None = None,
) -> dict[str, int]:
    """Writes a log to a file, which appears whole or not at all.

    Args:
        file_format: The format.
        shape: The log, or one without samples that has its columns.
        parts: The log, or its parts in order.
        path: Path of the file.
        surveyed: The same parts for `Format.survey`; None if ``parts`` can be iterated twice.

    Returns:
        What was written, as `Writer.counts`.

    Raises:
        ExportError: The log has nothing that the format can hold, or more than it can hold.
        OSError: The file cannot be written.
    """
    file_format.quantities(shape)  # raises if something is missing
    if (survey := file_format.survey(shape)) is not None:
        for part in parts if surveyed is None else surveyed:
            survey.add(part)
        file_format = survey.format
    with file_format.open(path, shape) as writer:
        for part in parts:
            writer.write(part)
    return writer.counts
