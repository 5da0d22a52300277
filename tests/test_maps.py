"""GPX, KML and GeoJSON, read back by gpxpy, fastkml and geojson."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import fastkml
import geojson
import gpxpy
import numpy as np
import pytest
from fastkml.gx import Track
from fastkml.utils import find_all

import xbus
from test_cli import WALK, run, sentence
from xbus import MessageId, encode_frame, encode_sample
from xbus.export.format import ExportError, export
from xbus.export.geojson import GeoJson
from xbus.export.gpx import Gpx
from xbus.export.kml import Kml
from xbus.export.track import TrackFormat
from xbus.log.part_file import export_parts
from xbus.protocol.tables import QUANTITIES

LOG = xbus.read_log(WALK)
FIXED = 0b110
#: The fields of a good fix at the equator.
PVT = {field.name: 0 for field in QUANTITIES["gnss_pvt_data"].fields} | {
    "valid": 7,
    "year": 2026,
    "month": 2,
    "day": 3,
    "hour": 4,
    "fixtype": 3,
    "flags": 1,
    "numSV": 11,
    "lat": 0,
    "lon": 0,
    "height": 60_000,
    "hMSL": 17_200,
    "hAcc": 1500,
    "vAcc": 2500,
    "hdop": 65,
    "vdop": 90,
    "pdop": 111,
}
UTC = {
    "ns": 250_000_000,
    "year": 2026,
    "month": 2,
    "day": 3,
    "hour": 4,
    "minute": 5,
    "second": 6,
    "valid": 7,
}


@pytest.fixture(autouse=True)
def _folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("geojson.geometry.DEFAULT_PRECISION", 15)


def receiver(*points: dict[str, Any]) -> xbus.Log:
    """A log of ``gnss_pvt_data``, one point each 0.25 s; the fields differ from `PVT`."""
    return xbus.read_log(b"".join(map(pvt, range(len(points)), points)))


def pvt(at: int, fields: dict[str, Any], bid: int = 0xFF, counter: int | None = None) -> bytes:
    values = PVT | {"sec": at // 4, "nano": at % 4 * 250_000_000, "lon": at * 1000} | fields
    values = {name: round(value) for name, value in values.items()}
    time = {"packet_counter": at if counter is None else counter, "sample_time_fine": 2500 * at}
    return encode_sample(time | {"gnss_pvt_data": values}, bid=bid)


def moving(at: int, bid: int = 0xFF, **quantities: Any) -> bytes:
    """A sample with a position of the filter in Float64, every 10 ms; None leaves a quantity out."""
    values: dict[Any, Any] = {"lat_lon": [52.0, at * 1e-5], "altitude_msl": 40.5} | quantities
    time = {"packet_counter": at, "sample_time_fine": 100 * at}
    values = time | {name: value for name, value in values.items() if value is not None}
    if "lat_lon" in values:
        values["lat_lon", "Float64"] = values.pop("lat_lon")
    return encode_sample(values, bid=bid)


def gpx(log: xbus.Log, **options: Any) -> list[list[Any]]:
    """The points of each segment."""
    log.to_gpx("out.gpx", **options)
    return [segment.points for track in read_gpx().tracks for segment in track.segments]


def read_gpx() -> Any:
    return gpxpy.parse(Path("out.gpx").read_text())


def features(log: xbus.Log, **options: Any) -> Any:
    log.to_geojson("out.geojson", **options)
    found = geojson.loads(Path("out.geojson").read_text())
    assert found.is_valid, found.errors()
    return found["features"]


def sizes(log: xbus.Log, **options: Any) -> list[int]:
    return [len(segment) for segment in gpx(log, **options)]


# ---------------------------------------------------------------------------------------------
# Values
# ---------------------------------------------------------------------------------------------


def test_gpx_of_the_filter() -> None:
    [points] = gpx(LOG)
    lat_lon = LOG["lat_lon"]
    assert [[point.latitude, point.longitude] for point in points] == lat_lon.values.tolist()
    assert [point.elevation for point in points] == LOG["altitude_ellipsoid"].values.tolist()
    stamps = np.array([point.time.replace(tzinfo=None) for point in points], "M8[ns]")
    np.testing.assert_array_equal(stamps, LOG.utc[lat_lon.sample])
    assert {point.type_of_gpx_fix for point in points} == {"dgps"}
    [track] = read_gpx().tracks
    assert track.name == "MTi-680G-8A1G6 008000A1B2"
    assert track.description == "Heights are above the WGS84 ellipsoid."


def test_gpx_of_the_receiver() -> None:
    [points] = gpx(LOG, source="gnss")
    rows = LOG["gnss_pvt_data"].scaled
    for point, row in zip(points, rows, strict=True):
        assert (point.latitude, point.longitude, point.elevation) == (
            row["lat"],
            row["lon"],
            row["hMSL"],
        )
        assert (point.satellites, point.horizontal_dilution) == (row["numSV"], row["hdop"])
        assert (point.vertical_dilution, point.position_dilution) == (row["vdop"], row["pdop"])
        assert point.geoid_height == pytest.approx(row["height"] - row["hMSL"])


def test_utc_of_the_receiver_is_that_of_its_message() -> None:
    """Not that of the sample, and only if its own validity bits are set."""
    data = encode_sample({"utc_time": UTC, "gnss_pvt_data": PVT | {"sec": 1, "nano": -1_000_000}})
    data += encode_sample({"utc_time": UTC, "gnss_pvt_data": PVT | {"valid": 3}})
    [points] = gpx(xbus.read_log(data))
    times = [point.time and point.time.isoformat() for point in points]
    assert times == ["2026-02-03T04:00:00.999000+00:00", None]


def test_heights_above_sea_level_are_preferred_in_gpx_and_kml() -> None:
    log = xbus.read_log(moving(0, altitude_ellipsoid=83.25) + moving(1, altitude_ellipsoid=83.25))
    [points] = gpx(log)
    assert [(point.elevation, point.geoid_height) for point in points] == [(40.5, 42.75)] * 2
    assert read_gpx().tracks[0].description is None
    log.to_kml("out.kml")
    assert "<altitudeMode>absolute" in Path("out.kml").read_text()
    assert "0.00001,52.0,40.5" in Path("out.kml").read_text()
    [feature] = features(log)
    assert feature["geometry"]["coordinates"] == [[0, 52, 83.25], [1e-5, 52, 83.25]]


def test_kml() -> None:
    LOG.to_kml("out.kml", source="gnss")
    [track] = kml_tracks()
    rows = LOG["gnss_pvt_data"].scaled
    assert [tuple(place) for place in track.coords] == rows[["lon", "lat", "hMSL"]].tolist()
    stamps = [item.when.dt.replace(tzinfo=None) for item in track.track_items]
    np.testing.assert_array_equal(np.array(stamps, "M8[ns]"), LOG["gnss_pvt_data"].datetime)
    text = Path("out.kml").read_text()
    assert text.count("<gx:value>dgps</gx:value>") == len(rows)
    assert text.count(f"<gx:value>{rows[0]['hAcc']}</gx:value>") == len(rows)


def test_kml_without_sea_level_is_on_the_ground() -> None:
    LOG.to_kml("out.kml")
    [track] = kml_tracks()
    assert track.altitude_mode.value == "clampToGround"
    assert [list(place) for place in track.coords] == LOG["lat_lon"].values[:, ::-1].tolist()


def kml_tracks() -> list[Any]:
    return list(find_all(fastkml.KML.parse("out.kml"), of_type=Track))


def test_geojson() -> None:
    [feature] = features(LOG, source="gnss")
    rows = LOG["gnss_pvt_data"].scaled
    assert feature["geometry"]["type"] == "LineString"
    assert feature["geometry"]["coordinates"] == [
        [row["lon"], row["lat"], row["height"]] for row in rows
    ]
    properties = feature["properties"]
    assert properties["name"] == "MTi-680G-8A1G6 008000A1B2"
    assert properties["satellites"] == rows["numSV"].tolist()
    assert properties["accuracy"] == rows["hAcc"].tolist()
    assert properties["coordTimes"][4] == "2026-11-22T09:30:01Z"


# ---------------------------------------------------------------------------------------------
# Points and segments
# ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("fields", "fix"),
    [
        ({"fixtype": 1}, None),
        ({"fixtype": 2}, "2d"),
        ({"fixtype": 3}, "3d"),
        ({"fixtype": 4}, "3d"),
        ({"flags": 0b11}, "dgps"),
        ({"flags": 0b0100_0001}, "dgps"),
        ({"flags": 0b1000_0001}, "dgps"),
        ({"fixtype": 0}, "none"),
        ({"fixtype": 5}, "none"),
        ({"fixtype": 6}, "none"),
        ({"flags": 0b10}, "none"),
        ({"lat": 90.1e7}, "none"),
        ({"lon": -180.1e7}, "none"),
    ],
    ids=str,
)
def test_fix_of_the_receiver(fields: dict[str, float], fix: str | None) -> None:
    """A position without a fix, or that is no place on Earth, is no point and ends the segment."""
    segments = gpx(receiver({}, fields, {}))
    found = [[point.type_of_gpx_fix for point in points] for points in segments]
    assert found == ([["3d"], ["3d"]] if fix == "none" else [["3d", fix, "3d"]])


@pytest.mark.parametrize(
    ("quantities", "expected"),
    [
        ({}, [5]),
        ({"status_word": FIXED}, [5]),
        ({"status_word": 0b100}, [2, 2]),
        ({"status_word": 0b10}, [2, 2]),
        ({"status_byte": 0b10}, [2, 2]),
        ({"lat_lon": [np.nan, 0]}, [2, 2]),
        ({"lat_lon": [0, np.inf]}, [2, 2]),
        ({"lat_lon": [-90.5, 0]}, [2, 2]),
        ({"lat_lon": [0, 180.5]}, [2, 2]),
        ({"lat_lon": None}, [4]),
        ({"lat_lon": [0, 0]}, [2, 2]),
        ({"altitude_msl": np.nan}, [5]),
    ],
    ids=str,
)
def test_fix_of_the_filter(quantities: dict[str, Any], expected: list[int]) -> None:
    samples = [moving(at, **(quantities if at == 2 else {})) for at in range(5)]
    assert sizes(xbus.read_log(b"".join(samples))) == expected


def test_the_fix_and_the_time_count_also_if_only_positions_are_chosen() -> None:
    names = ("ns", "year", "month", "day", "hour", "minute", "second", "valid")
    utc = dict(zip(names, (0, 2026, 11, 22, 9, 30, 1, 7), strict=True))
    samples = [moving(at, status_word=0b110 if at else 0, utc_time=utc) for at in range(5)]
    Path("log.mtb").write_bytes(b"".join(samples))
    for chosen in ([], ["--quantity", "lat_lon"]):
        result = run("decode", "log.mtb", "-o", "out.gpx", *chosen)
        assert "4 points" in result.stderr
        assert "1 unfixed position" in result.stderr
        assert all(point.time for point in read_gpx().tracks[0].segments[0].points)


def test_a_gap_and_a_restart_end_a_segment() -> None:
    samples = [moving(at) for at in range(10)]
    assert sizes(xbus.read_log(b"".join(samples[:4] + samples[5:]))) == [4, 5]
    wakeup = encode_frame(MessageId.WakeUp)
    assert sizes(xbus.read_log(b"".join([*samples[:4], wakeup, *samples[4:]]))) == [4, 6]
    # Also if the place of the gap is in a sample without a position.
    samples[5] = moving(5, lat_lon=None)
    assert sizes(xbus.read_log(b"".join(samples[:4] + samples[5:]))) == [4, 4]


def test_devices_have_a_track_each() -> None:
    samples = [moving(at, bid, altitude_msl=bid) for at in range(6) for bid in (1, 2)]
    samples.insert(7, encode_frame(MessageId.WakeUp, bid=2))
    identity = encode_frame(MessageId.DeviceID, bytes.fromhex("0080001E"), bid=2)
    log = xbus.read_log(b"".join([*samples, identity]))
    log.to_gpx("out.gpx")
    found = read_gpx().tracks
    assert [track.name for track in found] == ["MTi BID 1", "MTi 0080001E"]
    heights = [[{p.elevation for p in part.points} for part in track.segments] for track in found]
    assert heights == [[{1}], [{2}, {2}]]
    names = [feature["properties"]["name"] for feature in features(log)]
    assert names == ["MTi BID 1", "MTi 0080001E", "MTi 0080001E"]
    log.to_kml("out.kml")
    assert Path("out.kml").read_text().count("<Folder>") == 2


def test_a_name_from_the_wire_is_escaped() -> None:
    code = encode_frame(MessageId.ProductCode, b'<&"\x07 ]]>'.ljust(20))
    log = xbus.read_log(code + moving(0) + moving(1))
    log.to_gpx("out.gpx")
    log.to_kml("out.kml")
    fastkml.KML.parse("out.kml")
    assert read_gpx().tracks[0].name.startswith('<&"')
    assert features(log)[0]["properties"]["name"].startswith('<&"')


def test_points_without_utc_have_no_time() -> None:
    utc = [UTC | {"ns": 10_000_000 * at} if at > 2 else None for at in range(6)]
    log = xbus.read_log(b"".join(moving(at, utc_time=utc[at]) for at in range(6)))
    [points] = gpx(log)
    assert [point.time is None for point in points] == [True] * 3 + [False] * 3
    [feature] = features(log)
    assert feature["properties"]["coordTimes"][2:4] == [None, "2026-02-03T04:05:06.030Z"]
    log.to_kml("out.kml")
    text = Path("out.kml").read_text()
    assert (text.count("<LineString>"), text.count("<gx:Track>"), text.count("<when>")) == (1, 1, 3)
    Path("log.mtb").write_bytes(b"".join(moving(at) for at in range(3)))
    assert "3 points, 1 segment, 3 untimed points" in run("decode", "log.mtb", "-o", "a.kml").stderr


def test_antimeridian() -> None:
    points = [{"lon": lon * 1e7} for lon in (179.99, 179.998, -179.998, -179.99, 180, -180, 170)]
    log = receiver(*points)
    found = [feature["geometry"]["coordinates"] for feature in features(log)]
    lons = [[place[0] for place in line] for line in found]
    assert lons == [
        [179.99, 179.998, 180],
        [-180, -179.998, -179.99, -180],
        [180, 180, 180],
        [-180, -180, -180],
        [180, 170],
    ]
    times = features(log)[0]["properties"]["coordTimes"]
    assert times[-1] == "2026-02-03T04:00:00.375Z"
    assert [point.longitude for point in gpx(log)[0]][4] == -180


def test_one_point_is_no_line() -> None:
    [feature] = features(xbus.read_log(moving(0)))
    assert feature["geometry"] == {"type": "MultiPoint", "coordinates": [[0, 52]]}
    xbus.read_log(moving(0)).to_kml("out.kml")
    assert "<Point>" in Path("out.kml").read_text()


def test_thinning() -> None:
    log = xbus.read_log(b"".join(moving(at) for at in range(100)))
    lons = [[round(p.longitude * 1e5) for p in points] for points in gpx(log, every_seconds=0.25)]
    assert lons == [[0, 25, 50, 75]]
    # A point is 0.687 m east of the one before.
    [points] = gpx(log, every_metres=10)
    assert [round(p.longitude * 1e5) for p in points] == [0, 15, 30, 45, 60, 75, 90]
    assert sizes(log, every_metres=10, every_seconds=0.25) == [4]
    still = xbus.read_log(b"".join(moving(at, lat_lon=[52.0, 1.0]) for at in range(100)))
    assert sizes(still, every_metres=0.1) == [1]


def test_positions_in_ecef() -> None:
    data = moving(0, lat_lon=None, position_ecef=[6378137.0 + 10, 0.0, 0.0])
    [feature] = features(xbus.read_log(data))
    assert feature["geometry"]["coordinates"] == [[0, 0, 10]]


@pytest.mark.parametrize("options", [{}, {"every_metres": 2.0, "every_seconds": 0.05}], ids=str)
@pytest.mark.parametrize("track_format", [Gpx, Kml, GeoJson])
def test_the_parts_of_a_log_give_the_same_bytes(
    track_format: type[TrackFormat], options: dict[str, Any]
) -> None:
    """Of two devices with gaps, restarts, places without a fix and UTC that comes late."""
    data = bytearray()
    for at in range(300):
        for bid in (1, 2):
            if at % 50 == 7 * bid:
                data += encode_frame(MessageId.WakeUp, bid=bid)
            word = FIXED if at % 40 > bid else 0
            lat_lon = [52.0, (at * 0.004 + 179) % 360 - 360 * (at > 250)] if at % 9 else None
            utc = UTC | {"ns": 10_000_000 * (at % 100), "second": at // 100} if at > 99 else None
            if at % 31 != bid:
                data += moving(at, bid, status_word=word, lat_lon=lat_lon, utc_time=utc)
    data += encode_frame(MessageId.DeviceID, bytes.fromhex("0080001E"), bid=2)
    log, parts = xbus.read_log(data), xbus.split_log(bytes(data), block_bytes=500)
    counts = export(track_format(**options), log, [log], "whole")
    assert export_parts(parts, "parts", track_format(**options)) == counts
    assert min(counts.values()) > 10
    assert Path("whole").read_bytes() == Path("parts").read_bytes()


# ---------------------------------------------------------------------------------------------
# Refusals
# ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("data", "arguments", "message"),
    [
        (encode_sample({"temperature": 1.0}), [], "needs lat_lon, position_ecef or gnss_pvt_data"),
        (moving(0), ["--source", "gnss"], "needs gnss_pvt_data; xbus info"),
        (moving(0, status_word=0), [], "none of the 1 position (lat_lon) has a fix"),
        (
            moving(0, status_word=0) + pvt(1, {}),
            [],
            "none of the 1 position (lat_lon) has a fix; choose --source gnss, the receiver",
        ),
        (moving(0, lat_lon=[99, 0]), [], "no position (lat_lon) is a place on Earth; xbus info"),
    ],
    ids=["no positions", "no receiver", "no fix", "no fix of the filter", "no place"],
)
@pytest.mark.parametrize("suffix", ["gpx", "kml", "geojson"])
def test_refusals(data: bytes, arguments: list[str], message: str, suffix: str) -> None:
    Path("log.mtb").write_bytes(data)
    assert message in sentence(run("decode", "log.mtb", "-o", f"out.{suffix}", *arguments))
    assert [path.name for path in Path().iterdir()] == ["log.mtb"]


@pytest.mark.parametrize(
    "options", [{"source": "none"}, {"every_metres": 0}, {"every_seconds": -1}]
)
def test_wrong_options(options: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=next(iter(options))):
        LOG.to_gpx("out.gpx", **options)
    with pytest.raises(ExportError):
        xbus.read_log(b"").to_gpx("out.gpx")


def test_command() -> None:
    result = run(
        "decode", WALK, "-o", "out.gpx", "--source", "gnss", "--every-seconds", "1", "--json"
    )
    summary = json.loads(result.stdout)
    assert (summary["points"], summary["segments"], summary["omitted_points"]) == (10, 1, 30)
    assert (
        "--source applies to .gpx"
        in run("decode", WALK, "-o", "out.csv", "--source", "gnss").stderr
    )
