"""Memory of work part by part."""

from __future__ import annotations

import os
from functools import cache

from xbus import _core

__all__ = ["keep_freed_memory"]

#: What dask sets for its workers: malloc returns nearly everything to the system.
DASK_TRIM_THRESHOLD = "65536"


@cache
def keep_freed_memory() -> None:
    """Lets malloc keep freed memory, unless the user chose a limit.

    The main thread keeps up to 256 MiB, another thread as much as it took at once.

    By default glibc returns the memory of each part to the system as soon as it is free. The first touch of
    fresh memory in the next part would take as long as decoding it.
    """
    if os.environ.get("MALLOC_TRIM_THRESHOLD_") in (None, DASK_TRIM_THRESHOLD):
        _core.keep_freed_memory()
