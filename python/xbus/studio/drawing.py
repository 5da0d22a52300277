"""Small pictures as SVG: a curve over time, and clouds of points in three planes."""

from __future__ import annotations

import html
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from xbus.export.palette import COLOURS

__all__ = ["cloud", "curve"]

#: Size of a curve, and of one plane, in pixels, and room for numbers at their left and below.
WIDTH, HEIGHT, PLANE, LEFT, BELOW = 800, 130, 240, 46, 18
#: Dots of a cloud in each plane, at most about.
MAX_DOTS = 700
#: Planes by axis: across and up.
PLANES = ((0, 1), (0, 2), (1, 2))

Array = npt.NDArray[np.floating]


def curve(label: str, time: Array, values: Array) -> str:
    """Returns a curve over time as SVG, with every point; NaN is a gap. Empty if there is no number.

    >>> curve("norm", np.array([0.0, 1.0]), np.array([1.0, 2.0])).count("L")
    1
    """
    is_finite = np.isfinite(values) & np.isfinite(time)
    if not is_finite.any():
        return ""
    low, high = float(values[is_finite].min()), float(values[is_finite].max())
    first, last = float(time[is_finite].min()), float(time[is_finite].max())
    x = LEFT + (WIDTH - LEFT - 4) * (time - first) / ((last - first) or 1.0)
    y = 6 + (HEIGHT - BELOW - 12) * (high - values) / ((high - low) or 1.0)
    path, is_drawn = [], False
    for is_known, across, down in zip(is_finite.tolist(), x.tolist(), y.tolist(), strict=True):
        if is_known:
            path.append(f"{'L' if is_drawn else 'M'}{across:.1f} {down:.1f}")
        is_drawn = is_known
    bottom = HEIGHT - BELOW
    return (
        f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" class="xbus-drawing" role="img" '
        f'aria-label="{html.escape(label)}">'
        f'<path d="M{LEFT} 2V{bottom}H{WIDTH - 4}" class="xbus-axis"/>'
        f'<path d="{"".join(path)}" stroke="{COLOURS[1]}" fill="none" stroke-width="1.2"/>'
        + _text(LEFT - 4, 12, f"{high:.3g}", "end")
        + _text(LEFT - 4, bottom, f"{low:.3g}", "end")
        + _text((LEFT + WIDTH) / 2, HEIGHT - 4, label, "middle")
        + _text(LEFT, HEIGHT - 4, f"{first:,.0f} s", "start")
        + _text(WIDTH - 4, HEIGHT - 4, f"{last:,.0f} s", "end")
        + "</svg>"
    )


def cloud(clouds: Sequence[tuple[str, Array]]) -> str:
    """Returns clouds of points, ``(N, 3)`` each, in three planes as SVG. Empty if there is no point.

    >>> cloud([("before", np.eye(3)), ("after", np.eye(3))]).count("<svg")
    1
    """
    clouds = [(name, points[:: max(1, len(points) // MAX_DOTS)]) for name, points in clouds]
    end = max((float(np.abs(points).max()) for _, points in clouds if len(points)), default=0.0)
    if not 0 < end < np.inf:
        return ""
    parts = []
    for number, (across, up) in enumerate(PLANES):
        left = LEFT + number * (PLANE + 28)
        middle, half = left + PLANE / 2, PLANE / 2 - 4
        parts.append(
            f'<path d="M{left} {PLANE / 2}H{left + PLANE}M{middle} 0V{PLANE}" class="xbus-axis"/>'
            + _text(left + PLANE, PLANE / 2 - 4, "xyz"[across], "end")
            + _text(middle + 4, 10, "xyz"[up], "start")
        )
        for (_, points), colour in zip(clouds, COLOURS[1:], strict=False):
            places = points[:, [across, up]] / end * half
            dots = "".join(f"M{middle + x:.1f} {PLANE / 2 - y:.1f}h.1" for x, y in places.tolist())
            parts.append(
                f'<path d="{dots}" stroke="{colour}" stroke-width="2.4" stroke-linecap="round"/>'
            )
    bottom, place = PLANE + 14, float(LEFT)
    for (name, _), colour in zip(clouds, COLOURS[1:], strict=False):
        parts.append(f'<circle cx="{place + 4}" cy="{bottom - 4}" r="4" fill="{colour}"/>')
        parts.append(_text(place + 14, bottom, name, "start"))
        place += 120
    parts.append(_text(WIDTH, bottom, f"from -{end:.3g} to {end:.3g} a.u.", "end"))
    width = LEFT + 3 * PLANE + 2 * 28
    return (
        f'<svg viewBox="0 0 {width} {PLANE + BELOW}" class="xbus-drawing" role="img" '
        f'aria-label="three planes">{"".join(parts)}</svg>'
    )


def _text(x: float, y: float, text: str, anchor: str) -> str:
    return f'<text x="{x}" y="{y}" text-anchor="{anchor}">{html.escape(text)}</text>'
