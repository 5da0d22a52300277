"""Curves as traces of plotly."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from xbus.plots.plot import Line

__all__ = ["traces"]


def traces(line: Line) -> Iterator[dict[str, Any]]:
    """Yields the traces of a curve: its line, and the points without a line to a neighbour."""
    common = {"type": "scatter", "name": line.name, "legendgroup": line.name}
    if has_line := not line.is_dots:
        style = {"color": line.style.colour, "width": 1.2}
        if line.style.is_dashed:
            style["dash"] = "dash"
        yield {**common, "mode": "lines", "line": style, "x": line.time, "y": line.values}
    x, y = line.dots
    if len(x):
        marker = {"color": line.style.colour, "size": 3}
        dots = {"mode": "markers", "marker": marker, "x": x, "y": y}
        yield {**common, **dots, "showlegend": not has_line}
