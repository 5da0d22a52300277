"""What the numbers in messages mean: enumerations, flags and records, with the manual's names.

A device may send a number that no source explains. The number is kept: flags keep bits without a name, and a
number without a member of its enumeration is a plain integer. Only values sent to a device are checked.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from enum import IntEnum, IntFlag, StrEnum
from typing import NamedTuple, TypeVar

from xbus.protocol.formats import format_of
from xbus.protocol.ids import Coordinates, Precision

__all__ = [
    "BAUD_CODES",
    "CAN_BAUD_CODES",
    "CAN_EVERY",
    "EVERY",
    "GNSS_CARRIER_BIT",
    "GNSS_CORRECTED",
    "GNSS_FIX_OK",
    "POSITION_FIXES",
    "SATELLITE_USED_BIT",
    "Alignment",
    "AlignmentRotation",
    "AvailableProfile",
    "CanConfig",
    "CanDataId",
    "CanOutput",
    "DeviceErrorInfo",
    "DeviceWarning",
    "ErrorCode",
    "ExtOutputMode",
    "FilterProfile",
    "GnssChannel",
    "GnssFixType",
    "GnssLeverArm",
    "GnssPlatform",
    "GnssReceiver",
    "GnssReceiverSettings",
    "GnssSystem",
    "HardwareVersion",
    "IccCommand",
    "IccReply",
    "IccResult",
    "IccStatus",
    "LatLonAlt",
    "OptionFlag",
    "OptionFlags",
    "OrientationForm",
    "Output",
    "OutputMode",
    "OutputSettings",
    "Polarity",
    "PortConfig",
    "PortProtocol",
    "ResetCode",
    "Selftest",
    "State",
    "StringOutput",
    "StringType",
    "SyncFunction",
    "SyncLine",
    "SyncSetting",
    "UtcTime",
    "baud_code",
    "baudrate",
    "known",
    "usual_codes",
    "usual_rate",
]

E = TypeVar("E", bound=IntEnum)


def known(kind: type[E], number: int) -> E | int:
    """Returns the member of an enumeration, or the number itself if it has none.

    >>> known(ResetCode, 1), known(ResetCode, 99)
    (<ResetCode.HEADING: 1>, 99)
    """
    try:
        return kind(number)
    except ValueError:
        return number


class State(StrEnum):
    """State of a device (section 4)."""

    UNKNOWN = "unknown"
    WAKEUP = "wakeup"
    CONFIG = "config"
    MEASUREMENT = "measurement"


# The line

#: Bits on the line for each byte: a start bit, eight data bits, a stop bit.
BITS_PER_BYTE = 10
#: Maximum payload of a message to a device, in bytes (section 5.1, Table 3).
MAX_REQUEST_PAYLOAD = 2048
#: Bits per second by code, Table 7. The text has "76k6" where it means 76,800, and two codes for 921,600.
BAUD_CODES = {
    0x0D: 4_000_000,
    0x0E: 3_686_400,
    0x0C: 2_000_000,
    0x80: 921_600,
    0x0A: 921_600,
    0x00: 460_800,
    0x01: 230_400,
    0x02: 115_200,
    0x03: 76_800,
    0x04: 57_600,
    0x05: 38_400,
    0x06: 28_800,
    0x07: 19_200,
    0x08: 14_400,
    0x09: 9_600,
    0x0B: 4_800,
}
#: Bits per second on the CAN bus by code; they are not those of Table 7 (the CAN protocol document).
CAN_BAUD_CODES = {
    0x0C: 1_000_000,
    0x0B: 800_000,
    0x0A: 500_000,
    0x00: 250_000,
    0x01: 125_000,
    0x02: 100_000,
    0x03: 83_300,
    0x04: 62_500,
    0x05: 50_000,
    0x06: 33_300,
    0x07: 20_000,
    0x08: 10_000,
    0x09: 5_000,
}


def usual_codes(rates: Mapping[int, int]) -> dict[int, int]:
    """Returns the code to send for each rate of a table: the first one, such as 0x80 for 921,600.

    Args:
        rates: `BAUD_CODES` or `CAN_BAUD_CODES`.
    """
    return {rate: code for code, rate in reversed([*rates.items()])}


#: The code of each rate of Table 7 that all firmware knows.
_CODE_OF_RATE = usual_codes(BAUD_CODES)


def usual_rate(code: int, rates: Mapping[int, int]) -> int | None:
    """Returns the rate of a code; None if the table does not have the code, or another one is to send.

    >>> usual_rate(0x80, BAUD_CODES), usual_rate(0x0A, BAUD_CODES)
    (921600, None)
    """
    rate = rates.get(code)
    return rate if rate is not None and usual_codes(rates)[rate] == code else None


def baudrate(code: int) -> int | None:
    """Returns the bits per second of a code of Table 7; None if the table does not have the code.

    >>> baudrate(0x80), baudrate(0x55)
    (921600, None)
    """
    return BAUD_CODES.get(code)


def baud_code(rate: int) -> int:
    """Returns the code to send for a rate in bits per second (Table 7).

    Raises:
        ValueError: The table has no such rate.

    >>> hex(baud_code(921600))
    '0x80'
    """
    if rate not in _CODE_OF_RATE:
        rates = ", ".join(f"{rate:,}" for rate in sorted(_CODE_OF_RATE))
        raise ValueError(f"no device talks at {rate:,} baud; there are {rates}")
    return _CODE_OF_RATE[rate]


# Section 5.3.2: information


class HardwareVersion(NamedTuple):
    """Version of the hardware."""

    major: int
    minor: int

    def __str__(self) -> str:
        return f"{self.major}.{self.minor}"


class Selftest(IntFlag):
    """``SelftestResults``: a bit for each part that passed.

    From ``BATTERY`` on by the vendor's code. No source gives the bit of a part that the product lacks.
    """

    ACC_X = 1 << 0
    ACC_Y = 1 << 1
    ACC_Z = 1 << 2
    GYR_X = 1 << 3
    GYR_Y = 1 << 4
    GYR_Z = 1 << 5
    MAG_X = 1 << 6
    MAG_Y = 1 << 7
    MAG_Z = 1 << 8
    BARO = 1 << 9
    GNSS = 1 << 10
    BATTERY = 1 << 11
    FLASH = 1 << 12
    BUTTON = 1 << 13
    SYNC = 1 << 14

    @property
    def passed(self) -> bool:
        """Whether all nine inertial and magnetic sensors passed."""
        return int(self) & 0x1FF == 0x1FF


class DeviceErrorInfo(NamedTuple):
    """``Error``: its code (Table 5), and the bytes after it; code 40 has four."""

    code: int
    extra: bytes = b""


class ErrorCode(IntEnum):
    """Codes of Table 5, and one that devices send although the table lacks it; `RESULT_CODES` has all."""

    PERIOD = 3
    MESSAGE = 4
    TIMER_OVERFLOW = 30
    BAUDRATE = 32
    PARAMETER = 33
    DEVICE_ERROR = 40
    DATA_OVERFLOW = 41


class DeviceWarning(NamedTuple):
    """``Warning``: its code (Table 6) and text."""

    code: int
    text: str = ""


# Section 5.3.3: the device


class OptionFlag(IntFlag):
    """Option flags: Table 8, and from the vendor's code those that the table reserves or omits."""

    DISABLE_AUTO_STORE = 0x0001
    DISABLE_AUTO_MEASUREMENT = 0x0002
    ENABLE_BEIDOU = 0x0004
    DISABLE_GPS = 0x0008
    ENABLE_AHS = 0x0010
    ENABLE_ORIENTATION_SMOOTHER = 0x0020
    ENABLE_CONFIGURABLE_BUS_ID = 0x0040
    ENABLE_IN_RUN_COMPASS_CALIBRATION = 0x0080
    DISABLE_SLEEP_MODE = 0x0100
    ENABLE_CONFIG_MESSAGE_AT_STARTUP = 0x0200
    ENABLE_COLD_FILTER_RESETS = 0x0400
    ENABLE_POSITION_VELOCITY_SMOOTHER = 0x0800
    ENABLE_CONTINUOUS_ZRU = 0x1000
    ENABLE_RAW_GNSS_INPUT_FORWARDING = 0x2000


class OptionFlags(NamedTuple):
    """``SetOptionFlags``: flags to set and flags to clear; a flag in both is set."""

    set: OptionFlag = OptionFlag(0)
    clear: OptionFlag = OptionFlag(0)


#: Delays before an answer on RS485, in ticks of 1/29.4912 MHz (SetTransmitDelay).
TRANSMIT_DELAYS = range(590, 1 << 16)
#: Error modes: 0 ignore, 1 count, 2 count and report, 3 report and go to Config State.
ERROR_MODES = range(4)


# Section 5.3.4: synchronization


class SyncFunction(IntEnum):
    """Effects of input pulses and causes of output pulses: Table 11, and the vendor's names of others."""

    START_RECORDING_IN = 0
    STOP_RECORDING_IN = 1
    RESET_TIMER = 2
    TRIGGER_INDICATION = 3
    INTERVAL_TRANSITION_MEASUREMENT = 4
    INTERVAL_TRANSITION_RECORDING = 5
    GOTO_OPERATIONAL = 6
    SAMPLE_AND_SEND = 7
    SEND_LATEST = 8
    CLOCK_BIAS_ESTIMATION = 9
    PWM = 10
    START_SAMPLING = 11
    START_RECORDING_OUT = 12
    STOP_RECORDING_OUT = 13
    GNSS_1PPS = 14
    BUS_SYNC = 15


class SyncLine(IntEnum):
    """Lines (Table 12). Output pulses are on SYNC_OUT, and on BI_OUT on the 10- and 100-series."""

    CLOCK_IN = 0
    GNSS_CLOCK_IN = 1
    IN1 = 2
    BI_IN = 3
    BI_OUT = 4
    EXT_TIMEPULSE_IN = 5
    SOFTWARE = 6
    SYNC_OUT = 7
    GNSS_1PPS = 8
    IN2 = 9
    IN3 = 10


class Polarity(IntEnum):
    """The edge that counts, or the shape of a pulse (Tables 9 and 10)."""

    DISABLED = 0
    RISING = 1
    FALLING = 2
    BOTH = 3


#: Delays after an input pulse, and offsets of an output pulse, in 0.1 ms (Tables 9 and 10).
SYNC_DELAYS, PULSE_OFFSETS = range(60_000 + 1), range(-30_000, 30_000 + 1)
#: The functions with an output line; the others have an input line (Tables 9 and 10).
SYNC_OUT_FUNCTIONS = frozenset(
    {SyncFunction.INTERVAL_TRANSITION_MEASUREMENT, SyncFunction.GNSS_1PPS}
)


@dataclass(frozen=True)
class SyncSetting:
    """One synchronization setting (Tables 9 and 10).

    Attributes:
        function: Its function.
        line: Its line; the product determines the choices.
        polarity: The edge that counts.
        trigger_once: Whether only the first event counts.
        skip_first: Number of events to skip at the start.
        skip_factor: Number of events to skip after each that counts.
        pulse_width: Width of an output pulse, in 0.1 ms.
        offset: Delay after an input pulse, or offset of an output pulse, in 0.1 ms; for clock bias estimation
            the period of the reference clock, in ms.
    """

    function: SyncFunction | int
    line: SyncLine | int
    polarity: Polarity | int = Polarity.RISING
    trigger_once: bool = False
    skip_first: int = 0
    skip_factor: int = 0
    pulse_width: int = 0
    offset: int = 0


# Section 5.3.5: configuration

#: As an output frequency: the quantity comes with every message. In a request: the highest rate.
EVERY = 0xFFFF


class Output(NamedTuple):
    """One line of the output configuration (Table 15).

    Attributes:
        data_id: Data identifier with its format bits.
        frequency: Rate in Hz. 0 and 0xFFFF request the highest; 0xFFFF in a reply means every message.
    """

    data_id: int
    frequency: int = EVERY

    @property
    def quantity(self) -> str | None:
        """Name of the quantity, or None if the tables do not have the identifier."""
        row = format_of(self.data_id).quantity
        return None if row is None else row.name

    @property
    def precision(self) -> Precision | None:
        """Precision; None if the quantity is not a real number."""
        return format_of(self.data_id).precision

    @property
    def coordinates(self) -> Coordinates | int | None:
        """Coordinate system; None if the quantity has none."""
        return format_of(self.data_id).coordinates


#: Sampling periods for strings, 1/115200 s: 512 to 100 Hz (Table 18).
PERIODS = range(225, 1152 + 1)
#: Ticks of a sampling period in a second.
PERIOD_TICKS = 115_200
#: The skip factor with which strings are sent only on request, by ReqData (Table 19).
ON_DEMAND = 0xFFFF


class StringType(IntFlag):
    """Strings that a device can send instead of MTData2 (section 5.3.5, ReqStringOutputType).

    >>> import xbus
    >>> xbus.parse_string("$HEHDT,358.27,T*14").type
    <StringType.HEHDT: 256>
    """

    HCHDM = 1 << 0
    HCHDG = 1 << 1
    TSS2 = 1 << 2
    PHTRO = 1 << 3
    PRDID = 1 << 4
    EM1000 = 1 << 5
    PSONCMS = 1 << 6
    HCMTW = 1 << 7
    HEHDT = 1 << 8
    HEROT = 1 << 9
    GPGGA = 1 << 10
    PTCF = 1 << 11
    XSVEL = 1 << 12
    GPZDA = 1 << 13
    GPRMC = 1 << 14


class StringOutput(NamedTuple):
    """``StringOutputType``: the types of strings, and on the 600-series their rate in Hz.

    The 10- and 100-series take the rate from ``Period`` and ``OutputSkipFactor``; `frequency` is None.
    """

    types: StringType
    frequency: int | None = None


# MTData, the output of legacy products


class OutputMode(IntFlag):
    """Items of MTData.

    ``RAW`` excludes most others. ``MT9`` is the output of an older product, whose layout no source gives.
    """

    TEMPERATURE = 1 << 0
    CALIBRATED = 1 << 1
    ORIENTATION = 1 << 2
    AUXILIARY = 1 << 3
    POSITION = 1 << 4
    VELOCITY = 1 << 5
    STRAPDOWN = 1 << 9
    STATUS = 1 << 11
    GPS_PVT = 1 << 12
    RAW = 1 << 14
    MT9 = 1 << 15


class OrientationForm(IntEnum):
    """Form of the orientation in MTData."""

    QUATERNION = 0
    EULER_ANGLES = 1
    ROTATION_MATRIX = 2


#: Fields of OutputSettings that are one bit: the bit, and whether it is set if the field is False.
_SWITCHES = (
    ("packet_counter", 0, False),
    ("utc_time", 1, False),
    ("acceleration", 4, True),
    ("rate_of_turn", 5, True),
    ("magnetic_field", 6, True),
    ("status_word", 7, False),
    ("analog_in1", 10, True),
    ("analog_in2", 11, True),
    ("gps", 19, True),
    ("gyro_temperature", 24, False),
    ("sample_time_fine", 25, False),
)
_ORIENTATION_BIT, _PRECISION_BIT, _NED_BIT = 2, 8, 31
_KNOWN_SETTINGS = (
    sum(1 << bit for _, bit, _ in _SWITCHES)
    | 3 << _ORIENTATION_BIT
    | 3 << _PRECISION_BIT
    | 1 << _NED_BIT
)


@dataclass(frozen=True, repr=False)
class OutputSettings:
    """The form of the items of MTData (``OutputSettings``). The default is that of a new device.

    Attributes:
        packet_counter: Whether messages end with the packet counter.
        utc_time: Whether they end with UTC.
        orientation: Form of the orientation.
        acceleration: Whether the calibrated data contains acceleration.
        rate_of_turn: Whether it contains the rate of turn.
        magnetic_field: Whether it contains the magnetic field.
        status_word: Whether the status has 32 bits, not 8.
        precision: Number format of all real numbers.
        analog_in1: Whether the auxiliary data contains the first analog input.
        analog_in2: Whether it contains the second one.
        gps: Whether the GPS PVT data contains more than the pressure.
        gyro_temperature: Whether temperatures of the gyroscopes follow the temperature.
        sample_time_fine: Whether messages end with SampleTimeFine.
        coordinates: Coordinate system of orientation and velocity: NWU or NED.
        reserved: Bits that no source explains, kept unchanged.

    Raises:
        ValueError: A value does not fit its bits.

    >>> settings = OutputSettings(orientation=OrientationForm.EULER_ANGLES, coordinates=Coordinates.NED)
    >>> f"{int(settings):08X}", OutputSettings.from_word(0x105).precision.name
    ('80000005', 'Fp1220')
    >>> print(settings)
    80000005: packet counter, Euler angles, Float32, NED
    """

    packet_counter: bool = True
    utc_time: bool = False
    orientation: OrientationForm | int = OrientationForm.QUATERNION
    acceleration: bool = True
    rate_of_turn: bool = True
    magnetic_field: bool = True
    status_word: bool = False
    precision: Precision = Precision.Float32
    analog_in1: bool = True
    analog_in2: bool = True
    gps: bool = True
    gyro_temperature: bool = False
    sample_time_fine: bool = False
    coordinates: Coordinates = Coordinates.NWU
    reserved: int = 0

    def __post_init__(self) -> None:
        if self.coordinates not in (Coordinates.NWU, Coordinates.NED):
            raise ValueError(f"MTData has the coordinates NWU or NED, not {self.coordinates!r}")
        int(self)

    def __int__(self) -> int:
        switches = (
            (_bit(name, getattr(self, name)) ^ is_inverse) << bit
            for name, bit, is_inverse in _SWITCHES
        )
        return (
            sum(switches)
            | _bits("orientation", self.orientation, 3) << _ORIENTATION_BIT
            | _bits("precision", self.precision, 3) << _PRECISION_BIT
            | (self.coordinates == Coordinates.NED) << _NED_BIT
            | _bits("reserved", self.reserved, 0xFFFF_FFFF & ~_KNOWN_SETTINGS)
        )

    __index__ = __int__

    @classmethod
    def from_word(cls, word: int) -> OutputSettings:
        """Returns the settings that the message's word holds."""
        return cls(
            **{name: bool(word >> bit & 1) ^ is_inverse for name, bit, is_inverse in _SWITCHES},
            orientation=known(OrientationForm, word >> _ORIENTATION_BIT & 3),
            precision=Precision(word >> _PRECISION_BIT & 3),
            coordinates=Coordinates.NED if word >> _NED_BIT & 1 else Coordinates.NWU,
            reserved=word & ~_KNOWN_SETTINGS,
        )

    @property
    def is_explained(self) -> bool:
        """Whether a source explains every bit."""
        return not self.reserved and isinstance(self.orientation, OrientationForm)

    def __repr__(self) -> str:
        values = ((field.name, getattr(self, field.name), field.default) for field in fields(self))
        shown = (
            f"{name}={type(value).__name__}.{value.name}"
            if isinstance(value, IntEnum)
            else f"{name}={value!r}"
            for name, value, default in values
            if value != default
        )
        return f"OutputSettings({', '.join(shown)})"

    def __str__(self) -> str:
        form = known(OrientationForm, self.orientation)
        orientation = form.name if isinstance(form, OrientationForm) else f"orientation {form}"
        added = [
            name for name, _, is_inverse in _SWITCHES if not is_inverse and getattr(self, name)
        ]
        omitted = [
            f"no {name}"
            for name, _, is_inverse in _SWITCHES
            if is_inverse and not getattr(self, name)
        ]
        parts = [*added, orientation.lower(), *omitted]
        text = [
            part.replace("_", " ").replace("euler", "Euler").replace("utc", "UTC") for part in parts
        ]
        text += [self.precision.name, self.coordinates.name]
        text += [f"reserved bits {self.reserved:08X}"] if self.reserved else []
        return f"{int(self):08X}: {', '.join(text)}"


class GnssChannel(NamedTuple):
    """A channel of the GPS receiver of an MTi-G (``GnssStatus``).

    Attributes:
        channel: Number of the channel.
        satellite: Number of the satellite.
        flags: Bit mask of its state.
        quality: Quality of the signal.
        cno: Carrier-to-noise ratio, in dBHz.
    """

    channel: int
    satellite: int
    flags: int
    quality: int
    cno: int


class Alignment(IntEnum):
    """The rotation that ``AlignmentRotation`` sets (Table 20)."""

    ROT_SENSOR = 0
    ROT_LOCAL = 1


@dataclass(frozen=True)
class AlignmentRotation:
    """An alignment rotation (Table 20): output orientation = RotLocal q RotSensor.

    Attributes:
        parameter: Which rotation; None in replies of old firmware, which omit it.
        quaternion: q0, q1, q2, q3.
    """

    parameter: Alignment | int | None
    quaternion: tuple[float, float, float, float]


class ExtOutputMode(IntFlag):
    """Extended output mode (Table 21). Only legacy products have ``ANALOG_EULER_ANGLES``."""

    ANALOG_EULER_ANGLES = 1 << 0
    ALTERNATIVE_UART = 1 << 4
    USB_LOW_LATENCY = 1 << 5


class PortProtocol(IntEnum):
    """Protocol of a port of the 600-series (figure 2)."""

    NONE = 0
    XBUS = 1
    NMEA = 5
    RTCM = 6


def _bits(name: str, value: int, mask: int) -> int:
    """Returns the value if it fits its bits; raises ValueError otherwise."""
    if not isinstance(value, int) or isinstance(value, bool) or value & ~mask:
        raise ValueError(
            f"{name} cannot be {value!r}: it must be an integer within the bits 0x{mask:X}"
        )
    return int(value)


def _bit(name: str, value: bool) -> bool:
    """Returns the value if it is a bit; raises ValueError otherwise."""
    if not isinstance(value, int) or value not in (0, 1):
        raise ValueError(f"{name} cannot be {value!r}: it must be true or false")
    return bool(value)


@dataclass(frozen=True)
class PortConfig:
    """One port of the 600-series: RS232, UART, or the RS232 for RTCM (Table 22, figure 2).

    Attributes:
        protocol: Its protocol; NONE if the product does not have the port.
        baud_code: Code of Table 7; `baudrate` has the rate.
        flow_control: RTS and CTS; on the first port only.
        two_stop_bits: Whether there are two stop bits, not one.
        parity: Whether there is a parity bit.
        parity_even: Whether the parity is even, as far as known: no source confirms which of the two is set.
        reserved: Bits that no source explains, kept unchanged.
    """

    protocol: PortProtocol | int
    baud_code: int
    flow_control: bool = False
    two_stop_bits: bool = False
    parity: bool = False
    parity_even: bool = False
    reserved: int = 0

    @property
    def baudrate(self) -> int | None:
        """Bits per second; None for a code that Table 7 does not have."""
        return baudrate(self.baud_code)

    def __int__(self) -> int:
        flags = ("flow_control", "two_stop_bits", "parity", "parity_even")
        return (
            _bits("baud_code", self.baud_code, 0xFF)
            | sum(_bit(flag, getattr(self, flag)) << bit for bit, flag in enumerate(flags, 8))
            | _bits("protocol", self.protocol, 0xF) << 16
            | _bits("reserved", self.reserved, 0xFFF0_F000)
        )

    @classmethod
    def from_word(cls, word: int) -> PortConfig:
        """Returns the port that a word of the message describes.

        >>> PortConfig.from_word(0x00010080)
        PortConfig(protocol=<PortProtocol.XBUS: 1>, baud_code=128, flow_control=False, two_stop_bits=False, \
parity=False, parity_even=False, reserved=0)
        """
        flow, stop, parity, even = (bool(word >> bit & 1) for bit in (8, 9, 10, 11))
        protocol = known(PortProtocol, word >> 16 & 0xF)
        return cls(protocol, word & 0xFF, flow, stop, parity, even, word & 0xFFF0_F000)


class CanDataId(IntEnum):
    """Data identifiers on the CAN bus (the CAN protocol document)."""

    ERROR = 0x01
    WARNING = 0x02
    SAMPLE_TIME = 0x05
    GROUP_COUNTER = 0x06
    UTC_TIME = 0x07
    STATUS_WORD = 0x11
    QUATERNION = 0x21
    EULER_ANGLES = 0x22
    ROTATION_MATRIX = 0x23
    DELTA_V = 0x31
    RATE_OF_TURN = 0x32
    DELTA_Q = 0x33
    ACCELERATION = 0x34
    FREE_ACCELERATION = 0x35
    MAGNETIC_FIELD = 0x41
    TEMPERATURE = 0x51
    BARO_PRESSURE = 0x52
    RATE_OF_TURN_HR = 0x61
    ACCELERATION_HR = 0x62
    LAT_LON = 0x71
    ALTITUDE_ELLIPSOID = 0x72
    POSITION_ECEF_X = 0x73
    POSITION_ECEF_Y = 0x74
    POSITION_ECEF_Z = 0x75
    VELOCITY_XYZ = 0x76
    LATITUDE = 0x77
    LONGITUDE = 0x78
    GNSS_RECEIVER_STATUS = 0x79
    GNSS_RECEIVER_DOP = 0x7A


#: The same on CAN, where a frequency has 11 bits. Software of the vendor writes `EVERY`, which has them all.
CAN_EVERY = 0x7FF


@dataclass(frozen=True)
class CanOutput:
    """One line of the CAN output configuration.

    Attributes:
        data_id: Data identifier of the message.
        extended: Whether the CAN identifier has 29 bits, not 11.
        can_id: CAN identifier.
        frequency: Rate in Hz; `CAN_EVERY` or `EVERY` means the highest, or with every group.
    """

    data_id: CanDataId | int
    extended: bool
    can_id: int
    frequency: int

    @property
    def rate(self) -> int | None:
        """Rate in Hz; None for the highest, or with every group.

        >>> CanOutput(CanDataId.ACCELERATION, False, 0x34, EVERY).rate is None
        True
        """
        rate = self.frequency & CAN_EVERY
        return None if rate in (0, CAN_EVERY) else rate


@dataclass(frozen=True)
class CanConfig:
    """The CAN transceiver.

    Attributes:
        baud_code: A key of `CAN_BAUD_CODES`.
        enabled: Whether CAN is on.
        reserved: The other bits, which later products use.
    """

    baud_code: int
    enabled: bool = True
    reserved: int = 0

    @property
    def baudrate(self) -> int | None:
        """Bits per second; None for an unknown code."""
        return CAN_BAUD_CODES.get(self.baud_code)

    def __int__(self) -> int:
        return (
            _bits("baud_code", self.baud_code, 0xFF)
            | _bit("enabled", self.enabled) << 8
            | _bits("reserved", self.reserved, 0xFFFF_FE00)
        )

    @classmethod
    def from_word(cls, word: int) -> CanConfig:
        """Returns the settings that the message's word holds."""
        return cls(word & 0xFF, bool(word >> 8 & 1), word & 0xFFFF_FE00)


# Section 5.3.7: filters


class LatLonAlt(NamedTuple):
    """The stored place, for local gravity and declination (Table 28): degrees, degrees, metres."""

    lat: float
    lon: float
    alt: float


class AvailableProfile(NamedTuple):
    """One of the filter profiles on board (Table 29).

    Attributes:
        type: Its number; on the 600-series its kind: 195 base, 196 additional, 197 heading. 0: empty slot.
        version: Its version.
        label: Its name.
    """

    type: int
    version: int
    label: str


class FilterProfile(NamedTuple):
    """The filter profile in use, as the products before the 600-series name it (Table 30)."""

    version: int
    profile: int


class GnssSystem(IntEnum):
    """Satellite systems in GnssSatInfo (Table 26)."""

    GPS = 0
    SBAS = 1
    GALILEO = 2
    BEIDOU = 3
    IMES = 4
    QZSS = 5
    GLONASS = 6

    @property
    def label(self) -> str:
        """Its name as it is usually written, such as ``Galileo``."""
        return {"GALILEO": "Galileo", "BEIDOU": "BeiDou"}.get(self.name, self.name)


#: The bit of the flags of a satellite that is used for navigation (Table 26).
SATELLITE_USED_BIT = 3


class GnssFixType(IntEnum):
    """Fix types in GnssPvtData (Table 25)."""

    NONE = 0
    DEAD_RECKONING = 1
    FIX_2D = 2
    FIX_3D = 3
    GNSS_AND_DEAD_RECKONING = 4
    TIME_ONLY = 5


#: The fix types whose position is measured by the receiver.
POSITION_FIXES = (GnssFixType.FIX_2D, GnssFixType.FIX_3D, GnssFixType.GNSS_AND_DEAD_RECKONING)
#: Bits of the flags in GnssPvtData (Table 25): the fix is good, and corrections are applied.
GNSS_FIX_OK, GNSS_CORRECTED = 1 << 0, 1 << 1
#: The first of two bits of these flags, about the use of carrier phases: 0 none, 1 float, 2 fixed. The manual
#: does not describe them; they are those of u-blox, whose message this is.
GNSS_CARRIER_BIT = 6


class GnssPlatform(IntEnum):
    """Dynamic model of the GNSS receiver: Table 31, and the receiver maker's numbers of the others."""

    PORTABLE = 0
    STATIONARY = 2
    PEDESTRIAN = 3
    AUTOMOTIVE = 4
    SEA = 5
    AIRBORNE_1G = 6
    AIRBORNE_2G = 7
    AIRBORNE_4G = 8
    WRIST = 9


class GnssReceiver(IntEnum):
    """Kinds of GNSS receivers (not in this revision of the manual; the vendor's open code)."""

    MAX_M8Q = 0
    NMEA = 1
    NEO_M8P = 2
    ZED_F9P = 3
    SEPTENTRIO = 4
    TRIMBLE_BX992 = 5
    UBLOX = 6
    NONE = 0xFFFF


@dataclass(frozen=True)
class GnssReceiverSettings:
    """Settings of the connection to the GNSS receiver (not in this revision of the manual).

    Attributes:
        receiver: Kind of receiver.
        baud_code: Code of Table 7.
        rate: Solutions per second, in Hz.
        options: For u-blox the platform, for NMEA the talker (0 GL, 1 GN, 2 GP).
    """

    receiver: GnssReceiver | int
    baud_code: int
    rate: int
    options: int = 0


class GnssLeverArm(NamedTuple):
    """From the origin of the device to the antenna, m, in the sensor frame (Table 32)."""

    x: float
    y: float
    z: float


class ResetCode(IntEnum):
    """Orientation resets (Table 33). Legacy products have ``GLOBAL``, and no defaults."""

    STORE = 0
    HEADING = 1
    GLOBAL = 2
    INCLINATION = 3
    ALIGNMENT = 4
    DEFAULT_HEADING = 5
    DEFAULT_INCLINATION = 6
    DEFAULT_ALIGNMENT = 7


#: Orientation resets that legacy products lack.
LATER_RESETS = (
    ResetCode.DEFAULT_HEADING,
    ResetCode.DEFAULT_INCLINATION,
    ResetCode.DEFAULT_ALIGNMENT,
)


@dataclass(frozen=True)
class UtcTime:
    """A time (Table 35).

    Attributes:
        ns: Nanoseconds of the second.
        year: Year, 1999 to 2099.
        month: Month.
        day: Day of the month.
        hour: Hour.
        minute: Minute.
        second: Second.
        valid: Bit 0 time of week, bit 1 week number, bit 2 UTC.
    """

    ns: int
    year: int
    month: int
    day: int
    hour: int
    minute: int
    second: int
    valid: int = 0


class IccCommand(IntEnum):
    """In-run compass calibration (Table 36); STATUS is not in this revision of the manual."""

    START = 0
    STOP = 1
    STORE = 2
    STATE = 3
    STATUS = 4


class IccStatus(IntFlag):
    """Problems of a calibration (Table 39)."""

    DISTURBED = 0x01
    NOT_ENOUGH_DATA = 0x02
    OUTPUT_STABLE = 0x10
    REPRESENTATIVE_MOTION = 0x20


class IccResult(NamedTuple):
    """Result of a representative motion (Table 39).

    Attributes:
        ddt: Disturbance over noise.
        dimension: 2 or 3.
        status: Flags of problems; none if all is well.
    """

    ddt: float
    dimension: int
    status: IccStatus


@dataclass(frozen=True)
class IccReply:
    """``IccCommandAck`` (Tables 37 and 38): the command, and its result or state."""

    command: IccCommand | int
    result: IccResult | None = None
    active: bool | None = None
