"""What is known after a while, printed once: for people, and for programs."""

from __future__ import annotations

import sys
from dataclasses import asdict
from typing import Any

from xbus.cli.monitor.model import Model
from xbus.cli.monitor.rows import HEAD, clock, rows, safe, state, table
from xbus.cli.monitor.terminal import glyphs_of
from xbus.cli.monitor.values import flags, value_facts
from xbus.cli.printing import aligned

__all__ = ["facts", "text"]


def text(model: Model) -> str:
    """All of it in lines."""
    baudrate = None if model.baudrate is None else f"{model.baudrate} baud"
    head = [model.name, state(model), baudrate, model.device, f"{model.elapsed:.1f} s"]
    pairs = [
        (it.label, it.text) for it in rows(model, glyphs_of(getattr(sys.stdout, "encoding", None)))
    ]
    pairs += [(clock(it.at), it.text) for it in model.events]
    lines = ["  ".join(it for it in head if it), *aligned(pairs)]
    if found := table(model):
        lines += ["", *aligned([HEAD, *found], right=[1])]
    return "\n".join(map(safe, lines))


def facts(model: Model) -> dict[str, Any]:
    """All of it for programs; times in seconds since the monitor began."""
    status = model.status
    told = model.points
    return {
        "source": model.name,
        "state": None if model.state is None else str(model.state),
        "baudrate": model.baudrate,
        "product_code": model.device,
        "seconds": model.elapsed,
        "attitude_deg": None if told is None else told._asdict(),
        "fix": model.fix.type,
        "rtk": model.fix.rtk,
        "status": None
        if status is None
        else dict(flags(int(status.value), 8 * status.value.dtype.itemsize)),
        "counts": asdict(model.counts),
        "events": [asdict(it) for it in model.events],
        "quantities": [
            {
                "name": it.name,
                "coordinates": it.coordinates,
                "unit": it.unit,
                "count": it.count,
                "rate_hz": it.rate(model.now),
                "value": value_facts(it),
            }
            for it in model.quantities.values()
        ],
    }
