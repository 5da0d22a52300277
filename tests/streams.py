"""Byte streams for tests and benchmarks: realistic, random, damaged and hostile ones.

The bytes depend only on the arguments, so the same call returns the same bytes.

    frame(mid, payload), packet(data_id, data), real(data_id, *numbers)      by hand
    ahrs(n), hr(n), gnssins(n), dirty(n, seed)                     n messages of one kind of device
    random_frames(rng), random_log(rng), damage(data, rng)             everything that can be sent
    only_fa(n), zeros(n), lying(n), claims(n, length)                  n bytes of hostile input
"""

from __future__ import annotations

import math
import random
import struct
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

import reference

# ---------------------------------------------------------------------------------------------
# Frames and packets
# ---------------------------------------------------------------------------------------------


def frame(mid: int, payload: bytes = b"", bid: int = 0xFF, *, extended: bool = False) -> bytes:
    """A whole frame (Table 3 of the manual); with the extended length from 255 bytes on, or always.

    A reader must take the extended form for any length, though writers use it for long ones only.
    """
    if extended or len(payload) >= 0xFF:
        header = struct.pack(">BBBH", bid, mid, 0xFF, len(payload))
    else:
        header = struct.pack(">BBB", bid, mid, len(payload))
    body = header + payload
    return b"\xfa" + body + bytes([-sum(body) % 256])


def packet(data_id: int, data: bytes) -> bytes:
    """One packet of an MTData2 message."""
    return struct.pack(">HB", data_id, len(data)) + data


def mtdata2(*packets: bytes, bid: int = 0xFF) -> bytes:
    """An MTData2 frame of these packets."""
    return frame(0x36, b"".join(packets), bid)


def number(value: float, precision: int) -> bytes:
    """A real number as Float32, Fp1220, Fp1632 or Float64 (0 to 3)."""
    match precision:
        case 0:
            return struct.pack(">f", value)
        case 1:
            return round(value * 2**20).to_bytes(4, "big", signed=True)
        case 2:
            raw = round(value * 2**32).to_bytes(6, "big", signed=True)
            return raw[2:6] + raw[0:2]
        case 3:
            return struct.pack(">d", value)
    raise ValueError(precision)


def real(data_id: int, *values: float) -> bytes:
    """A packet of real numbers in the format that its identifier names."""
    return packet(data_id, b"".join(number(value, data_id & 0x3) for value in values))


# ---------------------------------------------------------------------------------------------
# The streams of the benchmarks
# ---------------------------------------------------------------------------------------------

VECTOR = (">f4", (3,))
FP1632 = np.dtype([("fraction", ">u4"), ("integer", ">i2")])

AHRS_PACKETS: list[tuple[str, int, Any]] = [
    ("packet_counter", 0x1020, ">u2"),
    ("sample_time_fine", 0x1060, ">u4"),
    ("quaternion", 0x2010, (">f4", (4,))),
    ("acceleration", 0x4020, VECTOR),
    ("rate_of_turn", 0x8020, VECTOR),
    ("magnetic_field", 0xC020, VECTOR),
    ("status_word", 0xE020, ">u4"),
]

GNSSINS_PACKETS: list[tuple[str, int, Any]] = [
    *AHRS_PACKETS,
    ("lat_lon", 0x5042, (FP1632, (2,))),
    ("altitude_ellipsoid", 0x5022, FP1632),
    ("velocity_xyz", 0xD012, (FP1632, (3,))),
    ("utc_time", 0x1010, [("ns", ">u4"), ("year", ">u2"), ("rest", "u1", (6,))]),
]

PVT_FIELDS = reference.STRUCTS[0x7010][2].split()


def _frames(count: int, packets: list[tuple[str, int, Any]]) -> NDArray[Any]:
    """`count` MTData2 frames of one layout, the numbers still to be filled in."""
    fields: list[Any] = [("header", "u1", (4,))]
    for name, _, kind in packets:
        kind = kind if isinstance(kind, tuple) else (kind,)
        fields += [(name + "_id", ">u2"), (name + "_size", "u1"), (name, *kind)]
    frames = np.zeros(count, np.dtype([*fields, ("checksum", "u1")]))
    frames["header"] = (0xFA, 0xFF, 0x36, frames.dtype.itemsize - 5)
    for name, data_id, _ in packets:
        frames[name + "_id"] = data_id
        frames[name + "_size"] = frames.dtype[name].itemsize
    return frames


def _seal(frames: NDArray[Any]) -> NDArray[np.uint8]:
    """The bytes of the frames, one row each, with their checksums."""
    frames["checksum"] = 0
    rows = frames.view("u1").reshape(len(frames), frames.dtype.itemsize)
    frames["checksum"] = -rows[:, 1:].sum(axis=1, dtype="i8") % 256
    return rows


def _fp1632(values: NDArray[np.float64]) -> NDArray[Any]:
    """Numbers as Fp1632."""
    raw = np.rint(values * 2.0**32).astype("i8")
    result = np.zeros(raw.shape, FP1632)
    result["fraction"] = raw & 0xFFFF_FFFF
    result["integer"] = raw >> 32
    return result


def _fill_inertial(frames: NDArray[Any], rng: np.random.Generator) -> None:
    """A device that is turned by hand: quaternion, acceleration, rate of turn, magnetic field."""
    n = len(frames)
    t = np.arange(n) / 400
    phase, rate = rng.uniform(0, 2 * math.pi, 4), rng.uniform(0.2, 2.0, 4)
    q = np.sin(t[:, None] * rate + phase) + 0.01 * rng.standard_normal((n, 4)) + 0.02
    frames["quaternion"] = q / np.linalg.norm(q, axis=1, keepdims=True)
    frames["acceleration"] = (0.0, 0.0, 9.81) + 0.4 * rng.standard_normal((n, 3))
    frames["rate_of_turn"] = np.cos(t[:, None] * rate[:3]) + 0.01 * rng.standard_normal((n, 3))
    frames["magnetic_field"] = (0.4, -0.2, -0.85) + 0.01 * rng.standard_normal((n, 3))
    frames["status_word"] = 3
    frames["status_word"][rng.random(n) < 0.01] |= 1 << 22  # SyncOut marker


def _counters(n: int, rng: np.random.Generator) -> NDArray[Any]:
    """PacketCounters of n messages in a row."""
    return (int(rng.integers(65536)) + np.arange(n)) % 65536


def ahrs(n: int, seed: int = 1) -> bytes:
    """n messages of an AHRS at 400 Hz, 88 bytes each: counter, time, four quantities, status."""
    rng = np.random.default_rng(seed)
    frames = _frames(n, AHRS_PACKETS)
    _fill_inertial(frames, rng)
    frames["packet_counter"] = _counters(n, rng)
    frames["sample_time_fine"] = int(rng.integers(10**6)) + 25 * np.arange(n)
    return _seal(frames).tobytes()


def hr(n: int, seed: int = 2) -> bytes:
    """n high-rate messages, 27 bytes each: time, and acceleration or rate of turn in order of time.

    The rates are those of a 600-series: 2000 and 1600 Hz (Tables 23 and 24).
    """
    rng = np.random.default_rng(seed)
    frames = _frames(n, [("sample_time_fine", 0x1060, ">u4"), ("vector", 0x4040, VECTOR)])
    times = np.concatenate([np.arange(n) * 5.0, np.arange(n) * 6.25 + 2])
    order = np.argsort(times, kind="stable")[:n]
    turning = order >= n
    frames["sample_time_fine"] = int(rng.integers(10**6)) + times[order].astype("i8")
    frames["vector_id"] = np.where(turning, 0x8040, 0x4040)
    noise = rng.standard_normal((n, 3))
    frames["vector"] = np.where(turning[:, None], 0.02 * noise, (0, 0, 9.81) + 0.3 * noise)
    return _seal(frames).tobytes()


def _utc(frames: NDArray[Any], seconds: NDArray[np.float64]) -> None:
    """UtcTime from 2025-07-13 09:00 on, every field in its range."""
    whole = np.floor(seconds).astype("i8")
    frames["utc_time"]["ns"] = np.rint((seconds - whole) * 1e4).astype("i8") % 10_000 * 100_000
    frames["utc_time"]["year"] = 2025
    rest = np.zeros((len(frames), 6), "u1")
    rest[:, 0], rest[:, 1], rest[:, 5] = 7, 13, 0x37
    rest[:, 2], rest[:, 3], rest[:, 4] = 9 + whole // 3600 % 14, whole // 60 % 60, whole % 60
    frames["utc_time"]["rest"] = rest


def gnssins(n: int, seed: int = 3) -> bytes:
    """n messages of a GNSS/INS at 100 Hz: AHRS, position, velocity and UTC; every 25th is GNSS.

    As on a real device the GNSS message, GnssPvtData first, is a separate message, counts as the
    others do, and carries a time some 45 ms older than its neighbours'. The first one is such.
    """
    rng = np.random.default_rng(seed)
    index = np.arange(n)
    gnss = index % 25 == 0
    counter = _counters(n, rng)
    fine = 10_000 + int(rng.integers(10**6)) + 100 * index

    ins = _frames(int((~gnss).sum()), GNSSINS_PACKETS)
    _fill_inertial(ins, rng)
    ins["status_word"] |= 1 << 2  # GNSS fix
    seconds = index[~gnss] / 100
    ins["packet_counter"], ins["sample_time_fine"] = counter[~gnss], fine[~gnss]
    track = np.stack([np.sin(seconds / 60), np.cos(seconds / 60)], axis=1)
    ins["lat_lon"] = _fp1632((52.2405, 6.8382) + 1e-3 * track)
    ins["altitude_ellipsoid"] = _fp1632(56.7 + rng.standard_normal(len(ins)))
    velocity = np.column_stack([1.9 * track, 0.01 * np.ones(len(ins))])
    ins["velocity_xyz"] = _fp1632(velocity + 0.05 * rng.standard_normal((len(ins), 3)))
    _utc(ins, seconds)

    layout = reference.STRUCTS[0x7010][1]
    kind = [(f, ">" + reference.DTYPES[c]) for f, c in zip(PVT_FIELDS, layout, strict=True)]
    pvt = _frames(
        int(gnss.sum()),
        [
            ("gnss_pvt_data", 0x7010, kind),
            ("utc_time", 0x1010, GNSSINS_PACKETS[-1][2]),
            ("sample_time_fine", 0x1060, ">u4"),
            ("packet_counter", 0x1020, ">u2"),
        ],
    )
    seconds = index[gnss] / 100
    pvt["packet_counter"] = counter[gnss]
    pvt["sample_time_fine"] = fine[gnss] - 450
    _utc(pvt, seconds)
    typical = {"valid": 0x37, "tAcc": 5, "fixtype": 3, "flags": 1, "numSV": 12, "hAcc": 2262}
    typical |= {"vAcc": 2077, "sAcc": 390, "headAcc": 15_028_926, "headVeh": 131_072}
    typical |= {"year": 2025, "month": 7, "day": 13}
    typical |= {dop + "dop": 50 + 10 * i for i, dop in enumerate("gptvhne")}
    for name, value in typical.items():
        pvt["gnss_pvt_data"][name] = value
    whole = np.floor(seconds).astype("i8")
    varied = {
        "itow": 49_662_250 + 250 * np.arange(len(pvt)),
        "hour": 9 + whole // 3600 % 14,
        "min": whole // 60 % 60,
        "sec": whole % 60,
        "nano": np.rint((seconds - whole) * 1e9) - 230_787,
        "lat": 522_405_000 + rng.integers(-10_000, 10_000, len(pvt)),
        "lon": 68_382_000 + rng.integers(-10_000, 10_000, len(pvt)),
        "height": 56_700 + rng.integers(-300, 300, len(pvt)),
        "hMSL": 13_900 + rng.integers(-300, 300, len(pvt)),
        "velN": rng.integers(-2000, 2000, len(pvt)),
        "velE": rng.integers(-2000, 2000, len(pvt)),
        "velD": rng.integers(-50, 50, len(pvt)),
        "gSpeed": rng.integers(0, 2800, len(pvt)),
    }
    for name, values in varied.items():
        pvt["gnss_pvt_data"][name] = values

    others = iter(_seal(ins))
    ours = iter(_seal(pvt))
    return b"".join(next(ours if own else others).tobytes() for own in gnss)


def dirty(n: int, seed: int = 4) -> bytes:
    """The stream of `ahrs`, one byte in a thousand flipped, one lost, and bursts rich in FA."""
    return damage(ahrs(n, seed), random.Random(seed))


def _events(rng: random.Random, length: int, rate: float) -> Iterator[int]:
    """Positions below `length`, each met with probability `rate`."""
    if rate <= 0:
        return
    at = -1
    while True:
        gap = math.log(1 - rng.random()) / math.log(1 - rate) if rate < 1 else 0
        at += 1 + int(gap)
        if at >= length:
            return
        yield at


def damage(
    data: bytes,
    rng: random.Random,
    flips: float = 1e-3,
    drops: float = 1e-3,
    bursts: float = 1e-4,
) -> bytes:
    """`data` with one bit flipped, a byte lost or a burst of garbage put in, at rates per byte.

    A burst is up to 64 bytes, every fourth of them FA on average.
    """
    marks = [(at, "flip") for at in _events(rng, len(data), flips)]
    marks += [(at, "drop") for at in _events(rng, len(data), drops)]
    marks += [(at, "burst") for at in _events(rng, len(data), bursts)]
    result = bytearray()
    done = 0
    for at, what in sorted(marks):
        if at < done:
            continue
        result += data[done:at]
        done = at
        if what == "burst":
            size = rng.randint(1, 64)
            result += bytes(rng.choice((0xFA, *rng.randbytes(3))) for _ in range(size))
        elif what == "flip":
            result.append(data[at] ^ 1 << rng.randrange(8))
            done = at + 1
        else:
            done = at + 1
    return bytes(result + data[done:])


# ---------------------------------------------------------------------------------------------
# Random logs
# ---------------------------------------------------------------------------------------------

# Identifiers with unknown contents.
STRANGE_IDS = (0x0000, 0x1110, 0x3330, 0x7770, 0x777F, 0x9994, 0xF0F0, 0xFAFA, 0xFFFF)

# Messages that are not documented, and some that only a host sends.
STRANGE_MIDS = (0x00, 0x10, 0x30, 0x3F, 0x9D, 0xB2, 0xC0, 0xEC, 0xF0, 0xFA)

PRODUCTS = (
    b"MTi-3-8A7G6",
    b"MTi-30-2A5G4",
    b"MTi-300-2A5G4",
    b"MTi-320-8A1G6",
    b"MTi-G-710-2A5G4",
    b"MTi-630-8A1G6",
    b"MTi-680G-8A1G6",
    b"Avior-M1",
    b"Sirius-AHRS",
    b"MTi-28A53G35",
    b"MTw2-3A7G6",
)

IDS = (0x0370_03F8, 0x0368_248C, 0x0770_10E6, 0x0388_7B6D, 0x03D0_0123, 0x0B40_0001, 0x8000_40D2)

ACCELERATION, STATUS_WORD = 0x4020, 0xE020


def random_number(rng: random.Random, precision: int) -> bytes:
    """A real number: any bits, or one from the edges of its format."""
    edges = [0.0, 1.0, -1.0, 0.5, -9.81, 2047.9999990463257, -2048.0]
    match rng.randrange(3):
        case 0:
            return number(rng.choice(edges), precision)
        case 1 if precision in (0, 3):
            width = reference.WIDTHS[precision]
            quiet = rng.choice((0x7FF8, 0xFFF4, 0x7FF0, 0xFFF0) if precision else (0x7FC0, 0x7F80))
            return quiet.to_bytes(2, "big") + rng.choice((bytes(width - 2), b"\1" * (width - 2)))
        case 1:
            return number(rng.uniform(-2000, 2000), precision)
    return rng.randbytes(reference.WIDTHS[precision])


def random_packet(rng: random.Random, base: int | None = None) -> bytes:
    """A packet that fits its identifier, or with an unknown identifier."""
    if base is None:
        tables = [*reference.REALS, *reference.NUMBERS, *reference.STRUCTS]
        base = rng.choice([*tables, reference.DEVICE_ID_PACKET, reference.GNSS_SAT_INFO, -1, -1])
    if base == -1:
        return packet(rng.choice(STRANGE_IDS), rng.randbytes(rng.choice((0, 1, 4, 12, 60, 255))))
    if base in reference.REALS:
        precision = rng.randrange(4)
        systems = (0x0, 0x4, 0x8) if base in reference.ROTATES else (0x0, 0x0, 0x4, 0x8, 0xC)
        values = [random_number(rng, precision) for _ in range(reference.REALS[base][1])]
        return packet(base | precision | rng.choice(systems), b"".join(values))
    format_bits = rng.choice((0, 0, 0, 3, 6, 0xF))
    if base in reference.NUMBERS:
        size = struct.calcsize(">" + reference.NUMBERS[base][1])
    elif base in reference.STRUCTS:
        size = struct.calcsize(">" + reference.STRUCTS[base][1])
    elif base == reference.DEVICE_ID_PACKET:
        size = rng.choice((4, 8))
    else:
        count = rng.choice((0, 1, 2, 28, 60))
        head = rng.randbytes(4) + bytes((count, 0, 0, 0))
        return packet(base | format_bits, head + rng.randbytes(4 * count))
    return packet(base | format_bits, rng.randbytes(size))


class RandomDevice:
    """A device whose counter and clock behave as those of real devices, most of the time."""

    def __init__(self, rng: random.Random, bids: Sequence[int]) -> None:
        """A device on these bus identifiers, about to wrap or not."""
        self.rng = rng
        self.bids = bids
        self.modulus = rng.choice((reference.DAY, reference.ALL_BITS))
        self.ticks = rng.choice((0, 51_703_123, self.modulus - 300, 3 * self.modulus - 100))
        self.counter = rng.choice((0, 43_398, 65_530))

    def stamps(self) -> list[bytes]:
        """Counter and time of the next message, either of them missing at times."""
        rng = self.rng
        found = []
        if rng.random() < 0.9:
            steps = (1, 1, 1, 1, 1, 1, 2, 5, 0, -1, 300, 32_767, 32_768, 40_000)
            self.counter += rng.choice(steps)
            found.append(packet(0x1020, struct.pack(">H", self.counter % 65536)))
        if rng.random() < 0.9:
            self.ticks = max(0, self.ticks + rng.choice((25, 25, 25, 100, 100, 0, -40, 2_000)))
            fine = self.ticks % self.modulus
            if rng.random() < 0.03:
                fine = rng.randrange(reference.ALL_BITS)
            found.append(packet(0x1060, struct.pack(">I", fine)))
        if rng.random() < 0.2:
            coarse = self.ticks // reference.TICKS
            if rng.random() < 0.1:
                coarse = rng.randrange(reference.ALL_BITS)
            found.append(packet(0x1070, struct.pack(">I", coarse % reference.ALL_BITS)))
        return found

    def sample(self) -> bytes:
        """An MTData2 message, mostly of the usual kind."""
        rng = self.rng
        packets: list[bytes]
        match rng.choice(("inertial",) * 4 + ("anything",) * 4 + ("gnss", "trigger", "hr", "bare")):
            case "inertial":
                packets = [*self.stamps(), random_packet(rng, 0x2010), random_packet(rng, 0x4020)]
            case "anything":
                packets = self.stamps() + [random_packet(rng) for _ in range(rng.randrange(5))]
                if rng.random() < 0.3:
                    rng.shuffle(packets)
                if rng.random() < 0.2 and packets:
                    packets.append(rng.choice(packets))
            case "gnss":
                older = max(0, self.ticks - 450) % self.modulus
                fine = rng.choice((older, older, rng.randrange(reference.ALL_BITS)))
                self.counter += 1
                packets = [
                    random_packet(rng, rng.choice((0x7010, reference.GNSS_SAT_INFO))),
                    packet(0x1060, struct.pack(">I", fine)),
                    packet(0x1020, struct.pack(">H", self.counter % 65536)),
                ]
            case "trigger":
                stamp = (self.ticks * 100 + rng.randrange(-5_000, 5_000)) % reference.ALL_BITS
                data = struct.pack(">BBIH", rng.choice((2, 9)), 1, stamp, 0)
                packets = [packet(rng.choice((0x4810, 0x4820, 0x4830)), data)]
            case "hr":
                packets = [random_packet(rng, rng.choice((0x4040, 0x8040)))]
                if rng.random() < 0.7:
                    self.ticks += 5
                    fine = self.ticks % self.modulus
                    packets.insert(0, packet(0x1060, struct.pack(">I", fine)))
            case _:
                packets = [random_packet(rng, 0xE020)]
        return self._frame(0x36, b"".join(packets) or random_packet(rng, 0xE020))

    def message(self) -> bytes:
        """A message of a length that a device sends it with."""
        rng = self.rng
        lengths = {mid: sizes for mid, sizes in reference.LENGTHS.items() if sizes}
        match rng.randrange(3):
            case 0:
                mid = rng.choice(list(lengths))
                payload = rng.randbytes(rng.choice(list(lengths[mid])))
            case 1:
                mid, payload = rng.choice(reference.RESTARTS), b""
            case _:
                mid, payload = self._name()
        return self._frame(mid, payload)

    def odd(self) -> bytes:
        """An intact frame that is accepted only for its place in the stream."""
        rng = self.rng
        match rng.randrange(7):
            case 0:  # an unknown message, some of them long
                size = rng.choice((0, 1, 7, 60, 254, 255, 300, 3_000))
                return self._frame(rng.choice(STRANGE_MIDS), rng.randbytes(size))
            case 1:  # a bus identifier that no single device has
                return frame(0x36, random_packet(rng), rng.choice((0, 32, 0x55, 0xFA, 0xFE)))
            case 2:  # a known message of an unusual length
                return self._frame(rng.choice((0x01, 0x03, 0x13, 0x25, 0x8D)), rng.randbytes(13))
            case 3:  # a packet of a size that its identifier does not allow
                bad = rng.choice((ACCELERATION, STATUS_WORD, 0x1060, 0x1020, 0x7010, 0x7020))
                payload = b"".join(self.stamps()) + packet(bad, rng.randbytes(rng.choice((1, 9))))
                return self._frame(0x36, payload)
            case 4:  # coordinates that are not defined
                return self._frame(0x36, b"".join(self.stamps()) + real(0x201C, 1, 0, 0, 0))
            case 5:  # MTData2 that its packets do not tile
                payload = b"".join(self.stamps()) + rng.choice(
                    (b"\x40", b"\x40\x20", b"\x40\x20\x0c")
                )
                return self._frame(0x36, payload)
        return self._frame(0x36, b"")  # and an empty one

    def long(self) -> bytes:
        """A frame that needs the extended length."""
        rng = self.rng
        if rng.random() < 0.3:
            return self._frame(0x91, rng.randbytes(rng.randint(255, 2_000)))
        packets = self.stamps()
        while sum(map(len, packets)) < 255:
            packets.append(random_packet(rng))
        return self._frame(0x36, b"".join(packets))

    def _name(self) -> tuple[int, bytes]:
        """A message that names the device."""
        rng = self.rng
        device_id = rng.choice(IDS).to_bytes(4, "big")
        match rng.choice((0x01, 0x01, 0x03, 0x0D, 0x1D)):
            case 0x01:
                return 0x01, rng.choice((device_id, bytes(4) + device_id, device_id + bytes(4)))
            case 0x03:
                return 0x03, device_id
            case 0x0D:
                halves = rng.choice((device_id + b"\x04\x80\0\0", bytes(4) + device_id))
                return 0x0D, halves + bytes(89) + b"\1" + device_id + bytes(16)
        return 0x1D, rng.choice(PRODUCTS).ljust(20)

    def _frame(self, mid: int, payload: bytes) -> bytes:
        """A frame from this device; one in twenty with an extended length it does not need."""
        extended = self.rng.random() < 0.05
        return frame(mid, payload, self.rng.choice(self.bids), extended=extended)


def random_frames(rng: random.Random, count: int | None = None) -> list[bytes]:
    """Frames of up to three devices: samples of everything, messages, odd and long frames."""
    buses = rng.sample([(0xFF,), (0xFF, 0xFF, 1), (1,), (2,), (31,)], rng.choice((1, 1, 2, 3)))
    devices = [RandomDevice(rng, bids) for bids in buses]
    kinds = (
        [RandomDevice.sample] * 15
        + [RandomDevice.message] * 3
        + [RandomDevice.odd] * 2
        + [RandomDevice.long]
    )
    count = rng.randint(1, 40) if count is None else count
    return [rng.choice(kinds)(rng.choice(devices)) for _ in range(count)]


def sentence(body: str, end: str = "\r\n") -> bytes:
    """An NMEA sentence of this body, with its checksum."""
    total = 0
    for character in body:
        total ^= ord(character)
    return f"${body}*{total:02X}{end}".encode("ascii")


def random_string(rng: random.Random) -> bytes:
    """A string output, or sometimes an invalid one."""
    numbers = [rng.choice(["", "0", "-4.56", " 001.2", "123.45", "+.5", "1e3"]) for _ in range(3)]
    text = ",".join(numbers)
    string = rng.choice(
        [
            sentence(f"{rng.choice(['HEHDT', 'HCHDM', 'XSVEL', 'GPGSV', 'P'])},{text}"),
            sentence(f"PSONCMS,{text}", rng.choice(["\r\n", "\n", "\r", ""])),
            f"$PRDID,{text}\r\n".encode("ascii"),
            b":12345  0000H 0123 -0456F\r\n",
            struct.pack("<BBhhhH", 0, 0x90, 123, -456, 0, rng.randrange(40_000)),
            sentence("HCHDG," + "x" * rng.randrange(230, 250)),
            frame(0x8F, b"\0\x20"),
        ]
    )
    if rng.random() < 0.2:
        at = rng.randrange(len(string))
        string = (
            string[:at] + rng.choice([b"", b"$", b":", b"\0", b"\xfa", b"*"]) + string[at + 1 :]
        )
    return string


def random_log(rng: random.Random, count: int | None = None) -> bytes:
    """An intact stream of those frames: all of them must be found."""
    return b"".join(random_frames(rng, count))


# ---------------------------------------------------------------------------------------------
# Hostile input, n bytes of it
# ---------------------------------------------------------------------------------------------


def _repeat(pattern: bytes, n: int) -> bytes:
    """n bytes of a pattern."""
    return (pattern * (n // len(pattern) + 1))[:n]


def only_fa(n: int) -> bytes:
    """Nothing but preambles."""
    return _repeat(b"\xfa", n)


def zeros(n: int) -> bytes:
    """No preamble at all."""
    return bytes(n)


def lying(n: int) -> bytes:
    """Headers of MTData2 frames that each claim 65,535 bytes, one after the other."""
    return _repeat(b"\xfa\xff\x36\xff\xff\xff", n)


def claims(n: int, length: int) -> bytes:
    """Headers of MTData2 frames that each claim `length` bytes, one after the other."""
    return _repeat(b"\xfa\xff\x36\xff" + struct.pack(">H", length), n)
