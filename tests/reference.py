"""A slow, plain decoder of Xbus logs: the reference that the fast implementation is tested against.

Everything here is written to be obviously correct: bytes are sliced, sums are summed again for
every candidate, numbers are Python's own. It shares no code and no table with the package. The
tables below are a second copy of what the package declares once, and they exist on purpose and in
the tests only: a check that read the package's tables would repeat its mistakes.

"The manual" is Xsens' MT0101P, revision 2020.A. Frames are in its section 5.1 and Table 3, the data
identifiers in Tables 16 and 17, what an MTData2 message holds in section 5.3.6.

    scan(data)      bytes -> frames, damage, how often a checksum failed where a frame was due
    find(data)      the same, and the strings
    decode(data)    bytes -> Reference: samples, columns, messages, time, counter, statistics
    array(ref, key) one column as the expected numpy array
"""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from reference_mtdata import GPS_PVT, MTDATA, Outputs

# ---------------------------------------------------------------------------------------------
# Tables
# ---------------------------------------------------------------------------------------------

PREAMBLE = 0xFA
LONGEST = 65535

MTDATA2 = 0x36
DEVICE_ID, INIT_BUS_RESULTS, CONFIGURATION, PRODUCT_CODE = 0x01, 0x03, 0x0D, 0x1D
GOTO_MEASUREMENT_ACK, RESET_ACK, WAKE_UP = 0x11, 0x41, 0x3E
RESTARTS = (GOTO_MEASUREMENT_ACK, RESET_ACK, WAKE_UP)

# What a device sends (section 5.3 and chapter 8): message identifier -> payload lengths. No lengths
# means that none are known: such a message is never plausible by itself. MTData2 is judged by its
# packets.
LENGTHS: dict[int, Collection[int]] = {
    0x01: (4, 8),  # DeviceID
    0x03: range(4, 33, 4),  # InitBusResults
    0x05: (0, 2),  # PeriodAck
    0x07: (),  # SetBidAck
    0x0B: (),  # DataLength
    0x0D: (118,),  # Configuration
    0x0F: (0,),  # RestoreFactoryDefAck
    0x11: (0,),  # GotoMeasurementAck
    0x13: (3, 11),  # FirmwareRev
    0x15: (),  # ReqUniqueIdAck
    0x19: (0, 1),  # BaudrateAck
    0x1B: (),  # ReqProductVariantAck
    0x1D: range(4, 21),  # ProductCode
    0x1F: (2,),  # HardwareVersion
    0x21: (),  # ProcessingFlagsAck
    0x23: (0,),  # SetNoRotationAck
    0x25: (2,),  # SelftestResults
    0x2D: range(0, 121, 12),  # SyncSettingsAck
    0x31: (0,),  # GotoConfigAck
    0x32: range(1, 2049),  # MTData
    0x3E: (0,),  # WakeUp
    0x41: (0,),  # ResetAck
    0x42: range(1, 9),  # Error
    0x43: range(4, 133),  # Warning
    0x46: (),  # MasterIndication
    0x49: (0, 4),  # OptionFlagsAck
    0x61: (0, 12),  # UTCTime
    0x63: range(22, 221, 22),  # AvailableFilterProfiles
    0x65: range(63),  # FilterProfileAck
    0x67: (),  # GravityMagnitudeAck
    0x69: (0, 12),  # GnssLeverArmAck
    0x6B: (),  # MagneticFieldAck
    0x6D: (),  # ReplayModeAck
    0x6F: (0, 12, 24),  # LatLonAltAck
    0x75: (1, 2, 7),  # IccCommandAck
    0x77: (0, 2),  # GnssPlatformAck
    0x7F: (),  # ReqErrorReportAck
    0x83: (),  # HeadingAck
    0x85: (0, 2),  # LocationIDAck
    0x87: (0, 2),  # ExtOutputMode
    0x8B: (),  # StoreFilterStateAck
    0x8D: range(0, 13, 4),  # PortConfig
    0x8F: (0, 2, 6),  # StringOutputTypeAck
    0x91: range(255, 8186),  # EmtsData
    0x93: (),  # UpdateFilterProfileAck
    0x95: (),  # RestoreEmtsAck
    0x97: (),  # StoreEmtsAck
    0x99: (),  # UnlockMaintenanceModeAck
    0x9B: (),  # ClockSyncCommandAck
    0xA1: (),  # FilterSettingsAck
    0xA3: (),  # AmdAck
    0xA5: (0,),  # ResetOrientationAck
    0xA7: (),  # GnssStatus
    0xA9: (0,),  # AdjustUTCTimeAck
    0xAD: (0, 10),  # GnssReceiverSettings
    0xBD: (),  # UpdateBiasAck
    0xC1: range(0, 129, 4),  # OutputConfigurationAck
    0xD1: (),  # OutputModeAck
    0xD3: (),  # OutputSettingsAck
    0xD5: (0, 2),  # OutputSkipFactorAck
    0xD7: (0,),  # SetInitialHeadingAck
    0xD9: (),  # SetSyncOutSettingsAck
    0xDB: (0, 2),  # ErrorModeAck
    0xDD: (0, 2),  # TransmitDelayAck
    0xDF: (),  # SetMfmResultsAck
    0xE1: (),  # ObjectAlignmentAck
    0xE3: (0,),  # ForwardGnssDataAck
    0xE7: (0, 4),  # CanConfig
    0xE9: range(0, 129, 8),  # CanOutputConfig
    0xED: (0, 16, 17),  # AlignmentRotationAck
    0xEE: (),  # ExtendedMessageID
    0xFF: (),  # SetDeviceIdContextAck
}

# Quantities made of real numbers, in the format that the identifier's two low bits name:
# identifier -> name, how many numbers.
REALS: dict[int, tuple[str, int]] = {
    0x0810: ("temperature", 1),
    0x2010: ("quaternion", 4),
    0x2020: ("rotation_matrix", 9),
    0x2030: ("euler_angles", 3),
    0x4010: ("delta_v", 3),
    0x4020: ("acceleration", 3),
    0x4030: ("free_acceleration", 3),
    0x4040: ("acceleration_hr", 3),
    0x5010: ("altitude_msl", 1),
    0x5020: ("altitude_ellipsoid", 1),
    0x5030: ("position_ecef", 3),
    0x5040: ("lat_lon", 2),
    0x8020: ("rate_of_turn", 3),
    0x8030: ("delta_q", 4),
    0x8040: ("rate_of_turn_hr", 3),
    0xA060: ("raw_delta_q", 4),
    0xA070: ("raw_delta_v", 3),
    0xC020: ("magnetic_field", 3),
    0xC030: ("magnetic_field_corrected", 3),
    0xD010: ("velocity_xyz", 3),
}

# Those of them that a coordinate system applies to (note 11 under Table 17).
ROTATES = (0x2010, 0x2020, 0x2030, 0xD010)
COORDINATES = {0x0: "ENU", 0x4: "NED", 0x8: "NWU"}

# Bytes of one number by precision: Float32, Fp1220, Fp1632, Float64.
WIDTHS = (4, 4, 6, 8)

# Quantities that hold numbers of one fixed type whatever the format bits: identifier -> name and
# layout as `struct` spells it. One letter is a scalar, several are a vector.
NUMBERS: dict[int, tuple[str, str]] = {
    0x1020: ("packet_counter", "H"),
    0x1030: ("itow", "I"),
    0x1040: ("gnss_age", "B"),
    0x1050: ("pressure_age", "B"),
    0x1060: ("sample_time_fine", "I"),
    0x1070: ("sample_time_coarse", "I"),
    0x1080: ("frame_range", "HH"),
    0x1090: ("packet_counter8", "B"),
    0x10A0: ("sample_time64", "Q"),
    0x10B0: ("packet_counter32", "I"),
    0x3010: ("baro_pressure", "I"),
    0x7030: ("gnss_pvt_pulse", "I"),
    0xA020: ("raw_gyro_temp", "hhh"),
    0xA030: ("raw_acc", "HHH"),
    0xA040: ("raw_gyr", "HHH"),
    0xA050: ("raw_mag", "HHH"),
    0xA090: ("raw_float_acc_gyr_mag_temp", "ffffffffff"),
    0xB010: ("analog_in1", "H"),
    0xB020: ("analog_in2", "H"),
    0xE010: ("status_byte", "B"),
    0xE020: ("status_word", "I"),
    0xE040: ("rssi", "b"),
    0xE090: ("location_id", "H"),
}

# Quantities with named fields: identifier -> name, layout, fields. GnssPvtData is Table 25,
# UtcTime is laid out as the UTCTime message, Table 35.
STRUCTS: dict[int, tuple[str, str, str]] = {
    0x1010: ("utc_time", "IHBBBBBB", "ns year month day hour minute second valid"),
    0x4810: ("trigger_in1", "BBIH", "line polarity timestamp frame"),
    0x4820: ("trigger_in2", "BBIH", "line polarity timestamp frame"),
    0x4830: ("trigger_in3", "BBIH", "line polarity timestamp frame"),
    0x7010: (
        "gnss_pvt_data",
        "IHBBBBBBIiBBBBiiiiIIiiiiiIIiHHHHHHH",
        "itow year month day hour min sec valid tAcc nano fixtype flags numSV Reserved1 lon lat "
        "height hMSL hAcc vAcc velN velE velD gSpeed headMot sAcc headAcc headVeh gdop pdop tdop "
        "vdop hdop ndop edop",
    ),
    0x8830: ("gps_dop", "IHHHHHHH", "itow gdop pdop tdop vdop hdop ndop edop"),
    0x8880: (
        "gps_time_utc",
        "IIiHBBBBBB",
        "itow tAcc nano year month day hour min sec valid",
    ),
    0xA010: (
        "raw_acc_gyr_mag_temp",
        "HHHHHHHHHh",
        "accX accY accZ gyrX gyrY gyrZ magX magY magZ temp",
    ),
    0xC810: (
        "awinda_snapshot",
        "IIiiiiiihhhIHBB",
        "deviceId frame iqX iqY iqZ ivX ivY ivZ magX magY magZ baro status accClipped gyrClipped",
    ),
}

# Two whose size varies: DeviceId is U4 or U8, GnssSatInfo (Table 26) is a head and its satellites.
DEVICE_ID_PACKET = 0xE080
GNSS_SAT_INFO = 0x7020
SAT_INFO_FIELDS = "itow numSvs res1 res2 res3"
SATELLITE_FIELDS = "gnssId svId cno flags"

TRIGGERS = ("trigger_in1", "trigger_in2", "trigger_in3")
GNSS = ("gnss_pvt_data", "gnss_sat_info")

# ---------------------------------------------------------------------------------------------
# Packets
# ---------------------------------------------------------------------------------------------

Key: TypeAlias = tuple[str, str | None]  # name, coordinate system
Packet: TypeAlias = tuple[int, bytes]  # identifier as received, data


class Float32(float):
    """A Float32 number that remembers its bits, since arithmetic does not keep those of a NaN."""

    __slots__ = ("bits",)
    bits: int

    def __new__(cls, raw: bytes) -> Float32:
        """The number in these four bytes."""
        self = super().__new__(cls, struct.unpack(">f", raw)[0])
        self.bits = int.from_bytes(raw, "big")
        return self


class Wide(int):
    """An integer of eight bytes where four are usual."""


def number(raw: bytes, precision: int) -> float:
    """One real number (Table 17 and "Definition output formats" below it), exactly."""
    match precision:
        case 0:
            return Float32(raw)
        case 1:  # Fp1220
            return int.from_bytes(raw, "big", signed=True) / 2**20
        case 2:  # Fp1632: the 32 bits of the fraction travel before the 16 of the integer
            return int.from_bytes(raw[4:6] + raw[0:4], "big", signed=True) / 2**32
        case 3:  # Float64
            return float(struct.unpack(">d", raw)[0])
    raise ValueError(precision)


def known(data_id: int) -> bool:
    """Whether the identifier, its format bits aside, is one whose contents are known."""
    base = data_id & 0xFFF0
    tables = (REALS, NUMBERS, STRUCTS)
    return base in (DEVICE_ID_PACKET, GNSS_SAT_INFO) or any(base in table for table in tables)


def read(data_id: int, data: bytes) -> tuple[Key, Any] | None:
    """Returns the column's key and the values of a packet; None if the data does not fit.

    A scalar is a number, a vector a tuple of numbers (a rotation matrix of nine, column by column
    as it travels), a struct a dict in the order of the wire.
    """
    base = data_id & 0xFFF0

    if base in REALS:
        name, count = REALS[base]
        precision = data_id & 0x3
        width = WIDTHS[precision]
        if len(data) != count * width:
            return None
        coordinates = None
        if base in ROTATES:
            if data_id & 0xC not in COORDINATES:
                return None
            coordinates = COORDINATES[data_id & 0xC]
        reals = tuple(number(data[i * width : (i + 1) * width], precision) for i in range(count))
        return (name, coordinates), reals[0] if count == 1 else reals

    if base in NUMBERS:
        name, layout = NUMBERS[base]
        if len(data) != struct.calcsize(">" + layout):
            return None
        if layout == "f" * len(layout):
            return (name, None), tuple(
                Float32(data[i : i + 4]) for i in range(0, 4 * len(layout), 4)
            )
        numbers = struct.unpack(">" + layout, data)
        return (name, None), numbers[0] if len(layout) == 1 else numbers

    if base in STRUCTS:
        name, layout, fields = STRUCTS[base]
        if len(data) != struct.calcsize(">" + layout):
            return None
        return (name, None), dict(
            zip(fields.split(), struct.unpack(">" + layout, data), strict=True)
        )

    if base == DEVICE_ID_PACKET:
        if len(data) not in (4, 8):
            return None
        return ("device_id", None), (Wide if len(data) == 8 else int).from_bytes(data, "big")

    if base == GNSS_SAT_INFO:
        if len(data) < 8 or len(data) != 8 + 4 * data[4]:
            return None
        head = struct.unpack(">IBBBB", data[:8])
        info: dict[str, Any] = dict(zip(SAT_INFO_FIELDS.split(), head, strict=True))
        info["satellites"] = [tuple(data[i : i + 4]) for i in range(8, len(data), 4)]
        return ("gnss_sat_info", None), info

    return None


def packets(payload: bytes) -> list[Packet] | None:
    """The packets that tile an MTData2 payload (Figure 4); None where they do not, or are none."""
    found = []
    at = 0
    while at < len(payload):
        if at + 3 > len(payload):
            return None
        data_id = int.from_bytes(payload[at : at + 2], "big")
        size = payload[at + 2]
        if at + 3 + size > len(payload):
            return None
        found.append((data_id, payload[at + 3 : at + 3 + size]))
        at += 3 + size
    return found or None


# ---------------------------------------------------------------------------------------------
# Frames
# ---------------------------------------------------------------------------------------------


class Frame(NamedTuple):
    """One frame: where its preamble is, and the message in it."""

    offset: int
    bid: int
    mid: int
    payload: bytes


class Damage(NamedTuple):
    """A stretch of bytes that is not a frame; the reason depends on the byte where a frame was due."""

    offset: int
    length: int
    reason: str


def candidate(data: bytes, at: int, limit: int) -> tuple[str, Frame | None, int]:
    """Returns ("", frame, its end) for the frame at `at`, or why no intact frame begins there.

    Intact means complete, not longer than the limit and with a good checksum (section 5.1).
    """
    if data[at] != PREAMBLE:
        return "no preamble", None, at
    header = 4
    if at + header > len(data):
        return "truncated", None, at
    length = data[at + 3]
    if length == 0xFF:
        header = 6
        if at + header > len(data):
            return "truncated", None, at
        length = int.from_bytes(data[at + 4 : at + 6], "big")
    if length > limit:
        return "too long", None, at
    end = at + header + length + 1
    if end > len(data):
        return "truncated", None, at
    if sum(data[at + 1 : end]) % 256 != 0:
        return "checksum", None, at
    return "", Frame(at, data[at + 1], data[at + 2], data[at + header : end - 1]), end


def plausible(frame: Frame) -> bool:
    """Whether a frame with a good checksum looks like one that a device would send."""
    if frame.bid != 0xFF and not 1 <= frame.bid <= 31:
        return False
    if frame.mid != MTDATA2:
        return len(frame.payload) in LENGTHS.get(frame.mid, ())
    tiles = packets(frame.payload)
    if tiles is None:
        return False
    return all(not known(data_id) or read(data_id, data) is not None for data_id, data in tiles)


class String(NamedTuple):
    """A string output: where it begins, its name or None, and its bytes."""

    offset: int
    name: str | None
    data: bytes


# Section 5.3.5, SetStringOutputType. A sentence is text between $ and *hh; two kinds of string have no
# checksum, but an end of line; EM1000 has neither.
SENTENCE = re.compile(rb"\$([A-Z][ -#%-~]*?)\*([0-9A-Fa-f]{2})\r?\n")
NUMBER = rb" *(?:[+-]?(?:\d+\.?\d*|\.\d+))? *"
PRDID = re.compile(rb"\$PRDID," + rb",".join([NUMBER] * 3) + rb"\r?\n")
TSS2 = re.compile(rb":(?=[ \d])[\d ]{5} [- ][\d ]{4}H[- ][\d ]{4} [- ][\d ]{4}F\r?\n")
TSS2_MASK = ["[0-9 ]"] * 5 + [" ", "[- ]"] + ["[0-9 ]"] * 4 + ["H", "[- ]"] + ["[0-9 ]"] * 4
TSS2_MASK += [" ", "[- ]"] + ["[0-9 ]"] * 4 + ["F"]
NAMES = ["HCHDM", "HCHDG", "TSS2", "PHTRO", "PRDID", "EM1000", "PSONCMS", "HCMTW"]
NAMES += ["HEHDT", "HEROT", "GPGGA", "PTCF", "XSVEL", "GPZDA", "GPRMC"]
EM1000_BIT = 1 << 5
STRING_OUTPUT_TYPE = 0x8F
LONGEST_STRING = 255


def string_at(data: bytes, at: int, expected: int, in_step: bool) -> tuple[str, String | None, int]:
    """Returns ("", string, its end) for the string at `at`, or why no string begins there."""
    if data[at] == 0x00 and expected & EM1000_BIT:
        return em1000_at(data, at, in_step)
    near = data[at : at + LONGEST_STRING]
    if near[:1] not in (b"$", b":"):
        return "no preamble", None, at
    found: tuple[re.Match[bytes] | None, str | None]
    if sentence := SENTENCE.match(near):
        name = next((name for name in NAMES if sentence[1].startswith(name.encode() + b",")), None)
        total = 0
        for byte in sentence[1]:
            total ^= byte
        if total != int(sentence[2], 16):
            return "checksum", None, at
        found = sentence, name
    elif prdid := PRDID.match(near):
        found = prdid, "PRDID"
    else:
        found = TSS2.match(near), "TSS2"
    match, name = found
    if match is not None:
        return "", String(at, name, match[0]), at + match.end()
    return why_no_string(data, at, near), None, at


def why_no_string(data: bytes, at: int, near: bytes) -> str:
    """Returns the reason: cut off by the end of the input, too long, or not a string."""
    if not re.match(rb"\$[A-Z]|:[ \d]|[$:]\Z", near):
        return "no preamble"
    if near[:1] == b":":
        text = near[1:].decode("latin-1")
        for i, mask in enumerate(TSS2_MASK):
            if i == len(text):
                return "truncated"
            if not re.match(mask, text[i]):
                return "no preamble"
        rest = near[1 + len(TSS2_MASK) :]
    else:
        rest = near[1 + len(re.match(rb"[ -#%-~]*", near[1:])[0]) :]  # type: ignore[index]
        if rest in (b"", b"\r") and len(near) == LONGEST_STRING:
            return "too long"
    return "truncated" if rest in (b"", b"\r") and at + len(near) == len(data) else "no preamble"


def em1000_at(data: bytes, at: int, in_step: bool) -> tuple[str, String | None, int]:
    """Ten bytes: 00 90, roll, pitch, heave and heading in little-endian words, 0.01 degrees."""
    if len(data) == at + 1:
        return "truncated", None, at
    if data[at + 1] != 0x90:
        return "no preamble", None, at
    end = at + 10
    if end > len(data):
        return "truncated", None, at
    roll, pitch, _, heading = struct.unpack("<hhhH", data[at + 2 : end])
    if abs(roll) > 18_000 or abs(pitch) > 9_000 or heading > 36_000:
        return "implausible", None, at
    if not in_step and data[end : end + 1] not in (b"", b"\xfa", b"$", b":", b"\0"):
        return "implausible", None, at
    return "", String(at, "EM1000", data[at:end]), end


def strings_enabled_by(frame: Frame) -> int | None:
    """Returns the enabled strings if a message reports them."""
    if frame.mid != STRING_OUTPUT_TYPE or len(frame.payload) not in (2, 6):
        return None
    return int.from_bytes(frame.payload if len(frame.payload) == 2 else frame.payload[:4], "big")


def scan(data: bytes, limit: int = LONGEST) -> tuple[list[Frame], list[Damage], int]:
    """The frames in `data`, the damage between them, and how many stretches a checksum began."""
    frames, _, damage, checksum_errors = find(data, limit)
    return frames, damage, checksum_errors


def find(
    data: bytes, limit: int = LONGEST, named: int = 0
) -> tuple[list[Frame], list[String], list[Damage], int]:
    """The frames and strings in `data`, the damage between them, and how many stretches a checksum began.

    An intact frame is accepted when it is plausible or in step on both sides: it begins where an
    accepted frame or string ended or the input begins, and it ends where another intact frame or string
    begins or the input ends. After a rejected candidate the search continues one byte further.
    """
    data = bytes(data)
    frames: list[Frame] = []
    strings: list[String] = []
    damage: list[Damage] = []
    enabled = 0  # the strings that the device reports as enabled
    due = 0  # where the last accepted frame or string ended: where the next one should begin
    why = ""  # what was wrong there
    at = 0
    while at < len(data):
        reason, frame, end = candidate(data, at, limit)
        string = None
        if data[at] != PREAMBLE:
            reason, string, end = string_at(data, at, named | enabled, at == due)
        if frame is not None and not plausible(frame):
            in_step = at == due and (
                end == len(data)
                or candidate(data, end, limit)[1] is not None
                or string_at(data, end, named | enabled, in_step=True)[1] is not None
            )
            if not in_step:
                reason, frame = "implausible", None
        if at == due:
            why = reason
        if frame is None and string is None:
            at += 1
            continue
        if at > due:
            damage.append(Damage(due, at - due, why))
        if frame is not None:
            frames.append(frame)
            now = strings_enabled_by(frame)
            enabled = enabled if now is None else now
        if string is not None:
            strings.append(string)
        at = due = end
    if at > due:
        damage.append(Damage(due, at - due, why))
    return frames, strings, damage, sum(stretch.reason == "checksum" for stretch in damage)


# ---------------------------------------------------------------------------------------------
# Clock and counter
# ---------------------------------------------------------------------------------------------

TICKS = 10_000  # of SampleTimeFine, in a second
DAY = 86_400 * TICKS  # where it wraps on the 10- and 100-series
ALL_BITS = 2**32  # and on the others


def modulus_of_id(device_id: int) -> int | None:
    """Where SampleTimeFine wraps on the device with this 32-bit identifier.

    Bit 31 marks the serial numbers of the 600-series, which carry no family.
    """
    if device_id & 0x8000_0000:
        return ALL_BITS
    match device_id & 0x00F0_0000:
        case 0x0060_0000 | 0x0070_0000:  # 10-series; 100-series and MTi-G
            return DAY
        case 0x0080_0000 | 0x00D0_0000:  # 1-series; 320 and 330
            return ALL_BITS
    return None


def modulus_of_ids(first: int, second: int) -> int | None:
    """The same for 64-bit identifiers, by their halves as sent.

    Bit 31 of a half marks them. Some devices of the 10- and 100-series answer with eight bytes and
    mean the first four.
    """
    if (first | second) & 0x8000_0000:
        return ALL_BITS
    return modulus_of_id(first)


def modulus_of_product(code: bytes) -> int | None:
    """Where SampleTimeFine wraps on the product with this code ("MTi-630-8A1G6")."""
    name = code.split(b" ")[0].decode("ascii", "replace")
    if name.startswith("MTi-"):
        model = name.removeprefix("MTi-")
        if model.startswith(("G-700", "G-710")):
            return DAY
        digits = model[: len(model) - len(model.lstrip("0123456789"))]
        if not digits:
            return None
        series = int(digits)
        if 1 <= series <= 9 or series in (320, 330) or 600 <= series <= 699:
            return ALL_BITS
        if 10 <= series <= 399:
            return DAY
        return None
    if name.startswith(("A", "S")):  # Avior, Sirius
        return ALL_BITS
    return None


def modulus_of_message(frame: Frame) -> int | None:
    """Where SampleTimeFine wraps on the device that a message names; None where it names none."""
    payload = frame.payload
    if frame.mid == PRODUCT_CODE:
        return modulus_of_product(payload)
    if frame.mid in (DEVICE_ID, INIT_BUS_RESULTS) and len(payload) == 4:
        return modulus_of_id(int.from_bytes(payload, "big"))
    if frame.mid == DEVICE_ID and len(payload) == 8:
        return modulus_of_ids(*struct.unpack(">II", payload))
    if frame.mid == CONFIGURATION and len(payload) >= 118:
        # Table 13; a 64-bit identifier has its halves exchanged, if not, the first half is zero.
        first, second = struct.unpack(">II", payload[:8])
        if first & 0x8000_0000 or (first == 0 and second & 0x8000_0000):
            return ALL_BITS
        return modulus_of_id(first)
    return None


@dataclass
class Device:
    """The state to unwrap the clock and the counter of one device."""

    modulus: int | None = None
    fine: int | None = None  # the last SampleTimeFine
    ticks: int = 0  # the same, unwrapped
    low: int | None = None  # the last PacketCounter
    counter: int = -1  # the same, unwrapped
    has_begun: bool = False
    restarted: bool = False  # after the last sample
    recounts: bool = False  # restarted after the last counter
    anchor: tuple[int, int] | None = None  # ticks and counter of the last sample that has both
    pace: tuple[int, int] = (0, 0)  # ticks, and what the counter counted in them

    def after(self, fine: int) -> int:
        """The unwrapped ticks of a SampleTimeFine that comes next."""
        if self.fine is None:
            return fine
        modulus = self.modulus
        if modulus is None:
            if fine >= self.fine:
                return self.ticks + fine - self.fine
            modulus = DAY if self.fine < DAY else ALL_BITS
        forward = (fine - self.fine) % modulus
        backward = forward - modulus
        if 2 * forward > modulus and self.ticks + backward >= 0:
            return self.ticks + backward
        return self.ticks + forward

    def time(self, stamps: dict[str, Any]) -> float:
        """The time of a sample, by the packets in it; moves the clock unless GNSS data is there."""
        fine: int | None = stamps.get("sample_time_fine")
        coarse: int | None = stamps.get("sample_time_coarse")
        triggers: list[dict[str, int]] = [stamps[name] for name in TRIGGERS if name in stamps]

        if fine is not None:
            ticks = result = self.after(fine)
            if coarse is not None:
                # The manual's BigTimestamp, section 5.3.6. The clock is set by it where it is
                # SampleTimeFine and a whole number of wraps.
                # If it only repeats SampleTimeFine, both start again together, and the
                # unwrapped time continues.
                stamp = coarse * TICKS + fine % TICKS
                moduli = (DAY, ALL_BITS) if self.modulus is None else (self.modulus,)
                if stamp != fine:
                    result = stamp
                if stamp > fine and any((stamp - fine) % m == 0 for m in moduli):
                    ticks = stamp
            if not any(name in stamps for name in GNSS):
                self.fine, self.ticks = fine, ticks
            return result / TICKS

        if triggers:
            stamp = triggers[-1]["timestamp"]
            if self.fine is not None:
                now = self.ticks * 100  # in microseconds, as the stamp is
                wraps = (now - stamp + ALL_BITS // 2) // ALL_BITS  # to the nearest
                stamp += max(0, wraps) * ALL_BITS
            return stamp / 1_000_000

        if coarse is not None:
            return float(coarse)
        return math.nan

    def sample(self, stamps: dict[str, Any]) -> tuple[float, int, bool]:
        """Returns the time of a sample, the samples lost before it and whether it starts a new run."""
        low: int | None = stamps.get("packet_counter")
        was_stamped, before = self.fine is not None, self.ticks
        seconds = self.time(stamps)
        now: int | None = None
        if "sample_time_fine" in stamps and not any(name in stamps for name in GNSS):
            now = self.ticks
            follows = (
                self.low is not None and low is not None and 1 <= (low - self.low) % 65536 <= 256
            )
            if was_stamped and now < before - TICKS and not follows:
                self.restarted = self.recounts = True
        lost = 0 if low is None else self.count(low, now)
        restarted = self.restarted and self.has_begun
        self.has_begun, self.restarted = True, False
        return seconds, lost, restarted

    def count(self, low: int, now: int | None) -> int:
        """Takes the next PacketCounter; returns how many samples were lost before it."""
        is_first, step = self.low is None, 1
        if self.low is None:
            self.counter = low
        else:
            step = (low - self.low) % 65536
            if step >= 32768 and self.counter + step >= 65536:  # else it would fall below zero
                step -= 65536
            self.counter += step
        self.low = low
        if is_first or self.recounts:
            self.pace, self.anchor = (0, 0), None
        if now is not None:
            unseen = self.unseen(now)
            self.counter += unseen
            step += unseen
            self.anchor = now, self.counter
        elif is_first or self.recounts:
            self.anchor = None
        lost = max(0, step - 1) if not self.recounts and not is_first else 0
        self.recounts = False
        return lost

    def unseen(self, now: int) -> int:
        """Returns what the counter counted unseen since the last sample: 65,536 for each of its wraps.

        It follows from the time between the two samples, at the pace of the counter until then.
        """
        if self.anchor is None:
            return 0
        elapsed, step = now - self.anchor[0], self.counter - self.anchor[1]
        if not 0 < elapsed < DAY or abs(step) >= 2**20:
            return 0
        ticks, counts = self.pace
        if ticks and Fraction(elapsed * counts, ticks) > step + 32768:
            expected = elapsed * counts // ticks
            wraps = (expected - step + 32768) // 65536
            error = abs(expected - step - 65536 * wraps)
            return 65536 * wraps if error <= min(expected // 16, 16384) else 0
        if step > 0:
            self.pace = ticks + elapsed, counts + step
            if self.pace[1] > 4096:
                self.pace = self.pace[0] // 2, self.pace[1] // 2
        return 0


# ---------------------------------------------------------------------------------------------
# Logs
# ---------------------------------------------------------------------------------------------


class Row(NamedTuple):
    """One packet: the sample it belongs to, its identifier as received, its values."""

    sample: int
    data_id: int
    values: Any


class Message(NamedTuple):
    """A message that is not a sample; `sample` is the index of the next sample."""

    mid: int
    bid: int
    payload: bytes
    offset: int
    sample: int


@dataclass
class Reference:
    """The expected content of a log."""

    frames: list[Frame]
    strings: list[String]
    damage: list[Damage]
    samples: list[tuple[int, int]] = field(default_factory=list)  # offset, bid
    columns: dict[Key, list[Row]] = field(default_factory=dict)
    unknown: dict[int, list[tuple[int, bytes]]] = field(default_factory=dict)
    messages: list[Message] = field(default_factory=list)
    time: list[float] = field(default_factory=list)  # seconds
    packet_counter: list[int] = field(default_factory=list)
    restarts: list[int] = field(
        default_factory=list
    )  # the first sample of each later run of a device
    stats: dict[str, int] = field(default_factory=dict)


#: Identifiers of the quantities, by name.
IDS = {name: base for base, (name, *_) in (*REALS.items(), *NUMBERS.items(), *STRUCTS.items())}
IDS |= {"device_id": DEVICE_ID_PACKET, "frame_range": 0x1080, "baro_pressure": 0x3010}
IDS |= {"gyro_temperature": 0x0400, "gps_pvt_data": 0x0410, "time_sync": 0x0420}
IDS |= {"gyro_bias": 0x0430, "aiding": 0x0440}


def mtdata_rows(outputs: Outputs, frame: Frame) -> list[tuple[int, tuple[Key, Any] | bytes]] | None:
    """The rows of an MTData message; None if it does not fit its settings."""
    items = outputs.items(frame.bid, frame.payload)
    if items is None:
        return None
    rows: list[tuple[int, tuple[Key, Any] | bytes]] = []
    for name, data, kind in items:
        data_id = IDS[name]
        if kind == "P":
            rows.append((data_id, ((name, None), 2 * int.from_bytes(data, "big"))))
        elif kind == "R":
            precision = outputs.precision(frame.bid)
            width = WIDTHS[precision]
            reals = tuple(
                number(data[at : at + width], precision) for at in range(0, len(data), width)
            )
            system = (4 if outputs.is_ned(frame.bid) else 8) if data_id in ROTATES else 0
            key = name, COORDINATES[system] if system else None
            value = reals[0] if len(reals) == 1 else reals
            rows.append((data_id | precision | system, (key, value)))
        elif name == "gps_pvt_data":
            numbers = struct.unpack(">" + GPS_PVT[1], data)
            rows.append(
                (data_id, ((name, None), dict(zip(GPS_PVT[2].split(), numbers, strict=True))))
            )
        elif name in ("time_sync", "aiding"):
            rows.append((data_id, ((name, None), data[0])))
        else:
            packet = read(data_id, data)
            assert packet is not None
            rows.append((data_id, packet))
    return rows


def decode(data: bytes, limit: int = LONGEST, named: int = 0) -> Reference:
    """Decodes a whole log."""
    frames, strings, damage, checksum_errors = find(data, limit, named)
    log = Reference(frames, strings, damage)
    devices: dict[int, Device] = {}
    outputs = Outputs()
    malformed = unfit = lost = gaps = 0

    for frame in frames:
        # A stand-alone device answers to 1 and to FF (section 5.1, "BID or Address").
        device = devices.setdefault(1 if frame.bid == 0xFF else frame.bid, Device())
        rows: list[tuple[int, tuple[Key, Any] | bytes]] | None = None
        if frame.mid == MTDATA2 and (tiles := packets(frame.payload)) is not None:
            rows = [(data_id, read(data_id, raw) or raw) for data_id, raw in tiles]
        elif frame.mid == MTDATA:
            rows = mtdata_rows(outputs, frame)

        if rows is None:
            malformed += frame.mid == MTDATA2
            unfit += frame.mid == MTDATA
            outputs.learn(frame.bid, frame.mid, frame.payload)
            log.messages.append(
                Message(frame.mid, frame.bid, frame.payload, frame.offset, len(log.samples))
            )
            device.modulus = modulus_of_message(frame) or device.modulus
            if frame.mid in RESTARTS:
                device.restarted = device.recounts = True
            continue

        sample = len(log.samples)
        log.samples.append((frame.offset, frame.bid))
        stamps: dict[str, Any] = {}  # the last of every quantity
        for data_id, packet in rows:
            if isinstance(packet, bytes):
                log.unknown.setdefault(data_id, []).append((sample, packet))
                continue
            (name, coordinates), values = packet
            log.columns.setdefault((name, coordinates), []).append(Row(sample, data_id, values))
            stamps[name] = values

        seconds, missing, restarted = device.sample(stamps)
        log.time.append(seconds)
        log.packet_counter.append(device.counter if "packet_counter" in stamps else -1)
        lost += missing
        gaps += missing > 0
        if restarted:
            log.restarts.append(sample)

    log.stats = {
        "bytes": len(data),
        "frames": len(frames),
        "samples": len(log.samples),
        "messages": len(log.messages),
        "malformed": malformed,
        "unfit": unfit,
        "strings": len(strings),
        "skipped_bytes": sum(stretch.length for stretch in damage),
        "checksum_errors": checksum_errors,
        "lost_samples": lost,
        "gaps": gaps,
    }
    return log


# ---------------------------------------------------------------------------------------------
# Comparing with numpy
# ---------------------------------------------------------------------------------------------

DTYPES = {"b": "i1", "B": "u1", "h": "i2", "H": "u2", "i": "i4", "I": "u4", "Q": "u8", "f": "f4"}


def struct_dtype(layout: str, fields: str) -> np.dtype[Any]:
    """The packed structured type of a `struct` layout and its field names."""
    return np.dtype([(f, DTYPES[c]) for f, c in zip(fields.split(), layout, strict=True)])


def array(log: Reference, key: Key) -> NDArray[Any]:
    """Returns the values of a column as the package should return them, bit for bit.

    Float32 alone is float32; any other precision, or several, is float64. Integers keep their
    width (DeviceId is uint64 once one of eight bytes is among them). A rotation matrix is (N, 3, 3)
    with rows first. Structs are structured arrays; of GnssSatInfo only the head, see `satellites`.
    """
    name, _ = key
    rows = [row.values for row in log.columns[key]]
    if name == "device_id":
        return np.array(rows, "u8" if any(isinstance(row, Wide) for row in rows) else "u4")
    if name == "gnss_sat_info":
        dtype = struct_dtype("IBBBB", SAT_INFO_FIELDS)
        return np.array([tuple(row.values())[:5] for row in rows], dtype)
    if name == "frame_range":
        return np.array(rows, struct_dtype("HH", "first last"))
    for struct_name, layout, fields in (*STRUCTS.values(), GPS_PVT):
        if name == struct_name:
            return np.array([tuple(row.values()) for row in rows], struct_dtype(layout, fields))
    if name in ("time_sync", "aiding"):
        return np.array(rows, "u1")
    for number_name, layout in NUMBERS.values():
        if name == number_name and layout[0] != "f":
            return np.array(rows, DTYPES[layout[0]])

    table = [row if isinstance(row, tuple) else (row,) for row in rows]
    result: NDArray[Any]
    if all(isinstance(x, Float32) for row in table for x in row):
        result = np.array([[x.bits for x in row] for row in table], "u4").view("f4")
    else:
        result = np.array([[float(x) for x in row] for row in table], "f8")
    if name == "rotation_matrix":
        return result.reshape(-1, 3, 3).transpose(0, 2, 1)
    return result if isinstance(rows[0], tuple) else result[:, 0]


def satellites(log: Reference) -> tuple[NDArray[Any], NDArray[np.int64]]:
    """The satellites of every GnssSatInfo in one structured array, and where each row's begin."""
    rows = [row.values["satellites"] for row in log.columns[("gnss_sat_info", None)]]
    dtype = struct_dtype("BBBB", SATELLITE_FIELDS)
    flat = np.array([satellite for row in rows for satellite in row], dtype)
    return flat, np.cumsum([0, *map(len, rows)], dtype="i8")


def samples_of(log: Reference, key: Key) -> NDArray[np.int64]:
    """Which sample each row of a column belongs to."""
    return np.array([row.sample for row in log.columns[key]], "i8")


def _parts(values: ArrayLike) -> Iterator[tuple[np.dtype[Any], bytes]]:
    """Type and bytes of an array, or of every field of a structured one."""
    whole = np.asarray(values)
    names = whole.dtype.names
    for part in [whole] if names is None else [whole[name] for name in names]:
        yield part.dtype, part.tobytes()


def same_bits(expected: ArrayLike, actual: ArrayLike) -> bool:
    """Whether two arrays have one shape, one type and the same bits, those of a NaN included.

    Structured arrays are compared field by field in their order; padding and names do not count.
    """
    if np.shape(expected) != np.shape(actual):
        return False
    return list(_parts(expected)) == list(_parts(actual))
