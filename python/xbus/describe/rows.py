"""The samples of a log as plain values for JSON."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

from xbus.describe.text import finite
from xbus.log.column import Column
from xbus.log.log import Log

__all__ = ["sample_dicts"]


def sample_dicts(log: Log) -> Iterator[dict[str, Any]]:
    """Yields one object per sample: its index, its times, its device, and the quantities that it has.

    A quantity is a number, or an object of its components or fields in their units, with its coordinates if
    it has any. If a sample has it in two coordinate systems, the second one is ``quaternion_ned``. The
    satellites of ``gnss_sat_info`` are a list. A number that JSON does not have (NaN, infinity) is None, and
    so is a time that is not known.

    >>> import json, xbus
    >>> log = xbus.read_log(xbus.encode_sample({"acceleration": (0.5, float("nan"), 9.75)}))
    >>> json.dumps(next(sample_dicts(log))["acceleration"])
    '{"x": 0.5, "y": null, "z": 9.75}'
    """
    utc = np.datetime_as_string(log.utc, "us").tolist()
    heads = zip(log.time.tolist(), utc, log.host_time.tolist(), log.bid.tolist(), strict=True)
    rows: list[dict[str, Any]] = [
        {
            "sample": log.first_sample + at,
            "time": finite(time),
            "utc": None if stamp == "NaT" else f"{stamp}Z",
            "host_time": finite(host_time),
            "bid": bid,
        }
        for at, (time, stamp, host_time, bid) in enumerate(heads)
    ]
    names = [column.name for column in log.values()]
    # Which of two coordinate systems is the first one must not depend on the samples before.
    for column in sorted(
        log.values(), key=lambda column: (names.index(column.name), column.coordinates or "")
    ):
        at = (column.sample - log.first_sample).tolist()
        taken = {row for row in at if column.name in rows[row]}
        second = f"{column.name}_{(column.coordinates or '').lower()}"
        for row, value in zip(at, _values(column), strict=True):
            rows[row][second if row in taken else column.name] = value
    yield from rows


def _values(column: Column) -> Iterator[Any]:
    """Yields the value of each row."""
    if column.name == "gnss_sat_info":
        satellites, ends = _records(column.satellites), column.offsets.tolist()
        for place, head in enumerate(_records(column.scaled)):
            yield head | {"satellites": satellites[ends[place] : ends[place + 1]]}
    elif column.dtype.names:
        yield from _records(column.scaled)
    elif names := column.fields:
        system = {} if column.coordinates is None else {"coordinates": column.coordinates}
        for row in column.values.reshape(len(column), -1).tolist():
            yield dict(zip(names, map(finite, row), strict=True)) | system
    else:
        yield from map(finite, column.values.tolist())


def _records(table: npt.NDArray[Any]) -> list[dict[str, Any]]:
    names = table.dtype.names or ()
    return [dict(zip(names, map(finite, row), strict=True)) for row in table.tolist()]
