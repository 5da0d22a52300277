"""Compares xbus with hand-written parsers: ``python benches/peers.py``.

Three parsers read the same quantities of the same recording in one process, with equal results: a loop over
``struct.unpack``; numpy with one fixed layout, which needs a recording without damage whose messages all have
the same packets; and `xbus.read_log`, which works for any recording. Each uses one thread. Times are relative
to a copy of the bytes.
"""

from __future__ import annotations

import struct
from typing import Any

import numpy as np

import xbus
from common import ahrs_stream, medians

#: The packets of a message: name, data identifier, struct format, numpy type, count of numbers.
PACKETS = [
    ("packet_counter", 0x1020, "H", ">u2", 1),
    ("sample_time_fine", 0x1060, "I", ">u4", 1),
    ("quaternion", 0x2010, "4f", ">f4", 4),
    ("acceleration", 0x4020, "3f", ">f4", 3),
    ("rate_of_turn", 0x8020, "3f", ">f4", 3),
    ("magnetic_field", 0xC020, "3f", ">f4", 3),
    ("status_word", 0xE020, "I", ">u4", 1),
]
BY_ID = {id_: (name, struct.Struct(">" + fmt)) for name, id_, fmt, _, _ in PACKETS}


def by_struct(data: bytes) -> dict[str, list[Any]]:
    """Parses message by message and packet by packet, and verifies checksums."""
    columns: dict[str, list[Any]] = {name: [] for name, *_ in PACKETS}
    at = 0
    while at + 5 <= len(data):
        length = data[at + 3]
        end = at + 5 + length
        if data[at] != 0xFA or sum(data[at + 1 : end]) & 0xFF:
            at += 1
            continue
        packet = at + 4
        while packet < end - 1:
            id_ = data[packet] << 8 | data[packet + 1]
            name, layout = BY_ID[id_]
            columns[name].append(layout.unpack_from(data, packet + 3))
            packet += 3 + data[packet + 2]
        at = end
    return columns


def by_numpy(data: bytes) -> dict[str, Any]:
    """Parses all messages at once, with the packets of the first, and verifies checksums."""
    fields: list[Any] = [("head", "V4")]
    for name, _, _, type_, count in PACKETS:
        fields += [(f"{name}_head", "V3"), (name, type_, (count,)) if count > 1 else (name, type_)]
    table = np.frombuffer(data, np.dtype([*fields, ("checksum", "u1")]))
    raw = np.frombuffer(data, np.uint8).reshape(len(table), -1)
    if (raw[:, 0] != 0xFA).any() or raw[:, 1:].sum(axis=1, dtype=np.uint8).any():
        raise ValueError("the recording is damaged, or its messages differ")
    return {name: table[name].astype(table[name].dtype.newbyteorder("=")) for name, *_ in PACKETS}


def by_xbus(data: bytes) -> dict[str, Any]:
    log = xbus.read_log(data, threads=1)
    return {name: log[name].values for name, *_ in PACKETS}


def main() -> None:
    small, large = ahrs_stream(4), ahrs_stream(128)

    answers = by_xbus(small), by_numpy(small), by_struct(small)
    for name, *_ in PACKETS:
        ours, theirs, plain = (np.asarray(answer[name]) for answer in answers)
        assert np.array_equal(ours, theirs), name
        assert np.array_equal(ours, plain.reshape(ours.shape).astype(ours.dtype)), name

    target = np.empty(len(large), np.uint8)
    source = np.frombuffer(large, np.uint8)
    copy, xbus_, numpy_ = medians(
        7, lambda: np.copyto(target, source), lambda: by_xbus(large), lambda: by_numpy(large)
    )
    (struct_,) = medians(1, lambda: by_struct(small))
    struct_ *= len(large) / len(small)

    print(
        f"{len(large) >> 20} MiB of 88-byte messages, equal answers; memcpy of the same bytes = 1"
    )
    for name, seconds in (
        ("xbus", xbus_),
        ("numpy, one fixed layout", numpy_),
        ("struct loop", struct_),
    ):
        print(
            f"  {name:<24}{copy / seconds:8.4f} x memcpy   xbus is {seconds / xbus_:6.1f} times as fast"
        )


if __name__ == "__main__":
    main()
