"""The section about sensor noise."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from xbus.formatting import format_count
from xbus.plots.thin import FloatArray
from xbus.report import figures
from xbus.report.allan import PARTS, at_one_second, flicker_floor
from xbus.report.blocks import Block, Heading, Paragraph, Plot, Table
from xbus.report.data import ReportData, Series
from xbus.report.findings import percent

__all__ = ["noise"]

#: Maximum standard deviation of a device at rest, in rad/s and m/s2.
AT_REST = {"rate_of_turn": 0.02, "acceleration": 0.2}
#: Units of random walk and bias instability, and their number in the unit of the log.
UNITS = {
    "rate_of_turn": ("deg/√h", np.degrees(60), "deg/h", np.degrees(3600)),
    "acceleration": ("m/s/√h", 60.0, "µg", 1e6 / 9.80665),
}
#: Slopes of a curve of white noise on logarithmic axes; the ideal slope is -1/2.
WHITE = (-0.65, -0.35)

INTRODUCTION = (
    "Overlapping Allan deviation. It shows the noise of a sensor only if the device was at rest and warm: "
    "motion, vibration and temperature changes look like noise. Only the longest stretch without a gap or a "
    "restart is used, and averaging times up to a ninth of it, where the deviation has an uncertainty of a "
    "quarter. "
    "Random walk is read at 1 s and is valid where the slope is near -1/2. Bias instability is the minimum "
    "of the deviation divided by 0.664; measuring it takes hours."
)


def noise(data: ReportData) -> Iterator[Block]:
    """Yields an Allan deviation for each accelerometer and gyroscope quantity."""
    noisy = [series for series in data.series if series.longest is not None]
    if noisy:
        yield Paragraph(INTRODUCTION)
    for series in noisy:
        yield Heading(f"noise-{series.anchor}", series.title)
        yield from _series(series)


def _series(series: Series) -> Iterator[Block]:
    assert series.longest is not None  # noqa: S101 - see `noise`
    result = figures.noise(series)
    if result is None:
        rows = format_count(series.longest.best.rows, "row")
        yield Paragraph(f"Too short: {rows} without a gap; at least {2 * PARTS} are needed.")
        return
    figure, curves = result
    for text in _data_quality(series):
        yield Paragraph(text)
    yield Plot(figure)
    yield from _results(series, curves)


def _data_quality(series: Series) -> Iterator[str]:
    """Yields sentences about the rows, and why they may not show noise."""
    assert series.longest is not None  # noqa: S101 - see `noise`
    best, gaps = series.longest.best, series.longest.stretches - 1
    extent = f"the longest of {gaps + 1:,} stretches without a gap" if gaps else "no gap"
    means = "" if best.size == 1 else f", averaged over {best.size}"
    rate = best.rate * best.size
    span = f"{best.seconds:,.2f} s from {best.start:,.2f} s on"
    yield f"{best.rows:,} rows at {rate:,.2f} Hz{means}: {span}, {extent}."
    if series.steps.irregular:
        share = percent(series.steps.irregular, series.steps.rows)
        yield (
            f"The rate is not uniform: {share} of the steps differ from the steps around them by more than a "
            "tenth. The results assume a uniform rate."
        )
    spread = float(best.values.std(axis=0).max())
    if spread > AT_REST[series.name.removesuffix("_hr")]:
        unit = next(iter(series.panels.values())).unit
        yield (
            f"The device moved (standard deviation {spread:.3g} {unit}): the results below show its motion, "
            "not its noise."
        )


def _results(series: Series, curves: list[tuple[FloatArray, FloatArray]]) -> Iterator[Block]:
    walk_unit, walk_factor, bias_unit, bias_factor = UNITS[series.name.removesuffix("_hr")]
    rows = []
    has_doubt = False
    for axis, (tau, deviation) in zip("xyz", curves, strict=True):
        if not np.all(deviation > 0):
            rows.append((axis, "constant or too large", "", "", "", ""))
            continue
        walk = slope = "not reached"
        if (read := at_one_second(tau, deviation)) is not None:
            walk, slope = f"{read[0] * walk_factor:.4g}", f"{read[1]:.2f}"
            if not WHITE[0] <= read[1] <= WHITE[1]:
                walk, has_doubt = f"({walk})", True
        floor = flicker_floor(tau, deviation)
        bias = f"{floor.bias * bias_factor:.4g}"
        bias = bias if floor.is_reached else f"less than {bias}"
        rows.append((axis, walk, slope, bias, f"{floor.tau:.3g}", f"{deviation[0]:.4g}"))
    kind = "angle" if series.name.startswith("rate") else "velocity"
    unit = next(iter(series.panels.values())).unit
    head = (
        "axis",
        f"{kind} random walk, {walk_unit}",
        "slope at 1 s",
        f"bias instability, {bias_unit}",
        "at, s",
        f"deviation at {curves[0][0][0]:.3g} s, {unit}",
    )
    yield Table(head, rows, numeric=(1, 2, 3, 4, 5))
    if has_doubt:
        text = "Values in brackets are not random walk: the slope is not near -1/2."
        yield Paragraph(text, is_note=True)
