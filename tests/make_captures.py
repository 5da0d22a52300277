"""Makes the recordings in ``tests/captures``: a virtual MTi-680G on the belt of a walker.

``python tests/make_captures.py`` writes them; a test holds the files to this program. The numbers are
made up; their formats, rates and order are what such a device sends.

walk.mtb   ten seconds, as a recorder writes them: Configuration first, then what the device sent
field.mtb  the same after a bad day: cut at both ends, bytes flipped and lost, samples missing
"""

from __future__ import annotations

import math
import random
from pathlib import Path

from xbus import MessageId, encode_frame, encode_sample

HERE = Path(__file__).parent / "captures"
RATE = 100
SECONDS = 10
#: Dilutions of precision, Table 25.
DOPS = ("gdop", "pdop", "tdop", "vdop", "hdop", "ndop", "edop")
#: The start date.
START = (2026, 11, 22, 9, 30, 0)


def configuration() -> bytes:
    """Table 14: a device with an 8-byte identifier, its halves exchanged as in real recordings."""
    payload = bytearray(118)
    payload[0:4] = bytes.fromhex("8000A1B2")
    payload[16:32] = b"2026112209295900"
    payload[32:52] = b"MTi-680G-8A1G6".ljust(20)
    payload[96:98] = (1).to_bytes(2, "big")
    payload[98:102] = payload[0:4]
    payload[112:115] = bytes([1, 12, 0])
    return encode_frame(MessageId.Configuration, bytes(payload))


def euler_to_quaternion(roll: float, pitch: float, yaw: float) -> list[float]:
    cr, sr, cp, sp, cy, sy = (
        f(math.radians(a) / 2) for a in (roll, pitch, yaw) for f in (math.cos, math.sin)
    )
    return [
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    ]


def walk() -> list[bytes]:
    """Returns the frames of walk.mtb."""
    noise = random.Random(680)
    frames = [
        configuration(),
        encode_frame(MessageId.FirmwareRev, bytes([1, 12, 0]) + bytes.fromhex("0000001E 00012345")),
    ]
    counter = 65000  # wraps during the recording
    start = 4_294_967_296 - 50_000  # and the time too, after five seconds

    def stamp(ticks: int) -> dict[object, object]:
        nonlocal counter
        counter = (counter + 1) % 65536
        return {"packet_counter": counter, "sample_time_fine": (start + ticks) % 2**32}

    def utc(ticks: int) -> dict[str, int]:
        year, month, day, hour, minute, second = START
        names = ("ns", "year", "month", "day", "hour", "minute", "second", "valid")
        seconds, rest = divmod(ticks, 10_000)
        values = (rest * 100_000, year, month, day, hour, minute, second + seconds, 7)
        return dict(zip(names, values, strict=True))

    for i in range(RATE * SECONDS):
        t = i / RATE
        step = 2 * math.pi * 1.8 * t  # 1.8 steps a second

        def jitter(scale: float) -> float:
            return noise.gauss(0, scale)

        roll, pitch = 4 * math.sin(step / 2) + jitter(0.05), 3 * math.sin(step) + jitter(0.05)
        yaw = 9 * t + 5 * math.sin(step / 2) + jitter(0.05)
        lat, lon = 52.2404 + 1.2e-5 * t, 6.8382 + 4e-6 * t
        packets: dict[object, object] = {
            **stamp(100 * i),
            "utc_time": utc(100 * i),
            "quaternion": euler_to_quaternion(roll, pitch, yaw),
            "euler_angles": [roll, pitch, yaw],
            "acceleration": [
                1.5 * math.sin(step) + jitter(0.02),
                0.8 * math.sin(step / 2) + jitter(0.02),
                9.81 + 2.5 * math.sin(2 * step) + jitter(0.02),
            ],
            "rate_of_turn": [
                math.radians(4 * 5.65 * math.cos(step / 2)) + jitter(0.002),
                math.radians(3 * 11.3 * math.cos(step)) + jitter(0.002),
                math.radians(9 + 5 * 5.65 * math.cos(step / 2)) + jitter(0.002),
            ],
            "magnetic_field": [0.39 + jitter(0.002), 0.02 + jitter(0.002), -0.91 + jitter(0.002)],
            ("lat_lon", "Fp1632"): [lat, lon],
            ("altitude_ellipsoid", "Fp1632"): 81.5 + 0.02 * math.sin(step),
            ("velocity_xyz", "Fp1632"): [0.27 + jitter(0.01), 1.33 + jitter(0.01), jitter(0.01)],
            "status_word": 0x0980_0006,
        }
        if i % 10 == 0:
            packets["baro_pressure"] = 100_260 + noise.randrange(-3, 4)
        if i % RATE == 0:
            packets["temperature"] = 31.5 + t / 40
        frames.append(encode_sample(packets.items()))  # type: ignore[arg-type]
        if i % 25 == 24:
            frames.append(encode_sample(receiver(stamp(100 * i - 450), utc(100 * i), lat, lon)))
    return frames


def receiver(
    stamps: dict[object, object], utc: dict[str, int], lat: float, lon: float
) -> dict[object, object]:
    """Returns a message of the GNSS receiver, which is some tens of milliseconds late."""
    pvt = dict.fromkeys(("velD", "Reserved1", "nano", "headMot", "headVeh", *DOPS), 0)
    date = {"year": utc["year"], "month": utc["month"], "day": utc["day"], "hour": utc["hour"]}
    pvt |= date | {"min": utc["minute"], "sec": utc["second"], "valid": 7, "tAcc": 25}
    pvt |= {"itow": 34_200_000 + utc["second"] * 1000, "fixtype": 3, "flags": 0x83, "numSV": 19}
    pvt |= {"lat": round(lat * 1e7), "lon": round(lon * 1e7), "height": 81_500, "hMSL": 38_700}
    pvt |= {"hAcc": 14, "vAcc": 19, "velN": 1330, "velE": 270, "gSpeed": 1357, "sAcc": 60}
    pvt |= {"headAcc": 0xFFFF_FFFF, "pdop": 112, "hdop": 61, "vdop": 94}
    return {"gnss_pvt_data": pvt, "utc_time": utc, **stamps}


def field() -> bytes:
    """Returns the bytes of field.mtb."""
    frames = walk()
    bad = random.Random(13)
    del frames[300:312], frames[700:701]  # never received
    data = bytearray(b"".join(frames)[40:-60])
    for _ in range(6):
        data[bad.randrange(len(data))] ^= 1 << bad.randrange(8)
    for _ in range(3):
        del data[bad.randrange(len(data))]
    at = bad.randrange(len(data))
    data[at:at] = b"\xfa\xff\x36\xfe" + bad.randbytes(60)
    error = encode_frame(MessageId.Error, b"\x29")  # data overflow, baud rate too low
    middle = data.index(frames[500])
    data[middle:middle] = error
    return bytes(data)


def captures() -> dict[str, bytes]:
    """Returns all recordings by file name."""
    return {"walk.mtb": b"".join(walk()), "field.mtb": field()}


if __name__ == "__main__":
    HERE.mkdir(exist_ok=True)
    for name, data in captures().items():
        (HERE / name).write_bytes(data)
