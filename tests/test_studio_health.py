"""The strip of the studio: what is always in view about a device."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("nicegui", reason="the extra studio is not installed")

import xbus
from xbus.protocol.tables import STATUS_FLAGS
from xbus.studio.health import ages, clipping, devices, filter_state
from xbus.watch.model import Clipped, Model, QuantityState
from xbus.watch.rows import BAD, DIM, GOOD, PLAIN, WARNING


def model_with(now: float = 100.0, **arrived: float) -> Model:
    """The state of a stream with quantities of 100 Hz that arrived last at these times."""
    model = Model("port", now=now)
    for name, at in arrived.items():
        quantity = QuantityState(name)
        quantity.update(1, at - 0.01, float("nan"))
        quantity.update(1, at, float("nan"))
        model.quantities[name, None] = quantity
    return model


def ages_of(model: Model, configured: Any = None) -> Any:
    outputs = (
        None if configured is None else [SimpleNamespace(quantity=name) for name in configured]
    )
    station: Any = SimpleNamespace(model=model, outputs=outputs)
    return ages(station)


def test_ages() -> None:
    assert ages_of(model_with()) == []
    assert ages_of(model_with(acceleration=99.9)) == [("all values are current", GOOD)]
    some = {"acceleration": 99.9, "temperature": 95.0, "lat_lon": 60.0}
    assert ages_of(model_with(**some)) == [
        ("lat_lon 40 s old", WARNING),
        ("temperature 5 s old", WARNING),
    ]
    # What is no longer configured is not missing.
    assert ages_of(model_with(**some), ["acceleration", "temperature"]) == [
        ("temperature 5 s old", WARNING)
    ]


def test_a_quantity_in_other_coordinates_is_current() -> None:
    model = model_with(quaternion=50.0)
    model.quantities["quaternion", "NED"] = model_with(quaternion=99.9).quantities[
        "quaternion", None
    ]
    assert ages_of(model) == [("all values are current", GOOD)]


def test_devices_whose_numbers_are_mixed() -> None:
    model = model_with(acceleration=99.9)
    model.devices = {1}
    assert devices(model) == []
    model.devices = {2, 1}
    assert devices(model) == [("BID 1, 2: the numbers mix them, plots do not", WARNING)]


def test_ages_of_many() -> None:
    old = {f"quantity{number}": 90.0 - number for number in range(5)}
    assert ages_of(model_with(**old)) == [("nothing for 10 s", WARNING)]
    assert ages_of(model_with(acceleration=99.9, **old)) == [
        ("quantity4 14 s old", WARNING),
        ("quantity3 13 s old", WARNING),
        ("quantity2 12 s old", WARNING),
        ("and 2 more", WARNING),
    ]


def watched(**quantities: Any) -> Model:
    model = Model("port")
    model.add_block(xbus.read_log(xbus.encode_sample(quantities)), now=1.0)
    return model


def word(**fields: int) -> int:
    return sum(value << STATUS_FLAGS[name].bit for name, value in fields.items())


LEVEL = [1.0, 0.0, 0.0, 0.0]


@pytest.mark.parametrize(
    ("quantities", "parts"),
    [
        ({"temperature": 20.0}, []),
        ({"quaternion": LEVEL}, [("no status word", DIM)]),
        ({"quaternion": LEVEL, "status_word": 0}, [("not valid", WARNING)]),
        ({"acceleration": [0, 0, 9.8], "status_word": 0}, []),
        ({"quaternion": LEVEL, "status_byte": 2}, [("valid", GOOD)]),
        (
            {"status_word": word(filter_valid=1, gnss_fix=1, filter_mode=1)},
            [("valid", GOOD), ("coasting after its loss", PLAIN)],
        ),
        (
            {"status_word": word(filter_valid=1, gnss_fix=1, filter_mode=2)},
            [("valid", GOOD), ("mode 2", PLAIN)],
        ),
    ],
)
def test_filter(quantities: Any, parts: Any) -> None:
    assert filter_state(watched(**quantities)) == parts


def test_clipping() -> None:
    assert clipping(Model("port")) == []
    assert clipping(watched(temperature=20.0)) == [("no status word", DIM)]
    assert clipping(watched(status_word=0)) == [("none", GOOD)]
    model = watched(status_word=word(clip_acc_x=1, clipping=1))
    assert clipping(model) == [("acc x now (1 sample)", BAD)]
    model.now = 31.0
    model.clipped["gyr z"] = Clipped(1234, 30.5)
    assert clipping(model) == [
        ("gyr z now (1,234 samples)", BAD),
        ("acc x 30 s ago (1 sample)", WARNING),
    ]
    model.now = 91.0
    assert clipping(model)[1] == ("acc x 90 s ago (1 sample)", DIM)


@pytest.mark.parametrize("block", [1, 2, 3])
def test_clipped_samples_are_counted_one_by_one(block: int) -> None:
    words = [word(clip_acc_x=1, clipping=1), word(clipping=1), word(clip_acc_x=1, clip_mag_z=1)]
    model = Model("port")
    for first in range(0, len(words), block):
        frames = [xbus.encode_sample({"status_word": each}) for each in words[first:][:block]]
        model.add_block(xbus.read_log(b"".join(frames)), now=1.0)
    counts = {name: clipped.samples for name, clipped in model.clipped.items()}
    assert counts == {"acc x": 2, "mag z": 1, "a sensor": 1}
