"""RTCM 3 frames in a stream of bytes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import chain

from xbus.extras import require

__all__ = ["rtcm_frames"]

#: Maximum size of a frame in bytes: preamble and length, 10 bits of length, CRC-24Q.
MAX_FRAME = 3 + 1023 + 3


def rtcm_frames(chunks: Iterable[bytes]) -> Iterator[bytes]:
    """Yields the RTCM 3 frames in bytes. Other bytes, and damaged frames, are skipped.

    Args:
        chunks: The bytes, in pieces of any size. A piece is requested when a frame needs it.

    Raises:
        ImportError: The extra ``rtk`` is not installed.

    >>> frame = bytes.fromhex("D300133ED7D30202980EDEEF34B4BD62AC0941986F33360B98")
    >>> list(rtcm_frames([b"noise" + frame[:7], frame[7:] + b"$GPGGA,..."])) == [frame]
    True
    """
    pyrtcm = require("pyrtcm", "rtk", "to find RTCM 3 frames")
    # A false preamble near the end may claim a length beyond it. The padding completes that candidate, so
    # that its checksum fails and true frames inside it are found.
    stream = _Stream(chain(chunks, [bytes(MAX_FRAME)]))
    reader = pyrtcm.RTCMReader(stream, quitonerror=pyrtcm.ERR_IGNORE, parsed=pyrtcm.PARSE_NONE)
    while (frame := reader.read()[0]) is not None:
        if pyrtcm.calc_crc24q(frame) == 0:
            yield frame
        else:
            # True frames may be inside.
            stream.put_back(frame[1:])


class _Stream:
    """Pieces of bytes, read like a file."""

    def __init__(self, chunks: Iterable[bytes]) -> None:
        self._chunks = iter(chunks)
        self._bytes = bytearray()

    def read(self, size: int) -> bytes:
        while len(self._bytes) < size and (chunk := next(self._chunks, None)) is not None:
            self._bytes += chunk
        data = bytes(self._bytes[:size])
        del self._bytes[:size]
        return data

    def put_back(self, data: bytes) -> None:
        self._bytes[:0] = data
