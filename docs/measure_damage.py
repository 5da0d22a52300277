"""Measures the frames lost and the false frames accepted, with the checksum alone and with the scanner.

``python docs/measure_damage.py [FRAMES]`` prints the table of docs/damage.md, for 400,000 frames by default.
*Lost* frames arrive intact and are not found. *Hit* frames are accepted in place of a real frame although
they changed; *made up* frames are accepted elsewhere.
"""

from __future__ import annotations

import sys

import numpy as np
import numpy.typing as npt

import xbus

#: Probability that a bit flips, that a byte is lost, and that a burst of random bytes precedes a byte.
FLIP, DROP, BURST = 1e-3, 1e-4, 1e-4
#: Share of each kind of frame.
MIX = {"ahrs": 0.4, "gnss/ins": 0.3, "high rate": 0.2, "reply": 0.1}

Bytes = npt.NDArray[np.uint8]
#: Offset and length of each frame.
Found = set[tuple[int, int]]


def stream(count: int, rng: np.random.Generator) -> tuple[Bytes, npt.NDArray[np.int64]]:
    """Concatenated intact frames, and the offset of each."""
    frames = []
    kinds = rng.choice(len(MIX), count, p=list(MIX.values()))
    for i, kind in enumerate(kinds):
        vector = rng.normal(0, 3, (4, 3))
        if kind <= 1:
            packets: dict[object, object] = {
                "packet_counter": i % 65536,
                "sample_time_fine": 100 * i,
            }
            packets |= {"quaternion": [1, *vector[0]], "acceleration": vector[1]}
            packets |= {"rate_of_turn": vector[2], "magnetic_field": vector[3]}
            if kind == 1:
                packets |= {
                    ("lat_lon", "Fp1632"): [52.24, 6.84],
                    ("velocity_xyz", "Fp1632"): vector[0],
                }
            frames.append(xbus.encode_sample(packets | {"status_word": 3}))
        elif kind == 2:
            frames.append(
                xbus.encode_sample({"sample_time_fine": 100 * i, "acceleration_hr": vector[0]})
            )
        else:
            frames.append(xbus.encode_frame(xbus.MessageId.DeviceID, rng.bytes(8)))
    ends = np.cumsum([len(frame) for frame in frames])
    return np.frombuffer(b"".join(frames), np.uint8), np.concatenate(([0], ends))


def damaged(
    sound: Bytes, bounds: npt.NDArray[np.int64], rng: np.random.Generator
) -> tuple[bytes, Found, Found]:
    """The damaged stream, its intact frames, and the frames that changed in place."""
    flips = np.zeros(len(sound), np.uint8)
    for bit in range(8):
        flips |= (rng.random(len(sound)) < FLIP).astype(np.uint8) << bit
    dropped = rng.random(len(sound)) < DROP
    bursts = np.where(rng.random(len(sound)) < BURST, rng.integers(1, 33, len(sound)), 0)

    # Shift and new position of each byte.
    shift = np.cumsum(bursts) - (np.cumsum(dropped) - dropped)
    place = np.arange(len(sound)) + shift
    out = rng.integers(0, 256, len(sound) + bursts.sum() - dropped.sum(), dtype=np.uint8)
    out[place[~dropped]] = (sound ^ flips)[~dropped]

    def among(marks: npt.NDArray[np.bool_], first: int) -> npt.NDArray[np.bool_]:
        """Whether any byte of each frame, from byte `first` on, is marked."""
        count = np.concatenate(([0], np.cumsum(marks)))
        return count[bounds[1:]] > count[bounds[:-1] + first]

    def at(chosen: npt.NDArray[np.bool_]) -> Found:
        starts, lengths = place[bounds[:-1][chosen]], np.diff(bounds)[chosen]
        return set(zip(starts.tolist(), lengths.tolist(), strict=True))

    whole = ~among(dropped, 0) & ~among(bursts > 0, 1)
    changed = among(flips != 0, 0)
    return out.tobytes(), at(whole & ~changed), at(whole & changed)


def by_checksum(data: bytes, limit: int) -> Found:
    """Every candidate with a valid checksum, from left to right."""
    # sums[n]: the sum of the first n bytes, modulo 256.
    sums = b"\0" + np.cumsum(np.frombuffer(data, np.uint8), dtype=np.uint8).tobytes()
    found, at = set(), data.find(0xFA)
    while 0 <= at <= len(data) - 5:
        size, payload = 4, data[at + 3]
        if payload == 0xFF:
            size, payload = 6, int.from_bytes(data[at + 4 : at + 6], "big")
        end = at + size + payload + 1
        if payload <= limit and end <= len(data) and sums[end] == sums[at + 1]:
            found.add((at, end - at))
            at = data.find(0xFA, end)
        else:
            at = data.find(0xFA, at + 1)
    return found


def by_scanner(data: bytes, limit: int) -> Found:
    """The frames that xbus accepts."""
    scanner = xbus.Scanner(limit)
    found = set()
    for event in [*scanner.feed(data), *scanner.close()]:
        if isinstance(event, xbus.Message):
            header = 6 if data[event.offset + 3] == 0xFF else 4
            found.add((event.offset, header + len(event.payload) + 1))
    return found


def main() -> None:
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 400_000
    rng = np.random.default_rng(1)
    data, intact, changed = damaged(*stream(count, rng), rng)
    print(
        f"{count} frames, {len(data)} bytes; {len(intact)} frames intact, {len(changed)} changed in place"
    )
    print(f"{'rule':<10}{'limit':>7}{'lost':>8}{'share':>10}{'hit':>8}{'made up':>9}")
    for name, rule in {"checksum": by_checksum, "xbus": by_scanner}.items():
        for limit in (8185, 65535):
            found = rule(data, limit)
            lost, hit, made_up = intact - found, found & changed, found - intact - changed
            share = len(lost) / len(intact)
            print(f"{name:<10}{limit:>7}{len(lost):>8}{share:>10.1e}{len(hit):>8}{len(made_up):>9}")


if __name__ == "__main__":
    main()
