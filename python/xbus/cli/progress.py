"""A progress bar for long work."""

from __future__ import annotations

import sys
import threading
from types import TracebackType
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from rich.progress import Progress as Bar
    from rich.progress import TaskID

__all__ = ["Progress", "ShowsProgress"]

#: Seconds before the bar is shown.
DELAY = 1.0


class ShowsProgress(Protocol):
    """Shows how far work is."""

    def update(self, task: str, done: int = 0, total: int | None = None) -> None:
        """Sets what is being done and how far that is, in bytes; ``total`` is None if unknown."""
        ...


class Progress:
    """Shows progress on stderr: only on a terminal, and only after a second.

    Args:
        task: Text of the bar.
        shown: False disables the bar.
    """

    def __init__(self, task: str, *, shown: bool = True) -> None:
        self._task = task
        self._done = 0
        self._total: int | None = None
        self._bar: Bar | None = None
        self._id: TaskID | None = None
        self._lock = threading.Lock()
        terminal = sys.stderr is not None and sys.stderr.isatty()
        self._timer = threading.Timer(DELAY, self._show) if shown and terminal else None

    def __enter__(self) -> Progress:
        if self._timer:
            self._timer.daemon = True
            self._timer.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._timer:
            self._timer.cancel()
            self._timer.join()
        if self._bar:
            self._bar.stop()

    def update(self, task: str, done: int = 0, total: int | None = None) -> None:
        """Updates the bar; ``done`` and ``total`` are in bytes, and ``total`` is None if unknown."""
        with self._lock:
            self._task, self._done, self._total = task, done, total
            self._redraw()

    def _redraw(self) -> None:
        if self._bar is not None and self._id is not None:
            self._bar.update(
                self._id, description=self._task, completed=self._done, total=self._total
            )

    def _show(self) -> None:
        from rich.console import Console
        from rich.progress import (
            BarColumn,
            DownloadColumn,
            Progress,
            TextColumn,
            TimeRemainingColumn,
        )
        from rich.table import Column

        narrow = Column(no_wrap=True, overflow="ellipsis", max_width=36)
        bar = Progress(
            # A file name can contain markup, and the bar has one line.
            TextColumn("{task.description}", markup=False, table_column=narrow),
            BarColumn(),
            DownloadColumn(),
            TimeRemainingColumn(),
            console=Console(stderr=True),
            transient=True,
        )
        with self._lock:
            self._bar, self._id = bar, bar.add_task(self._task, total=None)
            self._redraw()
        bar.start()
