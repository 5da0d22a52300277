"""The section about the magnetic field."""

from __future__ import annotations

from collections.abc import Iterator

from xbus.formatting import format_count
from xbus.plots.thin import FloatArray
from xbus.report import figures
from xbus.report.blocks import Block, Heading, Paragraph, Plot, Table
from xbus.report.data import ReportData
from xbus.report.field_quality import FAIR, GOOD, MIN_COVERAGE, FieldQuality

__all__ = ["SCALE", "facts", "magnetic"]

#: How the verdict is found.
SCALE = (
    "The verdict is about the deviation of the norm (RMS, of its mean): "
    f"up to {100 * GOOD:.0f} % is good, up to {100 * FAIR:.0f} % is fair."
)
INTRODUCTION = (
    "Where nothing disturbs it, the field has the same norm in every orientation of the device, and its "
    "measurements are on a sphere. Iron and magnets that move with the device turn the sphere into an "
    "ellipsoid, which is fitted here; its centre is the hard iron. "
    f"{SCALE} It needs a field seen in {100 * MIN_COVERAGE:.0f} % of all directions."
)


def magnetic(data: ReportData) -> Iterator[Block]:
    """Yields the quality of each magnetic field."""
    fields = [series for series in data.series if series.field is not None]
    if fields:
        yield Paragraph(INTRODUCTION)
    for series in fields:
        assert series.field is not None  # noqa: S101 - see above
        quality = series.field.quality()
        yield Heading(f"magnetic-{series.anchor}", series.title)
        yield Paragraph(f"{quality.verdict[0].upper()}{quality.verdict[1:]}.")
        if len(quality.points):
            yield Plot(figures.field(series, quality))
            yield Table(("", "value"), facts(quality))


def facts(quality: FieldQuality) -> list[tuple[str, str]]:
    """Returns what is known about a field, as names and texts."""
    norm, found = quality.norm, quality.ellipsoid
    rows = [
        ("norm, mean", f"{norm.mean:.3f} a.u."),
        ("standard deviation", f"{norm.std:.3f} a.u."),
        ("range", f"{norm.min:.3f} to {norm.max:.3f} a.u."),
        ("within 5 % of the mean", f"{100 * norm.within_5:.1f} % of the rows"),
        ("within 10 % of the mean", f"{100 * norm.within_10:.1f} % of the rows"),
    ]
    if quality.missing:
        rows.append(("without a number", format_count(quality.missing, "row")))
    if quality.coverage is not None:
        rows.append(("directions seen", f"{100 * quality.coverage:.0f} %"))
    if found is not None and quality.before is not None and quality.after is not None:
        rows += [
            ("deviation of the norm", f"{100 * quality.before:.2f} %"),
            ("after the correction", f"{100 * quality.after:.2f} %"),
            ("hard iron", f"{_numbers(found.center)} a.u."),
            ("soft iron, inverse", "; ".join(_numbers(row) for row in found.shape)),
            ("axes of the ellipsoid", f"{_numbers(found.axes)} a.u."),
        ]
    return rows


def _numbers(values: FloatArray) -> str:
    # Adding 0.0 turns -0 to 0.
    return ", ".join(f"{round(value, 3) + 0.0:.3f}" for value in values.tolist())
