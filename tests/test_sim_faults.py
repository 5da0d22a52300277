"""Lines with faults: their damage, and that it is reproducible."""

from __future__ import annotations

import functools
from collections.abc import Iterable
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from xbus import Device, Sample, SimulatedDevice
from xbus.sim.faults import STALL_BUFFER, Faults, FaultyLine
from xbus.sim.link import SimLink

DATA = np.random.default_rng(1).integers(0, 256, 20_000, np.uint8).tobytes()


def through(faults: Faults, data: bytes = DATA, time: float = 0.0) -> bytes:
    """Returns the bytes that arrive after bytes are sent at one time."""
    line = FaultyLine(faults)
    line.feed(data, time)
    return line.take(1e9)


def flipped_bits(received: bytes, sent: bytes) -> int:
    differing = np.frombuffer(received, np.uint8) ^ np.frombuffer(sent, np.uint8)
    return int(np.unpackbits(differing).sum())


@pytest.mark.parametrize("probability", [1e-5, 1e-3, 0.1, 0.9])
def test_flips_have_their_probability(probability: float) -> None:
    received = through(Faults(flip=probability))
    expected = 8 * len(DATA) * probability
    assert abs(flipped_bits(received, DATA) - expected) < 5 * expected**0.5
    assert len(received) == len(DATA)


@pytest.mark.parametrize("probability", [1e-3, 0.1, 0.9])
def test_drops_have_their_probability(probability: float) -> None:
    received = through(Faults(drop=probability))
    expected = len(DATA) * probability
    assert abs(len(DATA) - len(received) - expected) < 5 * expected**0.5
    rest = iter(DATA)
    assert all(byte in rest for byte in received), "the others keep their order"


def test_probabilities_of_0_and_1() -> None:
    assert through(Faults()) == DATA
    assert through(Faults(flip=1e-300, drop=1e-300)) == DATA
    assert through(Faults(flip=1)) == bytes(byte ^ 0xFF for byte in DATA)
    assert through(Faults(drop=1)) == b""


def test_the_seed_determines_the_damage() -> None:
    first, again, other = (through(Faults(flip=1e-3, drop=1e-3, seed=seed)) for seed in (1, 1, 2))
    assert first == again
    assert first != other


@given(st.lists(st.integers(0, len(DATA))))
def test_chunking_has_no_effect(cuts: list[int]) -> None:
    faults = Faults(flip=1e-3, drop=1e-3, burst=0.1)
    line = FaultyLine(faults)
    ends = [0, *sorted(cuts), len(DATA)]
    received = b""
    for start, end in pairwise(ends):
        line.feed(DATA[start:end], 0.05)
        received += line.take(0.06)
    assert received == b""
    assert line.take(0.1) == through(faults)


def arrivals(faults: Faults, times: list[float], until: float = 20.0) -> dict[str, float]:
    """Returns when bytes sent at these times arrive, to a tenth of a second."""
    line = FaultyLine(faults)
    came: dict[str, float] = {}
    for tick in range(round(until * 10) + 1):
        now = tick / 10
        if now in times:
            line.feed(str(now).encode() + b" ", now)
        came |= dict.fromkeys(line.take(now).decode().split(), now)
    return came


@pytest.mark.parametrize(
    ("faults", "sent", "came"),
    [
        (Faults(), [0.0, 0.1, 7.3], {"0.0": 0.0, "0.1": 0.1, "7.3": 7.3}),
        (Faults(burst=0.5), [0.0, 0.1, 0.5, 0.6], {"0.0": 0.0, "0.1": 0.5, "0.5": 0.5, "0.6": 1.0}),
        (Faults(stall=(5, 2)), [4.9, 5.0, 6.9, 7.0], {"4.9": 4.9, "5.0": 7.0, "6.9": 7.0, "7.0": 7.0}),
        (Faults(stall=(5, 2), burst=3), [4.0, 5.5], {"4.0": 6.0, "5.5": 9.0}),
        (Faults(unplug=(5, 2)), [4.9, 5.0, 6.9, 7.0], {"4.9": 4.9, "7.0": 7.0}),
        (Faults(unplug=(5, None)), [4.9, 5.0, 19.0], {"4.9": 4.9}),
        (Faults(unplug=(5, 2), burst=3), [2.0, 4.0, 7.5], {"2.0": 3.0, "7.5": 9.0}),
        (Faults(unplug=(6, 2), stall=(5, 2)), [4.0, 5.5, 8.0], {"4.0": 4.0, "8.0": 8.0}),
    ],
)  # fmt: skip
def test_bytes_arrive_when_bursts_and_stalls_let_them(
    faults: Faults, sent: list[float], came: dict[str, float]
) -> None:
    assert arrivals(faults, sent) == came


def test_a_stall_buffers_64_kib() -> None:
    line = FaultyLine(Faults(stall=(1, 1)))
    line.feed(b"a" * (STALL_BUFFER - 1), 1.0)
    line.feed(b"bc", 1.5)
    line.feed(b"d", 1.6)
    line.feed(b"e", 2.0)
    assert line.take(1.9) == b""
    assert line.take(2.0) == b"a" * (STALL_BUFFER - 1) + b"be"


def test_bytes_are_lost_while_the_plug_is_out() -> None:
    line = FaultyLine(Faults(unplug=(5, 2)))
    assert [line.is_plugged(time) for time in (0.0, 4.9, 5.0, 6.9, 7.0)] == [
        True,
        True,
        False,
        False,
        True,
    ]
    assert not FaultyLine(Faults(unplug=(5, None))).is_plugged(1e9)


@pytest.mark.parametrize(
    ("text", "faults"),
    [
        ("", Faults(seed=3)),
        ("flip=1e-4", Faults(flip=1e-4, seed=3)),
        ("drop=0.5 burst=0.016", Faults(drop=0.5, burst=0.016, seed=3)),
        ("stall=5:2 unplug=10:3", Faults(stall=(5, 2), unplug=(10, 3), seed=3)),
        ("unplug=10", Faults(unplug=(10, None), seed=3)),
    ],
)
def test_parse(text: str, faults: Faults) -> None:
    assert Faults.parse(text.split(), seed=3) == faults


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("flop=1", "'flop=1' is not a fault: use flip=P, "),
        ("seed=1", "'seed=1' is not a fault: use "),
        ("flip", "'flip' is not a fault: use "),
        ("flip=much", "'flip=much' is not a fault: use "),
        ("stall=5", "'stall=5' is not a fault: use "),
        ("unplug=1:2:3", "'unplug=1:2:3' is not a fault: use "),
        ("flip=0.1 flip=0.1", "flip is given twice"),
        ("drop=1.5", "drop is a probability, from 0 to 1, not 1.5"),
        ("flip=nan", "flip is a probability, from 0 to 1, not nan"),
        ("burst=-1", "burst must be 0 seconds or more, not -1.0"),
        ("stall=inf:1", "the time of stall must be 0 seconds or more, not inf"),
        ("unplug=1:-1", "the duration of unplug must be 0 seconds or more, not -1.0"),
    ],
)
def test_parse_refuses_other_texts(text: str, message: str) -> None:
    with pytest.raises(ValueError, match="^" + message.replace("(", r"\(")):
        Faults.parse(text.split())


def test_the_constructor_checks_its_values() -> None:
    wrong: list[dict[str, Any]] = [{"flip": 2}, {"burst": -1}, {"stall": (-1, 1)}]
    for arguments in wrong:
        with pytest.raises(ValueError, match="not"):
            Faults(**arguments)


# A device behind a faulty line


def samples_of(device: SimulatedDevice, seconds: float) -> list[Sample]:
    """Returns the bytes that a program receives in the first seconds."""
    host = Device(SimLink(device))
    found = []
    while device.time < seconds:
        found.append(host.read_sample())
    return found


@functools.cache
def samples_behind(
    product: str, rate: int | None, seed: int, faults: Faults | None, seconds: float
) -> list[Sample]:
    """Returns what a program receives from a noisy device behind a line."""
    device = SimulatedDevice(product, baudrate=rate, noise=1.0, seed=seed, faults=faults)
    return samples_of(device, seconds)


def numbers(samples: Iterable[Sample]) -> list[int]:
    return [int(sample["packet_counter"]) for sample in samples]


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize(("product", "rate"), [("MTi-630", None), ("MTi-680G", 115_200)])
@pytest.mark.parametrize(
    "faults",
    [
        Faults(),
        Faults(burst=0.016),
        Faults(stall=(3.0, 2.0)),
        Faults(flip=3e-5),
        Faults(drop=1e-3),
        Faults(drop=1e-2),
        Faults(burst=0.016, flip=3e-5, drop=1e-3, stall=(5.0, 1.0)),
    ],
    ids=str,
)
def test_received_samples_are_right_and_lost_ones_are_counted(
    faults: Faults, product: str, rate: int | None, seed: int
) -> None:
    """Every received sample was sent, once and in order, and the counter shows how many are missing.

    Several flipped bits in a frame could make a wrong one right: a sum of eight bits promises no more.
    """
    sent = samples_behind(product, rate, seed, None, 10.5)
    came = samples_behind(product, rate, seed, replace(faults, seed=seed), 10.0)
    assert numbers(sent) == list(range(len(sent)))
    received = numbers(came)
    assert all(before < after for before, after in pairwise(received))
    assert {message.payload for message in came} <= {message.payload for message in sent}

    # A damaged byte costs its frame and no other.
    sizes = np.array([len(message.payload) + 5 for message in sent[: received[-1] + 1]])
    expected = (1 - (1 - faults.drop) ** sizes * (1 - faults.flip) ** (8 * sizes)).sum()
    missing = len(sizes) - len(received)
    assert abs(missing - expected) <= 4 * expected**0.5
