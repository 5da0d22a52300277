"""The recordings of a folder and the folders in it."""

from __future__ import annotations

import contextlib
import os
from collections import OrderedDict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, NamedTuple, TypeVar

from xbus.describe.names import file_label
from xbus.files import RECORDING_SUFFIX, suffix_of_compression, uncompressed_name
from xbus.log.grouping import continued
from xbus.log.pieces import piece_name

__all__ = [
    "Entry",
    "FileCache",
    "Library",
    "find_recordings",
    "remember_recordings",
    "unused_path",
]

T = TypeVar("T")

#: Recordings that are listed, the latest first.
MAX_ENTRIES = 1000
#: Files and folders that are looked at, at most: someone may start the studio in a home folder.
MAX_LOOKED_AT = 50_000


@dataclass(frozen=True)
class Entry:
    """A recording.

    Attributes:
        files: Its pieces in order.
        size: Bytes of all of them.
        modified: When the latest was changed, in seconds since 1970.
    """

    files: tuple[Path, ...]
    size: int
    modified: float

    @property
    def path(self) -> Path:
        """The first file."""
        return self.files[0]

    @property
    def plain_path(self) -> Path:
        """The first file without the suffix of a compression: notes and exports have its name."""
        return self.path.with_name(uncompressed_name(self.path.name))

    @property
    def is_compressed(self) -> bool:
        """Whether the name of a file is that of a compressed one."""
        return any(suffix_of_compression(file.name) for file in self.files)

    @property
    def arguments(self) -> list[str]:
        """The files as arguments of a command; no name looks like an option."""
        return [f"./{file}" if str(file).startswith("-") else str(file) for file in self.files]

    @property
    def heading(self) -> str:
        """The name of the first file, and of the last one, as printable text."""
        name = self.path.name + (f" to {self.files[-1].name}" if len(self.files) > 1 else "")
        return file_label(name)

    def name_in(self, folder: Path) -> str:
        """Returns the heading, with the folder below another one."""
        below = os.path.relpath(self.path.parent, folder)
        return self.heading if below == "." else f"{file_label(below)}{os.sep}{self.heading}"


class Library(NamedTuple):
    """The recordings of a folder.

    Attributes:
        entries: The latest, at most `MAX_ENTRIES`, in descending order.
        total: Number of all that were found; pieces that are not listed count as recordings by their names.
        is_complete: Whether all files were looked at.
    """

    entries: list[Entry]
    total: int
    is_complete: bool


class _File(NamedTuple):
    path: Path
    size: int
    modified: float


def find_recordings(folder: Path) -> Library:
    """Returns the recordings of a folder and the folders in it, without hidden ones.

    The files of a recording in several pieces, such as those of ``xbus record --rotate``, are one recording.
    Whether a compressed piece continues another is known only when it is decompressed: until then, the names
    decide. A file that disappears meanwhile is left out.

    Raises:
        OSError: The folder exists and cannot be read.
    """
    names: dict[str, list[_File]] = {}
    with contextlib.suppress(FileNotFoundError), os.scandir(folder):
        pass
    looked_at = 0
    for entry in _walk(folder):
        looked_at += 1
        if looked_at > MAX_LOOKED_AT:
            break
        plain = uncompressed_name(entry.path)
        if plain.lower().endswith(RECORDING_SUFFIX):
            with contextlib.suppress(OSError):
                state = entry.stat()
                if entry.is_file():
                    file = _File(Path(entry.path), state.st_size, state.st_mtime)
                    names.setdefault(piece_name(entry.path).recording, []).append(file)
    latest = sorted(names.values(), key=lambda group: max(each.modified for each in group))
    entries: list[Entry] = []
    for group in reversed(latest[-MAX_ENTRIES:]):
        files = {str(each.path): each for each in group}
        for names_of_pieces in _grouped(list(files)):
            pieces = [files[name] for name in names_of_pieces]
            entries.append(
                Entry(
                    tuple(each.path for each in pieces),
                    sum(each.size for each in pieces),
                    max(each.modified for each in pieces),
                )
            )
    entries.sort(key=lambda each: each.modified, reverse=True)
    total = len(entries) + max(0, len(latest) - MAX_ENTRIES)
    return Library(entries[:MAX_ENTRIES], total, looked_at <= MAX_LOOKED_AT)


def remember_recordings(recordings: Sequence[Sequence[str]]) -> None:
    """Remembers that files with the names of one recording are several, as long as they do not change."""
    files = sorted(file for recording in recordings for file in recording)
    with contextlib.suppress(OSError):  # a file is gone
        _several.put(FileCache.key(list(map(Path, files))), [[*each] for each in recordings])


def _grouped(files: list[str]) -> list[list[str]]:
    """Returns files with the names of one recording, grouped into recordings."""
    suffixes = {suffix_of_compression(file) for file in files}
    if suffixes == {""} or len(files) == 1:
        return [group.files for group in continued(files)]
    numbers = {file: piece_name(file).number for file in files}
    if len(set(numbers.values())) < len(files):  # walk.mtb and walk.mtb.gz
        if len(suffixes) == 1:
            return [[file] for file in files]
        own = [[file for file in files if suffix_of_compression(file) == each] for each in suffixes]
        return [group for same in own for group in _grouped(same)]
    if 0 not in numbers.values():  # other programs give such names to recordings of any kind
        return [[file] for file in files]
    with contextlib.suppress(OSError):  # reading reports the error
        if found := _several.get(FileCache.key(list(map(Path, sorted(files))))):
            return found
    return [sorted(files, key=numbers.__getitem__)]


def _walk(folder: Path) -> Iterator[os.DirEntry[str]]:
    """Yields the files in a folder and the folders in it; the nearest first."""
    folders = [str(folder)]
    for each in folders:
        with contextlib.suppress(OSError), os.scandir(each) as found:
            for entry in found:
                yield entry
                if not entry.name.startswith(".") and entry.is_dir(follow_symlinks=False):
                    folders.append(entry.path)


def unused_path(path: Path, ending: str) -> Path:
    """Returns a path beside another one that no file has: ``walk-cut.mtb``, ``walk-cut-2.mtb``, ..."""
    number = 1
    while True:
        more = f"-{number}" if number > 1 else ""
        other = path.with_name(f"{path.stem}{ending}{more}{path.suffix}")
        if not os.path.lexists(other):
            return other
        number += 1


class FileCache(Generic[T]):
    """What is known about files; as long as they do not change, and not more than the latest.

    Args:
        most: Number of entries.
    """

    def __init__(self, most: int = 1000) -> None:
        self._most = most
        self._known: OrderedDict[object, T] = OrderedDict()

    @staticmethod
    def key(files: Sequence[Path]) -> object:
        """Returns what changes when a file changes.

        Raises:
            OSError: A file is gone.
        """
        states = [(file, file.stat()) for file in files]
        return tuple((str(file), state.st_size, state.st_mtime_ns) for file, state in states)

    def get(self, key: object) -> T | None:
        """Returns what is known."""
        if key in self._known:
            self._known.move_to_end(key)
        return self._known.get(key)

    def put(self, key: object, value: T) -> None:
        """Remembers it, and forgets what was used longest ago."""
        self._known[key] = value
        self._known.move_to_end(key)
        while len(self._known) > self._most:
            self._known.popitem(last=False)

    def forget(self, key: object) -> None:
        """Forgets it."""
        self._known.pop(key, None)


#: Files whose names are those of one recording, and which are several.
_several: FileCache[list[list[str]]] = FileCache()
