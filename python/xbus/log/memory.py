"""Memory of work part by part."""

from __future__ import annotations

import os
from functools import cache

from xbus import _core

__all__ = ["keep_freed_memory"]

#: Environment variables with which users configure glibc's malloc.
SETTINGS = ("MALLOC_MMAP_THRESHOLD_", "MALLOC_TOP_PAD_", "MALLOC_TRIM_THRESHOLD_")
#: What dask sets for its workers: malloc returns nearly everything to the system.
DASK_SETTINGS = {"MALLOC_TRIM_THRESHOLD_": "65536"}


@cache
def keep_freed_memory() -> None:
    """Lets malloc keep freed memory, unless one of `SETTINGS` is set, other than by dask.

    The main thread keeps up to 256 MiB, others about as much as they needed at once.

    By default glibc returns the memory of each part to the system as soon as it is free. The first touch of
    fresh memory in the next part would take as long as decoding it.
    """
    chosen = {name: os.environ[name] for name in SETTINGS if name in os.environ}
    if chosen in ({}, DASK_SETTINGS):
        _core.keep_freed_memory()
