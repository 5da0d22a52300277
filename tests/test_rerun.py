"""Files for the viewer rerun, read by rerun itself."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import xbus
from test_cli import FIELD, WALK, run
from xbus.export.palette import COLOURS
from xbus.export.rerun.rrd import Rrd
from xbus.export.rerun.scene import Scene
from xbus.geometry.earth import geodetic_to_ecef
from xbus.geometry.quaternion import rotate
from xbus.log.part_file import export_parts
from xbus.protocol.tables import RESULT_CODES

rerun = pytest.importorskip("rerun")
chunk = pytest.importorskip("rerun.chunk")

TIMELINES = {"sample", "device_time", "utc", "host_time"}


def rrd_rows(path: Path) -> dict[str, list[dict[str, Any]]]:
    """The rows of each entity, in the order of their samples; those without times are first."""
    rows: dict[str, list[dict[str, Any]]] = defaultdict(list)
    for found in chunk.RrdReader(path).stream():
        if found.entity_path == "/__properties":
            continue
        batch = found.to_record_batch()
        # The pandas of the tests has no type for nanoseconds of a duration.
        columns = {
            name.removesuffix("rerun.controls.RowId"): array
            for name, array in zip(batch.schema.names, batch.columns, strict=True)
        }
        columns.pop("", None)
        values = {
            name: array.cast("int64") if name in TIMELINES else array
            for name, array in columns.items()
        }
        lists = {name: array.to_pylist() for name, array in values.items()}
        rows[found.entity_path] += [
            dict(zip(lists, row, strict=True)) for row in zip(*lists.values(), strict=True)
        ]
    for own in rows.values():
        own.sort(key=lambda row: row.get("sample", -1))
    return dict(sorted(rows.items()))


def written(log: xbus.Log, tmp_path: Path) -> dict[str, list[dict[str, Any]]]:
    log.to_rrd(tmp_path / "out.rrd")
    return rrd_rows(tmp_path / "out.rrd")


def values(rows: list[dict[str, Any]], component: str) -> Any:
    return [row[component] for row in rows if row.get(component) is not None]


def test_numbers_are_those_of_the_log(tmp_path: Path) -> None:
    log = xbus.read_log(WALK)
    rows = written(log, tmp_path)
    for name in (
        "acceleration",
        "rate_of_turn",
        "magnetic_field",
        "velocity_xyz_enu",
        "euler_angles_enu",
    ):
        column = log[name.removesuffix("_enu")]
        found = rows[f"/008000A1B2/{name}"]
        np.testing.assert_array_equal(values(found, "Scalars:scalars"), column.values)
        np.testing.assert_array_equal(values(found, "sample"), column.sample)
        device_time = np.array(values(found, "device_time"))
        np.testing.assert_array_equal(device_time, np.round(column.time * 1e9))
        utc = np.array(values(found, "utc"), "M8[ns]")
        np.testing.assert_array_equal(utc, log.utc[column.sample])


def quaternion_sample(coordinates: str) -> bytes:
    return xbus.encode_sample([(("quaternion", coordinates), (0.0, 1.0, 0.0, 0.0))])


@pytest.mark.parametrize(
    ("coordinates", "north", "up"),
    [("ENU", (0, 1, 0), (0, 0, 1)), ("NED", (1, 0, 0), (0, 0, -1)), ("NWU", (1, 0, 0), (0, 0, 1))],
)
def test_a_local_coordinate_system_lies_in_the_scene(
    tmp_path: Path, coordinates: str, north: tuple[int, ...], up: tuple[int, ...]
) -> None:
    rows = written(xbus.read_log(quaternion_sample(coordinates)), tmp_path)
    ((frame,),) = values(rows[f"/bid_1/{coordinates}"], "Transform3D:quaternion")
    rotation = np.array([frame[3], *frame[:3]])
    # The scene is ENU: y is north and z is up.
    np.testing.assert_allclose(rotate(rotation, np.array(north)), (0, 1, 0), atol=1e-6)
    np.testing.assert_allclose(rotate(rotation, np.array(up)), (0, 0, 1), atol=1e-6)
    ((labels,),) = [values(rows[f"/bid_1/{coordinates}/axes"], "Arrows3D:labels")]
    assert {"ENU": "east", "NED": "north", "NWU": "north"}[coordinates] == labels[0]
    # As recorded, with q0 last.
    sensor = rows[f"/bid_1/{coordinates}/sensor"]
    assert values(sensor, "Transform3D:quaternion") == [[[1.0, 0.0, 0.0, 0.0]]]


def test_a_sample_is_drawn_once_from_the_preferred_orientation(tmp_path: Path) -> None:
    quaternion, euler = (0.5, 0.5, 0.5, 0.5), (0.0, 0.0, 90.0)
    both = xbus.encode_sample({"quaternion": quaternion, "euler_angles": euler})
    one = xbus.encode_sample({"euler_angles": euler})
    rows = written(xbus.read_log(both + one), tmp_path)["/bid_1/ENU/sensor"]
    drawn = np.array(values(rows, "Transform3D:quaternion"))[:, 0]
    np.testing.assert_allclose(drawn, [[0.5] * 4, [0, 0, 0.5**0.5, 0.5**0.5]], atol=1e-6)


def sample(counter: int, ticks: int, status: int = 1, bid: int = 0xFF) -> bytes:
    packets = {"packet_counter": counter, "sample_time_fine": ticks, "status_word": status}
    return xbus.encode_sample(packets | {"temperature": 20.0}, bid=bid)


WAKE_UP, ERROR = xbus.encode_frame(0x3E, b""), xbus.encode_frame(0x42, b"\x1e")
CLIPPED, MARKER = 1 << 8, 1 << 22


def test_events(tmp_path: Path) -> None:
    log = xbus.read_log(
        sample(10, 1_000_000)
        + sample(14, 1_000_400, 1 | CLIPPED)
        + sample(15, 1_000_500, 1 | CLIPPED | MARKER)
        + b"noise"
        + WAKE_UP
        + sample(0, 500)
        + ERROR
    )
    rows = written(log, tmp_path)
    events = [
        (row["sample"], *row["TextLog:level"], *row["TextLog:text"])
        for path in ("/bid_1/events", "/events")
        for row in rows[path]
    ]
    offset = log.damage["offset"][0]
    assert events == [
        (0, "INFO", "status: selftest"),
        (1, "WARN", "3 samples lost in 1 gap"),
        (1, "WARN", "status: selftest, clip_acc_x"),
        (3, "WARN", "the device restarted"),
        (3, "INFO", "WakeUp"),
        (3, "INFO", "device_time is the clock of the device plus 100.0000 s"),
        (3, "INFO", "status: selftest"),
        (3, "ERROR", f"Error 30: {RESULT_CODES[30]}"),
        (3, "WARN", f"5 bytes of damage at byte {offset}: no preamble"),
    ]


def test_the_clock_goes_on_after_a_restart(tmp_path: Path) -> None:
    first = sample(0, 1_000_000) + sample(1, 1_000_100)
    log = xbus.read_log(first + WAKE_UP + sample(0, 500) + sample(1, 600))
    rows = written(log, tmp_path)["/bid_1/temperature"]
    assert [ns / 1e9 for ns in values(rows, "device_time")] == [100.0, 100.01, 100.01, 100.02]


def test_devices_have_paths_and_places_of_their_own(tmp_path: Path) -> None:
    names = [xbus.encode_frame(0x01, bytes([3, 0x80, 0, bid]), bid=bid) for bid in (1, 2)]
    log = xbus.read_log(b"".join(names) + sample(0, 1, bid=2) + sample(0, 1, bid=1))
    rows = written(log, tmp_path)
    places = {
        path: values(rows[path], "Transform3D:translation")[0][0][0]
        for path in rows
        if path.count("/") == 1 and path != "/events" and path != "/"
    }
    assert places == {"/03800001": 4.0, "/03800002": 0.0}
    assert values(rows["/03800001/temperature"], "sample") == [1]


def test_a_device_that_is_identified_late_has_its_name_in_all_parts(tmp_path: Path) -> None:
    samples = [sample(counter, 100 * counter) for counter in range(100)]
    data = b"".join([*samples[:90], xbus.encode_frame(0x01, bytes([3, 0x80, 0, 1])), *samples[90:]])
    parts = xbus.split_log(data, block_bytes=400)
    assert parts[0].read().devices[0].device_id is None
    export_parts(parts, tmp_path / "out.rrd", Rrd())
    rows = rrd_rows(tmp_path / "out.rrd")
    assert values(rows["/03800001/temperature"], "sample") == list(range(100))
    assert not [path for path in rows if path.startswith("/bid_")]


VALID, NO_FIX = 0b111, 0b011


def position_sample(at: int, status: int, **position: Any) -> bytes:
    time = {"packet_counter": at, "sample_time_fine": 10_000 * at, "status_word": status}
    return xbus.encode_sample(time | position)


@pytest.mark.parametrize("name", ["lat_lon", "position_ecef"])
def test_positions_with_a_fix_are_on_the_map(name: str, tmp_path: Path) -> None:
    """The same as in a GPX file."""
    gpxpy = pytest.importorskip("gpxpy")
    places = [(52.0, 4.0 + at / 100) for at in range(5)]
    lat, lon = np.array(places).T
    ecef = geodetic_to_ecef(lat, lon, 40.0)
    given = {"lat_lon": places, "position_ecef": ecef.tolist()}[name]
    states = [VALID, NO_FIX, VALID, 0, VALID]
    rows = zip(states, given, strict=True)
    data = [position_sample(at, state, **{name: place}) for at, (state, place) in enumerate(rows)]
    path = tmp_path / "log.mtb"
    path.write_bytes(b"".join([*data, position_sample(5, VALID, **{name: [0.0] * len(given[0])})]))
    assert run("decode", str(path), "--quantity", name, "-o", f"{path}.rrd").exit_code == 0
    found = rrd_rows(Path(f"{path}.rrd"))[f"/bid_1/{name}/position"]
    drawn = np.array(values(found, "GeoPoints:positions"))[:, 0]
    xbus.read_log(path).to_gpx(tmp_path / "log.gpx")
    (track,) = gpxpy.parse((tmp_path / "log.gpx").read_text()).tracks
    points = [(point.latitude, point.longitude) for point in track.walk(only_points=True)]
    np.testing.assert_allclose(drawn, points, atol=1e-9)
    assert values(found, "sample") == [0, 2, 4]


SOFTWARE_VULKAN = [*Path("/usr/share/vulkan/icd.d").glob("lvp_icd*.json")]


@pytest.mark.drawing
@pytest.mark.skipif(not SOFTWARE_VULKAN, reason="no software Vulkan (mesa-vulkan-drivers)")
def test_the_viewer_draws_a_recording(tmp_path: Path) -> None:
    """Without positions: for a map the viewer would request tiles from the network."""
    waves = np.sin(np.arange(200)[:, None] / 20 + [0, 2, 4])
    time = [{"packet_counter": at, "sample_time_fine": 100 * at} for at in range(200)]
    samples = [
        xbus.encode_sample(time[at] | {"acceleration": tuple(row), "euler_angles": (0, 0, 90)})
        for at, row in enumerate(waves.tolist())
    ]
    xbus.read_log(b"".join(samples)).to_rrd(tmp_path / "log.rrd")
    # A busy computer: the viewer may say that the file has no recording, and draw it the next time.
    pictures = (_drawn(tmp_path / "log.rrd", tmp_path) for _ in range(3))
    pixels = next((found for found in pictures if _curves(found).all()), None)
    assert pixels is not None
    # The axes of the sensor are red, green and blue, on the left.
    height, width, _ = pixels.shape
    attitude = pixels[height // 10 : height // 2, : width // 2]
    for colour in range(3):
        others = [other for other in range(3) if other != colour]
        assert (attitude[..., colour] - attitude[..., others].max(axis=-1) > 40).sum() > 5


def _drawn(path: Path, folder: Path) -> Any:
    """The pixels of the viewer that shows a file."""
    image = pytest.importorskip("PIL.Image")
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = str(free.getsockname()[1])
    picture = folder / "viewer.png"
    command = [sys.executable, "-m", "rerun", str(path), "--headless", "--port", port]
    # The software cannot draw a larger window.
    command += ["--window-size", "800x600", "--screenshot-to", str(picture)]
    own = {"WGPU_BACKEND": "vulkan", "XDG_RUNTIME_DIR": str(folder), "HOME": str(folder)}
    own["VK_ICD_FILENAMES"] = str(SOFTWARE_VULKAN[0])
    result = subprocess.run(  # noqa: S603
        command, env=os.environ | own, capture_output=True, text=True, timeout=300, check=False
    )
    assert result.returncode == 0, result.stderr
    return np.asarray(image.open(picture).convert("RGB")).astype(int)


def _curves(pixels: Any) -> Any:
    """Whether the curves of three colours are on the right."""
    series = pixels[:, pixels.shape[1] // 2 :]
    colours = [list(bytes.fromhex(text[1:])) for text in COLOURS[:3]]
    distances = [np.abs(series - colour).max(axis=-1) for colour in colours]
    return np.array([(distance < 12).sum() > 100 for distance in distances])


def test_the_layout_has_a_view_for_each_kind(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sent: list[Any] = []
    monkeypatch.setattr(
        rerun.RecordingStream, "send_blueprint", lambda _, blueprint: sent.append(blueprint)
    )
    xbus.read_log(WALK).to_rrd(tmp_path / "walk.rrd")
    left, right = sent[-1].root_container.contents
    rrb = rerun.blueprint
    kinds = [type(view) for view in left.contents]
    assert kinds == [rrb.Spatial3DView, rrb.MapView, rrb.TextLogView]
    (device,) = right.contents
    assert device.name == "008000A1B2"
    assert {type(view) for view in device.contents} == {rrb.TimeSeriesView}
    assert "acceleration, m/s2" in [view.name for view in device.contents]
    xbus.read_log(sample(0, 100)).to_rrd(tmp_path / "small.rrd")
    left, right = sent[-1].root_container.contents
    assert [type(view) for view in left.contents] == [rrb.TextLogView]


def test_accuracies_and_dilutions_have_plots_of_their_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    titles: dict[str, str] = {}

    def add_series(self: Scene, device: str, title: str, path: str, names: list[str]) -> None:
        titles[path.removeprefix(f"{device}/")] = title

    monkeypatch.setattr(Scene, "add_series", add_series)
    written(xbus.read_log(WALK), tmp_path)
    found = {name: titles[f"gnss_pvt_data/{name}"] for name in ("height", "hAcc", "hdop", "numSV")}
    assert found == {
        "height": "gnss_pvt_data, m",
        "hAcc": "gnss_pvt_data accuracy, m",
        "hdop": "gnss_pvt_data dilution of precision",
        "numSV": "gnss_pvt_data",
    }


def test_a_row_is_on_the_timelines_of_its_sample(tmp_path: Path) -> None:
    log = xbus.read_log(xbus.encode_sample({"temperature": 1.0}) + sample(0, 10_000))
    rows = [row for row in written(log, tmp_path)["/bid_1/temperature"] if "sample" in row]
    assert [row.keys() & TIMELINES for row in rows] == [{"sample"}, {"sample", "device_time"}]


def test_the_viewer_verifies_the_file(tmp_path: Path) -> None:
    path = tmp_path / "field.rrd"
    assert run("decode", FIELD, "-o", str(path)).exit_code == 0
    command = [sys.executable, "-m", "rerun", "rrd", "verify", str(path)]
    result = subprocess.run(command, capture_output=True, text=True, check=True)  # noqa: S603
    assert "verified without error" in result.stdout + result.stderr


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no full disk on this system")
def test_a_full_disk(tmp_path: Path) -> None:
    out = tmp_path / "out.rrd"
    out.symlink_to("/dev/full")
    result = run("decode", WALK, "-o", str(out))
    assert result.exit_code == 1
    assert result.stderr.endswith("free some space, or write to another disk\n")


def test_rerun_that_is_switched_off(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RERUN", "off")
    result = run("decode", WALK, "-o", str(tmp_path / "out.rrd"))
    assert result.exit_code == 1
    assert result.stderr == "xbus: the environment variable RERUN switches rerun off; unset it\n"
    assert not list(tmp_path.iterdir())
