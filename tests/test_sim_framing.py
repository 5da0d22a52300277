"""Requests in the bytes of a host, compared with a plain walk from byte to byte."""

from __future__ import annotations

import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from xbus import encode_frame
from xbus.sim.framing import Framer, Request

LONGEST = 2048


def walk(data: bytes, *, is_last: bool) -> tuple[list[Request], bytes]:
    """Returns the requests in the bytes, and the bytes to keep for the next piece: candidate by candidate."""
    found: list[Request] = []
    start = 0
    while (start := data.find(0xFA, start)) >= 0:
        rest = data[start:]
        end: int | None = None
        header, long = 4, False
        if len(rest) >= 4:
            length = rest[3]
            if length == 0xFF:
                header = 6
                length = int.from_bytes(rest[4:6], "big")
                long = len(rest) >= 6 and length > LONGEST
            if len(rest) >= header:
                end = header + length + 1
        if not long and (end is None or end > len(rest)):
            if not is_last:
                return found, rest
            start += 1
        elif not long and end is not None and sum(rest[1:end]) % 256 == 0:
            found.append(Request(rest[1], rest[2], rest[header : end - 1]))
            start += end
        else:
            start += 1
    return found, b""


frames = st.builds(
    encode_frame, st.integers(0, 255), st.binary(max_size=8) | st.binary(min_size=253, max_size=300)
)
#: Bytes of headers, so that candidates overlap.
headers = st.lists(st.sampled_from([0xFA, 0xFF, 0, 1, 2, 5, 8]), max_size=30).map(bytes)
streams = st.lists(
    frames
    | headers
    | st.binary(max_size=20)
    | frames.map(lambda frame: frame[:-2])
    | st.just(bytes.fromhex("FA FF 10 FF 08 01"))
).map(b"".join)


@given(streams, st.data())
def test_pieces_give_what_a_plain_walk_gives(stream: bytes, data: st.DataObject) -> None:
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=9)))
    framer = Framer()
    found: list[Request] = []
    for start, end in zip([0, *cuts], [*cuts, len(stream)], strict=True):
        found += framer.feed(stream[start:end])
    complete, kept = walk(stream, is_last=False)
    assert found == complete
    assert framer.is_waiting == bool(kept)
    assert framer.flush() == walk(kept, is_last=True)[0]
    assert not framer.is_waiting


def test_a_request_byte_by_byte() -> None:
    framer = Framer()
    frame = encode_frame(0xC0, b"\xff" * 300, bid=1)
    found = [request for byte in frame for request in framer.feed(bytes([byte]))]
    assert found == [Request(1, 0xC0, b"\xff" * 300)]
    assert not framer.is_waiting


@pytest.mark.parametrize(
    "hostile",
    [b"\xfa", b"\xfa\xff", b"\xfa\xff\x10\xf9", b"\xfa\xff\x10\xff\x08\x00", bytes(range(256))],
    ids=["preambles", "too long", "long", "longest", "all bytes"],
)
def test_hostile_bytes_cost_no_more_than_others(hostile: bytes) -> None:
    size, piece = 1 << 23, 1 << 16
    data = hostile * (piece // len(hostile))
    framer = Framer()
    start = time.perf_counter()
    for _ in range(size // piece):
        framer.feed(data)
    # An idle machine of 2026 reaches 40 MB/s and more, and 0.5 MB/s in Python, byte by byte.
    assert size / (time.perf_counter() - start) > 4e6
