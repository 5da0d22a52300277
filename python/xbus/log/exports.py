"""The methods that write a log in the formats of other software."""

from __future__ import annotations

import os

from xbus.export.format import export
from xbus.export.part import Part

__all__ = ["Exports"]


class Exports:
    """Exports of a log. Each method imports its format when it is called."""

    def to_gpx(self: Part, path: str | os.PathLike[str]) -> None:
        """Writes the track of the GNSS receiver to a GPX file, which appears whole or not at all.

        Args:
            path: Path of the file.

        Raises:
            ExportError: The log has no positions; a ValueError.
            OSError: The file cannot be written.
        """
        from xbus.export.gpx import Gpx

        export(Gpx(), self, [self], path)
