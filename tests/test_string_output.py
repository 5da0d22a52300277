"""String outputs of devices: configured, sent by virtual devices, read live and recorded."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import streams
import xbus
from test_cli import run, sentence
from xbus import (
    Device,
    DeviceError,
    SimulatedDevice,
    StateError,
    StringType,
    XbusTimeout,
    connect,
)
from xbus.device.string_output import frequency_of, period_and_skip_factor, plan_strings
from xbus.protocol import State, StringOutput
from xbus.protocol.products import find_product, support
from xbus.protocol.strings import STRING_FIELDS
from xbus.protocol.tables import PRODUCTS
from xbus.sim import Replay, serving
from xbus.sim.link import SimLink
from xbus.sim.sensors import Sensors, Ticks
from xbus.sim.trajectories import trajectory

#: The products that have strings: all but the 1-series.
WITH_STRINGS = [number for number, product in PRODUCTS.items() if support(product).string_types]
EM1000 = bytes.fromhex("00 90 7B 00 38 FE 00 00 39 30")


def sending(product: str | int, strings: Any, rate: float | None, **options: Any) -> Device:
    """Returns a device that sends strings."""
    device = connect(SimulatedDevice(product, **options))
    with device.configure():
        device.set_strings(strings, rate, check_baudrate=False)
    return device


# ---------------------------------------------------------------------------------------------
# Period and skip factor (Tables 18 and 19)
# ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("frequency", "period", "skip_factor"),
    [
        (100, 1152, 0),  # the default
        (512, 225, 0),  # the shortest period
        (50, 1152, 1),  # the manual's examples
        (75, 768, 1),
        (40, 960, 2),
        (200, 576, 0),
        (60, 960, 1),
        (1, 1152, 99),
        (0.5, 1152, 199),
        (115200 / 1151, 1151, 0),
        (33.3333333333, 1152, 2),
        (100 / 65535, 1152, 65534),
    ],
)
def test_rates_of_period_and_skip_factor(frequency: float, period: int, skip_factor: int) -> None:
    assert period_and_skip_factor(frequency) == (period, skip_factor)
    assert frequency_of(period, skip_factor) == pytest.approx(frequency)


def test_every_pair_gives_a_rate_that_can_be_requested() -> None:
    for period in range(225, 1153, 7):
        for skip_factor in (0, 1, 2, 9, 100, 65534):
            rate = frequency_of(period, skip_factor)
            assert rate is not None
            found = period_and_skip_factor(rate)
            assert frequency_of(*found) == pytest.approx(rate)
            assert found[1] <= skip_factor
    assert frequency_of(1152, 65535) is None


@pytest.mark.parametrize(
    ("frequency", "problem"),
    [
        (0, "the rate must be from 0.0015 to 512 Hz, not 0 Hz"),
        (-1, "not -1 Hz"),
        (513, "0.0015 to 512 Hz, not 513 Hz"),
        (0.001, "not 0.001 Hz"),
        (511, "no period and skip factor give 511 Hz; the nearest are 509.735 and 512 Hz"),
        (101, "no period and skip factor give 101 Hz; the nearest are 100.964 and 101.053 Hz"),
        (float("nan"), "not nan Hz"),
    ],
)
def test_impossible_rates_are_rejected(frequency: float, problem: str) -> None:
    with pytest.raises(ValueError, match=r"^[^\n]*$") as caught:
        period_and_skip_factor(frequency)
    assert problem in str(caught.value)


@pytest.mark.parametrize(
    ("product", "strings", "rate", "messages"),
    [
        (30, ["HEHDT"], 50, [
            ("SetPeriod", 1152), ("SetOutputSkipFactor", 1),
            ("SetStringOutputType", StringOutput(StringType.HEHDT)),
        ]),
        (710, StringType.GPGGA | StringType.GPRMC, None, [
            ("SetOutputSkipFactor", 0xFFFF),
            ("SetStringOutputType", StringOutput(StringType.GPGGA | StringType.GPRMC)),
        ]),
        (630, ["HEHDT", StringType.HEROT], 10, [
            ("SetStringOutputType", StringOutput(StringType.HEHDT | StringType.HEROT, 10)),
        ]),
        (300, [], None, [("SetStringOutputType", StringOutput(StringType(0)))]),
        (680, [], None, [("SetStringOutputType", StringOutput(StringType(0), 0))]),
    ],
)  # fmt: skip
def test_string_settings(product: int, strings: Any, rate: Any, messages: Any) -> None:
    assert plan_strings(strings, rate, support(PRODUCTS[product])).messages == messages


@pytest.mark.parametrize(
    ("product", "strings", "rate", "problem"),
    [
        ("MTi-3", ["HEHDT"], 10, "the MTi-3 has no string HEHDT; it has none"),
        ("MTi-10", ["HEHDT"], 10, "the MTi-10 has no string HEHDT; it has PSONCMS"),
        ("MTi-30", ["NMEA"], 10, "no string is called 'NMEA'; there are HCHDM, "),
        ("MTi-30", ["HEHDT"], 101, "no period and skip factor give 101 Hz"),
        ("MTi-30", [], 10, "a rate of 10 Hz needs at least one string"),
        ("MTi-630", ["HEHDT"], None,
         "the MTi-630 does not send strings on request; give a rate from 1 to 400 Hz"),
        ("MTi-630", ["HEHDT"], 0.5, "at a whole number of Hz from 1 to 400, not at 0.5 Hz"),
        ("MTi-630", ["HEHDT"], 401, "not at 401 Hz"),
        ("MTi-630", ["HEHDT"], float("inf"), "not at inf Hz"),
        ("MTi-630", ["HEHDT"], float("nan"), "not at nan Hz"),
        ("MTi-300", ["PSONCMS"], 200, "these strings make about 26,400 bytes per second, and 115,200 baud"
         " carry 11,520; use at least 460,800 baud"),
    ],
)  # fmt: skip
def test_impossible_string_settings_are_rejected(
    product: str, strings: Any, rate: Any, problem: str
) -> None:
    """The error is one sentence, and no setting is sent."""
    virtual = SimulatedDevice(product)
    before = virtual.settings
    device = connect(virtual)
    with device.configure(), pytest.raises((ValueError, StateError), match=r"^[^\n]*$") as caught:
        device.set_strings(strings, rate)
    assert problem in str(caught.value)
    assert virtual.settings == before


def test_a_single_name_is_not_a_list() -> None:
    with pytest.raises(TypeError, match=r"\['HEHDT'\]"):
        connect("sim:MTi-30", strings="HEHDT")
    with pytest.raises(ValueError, match="no string is called 'X'"):
        xbus.read_log(b"", strings=["X"])


# ---------------------------------------------------------------------------------------------
# Virtual devices
# ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("product", WITH_STRINGS)
def test_every_string_of_every_product(product: int) -> None:
    """All strings at once cause no damage; afterwards the device returns to samples."""
    types = support(PRODUCTS[product]).string_types
    device = sending(product, types, 10, time_to_fix=0.0, noise=1.0)
    assert device.state == State.MEASUREMENT
    strings = [device.read_string() for _ in range(20 * len(types))]
    assert [string.type for string in strings] == list(types) * 20
    for string in strings:
        assert string.type is not None
        assert len(string.data) <= STRING_FIELDS[string.type].length
        assert string.values.keys() == string.units.keys()
        assert string.arrival is not None
    assert device.session.skipped == device.stats.skipped_bytes == 0
    assert set(device.stats.strings) == {str(kind.name) for kind in types}
    assert device.stats.unread_samples == 0
    with device.configure() as cfg:
        cfg.set_output_configuration({"packet_counter": None, "acceleration": 100})
        assert not cfg.commands.req_string_output_type().types
    assert list(device.read_sample()) == ["packet_counter", "acceleration"]


@pytest.mark.parametrize("rate", [1, 2.5, 100, 400, 115200 / 227])
def test_strings_are_sent_at_their_rate(rate: float) -> None:
    device = sending("MTi-300", ["GPZDA"], rate)
    device.read_string()
    moments = [device.read_string().values["time"] for _ in range(50)]
    seconds = np.array(
        [moment.minute * 60 + moment.second + moment.microsecond / 1e6 for moment in moments]
    )
    assert np.diff(seconds).mean() == pytest.approx(1 / rate, abs=0.01 / 49)
    assert abs(np.diff(seconds) - 1 / rate).max() < 0.0101


@pytest.mark.parametrize("motion", ["tumble", "drive", "sail", "turn"])
def test_strings_match_the_samples(motion: str) -> None:
    """Strings and samples describe the same trajectory at the same instants."""
    product = find_product("MTi-680G")
    sensors = Sensors(trajectory(motion), product)
    device = sending(
        "MTi-680G", support(product).string_types, 10, trajectory=motion, time_to_fix=0.0
    )
    rounds = [[device.read_string() for _ in range(15)] for _ in range(40)]
    for strings in rounds:
        by_type = {string.type: string.values for string in strings}
        moment = by_type[StringType.GPZDA]["time"]
        tick = round((moment.second + moment.microsecond / 1e6) * 10)
        ticks = Ticks(tick, 1, 10)

        def read(name: str, ticks: Ticks = ticks) -> Any:
            return np.asarray(sensors.read(name, ticks), float).reshape(-1)

        q0, q1, q2, q3 = read("quaternion")
        bow = [
            q0 * q0 + q1 * q1 - q2 * q2 - q3 * q3,
            2 * (q1 * q2 + q0 * q3),
            2 * (q1 * q3 - q0 * q2),
        ]
        port_up = 2 * (q2 * q3 + q0 * q1)
        up_up = q0 * q0 - q1 * q1 - q2 * q2 + q3 * q3
        heading = np.degrees(np.arctan2(bow[0], bow[1])) % 360
        pitch, roll = np.degrees(np.arcsin(bow[2])), np.degrees(np.arctan2(port_up, up_up))

        for kind in ("HCHDM", "HCHDG", "TSS2", "PRDID", "EM1000", "HEHDT", "PTCF"):
            off = (by_type[StringType[kind]]["heading"] - heading + 180) % 360 - 180
            assert abs(off) < 0.051, kind
        for kind in ("PHTRO", "PRDID", "EM1000", "PTCF"):
            assert by_type[StringType[kind]]["pitch"] == pytest.approx(pitch, abs=0.051), kind
            assert by_type[StringType[kind]]["roll"] == pytest.approx(roll, abs=0.051), kind
        # The mask of TSS2 has four digits.
        assert by_type[StringType.TSS2]["roll"] == pytest.approx(
            np.clip(roll, -99.99, 99.99), abs=0.006
        )
        psoncms = by_type[StringType.PSONCMS]
        for name in ("quaternion", "acceleration", "rate_of_turn", "magnetic_field", "temperature"):
            values = [value for key, value in psoncms.items() if key.startswith(name)]
            assert values == pytest.approx(
                read(name).tolist(), abs=0.051 if len(values) == 1 else 6e-5
            )
        x, y, z = np.degrees(read("rate_of_turn"))
        assert by_type[StringType.HEROT]["rate_of_turn"] == pytest.approx(-60 * z, abs=0.051)
        assert by_type[StringType.PTCF]["roll_rate"] == pytest.approx(x, abs=0.051)
        assert by_type[StringType.PTCF]["pitch_rate"] == pytest.approx(-y, abs=0.051)
        velocity = read("velocity_xyz")
        assert list(by_type[StringType.XSVEL].values()) == pytest.approx(
            velocity.tolist(), abs=6e-5
        )
        lat, lon = read("lat_lon")
        for kind, digits in (("GPGGA", 4), ("GPRMC", 2)):
            place = by_type[StringType[kind]]
            assert (place["lat"], place["lon"]) == pytest.approx(
                (lat, lon), abs=0.51 * 10**-digits / 60
            )
        pvt = dict(zip((field.name for field in xbus.protocol.tables.QUANTITIES["gnss_pvt_data"].fields),
                       read("gnss_pvt_data"), strict=True))  # fmt: skip
        gga, rmc = by_type[StringType.GPGGA], by_type[StringType.GPRMC]
        assert gga["height_msl"] == pytest.approx(pvt["hMSL"] / 1000, abs=0.051)
        assert gga["satellites"] == pvt["numSV"]
        assert (gga["quality"], rmc["status"]) == (1, "A")
        assert rmc["speed"] == pytest.approx(pvt["gSpeed"] / 1000 / (1852 / 3600), abs=0.06)
        if pvt["gSpeed"] > 210:
            off = (rmc["course"] - pvt["headMot"] / 1e5 + 180) % 360 - 180
            assert abs(off) < 0.1
        elif pvt["gSpeed"] < 190:
            assert rmc["course"] is None
        assert (rmc["date"], rmc["time"]) == (
            by_type[StringType.GPZDA]["date"],
            moment.replace(microsecond=0),
        )


def test_no_position_before_the_first_fix() -> None:
    device = sending("MTi-680G", ["GPGGA", "GPRMC"], 10, time_to_fix=2.0)
    pairs = [(device.read_string(), device.read_string()) for _ in range(40)]
    valid = [bool(gga.valid) for gga, _ in pairs]
    assert valid == [rmc.valid for _, rmc in pairs] == sorted(valid)
    assert set(valid) == {False, True}
    for gga, rmc in pairs:
        assert (gga.values["lat"] is None) == (rmc.values["lat"] is None) == (not gga.valid)


def test_time_steps_do_not_change_the_strings() -> None:
    def sent(steps: list[float]) -> bytes:
        device = SimulatedDevice("MTi-300", noise=1.0, trajectory="tumble")
        connected = connect(device)
        with connected.configure():
            connected.set_strings(["PSONCMS", "EM1000"], 115200 / 1151, check_baudrate=False)
        device.read()
        data = b""
        for step in steps:
            device.advance(step)
            data += device.read()
        return data

    once = sent([3.0])
    assert len(once) > 30_000
    assert sent([0.001] * 3000) == sent([0.7, 0.05, 1.25, 1.0]) == once


@pytest.mark.parametrize("product", ["MTi-30", "MTi-710"])
def test_strings_on_demand(product: str) -> None:
    """Skip factor FFFF, and ReqData (Table 19)."""
    device = sending(product, ["HCMTW", "GPZDA"], None)
    with pytest.raises(XbusTimeout, match=r"no string from sim:MTi-.* within 3 s"):
        device.read_string(3.0)
    first = device.link.clock()
    for _ in range(5):
        device.commands.req_data()
        assert device.read_string().type is StringType.HCMTW
        clock = device.read_string()
        assert device.link.clock() - first < 1.0
    assert clock.type is StringType.GPZDA
    with pytest.raises(XbusTimeout, match=r"no string from sim:MTi-.* within 1 s"):
        device.read_string(1.0)


# ---------------------------------------------------------------------------------------------
# Live
# ---------------------------------------------------------------------------------------------


def test_a_device_that_sends_strings_is_detected() -> None:
    """The strings identify the device, without a byte from the host."""
    virtual = SimulatedDevice("MTi-30")
    device = connect(virtual)
    with device.configure():
        device.set_strings(["HEHDT"], 50)
    virtual.power_cycle()
    virtual.advance(1.0)
    written: list[bytes] = []
    virtual.write = lambda data, *_: written.append(data)  # type: ignore[method-assign]
    again = connect(virtual)
    assert (again.state, written) == (State.MEASUREMENT, [])
    assert again.read_string().type is StringType.HEHDT


def test_em1000_is_enabled_by_the_device_or_the_caller() -> None:
    virtual = SimulatedDevice("MTi-300")
    device = connect(virtual)
    with device.configure():
        device.commands.set_string_output_type(StringType.EM1000)  # the setting is read back
    assert device.read_string().type is StringType.EM1000
    assert device.stats.skipped_bytes == 0
    assert connect(virtual, strings=["EM1000"]).read_string().type is StringType.EM1000
    unaware = connect(virtual)
    with pytest.raises(XbusTimeout, match=r"no string from sim:MTi-300 within 0\.5 s"):
        unaware.read_string(0.5)
    assert unaware.stats.skipped_bytes > 400  # even if nothing follows
    with unaware.configure() as cfg:
        cfg.commands.req_string_output_type()
    assert unaware.read_string().type is StringType.EM1000
    with unaware.configure() as cfg:
        cfg.set_strings([])
    assert not unaware.session.receive(EM1000 * 2 + xbus.encode_frame(0x3E))[0:-1]


def test_waiting_for_the_wrong_kind_of_output_raises() -> None:
    device = sending("MTi-300", ["HEHDT"], 10)
    with pytest.raises(XbusTimeout, match=r"sends strings, which read_string\(\) returns"):
        device.read_sample(0.5)
    with pytest.raises(XbusTimeout, match=r"no string from sim:MTi-3 within 0\.5 s"):
        connect("sim:MTi-3").read_string(0.5)
    with device.configure():
        for _ in range(device.link.acquisition.waiting.strings):
            device.read_string()
        with pytest.raises(StateError, match="the device is in Config State"):
            device.read_string()


def test_unread_strings_are_counted() -> None:
    """The oldest are dropped, and counted."""
    virtual = SimulatedDevice("MTi-300")
    with Device(SimLink(virtual, bound=1600)) as device:
        with device.configure() as cfg:
            cfg.set_strings(["GPZDA"], 100, check_baudrate=False)
        first = device.read_string()
        device.listen(5.0)
        sent, stats = device.stats.strings["GPZDA"], device.stats
        waiting = device.link.acquisition.waiting.strings
        assert waiting == 1600 // len(first.data) > 1
        assert stats.queued_bytes == waiting * len(first.data)
        assert stats.dropped_strings == sent - 1 - waiting > 400
        assert (stats.dropped_samples, stats.dropped_messages) == (0, 0)
        times = [first.values["time"], device.read_string().values["time"]]
        start, end = [
            time.hour * 3600 + time.minute * 60 + time.second + time.microsecond / 1e6
            for time in times
        ]
        assert end - start == pytest.approx((1 + stats.dropped_strings) / 100, abs=0.011)


def mixed(seconds: float) -> bytes:
    """A stream at 400 Hz, with a string after each sample."""
    pieces = []
    for i in range(round(400 * seconds)):
        pieces.append(xbus.encode_sample({"packet_counter": i % 65536, "sample_time_fine": 25 * i}))
        pieces.append(xbus.encode_string("HEHDT", {"heading": i % 36000 / 100}))
    return b"".join(pieces)


@pytest.mark.skipif(os.name != "posix", reason="needs pseudo-terminals")
@pytest.mark.parametrize("how", ["samples", "seconds"])
def test_a_mixed_stream_live_loses_nothing(how: str) -> None:
    """Blocks contain samples and strings in order, at 400 Hz over a pseudo-terminal."""
    data = mixed(3.0)
    virtual = SimulatedDevice("MTi-630", replay=Replay(data))
    with serving(virtual) as port, connect(port) as device:
        blocks = device.blocks(samples=100) if how == "samples" else device.blocks(seconds=0.2)
        found: list[xbus.Log] = []
        while sum(len(block) for block in found) < 1100:
            found.append(next(blocks))
        joined = [string.values["heading"] for block in found for string in block.strings]
        counters = np.concatenate([block.packet_counter for block in found])
        assert np.diff(counters).tolist() == [1] * (len(counters) - 1)
        first = round(joined[0] * 100)
        assert joined == [i / 100 for i in range(first, first + len(joined))]
        samples = [string.sample for block in found for string in block.strings]
        # Each string follows its sample.
        assert samples == [
            counters[0] * 0 + i + 1 + first - counters[0] for i in range(len(samples))
        ]
        stats = device.stats
        assert stats.skipped_bytes == stats.lost_samples == 0
        assert stats.rates["HEHDT"] == pytest.approx(stats.rates["packet_counter"], rel=0.1)


def test_samples_and_strings_are_read_by_separate_calls() -> None:
    device = connect(SimulatedDevice("MTi-630", replay=Replay(mixed(1.0))))
    for _ in range(50):
        sample = device.read_sample()
    strings = [device.read_string() for _ in range(49)]
    assert sample["packet_counter"] >= 49
    assert np.diff([string.offset for string in strings]).tolist() == [37] * 48
    assert all((string.arrival or -1) >= 0 for string in strings)


def test_recordings_contain_strings(tmp_path: Path) -> None:
    """EM1000 is found without an option, because the recording contains the setting."""
    virtual = SimulatedDevice("MTi-300", noise=1.0)
    device = connect(virtual)
    with device.configure():
        device.set_strings(["EM1000", "PSONCMS"], 50, check_baudrate=False)
    path = tmp_path / "strings.mtb"
    with device.record(path):
        live = [device.read_string() for _ in range(200)]
    log = xbus.read_log(path, strict=True)
    recorded = [string.data for string in log.strings]
    first = recorded.index(live[10].data)
    assert recorded[first : first + 190] == [string.data for string in live[10:]]
    assert log.stats.skipped_bytes == 0
    times = log.strings.host_time
    assert np.isfinite(times).all()
    assert (np.diff(times) >= 0).all()
    again = Replay(path)
    assert len(again) == len(log.strings)  # sent without a request
    assert connect(SimulatedDevice("MTi-300", replay=again), strings=["EM1000"]).read_string()


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mixed.mtb").write_bytes(mixed(0.5) + streams.sentence("GPGSV,1") + EM1000)
    return tmp_path


@pytest.mark.usefixtures("folder")
def test_info_and_dump_report_strings() -> None:
    page = run("info", "mixed.mtb").stdout
    assert "HEHDT 200, others 1" in page
    assert "10 bytes of damage in 1 place" in page
    page = run("info", "--string", "EM1000", "mixed.mtb").stdout
    assert "EM1000 1, HEHDT 200, others 1" in page
    assert page[page.index("damage") :].splitlines()[0] == "damage    no damage"
    assert json.loads(run("info", "--json", "mixed.mtb").stdout)[0]["strings"] == {
        "HEHDT": 200,
        "others": 1,
    }
    lines = run("dump", "--no-hex", "mixed.mtb", "--string", "EM1000").stdout.splitlines()
    assert lines[1].split()[1:] == ["HEHDT", "$HEHDT,000.00,T*1F"]
    assert lines[-2].split()[1] == "GPGSV"
    assert lines[-1].split()[1:3] == ["EM1000", "00"]
    document = json.loads(run("dump", "--json", "mixed.mtb").stdout.splitlines()[1])
    assert document == {
        "offset": 17, "string": "HEHDT", "text": "$HEHDT,000.00,T*1F",
        "bytes": b"$HEHDT,000.00,T*1F\r\n".hex().upper(),
    }  # fmt: skip
    assert "HEHDT" not in run("dump", "--mid", "MTData2", "mixed.mtb").stdout
    failed = run("info", "--string", "HEHDT", "mixed.mtb")
    assert (failed.exit_code, "HEHDT is always parsed" in failed.stderr) == (2, True)
    failed = run("info", "--string", "NMEA", "mixed.mtb")
    assert failed.exit_code == 2
    assert "no string is called 'NMEA'; choose from HCHDM, " in failed.stderr


@pytest.mark.parametrize("suffix", [".parquet", ".csv", ".npz"])
def test_decode_writes_one_string_type(folder: Path, suffix: str) -> None:
    pq = pytest.importorskip("pyarrow.parquet")
    pc = pytest.importorskip("pyarrow.csv")
    result = run("decode", "mixed.mtb", "--quantity", "HEHDT", "-o", f"out{suffix}")
    assert result.exit_code == 0, result.stderr
    out = str(folder / f"out{suffix}")
    if suffix == ".npz":
        heading = np.load(out)["HEHDT"]["heading"]
    else:
        table = pq.read_table(out) if suffix == ".parquet" else pc.read_csv(out)
        heading = table["heading"].to_numpy()
    assert heading.tolist() == [i / 100 for i in range(200)]
    missing = run("decode", "mixed.mtb", "--quantity", "GPGGA", "-o", f"none{suffix}")
    assert (missing.exit_code, "no GPGGA in mixed.mtb" in missing.stderr) == (1, True)
    document = json.loads(
        run("decode", "mixed.mtb", "--quantity", "HEHDT", "-o", out, "--json").stdout
    )
    assert (document["rows"], document["columns"], document["strings"]) == (200, 5, 201)


@pytest.mark.usefixtures("folder")
def test_npz_contains_the_requested_quantities() -> None:
    for key, names in (
        ("HEHDT", {"HEHDT"}),
        ("packet_counter", {"time", "packet_counter.unwrapped", "packet_counter", "packet_counter.sample",
                            "packet_counter.time"}),
    ):  # fmt: skip
        assert run("decode", "mixed.mtb", "--quantity", key, "-o", "x.npz").exit_code == 0
        assert set(np.load("x.npz")) == names
    assert run("decode", "mixed.mtb", "-o", "x.npz").exit_code == 0
    assert "HEHDT" in np.load("x.npz")


@pytest.mark.usefixtures("folder")
def test_a_log_of_strings_only() -> None:
    Path("nmea.txt").write_bytes(b"$HEHDT,123.45,T*1E\n" * 3)
    assert "HEHDT 3" in run("info", "nmea.txt").stdout
    assert run("dump", "nmea.txt").stdout.count("HEHDT") == 6
    assert run("decode", "nmea.txt", "--quantity", "HEHDT", "-o", "x.npz").exit_code == 0
    assert np.load("x.npz")["HEHDT"]["heading"].tolist() == [123.45] * 3
    for out in ("x.parquet", "x.mcap", "folder/"):
        assert sentence(run("decode", "nmea.txt", "-o", out)) == (
            "nmea.txt has no samples, only strings: HEHDT; write them to .nmea, or those of one type to "
            "a table with --quantity"
        )
    pytest.importorskip("plotly")
    assert run("report", "nmea.txt", "-o", "x.html").exit_code == 0
    page = Path("x.html").read_text("utf-8")
    assert "no samples, only strings" in page
    assert "HEHDT (string)" in page


def test_the_monitor_shows_strings(behind: Callable[[SimulatedDevice], str], folder: Path) -> None:
    virtual = SimulatedDevice("MTi-300")
    with connect(virtual) as device, device.configure():
        device.set_strings(["HCMTW", "EM1000"], 50)
    lines = run("monitor", behind(virtual), "--once", "3", "--string", "EM1000").stdout.splitlines()
    found = {
        line.split()[0]: line.split()[1:] for line in lines if line.startswith(("HCMTW", "EM1000"))
    }
    assert found["HCMTW"] == ["50.0", "$HCMTW,25.1,C*1E"]
    assert found["EM1000"][:3] == ["50.0", "00", "90"]
    page = run("monitor", "mixed.mtb", "--once", "1").stdout
    assert "other strings" in page
    assert "$GPGSV,1*" in page


@pytest.mark.parametrize("strings", [["EM1000"], ["HEHDT", "GPZDA"]])
def test_rotated_files_end_with_whole_strings(tmp_path: Path, strings: list[str]) -> None:
    device = sending("MTi-300", strings, 100)
    with device.record(tmp_path / "log.mtb", rotate_bytes=3000) as recording:
        while len(recording.files) < 4:
            device.read_string()
    logs = [xbus.read_log(file, strict=True, strings=strings) for file in recording.files]
    assert all(log.stats.strings > 20 for log in logs[:-1])
    assert recording.frames == sum(log.stats.messages for log in logs) - 2 * len(logs) - (
        len(logs) if strings == ["EM1000"] else 0
    )
    assert device.stats.skipped_bytes == 0


def test_each_file_begins_with_the_enabled_strings(tmp_path: Path) -> None:
    """Strings that are enabled during the recording are included."""
    device = sending("MTi-300", ["HEHDT"], 100)
    with device.record(tmp_path / "log.mtb", rotate_bytes=4000) as recording:
        for _ in range(150):
            device.read_string()
        with device.configure():
            device.set_strings(["EM1000"], 100)
        for _ in range(1500):
            device.read_string()
        with device.configure():
            device.set_strings(["HEHDT"], 100)
        for _ in range(500):
            device.read_string()
    logs = [xbus.read_log(file) for file in recording.files]
    assert [log.stats.skipped_bytes for log in logs] == [0] * len(logs)
    assert [sum(log.strings.counts.get(name, 0) for log in logs) >= least for name, least in (
        ("EM1000", 1500), ("HEHDT", 600))] == [True, True]  # fmt: skip


def test_firmware_without_strings_is_recorded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    device = connect("sim:MTi-300")
    command = device._channel.command

    def old(name: str, value: Any) -> Any:
        if name == "ReqStringOutputType":
            raise DeviceError("the device answered with Error 4", 4, name)
        return command(name, value)

    monkeypatch.setattr(device._channel, "command", old)
    with device.record(tmp_path / "log.mtb"):
        device.read_sample()
    with device.configure({"acceleration": 100}):
        pass
    assert "acceleration" in device.read_sample()


def test_the_command_records_strings(
    tmp_path: Path, behind: Callable[[SimulatedDevice], str]
) -> None:
    virtual = SimulatedDevice("MTi-300")
    with connect(virtual) as device, device.configure():
        device.set_strings(["HEHDT"], 50)
    path = tmp_path / "log.mtb"
    result = run("record", behind(virtual), "-o", str(path), "--duration", "4")
    assert result.exit_code == 0, result.stderr
    count = xbus.read_log(path).stats.strings
    assert f"4.0 s, 0 samples, {count} strings, " in result.stderr
    assert count == pytest.approx(200, abs=2)
