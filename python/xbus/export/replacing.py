"""Files that appear whole or not at all."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from typing import Any

__all__ = ["replacing"]


@contextlib.contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[Any]:
    """Opens a file to write that replaces ``path`` when it is complete.

    The file is written beside ``path`` and removed after an error, so neither a full disk nor Ctrl-C leaves
    half a file. If ``path`` is not a regular file (``/dev/stdout``, a pipe), it is written directly.
    """
    import secrets
    from pathlib import Path  # imported late: it takes longer than the rest of xbus

    target = Path(path)
    if target.exists() and not target.is_file():
        with target.open("wb") as out:
            yield out
        return
    # Follows links, and keeps the permissions of an existing file.
    target = target.resolve()
    part = target.with_name(f".{target.name}.{secrets.token_hex(4)}.part")
    try:
        with part.open("xb") as out:
            yield out
        if target.exists():
            part.chmod(target.stat().st_mode & 0o777)
        part.replace(target)
    except BaseException:
        part.unlink(missing_ok=True)
        raise
