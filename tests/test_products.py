"""What each product supports: the manual's tables, repeated on purpose, as in `reference`.

They include the corrections of FACTS. A test that read the package's tables would repeat their mistakes.
"""

from __future__ import annotations

import re

import pytest

from conftest import shared
from test_tables import names, rows
from xbus.protocol import (
    EVERY,
    HardwareVersion,
    OptionFlag,
    Output,
    Polarity,
    StringType,
    SyncFunction,
    SyncLine,
    SyncSetting,
    decode,
    encode,
)
from xbus.protocol.messages import LAYOUTS
from xbus.protocol.products import find_product, product_of_code, support
from xbus.protocol.tables import MESSAGES, PRODUCTS, QUANTITIES
from xbus.protocol.values import BAUD_CODES

ALL = (1, 2, 3, 7, 10, 20, 30, 100, 200, 300, 710, 610, 620, 630, 670, 680)
SERIES_1, SERIES_10, SERIES_100 = (1, 2, 3, 7), (10, 20, 30), (100, 200, 300, 710)
SERIES_600 = (610, 620, 630, 670, 680)
IMU, GNSS = (1, 10, 100, 610), (7, 710, 670, 680)


def test_there_are_sixteen_products() -> None:
    assert sorted(PRODUCTS) == sorted(ALL)
    for number in ALL:
        assert support(number).product is PRODUCTS[number]


# ---------------------------------------------------------------------------------------------
# Names and codes
# ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("spelling", "number"),
    [
        (630, 630), ("630", 630), ("MTi-630", 630), ("mti-630", 630), ("MTI-630", 630),
        ("MTi-680G", 680), ("680g", 680), ("MTi-680", 680), (680, 680), ("680", 680),
        ("MTi-G-710", 710), ("G-710", 710), ("mti-g-710", 710), ("710", 710), ("MTi-710", 710),
        ("MTi-1", 1), ("1", 1), (PRODUCTS[7], 7),
    ],
)  # fmt: skip
def test_find_product(spelling: str | int, number: int) -> None:
    assert find_product(spelling) is PRODUCTS[number]


@pytest.mark.parametrize(
    "spelling",
    ["", "MTi-", "MTi-8", "MTi-630G", "630R", "MTi-G-30", "G-630", "XMTi-3", 0, 640, "G"],
)
def test_unknown_products_are_rejected(spelling: str | int) -> None:
    error = (
        re.escape(f"no product is called {spelling!r}; there are MTi-1, MTi-2, ")
        + ".*MTi-680G, MTi, MTx, MTi-G$"
    )
    with pytest.raises(ValueError, match=error):
        find_product(spelling)


@pytest.mark.parametrize(
    ("code", "number"),
    [
        # Seen, FACTS 6.1.
        ("MTi-300-2A5G4", 300), ("MTi-30-2A5G4", 30), ("MTi-30-2A8G4", 30), ("MTi-G-710-2A5G4", 710),
        ("MTi-3-8A7G6", 3), ("MTi-630-8A1G6", 630), ("MTi-680G-8A1G6", 680),
        # Variants, and what is padded as in the message.
        ("MTi-3-8A7G6T", 3), ("MTi-7-8A7G6T      ", 7), ("MTi-630R-8A1G6", 630), ("MTi-670G-8A1G6", 670),
        ("MTi-680G", 680), ("MTi-1", 1), ("MTi-G-700-2A5G4", 710),
        # Of other lines, older or later.
        ("MTi-8-7A8G6", None), ("MTi-320-8A1G6", None), ("MTi-330-8A1G6", None),
        ("MTi-28A33G85", None), ("MTi-G-28A53G35", None), ("MTi-30A53G35", None),
        ("ARG-10-2A8G6", None), ("SMG-20-2A8G6", None),
        # No such product.
        ("", None), ("MTi", None), ("MTi-", None), ("MTi-G-", None), ("mti-630-8A1G6", None),
        ("XMTi-630", None), ("630", None), ("MTi-6300-8A1G6", None), ("MTi-99999999999999999999", None),
    ],
)  # fmt: skip
def test_product_of_code(code: str, number: int | None) -> None:
    assert product_of_code(code) is (None if number is None else PRODUCTS[number])


# ---------------------------------------------------------------------------------------------
# Messages
# ---------------------------------------------------------------------------------------------


def test_messages() -> None:
    """The product rows of section 5.3, as corrected in the list beside the repository."""
    for row in rows("spec/messages.csv"):
        if "series" in row["products"] or row["name"].startswith("InitBus"):
            continue
        text = re.sub(r"\(.*\)", "", row["products"])
        listed = {int(item) for item in re.findall(r"\b\d+\b", text)} & set(ALL)
        expected = set(ALL) if text.startswith("all") else listed
        for name in names(row["name"]) & set(LAYOUTS):
            assert {item for item in ALL if name in support(item).messages} == expected, name


def test_messages_of_ambiguous_products() -> None:
    """The vendor's software opens every MTi with InitBus; all but the 1-series can store a filter state."""
    assert all({"InitBus", "InitBusResults"} <= support(item).messages for item in ALL)
    without = {item for item in ALL if "StoreFilterState" not in support(item).messages}
    assert without == set(SERIES_1)
    known = set().union(*(support(item).messages for item in ALL))
    assert known == {message.name for message in MESSAGES.values() if message.products}


# ---------------------------------------------------------------------------------------------
# Rates
# ---------------------------------------------------------------------------------------------

#: Highest rates: Table 16, with what FACTS 4.4, 4.5 and data_ids.csv correct. "on": with every message, on
#: every event, or as the receiver delivers; "-": not there.
RATES = """
    quantity              1    2,3  7    10   20,30 100  200,300 710  610  620,630 670,680
    temperature           100  100  100  400  400   400  400     400  400  400     400
    utc_time              on   on   on   on   on    on   on      on   on   on      on
    packet_counter        on   on   on   on   on    on   on      on   on   on      on
    sample_time_fine      on   on   on   on   on    on   on      on   on   on      on
    sample_time_coarse    on   on   on   on   on    on   on      on   on   on      on
    quaternion            -    100  100  -    400   -    400     400  -    400     400
    rotation_matrix       -    100  100  -    400   -    400     400  -    400     400
    euler_angles          -    100  100  -    400   -    400     400  -    400     400
    baro_pressure         -    -    50   -    -     50   50      50   100  100     100
    delta_v               100  100  100  400  400   400  400     400  400  400     400
    acceleration          100  100  100  400  400   400  400     400  400  400     400
    free_acceleration     -    100  100  -    400   -    400     400  -    400     400
    acceleration_hr       800  800  800  1000 1000  1000 1000    1000 2000 2000    2000
    trigger_in1           -    -    -    -    -     -    -       -    on   on      on
    trigger_in2           -    -    -    -    -     -    -       -    on   on      on
    altitude_ellipsoid    -    -    100  -    -     -    -       400  -    -       400
    position_ecef         -    -    100  -    -     -    -       400  -    -       400
    lat_lon               -    -    100  -    -     -    -       400  -    -       400
    gnss_pvt_data         -    -    4    -    -     -    -       4    -    -       on
    gnss_sat_info         -    -    -    -    -     -    -       4    -    -       on
    gnss_pvt_pulse        -    -    -    -    -     -    -       -    -    -       on
    rate_of_turn          100  100  100  400  400   400  400     400  400  400     400
    delta_q               100  100  100  400  400   400  400     400  400  400     400
    rate_of_turn_hr       800  800  800  1000 1000  1000 1000    1000 1600 1600    1600
    raw_acc_gyr_mag_temp  -    -    -    2000 2000  2000 2000    2000 -    -       -
    raw_gyro_temp         -    -    -    2000 2000  2000 2000    2000 -    -       -
    magnetic_field        100  100  100  100  100   100  100     100  100  100     100
    velocity_xyz          -    -    100  -    -     -    -       400  -    -       400
    status_byte           on   on   on   on   on    on   on      on   on   on      on
    status_word           on   on   on   on   on    on   on      on   on   on      on
    device_id             -    -    -    on   on    on   on      on   -    -       -
    location_id           -    -    -    on   on    on   on      on   -    -       -
"""


def rate_table() -> dict[int, dict[str, int]]:
    """Returns the highest rates of each product by quantity."""
    head, *lines = [line.split() for line in RATES.strip().splitlines()]
    table: dict[int, dict[str, int]] = {}
    for column, numbers in enumerate(head[1:], 1):
        cells = {line[0]: line[column] for line in lines if line[column] != "-"}
        for number in numbers.split(","):
            table[int(number)] = {
                key: EVERY if supported == "on" else int(supported)
                for key, supported in cells.items()
            }
    return table


def test_table_16() -> None:
    found = {item: dict(support(item).rates) for item in ALL}
    # Triggers of a third line have an identifier, but nothing else is documented.
    assert {item for item in ALL if found[item].pop("trigger_in3", None)} <= {680}
    assert found == rate_table()


def test_table_16_matches_the_list() -> None:
    """The columns of rates agree for the rows of the manual."""
    columns = {
        "rate_1_2_3": (1, 2, 3), "rate_7_8": (7,), "rate_10s": SERIES_10, "rate_100s": (100, 200, 300),
        "rate_710": (710,), "rate_600s": SERIES_600,
    }  # fmt: skip
    by_id = {quantity.id: quantity.name for quantity in QUANTITIES.values()}
    table = rate_table()
    for row in rows("spec/data_ids.csv"):
        if row["in_seed"] != "y":
            continue
        name = by_id[int(row["base_id"], 16)]
        offering = {int(item) for item in re.findall(r"\b\d+\b", row["products"])} & set(ALL)
        assert {item for item in ALL if name in table[item]} == offering, name
        for column, numbers in columns.items():
            text = row[column]
            if "hw1" in text or text == "same as 1_2_3":
                listed = [800]
            elif "every" in text or "FFFF" in text:
                listed = [EVERY]
            else:
                listed = [int(item) for item in re.findall(r"\d+", text)[:1]]
            for number in numbers:
                if name in table[number]:
                    assert [table[number][name]] == listed, (name, number)


@pytest.mark.parametrize("number", ALL)
def test_rates_divide_the_highest_rate(number: int) -> None:
    """FACTS 4.5: all whole f with f * (k + 1) == base; others have one rate."""
    supported = support(number)
    for name, base in supported.rates.items():
        found = supported.rates_of(name)
        fixed_hr = name.endswith("_hr") and number in SERIES_10 + SERIES_100
        if base == EVERY or name.startswith("gnss_") or fixed_hr:
            assert found == (base,)
        else:
            every = [f for f in range(1, base + 1) if f * (base // f) == base]
            assert found == tuple(reversed(every))


def test_rates_of() -> None:
    assert support(7).rates_of("baro_pressure") == (50, 25, 10, 5, 2, 1)
    assert support(710).rates_of("gnss_pvt_data") == (4,)
    assert support(630).rates_of("gnss_pvt_data") == ()
    assert support(630).rates_of("wings") == ()
    assert support(630).rates_of("rate_of_turn_hr")[:4] == (1600, 800, 400, 320)


@pytest.mark.parametrize(
    ("number", "hardware", "acceleration", "rate_of_turn", "divide"),
    [
        # Tables 23 and 24, and FACTS 4.4 for hardware 3 and for the 600-series.
        (3, (1, 9), 1000, 1000, False),
        (3, (2, 0), 800, 800, True),
        (3, (2, 5), 800, 800, True),
        (3, (3, 0), 1000, 1000, True),
        (7, (1, 0), 1000, 1000, False),
        (30, (1, 0), 1000, 1000, False),
        (710, (2, 0), 1000, 1000, False),
        (630, (1, 0), 2000, 1600, True),
        (630, (2, 0), 2000, 2000, True),
    ],
)
def test_tables_23_and_24(
    number: int, hardware: tuple[int, int], acceleration: int, rate_of_turn: int, divide: bool
) -> None:
    supported = support(number, HardwareVersion(*hardware))
    assert supported.hardware == hardware
    assert (supported.rates["acceleration_hr"], supported.rates["rate_of_turn_hr"]) == (
        acceleration,
        rate_of_turn,
    )
    assert (len(supported.rates_of("acceleration_hr")) > 1) == divide
    assert (len(supported.rates_of("rate_of_turn_hr")) > 1) == divide
    assert supported.rates["acceleration"] == support(number).rates["acceleration"]


@pytest.mark.parametrize(
    ("number", "asked", "given"),
    [
        # The highest: as 0 and as FFFF.
        (630, (0x2010, 0), 400),
        (630, (0x2010, EVERY), 400),
        (630, (0x2010, 400), 400),
        # A supported rate, and rates between: the next lower one.
        (630, (0x2010, 100), 100),
        (630, (0x2010, 99), 80),
        (630, (0x2010, 3), 2),
        (630, (0x2010, 1), 1),
        # Above it.
        (630, (0x2010, 401), 400),
        (3, (0x2010, 400), 100),
        (630, (0x2010, 0xFFFE), 400),
        # With every message, whatever rate is requested.
        (630, (0x1020, 0), EVERY),
        (630, (0x1060, 400), EVERY),
        (630, (0xE020, EVERY), EVERY),
        (630, (0x4810, EVERY), EVERY),
        (680, (0x7010, 4), EVERY),
        # One rate.
        (710, (0x7010, 1), 4),
        (710, (0x7010, EVERY), 4),
        (30, (0x4040, 100), 1000),
        # Format bits stay.
        (630, (0x2016, 0), 400),
        (710, (0x3013, 100), 50),
        # Not on this product, or nowhere.
        (610, (0x2010, 100), None),
        (1, (0x3010, 50), None),
        (630, (0x5042, 100), None),
        (7, (0x7020, 4), None),
        (630, (0xE080, EVERY), None),
        (630, (0xC2A0, 100), None),
        (630, (0x0000, 0), None),
    ],
)
def test_acknowledged(number: int, asked: tuple[int, int], given: int | None) -> None:
    expected = None if given is None else Output(asked[0], given)
    assert support(number).acknowledged(Output(*asked)) == expected


def test_acknowledged_matches_real_devices() -> None:
    """The settings that an MTi-300 and an MTi-630 were seen to answer (FACTS 1.10)."""
    asked = (0x1060, 0x4020, 0x8020, 0x2030, 0xE020)
    found = [support(630).acknowledged(Output(item, 400)) for item in asked]
    assert found == [Output(item, EVERY if item in (0x1060, 0xE020) else 400) for item in asked]


def test_acknowledged_settings_are_stable() -> None:
    for number in ALL:
        supported = support(number)
        for name in supported.rates:
            for asked in (0, 1, 3, 7, 60, 100, 333, 5000, EVERY):
                given = supported.acknowledged(Output(QUANTITIES[name].id, asked))
                assert given is not None
                assert given.frequency in supported.rates_of(name)
                assert supported.acknowledged(given) == given


# ---------------------------------------------------------------------------------------------
# Option flags, synchronization, strings, baud rates
# ---------------------------------------------------------------------------------------------

#: Table 8. Two go beyond it: the vendor's code has the smoother on the MTi-7, and the settings of an MTi-680G
#: have the message at start-up.
TABLE_8 = {
    "DISABLE_AUTO_STORE": SERIES_1,
    "DISABLE_AUTO_MEASUREMENT": SERIES_1,
    "ENABLE_BEIDOU": (7, 670, 710),
    "ENABLE_AHS": SERIES_1 + SERIES_10 + SERIES_100,
    "ENABLE_ORIENTATION_SMOOTHER": (670, 680, 710, 7),
    "ENABLE_CONFIGURABLE_BUS_ID": SERIES_10 + SERIES_100 + SERIES_600,
    "ENABLE_IN_RUN_COMPASS_CALIBRATION": ALL,
    "ENABLE_CONFIG_MESSAGE_AT_STARTUP": SERIES_1 + SERIES_600,
    "ENABLE_COLD_FILTER_RESETS": (670, 680),
    "ENABLE_POSITION_VELOCITY_SMOOTHER": (680,),
    "ENABLE_CONTINUOUS_ZRU": (680,),
}


def test_table_8() -> None:
    for flag in OptionFlag:
        having = {item for item in ALL if flag in support(item).option_flags}
        assert having == set(TABLE_8.get(str(flag.name), ())), flag


F, L = SyncFunction, SyncLine
#: Functions with lines: Tables 11 and 12, with the vendor's code (FACTS 5.3) where their footnotes are lost.
SYNC: dict[tuple[int, ...], dict[int, tuple[int, ...]]] = {
    (1, 2, 3): {8: (2, 6)},
    (7,): {8: (2, 6), 9: (2, 1), 14: (8,)},
    (*SERIES_10, 100, 200, 300): {3: (2,), 4: (4,), 8: (2, 6), 9: (0,), 11: (2,)},
    (710,): {3: (2,), 4: (4,), 8: (2, 6), 9: (0, 1), 11: (2,), 14: (4,)},
    (610, 620, 630): {3: (2, 9), 4: (7,), 8: (2, 9, 6), 9: (2, 9), 11: (2, 9)},
    (670,): {3: (2, 9), 4: (7,), 8: (2, 9, 6), 9: (2, 9), 11: (2, 9), 14: (2, 9)},
    (680,): {3: (2, 9), 4: (7,), 8: (2, 9, 6), 9: (10,), 11: (2, 9), 14: (10,)},
}  # fmt: skip
#: Table 11 alone: the products with the function.
TABLE_11 = {
    3: set(ALL) - set(SERIES_1),
    4: set(ALL) - set(SERIES_1),
    8: set(ALL),
    9: set(ALL) - {1, 2, 3},
    11: set(ALL) - set(SERIES_1),
    14: set(GNSS),
}


def test_tables_11_and_12() -> None:
    for numbers, functions in SYNC.items():
        for number in numbers:
            found = {supported: set(lines) for supported, lines in support(number).sync.items()}
            assert found == {supported: set(lines) for supported, lines in functions.items()}, (
                number
            )
    assert {number for numbers in SYNC for number in numbers} == set(ALL)
    for function in SyncFunction:
        having = {item for item in ALL if function in support(item).sync}
        assert having == TABLE_11.get(function, set()), function


IMU_STRINGS = "PSONCMS HCMTW HEROT PTCF GPZDA"
VRU_STRINGS = f"{IMU_STRINGS} TSS2 PHTRO PRDID EM1000 HEHDT"
AHRS_STRINGS = f"{VRU_STRINGS} HCHDM HCHDG"
ALL_STRINGS = f"{AHRS_STRINGS} GPGGA XSVEL GPRMC"
#: FACTS 5.7.
STRINGS = {
    SERIES_1: "", (10, 100): IMU_STRINGS, (20, 200): VRU_STRINGS, (30, 300): AHRS_STRINGS,
    (710, *SERIES_600): ALL_STRINGS,
}  # fmt: skip


def test_strings() -> None:
    for numbers, text in STRINGS.items():
        for number in numbers:
            found = {str(string_type.name) for string_type in support(number).string_types}
            assert found == set(text.split()), number
    assert support(680).string_types == StringType(0x7FFF)
    # Products without strings do not have the message.
    for number in ALL:
        knows = "SetStringOutputType" in support(number).messages
        assert knows == bool(support(number).string_types)


def test_baud_rates() -> None:
    """Table 7. Section 7.2.1 has a maximum that Table 7 exceeds, which the older products keep."""
    every = sorted(set(BAUD_CODES.values()))
    for number in ALL:
        most = 921_600 if number in SERIES_10 + SERIES_100 else 4_000_000
        assert support(number).baudrates == tuple(item for item in every if item <= most)
        assert 115_200 in support(number).baudrates


# ---------------------------------------------------------------------------------------------
# Filter profiles
# ---------------------------------------------------------------------------------------------

#: Table 30. Real devices of the 10- and 100-series write small letters.
TABLE_30 = """
    39  20s,30s  General         50  1s  General          11  7    General
    40  20s,30s  High_mag_dep    51  1s  High_mag_dep     12  7    GeneralNoBaro
    41  20s,30s  Dynamic         52  1s  Dynamic          13  7    GeneralMag
    42  20s,30s  Low_mag_dep     53  1s  North_reference  01  710  General
    43  20s,30s  VRU_general     54  1s  VRU_general      02  710  GeneralNoBaro
    03  710  GeneralMag          04  710 Automotive       05  710  HighPerformanceEDR
"""


def test_table_30() -> None:
    words = TABLE_30.split()
    table = {int(profile): words[at + 2] for at, profile in enumerate(words) if at % 3 == 0}
    assert len(table) == 18
    numbers = {
        3: range(50, 55), 30: range(39, 44), 300: range(39, 44), 7: (11, 12, 13), 710: range(1, 6),
        # A VRU does not support the others, whose heading is magnetic.
        2: (54,), 20: (43,), 200: (43,),
    }  # fmt: skip
    for product, profiles in numbers.items():
        found = {
            filter_profile.type: filter_profile.label.lower()
            for filter_profile in support(product).filter_profiles
        }
        assert found == {profile: table[profile].lower() for profile in profiles}


def test_600_series_profiles() -> None:
    """Of the 600-series: a base, and on the VRU and AHRS a heading (kinds 195 and 197, FACTS 2.29)."""
    labels = {
        number: [
            (filter_profile.type, filter_profile.label)
            for filter_profile in support(number).filter_profiles
        ]
        for number in SERIES_600
    }
    base = [(195, "Responsive"), (195, "Robust")]
    vru = [*base, (197, "VRU"), (197, "VRUAHS")]
    assert labels == {
        610: [],
        620: vru,
        630: [*vru, (197, "NorthReference"), (197, "FixedMagRef")],
        670: [(195, "General"), (195, "GeneralNoBaro"), (195, "GeneralMag")],
        680: [(195, "General_RTK"), (195, "GeneralNoBaro_RTK"), (195, "GeneralMag_RTK")],
    }


def test_profiles_match_a_real_device() -> None:
    """The AvailableFilterProfiles of an MTi-300."""
    for line in shared("spec/frames.txt").read_text(encoding="utf-8").splitlines():
        if line.startswith("FA FF 63 "):
            payload = bytes.fromhex(line.partition("#")[0])[4:-1]
            assert decode("AvailableFilterProfiles", payload) == support(300).filter_profiles


@pytest.mark.parametrize("number", ALL)
def test_profiles_can_be_encoded(number: int) -> None:
    supported = support(number)
    assert bool(supported.filter_profiles) == (number not in IMU)
    if not supported.filter_profiles:
        assert supported.filter_profile is None
        return
    payload = encode("AvailableFilterProfiles", supported.filter_profiles)
    assert decode("AvailableFilterProfiles", payload) == supported.filter_profiles
    if isinstance(supported.filter_profile, str):
        assert "SetFilterProfileModern" in supported.messages
        labels = {row.label for row in supported.filter_profiles}
        assert set(supported.filter_profile.split("/")) <= labels
        assert decode(
            "SetFilterProfileModern", encode("SetFilterProfileModern", supported.filter_profile)
        )
    else:
        assert "SetFilterProfile" in supported.messages
        assert supported.filter_profile in {row.type for row in supported.filter_profiles}


# ---------------------------------------------------------------------------------------------
# Factory settings
# ---------------------------------------------------------------------------------------------

FIRST, LAST = "1020 FFFF 1060 FFFF", "E020 FFFF"
#: Table 2: the output configuration, as a payload. The counter and the time are first, as MT Manager
#: writes them.
TABLE_2 = {
    IMU: f"{FIRST} 8030 0064 4010 0064 C020 0064 {LAST}",
    (2, 20, 200, 620, 3, 30, 300, 630): f"{FIRST} 2010 0064 {LAST}",
    GNSS: f"{FIRST} 2010 0064 5022 0064 5042 0064 D012 0064 {LAST}",
}
#: Table 2: the setting profile.
PROFILE = {
    2: 54, 20: 43, 200: 43, 620: "Responsive/VRU", 3: 50, 30: 39, 300: 39,
    630: "Responsive/NorthReference", 7: 11, 710: 1, 670: "General", 680: "General_RTK",
}  # fmt: skip


def test_table_2_outputs() -> None:
    for numbers, payload in TABLE_2.items():
        for number in numbers:
            supported = support(number)
            assert encode(
                "SetOutputConfiguration", supported.output_configuration
            ) == bytes.fromhex(payload)
            assert (
                tuple(supported.acknowledged(row) for row in supported.output_configuration)
                == supported.output_configuration
            )
    assert {number for numbers in TABLE_2 for number in numbers} == set(ALL)


def test_table_2_profiles() -> None:
    assert {item: support(item).filter_profile for item in ALL} == {
        item: PROFILE.get(item) for item in ALL
    }


def test_tables_2_and_41_synchronization() -> None:
    """Disabled, except that products with a receiver synchronize to its clock on their line."""
    for number in ALL:
        supported = support(number)
        if number not in GNSS:
            assert supported.sync_settings == ()
            continue
        (setting,) = supported.sync_settings
        assert (setting.function, setting.polarity) == (F.CLOCK_BIAS_ESTIMATION, Polarity.RISING)
        assert setting.line in supported.sync[F.CLOCK_BIAS_ESTIMATION]
    published = {7: (L.GNSS_CLOCK_IN, 1000), 710: (L.GNSS_CLOCK_IN, 250), 680: (L.IN3, 1000)}
    for number, (line, period) in published.items():
        expected = SyncSetting(F.CLOCK_BIAS_ESTIMATION, line, offset=period)
        assert support(number).sync_settings == (expected,)


@pytest.mark.parametrize("number", ALL)
def test_identities_match_the_product(number: int) -> None:
    """Identifiers have the layout of FACTS 6, and codes identify the product."""
    supported = support(number)
    identity, series = supported.identity, supported.product.series
    assert product_of_code(identity.product_code) is supported.product
    for name, value in [
        ("DeviceID", identity.device_id),
        ("ProductCode", identity.product_code),
        ("FirmwareRev", identity.firmware),
        ("HardwareVersion", identity.hardware),
    ]:
        assert decode(name, encode(name, value)) == value
    assert len(encode("DeviceID", identity.device_id)) == supported.product.id_size
    if series == "600-series":
        assert identity.device_id >> 31 == 1
    else:
        family = {"1-series": 8, "10-series": 6, "100-series": 7}[series]
        kind = {"IMU": 1, "VRU": 2, "AHRS": 3, "GNSS/INS": 7}[supported.product.kind]
        assert (identity.device_id >> 20 & 0xF, identity.device_id >> 24) == (family, kind)
        # From 1000 on it is a 710, below it was a 700 (FACTS 6.1).
        assert number != 710 or identity.device_id & 0xFFFF >= 1000
    # High rates are those of the manual.
    assert support(number, identity.hardware).rates == supported.rates
