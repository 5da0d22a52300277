"""The options of ``xbus decode`` that write a folder of files."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass

import click

from xbus.cli.export_target import writing
from xbus.cli.failure import Failure
from xbus.cli.inputs import label
from xbus.cli.rotation import parse_size
from xbus.export.replacing import ForeignFilesError, check_replaceable

__all__ = ["Dataset", "check_folder", "dataset_options", "foreign_files", "is_folder"]


@dataclass(frozen=True)
class Dataset:
    """How a table is divided into files.

    Attributes:
        suffix: Suffix of the files.
        size: A file with this many bytes is followed by another one.
        by_hour: Whether each hour has a folder.
    """

    suffix: str
    size: int
    by_hour: bool


def is_folder(out: str) -> bool:
    """Returns whether a path is that of a folder, because it ends with a slash."""
    return out.endswith(("/", os.sep))


def check_folder(out: str) -> None:
    """Raises the errors of a folder OUT that can be known before reading, which may take long."""
    with writing(out):
        os.stat(os.path.dirname(os.path.abspath(out)))  # noqa: PTH100, PTH116, PTH120 - pathlib is slow to import
        try:
            check_replaceable(out)
        except ForeignFilesError as error:
            raise foreign_files(out, error) from error
        if os.path.isdir(out) and os.path.samefile(out, os.curdir):  # noqa: PTH112, PTH121
            # The shell would stay in the folder of before, which is deleted.
            raise Failure(
                f"{label(out)} is the working directory, which cannot be replaced; choose another folder"
            )


def foreign_files(out: str, error: ForeignFilesError) -> Failure:
    """Returns the failure of a folder that is not replaced."""
    return Failure(
        f"{label(out)} is not replaced, because it {error}; move them, or choose another folder"
    )


def _size(
    ctx: click.Context,  # noqa: ARG001 - click's signature
    param: click.Parameter,  # noqa: ARG001
    value: str,
) -> int:
    return parse_size(value)


def dataset_options(command: Callable[..., None]) -> Callable[..., None]:
    """Adds the options."""
    for option in (
        click.option(
            "--partition-size",
            default="256MB",
            show_default=True,
            callback=_size,
            metavar="SIZE",
            help="In a folder, start a new file at this size.",
        ),
        click.option(
            "--partition-by",
            type=click.Choice(["hour"]),
            help="In a folder, start a subfolder with each hour: date=2026-11-22/hour=09 by UTC, else by the "
            "clock of the recording computer; hour=0009 since the first sample if neither is known.",
        ),
    ):
        command = option(command)
    return command
