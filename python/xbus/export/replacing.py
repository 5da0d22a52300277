"""Files and folders that appear whole or not at all."""

from __future__ import annotations

import contextlib
import errno
import os
import re
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pathlib import Path

__all__ = [
    "ForeignFilesError",
    "check_replaceable",
    "new_folder",
    "replacing",
    "replacing_all",
    "replacing_folder",
]

#: The mark of a folder that may be replaced. Readers of datasets ignore it, because it is empty and its name
#: begins with a dot.
MARK = ".xbus-dataset"
#: The files of such a folder.
PART = re.compile(r"((date=[0-9-]+/)?hour=[0-9]+/)?part-[0-9]{4}\.[a-z]+")


@contextlib.contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[Any]:
    """Opens a file to write that replaces ``path`` when it is complete.

    The file is written beside ``path`` and removed after an error, so neither a full disk nor Ctrl-C leaves
    half a file. If ``path`` is not a regular file (``/dev/stdout``, a pipe), it is written directly.
    """
    from pathlib import Path  # imported late: it takes longer than the rest of xbus

    target = Path(path)
    if target.exists() and not target.is_file():
        with target.open("wb") as out:
            yield out
        return
    # Follows links, and keeps the permissions of an existing file.
    target = target.resolve()
    part = target.with_name(f".{target.name}.{os.urandom(4).hex()}.part")
    try:
        with part.open("xb") as out:
            yield out
        if target.exists():
            part.chmod(target.stat().st_mode & 0o777)
        part.replace(target)
    except BaseException:
        part.unlink(missing_ok=True)
        raise


@contextlib.contextmanager
def replacing_all(paths: Sequence[str]) -> Iterator[list[Any]]:
    """Opens files to write that replace those at ``paths`` when all are complete, or none of them.

    A single path may be no regular file, as in `replacing`.
    """
    from pathlib import Path

    if len(paths) == 1:
        with replacing(paths[0]) as out:
            yield [out]
        return
    mark = os.urandom(4).hex()
    targets = [Path(path).resolve() for path in paths]
    parts, olds = (
        [target.with_name(f".{target.name}.{mark}.{end}") for target in targets]
        for end in ("part", "old")
    )
    placed = []
    try:
        with contextlib.ExitStack() as stack:
            yield [stack.enter_context(part.open("xb")) for part in parts]
        for target, part, old in zip(targets, parts, olds, strict=True):
            if target.is_file():
                part.chmod(target.stat().st_mode & 0o777)
                target.rename(old)
            part.rename(target)
            placed.append(target)
    except BaseException:
        for target in placed:
            target.unlink()
        for target, part, old in zip(targets, parts, olds, strict=True):
            part.unlink(missing_ok=True)
            if old.exists():
                old.rename(target)
        raise
    for old in olds:
        old.unlink(missing_ok=True)


class ForeignFilesError(ValueError):
    """A folder "has files ...", which would be lost if it were replaced."""


@contextlib.contextmanager
def replacing_folder(path: str | os.PathLike[str]) -> Iterator[str]:
    """Makes a folder beside ``path`` that replaces it when it is complete, and yields its path.

    It is removed after an error. Its files must have names such as
    ``date=2026-11-22/hour=09/part-0000.parquet``. A hidden mark is added to it.

    Raises:
        ForeignFilesError: ``path`` is a folder without the mark, or with other files.
        OSError: A folder cannot be made, or ``path`` is a file.
    """
    import shutil
    from pathlib import Path  # imported late: it takes longer than the rest of xbus

    target = Path(path).resolve()
    check_replaceable(target)
    mark = os.urandom(4).hex()
    part, old = (target.with_name(f".{target.name}.{mark}.{end}") for end in ("part", "old"))
    part.mkdir()
    try:
        yield str(part)
        (part / MARK).touch()
        check_replaceable(target)
        if target.exists():
            target.rename(old)
        part.rename(target)
    except BaseException:
        if old.exists() and not target.exists():
            old.rename(target)
        shutil.rmtree(part, ignore_errors=True)
        raise
    shutil.rmtree(old, ignore_errors=True)


def check_replaceable(path: str | os.PathLike[str]) -> None:
    """Raises the errors of `replacing_folder` that can be known before there is anything to write."""
    from pathlib import Path

    target = Path(path)
    if not target.exists():
        return
    names = _files(target)  # raises NotADirectoryError
    if MARK in names:
        names = {
            name for name in names if name != MARK and not PART.fullmatch(name.replace(os.sep, "/"))
        }
    if names:
        raise ForeignFilesError(f"has files that xbus did not write, such as {min(names)}")


def _files(folder: Path) -> set[str]:
    """Returns the files in a folder and its subfolders, relative to it, and subfolders that are empty."""
    if not folder.is_dir():
        raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR), str(folder))
    found = set()
    for name, folders, files in os.walk(folder):
        for file in files or ([] if folders or name == str(folder) else [""]):
            found.add(os.path.relpath(os.path.join(name, file), folder))  # noqa: PTH118
    return found


@contextlib.contextmanager
def new_folder(path: str | os.PathLike[str]) -> Iterator[tuple[Path, str]]:
    """Makes a folder that appears at ``path`` when it is complete, and yields it with its later name.

    It is made beside ``path`` and removed after an error.

    Raises:
        FileExistsError: There is something at ``path`` already, which is not replaced.
    """
    import shutil
    from pathlib import Path

    target = Path(path).absolute()
    if os.path.lexists(target):
        raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(path))
    part = target.with_name(f".{target.name}.{os.urandom(4).hex()}.part")
    try:
        part.mkdir()
        yield part, target.name
        part.rename(target)
    except BaseException:
        shutil.rmtree(part, ignore_errors=True)
        raise
