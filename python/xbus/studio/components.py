"""Parts of pages that draw live data in the browser."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from nicegui.element import Element

from xbus.studio.history import Series

__all__ = ["Chart", "Horizon"]


class Chart(Element, component="static/chart.js"):
    """Curves of one series over time.

    Args:
        source: Port of the device.
        series: The series.
        span: Seconds to show.
        on_zoom: Called with begin and end when the user chooses a part of the time.
    """

    def __init__(
        self, source: str, series: Series, span: float, on_zoom: Callable[[float, float], Any]
    ) -> None:
        super().__init__()
        self.props["source"], self.props["name"], self.props["unit"] = (
            source,
            series.name,
            series.unit,
        )
        self.props["fields"], self.props["span"] = list(series.fields), span
        self.props["view"], self.props["locked"] = None, False
        self.on("zoom", lambda event: on_zoom(event.args["begin"], event.args["end"]))

    def show(self, **props: Any) -> None:
        """Changes ``span``, ``view`` (begin and end, or None for live) or ``locked``."""
        self.props.update(props)
        self.update()


class Horizon(Element, component="static/horizon.js"):
    """An artificial horizon with heading.

    Args:
        source: Port of the device.
    """

    def __init__(self, source: str) -> None:
        super().__init__()
        self.props["source"] = source
