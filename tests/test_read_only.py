"""Every array of a log is read-only: what was decoded stays as it was decoded."""

from __future__ import annotations

import random
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

import streams
import xbus


def arrays(owner: Any, name: str) -> Iterator[tuple[str, np.ndarray[Any, Any]]]:
    """The arrays among the public attributes, by name."""
    for attribute in dir(owner):
        if attribute.startswith("_"):
            continue
        try:
            value = getattr(owner, attribute)
        except AttributeError:  # of other quantities
            continue
        if isinstance(value, np.ndarray):
            yield f"{name}.{attribute}", value


def arrays_of_log(log: xbus.Log) -> Iterator[tuple[str, np.ndarray[Any, Any]]]:
    yield from arrays(log, "log")
    yield from arrays(log.messages, "messages")
    yield from arrays(log.strings, "strings")
    for data_id, unknown in log.unknown.items():
        yield from arrays(unknown, f"unknown[{data_id}]")
    for key in log:
        yield from arrays(log[key], log[key].name)


def everything() -> bytes:
    """Samples of all quantities, other messages, strings and damage."""
    rng = random.Random(4)
    data = b"".join(streams.random_log(rng) for _ in range(20))
    string = xbus.encode_string("HEHDT", {"heading": 12.5})
    sample = xbus.encode_sample({"rotation_matrix": np.eye(3), "status_word": 3})
    return sample + string + data + bytes(7) + sample


@pytest.mark.parametrize("data", [everything(), b""], ids=["everything", "nothing"])
def test_arrays_are_read_only(data: bytes) -> None:
    log = xbus.read_log(data)
    found = dict(arrays_of_log(log))
    expected = {"log.offset", "log.bid", "log.time", "log.packet_counter", "log.damage"}
    expected |= {"messages.offset", "messages.sample", "messages.mid", "messages.bid"}
    expected |= {"strings.offset", "strings.sample", "strings.end"}
    if data:
        quantities = ("acceleration", "utc_time", "gnss_sat_info", "rotation_matrix")
        expected |= {f"{name}.{of}" for name in quantities for of in ("values", "sample", "time")}
        expected |= {"gnss_sat_info.satellites", "gnss_sat_info.scaled", "utc_time.datetime"}
    assert expected <= found.keys()
    assert [name for name, array in found.items() if array.flags.writeable] == []


def test_what_the_core_hands_over_is_read_only() -> None:
    log = xbus.read_log(everything())
    core = log._core
    owners = [core, core.damage, core.messages, core.strings, *core.columns]
    found = [found for owner in owners for found in arrays(owner, type(owner).__name__)]
    assert len(found) > 50
    assert [name for name, array in found if array.flags.writeable] == []
