"""Files with the names of one recording, grouped into recordings by what is in them."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

from xbus.log.pieces import PiecesError, piece_name, pieces_of

__all__ = ["Group", "continued"]


class Group(NamedTuple):
    """The files of a recording.

    Attributes:
        files: The files in order.
        notes: What is unusual: see `xbus.log.pieces.Pieces`.
        error: Why they do not continue the previous recording, although their names say so; or None.
    """

    files: list[str]
    notes: list[str]
    error: PiecesError | None


def continued(files: Sequence[str], *, allow_restart: bool = False) -> list[Group]:
    """Returns the recordings of files whose names are those of one recording.

    They are one recording as far as each file continues the previous one.

    Args:
        files: Paths or URLs of ``walk.mtb``, ``walk-0001.mtb``, ..., in any order.
        allow_restart: As in `xbus.read_log`.

    >>> continued(["tests/captures/walk.mtb"])
    [Group(files=['tests/captures/walk.mtb'], notes=[], error=None)]
    """
    alone = [Group([file], [], None) for file in files]
    if len(alone) == 1:
        return alone
    numbers = [piece_name(file).number for file in files]
    if len(set(numbers)) < len(numbers):  # walk.mtb and walk.mtb.gz
        return alone
    # Without the first file, other programs may have given these names to recordings of any kind.
    is_direct = 0 not in numbers
    try:
        pieces = pieces_of(files, allow_restart=allow_restart, direct=is_direct)
        return [Group(pieces.names, pieces.notes, None)]
    except OSError:
        return alone  # reading reports the error
    except PiecesError as error:
        reason = error
    ordered = [file for _, file in sorted(zip(numbers, files, strict=True))]
    found = [[ordered[0]]]
    for one, other in pairwise(ordered):
        try:
            pieces_of([one, other], allow_restart=allow_restart, direct=is_direct)
        except PiecesError:
            found.append([other])
        else:
            found[-1].append(other)
    return [Group(names, [], reason if at else None) for at, names in enumerate(found)]
