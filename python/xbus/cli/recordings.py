"""The recordings that the arguments of a command name: files, folders, patterns and URLs."""

from __future__ import annotations

import glob
import os
import stat
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import click

from xbus.captures import is_capture
from xbus.cli.failure import Failure, cannot
from xbus.cli.inputs import STDIN, label
from xbus.files import COMPRESSIONS, RECORDING_SUFFIX, is_url, local_name, suffix_of_compression
from xbus.remote import matching_urls

if TYPE_CHECKING:
    from xbus.log.pieces import PiecesError

__all__ = [
    "Recording",
    "find_files",
    "joined_recordings",
    "one_recording",
    "several_recordings",
    "show_unread_piece",
]


@dataclass(frozen=True)
class Recording:
    """A recording: its files in order.

    Attributes:
        files: Paths or URLs of the pieces; ``-`` is standard input.
        notes: What is unusual about the recording, and not printed yet.
    """

    files: list[str]
    notes: list[str] = field(default_factory=list)

    @property
    def name(self) -> str:
        """The name of the first file, for messages."""
        return label(self.files[0])

    @property
    def heading(self) -> str:
        """The names of the first and the last file."""
        return self.name + (f" to {label(self.files[-1])}" if len(self.files) > 1 else "")

    @property
    def title(self) -> str:
        """The names of all files without folders, for the title of a page."""
        return ", ".join(label(os.path.basename(file)) for file in self.files)  # noqa: PTH119

    def show_notes(self) -> None:
        """Prints the notes on stderr, each once."""
        while self.notes:
            click.echo(f"xbus: {self.notes.pop(0)}", err=True)


def find_files(names: Sequence[str]) -> list[str]:
    """Returns the files that arguments name, each once, in order.

    A folder stands for the recordings in it. A pattern that names no file is expanded as a shell would.

    Raises:
        Failure: A folder or a pattern without recordings.
    """
    from xbus.log.arrivals import side_files

    found: dict[str, tuple[str, str]] = {}
    for name in names:
        for file in _expand(name):
            is_local = file != STDIN and not is_url(file)
            path = os.path.abspath(local_name(file)) if is_local else file  # noqa: PTH100
            # A link is the same file, whose real name says whether it is a piece.
            target = os.path.realpath(path) if is_local else file
            if target not in found or path == target != found[target][0]:
                found[target] = path, file
    sides = {side for path, _ in found.values() for side in side_files(path)}
    recordings = [file for path, file in found.values() if path not in sides]
    return recordings or [file for _, file in found.values()]


def _expand(name: str) -> Iterator[str]:
    path = local_name(name)
    if name == STDIN:
        yield name
    elif is_url(path):
        yield from _matching_urls(name)
    elif os.path.isdir(path):  # noqa: PTH112
        suffixes = tuple(RECORDING_SUFFIX + compression for compression in ("", *COMPRESSIONS))
        try:
            files = sorted(file for file in os.listdir(path) if file.lower().endswith(suffixes))  # noqa: PTH208
        except OSError as error:
            raise cannot(f"read {label(name)}", error) from error
        files = [file for file in files if _is_recording(os.path.join(path, file))]  # noqa: PTH118
        if not files:
            raise Failure(
                f"no {RECORDING_SUFFIX} file in the folder {label(name)}; name the files, such as "
                f"{label(os.path.join(name, _pattern(path)))}"  # noqa: PTH118
            )
        yield from (os.path.join(path, file) for file in files)  # noqa: PTH118
    elif glob.has_magic(path) and not os.path.lexists(path):
        files = sorted(glob.glob(path, recursive=True))  # noqa: PTH207
        files = [file for file in files if _is_recording(file)]
        if not files:
            raise _no_match(name)
        yield from files
    else:
        yield name


def _pattern(folder: str) -> str:
    """Returns a pattern for the recordings in a folder without any, in subfolders if they are there."""
    below = glob.iglob(f"{glob.escape(folder)}/**/*{RECORDING_SUFFIX}*", recursive=True)  # noqa: PTH207
    return f"**/*{RECORDING_SUFFIX}" if next(below, None) else "*.bin"


def _matching_urls(pattern: str) -> list[str]:
    try:
        urls = matching_urls(pattern)
    except OSError as error:
        raise cannot(f"read {label(pattern)}", error) from error
    if not urls:
        raise _no_match(pattern)
    return urls


def _no_match(pattern: str) -> Failure:
    return Failure(f"no file matches {label(pattern)}; check the pattern")


def _is_recording(path: str) -> bool:
    """Returns whether a file of a folder can be a recording: no folder, pipe, socket or device."""
    try:
        return stat.S_ISREG(os.stat(path).st_mode)  # noqa: PTH116 - pathlib is slow to import
    except OSError:
        return True  # reading it reports the error


def several_recordings(
    names: Sequence[str], *, allow_restart: bool = False, is_hex: bool = False
) -> list[Recording]:
    """Returns the recordings that arguments name.

    Files with the names of one recording (``walk.mtb``, ``walk-0001.mtb``, ...) are its pieces, in the order
    of the names, as far as each continues the previous one.

    Args:
        names: Files, folders, patterns and URLs.
        allow_restart: As in `xbus.read_log`.
        is_hex: Whether the files are text with the bytes in hex. Each is a recording.
    """
    from xbus.log.grouping import continued
    from xbus.log.pieces import piece_name

    if is_hex:
        return [Recording([file]) for file in find_files(names)]
    groups: dict[str, list[str]] = {}
    files = find_files(names)
    for file in files:
        is_numbered = file != STDIN and not is_capture(file)
        groups.setdefault(piece_name(file).recording if is_numbered else file, []).append(file)
    recordings = []
    for group in groups.values():
        for found in continued(group, allow_restart=allow_restart):
            notes = found.notes if found.error is None else [_note(found.error)]
            unread = _unread_piece(found.files[-1], files, "name it too, or the folder")
            recordings.append(Recording(found.files, [*notes, *unread]))
    return recordings


def show_unread_piece(file: str) -> None:
    """Prints a note on stderr if a recording goes on in another file. For commands that read one file."""
    for note in _unread_piece(file, [file], "this command reads one file"):
        click.echo(f"xbus: {note}", err=True)


def _unread_piece(last: str, named: Sequence[str], remedy: str) -> list[str]:
    """Returns a note if the piece after the last one of a recording is there, but was not named."""
    from xbus.log.pieces import name_of_piece, piece_name

    if last == STDIN or is_url(last) or is_capture(last):
        return []
    recording, number = piece_name(local_name(last))
    other = name_of_piece(recording, number + 1) + suffix_of_compression(last)
    if not os.path.isfile(other):  # noqa: PTH113
        return []
    if os.path.realpath(other) in {os.path.realpath(local_name(name)) for name in named}:
        return []
    return [f"{label(other)}, the piece after {label(last)}, is not read; {remedy}"]


def _note(error: PiecesError) -> str:
    return (
        f"{label(error.other)} does not continue {label(error.one)}: {error.reason}; they are separate "
        "recordings"
    )


def one_recording(
    names: Sequence[str], *, allow_restart: bool, is_hex: bool, remedy: str
) -> Recording:
    """Returns the recording of which arguments name the pieces.

    Args:
        names: Files, folders, patterns and URLs.
        allow_restart: As in `xbus.read_log`.
        is_hex: Whether the files are text with the bytes in hex.
        remedy: What to do with different recordings, for the error message.

    Raises:
        Failure: A file cannot be read.
        UsageError: The inputs are different recordings.
    """
    recordings, error = _joined(names, allow_restart=allow_restart, is_hex=is_hex)
    if len(recordings) == 1:
        return recordings[0]
    if error is None:
        kind = "text in hex" if is_hex else "a CAN capture"
        raise click.UsageError(f"{kind} is one recording per file; {remedy}")
    if error.is_restart:
        remedy += ", or --allow-restart if the device restarted in between"
    raise click.UsageError(
        f"these are different recordings: {label(error.other)} does not continue {label(error.one)}, "
        f"because {error.reason}; {remedy}"
    )


def joined_recordings(
    names: Sequence[str], *, allow_restart: bool, is_hex: bool
) -> list[Recording]:
    """Returns one recording if the files that arguments name are its pieces, whatever their names.

    Args:
        names: Files, folders, patterns and URLs.
        allow_restart: As in `xbus.read_log`.
        is_hex: Whether the files are text with the bytes in hex. Each is a recording.

    Raises:
        Failure: A file cannot be read.
    """
    return _joined(names, allow_restart=allow_restart, is_hex=is_hex)[0]


def _joined(
    names: Sequence[str], *, allow_restart: bool, is_hex: bool
) -> tuple[list[Recording], PiecesError | None]:
    """Returns the recordings, and why there are several; None for text in hex and CAN captures."""
    from xbus.log.pieces import PiecesError, pieces_of

    files = find_files(names)
    if STDIN in files and len(files) > 1:
        raise click.UsageError("- is a whole recording and cannot be joined with other inputs")
    _check_existence(files)
    recordings = several_recordings(names, allow_restart=allow_restart, is_hex=is_hex)
    if len(recordings) == 1 or is_hex or any(map(is_capture, files)):
        return recordings, None
    try:
        pieces = pieces_of(files, allow_restart=allow_restart, direct=True)
    except PiecesError as error:
        return recordings, error
    except ValueError as error:
        raise Failure(str(error)) from error
    except OSError as error:
        raise cannot(f"read {label(str(error.filename or files[0]))}", error) from error
    return [Recording(pieces.names, pieces.notes)], None


def _check_existence(files: Sequence[str]) -> None:
    for file in files:
        if file != STDIN and not is_url(file):
            try:
                os.stat(local_name(file))  # noqa: PTH116 - pathlib is slow to import
            except OSError as error:
                raise cannot(f"read {label(file)}", error) from error
