"""``xbus monitor`` without a terminal: what is known of a stream, and how it is drawn."""

from __future__ import annotations

import contextlib
import datetime
import io
import json
import math
import socket
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from rich.console import Console

import xbus
from conftest import counter, damaged_streams, fine
from streams import frame, mtdata2, packet
from test_cli import FIELD, WALK, run, sentence
from xbus import SimulatedDevice, encode_frame, encode_sample, read_log
from xbus.cli.monitor.horizon import compass, horizon
from xbus.cli.monitor.keyboard import parse_keys
from xbus.cli.monitor.replay_source import ReplaySource
from xbus.cli.monitor.screen import Screen, ViewState
from xbus.cli.monitor.snapshot import snapshot_dict, snapshot_text
from xbus.device.stats import LiveStats, live_stats
from xbus.protocol import State
from xbus.protocol.ids import MessageId
from xbus.sim import Replay
from xbus.watch import device_source
from xbus.watch.attitude import Attitude, attitude_of
from xbus.watch.device_source import DeviceSource
from xbus.watch.model import Model, QuantityState
from xbus.watch.rate import Rate
from xbus.watch.rows import UNICODE, status_rows, value_rows

# Attitude


def block_of(
    product: str, trajectory: str, outputs: dict[Any, int | None], samples: int = 400
) -> xbus.Log:
    device = xbus.connect(SimulatedDevice(product, trajectory=trajectory))
    with device.configure(outputs):
        pass
    for block in device.blocks(samples=samples):
        return block
    raise AssertionError


@pytest.mark.parametrize("coordinates", ["ENU", "NED", "NWU"])
def test_all_forms_and_coordinates_agree_with_the_accelerometer(coordinates: str) -> None:
    """The tumble trajectory passes all orientations; the accelerometer measures which way is up."""
    forms = ("quaternion", "rotation_matrix", "euler_angles")
    block = block_of(
        "MTi-630", "tumble", {"acceleration": 100, **{(form, coordinates): 100 for form in forms}}
    )
    up = block["acceleration"].values / 9.81
    for at in range(len(block)):
        reported = [attitude_of(form, coordinates, block[form].values[at]) for form in forms]
        x, y, z = up[at].tolist()
        for item in reported:
            assert item is not None
            assert math.sin(math.radians(item.pitch)) == pytest.approx(x, abs=2e-3)
            if math.hypot(y, z) > 0.1:  # next to the vertical roll means nothing
                assert math.hypot(y, z) * math.sin(math.radians(item.roll)) == pytest.approx(
                    y, abs=2e-3
                )
                assert math.hypot(y, z) * math.cos(math.radians(item.roll)) == pytest.approx(
                    z, abs=2e-3
                )
                turned = math.radians(item.heading - reported[0].heading)  # type: ignore[union-attr]
                assert math.cos(turned) == pytest.approx(1, abs=1e-3)


def test_the_heading_of_a_car_is_its_track() -> None:
    block = block_of("MTi-680G", "drive", {("quaternion", "NED"): 10, "velocity_xyz": 10}, 800)
    moving = block["velocity_xyz"]
    for velocity, sample in zip(moving.values, moving.sample, strict=True):
        row = block["quaternion"].values[block["quaternion"].sample == sample]
        reported = attitude_of("quaternion", "NED", row[0])
        assert reported is not None
        track = math.degrees(math.atan2(velocity[0], velocity[1]))
        assert math.cos(math.radians(reported.heading - track)) == pytest.approx(1, abs=1e-3)


@pytest.mark.parametrize(
    ("form", "row"),
    [
        ("quaternion", [0, 0, 0, 0]),
        ("quaternion", [math.nan, 0, 0, 1]),
        ("quaternion", [math.inf, 0, 0, 1]),
        ("quaternion", np.array([0x7FA00000] * 4, "u4").view("f4")),  # a NaN that signals
        ("rotation_matrix", [[math.nan] * 3] * 3),
        ("euler_angles", [math.inf, 0, 0]),
    ],
)
def test_an_invalid_orientation_is_not_shown(form: str, row: Any) -> None:
    assert attitude_of(form, "ENU", row) is None


def test_the_heading_is_never_360() -> None:
    reported = attitude_of("euler_angles", "ENU", [0, 0, 90 + 1e-9])
    assert reported == Attitude(0.0, 0.0, 0.0)


def picture(attitude: Attitude) -> list[str]:
    return ["".join(".#"[item] for item in line) for line in horizon(attitude, 9, 8)]


def test_the_horizon() -> None:
    level = picture(Attitude(0, 0, 0))
    assert level == ["." * 9] * 4 + ["#" * 9] * 4
    # The nose up: more sky. The right side down: more ground at the right.
    assert picture(Attitude(0, 15, 0)) == ["." * 9] * 6 + ["#" * 9] * 2
    assert picture(Attitude(0, -40, 0)) == ["#" * 9] * 8
    assert picture(Attitude(0, 0, 180)) == level[::-1]
    right = picture(Attitude(0, 0, 40))
    assert [item.count("#") for item in right] == [0, 2, 3, 4, 5, 6, 7, 9]
    assert all(item == "." * item.count(".") + "#" * item.count("#") for item in right)
    assert picture(Attitude(0, 0, -40)) == [item[::-1] for item in right]


@pytest.mark.parametrize(
    ("heading", "shown"),
    [
        (0, "·  NW ·  ·  N  ·  ·  NE ·"),
        (90, "·  NE ·  ·  E  ·  ·  SE ·"),
        (359.9, "·  NW ·  ·  N  ·  ·  NE ·"),
        (45, "·  N  ·  ·  NE ·  ·  E  ·"),
    ],
)
def test_the_compass(heading: float, shown: str) -> None:
    assert compass(heading, 25, "·") == shown


# The model


def test_a_rate_is_that_of_the_last_seconds() -> None:
    rate = Rate()
    assert rate.value is None
    for second in range(20):
        rate.add(second, 1000 * second + 3000 * max(0, second - 10))
    assert rate.value == 4000
    for now in (100, 50):  # after a pause, and after a step back of the clock
        rate.add(now, 10**6)
        assert rate.value is None


def test_rates_are_those_of_the_device() -> None:
    known = QuantityState("temperature")
    for second in range(4):
        known.update(1, 100 + second * 1.1, 7.0 + second)
    assert known.rate(103.5) == 1.0
    assert known.rate(110.0) == 0.0
    # Without time stamps the rate is by the clock of the host.
    for tenth in range(1, 31):
        known.update(20, 110 + tenth / 10, math.nan)
    assert known.rate(113.0) == pytest.approx(200)
    # A restarted device restarts its time.
    for stamp in (500.0, 500.1, 0.1, 0.2, 0.3):
        known.update(10, 113.0 + stamp % 1, stamp)
    assert known.rate(113.4) == pytest.approx(100)


def test_late_samples_of_the_receiver_do_not_change_the_rate_of_others() -> None:
    device = xbus.connect(SimulatedDevice("MTi-680G", replay=Replay(WALK)))
    model, rates = Model("test"), []
    for number, block in zip(range(500), device.blocks(samples=1), strict=False):
        model.add_block(block, number / 104)
        rates.append(model.quantities["packet_counter", None].rate(model.now))
    # 100 samples per second, and 4 of the receiver.
    assert rates[200:] == [pytest.approx(104, rel=0.01)] * 300


def known(data: bytes) -> Model:
    model = Model("test")
    model.add_block(read_log(data), 0.0)
    return model


def shown_values(data: bytes) -> dict[str, str]:
    return {value_row[0]: value_row[3].strip() for value_row in value_rows(known(data))}


def test_values() -> None:
    date = [1_000_000, 2026, 11, 22, 9, 30, 5, 7]
    printed = shown_values(
        encode_sample(
            {
                "temperature": 31.625,
                "baro_pressure": 100259,
                ("lat_lon", "Fp1632"): [52.2404607, -6.8382202],
                "acceleration": [0.5, -9.80665, math.nan],
                "free_acceleration": [1e30, 0, math.inf],
                "utc_time": date,
                "status_word": 0x09800006,
                "rotation_matrix": [[1, 0, 0], [0, 0, -1], [0, 1, 0]],
                "trigger_in1": [9, 1, 1234567, 3],
                "gnss_sat_info": ([1, 2, 0, 0, 0], [[0, 3, 40, 1], [0, 7, 0, 0]]),
            }
        )
        + encode_frame(MessageId.MTData2, packet(0xC2A0, b"\x01\xff") + packet(0xC2B0, b""))
    )
    assert printed == {
        "temperature": "31.62",
        "baro_pressure": "100259",
        "lat_lon": "52.2404607   -6.8382202",
        "acceleration": "0.5000   -9.8067       NaN",
        "free_acceleration": "1e+30    0.0000       inf",
        "utc_time": "2026-11-22 09:30:05.001",
        "status_word": "0x09800006",
        "rotation_matrix": "1.00  0.00  0.00  0.00  0.00 -1.00  0.00  1.00  0.00",
        "trigger_in1": "line=9 polarity=1 timestamp=1.234567s frame=3",
        "gnss_sat_info": "2 satellites, 40 to 40 dBHz",
        "0xC2A0": "01 FF",
        "0xC2B0": "empty",
    }
    date[-1] = 3
    assert shown_values(encode_sample({"utc_time": date})) == {
        "utc_time": "2026-11-22 09:30:05.001 not valid"
    }


def test_every_quantity_has_text() -> None:
    """Every quantity of a recording has text and JSON."""
    data = b"".join(
        encode_sample({name: example(row)}) for name, row in xbus.protocol.tables.QUANTITIES.items()
    )
    model = known(data)
    assert {name for name, _ in model.quantities} == set(xbus.protocol.tables.QUANTITIES)
    assert all(value_row[3] for value_row in value_rows(model))
    facts = json.loads(json.dumps(snapshot_dict(model), allow_nan=False))
    assert len(facts["quantities"]) == len(xbus.protocol.tables.QUANTITIES)


def example(row: xbus.protocol.tables.Quantity) -> Any:
    if row.kind == "list":
        return [1] * len(row.fields), [[2] * len(row.entry)]
    if row.kind == "struct":
        return [1] * len(row.fields)
    return np.ones(row.numbers).tolist() if row.kind in ("real", "f4") else [1] * row.numbers


@given(damaged_streams())
def test_any_stream_can_be_shown(data: bytes) -> None:
    """Streams hold any NaN, impossible dates and unknown identifiers; warnings are errors here."""
    model = known(data)
    for columns in (30, 80, 200):
        assert len(lines(model, ViewState(), columns)) == 24
    assert snapshot_text(model)
    json.dumps(snapshot_dict(model), allow_nan=False)


def test_several_devices_are_reported() -> None:
    """Their rates and values are mixed."""
    frames = [encode_sample({"temperature": 20.0}, bid=bid) for bid in (0xFF, 1)]
    model = known(b"".join(frames))
    assert not model.events
    model.add_block(read_log(encode_sample({"temperature": 20.0}, bid=2)), 1.0)
    model.add_block(read_log(b"".join(frames)), 2.0)
    (event,) = model.events
    assert event.text == (
        "samples of several devices (BID 1, 2) are shown as those of one; values and rates mix them"
    )
    assert event.is_bad


def test_one_of_several_devices(tmp_path: Path) -> None:
    path = tmp_path / "bus.mtb"
    frames = [encode_sample({"temperature": 10.0 * bid}, bid=bid) for bid in (0xFF, 2)]
    path.write_bytes(b"".join(frames * 10))
    for bid, temperature in (("1", 2550.0), ("2", 20.0)):
        result = run("monitor", str(path), "--once", "1", "--json", "--bid", bid)
        (shown,) = json.loads(result.stdout)["quantities"]
        assert shown["value"] == temperature
    result = run("monitor", str(path), "--once", "1")
    assert "are shown as those of one; --bid N shows one of them" in result.stdout
    result = run("monitor", str(path), "--once", "1", "--bid", "3")
    assert result.exit_code == 1
    assert "no samples of device 3; the log has those of BID 255, 2" in result.stderr
    with socket.create_server(("127.0.0.1", 0)) as server, ThreadPoolExecutor(1) as pool:
        done = threading.Event()

        def send() -> None:
            connection, _ = server.accept()
            with connection, contextlib.suppress(ConnectionError):
                while not done.wait(0.02):
                    connection.sendall(b"".join(frames))

        sent = pool.submit(send)
        port = f"socket://127.0.0.1:{server.getsockname()[1]}"
        result = run("monitor", port, "--listen", "--once", "1", "--json", "--bid", "2")
        done.set()
        sent.result()
    (shown,) = json.loads(result.stdout)["quantities"]
    assert shown["value"] == 20.0


def words(model: Model) -> dict[str, str]:
    return {status_row.label: status_row.text for status_row in status_rows(model, UNICODE)}


def test_status_by_name() -> None:
    word = 1 << 8 | 1 << 19 | 3 << 23
    sample = {"packet_counter": 1, "status_word": word}
    printed = words(known(encode_sample(sample | {"quaternion": [1, 0, 0, 0]})))
    assert printed["status"] == "filter not valid clip_acc_x clipping filter_mode=3"
    # A device without a filter does not report it as invalid.
    printed = words(known(encode_sample(sample)))
    assert printed["status"] == "clip_acc_x clipping filter_mode=3"
    assert "GNSS" not in printed
    assert printed["losses"] == "no samples lost  no damage  queue empty"
    printed = words(known(encode_sample({"status_byte": 0b111})))
    assert printed["status"] == "selftest filter_valid gnss_fix"


def test_gnss() -> None:
    fields = {item.name: 0 for item in xbus.protocol.tables.QUANTITIES["gnss_pvt_data"].fields}
    fields |= {"fixtype": 3, "flags": 2 << 6 | 1, "numSV": 18, "hAcc": 14, "vAcc": 1234}
    data = encode_sample({"gnss_pvt_data": fields})
    assert words(known(data))["GNSS"] == "3D  RTK fixed  18 SV  hAcc 14 mm  vAcc 1.2 m"
    model = known(data)
    model.now = 10.0
    assert words(model)["GNSS"] == "3D  RTK fixed  stopped"
    fields |= {"hAcc": 0xFFFF_FFFF, "vAcc": 0xFFFF_FFFF}
    shown = words(known(encode_sample({"gnss_pvt_data": fields})))["GNSS"]
    assert shown == "3D  RTK fixed  18 SV  hAcc unknown  vAcc unknown"
    fields["flags"] &= ~1
    shown = words(known(encode_sample({"gnss_pvt_data": fields})))["GNSS"]
    assert shown.startswith("3D, no valid position  RTK fixed")


def test_an_outdated_orientation_is_not_shown() -> None:
    model = known(encode_sample({"quaternion": [1, 0, 0, 0]}))
    assert words(model)["heading"] == "090° E  pitch 0.0° up  roll 0.0° right"
    model.now = 3.0
    assert words(model)["heading"] == "no attitude for 3 s"
    assert model.attitude is None


# The screen


def lines(
    model: Model, view: ViewState, columns: int = 80, height: int = 24, encoding: str = "utf-8"
) -> list[str]:
    file = io.TextIOWrapper(io.BytesIO(), encoding)
    console = Console(file=file, width=columns, height=height)
    options = console.options.update(height=height)
    rendered = console.render_lines(Screen(model, view), options)
    return ["".join(segment.text for segment in line) for line in rendered]


def trimmed(model: Model, view: ViewState, columns: int = 80, height: int = 24) -> list[str]:
    return [line.rstrip() for line in lines(model, view, columns, height)]


@pytest.fixture(scope="module")
def field() -> Model:
    """Returns the model at the end of the damaged recording."""
    source = ReplaySource(FIELD)
    model = source.model()
    while not source.is_over:
        source.advance(model)
    return model


def test_the_main_view_fits_80_by_24(field: Model) -> None:
    """The view shows all quantities of an MTi-680G, and all losses and errors."""
    screen = trimmed(field, ViewState(), 80, 24)
    text = "\n".join(screen)
    for name, _ in field.quantities:
        assert f"\n{name} " in text
    for item in (
        "heading 000° N  pitch 0.3° up  roll 0.2° left",
        "GNSS    3D  RTK float  19 SV  hAcc 14 mm  vAcc 19 mm",
        "23 samples lost in 12 gaps  1,816 bytes damaged",
        "9 checksum errors",
        "Error 41: more data than the baud rate can",
        "filter_valid",
        "q quit",
    ):
        assert item in text
    assert "▄▄---▄+▄---▄▄" in text
    assert not any("…" in item for item in screen[7:])


@pytest.mark.parametrize("columns", [1, 2, 7, 20, 40, 79, 80, 81, 97, 132, 300])
def test_any_size(field: Model, columns: int) -> None:
    pages = (
        ViewState(),
        ViewState(shows_help=True),
        ViewState("acc", is_typing=True),
        ViewState("acc"),
        ViewState("no such"),
        ViewState(first_row=99, is_paused=True),
    )
    for height in (1, 2, 3, 5, 7, 10, 13, 23, 24, 25, 40, 100):
        for view in pages:
            drawn = lines(field, view, columns, height)
            assert len(drawn) == height
            assert max(map(len, drawn)) <= columns


def test_a_long_name_leaves_room_for_the_state() -> None:
    model = Model(
        "/dev/serial/by-id/usb-Xsens_MTi_Converter_0123456789-if00-port0", state=State.MEASUREMENT
    )
    title = trimmed(model, ViewState(is_paused=True), 80, 24)[0]
    assert title.startswith(" …ter_0123456789-if00-port0  PAUSED  Measurement State")


def test_a_small_screen_omits_parts(field: Model) -> None:
    first = trimmed(field, ViewState(), 80, 20)
    head = next(item for item in first if item.startswith("quantity"))
    assert head.endswith("4 below: arrow keys")
    assert not any(item.startswith("gnss_pvt_data") for item in first)
    last = trimmed(field, ViewState(first_row=99), 80, 20)
    assert any("4 above: arrow keys" in item for item in last)
    assert last[-2].startswith("gnss_pvt_data")


def test_filter(field: Model) -> None:
    drawn = trimmed(field, ViewState("ACC"), 80, 24)
    names = [
        entry.split()[0]
        for entry in drawn[drawn.index(next(item for item in drawn if "rate/Hz" in item)) :]
        if entry
    ]
    assert names == ["quantity", "acceleration", "filter"]


def test_ascii(field: Model) -> None:
    assert all(line.isascii() for line in lines(field, ViewState(), 60, 24, "ascii"))
    assert all(line.isascii() for line in lines(field, ViewState(), 120, 24, "ascii"))


def test_the_help_page_lists_all_events(field: Model) -> None:
    text = "\n".join(trimmed(field, ViewState(shows_help=True), 80, 24))
    assert "Events, the latest first" in text
    assert "0:00:04   Error 41: more data than the baud rate can carry" in text


def test_keys() -> None:
    assert parse_keys("q\x1b[B\x1b[5~\x7f\r") == ["q", "down", "page up", "backspace", "enter"]
    # Home, F5 and Alt-x mean nothing, and are not taken for letters.
    assert parse_keys("\x1b[H\x1b[15~p") == ["p"]
    assert parse_keys("\x1bOA\x1b") == ["up", "escape"]


# Sources


def test_a_replay_counts_what_read_log_finds() -> None:
    for path in (WALK, FIELD):
        source = ReplaySource(path)
        model = source.model()
        while not source.is_over:
            source.advance(model)
        log = read_log(path)
        assert {name: state.count for (name, _), state in model.quantities.items()} == {
            str(name): len(log[name]) for name in log
        }
        stats = log.stats
        assert model.counts.samples == stats.samples
        assert model.counts.lost_samples == stats.lost_samples
        assert model.counts.skipped_bytes == stats.skipped_bytes
        assert model.counts.checksum_errors == stats.checksum_errors
        assert model.elapsed == pytest.approx(log.duration, abs=0.02)
        assert model.progress == 1.0
    assert [event.text for event in model.events] == [
        "Error 41: more data than the baud rate can carry"
    ]


def test_two_devices_play_at_the_pace_of_the_first(tmp_path: Path) -> None:
    path = tmp_path / "bus.mtb"
    path.write_bytes(
        b"".join(
            mtdata2(counter(row), fine(100 * row + start), bid=bid)
            for row in range(50)
            for bid, start in ((1, 0), (2, 900_000))
        )
    )
    source = ReplaySource(str(path))
    model = source.model()
    while not source.is_over:
        source.advance(model)
    assert model.counts.samples == 100
    assert model.elapsed == pytest.approx(0.49, abs=0.02)


@pytest.mark.parametrize("speed", [1.0, 4.0])
def test_a_recording_plays_at_its_recorded_pace(
    monkeypatch: pytest.MonkeyPatch, speed: float
) -> None:
    now = 50.0
    monkeypatch.setattr("time.monotonic", lambda: now)
    source = ReplaySource(WALK, speed)
    model = source.model()
    while not source.is_over:
        wait = source.wait()
        assert wait * speed < 0.2
        now += wait
        source.advance(model)
        assert (now - 50.0) * speed == pytest.approx(model.elapsed)
    assert source.wait() == math.inf


def test_a_paused_recording_loses_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    now = 50.0
    monkeypatch.setattr("time.monotonic", lambda: now)
    source = ReplaySource(WALK)
    wait = source.wait()
    source.pause()
    assert source.wait() == math.inf
    now += 1000
    source.pause()
    assert source.wait() == pytest.approx(wait)


def test_pauses_of_a_recording(tmp_path: Path) -> None:
    """A pause lasts 10 s at most, and a step back takes no time; without time stamps the rate is 100 Hz."""
    stamps = [0, 10_000, 5_000_000, 4_000_000, 4_010_000]
    path = tmp_path / "log.mtb"
    path.write_bytes(b"".join(encode_sample({"sample_time_fine": stamp}) for stamp in stamps))
    source = ReplaySource(str(path))
    model = source.model()
    while not source.is_over:
        source.advance(model)
    assert model.elapsed == pytest.approx(1 + 10 + 0 + 1)
    path.write_bytes(encode_sample({"temperature": 20}) * 500)
    source = ReplaySource(str(path))
    model = source.model()
    while not source.is_over:
        source.advance(model)
    assert model.elapsed == pytest.approx(4.99)


def test_a_new_file_never_has_an_existing_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Clock(datetime.datetime):
        @classmethod
        def now(cls, tz: datetime.tzinfo | None = None) -> Clock:
            return cls(2026, 11, 22, 9, 30, 5)

    monkeypatch.setattr(device_source, "datetime", Clock)
    monkeypatch.chdir(tmp_path)
    names = [device_source._new_file().name for _ in range(3)]
    assert names == [f"xbus-20261122-093005{name}.mtb" for name in ("", "-2", "-3")]


def live(sim: SimulatedDevice) -> tuple[DeviceSource, Model, xbus.Device]:
    device = xbus.connect(sim)
    source = DeviceSource(device, reconnect=True)
    return source, source.model(), device


def test_recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    source, model, device = live(SimulatedDevice("MTi-680G"))
    for _ in range(2):
        source.toggle_recording(model)
        for _ in range(10):
            source.advance(model)
        assert model.recording is not None
        assert model.device == "MTi-680G-8A1G6"
        source.toggle_recording(model)
        assert model.recording is None
    source.close(model)
    assert device.state == State.MEASUREMENT
    files = sorted(tmp_path.glob("*.mtb"))
    assert {recording.file for recording in source.recordings} == {file.name for file in files}
    assert all(len(read_log(file)) > 90 for file in files)
    assert len(files) == 2


def test_a_recording_that_cannot_start_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    source, model, _ = live(SimulatedDevice("MTi-680G"))
    gone = tmp_path / "gone"
    gone.mkdir()
    monkeypatch.chdir(gone)
    gone.rmdir()
    source.toggle_recording(model)
    assert model.recording is None
    assert model.events[-1].text.startswith("no recording: ")
    # The device did not answer: no empty file is left behind.
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(
        xbus.Device,
        "record",
        lambda *_: (_ for _ in ()).throw(xbus.XbusTimeout("no answer", None, 0.5)),
    )
    source.toggle_recording(model)
    assert model.events[-1].text == "no recording: no answer"
    assert list(tmp_path.iterdir()) == []


class FullDisk:
    """A recording that ended because of a full disk."""

    files = ("full.mtb",)
    bytes = 1234
    error = "No space left on device"
    is_active = False

    def stop(self) -> None:
        raise OSError(self.error)


def test_a_recording_that_ends_by_itself_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(xbus.Device, "record", lambda *_: FullDisk())
    source, model, _ = live(SimulatedDevice("MTi-680G"))
    source.toggle_recording(model)
    assert model.recording is None
    printed = "recorded 1,234 bytes in full.mtb; the recording ended early: No space left on device"
    assert (model.events[-1].text, model.events[-1].is_bad) == (printed, True)
    assert [str(recording) for recording in source.recordings] == [printed]


def test_a_block_counts_the_stream_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Twenty times a second, this is a good part of what an idle studio does."""
    source, model, _ = live(SimulatedDevice("MTi-630"))
    reads = []

    def counted(*counts: Any) -> LiveStats:
        reads.append(live_stats(*counts))
        return reads[-1]

    monkeypatch.setattr("xbus.device.device.live_stats", counted)
    for _ in range(5):
        source.advance(model)
    assert len(reads) == 5
    assert source.stats is reads[-1]


@pytest.mark.parametrize("pause", [0.2, 3.0])
def test_a_pause_on_purpose_makes_no_rate_low(pause: float) -> None:
    source, model, device = live(SimulatedDevice("MTi-630"))
    rates = []

    def watch() -> None:
        for _ in range(70):
            source.advance(model)
            rates.append(model.quantities["quaternion", "ENU"].rate(model.now))

    watch()
    with device.configure():
        device.link.pause(pause)
    watch()
    measured = [rate for rate in rates if rate is not None]
    assert len(measured) > 120
    assert min(measured) == pytest.approx(100, rel=0.03)


@pytest.mark.parametrize("measured", [True, False])
def test_a_device_is_left_as_it_was_found(measured: bool) -> None:
    sim = SimulatedDevice("MTi-630")
    xbus.connect(sim).go_to_config()
    source, model, _ = live(sim)
    source.advance(model)
    assert str(model.state) == "config"
    assert model.quantities == {}
    if measured:
        source.start_measurement(model)
        source.advance(model)
        assert str(model.state) == "measurement"
        assert model.quantities
    source.close(model)
    assert sim.state == State.CONFIG


def test_monitoring_sends_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    sim = SimulatedDevice("MTi-630")
    source, model, device = live(sim)
    written: list[bytes] = []
    monkeypatch.setattr(device.link, "write", written.append)
    for _ in range(20):
        source.advance(model)
    source.close(model)
    assert written == []
    assert model.counts.samples > 150


def test_a_lost_port_is_waited_for() -> None:
    source, model, device = live(SimulatedDevice("MTi-630", faults=xbus.Faults(unplug=(2.0, 3.0))))
    printed = set()
    while device.link.clock() < 8:
        source.advance(model)
        printed.add(model.is_lost)
        if model.is_lost and model.now - 2.0 > 2:
            assert next(iter(model.quantities.values())).rate(model.now) == 0
    assert printed == {True, False}
    assert not model.is_lost
    assert model.state == State.MEASUREMENT
    texts = [event.text for event in model.events]
    assert "the port is gone; check the cable" in texts
    assert "the port is back after 3 s" in texts


def test_counts_start_with_the_monitor() -> None:
    device = xbus.connect(SimulatedDevice("MTi-630"))
    for _ in range(30):
        device.read_sample()
    source = DeviceSource(device, reconnect=True)
    model = source.model()
    assert model.counts.samples == 0
    for _ in range(5):
        source.advance(model)
    assert 40 < model.counts.samples < 60


# The command


def test_once() -> None:
    printed = run("monitor", "sim:MTi-680G", "--once", "3").stdout.splitlines()
    assert printed[0].startswith("sim:MTi-680G  Measurement State  115200 baud  MTi-680G-8A1G6  3.")
    assert printed[1].startswith("heading ")
    head = next(at for at, line in enumerate(printed) if line.startswith("quantity "))
    found = {item.split()[0]: item.split()[1] for item in printed[head + 1 :]}
    assert found["packet_counter"] == found["quaternion"] == "100.0"
    assert printed == run("monitor", "sim:MTi-680G", "--once", "3").stdout.splitlines()


def test_once_of_a_recording() -> None:
    facts = json.loads(run("monitor", WALK, "--once", "5", "--json").stdout)
    assert facts["seconds"] == pytest.approx(5, abs=0.2)
    assert facts["product_code"] == "MTi-680G-8A1G6"
    assert (facts["state"], facts["baudrate"]) == (None, None)
    log = read_log(WALK)
    found = {fact["name"]: fact for fact in facts["quantities"]}
    assert list(found) == list(log)
    at = found["acceleration"]["count"] - 1
    expected = dict(zip("xyz", log["acceleration"].values[at].tolist(), strict=True))
    assert found["acceleration"]["value"] == expected
    assert found["acceleration"]["rate_hz"] == pytest.approx(100)
    assert found["temperature"]["rate_hz"] == pytest.approx(1)
    assert facts["status"] == {"filter_valid": 1, "gnss_fix": 1, "filter_mode": 3, "rtk_status": 1}
    # A shorter recording is read to its end.
    assert json.loads(run("monitor", WALK, "--once", "99", "--json").stdout)["seconds"] < 11


def test_once_of_a_port_that_is_lost(behind: Any) -> None:
    port = behind(SimulatedDevice("MTi-630", faults=xbus.Faults(unplug=(2.0, 9.0))))
    printed = sentence(run("monitor", port, "--once", "5"))
    assert printed == "mti is gone: sim:MTi-630 was unplugged; check the cable"


def test_control_characters_of_a_file_are_not_printed(tmp_path: Path) -> None:
    text = b"\x1b[31mred\x07" + "\u202e".encode()
    path = tmp_path / "odd\x1b[2J.mtb"
    path.write_bytes(
        encode_frame(MessageId.Warning, b"\0\0\0\x1e" + text)
        + frame(0x0D, b"MTi\x1b[2J\x07 abcdef")
    )
    for args in (["--once", "1"], ["--once", "1", "--json"]):
        printed = run("monitor", str(path), *args).stdout
        assert all(item.isprintable() or item == "\n" for item in printed)


@pytest.mark.parametrize(
    ("args", "printed"),
    [
        (["sim:MTi-630"], "needs a terminal"),
        (["sim:MTi-630", "--json"], "--json requires --once"),
        (["sim:MTi-630", "--once", "0"], "x>0"),
        (["sim:MTi-630", "--once", "1", "--speed", "2"], "--speed is for a recording"),
        ([WALK, "--once", "1", "--baudrate", "9600"], "--baudrate is for a port"),
        (["sim:nonsense", "--once", "1"], "is not a port"),
    ],
)
def test_wrong_call(args: list[str], printed: str) -> None:
    result = run("monitor", *args)
    assert result.exit_code == 2
    assert printed in " ".join(result.output.split())


def test_unreadable_files_are_reported(tmp_path: Path) -> None:
    empty = tmp_path / "empty.mtb"
    empty.touch()
    assert sentence(run("monitor", str(empty), "--once", "1")).startswith("no Xbus frame in ")
    assert sentence(run("monitor", str(tmp_path / "no"), "--once", "1")).startswith("cannot open ")
