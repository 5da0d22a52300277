"""Helpers of the tests: random streams, and comparison of a log with the reference decoder.

    shared(path)                 a file beside the repository; the test skips where it is absent
    exchanges()                  published exchanges of hosts and devices, by product
    read(data, ...)              bytes -> Log, with the options that read_log does not have
    facts(log or logs)           the whole content of a log, by name; parts of a log are joined
    facts_of(reference)          the same for the reference decoder
    differences(one, other)      a description of where they differ
    AlteredDevice(product)       a virtual device that changes what the host receives
    sound_streams(), ...         strategies for hypothesis

A stream is bytes; what a stream can hold is in `streams`.
"""

from __future__ import annotations

import gc
import os
import random
import struct
from collections.abc import Callable, Generator, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st

import reference
import streams
import xbus
from reference import Reference
from streams import packet
from xbus import Column, Log, MessageId, SimulatedDevice, _core, connect
from xbus.protocol import encode

if TYPE_CHECKING:
    from object_store import ObjectStore

settings.register_profile(
    "default", deadline=None, max_examples=60, suppress_health_check=[HealthCheck.too_slow]
)
settings.register_profile("thorough", parent=settings.get_profile("default"), max_examples=2000)
# CI uses the same inputs every time; local runs use random ones.
settings.register_profile("ci", parent=settings.get_profile("default"), derandomize=True)
settings.load_profile(
    os.environ.get("HYPOTHESIS_PROFILE", "ci" if "CI" in os.environ else "default")
)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers() -> int | None:
    """Returns how many workers `-n auto` starts: one more than processors, because many tests wait."""
    if "PYTEST_XDIST_AUTO_NUM_WORKERS" in os.environ:
        return None
    affinity = getattr(os, "sched_getaffinity", None)
    processors = len(affinity(0)) if affinity else os.cpu_count() or 1
    return processors + 1


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Keeps the garbage collector from searching the tests and the libraries that they import."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


SHARED = Path(__file__).resolve().parents[2] / "shared"
OWN_CAPTURES = Path(__file__).parent / "captures"


@pytest.fixture(scope="session")
def store() -> Iterator[ObjectStore]:
    """An S3 server on loopback."""
    from object_store import object_store  # imported late: only few tests need it

    with object_store() as server:
        yield server


def shared(path: str) -> Path:
    """Returns a file beside the repository; skips the test if the file is absent."""
    found = SHARED / path
    if not found.exists():
        pytest.skip(f"{found} is absent")
    return found


def exchanges() -> dict[str, list[str]]:
    """Returns published exchanges by product: from Config State on, requests and replies alternate."""
    lines = (Path(__file__).parent / "spec" / "exchanges.txt").read_text().splitlines()
    found: dict[str, list[str]] = {}
    for line in lines:
        if line.startswith("["):
            found[line.strip("[]")] = exchange = []
        elif line and not line.startswith("#"):
            exchange.append(line)
    return found


# ---------------------------------------------------------------------------------------------
# Packets by their contents
# ---------------------------------------------------------------------------------------------


def fine(ticks: int) -> bytes:
    """SampleTimeFine."""
    return packet(0x1060, struct.pack(">I", ticks))


def coarse(seconds: int) -> bytes:
    """SampleTimeCoarse."""
    return packet(0x1070, struct.pack(">I", seconds))


def counter(value: int) -> bytes:
    """PacketCounter."""
    return packet(0x1020, struct.pack(">H", value % 65536))


def trigger(microseconds: int, data_id: int = 0x4810) -> bytes:
    """TriggerIn on line 9, rising."""
    return packet(data_id, struct.pack(">BBIH", 9, 1, microseconds, 0))


# ---------------------------------------------------------------------------------------------
# Reading
# ---------------------------------------------------------------------------------------------


def read(data: bytes, *, limit: int = 0xFFFF, fast: bool = True) -> Log:
    """Returns the log in `data`; without `fast` only the plain path reads it."""
    array = np.frombuffer(data, np.uint8)
    reader = _core.Reader(array, limit=limit, strict=False, wanted=None, fast=fast)
    while reader.advance(1 << 40):
        pass
    return Log(reader.take())


Facts: TypeAlias = dict[str, Any]


def facts(*parts: Log) -> Facts:
    """Returns the whole content of a log. Several parts are joined, and should equal the whole."""
    result: Facts = {
        "offset": _joined([part.offset for part in parts]),
        "bid": _joined([part.bid for part in parts]),
        "time": _joined([part.time for part in parts]),
        "packet counter": _joined([part.packet_counter for part in parts]),
        "restarts": _joined([part.core.restarts.sample for part in parts]),
        "messages": [message for part in parts for message in _messages(part)],
        "strings": [string for part in parts for string in _strings(part)],
        "damage": [item for part in parts for item in part.damage.tolist()],
        "unknown": {},
        "stats": {
            key: sum(vars(part.stats)[key] for part in parts) for key in vars(parts[0].stats)
        },
    }
    found: dict[tuple[str, str | None], list[Column]] = {}
    for part in parts:
        for data_id, unknown in part.unknown.items():
            rows = zip(unknown.sample.tolist(), unknown, strict=True)
            result["unknown"].setdefault(data_id, []).extend(rows)
        for key in part:
            column = part[key]
            found.setdefault((column.name, column.coordinates), []).append(column)
    for name, columns in found.items():
        data_ids = {column.data_id for column in columns}
        result[f"{name} sample"] = _joined([column.sample for column in columns])
        result[f"{name} time"] = _joined([column.time for column in columns])
        result[f"{name} values"] = _joined([column.values for column in columns])
        result[f"{name} data_id"] = (
            data_ids.pop() if len(data_ids) == 1 else data_ids.pop() & 0xFFF0
        )
        precisions = {column.precision for column in columns}
        result[f"{name} precision"] = precisions.pop() if len(precisions) == 1 else None
        if name[0] == "gnss_sat_info":
            counts = _joined([np.diff(column.offsets) for column in columns])
            result["satellites"] = _joined([column.satellites for column in columns])
            result["satellites begin"] = np.concatenate(([0], np.cumsum(counts)))
    return result


def facts_of(log: Reference) -> Facts:
    """Returns the same for the reference decoder."""
    result: Facts = {
        "offset": np.array([offset for offset, _ in log.samples], "i8"),
        "bid": np.array([bid for _, bid in log.samples], "u1"),
        "time": np.array(log.time, "f8"),
        "packet counter": np.array(log.packet_counter, "i8"),
        "restarts": np.array(log.restarts, "i8"),
        "messages": [tuple(message) for message in log.messages],
        "strings": [
            (*string, sum(offset < string.offset for offset, _ in log.samples))
            for string in log.strings
        ],
        "damage": [tuple(item) for item in log.damage],
        "unknown": log.unknown,
        "stats": log.stats,
    }
    for key, rows in log.columns.items():
        data_ids = {row.data_id for row in rows}
        sample = reference.samples_of(log, key)
        result[f"{key} sample"] = sample
        result[f"{key} time"] = result["time"][sample]
        result[f"{key} values"] = reference.array(log, key)
        result[f"{key} data_id"] = (
            rows[0].data_id if len(data_ids) == 1 else rows[0].data_id & 0xFFF0
        )
        precisions = {row.data_id & 3 for row in rows}
        is_real = rows[0].data_id & 0xFFF0 in reference.REALS
        is_one = is_real and len(precisions) == 1
        names = ("Float32", "Fp1220", "Fp1632", "Float64")
        result[f"{key} precision"] = names[precisions.pop()] if is_one else None
        if key[0] == "gnss_sat_info":
            result["satellites"], result["satellites begin"] = reference.satellites(log)
    return result


def differences(one: Facts, other: Facts) -> list[str]:
    """Returns the facts that differ, and those that only one side has."""
    alone = [f"only on one side: {item}" for item in one.keys() ^ other.keys()]
    apart = [item for item in one.keys() & other.keys() if not _same(one[item], other[item])]
    return sorted(alone + [f"{item}: {_short(one[item], other[item])}" for item in apart])


def _same(one: Any, other: Any) -> bool:
    if isinstance(one, np.ndarray):
        return reference.same_bits(one, other)
    return bool(one == other)


def _short(one: Any, other: Any) -> str:
    if isinstance(one, list):
        at = next(
            (i for i, pair in enumerate(zip(one, other, strict=False)) if pair[0] != pair[1]), None
        )
        at = min(len(one), len(other)) if at is None else at
        return f"at {at}: {one[at : at + 2]} and {other[at : at + 2]}"
    if isinstance(one, np.ndarray) and one.shape == other.shape and one.dtype == other.dtype:
        rows = range(len(one))
        at = next((i for i in rows if one[i].tobytes() != other[i].tobytes()), 0)
        return f"at {at} of {len(one)}: {one[at]} and {other[at]}"
    if isinstance(one, np.ndarray):
        return f"{one.dtype} {one.shape} and {other.dtype} {other.shape}"
    return f"{one} and {other}"


def _messages(log: Log) -> list[tuple[Any, ...]]:
    return [
        (message.mid, message.bid, message.payload, message.offset, message.sample)
        for message in log.messages
    ]


def _strings(log: Log) -> list[tuple[Any, ...]]:
    def name(string: xbus.String) -> str | None:
        return string.type.name if string.type is not None else None

    return [(string.offset, name(string), string.data, string.sample) for string in log.strings]


def _joined(arrays: list[npt.NDArray[Any]]) -> npt.NDArray[Any]:
    with np.errstate(invalid="ignore"):  # a signalling NaN is quiet once it is widened
        return arrays[0] if len(arrays) == 1 else np.concatenate(arrays)


# ---------------------------------------------------------------------------------------------
# Strategies
# ---------------------------------------------------------------------------------------------

SEEDS = st.integers(0, 2**32 - 1)

#: Bytes to insert into a stream: noise, preambles, headers with a wrong length, whole frames.
INTRUDERS = st.one_of(
    st.binary(min_size=1, max_size=40),
    st.integers(1, 40).map(streams.only_fa),
    st.integers(1, 40).map(streams.lying),
    st.integers(0, 255).map(lambda size: b"\xfa\xff\x36" + bytes([size])),
    SEEDS.map(lambda seed: streams.random_string(random.Random(seed))),
    st.sampled_from((0, 1, 60, 254, 255, 3000, 65535)).map(lambda size: streams.claims(6, size)),
    SEEDS.map(lambda seed: streams.random_frames(random.Random(seed), 1)[0]),
)


@st.composite
def edits(draw: st.DrawFn) -> tuple[float, str, Any]:
    """Draws one change of a stream: where, as a fraction of its length, and what."""
    where = draw(st.floats(0, 1))
    what = draw(st.sampled_from(("flip", "drop", "insert", "repeat")))
    detail: Any
    if what == "flip":
        detail = draw(st.integers(0, 7))
    elif what == "insert":
        detail = draw(INTRUDERS)
    else:
        detail = draw(st.sampled_from((1, 1, 1, 2, 5, 40, 200)))
    return where, what, detail


def edited(data: bytes, changes: list[tuple[float, str, Any]]) -> bytes:
    """Returns the stream with the changes applied."""
    for where, what, detail in changes:
        at = min(int(where * len(data)), max(0, len(data) - 1))
        if what == "flip" and data:
            data = data[:at] + bytes([data[at] ^ 1 << detail]) + data[at + 1 :]
        elif what == "drop":
            data = data[:at] + data[at + detail :]
        elif what == "insert":
            data = data[:at] + detail + data[at:]
        elif what == "repeat":
            data = data[: at + detail] + data[at:]
    return data


@st.composite
def sound_streams(draw: st.DrawFn, most: int = 60) -> bytes:
    """Draws frames of everything that a device can send. They repeat, so that layouts are learned."""
    rng = random.Random(draw(SEEDS))
    frames = streams.random_frames(rng, draw(st.integers(0, most)))
    return b"".join(frames * draw(st.sampled_from((1, 1, 2, 3))))


@st.composite
def damaged_streams(draw: st.DrawFn, most: int = 60) -> bytes:
    """Draws the same, with up to eight changes."""
    return edited(draw(sound_streams(most)), draw(st.lists(edits(), max_size=8)))


#: Fine times near the two wraps of the products, one day and 32 bits, and in between.
FINE_TIMES = st.one_of(
    *(
        st.integers(max(0, at - 200), min(at + 200, 2**32 - 1))
        for at in (0, 432_000_000, 864_000_000, 2**31, 2**32 - 1)
    )
)
STAMPS = st.builds(
    lambda *packets: b"".join(packets),
    st.just(b"") | st.integers(0, 0xFFFF).map(counter),
    st.just(b"") | FINE_TIMES.map(fine),
    st.just(b"") | st.integers(0, 2**32 - 1).map(coarse) | st.integers(86_390, 86_410).map(coarse),
    st.just(b"") | st.integers(0, 2**32 - 1).map(trigger),
    st.just(b"") | st.just(bytes.fromhex("7020 08 00000000 00000000")),
)
#: What devices send: samples, messages that name the device, and messages that start a new run.
MESSAGES_OF_DEVICES = st.sampled_from(
    [(MessageId.DeviceID, encode("DeviceID", number)) for number in (0x0370_03F8, 0x8000_5BF5)]
    + [(MessageId.ProductCode, encode("ProductCode", "MTi-30-2A5G4"))]
    + [(mid, b"") for mid in (MessageId.WakeUp, MessageId.GoToMeasurementAck, MessageId.ResetAck)]
)
SENT = st.tuples(
    st.sampled_from([0xFF, 1, 2]),
    st.one_of(*[STAMPS.map(lambda payload: (MessageId.MTData2, payload))] * 4, MESSAGES_OF_DEVICES),
)


@st.composite
def clock_streams(draw: st.DrawFn) -> bytes:
    """Draws samples with time stamps of every kind, of several devices, which restart and are named."""
    sent = draw(st.lists(SENT, max_size=40))
    return b"".join(xbus.encode_frame(mid, payload, bid=bid) for bid, (mid, payload) in sent)


@st.composite
def damaged_clock_streams(draw: st.DrawFn) -> bytes:
    """Draws the same, with up to eight changes."""
    return edited(draw(clock_streams()), draw(st.lists(edits(), max_size=8)))


# ---------------------------------------------------------------------------------------------
# Devices
# ---------------------------------------------------------------------------------------------


class AlteredDevice(SimulatedDevice):
    """A virtual device that records what the host sends, and changes what the host receives.

    Attributes:
        written: What the host has sent, one item for each call of `write`.
        alter: Returns what the host receives instead of these bytes, which may be empty.
    """

    def __init__(self, product: str, **settings: Any) -> None:
        super().__init__(product, **settings)
        self.written: list[bytes] = []
        self.alter: Callable[[bytes], bytes] = lambda data: data

    def write(self, data: bytes, baudrate: int | None = None) -> None:
        self.written.append(data)
        super().write(data, baudrate)

    def read(self, baudrate: int | None = None) -> bytes:
        return self.alter(super().read(baudrate))


@pytest.fixture
def behind(monkeypatch: pytest.MonkeyPatch) -> Callable[[SimulatedDevice], str]:
    """Puts a virtual device behind a port of this process, and returns the name of the port."""

    def put(sim: SimulatedDevice) -> str:
        monkeypatch.setattr(
            "xbus.device.connect", lambda _, *args, **more: connect(sim, *args, **more)
        )
        return "mti"

    return put
