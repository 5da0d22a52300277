"""Hostile bytes: their cost, the frames that they hide, and the messages that they give.

The attacks are generated, not kept as files: one line describes a million false preambles.
"""

from __future__ import annotations

import random
import struct
import subprocess
import sys
import textwrap
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import reference
import streams
import xbus
from conftest import counter, differences, facts, facts_of, fine, read
from streams import frame, mtdata2, packet, real

MEGABYTE = 1 << 20
GOOD = mtdata2(counter(1), fine(100), real(0x4020, 1, 2, 3))


def repeated(pattern: bytes, size: int) -> bytes:
    return (pattern * (size // len(pattern) + 1))[:size]


def other_identifiers(size: int) -> bytes:
    """Returns messages of one packet each, with all 65536 identifiers in turn."""
    one_turn = b"".join(mtdata2(packet(data_id, b"")) for data_id in range(65536))
    return repeated(one_turn, size)


def half_tiled(size: int) -> bytes:
    """Returns overlapping MTData2 messages of 60,000 bytes, which packets tile far into each."""
    header = b"\xfa\xff\x36\xff\xea\x60"
    return repeated(header + b"\x70\x00\x00" * 40, size)


ATTACKS: dict[str, Callable[[int], bytes]] = {
    "nothing but preambles": streams.only_fa,
    "no preamble": streams.zeros,
    "lengths that lie": streams.lying,
    "claims of 254 bytes": lambda n: repeated(b"\xfa\xff\x36\xfe", n),
    "claims of 8185 bytes": lambda n: streams.claims(n, 8185),
    "claims of 65535 bytes": lambda n: streams.claims(n, 65535),
    "claims of what a device may send": lambda n: repeated(b"\xfa\xff\x91\xff\x1f\xf9", n),
    "half tiled messages": half_tiled,
    "noise": lambda n: random.Random(1).randbytes(n),
    "noise full of preambles": lambda n: random.Random(2).randbytes(n).replace(b"\0", b"\xfa\xff\x36"),
    "the smallest messages": lambda n: repeated(frame(0x3E), n),
    "the smallest messages, torn apart": lambda n: repeated(frame(0x3E) + b"\0", n),
    "empty MTData2": lambda n: repeated(mtdata2(), n),
    "the smallest samples": lambda n: repeated(mtdata2(packet(0x7000, b"")), n),
    "packets without data": lambda n: repeated(frame(0x36, b"\x70\x00\x00" * 84), n),
    "long messages of packets without data": lambda n: repeated(frame(0x36, b"\x70\x00\x00" * 21_000), n),
    "all identifiers in turn": other_identifiers,
    "one packet forty times": lambda n: repeated(mtdata2(*[counter(7)] * 40), n),
    "satellites": lambda n: repeated(mtdata2(packet(0x7020, b"\0\0\0\0\x3d" + bytes(247))), n),
}  # fmt: skip


# ---------------------------------------------------------------------------------------------
# Messages
# ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("attack", ATTACKS.values(), ids=ATTACKS)
def test_hostile_input_gives_the_expected_messages(attack: Callable[[int], bytes]) -> None:
    """The reader and the oracle agree on a small input, alone and between sound messages."""
    data = attack(3000)
    for whole in (data, GOOD * 3 + data + GOOD * 3 + data):
        assert differences(facts(xbus.read_log(whole)), facts_of(reference.decode(whole))) == []
        parts = xbus.iter_log(whole, block_bytes=500)
        assert differences(facts(*parts), facts_of(reference.decode(whole))) == []


@pytest.mark.parametrize("attack", ATTACKS.values(), ids=ATTACKS)
def test_every_byte_is_counted(attack: Callable[[int], bytes]) -> None:
    data = attack(MEGABYTE)
    log = xbus.read_log(data)
    assert log.stats.bytes == len(data)
    assert log.stats.skipped_bytes == log.damage["length"].sum()
    sizes = [
        len(message.payload) + (7 if len(message.payload) > 254 else 5)
        for message in log.messages[:1000]
    ]
    assert log.stats.frames == log.stats.samples + log.stats.messages
    assert log.stats.skipped_bytes + sum(sizes) <= len(data)


@pytest.mark.parametrize("attack", ATTACKS.values(), ids=ATTACKS)
def test_frames_after_hostile_input_are_found(attack: Callable[[int], bytes]) -> None:
    """Hostile bytes do not hide a sound recording behind them.

    The exceptions are headers of messages that a device may send and that may hold anything: there are a
    thousand of them in the last 8185 bytes, and one in 256 has the right sum.
    """
    if attack is ATTACKS["claims of what a device may send"]:
        pytest.skip("the checksum has eight bits")
    data = attack(MEGABYTE)
    sound = streams.gnssins(200)
    log = xbus.read_log(data + sound)
    behind = log.offset[log.offset >= len(data)] - len(data)
    assert behind.tolist() == xbus.read_log(sound).offset.tolist()


# ---------------------------------------------------------------------------------------------
# Cost
# ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("attack", ATTACKS.values(), ids=ATTACKS)
def test_time_is_linear(attack: Callable[[int], bytes], tmp_path: Path) -> None:
    """Eight megabytes: a reader that checks each header from scratch would take hours."""
    path = tmp_path / "attack.mtb"
    path.write_bytes(attack(8 * MEGABYTE))
    assert repr(xbus.read_log(path))
    for part in xbus.iter_log(path, block_bytes=MEGABYTE):
        assert part.device_id is None


MEASURE = """\
    import sys
    import xbus

    def resident(name):
        with open("/proc/self/status") as status:
            return next(int(line.split()[1]) << 10 for line in status if line.startswith(name))

    def reset():
        with open("/proc/self/clear_refs", "w") as file:
            file.write("5")

    (path,) = sys.argv[1:]
    xbus.read_log(bytes(100_000))
    reset()
    before = resident("VmRSS:")
    log = xbus.read_log(path)
    whole = resident("VmHWM:") - before
    # Afterwards, because malloc keeps freed memory once parts have been read.
    del log
    reset()
    before = resident("VmRSS:")
    for log in xbus.iter_log(path, block_bytes=1 << 20):
        pass
    print(resident("VmHWM:") - before, whole)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="measured in /proc")
@pytest.mark.parametrize(
    "name",
    [
        *("nothing but preambles", "lengths that lie", "claims of 65535 bytes", "noise"),
        *("the smallest messages", "the smallest messages, torn apart", "the smallest samples"),
        *("packets without data", "all identifiers in turn"),
    ],
)
def test_memory_is_bounded(name: str, tmp_path: Path) -> None:
    """If every few bytes are a message, memory is that of the messages; otherwise it is negligible."""
    data = ATTACKS[name](8 * MEGABYTE)
    path = tmp_path / "attack.mtb"
    path.write_bytes(data)
    program = [sys.executable, "-c", textwrap.dedent(MEASURE), str(path)]
    result = subprocess.run(program, check=True, capture_output=True, text=True)  # noqa: S603
    parts, whole = map(int, result.stdout.split())
    log = xbus.read_log(data)
    bound = 32 * len(data) if log.stats.frames > 100 else len(data)
    assert whole < bound
    # A part of a megabyte costs at most twice a megabyte; 65536 columns have a fixed cost.
    assert parts < bound / 8 * 2 + 2000 * len(log.unknown) + 2 * MEGABYTE


# ---------------------------------------------------------------------------------------------
# Three laws
# ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "start", [b"\xfa", b"\xfa\xff", b"\xfa\xff\x36", b"\xfa\xff\x36\x10", b"\xfa\xff\x36\xff"]
)
def test_a_false_start_costs_one_byte(start: bytes) -> None:
    """For any header, the search continues one byte after its preamble."""
    for claim in (b"", b"\x00\x20", b"\x1f\xf9", b"\xff\xff"):
        data = GOOD + start + claim + GOOD * 40
        log = xbus.read_log(data)
        assert len(log) == 41
        assert log.damage[["offset", "length"]].tolist() == [(len(GOOD), len(start + claim))]


@pytest.mark.parametrize("length", [0x20, 254, 1003, 65535])
def test_a_frame_inside_a_false_one(length: int) -> None:
    """The false frame ends inside a sound frame, and its checksum is right by chance."""
    sound = b"".join(mtdata2(counter(i), fine(i), real(0x4020, i, 1, 2)) for i in range(3000))
    size = bytes([length]) if length < 255 else b"\xff" + struct.pack(">H", length)
    header = b"\xfa\xff\x36" + size
    data = bytearray(b"\0" + header + sound)
    end = 1 + len(header) + length
    before = data[end]
    data[end] = -sum(data[2:end]) % 256
    assert data[end] != before  # one sound frame is lost
    log = xbus.read_log(bytes(data))
    assert len(log) == 3000 - 1
    assert log.stats.lost_samples == 1


def test_a_message_that_holds_messages() -> None:
    """A payload is not scanned: a recording inside an EmtsData message gives no samples."""
    inner = GOOD * 10
    assert len(inner) > 255
    log = xbus.read_log(GOOD + frame(0x91, inner) + GOOD)
    assert len(log) == 2
    assert log.messages[0].payload == inner


@pytest.mark.parametrize("size", [255, 3000, 65535])
def test_a_long_message_cut_short(size: int) -> None:
    """A message that is cut short does not hide the messages behind it."""
    long = frame(0x91, random.Random(size).randbytes(size).replace(b"\xfa", b"\0"))
    assert len(xbus.read_log(GOOD + long[: size // 2] + GOOD * 2000)) == 2001


# ---------------------------------------------------------------------------------------------
# An intact frame is not lost to the damage beside it
# ---------------------------------------------------------------------------------------------


def frames_of(data: bytes) -> list[bytes]:
    """Returns the frames of a sound stream, all in standard form."""
    frames, at = [], 0
    while at < len(data):
        end = at + data[at + 3] + 5
        frames.append(data[at:end])
        at = end
    return frames


def harmed(
    frames: list[bytes], rng: random.Random, flips: float, drops: float, bursts: float
) -> tuple[bytes, set[int]]:
    """Returns a stream damaged at these rates (per bit, byte and byte), and the offsets of intact frames."""
    out, intact = bytearray(), set()
    for sound in frames:
        size = len(sound)
        spared = (1 - flips) ** (8 * size) * (1 - drops) ** size * (1 - bursts) ** size
        bad = sound
        while rng.random() >= spared and bad == sound:
            bad = streams.damage(sound, rng, 8 * flips, drops, bursts)
        if bad == sound:
            intact.add(len(out))
        out += bad
    return bytes(out), intact


def messages(rng: random.Random, count: int) -> list[bytes]:
    """Returns messages of all kinds that devices send; each is plausible."""
    found: list[bytes] = []
    while len(found) < count:
        some = streams.random_frames(rng, 20)
        found += [
            candidate for candidate in some if reference.plausible(reference.scan(candidate)[0][0])
        ]
    return found


@pytest.mark.parametrize(
    ("flips", "drops", "bursts", "lost"),
    [
        (1e-4, 0, 0, 0),
        (0, 0, 5e-3, 1),
        (1e-3, 1e-4, 1e-4, 1),
        # If a byte of the last packet is lost, the next preamble is taken for the checksum: 1 in 256.
        (1e-3, 1e-3, 1e-3, 5),
    ],
)
def test_intact_frames_are_found(flips: float, drops: float, bursts: float, lost: int) -> None:
    """The rule loses 3 in a million at flips of 1e-3 per bit, and 1e-4 of the other faults."""
    rng = random.Random(7)
    frames = frames_of(streams.gnssins(20_000)) + frames_of(streams.hr(20_000))
    frames += messages(rng, 2_000)
    data, intact = harmed(frames, rng, flips, drops, bursts)
    assert 10_000 < len(intact) < len(frames)
    for limit in (8185, 65535):
        log = read(data, limit=limit)
        found = set(log.offset.tolist()) | set(np.asarray(log.messages.offset).tolist())
        assert len(intact - found) <= lost
        # One damaged frame in 256 has a right checksum by chance, and one in 16 pairs of flips cancel.
        assert len(found - intact) < 0.03 * (len(frames) - len(intact))


def test_every_flipped_bit_of_a_length() -> None:
    """A flipped bit of a length byte costs one message of the stream."""
    rng = random.Random(3)
    sound = frames_of(streams.gnssins(60, 5))
    lost = 0
    for bit in range(8):
        at = rng.randrange(10, 40)
        bad = bytearray(sound[at])
        bad[3] ^= 1 << bit
        log = xbus.read_log(b"".join([*sound[:at], bytes(bad), *sound[at + 1 :]]))
        lost += len(sound) - len(log)
    assert lost == 8
