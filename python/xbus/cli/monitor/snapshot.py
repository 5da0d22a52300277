"""The state of a stream, printed once: as text and as JSON."""

from __future__ import annotations

import sys
from dataclasses import asdict
from typing import Any

from xbus.cli.printing import align
from xbus.formatting import printable
from xbus.watch.model import Model
from xbus.watch.rows import (
    HEAD,
    device_state,
    format_elapsed,
    glyphs_for,
    status_rows,
    value_rows,
)
from xbus.watch.values import set_flags, value_json

__all__ = ["snapshot_dict", "snapshot_text"]


def snapshot_text(model: Model) -> str:
    """Returns the state as lines of text."""
    baudrate = None if model.baudrate is None else f"{model.baudrate} baud"
    head = [model.name, device_state(model), baudrate, model.device, f"{model.elapsed:.1f} s"]
    glyphs = glyphs_for(getattr(sys.stdout, "encoding", None))
    pairs = [(row.label, row.text) for row in status_rows(model, glyphs)]
    pairs += [(format_elapsed(event.at), event.text) for event in model.events]
    lines = ["  ".join(part for part in head if part), *align(pairs)]
    if rows := value_rows(model):
        lines += ["", *align([HEAD, *rows], right=[1])]
    return "\n".join(map(printable, lines))


def snapshot_dict(model: Model) -> dict[str, Any]:
    """Returns the state for JSON; times are seconds since the monitor started."""
    status = model.status
    flags = None
    if status is not None:
        flags = dict(set_flags(status.name, int(status.value)))
    return {
        "source": model.name,
        "state": None if model.state is None else str(model.state),
        "baudrate": model.baudrate,
        "product_code": model.device,
        "seconds": model.elapsed,
        "attitude_deg": None if model.attitude is None else model.attitude._asdict(),
        "fix": model.fix.type,
        "rtk": model.fix.rtk,
        "status": flags,
        "counts": asdict(model.counts),
        "events": [asdict(event) for event in model.events],
        "quantities": [
            {
                "name": quantity.name,
                "coordinates": quantity.coordinates,
                "unit": quantity.unit,
                "count": quantity.count,
                "rate_hz": quantity.rate(model.now),
                "value": value_json(quantity),
            }
            for quantity in model.quantities.values()
        ],
    }
