"""The content of a report, and its drawing in a browser."""

from __future__ import annotations

import base64
import functools
import json
import re
import shutil
import struct
from collections.abc import Callable, Iterator
from html.parser import HTMLParser
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings

import xbus
from conftest import OWN_CAPTURES, counter, damaged_streams, fine
from streams import mtdata2, packet, real
from xbus import MessageId, SimulatedDevice, encode_frame, encode_sample
from xbus.export.palette import ALARM, COLOURS
from xbus.report import Options, gather, plotly_js, write_report
from xbus.report.base_map import SERVER
from xbus.report.findings import findings, percent
from xbus.report.page import page

pytest.importorskip("plotly")

WALK, FIELD = OWN_CAPTURES / "walk.mtb", OWN_CAPTURES / "field.mtb"
#: Replaces plotly's JavaScript where nothing is drawn.
NO_PLOTLY = "var none = '</b>';"
EVIL = "</script><script>alert(1)</script><b>&"


class Page(HTMLParser):
    """A page, taken apart: tags, ids, links, the cells of tables, text, and the figures."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.ids: list[str] = []
        self.links: list[str] = []
        self.sources: list[str] = []
        self.rows: list[list[str]] = []
        self.texts: list[str] = []
        self._open: list[str] = []
        self.feed(text)
        found = re.search(r'id="figures">(.*?)</script>', text, re.DOTALL)
        assert found is not None
        self.figures: list[dict[str, Any]] = json.loads(found[1])

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        known = dict(attrs)
        self.tags.append(tag)
        if known.get("id"):
            self.ids.append(str(known["id"]))
        if tag == "a":
            self.links.append(str(known["href"]))
        self.sources += [
            str(known[name]) for name in ("src", "href") if name in known and tag != "a"
        ]
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th"):
            self.rows[-1].append("")
        if tag in ("script", "style", "td", "th"):
            self._open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        if self._open and self._open[-1] == tag:
            self._open.pop()

    def handle_data(self, data: str) -> None:
        if self._open and self._open[-1] in ("td", "th"):
            self.rows[-1][-1] += data
        if not {"script", "style"} & set(self._open):
            self.texts.append(data)

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.texts).split())

    def figure(self, name: str) -> dict[str, Any]:
        (found,) = [figure for figure in self.figures if figure["name"] == name]
        return found


def text_of(source: Any, title: str = "walk") -> str:
    return page(title, [(title, gather(source))], NO_PLOTLY)


@functools.lru_cache(maxsize=8)
def page_of(source: Any) -> Page:
    """The page of a recording. Many tests look at that of the same one."""
    return Page(text_of(source))


def array(data: dict[str, str]) -> npt.NDArray[Any]:
    return np.frombuffer(base64.b64decode(data["bdata"]), f"<{data['dtype']}")


def output(source: Any) -> list[str]:
    return [finding.text for finding in findings(gather(source))]


def samples(rows: int, **more: Any) -> list[bytes]:
    """Returns samples at 100 Hz; ``more`` has constant values, or functions of the row."""
    found = []
    for row in range(rows):
        values: dict[Any, Any] = {"packet_counter": row, "sample_time_fine": 100 * row}
        values |= {name: of(row) if callable(of) else of for name, of in more.items()}
        found.append(encode_sample(values))
    return found


def sample(row: int, *more: bytes, start: int = 0, bid: int = 0xFF) -> bytes:
    """Returns a sample at 100 Hz of a clock that starts at ``start`` s."""
    return mtdata2(counter(row), fine(10_000 * start + 100 * row), *more, bid=bid)


def utc(second: int) -> bytes:
    """Returns valid UTC, this long after 2026-11-22 09:30."""
    date = (0).to_bytes(4, "big") + (2026).to_bytes(2, "big")
    return packet(0x1010, date + bytes([11, 22, 9, 30, second, 7]))


# Findings


def test_a_good_recording() -> None:
    report = page_of(WALK)
    assert "No sample lost, no damage, no errors size 169,069 bytes" in report.text
    assert "MTi-680G-8A1G6, id 008000A1B2, firmware 1.12.0 build 30" in report.text
    assert "0 s is 2026-11-22 09:30:00.000 UTC" in report.text
    assert ["acceleration", "", "1,000", "100.0", "Float32", "m/s2", "0"] in report.rows
    assert ["filter profile", "0"] in report.rows
    assert ["MTData2 (samples)", "1,040"] in report.rows
    assert output(WALK) == []


def test_a_bad_recording() -> None:
    report = page_of(FIELD)
    first, *rest = output(FIELD)
    assert first == "23 samples lost in 12 gaps, 2.2 %; largest gap: 12 samples before 2.99 s"
    assert rest[:2] == [
        "1,816 bytes of damage in 12 places, 1.1 % of the bytes",
        "1 error from the device; the first: 41: more data than the baud rate can carry",
    ]
    assert "3 problems and 1 note in this recording" in report.text
    assert len(output(FIELD)) == 4
    assert ["4.90", "81,068", "Error", "41: more data than the baud rate can carry"] in report.rows
    assert ["2.99", "12", "294"] in report.rows
    assert ["3,713", "227", "checksum"] in report.rows
    events = report.figure("events")
    assert [data["name"] for data in events["data"]] == ["samples lost", "damage", "errors"]
    starts = array(events["data"][2]["x"])[::3]
    assert starts == pytest.approx([4.9])


def test_every_quantity_has_its_plots() -> None:
    report = page_of(WALK)
    log = xbus.read_log(WALK)
    names = [figure["name"] for figure in report.figures]
    for name in ("quaternion", "euler_angles", "acceleration"):
        data = report.figure(name)["data"]
        assert [curve["name"] for curve in data] == list(log[name].fields)
        for at, curve in enumerate(data):
            np.testing.assert_array_equal(array(curve["y"]), log[name].values[:, at])
            assert array(curve["x"]) == pytest.approx(log[name].time - log.time[0])
    assert report.figure("acceleration")["layout"]["yaxis"]["title"]["text"] == "acceleration, m/s2"
    start = np.datetime64("2026-11-22T09:30", "ms").astype(int)
    assert report.figure("acceleration")["clock"] == [[0, start, 1]]
    speed = report.figure("speed")["data"]
    assert [curve["name"] for curve in speed] == ["filter", "receiver"]
    north = log["velocity_xyz"].values[:, :2]
    assert array(speed[0]["y"]) == pytest.approx(np.hypot(*north.T), abs=1e-6)
    norm = report.figure("magnetic_field")["data"][3]
    assert norm["name"] == "norm"
    field = log["magnetic_field"].values
    assert array(norm["y"]) == pytest.approx(np.linalg.norm(field, axis=1), abs=1e-6)
    # Latitude and longitude are flat over time.
    assert not any("lat_lon" in name for name in names)
    assert {"baro_pressure", "temperature", "status", "steps", "track"} <= set(names)
    accuracy = report.figure("accuracy")
    assert accuracy["data"][0]["name"] == "horizontal"
    assert array(accuracy["data"][0]["y"]) == pytest.approx(log["gnss_pvt_data"].scaled["hAcc"])
    assert {"noise acceleration", "noise rate_of_turn"} <= set(names)
    assert len(names) == len(set(names)) == report.tags.count("figure")


def test_the_magnetic_field_is_judged() -> None:
    angle = np.linspace(0, 1, 500)
    around, up = 2 * np.pi * 37 * angle, np.pi * (angle - 0.5)
    field = np.stack([np.cos(around) * np.cos(up), np.sin(around) * np.cos(up), np.sin(up)], axis=1)
    field += [0.25, 0, 0]
    data = b"".join(samples(500, magnetic_field=lambda row: field[row].tolist()))
    report = page_of(data)
    assert "Disturbed: the norm deviates by" in report.text
    assert ["hard iron", "0.250, 0.000, 0.000 a.u."] in report.rows
    assert [text for text in output(data) if text.startswith("magnetic_field is disturbed: ")]
    drawn = report.figure("field magnetic_field")["data"]
    assert len(drawn) == 6
    recorded, corrected = (array(curve["x"]) for curve in drawn[:2])
    assert recorded - corrected == pytest.approx(np.full(500, 0.25), abs=0.01)
    # The walk goes straight on.
    assert "Not enough motion to judge: the device was hardly turned" in page_of(WALK).text
    assert not page_of(b"".join(samples(100, acceleration=[0, 0, 9.8]))).text.count("hard iron")


def test_links_have_targets() -> None:
    for file in (WALK, FIELD):
        report = page_of(file)
        assert len(report.ids) == len(set(report.ids))
        assert {link.removeprefix("#") for link in report.links} <= set(report.ids)
        assert {"timeline", "quantities", "acceleration", "track", "noise", "messages"} <= set(
            report.ids
        )


def test_two_coordinate_systems() -> None:
    data = b"".join(
        samples(30, temperature=20)
        + [encode_sample({("euler_angles", name): [1, 2, 3]}) for name in ("ENU", "NED")]
    )
    report = page_of(data)
    assert {"euler_angles", "euler_angles-NED"} <= set(report.ids) & {
        f["name"] for f in report.figures
    }


def test_a_rotation_matrix_has_nine_curves() -> None:
    data = b"".join(samples(5, rotation_matrix=lambda row: np.arange(9) + row))
    curves = page_of(data).figure("rotation_matrix")["data"]
    log = xbus.read_log(data)
    assert [curve["name"] for curve in curves] == list(log["rotation_matrix"].fields)
    values = log["rotation_matrix"].values.reshape(5, 9)
    assert [array(curve["y"]).tolist() for curve in curves] == values.T.tolist()


def test_lines_end_at_lost_samples() -> None:
    rows = samples(100, acceleration=lambda row: [row, 0, 9.81])
    report = page_of(b"".join(rows[:40] + rows[45:]))
    x = report.figure("acceleration")["data"][0]
    assert np.flatnonzero(np.isnan(array(x["y"]))).tolist() == [40]
    assert array(report.figure("events")["data"][0]["x"])[:2] == pytest.approx([0.39, 0.45])


def test_settings_of_the_recording_are_listed() -> None:
    messages = {
        MessageId.ReqGnssLeverArmAck: struct.pack(">3f", 0.1, 0, -0.2),
        MessageId.ReqOptionFlagsAck: bytes([0, 0, 0, 0x10]),
        MessageId.ReqOutputConfigurationAck: bytes.fromhex("40200064"),
    }
    frames = [encode_frame(mid, payload) for mid, payload in messages.items()]
    rows = page_of(b"".join(samples(30, temperature=1) + frames)).rows
    assert ["0.29", "ReqGnssLeverArmAck", "x=0.1 y=0 z=-0.2"] in rows
    assert ["0.29", "ReqOptionFlagsAck", "enable_ahs"] in rows
    outputs = "data_id=Acceleration,frequency=100"
    assert ["0.29", "ReqOutputConfigurationAck", outputs] in rows


def test_clipping_is_reported() -> None:
    word = 1 << 10 | 1 << 19 | 2
    rows = samples(100, status_word=lambda row: word if 20 <= row < 22 else 2)
    assert (
        output(b"".join(rows))[0]
        == "accelerometer z out of range in 2 % of the time, first at 0.20 s"
    )
    data = {item["name"]: item for item in page_of(b"".join(rows)).figure("status")["data"]}
    assert set(data) == {"filter_valid", "clip_acc_z", "clipping"}
    assert array(data["clip_acc_z"]["x"])[:2] == pytest.approx([0.2, 0.22])


def test_a_filter_that_is_not_valid() -> None:
    rows = samples(100, status_word=lambda row: 0 if row in (5, 7) else 2)
    text = "the orientation filter is not valid in 2 % of the time, last at 0.07 s"
    assert text in output(b"".join(rows))


def test_missing_time_and_counter_are_reported() -> None:
    rows = b"".join(encode_sample({"acceleration": [0, 0, index]}) for index in range(50))
    texts = output(rows)
    assert "no time stamps: the horizontal axis is the sample number" in texts
    assert any(text.startswith("no packet counter") for text in texts)
    report = page_of(rows)
    assert "No damage, no errors" in report.text
    assert "no packet counter to detect losses" in report.text
    figure = report.figure("acceleration")
    assert figure["layout"]["xaxis"]["title"]["text"] == "sample"
    assert array(figure["data"][2]["x"]).tolist() == list(range(50))


def test_the_counter_replaces_missing_time() -> None:
    rows = [encode_sample({"packet_counter": index, "temperature": index}) for index in range(50)]
    report = page_of(b"".join(rows[:20] + rows[25:]))
    curve = report.figure("temperature")["data"][0]
    assert array(curve["x"])[19:22].tolist() == pytest.approx([19, np.nan, 25], nan_ok=True)


def test_without_a_counter_pauses_are_found_by_time() -> None:
    rows = [
        encode_sample({"sample_time_fine": 100 * index, "temperature": 1}) for index in range(90)
    ]
    text = "1 pause in the time stamps of temperature, and no packet counter"
    assert output(b"".join(rows[:50] + rows[60:]))[0] == text


def test_nan_values_are_reported() -> None:
    rows = samples(30, acceleration=lambda row: [np.nan if row == 3 else 0, 0, 9.81])
    assert "1 value of acceleration NaN or infinite" in output(b"".join(rows))


def test_a_log_of_messages_only() -> None:
    report = page_of(encode_frame(MessageId.Error, b"\x29"))
    assert "no samples, only messages" in report.text


def test_an_empty_log() -> None:
    assert "no samples" in page_of(b"").text


def test_an_unknown_identifier() -> None:
    report = page_of(mtdata2(counter(1), fine(1), packet(0xF990, b"abc")))
    assert ["0xF990", "1", "3"] in report.rows
    assert "not decoded: 1 packet 0xF990, 3 bytes" in report.text


@pytest.mark.parametrize(
    ("part", "whole", "text"),
    [(0, 5, "0 %"), (1, 10**6, "less than 0.01 %"), (999, 1000, "99.9 %"), (1, 3, "33 %")],
)
def test_percent(part: int, whole: int, text: str) -> None:
    assert percent(part, whole) == text


@settings(max_examples=25)
@given(damaged_streams())
def test_any_stream_makes_a_page(data: bytes) -> None:
    """Damaged input makes a page with a plot for each figure and a target for each link."""
    whole = text_of(data)
    found = Page(whole)
    assert len(found.figures) == found.tags.count("figure")
    assert {link.removeprefix("#") for link in found.links} <= set(found.ids)


# Track


def test_a_track_in_metres() -> None:
    rows = samples(50, lat_lon=lambda row: [52 + row * 1e-5, 6.0] if row >= 10 else [0, 0])
    north = page_of(b"".join(rows)).figure("track")["data"][0]
    y = array(north["y"])
    # A degree of latitude is 111.27 km at 52 degrees; a position of zero is not a place.
    assert len(y) == 40
    assert y[-1] - y[0] == pytest.approx(39e-5 * 111_267, abs=0.2)
    assert array(north["x"]) == pytest.approx(0, abs=1e-3)


@pytest.mark.parametrize("name", ["position_ecef", "gnss_pvt_data"])
def test_other_sources_of_a_track(name: str) -> None:
    rows: dict[str, Any] = {"position_ecef": lambda row: [3_900_000, 468_000 + row, 5_000_000]}
    log = xbus.read_log(WALK)
    if name in rows:
        report = page_of(b"".join(samples(20, **rows)))
    else:
        report = page_of(WALK)
        assert len(log["gnss_pvt_data"]) == 40
    (track,) = [data for data in report.figure("track")["data"] if data["name"] == name]
    assert len(array(track["x"])) in (20, 40)
    assert np.ptp(array(track["x"])) > 1


def test_a_track_without_a_fix() -> None:
    rows = samples(50, lat_lon=[0, 0], status_word=0)
    assert "track" not in {figure["name"] for figure in page_of(b"".join(rows)).figures}
    assert "no GNSS fix in 100 % of the time" in output(b"".join(rows))


def test_a_receiver_without_a_fix_has_no_height() -> None:
    virtual = SimulatedDevice("MTi-680G", trajectory="drive", time_to_fix=3)
    with xbus.connect(virtual) as device, device.configure() as cfg:
        cfg.set_output_configuration({"sample_time_fine": None, "gnss_pvt_data": 4})
    virtual.advance(6)
    data = bytes(virtual.read())
    fixes = np.isin(xbus.read_log(data)["gnss_pvt_data"].values["fixtype"], (2, 3, 4))
    assert 0 < np.count_nonzero(fixes) < len(fixes)
    report = page_of(data)
    assert len(array(report.figure("height")["data"][0]["y"])) == np.count_nonzero(fixes)
    satellites = report.figure("gnss_pvt_data fix type and satellites")["data"][0]["y"]
    assert len(array(satellites)) == len(fixes)
    assert any(item.startswith("no GNSS fix in") for item in output(data))


def test_a_long_track_keeps_its_corners() -> None:
    corner = 7777
    rows = samples(20_000, lat_lon=lambda row: [52, 6 + 1e-3 * (row == corner) + 1e-9 * row])
    track = page_of(b"".join(rows)).figure("track")["data"][0]
    assert len(array(track["x"])) < 10_000
    at = int(np.argmax(array(track["x"])))
    assert array(track["customdata"])[at] == pytest.approx(corner / 100)


# Noise


def still(seconds: float, rate: int = 100) -> bytes:
    """Returns the output of a virtual MTi-630 that lies still."""
    virtual = SimulatedDevice("MTi-630", trajectory="still", noise=1)
    outputs = {"packet_counter": None, "sample_time_fine": None}
    with xbus.connect(virtual) as device, device.configure() as cfg:
        cfg.set_output_configuration({**outputs, "acceleration": rate, "rate_of_turn": rate})
    virtual.advance(seconds)
    return bytes(virtual.read())


def figures_of(report: Page, kind: str) -> list[list[str]]:
    at = next(at for at, row in enumerate(report.rows) if len(row) > 1 and row[1].startswith(kind))
    return report.rows[at + 1 : at + 4]


def test_noise_figures() -> None:
    data = still(120)
    report = page_of(data)
    log = xbus.read_log(data)
    for name, kind, factor in (
        ("rate_of_turn", "angle", np.degrees(60)),
        ("acceleration", "velocity", 60),
    ):
        rows = figures_of(report, kind)
        assert [row[0] for row in rows] == ["x", "y", "z"]
        for at, row in enumerate(rows):
            # The random walk of white noise follows from its standard deviation.
            walk = float(log[name].values[:, at].std()) / np.sqrt(log[name].rate) * factor
            assert float(row[1]) == pytest.approx(walk, rel=0.25)
            assert float(row[2]) == pytest.approx(-0.5, abs=0.15)
    assert "moved" not in report.text


def test_noise_of_the_longest_stretch() -> None:
    log = xbus.read_log(data := still(20))
    cut = data[: int(log.offset[500])] + data[int(log.offset[504]) :]
    rows, seconds = len(log) - 504, log.time[-1] - log.time[504]
    start = log.time[504] - log.time[0]
    text = f"{rows:,} rows at 100.00 Hz: {seconds:.2f} s from {start:.2f} s on, the longest of"
    assert f"{text} 2 stretches without a gap." in page_of(cut).text


def test_noise_of_a_moving_device() -> None:
    text = page_of(WALK).text
    assert "The device moved (standard deviation 0.418 rad/s)" in text


def test_too_little_for_noise() -> None:
    report = page_of(b"".join(samples(12, acceleration=[0, 0, 9.81])))
    assert "Too short: 12 rows without a gap" in report.text


def test_a_rate_that_is_not_uniform() -> None:
    times = [100 * index + 20 * (index % 2) for index in range(400)]
    rows = [encode_sample({"sample_time_fine": time, "acceleration": [0, 0, 1]}) for time in times]
    assert "The rate is not uniform: 50 % of the steps differ" in page_of(b"".join(rows)).text


# Escaping


def test_text_from_a_log_is_escaped() -> None:
    words = EVIL.encode()
    data = encode_frame(MessageId.Warning, bytes([0, 0, 0, 42]) + words) + WALK.read_bytes()
    text = text_of(data, EVIL + "\u202e\x1b[0m")
    report = Page(text)
    assert "alert" not in re.sub(re.escape("&lt;script&gt;alert(1)"), "", text)
    assert report.tags.count("script") == 3
    assert EVIL in report.text
    assert "\u202e" not in text
    assert "\x1b" not in text


def test_json_cannot_end_its_script() -> None:
    text = text_of(WALK)
    figures = text.partition('id="figures">')[2].partition("</script>")[0]
    assert "<br>" in json.loads(figures)[2]["data"][0]["hovertemplate"]
    assert "<" not in figures


def test_nothing_is_fetched() -> None:
    text = text_of(WALK)
    assert Page(text).sources == ["data:,"]
    assert "default-src 'none'" in text
    style = text.partition("<style>")[2].partition("</style>")[0]
    assert "url(" not in style
    assert "@import" not in style


# Map


def test_a_map_is_the_only_thing_that_is_fetched() -> None:
    data = gather(WALK, options=Options(base_map=True))
    text = page("walk", [("walk", data)], NO_PLOTLY)
    report = Page(text)
    assert "© OpenStreetMap contributors, © CARTO" in report.text
    assert f"img-src data: blob: {SERVER}" in text
    assert "default-src 'none'" in text
    assert SERVER not in text_of(WALK)
    images = report.figure("map")["layout"]["images"]
    assert all(image["source"].startswith(f"{SERVER}/rastertiles/voyager/18/") for image in images)
    # The tile that holds the start of the track.
    lat, lon = np.radians(xbus.read_log(WALK)["lat_lon"].values[0])
    number = 2**18
    column = int((lon / np.pi + 1) / 2 * number)
    row = int((1 - np.log(np.tan(lat) + 1 / np.cos(lat)) / np.pi) / 2 * number)
    (tile,) = [image for image in images if image["source"].endswith(f"/{column}/{row}.png")]
    x, y = (array(report.figure("map")["data"][-1][axis])[0] for axis in "xy")
    assert tile["x"] <= x < tile["x"] + tile["sizex"]
    assert tile["y"] - tile["sizey"] < y <= tile["y"]


def test_a_map_of_a_long_way_has_few_tiles() -> None:
    rows = samples(50, lat_lon=lambda row: [-60 + row, 170 + row])
    data = gather(b"".join(rows), options=Options(base_map=True))
    report = Page(page("way", [("way", data)], NO_PLOTLY))
    images = report.figure("map")["layout"]["images"]
    assert 4 <= len(images) <= 30
    numbers = [image["source"].removesuffix(".png").split("/")[-3:] for image in images]
    assert all(0 <= int(at) < 2 ** int(zoom) for zoom, *place in numbers for at in place)


def test_without_a_position_there_is_no_map() -> None:
    data = gather(b"".join(samples(50, temperature=1)), options=Options(base_map=True))
    assert SERVER not in page("rest", [("rest", data)], NO_PLOTLY)


# Several recordings


def test_recordings_side_by_side() -> None:
    short = b"".join(samples(50, acceleration=[0, 0, 1], free_acceleration=[0, 0, 0]))
    reports = [("walk.mtb", gather(WALK)), ("short.mtb", gather(short)), ("empty", gather(b""))]
    text = page("three", reports, NO_PLOTLY)
    report = Page(text)
    assert len(report.ids) == len(set(report.ids))
    assert {link.removeprefix("#") for link in report.links} <= set(report.ids)
    assert len(report.figures) == report.tags.count("figure")
    wanted = [figure for figure in report.figures if figure["name"] == "acceleration"]
    assert [figure["recording"] for figure in wanted] == [0, 1]
    assert [len(array(figure["data"][0]["x"])) for figure in wanted] == [1000, 50]
    # What only one recording has.
    heading = text.partition('id="free_acceleration"')[2].partition("</section>")[0]
    assert re.findall(r'class="of">([^<]*)', heading) == ["walk.mtb", "short.mtb", "empty"]
    assert heading.count("Not in this recording.") == 2
    # Paragraphs that all recordings share occur once.
    assert text.count("Overlapping Allan deviation.") <= 2
    # Each has its own verdict.
    for verdict in ("No sample lost, no damage, no errors", "no samples, only messages"):
        assert verdict in report.text


# The file


def test_a_page_of_a_file(tmp_path: Path) -> None:
    out = tmp_path / "walk.html"
    write_report(WALK, out)
    text = out.read_text("utf-8")
    assert "<title>walk.mtb</title>" in text
    assert text.count("plotly.js v") == 1
    assert len(text) < 15e6
    write_report(WALK.read_bytes(), out, title="yesterday")
    assert "<h1>yesterday</h1>" in out.read_text("utf-8")
    assert [path.name for path in tmp_path.iterdir()] == ["walk.html"]


def test_parts_make_the_same_page(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = page_of(FIELD)
    monkeypatch.setattr("xbus.report.BLOCK", 3000)
    parts = Page(text_of(FIELD))
    assert parts.text == whole.text
    assert parts.figures == whole.figures


# In a browser

#: A browser to take pictures with; `.ci/run drawing` installs one.
CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    if CHROMIUM is None:
        pytest.skip("no chromium")
    playwright = pytest.importorskip("playwright.sync_api")
    # There is no network: the page must not need any.
    args = ["--no-sandbox", "--disable-gpu", "--proxy-server=127.0.0.1:9"]
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=args)
        yield browser
        browser.close()


@pytest.fixture
def opened(browser: Any) -> Iterator[Callable[..., Any]]:
    """Opens a file, and returns the page once its plots are drawn. It must not complain."""
    tabs, complaints = [], []

    def open_file(path: Path, width: int = 1200) -> Any:
        tab = browser.new_page(viewport={"width": width, "height": 4000})
        # A violation of the content policy, such as a fetch, is a console message too.
        tab.on("console", lambda message: complaints.append(message.text))
        tab.on("pageerror", lambda error: complaints.append(str(error)))
        tab.goto(path.as_uri())
        tab.locator("body[data-drawn]").wait_for(timeout=60_000)
        tabs.append(tab)
        return tab

    yield open_file
    for tab in tabs:
        tab.close()
    assert complaints == []


def evil_page(folder: Path, *, spectra: bool = False) -> tuple[Path, list[dict[str, Any]]]:
    """Returns a page of a recording with all kinds of content, and the figures in the page."""
    data = encode_frame(MessageId.Warning, bytes([0, 0, 0, 42]) + EVIL.encode())
    (folder / "field.mtb").write_bytes(data + FIELD.read_bytes())
    out = folder / "field.html"
    write_report(folder / "field.mtb", out, title=EVIL, spectrum=spectra, spectrogram=spectra)
    return out, Page(out.read_text("utf-8")).figures


@pytest.mark.drawing
def test_a_browser_draws_every_curve(tmp_path: Path, opened: Callable[..., Any]) -> None:
    out, figures = evil_page(tmp_path, spectra=True)
    dom = opened(out).content()
    assert f'data-drawn="{len(figures)}"' in dom
    # Each plot draws as many curves as its figure has.
    plots = dom.split('class="plot js-plotly-plot"')[1:]
    assert len(plots) == len(figures)
    for plot, figure in zip(plots, figures, strict=True):
        if figure["name"].startswith("spectrogram"):
            assert '<g class="hm"><image' in plot
            continue
        _, *traces = plot.split('class="trace scatter')
        assert len(traces) == len(figure["data"]), figure["name"]
        for drawn, data in zip(traces, figure["data"], strict=True):
            # Each piece of a line and each dot is a path.
            assert re.search(r'\bd="M[-0-9.,]+[LVHA]', drawn), (figure["name"], data["name"])


@pytest.mark.parametrize("name", ["lat_lon", "position_ecef"])
def test_a_position_without_a_fix_is_not_in_the_track(name: str) -> None:
    position = {"lat_lon": (52.0, 4.0), "position_ecef": (3.9e6, 3.3e5, 5e6)}[name]
    valid, no_fix = 0b111, 0b011
    data = b"".join(
        encode_sample({"sample_time_fine": 100 * at, "status_word": status, name: position})
        for at, status in enumerate([valid, no_fix, 0, valid])
    )
    assert gather(data).tracks[name].rows == 2


@pytest.mark.drawing
def test_a_browser_shows_the_colours(tmp_path: Path, opened: Callable[..., Any]) -> None:
    imread = pytest.importorskip("matplotlib.image").imread
    out, _ = evil_page(tmp_path)
    opened(out).screenshot(path=tmp_path / "page.png")
    picture = imread(tmp_path / "page.png")
    flat = 255 * picture[..., :3].reshape(-1, 3)
    # The colours of curves, bands and problems.
    for colour in (*COLOURS[:3], ALARM):
        wanted = [int(colour[at : at + 2], 16) for at in (1, 3, 5)]
        near = np.abs(flat - wanted).max(axis=1) < 12
        assert np.count_nonzero(near) > 300, colour


@pytest.mark.drawing
@pytest.mark.parametrize("width", [360, 500, 800, 1600])
def test_every_mark_is_visible_at_every_width(
    width: int, tmp_path: Path, opened: Callable[..., Any]
) -> None:
    """Each gap, place of damage and error has a mark that is two pixels wide, however narrow the plot."""
    out = tmp_path / "page.html"
    write_report(FIELD, out)
    figures = Page(out.read_text("utf-8")).figures
    dom = opened(out, width).content()
    at = [figure["name"] for figure in figures].index("events")
    plot = dom.split('class="plot js-plotly-plot"')[1:][at]
    drawn = re.search(r'class="main-svg"[^>]* width="([0-9.]+)"', plot)
    assert drawn is not None
    assert 0.8 * min(width, 1200) < float(drawn[1]) <= width  # of a page of at most 1,200 pixels
    _, *traces = plot.split('class="trace scatter')
    gathered = gather(FIELD)
    expected = [len(gathered.lost), len(gathered.damage), len(gathered.events)]
    assert expected == [10, 11, 1]  # adjacent gaps are one band
    for trace, number in zip(traces, expected, strict=True):
        points = re.findall(r'<path class="point"[^>]*translate\(([-0-9.]+),[^>]*>', trace)
        assert len(points) == 2 * number  # both ends
        assert all(0 <= float(x) <= float(drawn[1]) for x in points)
        assert "stroke-width: 2px" in trace
        assert "stroke: rgb(214, 40, 40)" in trace


#: Zooms in one plot, prints, and reports the ranges of all plots.
VISITOR = """async () => {
  const plots = [...document.querySelectorAll(".plot")];
  const report = {};
  const ranges = () => plots.map((plot) => plot.layout.xaxis.range.map(Number));
  report.before = ranges();
  const zoom = async (from, to) => {
    const { ticktext } = plots[1].layout.xaxis;
    // A zoom has no effect while the plots still follow the one before.
    while (plots[1].layout.xaxis.ticktext === ticktext) {
      await Plotly.relayout(plots[0], { "xaxis.range[0]": from, "xaxis.range[1]": to });
      await new Promise((go) => setTimeout(go, 100));
    }
    return plots[1].layout.xaxis;
  };
  report.marks = [];
  for (const [from, to] of [[0, 0.05], [0, 4000], [0, 90000], [2, 3]]) {
    const { ticktext, title } = await zoom(from, to);
    report.marks.push([ticktext[0], ticktext[1], title.text]);
  }
  report.zoomed = ranges();
  dispatchEvent(new Event("beforeprint"));
  report.printed = plots.map((plot) => plot.layout.width);
  dispatchEvent(new Event("afterprint"));
  report.after = plots.map((plot) => plot.querySelector("svg").getBoundingClientRect().width > 900);
  return report;
}"""


@pytest.mark.drawing
def test_zoom_and_print_apply_to_all_plots(tmp_path: Path, opened: Callable[..., Any]) -> None:
    """A zoom in one plot over time applies to all of them; printed plots are as wide as the paper."""
    rows = [
        sample(
            row,
            real(0x4020, row % 7, 0, 9.8),
            real(0x0810, row),
            *([] if row % 100 else [utc(row // 100)]),
        )
        for row in range(1000)
    ]
    out = tmp_path / "page.html"
    text = page("page", [("page", gather(b"".join(rows)))], plotly_js())
    figures = Page(text).figures
    out.write_text(text, "utf-8")
    reported = opened(out).evaluate(VISITOR)
    for figure, before, zoomed in zip(figures, reported["before"], reported["zoomed"], strict=True):
        assert zoomed == ([2, 3] if figure["is_over_time"] else before), figure["name"]
        assert before != [2, 3]
    day = "below, UTC of 2026-11-22"
    assert reported["marks"] == [
        ["0.000<br>09:30:00", "0.005<br>09:30:00.005", f"time since the start, s; {day}"],
        ["0:00<br>09:30:00", "10:00<br>09:40:00", f"time since the start, min:s; {day}"],
        [
            "0:00:00<br>09:30:00",
            "3:00:00<br>12:30:00",
            f"time since the start, h:min:s; {day} to 2026-11-23",
        ],
        ["2.0<br>09:30:02", "2.1<br>09:30:02.100", f"time since the start, s; {day}"],
    ]
    assert set(reported["printed"]) == {700}
    assert set(reported["after"]) == {True}


# Restarts and several devices


def test_a_restarted_device_continues_the_axis() -> None:
    """After a restart, plots, gaps and events continue at the last sample."""
    error = encode_frame(MessageId.Error, bytes([41]))
    rows = [sample(index, start=500) for index in range(100)]
    rows += [encode_frame(MessageId.WakeUp)]
    rows += [sample(index, start=2) for index in (*range(50), *range(60, 100))]
    rows += [error, sample(100, start=2), sample(107, start=2)]
    log = b"".join(rows)
    gathered = gather(log)
    assert gathered.end == pytest.approx(2.07)
    assert gathered.gaps.rows["position"].tolist() == pytest.approx([1.6, 2.07])
    assert gathered.events.rows.tolist() == pytest.approx([1.99])
    assert [finding.text for finding in findings(gathered)][:3] == [
        "16 samples lost in 2 gaps, 7.7 %; largest gap: 10 samples before 1.60 s",
        "1 error from the device; the first: 41: more data than the baud rate can carry",
        "the device restarted 1 time; the time until it was back is unknown and not drawn",
    ]
    report = page_of(log)
    assert ["1.60", "10", "150"] in report.rows
    assert any(row[0] == "1.99" and row[2] == "Error" for row in report.rows)


def test_utc_goes_on_during_a_restart() -> None:
    """The axis shows no interruption, and UTC shows how long it took."""
    wake_up = encode_frame(MessageId.WakeUp)
    rows = [sample(0), sample(1, utc(1)), wake_up, sample(0), wake_up, sample(0, utc(20))]
    zero = np.datetime64("2026-11-22T09:30:00", "ns").astype(int)
    clock = gather(b"".join(rows)).clock
    assert [piece.start for piece in clock] == pytest.approx([0, 0.02, 0.03])
    expected = [zero + 990_000_000, None, zero + 20_000_000_000]
    assert [piece.utc for piece in clock] == expected


def test_two_devices() -> None:
    """Each has separate plots, on its own clock."""
    temperature = {bid: packet(0x0810, struct.pack(">f", 20 + bid)) for bid in (1, 2)}
    rows = [
        sample(row, temperature[bid], start=90 * bid, bid=bid)
        for row in range(100)
        for bid in (1, 2)
    ]
    gathered = gather(b"".join(rows))
    assert gathered.end == pytest.approx(0.99)
    (found,) = [finding for finding in findings(gathered) if "several" in finding.text]
    assert not found.is_bad
    assert found.text.startswith("samples of several devices (BID 1, 2), each drawn by its own")
    report = page_of(b"".join(rows))
    for bid in (1, 2):
        (trace,) = report.figure(f"temperature-BID{bid}")["data"]
        assert array(trace["y"]).tolist() == [20 + bid] * 100
        assert array(trace["x"]) == pytest.approx(np.arange(100) / 100)
    assert ["temperature", "", "200", "100.0", "Float32", "degC", "0"] in report.rows


def test_a_gap_of_one_of_two_devices() -> None:
    """It begins at the last sample of this device, not at that of the other."""
    rows = [
        sample(row, start=90 * bid, bid=bid)
        for row in range(100)
        for bid in (1, 2)
        if not (bid == 2 and 50 <= row < 60)
    ]
    gathered = gather(b"".join(rows))
    assert gathered.lost.start == pytest.approx([0.49])
    assert gathered.lost.end == pytest.approx([0.6])


@pytest.mark.parametrize("message", [b"", encode_frame(MessageId.WakeUp)])
def test_noise_is_that_of_one_run(message: bytes) -> None:
    """The Allan deviation of a device that restarted does not join two runs."""
    data = still(20)
    offset = xbus.read_log(data).offset
    once = message + data
    text = page_of(data[: int(offset[1500])] + once).text
    assert "2,000 rows at 100.00 Hz: 19.99 s from 15.00 s on, the longest of 2 stretches" in text


def test_noise_of_two_devices_is_apart() -> None:
    data = still(20)
    frames = [data[start:end] for start, end in pairwise([*xbus.read_log(data).offset, len(data)])]
    both = [xbus.encode_frame(one[2], one[4:-1], bid=bid) for one in frames for bid in (1, 2)]
    text = page_of(b"".join(both)).text
    assert text.count("rows at 100.00 Hz: 19.99 s from 0.00 s on, no gap.") == 4


def test_a_status_byte_beside_the_word_counts_once() -> None:
    """The byte repeats the word, so a sample with both counts once."""
    word, byte = packet(0xE020, (1 << 19 | 3).to_bytes(4, "big")), packet(0xE010, b"\3")
    both = gather(b"".join(sample(row, word, byte) for row in range(100)))
    assert both.status_rows == 100
    assert both.flags["filter_valid", 1].rows == 100
    alone = gather(b"".join(sample(row, byte) for row in range(100)))
    assert alone.status_rows == 100
    assert alone.flags["filter_valid", 1].rows == 100
