"""Corrections for the GNSS receiver of a device, and what they have made of its position.

Corrections are RTCM 3 frames, which a base station makes and a caster hands on (`xbus.rtk.caster`). pyrtcm
finds them; nothing else reaches the receiver, which would take other bytes for settings.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from itertools import chain
from typing import Any, NamedTuple, Protocol

from xbus.errors import XbusTimeout
from xbus.extras import require
from xbus.protocol.keys import Key
from xbus.protocol.tables import QUANTITIES, STATUS_FLAGS

__all__ = ["Fix", "Forwarder", "Position", "rtcm_frames"]

#: How many messages in a row may stay without an answer. Corrections come again every second or so, and a
#: lost answer is no lost correction.
UNANSWERED = 5
#: Fix types of the receiver (Table 25).
FIX_TYPES = ("none", "dead reckoning", "2D", "3D", "GNSS and dead reckoning", "time only")
RTK = ("none", "float", "fixed")
#: The longest RTCM 3 frame: preamble and length, 10 bits of length, CRC-24Q.
LONGEST = 3 + 1023 + 3
_FLAGS = {it.name: it for it in STATUS_FLAGS}


def rtcm_frames(chunks: Iterable[bytes]) -> Iterator[bytes]:
    """The RTCM 3 frames in bytes that come in pieces; what is none, or damaged, is left out.

    Args:
        chunks: The bytes, in pieces of any size. The next piece is asked for when a frame needs it.

    Raises:
        ImportError: The extra ``rtk`` is not installed.

    >>> frame = bytes.fromhex("D300133ED7D30202980EDEEF34B4BD62AC0941986F33360B98")
    >>> list(rtcm_frames([b"noise" + frame[:7], frame[7:] + b"$GPGGA,..."])) == [frame]
    True
    """
    pyrtcm = require("pyrtcm", "rtk", "to find RTCM 3 frames")
    # A false start may claim more than there is; behind the last byte it gets enough to prove itself wrong.
    stream = _Stream(chain(chunks, [bytes(LONGEST)]))
    reader = pyrtcm.RTCMReader(stream, quitonerror=pyrtcm.ERR_IGNORE, parsed=pyrtcm.PARSE_NONE)
    while (frame := reader.read()[0]) is not None:
        if pyrtcm.calc_crc24q(frame) == 0:
            yield frame
        else:
            # A false start: true frames may be inside.
            stream.put_back(frame[1:])


class _Stream:
    """Pieces, read like a file."""

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


class GnssDevice(Protocol):
    """A device with a GNSS receiver that takes corrections: `xbus.Device` is one."""

    def command(self, name: str, value: bytes) -> object:
        """Sends a command by the manual's name and waits for the acknowledgement."""
        ...


class Forwarder:
    """Hands corrections to the GNSS receiver of a device, and counts them.

    Args:
        device: A device in Measurement State.

    Attributes:
        messages: RTCM 3 frames that were handed over.
        bytes: Their bytes.
        unanswered: How many of them the device did not acknowledge.
    """

    def __init__(self, device: GnssDevice) -> None:
        self.messages = 0
        self.bytes = 0
        self.unanswered = 0
        self._device = device
        self._silent = 0

    def forward(self, chunks: Iterable[bytes]) -> None:
        """Sends each RTCM 3 frame as a ForwardGnssData message (0xE2), until there are no more chunks.

        Args:
            chunks: Bytes, in pieces of any size, such as a generator that waits for them. What is no RTCM 3
                frame is not sent.

        Raises:
            StateError: The device is in Config State, or its product has no such message.
            DeviceError: The device refused one.
            XbusTimeout: Five in a row were not answered.
            Disconnected: The port is gone.
            ImportError: The extra ``rtk`` is not installed.
        """
        for frame in rtcm_frames(chunks):
            self.messages += 1
            self.bytes += len(frame)
            try:
                self._device.command("ForwardGnssData", frame)
                self._silent = 0
            except XbusTimeout:
                self.unanswered += 1
                self._silent += 1
                if self._silent >= UNANSWERED:
                    raise

    def __repr__(self) -> str:
        return f"<Forwarder {self.messages} messages, {self.bytes} bytes, {self.unanswered} unanswered>"


class Position(NamedTuple):
    """Where a device is.

    Attributes:
        lat: Latitude, degrees.
        lon: Longitude, degrees.
        alt: Height above mean sea level, m; above the ellipsoid where ``sep`` is 0.
        sep: Height of mean sea level above the ellipsoid, m; 0 where the device does not tell it.
        satellites: How many are used; None where the device does not tell.
        hdop: Horizontal dilution of precision; None where the device does not tell.
    """

    lat: float
    lon: float
    alt: float
    sep: float = 0.0
    satellites: int | None = None
    hdop: float | None = None


class Fix:
    """What the samples of a device say about its position; the latest one counts.

    It is taken from ``gnss_pvt_data`` and ``status_word``, and without the former from ``lat_lon`` and
    ``altitude_ellipsoid``.

    Attributes:
        type: ``"none"``, ``"2D"``, ``"3D"``, ... (Table 25), ``"yes"`` where only the status word tells, or
            None before anything told.
        rtk: ``"none"``, ``"float"`` or ``"fixed"`` (bits 27 and 28 of the status word, or else the flags of
            the receiver), or None.
        position: The last one known, or None.

    >>> import xbus
    >>> fix = Fix()
    >>> with xbus.connect("sim:MTi-680G") as device:
    ...     while fix.position is None:
    ...         fix.update(device.read_sample())
    >>> fix.type, fix.rtk, round(fix.position.lat, 2)
    ('yes', 'none', 52.24)
    """

    def __init__(self) -> None:
        self.type: str | None = None
        self.rtk: str | None = None
        self.position: Position | None = None
        self._has_pvt = self._has_status = False

    def update(self, sample: Mapping[Key, Any]) -> None:
        """Takes in a sample, or anything with the same keys and values."""
        if (word := sample.get("status_word")) is not None:
            self._has_status = True
            self.rtk = _rtk(_flag(word, "rtk_status"))
            if not self._has_pvt:
                self.type = "yes" if _flag(word, "gnss_fix") else "none"
        if (pvt := sample.get("gnss_pvt_data")) is not None:
            self._take_pvt(pvt)
        elif not self._has_pvt and "lat_lon" in sample and self.type != "none":
            lat, lon = map(float, sample["lat_lon"])
            alt = float(sample.get("altitude_ellipsoid", 0.0))
            if math.isfinite(lat + lon + alt):
                self.position = Position(lat, lon, alt)

    def _take_pvt(self, pvt: dict[str, int]) -> None:
        self._has_pvt = True
        kind = pvt["fixtype"]
        self.type = FIX_TYPES[kind] if kind < len(FIX_TYPES) else str(kind)
        if not self._has_status:
            # As u-blox has them, whose message this is; the manual does not explain these two bits.
            self.rtk = _rtk(pvt["flags"] >> 6 & 3)
        if self.type in ("2D", "3D", "GNSS and dead reckoning"):
            it = {field.name: pvt[field.name] * field.scale for field in _PVT}
            self.position = Position(
                it["lat"],
                it["lon"],
                it["hMSL"],
                it["height"] - it["hMSL"],
                pvt["numSV"],
                it["hdop"],
            )

    def __repr__(self) -> str:
        where = f", {self.position.lat:.5f}, {self.position.lon:.5f}" if self.position else ""
        return f"<Fix {self.type}, RTK {self.rtk}{where}>"


_PVT = QUANTITIES["gnss_pvt_data"].fields


def _flag(word: Any, name: str) -> int:
    flag = _FLAGS[name]
    return int(word) >> flag.bit & ((1 << flag.width) - 1)


def _rtk(value: int) -> str:
    return RTK[value] if value < len(RTK) else str(value)
