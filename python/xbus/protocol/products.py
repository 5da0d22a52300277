"""What each product supports, and its factory settings: plain tables.

The rows of messages and quantities in `xbus.protocol.tables` list the products that have them. This module
has rates, synchronization, flags, strings, profiles, baud rates and defaults. Where the manual has a gap, the
sources are the vendor's open code and published settings of real devices.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

from xbus.protocol.configuration import Firmware
from xbus.protocol.ids import DataId
from xbus.protocol.tables import LEGACY_PRODUCTS, MESSAGES, PRODUCTS, QUANTITIES, Product
from xbus.protocol.values import (
    BAUD_CODES,
    EVERY,
    LATER_RESETS,
    AvailableProfile,
    GnssReceiver,
    GnssReceiverSettings,
    HardwareVersion,
    OptionFlag,
    Output,
    OutputMode,
    Polarity,
    PortConfig,
    PortProtocol,
    ResetCode,
    Selftest,
    StringType,
    SyncFunction,
    SyncLine,
    SyncSetting,
    baud_code,
)

__all__ = [
    "DEFAULT_BAUDRATE",
    "FactoryIdentity",
    "Support",
    "find_product",
    "legacy_product",
    "product_of_code",
    "support",
]

# Rates (Table 16, Tables 23 and 24)

#: The columns of `RATES`.
_FAMILIES = {
    1: "one", 2: "one", 3: "one", 7: "seven", 10: "ten", 20: "ten", 30: "ten",
    100: "hundred", 200: "hundred", 300: "hundred", 710: "g710",
    610: "six", 620: "six", 630: "six", 670: "six", 680: "six",
}  # fmt: skip


def _rates(one: int, seven: int, ten: int, hundred: int, g710: int, six: int) -> dict[str, int]:
    return {"one": one, "seven": seven, "ten": ten, "hundred": hundred, "g710": g710, "six": six}


#: The highest rate of each quantity, Hz: 1/2/3, 7, 10-series, 100-series, 710, 600-series. `EVERY`: with
#: every message, on every event, or with every solution of the receiver. 0: not supported.
# Table 16 has temperature at 1 Hz, but an MTi-G-710 took 100 Hz; and the pressure at 50 Hz, which the
# 600-series exceeds.
RATES: dict[str, dict[str, int]] = {
    "temperature":          _rates(100, 100, 400, 400, 400, 400),
    "quaternion":           _rates(100, 100, 400, 400, 400, 400),
    "rotation_matrix":      _rates(100, 100, 400, 400, 400, 400),
    "euler_angles":         _rates(100, 100, 400, 400, 400, 400),
    "baro_pressure":        _rates(0, 50, 0, 50, 50, 100),
    "delta_v":              _rates(100, 100, 400, 400, 400, 400),
    "acceleration":         _rates(100, 100, 400, 400, 400, 400),
    "free_acceleration":    _rates(100, 100, 400, 400, 400, 400),
    "acceleration_hr":      _rates(800, 800, 1000, 1000, 1000, 2000),
    "altitude_ellipsoid":   _rates(0, 100, 0, 0, 400, 400),
    "position_ecef":        _rates(0, 100, 0, 0, 400, 400),
    "lat_lon":              _rates(0, 100, 0, 0, 400, 400),
    "gnss_pvt_data":        _rates(0, 4, 0, 0, 4, EVERY),
    "gnss_sat_info":        _rates(0, 0, 0, 0, 4, EVERY),
    "gnss_pvt_pulse":       _rates(0, 0, 0, 0, 0, EVERY),
    "rate_of_turn":         _rates(100, 100, 400, 400, 400, 400),
    "delta_q":              _rates(100, 100, 400, 400, 400, 400),
    "rate_of_turn_hr":      _rates(800, 800, 1000, 1000, 1000, 1600),
    "raw_acc_gyr_mag_temp": _rates(0, 0, 2000, 2000, 2000, 0),
    "raw_gyro_temp":        _rates(0, 0, 2000, 2000, 2000, 0),
    "magnetic_field":       _rates(100, 100, 100, 100, 100, 100),
    "velocity_xyz":         _rates(0, 100, 0, 0, 400, 400),
}  # fmt: skip
#: Groups that come with every message or event, whatever rate is requested (Table 16, notes 7 and 10).
_EVERY_GROUPS = ("Timestamp", "Status", "Indication")
#: High-rate quantities whose rate is fixed: the 10- and 100-series, and the first hardware of the 1-series.
_HR = ("acceleration_hr", "rate_of_turn_hr")


def _highest(product: Product, quantity: str, hardware: HardwareVersion | None) -> int:
    """Returns the highest rate, with what the version of the hardware changes (Tables 23 and 24)."""
    row = QUANTITIES[quantity]
    if row.group in _EVERY_GROUPS:
        return EVERY
    rate = RATES[quantity][_FAMILIES[product.number]]
    if hardware is not None and quantity in _HR:
        if product.series == "1-series" and hardware.major != 2:
            return 1000
        if product.series == "600-series" and hardware.major == 2:
            return 2000
    return rate


def _is_fixed(product: Product, quantity: str, hardware: HardwareVersion | None) -> bool:
    old = product.series == "1-series" and hardware is not None and hardware.major < 2
    fixed_hr = quantity in _HR and (product.series in ("10-series", "100-series") or old)
    return fixed_hr or QUANTITIES[quantity].group == "GNSS"


@cache
def _quotients(highest: int) -> tuple[int, ...]:
    """Returns the whole quotients of a rate and whole numbers, the highest first."""
    return tuple(highest // index for index in range(1, highest + 1) if highest % index == 0)


# Synchronization (Tables 11 and 12)

_F, _L = SyncFunction, SyncLine
_Lines = dict[SyncFunction, tuple[SyncLine, ...]]
_IN, _IN_SOFTWARE = (_L.IN1,), (_L.IN1, _L.SOFTWARE)
_INS, _INS_SOFTWARE = (_L.IN1, _L.IN2), (_L.IN1, _L.IN2, _L.SOFTWARE)

_SYNC_1: _Lines = {_F.SEND_LATEST: _IN_SOFTWARE}
_SYNC_7: _Lines = {
    _F.SEND_LATEST: _IN_SOFTWARE,
    # In1 takes an external reference clock (Table 12, note 3).
    _F.CLOCK_BIAS_ESTIMATION: (_L.IN1, _L.GNSS_CLOCK_IN),
    _F.GNSS_1PPS: (_L.GNSS_1PPS,),
}
_SYNC_10: _Lines = {
    _F.TRIGGER_INDICATION: _IN,
    _F.INTERVAL_TRANSITION_MEASUREMENT: (_L.BI_OUT,),
    _F.SEND_LATEST: _IN_SOFTWARE,
    _F.CLOCK_BIAS_ESTIMATION: (_L.CLOCK_IN,),
    _F.START_SAMPLING: _IN,
}
_SYNC_710: _Lines = {
    **_SYNC_10,
    _F.CLOCK_BIAS_ESTIMATION: (_L.CLOCK_IN, _L.GNSS_CLOCK_IN),
    _F.GNSS_1PPS: (_L.BI_OUT,),
}
_SYNC_600: _Lines = {
    _F.TRIGGER_INDICATION: _INS,
    _F.INTERVAL_TRANSITION_MEASUREMENT: (_L.SYNC_OUT,),
    _F.SEND_LATEST: _INS_SOFTWARE,
    _F.CLOCK_BIAS_ESTIMATION: _INS,
    _F.START_SAMPLING: _INS,
}
_SYNC_670: _Lines = {**_SYNC_600, _F.GNSS_1PPS: _INS}
# The receiver is built in: its pulse is on In3 only.
_SYNC_680: _Lines = {**_SYNC_600, _F.CLOCK_BIAS_ESTIMATION: (_L.IN3,), _F.GNSS_1PPS: (_L.IN3,)}

_SYNC = {
    1: _SYNC_1, 2: _SYNC_1, 3: _SYNC_1, 7: _SYNC_7,
    10: _SYNC_10, 20: _SYNC_10, 30: _SYNC_10, 100: _SYNC_10, 200: _SYNC_10, 300: _SYNC_10,
    710: _SYNC_710,
    610: _SYNC_600, 620: _SYNC_600, 630: _SYNC_600, 670: _SYNC_670, 680: _SYNC_680,
}  # fmt: skip

# Option flags (Table 8)

_ONE, _TEN, _HUNDRED, _SIX = "1-series", "10-series", "100-series", "600-series"
#: The products that have each flag, by number or series.
_FLAGS: dict[OptionFlag, tuple[int | str, ...]] = {
    OptionFlag.DISABLE_AUTO_STORE: (_ONE,),
    OptionFlag.DISABLE_AUTO_MEASUREMENT: (_ONE,),
    OptionFlag.ENABLE_BEIDOU: (7, 670, 710),
    OptionFlag.ENABLE_AHS: (_ONE, _TEN, _HUNDRED),
    OptionFlag.ENABLE_ORIENTATION_SMOOTHER: (7, 670, 680, 710),
    OptionFlag.ENABLE_CONFIGURABLE_BUS_ID: (_TEN, _HUNDRED, _SIX),
    OptionFlag.ENABLE_IN_RUN_COMPASS_CALIBRATION: (_ONE, _TEN, _HUNDRED, _SIX),
    # Table 8 names the 1-series only, but the settings of an MTi-680G have it too.
    OptionFlag.ENABLE_CONFIG_MESSAGE_AT_STARTUP: (_ONE, _SIX),
    OptionFlag.ENABLE_COLD_FILTER_RESETS: (670, 680),
    OptionFlag.ENABLE_POSITION_VELOCITY_SMOOTHER: (680,),
    OptionFlag.ENABLE_CONTINUOUS_ZRU: (680,),
}

# Strings (products with strings: the manual; the strings of each product: the vendor's open code)

_S = StringType
_STRINGS_IMU = _S.PSONCMS | _S.HCMTW | _S.HEROT | _S.PTCF | _S.GPZDA
_STRINGS_VRU = _STRINGS_IMU | _S.TSS2 | _S.PHTRO | _S.PRDID | _S.EM1000 | _S.HEHDT
_STRINGS_AHRS = _STRINGS_VRU | _S.HCHDM | _S.HCHDG
_STRINGS_ALL = _STRINGS_AHRS | _S.GPGGA | _S.XSVEL | _S.GPRMC


def _strings(product: Product) -> StringType:
    if product.series == _ONE:
        return StringType(0)
    if product.series == _SIX:
        return _STRINGS_ALL
    return {"IMU": _STRINGS_IMU, "VRU": _STRINGS_VRU, "AHRS": _STRINGS_AHRS}.get(
        product.kind, _STRINGS_ALL
    )


# Filter profiles (Table 30; for the 600-series, whose profiles have names, the product's own manual)

#: Kinds of profiles on the 600-series.
BASE, ADDITIONAL, HEADING = 195, 196, 197


def _profiles(version: int, *rows: tuple[int, str]) -> tuple[AvailableProfile, ...]:
    return tuple(AvailableProfile(number, version, label) for number, label in rows)


_AHRS_10 = _profiles(
    15,
    (39, "general"),
    (40, "high_mag_dep"),
    (41, "dynamic"),
    (42, "low_mag_dep"),
    (43, "vru_general"),
)
_AHRS_1 = _profiles(
    1,
    (50, "General"),
    (51, "High_mag_dep"),
    (52, "Dynamic"),
    (53, "North_reference"),
    (54, "VRU_general"),
)
_VRU_600 = _profiles(
    1, (BASE, "Responsive"), (BASE, "Robust"), (HEADING, "VRU"), (HEADING, "VRUAHS")
)
_AHRS_600 = (*_VRU_600, *_profiles(1, (HEADING, "NorthReference"), (HEADING, "FixedMagRef")))

_PROFILES: dict[int, tuple[AvailableProfile, ...]] = {
    2: _AHRS_1[4:],
    3: _AHRS_1,
    7: _profiles(1, (11, "General"), (12, "GeneralNoBaro"), (13, "GeneralMag")),
    20: _AHRS_10[4:],
    30: _AHRS_10,
    200: _AHRS_10[4:],
    300: _AHRS_10,
    710: _profiles(
        1,
        (1, "General"),
        (2, "GeneralNoBaro"),
        (3, "GeneralMag"),
        (4, "Automotive"),
        (5, "HighPerformanceEDR"),
    ),
    620: _VRU_600,
    630: _AHRS_600,
    670: _profiles(1, (BASE, "General"), (BASE, "GeneralNoBaro"), (BASE, "GeneralMag")),
    680: _profiles(1, (BASE, "General_RTK"), (BASE, "GeneralNoBaro_RTK"), (BASE, "GeneralMag_RTK")),
}

#: The default profile (Table 2): its number, or on the 600-series its names.
_DEFAULT_PROFILES: dict[int, int | str] = {
    2: 54, 3: 50, 7: 11, 20: 43, 30: 39, 200: 43, 300: 39, 710: 1,
    620: "Responsive/VRU", 630: "Responsive/NorthReference", 670: "General", 680: "General_RTK",
}  # fmt: skip

# MTData (the vendor's older manuals and open code)

LEGACY = "legacy"
_M = OutputMode
_MODES_IMU = _M.TEMPERATURE | _M.CALIBRATED | _M.AUXILIARY | _M.STATUS | _M.RAW
_MODES_AHRS = _MODES_IMU | _M.ORIENTATION
_LEGACY_MODES = {
    "IMU": _MODES_IMU,
    "VRU": _MODES_AHRS,
    "AHRS": _MODES_AHRS,
    "GNSS/INS": _MODES_AHRS | _M.POSITION | _M.VELOCITY | _M.GPS_PVT,
}

# Defaults (Tables 2, 18, 40, 41)

_D = DataId
_FP1632 = 2
#: Default outputs at 100 Hz; counter and time come before them, the status word after them.
_DEFAULT_OUTPUTS = {
    "IMU": (_D.DeltaQ, _D.DeltaV, _D.MagneticField),
    "VRU": (_D.Quaternion,),
    "AHRS": (_D.Quaternion,),
    "GNSS/INS": (
        _D.Quaternion,
        _D.AltitudeEllipsoid | _FP1632,
        _D.LatLon | _FP1632,
        _D.VelocityXYZ | _FP1632,
    ),
}


def _default_outputs(product: Product) -> tuple[Output, ...]:
    measured = (Output(int(data_id), 100) for data_id in _DEFAULT_OUTPUTS[product.kind])
    return (Output(_D.PacketCounter), Output(_D.SampleTimeFine), *measured, Output(_D.StatusWord))


def _clock_bias(line: SyncLine, period: int) -> SyncSetting:
    return SyncSetting(SyncFunction.CLOCK_BIAS_ESTIMATION, line, Polarity.RISING, offset=period)


#: SyncIn of the GNSS/INS products (Table 2: GPS_Clock_Sync); lines and periods of published settings.
_DEFAULT_SYNC: dict[int, tuple[SyncSetting, ...]] = {
    7: (_clock_bias(SyncLine.GNSS_CLOCK_IN, 1000),),
    710: (_clock_bias(SyncLine.GNSS_CLOCK_IN, 250),),
    670: (_clock_bias(SyncLine.IN1, 1000),),
    680: (_clock_bias(SyncLine.IN3, 1000),),
}


#: Default baud rate (section 7.2.1).
DEFAULT_BAUDRATE = 115_200
_HOST_PORT = PortConfig(PortProtocol.XBUS, baud_code(DEFAULT_BAUDRATE))
_NO_PORT = PortConfig(PortProtocol.NONE, 0)
# The rate of the port for corrections is that of published settings.
_RTCM_PORT = PortConfig(PortProtocol.RTCM, baud_code(38_400))


def _default_ports(product: Product) -> tuple[PortConfig, ...]:
    """Returns the three ports of the 600-series (Table 22); none on other products."""
    if product.series != _SIX:
        return ()
    if product.number == 680:
        return (_HOST_PORT, _NO_PORT, _RTCM_PORT)
    return (_HOST_PORT, _HOST_PORT, _NO_PORT)


_NO_RECEIVER = GnssReceiverSettings(GnssReceiver.NONE, baud_code(DEFAULT_BAUDRATE), 0)
#: Default settings of the GNSS receiver, as published. The receiver of an MTi-670 is external.
_DEFAULT_RECEIVERS = {
    7: GnssReceiverSettings(GnssReceiver.MAX_M8Q, baud_code(115_200), 4),
    670: GnssReceiverSettings(GnssReceiver.MAX_M8Q, baud_code(115_200), 4),
    680: GnssReceiverSettings(GnssReceiver.ZED_F9P, baud_code(230_400), 4),
}

#: Bits of a passed self-test: nine sensors, and on an MTi-7 barometer and GNSS receiver.
_SELFTEST = Selftest((Selftest.MAG_Z << 1) - 1)
_SELFTEST_7 = _SELFTEST | Selftest.BARO | Selftest.GNSS

#: Letter and version of the filter in Configuration, as published; the manual does not list them.
_FILTER_VERSIONS = {30: ("I", (5, 1)), 300: ("I", (5, 1)), 710: ("7", (4, 1))}


@dataclass(frozen=True)
class FactoryIdentity:
    """Identity of a virtual device of a product: that of a real device where one is published."""

    device_id: int
    product_code: str
    firmware: Firmware
    hardware: HardwareVersion


def _identity(
    device_id: int, code: str, firmware: tuple[int, ...], hardware: tuple[int, int]
) -> FactoryIdentity:
    return FactoryIdentity(device_id, code, Firmware(*firmware), HardwareVersion(*hardware))


_IDENTITIES = {
    1: _identity(0x0188_0001, "MTi-1-8A7G6", (1, 5, 0, 33, 85107), (2, 0)),
    2: _identity(0x0288_0001, "MTi-2-8A7G6", (1, 5, 0, 33, 85107), (2, 0)),
    3: _identity(0x0388_7B6D, "MTi-3-8A7G6", (1, 5, 0, 33, 85107), (2, 0)),
    7: _identity(0x0788_1322, "MTi-7-8A7G6", (1, 14, 0, 33, 85107), (2, 0)),
    10: _identity(0x0160_0001, "MTi-10-2A5G4", (1, 8, 2, 37, 70964), (1, 0)),
    20: _identity(0x0260_0001, "MTi-20-2A5G4", (1, 8, 2, 37, 70964), (1, 0)),
    30: _identity(0x0360_08A6, "MTi-30-2A5G4", (1, 8, 2, 37, 70964), (1, 0)),
    100: _identity(0x0170_0001, "MTi-100-2A5G4", (1, 8, 2, 37, 70964), (1, 0)),
    200: _identity(0x0270_0001, "MTi-200-2A5G4", (1, 8, 2, 37, 70964), (1, 0)),
    300: _identity(0x0370_03F8, "MTi-300-2A5G4", (1, 8, 2, 37, 70964), (1, 0)),
    710: _identity(0x0770_10E6, "MTi-G-710-2A5G4", (1, 8, 2, 37, 70964), (1, 0)),
    610: _identity(0x8000_4001, "MTi-610-8A1G6", (1, 6, 0, 114, 108021), (1, 0)),
    620: _identity(0x8000_4002, "MTi-620-8A1G6", (1, 6, 0, 114, 108021), (1, 0)),
    630: _identity(0x8000_40D2, "MTi-630-8A1G6", (1, 6, 0, 114, 108021), (1, 0)),
    670: _identity(0x8000_4003, "MTi-670-8A1G6", (1, 6, 0, 114, 108021), (1, 0)),
    680: _identity(0x8000_A1B2, "MTi-680G-8A1G6", (1, 8, 0, 114, 108021), (1, 0)),
}
_LEGACY_IDENTITIES = {
    "MTi": _identity(0x0030_0001, "MTi-28A53G35", (2, 8, 1), (1, 0)),
    "MTx": _identity(0x0030_0002, "MTx-28A53G25", (2, 8, 1), (1, 0)),
    "MTi-G": _identity(0x0050_0618, "MTi-G-28A53G35", (2, 4, 0), (1, 0)),
}

# Section 7.2.1 allows at most 921,600, Table 7 has higher rates: the later products have them.
_ALL_BAUDRATES = tuple(sorted(set(BAUD_CODES.values())))
_BAUDRATES = {
    _ONE: _ALL_BAUDRATES,
    _TEN: tuple(rate for rate in _ALL_BAUDRATES if rate <= 921_600),
    _HUNDRED: tuple(rate for rate in _ALL_BAUDRATES if rate <= 921_600),
    _SIX: _ALL_BAUDRATES,
}


@dataclass(frozen=True)
class Support:
    """What a product supports, and its factory settings.

    Attributes:
        product: The product.
        hardware: The hardware version that the rates are for; None for the rates of the manual.
        messages: Names of the messages that it supports.
        legacy_messages: Names of those that it supports only in legacy mode, in which it sends MTData.
        output_modes: Items of MTData that it has; none if it never sends MTData.
        rates: The highest rate in Hz of each quantity that it offers; 0xFFFF if the quantity comes with every
            message, event, or solution of the GNSS receiver.
        sync: Synchronization functions, with their lines.
        option_flags: The option flags that it has.
        string_types: The strings that it can send.
        filter_profiles: The filter profiles on board.
        baudrates: Bits per second that its port can be set to.
        output_configuration: Default output configuration.
        sync_settings: Default synchronization.
        filter_profile: Default filter profile: a number, or names on the 600-series; None on an IMU.
        port_config: Default ports of the 600-series; empty on other products.
        gnss_receiver_settings: Default settings of the GNSS receiver.
        selftest: The result of a self-test in which all parts pass.
        filter_version: Letter of the filter in Configuration (None: not listed) and its version.
        identity: Identity of a virtual device of this product.
    """

    product: Product
    hardware: HardwareVersion | None
    messages: frozenset[str]
    legacy_messages: frozenset[str]
    output_modes: OutputMode
    rates: Mapping[str, int]
    sync: Mapping[SyncFunction, tuple[SyncLine, ...]]
    option_flags: OptionFlag
    string_types: StringType
    filter_profiles: tuple[AvailableProfile, ...]
    baudrates: tuple[int, ...]
    output_configuration: tuple[Output, ...]
    sync_settings: tuple[SyncSetting, ...]
    filter_profile: int | str | None
    port_config: tuple[PortConfig, ...]
    gnss_receiver_settings: GnssReceiverSettings
    selftest: Selftest
    filter_version: tuple[str | None, tuple[int, int]]
    identity: FactoryIdentity

    @property
    def is_legacy(self) -> bool:
        """Whether it sends MTData only, and no MTData2."""
        return self.product.series == LEGACY

    @property
    def orientation_resets(self) -> tuple[ResetCode, ...]:
        """The orientation resets that it has (Table 33). GNSS/INS products refuse that of the heading.

        >>> [code.name for code in support("MTi-680G").orientation_resets][:3]
        ['STORE', 'INCLINATION', 'ALIGNMENT']
        """
        lacking = LATER_RESETS if self.is_legacy else (ResetCode.GLOBAL,)
        if self.product.kind == "GNSS/INS":
            lacking = (*lacking, ResetCode.HEADING)
        return tuple(code for code in ResetCode if code not in lacking)

    @property
    def base_rate(self) -> int:
        """The rate in Hz at which the device computes samples; all output rates but HR divide it."""
        return self.rates["acceleration"]

    @property
    def strings_have_rate(self) -> bool:
        """Whether StringOutputType has the rate; other products use Period and OutputSkipFactor."""
        return self.product.series == _SIX

    def rates_of(self, quantity: str) -> tuple[int, ...]:
        """Returns the rates of a quantity in Hz, the highest first; empty if the product does not offer it.

        They are the whole quotients of the highest rate and whole numbers.

        >>> support("MTi-3").rates_of("acceleration")
        (100, 50, 25, 20, 10, 5, 4, 2, 1)
        """
        highest = self.rates.get(quantity, 0)
        if highest in (0, EVERY) or _is_fixed(self.product, quantity, self.hardware):
            return (highest,) if highest else ()
        return _quotients(highest)

    def acknowledged(self, output: Output) -> Output | None:
        """Returns the output with the rate in effect, as the device answers; None if it rejects it.

        An unsupported rate becomes the next lower supported one.
        """
        rates = self.rates_of(output.quantity or "")
        if not rates:
            return None
        asked = output.frequency if 0 < output.frequency < EVERY else rates[0]
        return Output(output.data_id, next((rate for rate in rates if rate <= asked), rates[-1]))


def _legacy_messages(product: Product) -> frozenset[str]:
    return frozenset(name for name, row in MESSAGES.items() if product.name in row.legacy)


def _legacy_support(product: Product) -> Support:
    modes = _LEGACY_MODES[product.kind]
    return Support(
        product=product,
        hardware=None,
        messages=_legacy_messages(product),
        legacy_messages=frozenset(),
        output_modes=modes,
        rates={},
        sync={},
        option_flags=OptionFlag(0),
        string_types=StringType(0),
        filter_profiles=(),
        baudrates=_BAUDRATES[_TEN],
        output_configuration=(),
        sync_settings=(),
        filter_profile=None,
        port_config=(),
        gnss_receiver_settings=_NO_RECEIVER,
        selftest=Selftest(0),
        filter_version=(None, (0, 0)),
        identity=_LEGACY_IDENTITIES[product.name],
    )


@cache
def _support(product: Product, hardware: HardwareVersion | None) -> Support:
    if product.series == LEGACY:
        return _legacy_support(product)
    number = product.number
    offered = {
        name: _highest(product, name, hardware)
        for name, row in QUANTITIES.items()
        if number in row.products
    }
    return Support(
        product=product,
        hardware=hardware,
        messages=frozenset(name for name, row in MESSAGES.items() if number in row.products),
        legacy_messages=_legacy_messages(product),
        output_modes=_LEGACY_MODES[product.kind]
        if product.series in (_TEN, _HUNDRED)
        else OutputMode(0),
        rates=offered,
        sync=_SYNC[number],
        option_flags=OptionFlag(
            sum(
                flag
                for flag, owners in _FLAGS.items()
                if number in owners or product.series in owners
            )
        ),
        string_types=_strings(product),
        filter_profiles=_PROFILES.get(number, ()),
        baudrates=_BAUDRATES[product.series],
        output_configuration=_default_outputs(product),
        sync_settings=_DEFAULT_SYNC.get(number, ()),
        filter_profile=_DEFAULT_PROFILES.get(number),
        port_config=_default_ports(product),
        gnss_receiver_settings=_DEFAULT_RECEIVERS.get(number, _NO_RECEIVER),
        selftest=_SELFTEST_7 if number == 7 else _SELFTEST,
        filter_version=_FILTER_VERSIONS.get(number, (None, (0, 0))),
        identity=_IDENTITIES[number],
    )


def find_product(product: str | int | Product) -> Product:
    """Returns a product by its model, its number or itself.

    Raises:
        ValueError: There is no such product.

    >>> find_product("mti-630").title
    'MTi-630 AHRS'
    """
    if isinstance(product, Product):
        return product
    for name, row in LEGACY_PRODUCTS.items():
        if str(product).upper() == name.upper():
            return row
    wanted = str(product).upper().removeprefix("MTI-")
    for row in PRODUCTS.values():
        if wanted in (str(row.number), row.name.upper().removeprefix("MTI-")):
            return row
    names = ", ".join(row.name for row in (*PRODUCTS.values(), *LEGACY_PRODUCTS.values()))
    raise ValueError(f"no product is called {product!r}; there are {names}")


def product_of_code(code: str) -> Product | None:
    """Returns the product of a code such as ``MTi-630-8A1G6``; None if the manual does not describe it.

    The MTi-G-700 counts as its successor, which has the same messages. A variant (R, G) counts as the product
    with its number.

    >>> product_of_code("MTi-G-700-2A5G4").name, product_of_code("MTi-320-8A1G6")
    ('MTi-G-710', None)
    """
    if (found := re.match(r"MTi-(?:G-)?(\d+)[GR]?\b", code)) is None:
        return None
    number = int(found[1])
    return PRODUCTS.get(710 if number == 700 else number)


def legacy_product(device_id: int, code: str | None = None) -> Product | None:
    """Returns the legacy product with a device identifier; None if the identifier is that of another one.

    Args:
        device_id: Device identifier.
        code: Product code, which distinguishes MTx and MTi.

    >>> legacy_product(0x01500618).name, legacy_product(0x00300F3A, "MTx-28A53G25").name
    ('MTi-G', 'MTx')
    """
    kind = None if device_id >> 31 else device_id >> 20 & 0xF
    if kind == 3:
        return LEGACY_PRODUCTS["MTx" if code is not None and code.startswith("MTx") else "MTi"]
    return LEGACY_PRODUCTS["MTi-G"] if kind == 5 else None


def support(product: str | int | Product, hardware: HardwareVersion | None = None) -> Support:
    """Returns what a product supports, and its factory settings.

    Args:
        product: Model, number or `xbus.protocol.tables.Product`.
        hardware: The version of its hardware, which changes the high rates (Tables 23 and 24).

    Raises:
        ValueError: There is no such product.

    >>> support("MTi-630").rates["acceleration_hr"], support("MTi-630").filter_profile
    (2000, 'Responsive/NorthReference')
    """
    return _support(find_product(product), hardware)
