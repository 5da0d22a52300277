"""Measurements and messages of a virtual device: the encoder, the sensors, and the times of messages."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

import xbus
from xbus import _core
from xbus.geometry import earth, quaternion
from xbus.protocol.ids import Coordinates, DataId, Precision
from xbus.protocol.tables import PRODUCTS, QUANTITIES, Quantity
from xbus.sim.motion import SampledTrajectory
from xbus.sim.sensors import Sensors, Ticks
from xbus.sim.stream import Stream
from xbus.sim.trajectories import trajectory

Array = npt.NDArray[Any]
EVERY = 0xFFFF
U32, DAY = 2**32, 864_000_000

COUNTER, FINE, COARSE = DataId.PacketCounter, DataId.SampleTimeFine, DataId.SampleTimeCoarse
STAMPS = [(COUNTER, EVERY), (FINE, EVERY)]
STATUS = (DataId.StatusWord, EVERY)


NAMES = {quantity.id: quantity.name for quantity in QUANTITIES.values()}


def make(
    product: int, outputs: Sequence[tuple[int, int]], path: str = "walk", **options: Any
) -> Stream:
    """Returns the stream of a product, with options of the sensors and of the stream."""
    kinds = ("noise", "seed", "rot_sensor", "rot_local", "utc", "time_to_fix", "rtk")
    chosen = {key: options.pop(key) for key in kinds if key in options}
    sensors = Sensors(trajectory(path), PRODUCTS[product], **chosen)
    series = PRODUCTS[product].series
    defaults = {
        "base_rate": 100 if series == "1-series" else 400,
        "fine_wrap": PRODUCTS[product].fine_wrap,
        "synchronous_hr": series in ("10-series", "100-series"),
    }
    return Stream(outputs, sensors=sensors, **{**defaults, **options})


def log_of(stream: Stream, seconds: float, status: int = 0) -> xbus.Log:
    log = xbus.read_log(b"".join(frame for _, frame in stream.take(seconds, status)))
    assert (log.stats.skipped_bytes, log.stats.malformed, len(log.unknown)) == (0, 0, 0)
    return log


def names(frame: bytes) -> list[str | None]:
    """Returns the quantities of a frame, in order."""
    return [packet.name for packet in _core.packets(frame[4:-1] if frame[3] < 255 else frame[6:-1])]


# The encoder -----------------------------------------------------------------------------------------


def contents(quantity: Quantity) -> Array:
    """Returns four rows of numbers with extreme values."""
    random = np.random.default_rng(quantity.id)
    if quantity.kind == "real":
        rows = random.normal(0, 1000, (4, quantity.numbers))
        rows[0], rows[1], rows[2] = 0.5 / 2**20, -1e30, -2.5 / 2**32
        return rows
    types = [field.type for field in quantity.fields] or [quantity.kind] * quantity.numbers
    if quantity.kind == "list":
        head = [7, 2, 0, 0, 0]
        return np.array([[*head, *random.integers(0, 256, 8)] for _ in range(4)])
    if quantity.kind == "id":
        types = ["u4"]
    limits = [(-(2**24), 2**24) if kind == "f4" else np.iinfo(kind) for kind in types]
    ranges = [limit if isinstance(limit, tuple) else (limit.min, limit.max) for limit in limits]
    dtype = np.uint64 if "u8" in types else np.int64
    return np.array([[low, high, high // 2, high // 3] for low, high in ranges], dtype).T.copy()


def formats(quantity: Quantity) -> Iterator[tuple[str | None, str | None]]:
    precisions = list(Precision.__members__) if quantity.kind == "real" else [None]
    coordinates = list(Coordinates.__members__) if quantity.coordinates else [None]
    return itertools.product(precisions, coordinates)


@pytest.mark.parametrize("quantity", QUANTITIES.values(), ids=lambda row: row.name)
def test_many_samples_encode_like_single_samples(quantity: Quantity) -> None:
    rows = contents(quantity)
    for precision, coordinates in formats(quantity):
        data_id = quantity.id
        data_id |= Precision[precision] if precision else 0
        data_id |= Coordinates[coordinates] if coordinates else 0
        counters = np.arange(4)
        frames = _core.encode_samples([(COUNTER, counters), (data_id, rows)], 5)
        single = [
            xbus.encode_frame(
                0x36,
                xbus.encode_packet("packet_counter", counter)
                + _core.encode_packet(quantity.name, precision, coordinates, row),
                bid=5,
            )
            for counter, row in zip(counters.tolist(), rows, strict=True)
        ]
        assert frames.data == b"".join(single)
        assert frames.ends.tolist() == np.cumsum([len(frame) for frame in single]).tolist()


def test_rows_of_any_layout_in_memory_and_scalars_without_an_axis() -> None:
    vectors = np.arange(6.0).reshape(3, 2).T  # not contiguous
    frames = _core.encode_samples([(0x4020, vectors), (0x0810, np.array([1.5, 2.5]))], 0xFF)
    log = xbus.read_log(frames.data)
    assert log["acceleration"].values.tolist() == vectors.tolist()
    assert log["temperature"].values.tolist() == [1.5, 2.5]


def test_no_packets_give_no_frames() -> None:
    for packets in ([], [(0x4020, np.zeros((0, 3)))]):
        frames = _core.encode_samples(packets, 0xFF)
        assert (frames.data, frames.ends.tolist()) == (b"", [])


def test_long_messages_get_the_extended_length() -> None:
    double = (0x2023, np.ones((2, 9)))
    frames = _core.encode_samples([double] * 4, 0xFF)
    assert (frames.data[3:6].hex(), frames.ends.tolist()) == ("ff012c", [307, 614])
    assert len(xbus.read_log(frames.data)) == 2


@pytest.mark.parametrize(
    ("packets", "error", "words"),
    [
        ([(0x4020, np.zeros((2, 2)))], ValueError, "acceleration takes 3 numbers, not 2"),
        (
            [(0x4020, np.zeros((2, 3))), (COUNTER, np.zeros(3))],
            ValueError,
            "one row for each message",
        ),
        ([(COUNTER, np.array(1))], ValueError, "one row for each message"),
        ([(COUNTER, np.array([0, 65536]))], ValueError, "65536 is outside U2"),
        ([(0x0811, np.array([np.nan]))], ValueError, "Fp1220 has no NaN"),
        ([(0x9990, np.zeros(1))], ValueError, "no quantity has the data identifier 0x9990"),
        ([(0x201C, np.zeros((1, 4)))], ValueError, "no quantity has the data identifier 0x201c"),
        (
            [(COUNTER, np.zeros(1, np.int8))],
            TypeError,
            "an array of float32, float64, int64 or uint64",
        ),
    ],
)
def test_invalid_arrays_are_refused(
    packets: list[tuple[int, Array]], error: type[Exception], words: str
) -> None:
    with pytest.raises(error, match=words):
        _core.encode_samples(packets, 0xFF)


# Times of messages ----------------------------------------------------------------------------

Q, EULER, ACC, GYR, MAG = 0x2010, 0x2030, 0x4020, 0x8020, 0xC020
DV, DQ, ACC_HR, GYR_HR, PRESSURE, TEMPERATURE = 0x4010, 0x8030, 0x4040, 0x8040, 0x3010, 0x0810
RAW, RAW_GYRO = 0xA010, 0xA020
LAT_LON, ALTITUDE, ECEF, VELOCITY = 0x5043, 0x5023, 0x5033, 0xD013
PVT, SAT, PULSE, UTC = 0x7010, 0x7020, 0x7030, 0x1010


@pytest.mark.parametrize(
    ("product", "outputs", "rates", "messages"),
    [
        (1, [(ACC, 100), (MAG, 50), (TEMPERATURE, 1)], [100, 50, 1], 100),
        (3, [(Q, 100), (ACC_HR, 1000), (GYR_HR, 800)], [100, 1000, 800], 1900),
        (3, [(Q, 10), (EULER, 4)], [10, 4], 12),  # both at 0, 0.5, ... s
        (7, [(LAT_LON, 100), (PVT, 4), (ACC_HR, 800)], [100, 4, 800], 904),
        (10, [(RAW, 2000), (RAW_GYRO, 100)], [2000, 100], 2000),
        (30, [(Q, 400), (MAG, 100), (ACC_HR, 1000)], [400, 100, 1000], 1400),
        (710, [(Q, 100), (PRESSURE, 50), (PVT, 4), (SAT, 4)], [100, 50, 4, 4], 108),
        (680, [(ACC, 80), (LAT_LON, 400), (PVT, EVERY), (PULSE, EVERY)], [80, 400, 4, 4], 404),
        (630, [(GYR, 400), (ACC_HR, 2000), (GYR_HR, 1600)], [400, 2000, 1600], 4000),
        (630, [(ACC_HR, 500)], [500], 500),
    ],
)
def test_outputs_have_their_rates(
    product: int, outputs: list[tuple[int, int]], rates: list[int], messages: int
) -> None:
    log = log_of(make(product, [*STAMPS, *outputs, STATUS]), 10.0)
    columns = [log[NAMES[data_id & 0xFFF0]] for data_id, _ in outputs]
    assert [len(column) for column in columns] == [10 * rate for rate in rates]
    assert len(log) == 10 * messages
    assert log.stats.lost_samples == 0
    assert log["packet_counter"].values.tolist() == list(range(len(log)))


@pytest.mark.parametrize(
    ("outputs", "order"),
    [
        ([*STAMPS, (Q, 100), STATUS, (ACC, 100)],
         "packet_counter sample_time_fine quaternion status_word acceleration"),
        ([(ACC, 100), STATUS, *STAMPS],
         "acceleration status_word packet_counter sample_time_fine"),
    ],
)  # fmt: skip
def test_packets_come_in_the_order_of_the_configuration(
    outputs: list[tuple[int, int]], order: str
) -> None:
    (_, frame), *_ = make(630, outputs).take(0.01, 0)
    assert names(frame) == order.split()


def test_packets_that_are_not_due_are_missing() -> None:
    stream = make(630, [(COUNTER, EVERY), (Q, 200), (ACC, 400), (MAG, 100)])
    due = ["acceleration", "quaternion acceleration", "acceleration"]
    for (_, frame), quantities in zip(stream.take(0.0075, 0), due, strict=True):
        assert names(frame) == ["packet_counter", *quantities.split()]


def test_time_stamps_and_status_alone_come_at_100_hz() -> None:
    log = log_of(make(630, [*STAMPS, STATUS]), 2.0, status=7)
    assert np.diff(log["sample_time_fine"].values).tolist() == [100] * 199
    assert set(log["status_word"].values) == {7}


def test_hr_samples_come_alone_with_time_stamps_and_without_status() -> None:
    stream = make(630, [(COARSE, EVERY), (ACC, 100), (ACC_HR, 2000), STATUS, (UTC, EVERY)])
    found = {tuple(names(frame)) for _, frame in stream.take(0.1, 0)}
    hr = ("sample_time_coarse", "acceleration_hr", "utc_time")
    assert found == {("sample_time_coarse", "acceleration", "status_word", "utc_time"), hr}


@pytest.mark.parametrize(
    ("product", "aligned"), [(3, False), (630, False), (30, True), (710, True)]
)
def test_hr_samples_miss_the_ticks_where_they_are_not_synchronous(
    product: int, aligned: bool
) -> None:
    log = log_of(make(product, [*STAMPS, (ACC, 100), (ACC_HR, 1000), (GYR_HR, 500)]), 1.0)
    ticks = [
        np.rint(log[name].time * 1e4).astype(int) for name in ("acceleration_hr", "rate_of_turn_hr")
    ]
    assert [bool((tick % 10 == 0).all()) for tick in ticks] == [aligned] * 2
    assert all(set(np.diff(tick)) == {step} for tick, step in zip(ticks, (10, 20), strict=True))


def test_status_byte_is_the_low_byte_and_identifiers_are_sent() -> None:
    outputs = [
        (DataId.StatusByte, EVERY),
        STATUS,
        (DataId.DeviceId, EVERY),
        (DataId.LocationId, EVERY),
    ]
    log = log_of(make(30, outputs, device_id=0x0368248C, location_id=513), 0.01, status=0x123)
    values = [
        log[name].values.tolist()
        for name in ("status_byte", "status_word", "device_id", "location_id")
    ]
    assert values == [[0x23], [0x123], [0x0368248C], [513]]


def test_bus_identifier() -> None:
    assert set(log_of(make(630, [(ACC, 100)], bid=3), 0.1).bid) == {3}


def test_the_stream_starts_after_its_start_time() -> None:
    stream = make(680, [*STAMPS, (ACC, 100), (PVT, EVERY)], start=0.3)
    sent = [at for at, _ in stream.take(0.56, 0)]
    assert sent[:2] == [0.31, 0.32]
    assert [at for at in sent if at % 0.01 > 0.001 and at % 0.01 < 0.009] == [0.545]


@pytest.mark.parametrize(
    ("outputs", "words"),
    [
        ([(ACC, 30)], "acceleration: 30 Hz does not divide 400 Hz"),
        ([(ACC, 800)], "acceleration: 800 Hz does not divide 400 Hz"),
        ([(ACC, EVERY)], "acceleration: the rate must be 1 to 2000 Hz, not 65535 Hz"),
        ([(ACC_HR, EVERY)], "acceleration_hr: the rate must be 1 to 2000 Hz, not 65535 Hz"),
        ([(0x9990, 100)], "no quantity has the data identifier 0x9990"),
    ],
)
def test_invalid_configurations_are_refused(outputs: list[tuple[int, int]], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        make(630, outputs)


def test_triggers_are_not_part_of_the_stream() -> None:
    assert make(630, [(DataId.TriggerIn1, EVERY)]).take(10.0, 0) == []


# Time and counters -------------------------------------------------------------------------------------

#: Outputs with three clocks and seven combinations of packets.
FULL = [
    *STAMPS, (COARSE, EVERY), (UTC, EVERY), (Q, 400), (ACC, 100), (DQ, 50), (LAT_LON, 10), (TEMPERATURE, 1),
    (ACC_HR, 2000), (GYR_HR, 1600), (PVT, EVERY), (SAT, EVERY), (PULSE, EVERY), STATUS,
]  # fmt: skip


@pytest.mark.parametrize("seed", range(5))
def test_the_number_of_calls_has_no_effect(seed: int) -> None:
    options: dict[str, Any] = {"noise": 1.0, "time_to_fix": 1.03, "seed": 4}
    whole = make(680, FULL, **options).take(2.0, 5)
    random = np.random.default_rng(seed)
    cuts = np.sort(random.uniform(0, 2, [1, 7, 50, 200, 3000][seed]))
    pieces = make(680, FULL, **options)
    assert [sent for until in [*cuts, 2.0, 2.0] for sent in pieces.take(float(until), 5)] == whole
    assert [at for at, _ in whole] == sorted(at for at, _ in whole)


def test_seeds_of_64_bits() -> None:
    first, second = (
        make(630, [(ACC, 100)], noise=1.0, seed=2**64 - offset).take(0.1, 0) for offset in (1, 2)
    )
    assert first != second


def test_the_same_seed_gives_the_same_bytes_and_another_one_others() -> None:
    first, again, other = (make(680, FULL, noise=1.0, seed=seed).take(0.5, 0) for seed in (1, 1, 2))
    assert first == again
    assert first != other


@pytest.mark.parametrize(
    ("product", "wrap"), [(3, U32), (30, DAY), (300, DAY), (710, DAY), (630, U32), (680, U32)]
)
def test_counter_and_fine_time_wrap_and_nothing_is_lost(product: int, wrap: int) -> None:
    outputs = [*STAMPS, (ACC, 100), (ACC_HR, 500)]
    stream = make(product, outputs, counter=65000, fine_start=wrap - 10_000)
    log = log_of(stream, 2.0)
    assert stream.counter == (65000 + 1200) % 65536
    assert log.packet_counter.tolist() == list(range(65000, 66200))
    assert log.stats.lost_samples == 0
    assert log["sample_time_fine"].values.min() < 100
    time = log["acceleration"].time - (wrap - 10_000) / 1e4
    assert time == pytest.approx(np.arange(1, 201) / 100, abs=1e-6)


def test_coarse_time_continues_when_the_fine_time_wraps() -> None:
    """The two disagree after the wrap (section 5.3.6, "valid only until the wraparound")."""
    log = log_of(make(3, [(FINE, EVERY), (COARSE, EVERY), (ACC, 1)], fine_start=U32 - 15_000), 3.0)
    assert log["sample_time_fine"].values.tolist() == [U32 - 5_000, 5_000, 15_000]
    assert log["sample_time_coarse"].values.tolist() == [429_496, 429_497, 429_498]


def test_coarse_and_calendar_agree_with_the_fine_time() -> None:
    utc = np.datetime64("2024-12-31T23:59:58.5", "ns")
    log = log_of(make(680, FULL, utc=utc), 3.0)
    fine, coarse = log["sample_time_fine"].values, log["sample_time_coarse"].values
    assert (coarse == fine // 10_000).all()
    late = log["utc_time"].datetime - utc - fine.astype("m8[ns]") * 100_000
    assert (late >= np.timedelta64(0)).all()
    assert (late < np.timedelta64(100_000, "ns")).all()  # the fine time is rounded down
    assert str(log["utc_time"].datetime[-1]).startswith("2025-01-01T00:00:01.")


def test_ticks_do_not_drift() -> None:
    stream = make(630, [(ACC, 400), (GYR_HR, 1600)], start=100_000.0)
    hr = [(160_000_000 + k) / 1600 + 0.0003 for k in range(8)]
    sent = [at for at, _ in stream.take(100_000.005, 0)]
    assert sent == sorted([100_000.0025, 100_000.005, *hr])


# The receiver ------------------------------------------------------------------------------------------


def test_messages_of_the_receiver() -> None:
    frames = [frame for _, frame in make(680, FULL).take(1.0, 0)]
    at = [i for i, frame in enumerate(frames) if "gnss_sat_info" in (names(frame) or [])]
    stamps = ["utc_time", "sample_time_coarse", "sample_time_fine", "packet_counter"]
    assert len(at) == 4
    for i in at:
        assert names(frames[i]) == ["gnss_sat_info", *stamps]
        assert names(frames[i + 1]) == ["gnss_pvt_data", "gnss_pvt_pulse", *stamps]


def test_the_receiver_runs_45_ms_behind() -> None:
    log = log_of(make(680, FULL), 2.0)
    pvt, sat, base = log["gnss_pvt_data"], log["gnss_sat_info"], log["quaternion"]
    assert pvt.time.tolist() == sat.time.tolist() == [k / 4 for k in range(8)]
    assert (log["gnss_pvt_pulse"].values == pvt.time * 10_000).all()
    before = np.searchsorted(base.sample, pvt.sample) - 1
    assert base.time[before] - pvt.time == pytest.approx(0.045, abs=1e-9)
    assert (log["packet_counter"].values == np.arange(len(log))).all()


def test_the_receiver_reports_the_position_of_the_trajectory() -> None:
    utc = np.datetime64("2024-02-29T23:59:59.75", "ns")  # a Thursday
    stream = make(670, [*STAMPS, (PVT, EVERY)], "fly", utc=utc)
    log = log_of(stream, 20.0)
    pvt, truth = log["gnss_pvt_data"].scaled, motion_at("fly", log["gnss_pvt_data"].time)
    lat, lon, height = earth.enu_to_geodetic(truth.position, earth.ORIGIN)
    east, north, up = truth.velocity.T
    for name, value, count in [
        ("lat", lat, 1e-7), ("lon", lon, 1e-7), ("height", height, 1e-3), ("velE", east, 1e-3),
        ("velN", north, 1e-3), ("velD", -up, 1e-3), ("gSpeed", np.hypot(east, north), 1e-3),
        ("headMot", np.degrees(np.arctan2(east, north)) % 360, 1e-5),
    ]:  # fmt: skip
        assert pvt[name] == pytest.approx(value, abs=0.51 * count), name
    assert pvt["hMSL"] == pytest.approx(pvt["height"] - earth.GEOID_SEPARATION, abs=2e-3)
    # Thursday's last quarter of a second, 18 leap seconds ahead of UTC; the next day is 1 March.
    assert pvt["itow"][:2] == pytest.approx([5 * 86400 + 17.75, 5 * 86400 + 18.0])
    days = [(row["year"], row["month"], row["day"], row["sec"], row["nano"]) for row in pvt[:2]]
    assert days == [(2024, 2, 29, 59, pytest.approx(0.75)), (2024, 3, 1, 0, 0.0)]
    assert set(pvt["fixtype"]) == {3}
    assert set(pvt["valid"] & 7) == {7}
    assert pvt["pdop"] ** 2 == pytest.approx(pvt["hdop"] ** 2 + pvt["vdop"] ** 2, rel=0.02)


def test_before_the_first_fix_values_are_missing() -> None:
    outputs = [
        *STAMPS,
        (Q, 100),
        (LAT_LON, 100),
        (VELOCITY, 50),
        (PVT, EVERY),
        (SAT, EVERY),
        (UTC, EVERY),
    ]
    log = log_of(make(680, outputs, time_to_fix=2.5), 5.0)
    pvt = log["gnss_pvt_data"]
    fixed = pvt.time >= 2.5
    assert (~fixed).sum() == 10
    assert (pvt.values["fixtype"] == 3 * fixed).all()
    assert (np.isnan(pvt.scaled["hAcc"]) == ~fixed).all()
    assert (pvt.values["lat"][~fixed] == 0).all()
    assert (log["gnss_sat_info"].satellites["cno"][:100] == 0).all()
    assert (log["utc_time"].values["valid"] == 7 * (log["utc_time"].time >= 2.5)).all()
    assert len(log["quaternion"]) == 500
    assert (log["lat_lon"].time[0], log["velocity_xyz"].time[0]) == (2.5, 2.5)


def test_satellites() -> None:
    log = log_of(make(680, [*STAMPS, (PVT, EVERY), (SAT, EVERY)], seed=3), 600.0)
    info, pvt = log["gnss_sat_info"], log["gnss_pvt_data"].values
    first = info.satellites[: info.offsets[1]]
    assert (
        len({(int(satellite["gnssId"]), int(satellite["svId"])) for satellite in first})
        == len(first)
        == 20
    )
    used = [
        int((info.satellites[i:j]["flags"] >> 3 & 1).sum())
        for i, j in itertools.pairwise(info.offsets)
    ]
    assert used == pvt["numSV"].tolist()
    assert min(used) > 8
    strength = info.satellites["cno"].reshape(-1, 20).astype(int)
    assert np.ptp(strength, axis=0).min() >= 1
    assert np.abs(np.diff(strength, axis=0)).max() == 1  # slowly


def test_an_rtk_fix_is_more_accurate() -> None:
    none, floating, fixed = (
        log_of(make(680, [*STAMPS, (PVT, EVERY)], rtk=rtk), 1.0)["gnss_pvt_data"].scaled[0]
        for rtk in range(3)
    )
    assert [int(pvt["flags"]) for pvt in (none, floating, fixed)] == [0x01, 0x43, 0x83]
    assert fixed["hAcc"] < 0.02 < floating["hAcc"] < 1 < none["hAcc"]
    assert fixed["sAcc"] < floating["sAcc"] < none["sAcc"]


def test_send_latest_returns_one_message_of_each_kind() -> None:
    outputs = [*STAMPS, (ACC, 100), (TEMPERATURE, 1), (ACC_HR, 2000), (PVT, EVERY), STATUS]
    stream = make(680, outputs, counter=10)
    log = xbus.read_log(b"".join([*stream.latest(1.0532, 3), *stream.latest(1.0571, 3)]))
    assert log["packet_counter"].values.tolist() == [10, 11, 12]
    assert (log["acceleration"].sample.tolist(), log["gnss_pvt_data"].sample.tolist()) == (
        [0, 2],
        [1],
    )
    assert log["sample_time_fine"].values.tolist() == [10525, 10000, 10550]
    assert log["status_word"].values.tolist() == [3, 3]
    truth = log_of(make(680, outputs), 1.05)
    assert (log["acceleration"].values == truth["acceleration"].values[-1]).all()
    assert (log["temperature"].values == truth["temperature"].values[-1]).all()


# Measurements ---------------------------------------------------------------------------------------


def motion_at(path: str, time: Array) -> Any:
    return trajectory(path).at(np.asarray(time, np.float64))


def gravity() -> Array:
    return np.array([0, 0, float(earth.gravity(earth.ORIGIN.lat, earth.ORIGIN.alt))])


#: With double precision and stamps.
INERTIAL = [0x2013, 0x8033, 0x4013, 0x4023, 0x8023, 0xD013, 0x4033]
RATES = [1, 2, 4, 5, 8, 10, 16, 20, 25, 40, 50, 80, 100, 200, 400]


@pytest.mark.parametrize("path", ["walk", "tumble", "fly"])
@pytest.mark.parametrize("rate", RATES)
def test_increments_add_up_to_orientation_and_velocity(rate: int, path: str) -> None:
    log = log_of(make(680, [*STAMPS, *((data_id, rate) for data_id in INERTIAL)], path), 20.0)
    q, v = log["quaternion"].values, log["velocity_xyz"].values
    turned = q[:1]
    for delta in log["delta_q"].values[1:]:
        turned = quaternion.multiply(turned, delta[np.newaxis])
    assert np.abs((turned * q[-1]).sum()) == pytest.approx(1, abs=1e-12)
    assert np.abs(np.cross(turned[0, 1:], q[-1, 1:])).max() < 1e-12
    assert (log["delta_q"].values[:, 0] >= 0).all()
    # The sum of all increments, each rotated from the coordinates at the start of its interval.
    gained = quaternion.rotate(q[:-1], log["delta_v"].values[1:]) - gravity() / rate
    assert v[0] + gained.cumsum(axis=0) == pytest.approx(v[1:], abs=1e-9)


@pytest.mark.parametrize(
    ("path", "rates", "bound"),
    [
        ("fly", [1, 2, 5, 10, 20, 40, 80, 100, 200, 400], 0.01),
        ("walk", [40, 80, 100, 200, 400], 90.0),
    ],
)
def test_acceleration_less_gravity_is_the_derivative_of_velocity(
    path: str, rates: list[int], bound: float
) -> None:
    for rate in rates:
        log = log_of(make(680, [*STAMPS, *((data_id, rate) for data_id in INERTIAL)], path), 20.0)
        q, v = log["quaternion"].values, log["velocity_xyz"].values
        linear = quaternion.rotate(q, log["acceleration"].values) - gravity()
        # The error of central differences: the third derivative of velocity times dt^2 / 6.
        derivative = (v[2:] - v[:-2]) * rate / 2
        assert linear[1:-1] == pytest.approx(derivative, abs=bound / rate**2)
        assert linear == pytest.approx(log["free_acceleration"].values, abs=1e-9)


@pytest.mark.parametrize("path", ["walk", "fly"])
@pytest.mark.parametrize(("accelerations", "turns"), [(2000, 1600), (500, 400), (2000, 320)])
def test_hr_samples_integrate_to_velocity_and_orientation(
    accelerations: int, turns: int, path: str
) -> None:
    outputs = [(0x4043, accelerations), (0x8043, turns), (0x2013, 400), (0xD013, 400)]
    log = log_of(make(680, [*STAMPS, *outputs], path), 10.0)
    time, q, v = log["quaternion"].time, log["quaternion"].values, log["velocity_xyz"].values
    hr = log["acceleration_hr"]
    inside = (hr.time >= time[0]) & (hr.time <= time[-1])
    between = np.stack([np.interp(hr.time[inside], time, component) for component in q.T], axis=1)
    linear = quaternion.rotate(between, hr.values[inside]) - gravity()
    gained = ((linear[1:] + linear[:-1]) / 2).sum(axis=0) / accelerations
    ends = [
        np.array([np.interp(now, time, axis) for axis in v.T]) for now in hr.time[inside][[0, -1]]
    ]
    assert gained == pytest.approx(ends[1] - ends[0], abs=2e-3)

    gyr = log["rate_of_turn_hr"]
    turned = np.array([1.0, 0, 0, 0])
    for rate in (gyr.values[1:] + gyr.values[:-1]) / 2:
        turned = quaternion.multiply(turned, quaternion.from_rotation_vector(rate / turns))
    first, last = (
        motion_at(path, np.array([tick / turns + 3e-4])).orientation for tick in (0, 10 * turns - 1)
    )
    error = quaternion.multiply(quaternion.conjugate(quaternion.multiply(first, turned)), last)
    assert np.abs(error[0, 1:]).max() < 2e-5


def test_rate_of_turn_is_that_of_the_quaternion() -> None:
    log = log_of(make(680, [*STAMPS, (0x2013, 400), (0x8023, 400)], "tumble"), 5.0)
    q = log["quaternion"].values
    vector = 2 * quaternion.multiply(quaternion.conjugate(q[:-2]), q[2:])[:, 1:] * 400 / 2
    assert vector == pytest.approx(log["rate_of_turn"].values[1:-1], abs=1e-3)


def test_coordinates() -> None:
    ids = [data_id | system | 3 for data_id in (Q, EULER, 0x2020, 0xD010) for system in Coordinates]
    log = log_of(make(680, [*STAMPS, *((identifier, 50) for identifier in ids)], "drive"), 10.0)
    turns = {"ENU": np.eye(3), "NED": np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1]]),
             "NWU": np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1]])}  # fmt: skip
    truth = motion_at("drive", log["quaternion", "ENU"].time)
    assert log["quaternion", "ENU"].values == pytest.approx(truth.orientation, abs=1e-12)
    for system, turn in turns.items():
        matrix = turn @ quaternion.to_matrix(truth.orientation)
        assert log["rotation_matrix", system].values == pytest.approx(matrix, abs=1e-12)
        q = log["quaternion", system].values
        assert quaternion.to_matrix(q) == pytest.approx(matrix, abs=1e-12)
        euler = log["euler_angles", system].values
        assert quaternion.to_matrix(quaternion.from_euler(euler)) == pytest.approx(matrix, abs=1e-9)
        velocity = log["velocity_xyz", system].values
        assert velocity == pytest.approx(truth.velocity @ turn.T, abs=1e-12)


def test_precisions() -> None:
    real = [0x0810, Q, DV, ACC, 0x4030, 0x5020, 0x5040, GYR, DQ, MAG, 0xD010]
    logs = [
        log_of(make(680, [*STAMPS, *((data_id | code, 100) for data_id in real)]), 1.0)
        for code in Precision
    ]
    for data_id in real:
        exact = logs[3][NAMES[data_id]].values
        for log, resolution in zip(logs, (2**-24, 2**-21, 2**-33, 0), strict=True):
            column = log[NAMES[data_id]]
            scale = np.abs(exact).max() if column.precision == "Float32" else 1
            assert column.values == pytest.approx(exact, abs=resolution * scale, rel=0), column
    assert [log["acceleration"].precision for log in logs] == list(Precision.__members__)


def test_alignment_keeps_orientation_and_vectors_together() -> None:
    sensor, local = (0.5, 0.5, -0.5, 0.5), (0.8, 0.0, 0.0, 0.6)
    outputs = [*STAMPS, *((data_id, 100) for data_id in [*INERTIAL, 0xC023])]
    plain = log_of(make(680, outputs), 5.0)
    turned = log_of(make(680, outputs, rot_sensor=sensor, rot_local=local), 5.0)
    before, after = np.array(local), np.array(sensor)  # the factors around q
    q = turned["quaternion"].values
    expected = quaternion.multiply(before, quaternion.multiply(plain["quaternion"].values, after))
    assert q == pytest.approx(expected, abs=1e-12)
    for name in ("acceleration", "rate_of_turn", "magnetic_field", "delta_v"):
        seen = quaternion.rotate(quaternion.conjugate(after), plain[name].values)
        assert turned[name].values == pytest.approx(seen, abs=1e-12), name
    advanced = quaternion.multiply(q[:-1], turned["delta_q"].values[1:])
    assert advanced == pytest.approx(q[1:], abs=1e-12)
    # The same force, in the rotated local coordinates.
    force = quaternion.rotate(
        before, quaternion.rotate(plain["quaternion"].values, plain["acceleration"].values)
    )
    assert quaternion.rotate(q, turned["acceleration"].values) == pytest.approx(force, abs=1e-12)
    free = quaternion.rotate(before, plain["free_acceleration"].values)
    assert turned["free_acceleration"].values == pytest.approx(free, abs=1e-12)
    assert (turned["velocity_xyz"].values == plain["velocity_xyz"].values).all()


def test_positions_agree() -> None:
    log = log_of(
        make(
            680,
            [*STAMPS, *((data_id, 100) for data_id in (LAT_LON, ALTITUDE, ECEF, PRESSURE))],
            "fly",
        ),
        10.0,
    )
    truth = motion_at("fly", log["lat_lon"].time)
    lat, lon = log["lat_lon"].values.T
    ecef = earth.geodetic_to_ecef(lat, lon, log["altitude_ellipsoid"].values)
    assert ecef == pytest.approx(log["position_ecef"].values, abs=1e-5)
    assert earth.ecef_to_enu(ecef, earth.ORIGIN) == pytest.approx(truth.position, abs=1e-5)
    pressure = earth.pressure(log["altitude_ellipsoid"].values - earth.GEOID_SEPARATION)
    assert log["baro_pressure"].values == pytest.approx(pressure, abs=0.5)


def test_the_magnetic_field_points_north_and_down() -> None:
    log = log_of(make(630, [*STAMPS, (0x2013, 100), (0xC023, 100)], "tumble"), 10.0)
    field = quaternion.rotate(log["quaternion"].values, log["magnetic_field"].values)
    assert field == pytest.approx(np.tile(earth.magnetic_field(), (1000, 1)), abs=1e-12)


def test_raw_counts_are_the_calibrated_values_by_fixed_gains() -> None:
    log = log_of(
        make(710, [*STAMPS, (RAW, 2000), (RAW_GYRO, 2000), (ACC, 400), (GYR, 400), (MAG, 100)]), 2.0
    )
    raw = log["raw_acc_gyr_mag_temp"]
    gains = {"acceleration": 300, "rate_of_turn": 1800, "magnetic_field": 8000}
    for (name, gain), letters in zip(gains.items(), ("acc", "gyr", "mag"), strict=True):
        column = log[name]
        rows = raw.values[np.isin(raw.sample, column.sample)]
        counts = np.stack([rows[f"{letters}{axis}"] for axis in "XYZ"], axis=1).astype(float)
        assert (counts - 32768) / gain == pytest.approx(column.values, abs=0.6 / gain), name
    assert (log["raw_gyro_temp"].values == raw.values["Temp"][:, np.newaxis]).all()
    assert raw.values["Temp"][0] == 25 * 256


def test_the_temperature_rises_to_its_final_value() -> None:
    values = log_of(make(630, [*STAMPS, (TEMPERATURE, 1)]), 3600.0)["temperature"].values
    assert (np.diff(values) >= 0).all()
    assert values[[0, -1]] == pytest.approx([25.0, 37.0], abs=0.1)


@pytest.mark.parametrize("rate", [10, 100, 400])
def test_noise_is_white_and_of_the_density_of_a_data_sheet(rate: int) -> None:
    log, clean = (
        log_of(
            make(630, [*STAMPS, (0x8023, rate), (0x4023, rate), (0x8033, rate)], noise=noise),
            1000 / rate * 4,
        )
        for noise in (1.0, 0.0)
    )
    for name, density in [("rate_of_turn", np.radians(0.007)), ("acceleration", 60e-6 * 9.81)]:
        noise = log[name].values - clean[name].values
        assert noise.std(axis=0) == pytest.approx(density * np.sqrt(rate / 2), rel=0.1)
        assert np.abs((noise[1:] * noise[:-1]).mean(axis=0)).max() < 0.1 * noise.var()
    # The increments come from the same sensor.
    turned = 2 * quaternion.delta(clean["delta_q"].values, log["delta_q"].values)[:, 1:] * rate
    assert turned == pytest.approx(
        log["rate_of_turn"].values - clean["rate_of_turn"].values, abs=1e-6
    )


def test_hr_samples_have_noise_of_their_own() -> None:
    log = log_of(make(630, [*STAMPS, (0x4023, 400), (0x4043, 400)], "still", noise=1.0), 1.0)
    plain, hr = log["acceleration"].values[:399, 0], log["acceleration_hr"].values[1:, 0]
    assert abs(np.corrcoef(plain, hr)[0, 1]) < 0.2  # ticks 1 to 399 of both


def test_delta_q_is_the_shorter_way_round() -> None:
    time = np.arange(0, 5, 0.1)
    spin = SampledTrajectory(time, quaternion.from_euler(np.outer(time, [0, 0, 270])))
    values = Sensors(spin, PRODUCTS[630]).read("delta_q", Ticks(1, 3, 1))
    assert values == pytest.approx(np.tile([np.sqrt(0.5), 0, 0, -np.sqrt(0.5)], (3, 1)), abs=1e-6)


def test_three_forms_of_an_orientation_have_the_same_noise() -> None:
    log = log_of(make(630, [*STAMPS, (0x2013, 100), (0x2023, 100), (0x2033, 100)], noise=1.0), 1.0)
    matrix = quaternion.to_matrix(log["quaternion"].values)
    assert log["rotation_matrix"].values == pytest.approx(matrix, abs=1e-12)
    angles = quaternion.to_matrix(quaternion.from_euler(log["euler_angles"].values))
    assert angles == pytest.approx(matrix, abs=1e-9)


@pytest.mark.parametrize(
    ("product", "name"),
    [(610, "quaternion"), (630, "lat_lon"), (630, "raw_gyro_temp"), (1, "baro_pressure")],
)
def test_quantities_that_the_product_does_not_measure_are_refused(product: int, name: str) -> None:
    sensors = Sensors(trajectory("still"), PRODUCTS[product])
    with pytest.raises(ValueError, match=f"{PRODUCTS[product].name} does not measure {name}"):
        sensors.read(name, Ticks(0, 1, 100))


def test_every_measured_quantity_of_every_product() -> None:
    elsewhere = {"Timestamp", "Status", "Indication"}
    for product in PRODUCTS.values():
        sensors = Sensors(trajectory("walk"), product, noise=1.0)
        for row in QUANTITIES.values():
            if (
                product.number not in row.products
                or row.group in elsewhere
                or row.name == "gnss_pvt_pulse"
            ):
                continue
            values = sensors.read(row.name, Ticks(7, 2, 100))
            frames = _core.encode_samples([(row.id, values)], 0xFF)
            assert len(xbus.read_log(frames.data, strict=True)[row.name]) == 2


def test_sensors_can_be_replaced_while_measuring() -> None:
    stream = make(630, [*STAMPS, (Q, 100)], "still")
    stream.take(0.5, 0)
    stream.sensors = Sensors(trajectory("still"), PRODUCTS[630], rot_local=(0.6, 0.0, 0.0, 0.8))
    frames = b"".join(frame for _, frame in stream.take(1.0, 0))
    assert xbus.read_log(frames)["quaternion"].values == pytest.approx(
        np.tile([0.6, 0, 0, 0.8], (50, 1))
    )
