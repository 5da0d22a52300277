"""Draws the picture of docs/time.md: ``python docs/draw_times.py`` writes docs/times.svg.

It shows samples every 2 ms from an adapter that waits up to 16 ms: the delay of each arrival behind device
time, the lower hull of the arrivals, and a least-squares line.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from xbus import HostClock

WIDTH, HEIGHT, LEFT, BOTTOM = 720, 300, 60, 250
SHOWN = 0.25


def main() -> None:
    rng = np.random.default_rng(4)
    time = np.arange(0, 30, 0.002)
    reads = np.cumsum(0.015 + rng.uniform(0, 0.004, 2500))
    arrival = reads[np.searchsorted(reads, time)] + 0.0012
    clock = HostClock()
    clock.update(time, np.rint(arrival * 1e9).astype(np.int64))
    late = (arrival - time) * 1e3

    def x(seconds: float) -> float:
        return round(LEFT + (seconds - (30 - SHOWN)) / SHOWN * (WIDTH - LEFT - 20), 1)

    def y(ms: float) -> float:
        return round(BOTTOM - ms * 11, 1)

    def line(ms: float, color: str, text: str, below: int) -> str:
        right = WIDTH - 20
        return (
            f'<path d="M{LEFT} {y(ms)}H{right}" stroke="{color}" stroke-width="2"/>'
            f'<text x="{right}" y="{BOTTOM + below}" fill="{color}" text-anchor="end">{text}</text>'
        )

    dots = "".join(
        f'<circle cx="{x(t)}" cy="{y(ms)}" r="2.2"/>'
        for t, ms in zip(time.tolist(), late.tolist(), strict=True)
        if t > 30 - SHOWN
    )
    ticks = "".join(
        f'<text x="{LEFT - 8}" y="{y(ms) + 4}" text-anchor="end">{ms}</text>'
        f'<line x1="{LEFT - 4}" x2="{LEFT}" y1="{y(ms)}" y2="{y(ms)}" stroke="#555"/>'
        for ms in (0, 5, 10, 15, 20)
    )
    host_time = (clock.host_time(30.0) - 30) * 1e3
    size = f'viewBox="0 0 {WIDTH} {HEIGHT}" font-family="sans-serif" font-size="13"'
    picture = f"""\
<svg xmlns="http://www.w3.org/2000/svg" {size}>
<rect width="{WIDTH}" height="{HEIGHT}" fill="white"/>
<g fill="#555">{ticks}
<text x="{LEFT}" y="{BOTTOM + 18}">device time &#8594; ({SHOWN * 1e3:.0f} ms shown, after 30 s)</text>
<text x="{LEFT - 46}" y="18">arrival less device time, ms</text></g>
<path d="M{LEFT} 26V{BOTTOM}H{WIDTH - 20}" fill="none" stroke="#555"/>
<g fill="#1f77b4">{dots}</g>
{line(float(late.mean()), "#777", f"least squares: {late.mean():.1f} ms", 18)}
{line(host_time, "#d62728", f"lower hull, host_time: {host_time:.2f} ms (the least delay is 1.20 ms)", 36)}
</svg>
"""
    Path(__file__).with_name("times.svg").write_text(picture, "utf-8")


if __name__ == "__main__":
    main()
