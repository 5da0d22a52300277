"""The studio in a browser, with virtual devices."""

from __future__ import annotations

import gzip
import json
import re
import shutil
import signal
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import xbus
from xbus.sim import Faults

pytest.importorskip("nicegui", reason="the extra studio is not installed")
playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")

#: A page of each kind.
PAGES = (
    "",
    "live/sim-MTi-680G",
    "configure/sim-MTi-630",
    "record",
    "recordings",
    "rtk/sim-MTi-680G",
    "messages/sim-MTi-3",
)
#: A recording.
WALK = Path(__file__).parent / "captures" / "walk.mtb"
CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
PROGRAM = {"executable_path": CHROMIUM, "args": ["--no-sandbox"]}
pytestmark = [
    pytest.mark.drawing,
    pytest.mark.skipif(CHROMIUM is None, reason="no chromium"),
]


class Studio:
    """A running studio, and a page of it."""

    def __init__(self, page: Any, url: Any, folder: Any) -> None:
        self.page, self.url, self.folder = page, url, folder
        self.problems: list[str] = []
        page.on("pageerror", lambda error: self.problems.append(str(error)))

    def open(self, path: Any) -> None:
        self.page.goto(self.url + path)
        self.page.get_by_text("xbus studio").wait_for()


@pytest.fixture(scope="module")
def running(tmp_path_factory: Any) -> Any:
    folder = tmp_path_factory.mktemp("studio")
    command = [sys.executable, "-m", "xbus", "studio", "--demo", "--no-browser", "--port", "0"]
    process = subprocess.Popen(  # noqa: S603 - our own command
        [*command, "--folder", str(folder)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    assert process.stderr is not None
    line = process.stdout.readline()
    assert re.fullmatch(r"studio: http://127\.0\.0\.1:\d+/\n", line), process.stderr.read()
    yield line.split()[1], folder
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert errors == ""
    assert process.returncode == 0


@pytest.fixture(scope="module")
def chromium() -> Any:
    with playwright.sync_playwright() as driver:
        yield driver.chromium


@pytest.fixture(scope="module")
def tabs(chromium: Any, tmp_path_factory: Any) -> Any:
    """The browser of one user. Its profile keeps the scripts of the studio as compiled code."""
    window = {"width": 1280, "height": 900}
    profile = tmp_path_factory.mktemp("profile")
    with chromium.launch_persistent_context(profile, **PROGRAM, viewport=window) as tabs:
        tabs.set_default_timeout(60_000)
        yield tabs


@pytest.fixture
def studio(running: Any, tabs: Any) -> Any:
    url, folder = running
    page = tabs.new_page()
    outside = []
    page.on(
        "request",
        lambda request: (
            None
            if request.url.startswith((url, url.replace("http", "ws"), "data:", "blob:"))
            else outside.append(request.url)
        ),
    )
    opened = Studio(page, url, folder)
    yield opened
    # The next page of a device begins with what this one shows.
    resume = page.get_by_role("button", name="Resume")
    if resume.count():
        resume.click()
        page.get_by_role("button", name="Pause").wait_for()
    page.close()
    assert opened.problems == []
    assert outside == [], "the studio loads nothing from the internet"


def test_devices_are_listed_and_identified(studio: Any) -> None:
    studio.open("")
    for product in ("MTi-680G", "MTi-630", "MTi-3"):
        card = studio.page.locator(f".xbus-device-sim-{product}")
        assert card.inner_text().startswith(f"{product} ")
        assert "firmware" in card.inner_text()


def test_a_device_is_opened_tested_and_closed(studio: Any, tabs: Any) -> None:
    page = studio.page
    studio.open("")
    page.get_by_role("textbox", name="port or URL").fill("sim:MTi-300")
    page.get_by_role("button", name="Open the port or URL").click()
    card = page.locator(".xbus-device-sim-MTi-300")
    card.get_by_role("button", name="Self test").click()
    dialog = page.get_by_role("dialog")
    dialog.get_by_text("acc x: passed").wait_for()
    # The devices are drawn again when another page opens one; the dialog stays.
    other = tabs.new_page()
    other.goto(studio.url)
    other.get_by_role("textbox", name="port or URL").fill("sim:MTi-2")
    other.get_by_role("button", name="Open the port or URL").click()
    page.locator(".xbus-device-sim-MTi-2").wait_for(state="attached")
    other.locator(".xbus-device-sim-MTi-2").get_by_role("button", name="Close").click()
    page.locator(".xbus-device-sim-MTi-2").wait_for(state="detached")
    other.close()
    dialog.get_by_role("button", name="Close").click()
    card.get_by_role("button", name="Close").click()
    card.wait_for(state="detached")


def test_a_port_that_does_not_exist_is_one_sentence(studio: Any) -> None:
    page = studio.page
    studio.open("")
    page.get_by_role("textbox", name="port or URL").fill("/dev/ttyNOWHERE")
    page.keyboard.press("Enter")
    page.get_by_text(
        "cannot open /dev/ttyNOWHERE: No such file or directory; xbus ports lists"
    ).wait_for()


def test_a_closed_device_is_named_and_can_be_opened(studio: Any, tabs: Any) -> None:
    page = studio.page
    studio.open("configure/sim-MTi-10")
    page.get_by_text("sim:MTi-10 is not open.").wait_for()
    page.get_by_role("button", name="Open sim:MTi-10").click()
    page.get_by_text("as the device has it").wait_for()
    # Another page closes it.
    other = tabs.new_page()
    other.goto(studio.url)
    other.locator(".xbus-device-sim-MTi-10").get_by_role("button", name="Close").click(
        timeout=60_000
    )
    page.get_by_text("sim:MTi-10 is not open.").wait_for()
    other.close()
    studio.open("messages/dev-ttyNOWHERE")
    page.get_by_text("dev-ttyNOWHERE is not open.").wait_for()


def test_live_data_move(studio: Any) -> None:
    page = studio.page
    studio.open("live/sim-MTi-630")
    page.locator(".xbus-chart canvas").first.wait_for()
    assert page.locator(".xbus-chart").count() == 3
    # What is drawn changes from one frame to the next, and the table has values.
    pixels = "() => document.querySelector('.xbus-chart canvas').toDataURL()"
    before = page.evaluate(pixels)
    page.wait_for_function(f"before => ({pixels})() !== before", arg=before)
    horizon = page.locator(".xbus-horizon")
    page.wait_for_function(
        "() => document.querySelector('.xbus-horizon').ariaLabel.startsWith('heading')"
    )
    assert horizon.get_attribute("aria-label")
    table = page.locator(".xbus-table").first
    assert "acceleration" in table.inner_text()
    assert "m/s2" in table.inner_text()
    assert "xbus monitor sim:MTi-630" in page.locator("footer").inner_text()


def test_satellites_and_attitude_in_3d(studio: Any) -> None:
    page = studio.page
    studio.open("live/sim-MTi-680G")
    page.get_by_text("signals, dBHz:").wait_for()
    assert page.locator("svg g title").count() > 3
    page.get_by_role("tab", name="3D").click()
    page.get_by_text("world axes: east, north, up").wait_for()
    page.reload()
    page.get_by_text("world axes: east, north, up").wait_for()
    # A computer without graphics draws the horizon faster, for the tests that follow.
    page.get_by_role("tab", name="Horizon").click()
    page.locator(".xbus-horizon[aria-label^='heading']").wait_for()


def test_this_computer_is_checked(studio: Any) -> None:
    studio.open("")
    studio.page.get_by_role("button", name="Check").click()
    studio.page.get_by_text("package and extension module have the same version").wait_for()


def test_a_paused_plot_stands_still_and_goes_on(studio: Any) -> None:
    page = studio.page
    studio.open("live/sim-MTi-630")
    canvas = page.locator(".xbus-chart canvas").first
    canvas.wait_for()
    page.get_by_role("button", name="Pause").click()
    resume = page.get_by_role("button", name="Resume")
    resume.wait_for()
    # The part of the past is asked for once; then nothing is drawn.
    pixels = "() => document.querySelector('.xbus-chart canvas').toDataURL()"
    page.wait_for_timeout(1000)
    before = page.evaluate(pixels)
    page.wait_for_timeout(500)
    assert page.evaluate(pixels) == before
    resume.click()
    page.wait_for_function(f"before => ({pixels})() !== before", arg=before)


#: The history of the server, from its feed: every sample, because a column of pixels is short.
HISTORY = """([source, name, begin, end]) => new Promise((resolve) => {
  const step = (end - begin) / 8000;
  const id = window.xbusFeed.show({ source, name, step, begin, end }, ({ time, values }) => {
    window.xbusFeed.hide(id);
    resolve([Array.from(time), values.map((row) => Array.from(row))]);
  });
})"""


def cursor_times(page: Any) -> dict[str, float]:
    """The cursors of the page, in seconds since 1970."""
    found = page.locator("[data-cursor]")
    return {
        found.nth(at).get_attribute("data-cursor"): float(found.nth(at).get_attribute("data-time"))
        for at in range(found.count())
    }


def cursor_rows(page: Any, name: str) -> list[list[str]]:
    """The rows of a series in the table of the cursors."""
    rows = page.locator(f"[data-series='{name}'] tr").all()[1:]
    return [row.locator("td").all_inner_texts() for row in rows]


def hover(page: Any, share: float, plot: int = 0) -> None:
    """Moves the mouse over a plot, at a share of its width."""
    box = page.locator(".xbus-chart .u-over").nth(plot).bounding_box()
    page.mouse.move(box["x"] + share * box["width"], box["y"] + box["height"] / 2)


def wait_for_data(page: Any) -> None:
    page.locator(".xbus-chart .u-legend .u-value", has_text=re.compile("[0-9]")).first.wait_for()


def test_statistics_between_two_cursors_are_those_of_numpy(studio: Any) -> None:
    page = studio.page
    studio.open("live/sim-MTi-630")
    wait_for_data(page)
    hover(page, 0.9)
    page.keyboard.press("b")
    hover(page, 0.6, plot=1)
    page.keyboard.press("a")
    page.get_by_role("button", name="Resume").wait_for()
    page.locator("[data-cursor=A].xbus-active").wait_for()
    times = cursor_times(page)
    assert times["A"] < times["B"]
    for name in ("acceleration", "rate_of_turn", "magnetic_field"):
        page.locator(f"[data-series='{name}']").get_by_text("nothing lost").wait_for()
        asked = ["sim:MTi-630", name, times["A"] - 1, times["B"]]
        time, values = map(np.array, page.evaluate(HISTORY, asked))
        at_a, at_b = (np.searchsorted(time, times[cursor], side="right") - 1 for cursor in "AB")
        inside = (time >= times["A"]) & (time <= times["B"])
        assert inside.sum() > 50
        minutes = (time[inside] - times["A"]) / 60
        for row, numbers in zip(cursor_rows(page, name), values, strict=True):
            own = numbers[inside]
            places = [numbers[at_a], numbers[at_b], own.mean(), own.min(), own.max()]
            widths = [
                numbers[at_b] - numbers[at_a],
                own.std(),
                np.ptp(own),
                np.polyfit(minutes, own, 1)[0],
            ]
            _, a, b, change, number, mean, std, low, high, spread, slope = row
            assert int(number) == len(own)
            shown = [float(text) for text in (a, b, mean, low, high)]
            assert shown == pytest.approx(places, abs=1e-3 * np.ptp(own))
            shown = [float(text) for text in (change, std, spread, slope)]
            assert shown == pytest.approx(widths, rel=1e-4, abs=1e-4 * np.ptp(own))


def test_a_live_plot_has_the_detail_of_its_pixels(studio: Any) -> None:
    page, asked, frozen = studio.page, {}, []

    def remember(text: str) -> None:
        shown = json.loads(text).get("show", {})
        if "begin" in shown:
            frozen.append(shown["name"])
        elif shown:
            asked[shown["name"]] = shown["span"] / shown["step"]

    page.on(
        "websocket",
        lambda socket: socket.on("framesent", remember) if "/feed" in socket.url else None,
    )
    studio.open("live/sim-MTi-630")
    wait_for_data(page)
    page.locator(".xbus-chart").nth(2).wait_for()
    width = page.locator(".xbus-chart .u-over").first.bounding_box()["width"]
    for name in ("acceleration", "rate_of_turn", "magnetic_field"):
        assert asked[name] == pytest.approx(width, rel=0.1)
    # A cursor that moves needs no new points.
    for key in ("a", "b", "ArrowLeft", "ArrowLeft"):
        page.keyboard.press(key)
    page.locator("[data-cursor=B]").wait_for()
    page.keyboard.press("Escape")
    page.get_by_role("button", name="Pause").wait_for()
    assert sorted(frozen) == ["acceleration", "magnetic_field", "rate_of_turn"]


def test_cursors_move_by_keys_and_clicks(studio: Any) -> None:
    page = studio.page
    studio.open("live/sim-MTi-630")
    wait_for_data(page)
    # A click on a plot that moves sets none.
    plot = page.locator(".xbus-chart .u-over").first
    width = plot.bounding_box()["width"]
    plot.click(position={"x": 100, "y": 50})
    page.mouse.move(0, 0)
    page.keyboard.press(" ")
    page.get_by_role("button", name="Resume").wait_for()
    assert page.locator("[data-cursor]").count() == 0
    for cursor, x in {"A": 0.25 * width, "B": 0.75 * width}.items():
        plot.click(position={"x": x, "y": 50})
        page.locator(f"[data-cursor={cursor}]").wait_for()
    before = cursor_times(page)
    column = 10 / width
    assert before["B"] - before["A"] == pytest.approx(5, abs=1.5 * column)

    def press(key: str, cursor: str) -> float:
        """How far a key moves a cursor, in columns of pixels."""
        text = page.locator(f"[data-cursor={cursor}]")
        old = text.get_attribute("data-time")
        page.keyboard.press(key)
        page.wait_for_function(
            "([name, old]) => document.querySelector(`[data-cursor=${name}]`).dataset.time !== old",
            arg=[cursor, old],
        )
        return float((cursor_times(page)[cursor] - float(old)) / column)

    assert press("ArrowRight", "B") == pytest.approx(1, abs=0.02)
    assert press("Shift+ArrowLeft", "B") == pytest.approx(-10, abs=0.02)
    page.keyboard.press("+")
    assert press("ArrowLeft", "B") == pytest.approx(-0.5, abs=0.02)
    page.keyboard.press("-")
    page.get_by_role("button", name="cursor A").click()
    assert press("ArrowRight", "A") == pytest.approx(1, abs=0.02)
    # The list of keys; Escape closes it first, and then it resumes.
    page.keyboard.press("?")
    page.get_by_role("dialog").get_by_text("move the cursor by a column of pixels").wait_for()
    page.keyboard.press("Escape")
    page.get_by_role("dialog").wait_for(state="detached")
    assert page.locator("[data-cursor]").count() == 2
    page.keyboard.press("Escape")
    page.get_by_role("button", name="Pause").wait_for()
    page.locator("[data-cursor]").first.wait_for(state="detached")


#: The limits at which the y axes of the plots are locked; null without one.
LOCKED = """() => {
  const charts = [...document.querySelectorAll(".xbus-chart")].map((part) => getElement(part.id.slice(1)));
  return charts.every((chart) => chart.fixed) ? charts.map((chart) => Array.from(chart.fixed)) : null;
}"""


def test_a_reload_and_a_second_page_show_what_was_there(studio: Any, tabs: Any) -> None:
    page = studio.page
    studio.open("live/sim-MTi-620")
    page.get_by_role("button", name="Open sim:MTi-620").click()
    wait_for_data(page)
    # A quantity of another device too, on the same axis of time.
    page.get_by_role("combobox", name="plots").click()
    page.get_by_role("option", name="packet_counter", exact=True).click()
    page.locator(".xbus-chart").nth(1).wait_for()
    page.get_by_role("option", name=re.compile("^acceleration, MTi-630")).click()
    page.keyboard.press("Escape")
    page.locator(".xbus-chart").nth(2).wait_for()
    page.get_by_role("switch", name="lock y").click()
    page.wait_for_function(LOCKED)
    page.keyboard.press("a")
    page.keyboard.press("b")
    page.locator("[data-series^='acceleration, MTi-630']").get_by_text("lost").wait_for()

    def shown(page: Any) -> Any:
        page.get_by_role("button", name="Resume").wait_for()
        for plot in range(3):
            legend = page.locator(".xbus-chart").nth(plot).locator(".u-value").nth(1)
            playwright.expect(legend).to_have_text(re.compile("[0-9]"), timeout=60_000)
        page.locator("[data-cursor=B].xbus-active").wait_for()
        assert page.get_by_role("switch", name="lock y").is_checked()
        titles = page.locator(".xbus-chart .u-title").all_inner_texts()
        return titles, page.evaluate(LOCKED), cursor_times(page)

    before = shown(page)
    assert [title.split()[0] for title in before[0]] == [
        "quaternion",
        "packet_counter",
        "acceleration,",
    ]
    page.reload()
    assert shown(page) == before
    other = tabs.new_page()
    other.goto(page.url)
    assert shown(other) == before
    # What is done there does not disturb the first page.
    other.keyboard.press(" ")
    other.get_by_role("button", name="Pause").wait_for()
    assert cursor_times(page) == before[2]
    other.close()
    studio.open("")
    page.locator(".xbus-device-sim-MTi-620").get_by_role("button", name="Close").click()
    page.locator(".xbus-device-sim-MTi-620").wait_for(state="detached")


def test_every_control_of_the_page_live_has_a_visible_focus(studio: Any) -> None:
    page = studio.page
    studio.open("live/sim-MTi-630")
    wait_for_data(page)
    describe = """() => {
      const part = document.activeElement;
      const name = part.ariaLabel || part.innerText.replace(/\\s+/g, " ").trim();
      return [name, getComputedStyle(part).boxShadow !== "none" || !!part.closest(".q-field--focused")];
    }"""
    reached = {}
    for _ in range(40):
        page.keyboard.press("Tab")
        name, is_visible = page.evaluate(describe)
        reached[name] = is_visible
    controls = ["plots", "time", "pause Pause", "cursor A", "cursor B", "less time", "more time"]
    controls += ["lock y", "keys of this page", "Horizon"]
    assert {name: reached.get(name) for name in controls} == dict.fromkeys(controls, True)


def test_a_map_without_tiles(studio: Any) -> None:
    page = studio.page
    studio.open("live/sim-MTi-680G")
    place = page.locator(".xbus-map[aria-label^='52.24']")
    place.wait_for()
    label = place.get_attribute("aria-label")
    assert re.fullmatch(
        r"52\.24\d{5}° N, 6\.8\d{6}° E, position of the filter; accuracy by the receiver 1\.\d m",
        label,
    )
    pixels = "() => document.querySelector('.xbus-map').toDataURL()"
    before = page.evaluate(pixels)
    page.wait_for_function(f"before => ({pixels})() !== before", arg=before)
    strip = page.locator(".xbus-strip")
    for text in ("all values are current", "valid with GNSS", "clipping none", "no RTK"):
        assert text in strip.inner_text().replace("\n", " ")
    studio.open("live/sim-MTi-630")
    wait_for_data(page)
    assert not page.locator(".xbus-map").is_visible()


def test_recording_goes_on_without_a_page(studio: Any, tabs: Any) -> None:
    page = studio.page
    studio.open("record/sim-MTi-630")
    page.get_by_role("checkbox", name=re.compile("^MTi-3 ")).click()
    page.get_by_label("note", exact=True).fill("on the bench")
    page.get_by_label("new file after").fill("1h")
    page.locator("footer").get_by_text("--rotate 1h").wait_for()
    page.reload()
    playwright.expect(page.get_by_label("note", exact=True)).to_have_value(
        "on the bench", timeout=60_000
    )
    assert page.get_by_label("new file after").input_value() == "1h"
    assert not page.get_by_role("checkbox", name=re.compile("^MTi-3 ")).is_checked()
    page.get_by_role("button", name="Record", exact=True).last.click()
    page.get_by_role("button", name="Stop").wait_for()
    page.get_by_label("note during the recording").fill("a knock")
    page.get_by_role("button", name="Add note").click()
    page.locator("td", has_text="2 notes").first.wait_for()
    other = tabs.new_page()
    other.goto(studio.url + "record")
    stop = other.get_by_role("button", name="Stop")
    stop.wait_for(timeout=60_000)
    page.goto("about:blank")
    other.wait_for_timeout(1000)
    stop.click()
    other.get_by_role("button", name="Record", exact=True).last.wait_for(timeout=60_000)
    other.get_by_text("nothing is being recorded").wait_for()
    other.close()
    files = sorted(studio.folder.glob("*.mtb"))
    assert [file.name.split("-8A")[0] for file in files] == ["MTi-630", "MTi-680G"]
    times = set()
    for file in files:
        log = xbus.read_log(file)
        assert log.duration > 1
        assert log.stats.lost_samples == log.stats.skipped_bytes == 0
        lines = Path(f"{file}.notes").read_text("utf-8").splitlines()
        notes = [json.loads(line) for line in lines]
        assert [note["text"] for note in notes] == ["on the bench", "a knock"]
        times.add(notes[1]["time"])
    assert len(times) == 1, "a note has the same time in the recordings of all devices"


#: How many pixels of a plot have a colour, as curves have.
COLOURED = """() => {
  const canvas = document.querySelector(".xbus-chart canvas");
  const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
  let count = 0;
  for (let at = 0; at < data.length; at += 4) {
    const parts = data.slice(at, at + 3);
    if (data[at + 3] > 200 && Math.max(...parts) - Math.min(...parts) > 60) count++;
  }
  return count;
}"""


def test_dark_and_light(studio: Any) -> None:
    page = studio.page
    studio.open("live/sim-MTi-630")
    page.locator(".xbus-chart canvas").first.wait_for()
    was_dark = page.evaluate("document.body.classList.contains('body--dark')")
    page.get_by_role("button", name="dark or light").click()
    page.wait_for_function(
        "was => document.body.classList.contains('body--dark') !== was", arg=was_dark
    )
    page.wait_for_function(f"({COLOURED})() > 100")
    page.get_by_role("button", name="Pause").click()
    page.get_by_role("button", name="Resume").wait_for()
    page.get_by_role("button", name="dark or light").click()
    page.wait_for_function(
        "was => document.body.classList.contains('body--dark') === was", arg=was_dark
    )
    page.wait_for_function(f"({COLOURED})() > 100")


def test_outputs_are_changed_and_read_back(studio: Any) -> None:
    page = studio.page
    studio.open("configure/sim-MTi-3")
    page.get_by_role("button", name="Orientation at 100 Hz").click()
    changes = page.locator(".xbus-card", has_text="Changes").last
    changes.get_by_text('-  { quantity = "free_acceleration"').wait_for()
    changes.get_by_role("button", name="Apply").click()
    dialog = page.get_by_role("dialog")
    dialog.get_by_text("Change MTi-3").wait_for()
    dialog.get_by_role("button", name="Apply").click()
    page.get_by_text("applied and read back").wait_for()
    page.get_by_text("as the device has it").wait_for()
    # The page shows what the device says, and the stream has these quantities.
    assert page.get_by_role("checkbox", name="quaternion").is_checked()
    assert not page.get_by_role("checkbox", name="free_acceleration").is_checked()
    page.get_by_role("button", name="Live").click()
    table = page.locator(".xbus-table").first
    table.get_by_text("rate_of_turn").wait_for()


def test_a_preset_names_what_it_leaves_out_and_a_rate_is_shown_only_if_it_is_set(
    studio: Any,
) -> None:
    page = studio.page
    studio.open("configure/sim-MTi-630")
    rate = page.get_by_role("combobox", name="rate of temperature")
    box = page.get_by_role("checkbox", name="temperature")
    precision = page.get_by_role("combobox", name="precision of temperature")
    page.get_by_role("button", name="Navigation").click()
    lacking = "lat_lon, altitude_ellipsoid, velocity_xyz, gnss_pvt_data"
    reason = page.get_by_text(f"Left out, because the MTi-630 AHRS does not have them: {lacking}")
    reason.wait_for()
    row = page.locator(".xbus-offered", has=rate)
    assert row.inner_text().startswith("up to 400 Hz")
    assert precision.count() == 0  # there is nothing to choose
    assert not box.is_checked()
    # A rate that is chosen ticks the quantity; without the tick there is no rate.
    rate.click()
    page.get_by_role("option", name="50 Hz", exact=True).click()
    page.get_by_text(
        '+  { quantity = "temperature", precision = "Float32", frequency = 50'
    ).wait_for()
    assert box.is_checked()
    precision.wait_for()
    box.click()
    row.wait_for()
    box.click()
    page.get_by_text(
        '+  { quantity = "temperature", precision = "Float32", frequency = 400'
    ).wait_for()
    page.get_by_role("button", name="Revert").click()
    page.get_by_text("as the device has it").wait_for()
    assert not reason.is_visible()


def test_buttons_are_large_enough_for_fingers(running: Any, chromium: Any) -> None:
    url, _ = running
    window = {"width": 1024, "height": 768}
    with chromium.launch(**PROGRAM) as browser:
        page = browser.new_page(viewport=window, has_touch=True, is_mobile=True)
        for path, name in {"configure/sim-MTi-630": "Navigation", "": "Self test"}.items():
            page.goto(url + path)
            button = page.get_by_role("button", name=name).first
            button.wait_for(timeout=60_000)
            box = button.bounding_box()
            assert min(box["width"], box["height"]) >= 44


def test_the_compass_is_calibrated_and_the_initial_heading_set(studio: Any) -> None:
    page = studio.page
    studio.open("configure/sim-MTi-680G")
    page.get_by_role("tab", name="Device").click()
    page.get_by_role("button", name="start of the calibration").click()
    page.get_by_text(
        "representative motion is running: turn the device, then Stop"
    ).first.wait_for()
    page.get_by_text("xbus send sim:MTi-680G IccCommand command=START").wait_for()
    page.get_by_role("button", name="stop of the calibration").click()
    page.get_by_text(
        re.compile(r"(good|not enough data.*): estimate in [23]D, disturbance \d")
    ).wait_for()
    page.get_by_role("button", name="stop of the calibration").click()
    page.get_by_text("the device answered IccCommand with Error").wait_for()
    page.get_by_role("button", name="state of the calibration").click()
    page.get_by_text("no representative motion is running").wait_for()
    page.get_by_role("button", name="store the calibration").click()
    dialog = page.get_by_role("dialog")
    dialog.get_by_text("It replaces the stored calibration.").wait_for()
    dialog.get_by_role("button", name="Store").click()
    page.get_by_text("the calibration is stored").wait_for()
    page.get_by_label("heading, deg").fill("-90.5")
    page.get_by_role("button", name="set the initial heading").click()
    page.get_by_text(
        "the device took the initial heading -90.5 deg; it cannot be read back"
    ).wait_for()
    page.get_by_text("xbus send sim:MTi-680G --config SetInitialHeading -90.5").wait_for()
    # Only for products that have the commands.
    studio.open("configure/sim-MTi-630")
    page.get_by_role("tab", name="Device").click()
    page.get_by_role("button", name="store the calibration").wait_for()
    assert page.get_by_label("heading, deg").count() == 0


def test_wrong_settings_are_shown_at_once(studio: Any) -> None:
    page = studio.page
    studio.open("configure/sim-MTi-630")
    page.get_by_role("tab", name="As text").click()
    editor = page.locator(".cm-content")
    editor.click()
    page.keyboard.press("Control+End")
    page.keyboard.type("\nlocation_idd = 7\n")
    apply = page.get_by_role("button", name="Apply")
    page.locator("div.xbus-fault", has_text="did you mean location_id?").wait_for()
    assert apply.is_disabled()
    page.get_by_role("button", name="Revert").click()
    page.get_by_text("as the device has it").wait_for()


def test_a_form_is_checked_and_both_pages_show_what_the_device_has(studio: Any, tabs: Any) -> None:
    page = studio.page
    studio.open("configure/sim-MTi-630")
    other = tabs.new_page()
    other.goto(studio.url + "configure/sim-MTi-630")
    for each in (page, other):
        each.get_by_role("tab", name="Filter").click()
    field = page.get_by_role("spinbutton", name="location ID")
    theirs = other.get_by_role("spinbutton", name="location ID")
    field.fill("70000")
    reason = "location_id: location_id cannot be 70000: it must be an integer from 0 to 65535"
    page.locator(".xbus-setting-location_id").get_by_text(reason).wait_for()
    assert page.get_by_role("button", name="Apply").is_disabled()
    # The other page keeps its change.
    other.locator(".xbus-setting-rot_local").get_by_label("yaw, deg").fill("90")
    other.get_by_text("+rot_local = [0.7071068, 0.0, 0.0, 0.7071068]").wait_for()
    number = str(int(theirs.input_value()) + 1)
    field.fill(number)
    page.get_by_text(f"+location_id = {number}").wait_for()
    page.get_by_role("button", name="Apply").click()
    page.get_by_role("dialog").get_by_role("button", name="Apply").click()
    page.get_by_text("applied and read back").wait_for()
    playwright.expect(theirs).to_have_value(number, timeout=60_000)
    other.get_by_text("+rot_local = [0.7071068, 0.0, 0.0, 0.7071068]").wait_for()
    other.close()


def test_settings_files_are_compared_and_loaded(studio: Any, tmp_path: Any) -> None:
    page = studio.page
    studio.open("configure/sim-MTi-3")
    mine, theirs = tmp_path / "mine.toml", tmp_path / "theirs.toml"
    mine.write_text("location_id = 11\nerror_mode = 1\n")
    theirs.write_text("location_id = 12\n")
    wrong = tmp_path / "wrong.toml"
    wrong.write_bytes(b"\xff")
    load, compare = (page.locator(f".xbus-upload-{name} input") for name in ("load", "compare"))
    compare.set_input_files([mine, theirs])
    dialog = page.get_by_role("dialog")
    for text in ("- location_id = 11", "+ location_id = 12", "only in mine.toml: error_mode"):
        dialog.get_by_text(text).wait_for()
    dialog.get_by_role("button", name="Close").click()
    dialog.wait_for(state="detached")
    compare.set_input_files([theirs])
    dialog.get_by_text("+ location_id = 12").wait_for()
    dialog.get_by_role("button", name="Close").click()
    page.get_by_text("as the device has it").wait_for()
    load.set_input_files([wrong])
    page.get_by_text("wrong.toml: byte 0 is not UTF-8").wait_for()
    load.set_input_files([theirs])
    page.get_by_text("+location_id = 12").wait_for()


def test_baud_rate_and_factory_settings_are_confirmed(studio: Any) -> None:
    page = studio.page
    studio.open("configure/sim-MTi-680G")
    page.get_by_role("tab", name="Device").click()
    page.get_by_text("The port is open at 115,200 baud.").wait_for()
    page.get_by_role("combobox", name="new baud rate").click()
    page.get_by_role("option", name="921,600 baud").click()
    page.get_by_role("button", name="Change", exact=True).click()
    dialog = page.get_by_role("dialog")
    dialog.get_by_text("The port is opened again at 921,600 baud.").wait_for()
    dialog.get_by_role("button", name="Change").click()
    page.get_by_text("The port is open at 921,600 baud.").wait_for()
    page.get_by_role("button", name="Factory settings").click()
    dialog.get_by_text("All settings are lost").wait_for()
    dialog.get_by_role("button", name="Restore").click()
    page.get_by_text("The port is open at 115,200 baud.").wait_for()
    # GNSS/INS products have no reset of the heading.
    assert page.get_by_role("button", name="Heading", exact=True).count() == 0
    page.get_by_role("button", name="Inclination", exact=True).click()
    page.get_by_text("inclination done; it is lost at the next restart").wait_for()


def test_a_device_that_is_lost_while_it_is_configured(studio: Any) -> None:
    page = studio.page
    with xbus.sim.serving(xbus.SimulatedDevice("MTi-630"), tcp=True) as port:
        studio.open("")
        page.get_by_role("textbox", name="port or URL").fill(port)
        page.get_by_role("button", name="Open the port or URL").click()
        key = re.sub("[^A-Za-z0-9]+", "-", port)
        page.locator(f".xbus-device-{key}").wait_for()
        studio.open(f"configure/{key}")
        page.get_by_role("tab", name="Filter").click()
        page.get_by_role("spinbutton", name="location ID").fill("9")
        page.get_by_text("+location_id = 9").wait_for()
    page.get_by_text("The port is gone; check the cable. These are the settings of").wait_for()
    page.get_by_role("button", name="Apply").click()
    page.get_by_role("dialog").get_by_role("button", name="Apply").click()
    page.get_by_text("; check the cable; the next command opens the port again").wait_for()
    page.get_by_text("+location_id = 9").wait_for()
    studio.open("")
    page.locator(f".xbus-device-{key}").get_by_role("button", name="Close").click()
    page.locator(f".xbus-device-{key}").wait_for(state="detached")


@pytest.mark.skipif(sys.platform == "win32", reason="no pseudo-terminals")
def test_a_plug_is_pulled_and_put_back(studio: Any, tmp_path: Any) -> None:
    """The page goes on without a reload."""
    page, port = studio.page, tmp_path / "port"
    virtual, done = xbus.SimulatedDevice("MTi-630"), threading.Event()
    with xbus.sim.PtyServer(virtual, link=port) as server:
        thread = threading.Thread(target=xbus.sim.serve, args=(server, done.is_set))
        thread.start()
        try:
            studio.open("")
            page.get_by_role("textbox", name="port or URL").fill(str(port))
            page.get_by_role("button", name="Open the port or URL").click()
            key = re.sub("[^A-Za-z0-9]+", "-", str(port)).strip("-")
            page.locator(f".xbus-device-{key}").wait_for()
            studio.open(f"live/{key}")
            page.evaluate("window.isTheSamePage = true")
            strip = page.locator(".xbus-strip")
            strip.get_by_text("Measurement State").wait_for()
            virtual.faults = Faults(unplug=(virtual.time, 3.0))
            strip.get_by_text("port lost").wait_for()
            strip.get_by_text("Measurement State").wait_for()
            page.get_by_text("the port is back").first.wait_for()
            assert page.evaluate("window.isTheSamePage")
            # Counts are cleared by a key and by a button, which is there as long as there are some.
            clear = page.get_by_role("button", name="Clear counts")
            for act in (lambda: page.keyboard.press("c"), clear.click):
                virtual.faults = Faults(drop=1e-3)
                strip.get_by_text("damaged").wait_for()
                virtual.faults = Faults()
                page.wait_for_timeout(300)  # what is on its way arrives
                act()
                strip.get_by_text("no damage").wait_for()
                clear.wait_for(state="hidden")
            page.get_by_text("the counts were cleared").first.wait_for()
            studio.open("")
            page.locator(f".xbus-device-{key}").get_by_role("button", name="Close").click()
            page.locator(f".xbus-device-{key}").wait_for(state="detached")
        finally:
            done.set()
            thread.join()


#: Parts of the menu that overlap, and texts that are wider than the part they are in.
MISFITS = """() => {
    const box = (part) => part.getBoundingClientRect();
    const shown = (part) => part.checkVisibility() && box(part).width > 0;
    const found = [];
    if (document.documentElement.scrollWidth > innerWidth) found.push("the page is wider than the window");
    const menu = [...document.querySelectorAll("header button, header a")].filter(shown);
    for (const [i, one] of menu.entries())
        for (const other of menu.slice(i + 1)) {
            const [a, b] = [box(one), box(other)];
            if (a.left < b.right - 1 && b.left < a.right - 1 && a.top < b.bottom - 1 && b.top < a.bottom - 1)
                found.push(`${one.innerText} overlaps ${other.innerText}`);
        }
    for (const part of document.querySelectorAll(".q-btn, .q-checkbox__label, .xbus-fact, label, td"))
        if (shown(part) && part.scrollWidth > part.clientWidth + 2 && part.clientWidth > 0)
            found.push(`"${part.innerText}" is cut off`);
        else if (shown(part) && !part.closest(".overflow-x-auto") && box(part).right > innerWidth + 1)
            found.push(`"${part.innerText}" is outside of the window`);
    return found;
}"""


@pytest.mark.parametrize("path", PAGES)
def test_pages_fit(studio: Any, path: Any) -> None:
    """On a laptop and on a tablet, in both colours, no part is cut off or over another one."""
    page = studio.page
    for width, height in ((1280, 900), (1024, 768)):
        page.set_viewport_size({"width": width, "height": height})
        studio.open(path)
        page.locator(".xbus-card:visible, .xbus-page .xbus-quiet:visible").first.wait_for()
        for scheme in ("light", "dark"):
            page.emulate_media(color_scheme=scheme)
            page.wait_for_function(f"() => ({MISFITS})().length === 0")
            assert page.evaluate(MISFITS) == []


def test_recordings_are_described_replayed_and_exported(studio: Any) -> None:
    page = studio.page
    shutil.copy(WALK, studio.folder / "walk.mtb")
    studio.open("recordings")
    card = page.locator(".xbus-card", has_text="walk.mtb")
    card.get_by_text("MTi-680G-8A1G6").wait_for()
    assert "1,040 samples" in card.inner_text()
    card.get_by_role("button", name="Export").click()
    page.get_by_text("CSV: spreadsheets").click()
    page.get_by_text("wrote walk.csv").wait_for()
    assert (studio.folder / "walk.csv").read_text().count("\n") == 1041
    page.keyboard.press("Escape")
    with page.context.expect_page() as opened:
        card.get_by_role("button", name="Report").click()
    opened.value.get_by_text("walk.mtb").first.wait_for()
    opened.value.close()
    card.get_by_role("button", name="Replay").click()
    wait_for_data(page)
    assert "/live/replay" in page.url
    # A replay has the same cursors and map.
    page.get_by_role("button", name="cursor A").click()
    page.get_by_role("button", name="cursor B").click()
    page.locator("[data-series=acceleration]").get_by_text("lost").wait_for()
    assert cursor_times(page).keys() == {"A", "B"}
    # The recording lasts ten seconds; its end is no fault.
    strip = page.locator(".xbus-strip")
    strip.get_by_text("end of the recording").wait_for()
    assert strip.locator(".xbus-fault").count() == 0
    page.locator(".xbus-map[aria-label*='position of the filter']").wait_for()


def test_a_part_is_cut_out(studio: Any) -> None:
    page = studio.page
    (studio.folder / "day").mkdir()
    path = studio.folder / "day" / "whole.mtb"
    shutil.copy(WALK, path)
    studio.open("recordings")
    card = page.locator(".xbus-card", has_text="day/whole.mtb")
    card.get_by_text("1,040 samples").wait_for()
    assert card.locator("svg.xbus-thumbnail path").count() == 3
    card.get_by_role("button", name="Cut").click()
    dialog = page.get_by_role("dialog")
    dialog.get_by_label("begin, s").fill("12")
    dialog.get_by_text("the end must be after the begin").wait_for()
    assert dialog.get_by_role("button", name="Cut").is_disabled()
    dialog.get_by_label("begin, s").fill("2")
    dialog.get_by_label("end, s").fill("5")
    dialog.get_by_text("--from 2 --to 5 -o").wait_for()
    dialog.get_by_role("button", name="Cut").click()
    page.get_by_text("wrote whole-cut.mtb").wait_for()
    page.locator(".xbus-card", has_text="whole-cut.mtb").get_by_text("3.0 s").wait_for()
    assert xbus.read_log(path.with_name("whole-cut.mtb")).duration == pytest.approx(2.99, abs=0.01)


def test_a_compressed_recording_with_a_gap(studio: Any) -> None:
    page = studio.page
    log = xbus.read_log(WALK)
    data = WALK.read_bytes()
    path = studio.folder / "packed.mtb.gz"
    path.write_bytes(gzip.compress(data[: log.offset[300]] + data[log.offset[500] :]))
    (studio.folder / "other.mtb").write_bytes(data)
    studio.open("recordings")
    page.get_by_label("filter: name").fill("PACKED")
    page.wait_for_function("document.querySelectorAll('.xbus-recording').length === 1")
    card = page.locator(".xbus-recording")
    card.get_by_text("compressed, ").wait_for()
    card.get_by_text("840 samples").wait_for()
    card.get_by_text("200 samples lost").wait_for()
    assert card.locator("svg.xbus-thumbnail rect").count() == 1
    card.get_by_role("button", name="Export").click()
    page.get_by_text("CSV: spreadsheets").click()
    page.get_by_text("wrote packed.csv").wait_for()
    assert (studio.folder / "packed.csv").read_text().count("\n") == 841
    page.keyboard.press("Escape")
    card.get_by_role("button", name="Cut").click()
    page.get_by_role("dialog").get_by_label("end, s").fill("1")
    page.get_by_role("dialog").get_by_role("button", name="Cut").click()
    page.get_by_text("wrote packed-cut.mtb").wait_for()
    card = page.locator(".xbus-recording", has_text="packed.mtb.gz")
    page.locator(".xbus-recording", has_text="packed-cut.mtb").wait_for()
    assert page.locator(".xbus-recording").count() == 2  # the filter stays
    card.get_by_role("button", name="Replay").click()
    wait_for_data(page)


def test_recordings_that_cannot_be_read_say_why(studio: Any) -> None:
    page = studio.page
    (studio.folder / "damaged.mtb.gz").write_bytes(gzip.compress(WALK.read_bytes())[:5000])
    (studio.folder / "empty.mtb").write_bytes(b"")
    shutil.copy(WALK, studio.folder / "gone.mtb")
    studio.open("recordings")
    reason = {"damaged.mtb.gz": "the compressed data is damaged", "empty.mtb": "the input is empty"}
    for name, text in reason.items():
        card = page.locator(".xbus-recording", has_text=name)
        card.get_by_text(text).wait_for()
        card.get_by_role("button", name="Replay").wait_for(state="hidden")
        (studio.folder / name).unlink()
    # A file that disappears before something is done with it.
    (studio.folder / "gone.mtb").unlink()
    card = page.locator(".xbus-recording", has_text="gone.mtb")
    card.get_by_role("button", name="Replay").click()
    page.get_by_text("gone.mtb: No such file or directory").wait_for()


def test_the_magnetic_field_of_a_recording(studio: Any) -> None:
    page = studio.page
    angle = np.linspace(0, 1, 600)
    around, up = 2 * np.pi * 37 * angle, np.pi * (angle - 0.5)
    field = np.stack([np.cos(around) * np.cos(up), np.sin(around) * np.cos(up), np.sin(up)], axis=1)
    samples = [
        xbus.encode_sample({"sample_time_fine": 100 * row, "magnetic_field": values.tolist()})
        for row, values in enumerate(field + np.array([0.25, 0, 0]))
    ]
    (studio.folder / "turns.mtb").write_bytes(b"".join(samples))
    studio.open("recordings")
    page.locator(".xbus-card", has_text="turns.mtb").get_by_role(
        "button", name="Magnetic field"
    ).click()
    dialog = page.get_by_role("dialog")
    dialog.get_by_text("disturbed: the norm deviates by").wait_for()
    assert dialog.get_by_text("0.250, 0.000, 0.000 a.u.").count() == 1
    assert dialog.locator("svg.xbus-drawing").count() == 2
    dialog.get_by_role("button", name="Close").click()
    dialog.wait_for(state="detached")


def test_a_replay_is_restarted_and_sped_up(studio: Any) -> None:
    page = studio.page
    path = studio.folder / "again.mtb"
    shutil.copy(WALK, path)
    studio.open("recordings")
    page.locator(".xbus-card", has_text="again.mtb").get_by_role("button", name="Replay").click()
    bar = page.locator(".xbus-replay")
    bar.get_by_text("of 10.0 s").wait_for()

    def choose(speed: str) -> None:
        bar.get_by_role("combobox", name="speed").click()
        page.get_by_role("option", name=speed, exact=True).click()

    choose("10×")
    bar.get_by_text("end of the recording").wait_for()
    choose("0.5×")  # twenty seconds in which the page shows that it began again
    bar.get_by_role("button", name="Play again").click()
    bar.get_by_text("end of the recording").wait_for(state="hidden")
    bar.get_by_role("button", name="replay from the beginning").wait_for()
    choose("10×")
    bar.get_by_text("end of the recording").wait_for()
    # The plots stand still at the end.
    page.wait_for_function(
        "() => Math.abs(getElement(document.querySelector('.xbus-chart')).now() - 9.98) < 0.05"
    )
    page.locator(".xbus-strip").get_by_text("no samples lost").wait_for()
    # After a choice, keys are for the page again.
    page.keyboard.press(" ")
    page.get_by_role("button", name="Resume").wait_for()


def test_files_and_notes_of_others_are_text(studio: Any) -> None:
    evil = "<img src=x onerror=document.title='evil'>"
    path = studio.folder / f"{evil}.mtb"
    path.write_bytes(b"no frame" * 100)
    note = json.dumps({"time": "2026-11-29T15:04:05+00:00", "text": evil})
    path.with_name(path.name + ".notes").write_text(f"{note}\n")
    (studio.folder / "gone.mtb").symlink_to(studio.folder / "nowhere")
    studio.open("recordings")
    card = studio.page.locator(".xbus-card", has_text=evil)
    card.locator(".xbus-fault").wait_for()
    assert card.inner_text().count(evil) >= 2
    assert card.locator("img").count() == 0
    assert studio.page.title() == "xbus studio"
    path.unlink()
    (studio.folder / "gone.mtb").unlink()


@pytest.mark.parametrize(
    "name",
    [
        "..%5Csecret.html",
        "%00.html",
        "a" * 1000 + ".html",
        "walk.mtb",
        "folder.html",
    ],
)
def test_only_reports_of_the_folder_are_served(studio: Any, name: Any) -> None:
    (studio.folder.parent / "secret.html").write_text("secret")
    (studio.folder / "folder.html").mkdir(exist_ok=True)
    answer = studio.page.request.get(f"{studio.url}recordings/file/{name}")
    assert answer.status == 404
    assert "secret" not in answer.text().replace("secret.html", "")


def test_messages_are_sent_and_listed(studio: Any) -> None:
    page = studio.page
    studio.open("messages/sim-MTi-630")
    page.get_by_label("message").fill("SetLocationID")
    page.get_by_role("option", name="SetLocationID").click()
    page.get_by_label("location_id").fill("70000000")
    page.get_by_role("button", name="Send", exact=True).click()
    page.get_by_text("location_id cannot be 70000000: it must be an integer from 0").wait_for()
    page.get_by_label("location_id").fill("5")
    page.get_by_role("button", name="Send", exact=True).click()
    table = page.locator(".xbus-table")
    table.get_by_text("SetLocationID", exact=True).first.wait_for()
    table.get_by_text("SetLocationIDAck").first.wait_for()
    page.get_by_label("or in hex").fill("FA FF 30 00 D1")
    page.get_by_role("button", name="Send hex").click()
    table.get_by_text("FA FF 31 00 D0").first.wait_for()
    page.get_by_label("or in hex").fill("xyz")
    page.get_by_role("button", name="Send hex").click()
    page.get_by_text("is not hex; write bytes").wait_for()
    # A number with names is chosen by its name.
    page.get_by_label("message").fill("SetBaudrate")
    page.get_by_role("option", name="SetBaudrate").click()
    page.get_by_role("combobox", name="code").click()
    page.get_by_role("option", name="921,600 baud").click()
    page.get_by_text("xbus send sim:MTi-630 --config SetBaudrate code=128").wait_for()
    page.get_by_label("or in hex").fill("10")
    page.get_by_role("button", name="Send hex").click()


def test_a_list_has_inputs_for_each_field_of_each_entry(studio: Any) -> None:
    page = studio.page

    def choose(label: str, option: str, number: int = 0) -> None:
        page.get_by_label(label).nth(number).click()
        page.get_by_role("option", name=option, exact=True).click()

    def compose(name: str) -> None:
        page.get_by_label("message").fill(name)
        page.get_by_role("option", name=name, exact=True).click()

    studio.open("messages/sim-MTi-630")
    compose("SetSyncSettings")
    choose("function", "START_SAMPLING")
    choose("line", "IN1")
    choose("polarity", "RISING")
    for field in ("skip_first", "skip_factor", "pulse_width, 0.1 ms"):
        page.get_by_label(field).fill("0")
    page.get_by_label("offset, 0.1 ms").fill("5")
    page.get_by_role("button", name="Add entry").click()
    page.get_by_role("button", name="Remove entry 2").wait_for()
    page.get_by_role("button", name="Send", exact=True).click()
    page.get_by_text("fields are missing: function").wait_for()
    page.get_by_role("button", name="Remove entry 2").click()
    page.get_by_text("function=START_SAMPLING,line=IN1,polarity=RISING").first.wait_for()
    page.get_by_role("button", name="Send", exact=True).click()
    table = page.locator(".xbus-table")
    table.get_by_text("SetSyncSettingsAck").first.wait_for()
    table.get_by_text("offset=5").first.wait_for()
    page.get_by_role("button", name="Remove entry 1").click()
    page.get_by_text("no entries: the list of the device is cleared").wait_for()
    page.get_by_role("button", name="Send", exact=True).click()
    table.get_by_text("FA FF 2C 0C 00 00 00 00 00 00 00 00 00 00 00 00 C9").first.wait_for()
    # Flags, and a message that no source describes.
    compose("SetOptionFlags")
    choose("clear", "ENABLE_AHS")
    page.keyboard.press("Escape")
    page.get_by_text("SetOptionFlags set=0 clear=ENABLE_AHS").wait_for()
    compose("SetMagneticField")
    page.get_by_text("Only in hex, because no source describes the fields.").wait_for()


def test_corrections_of_a_caster(studio: Any) -> None:
    pytest.importorskip("pygnssutils", reason="the extra rtk is not installed")
    from test_rtk import serving_caster

    page = studio.page
    with serving_caster() as caster:
        caster.account = ("me", "a secret")
        studio.open("rtk/sim-MTi-680G")
        page.get_by_label("address").fill(caster.address)
        page.get_by_label("user").fill("me")
        page.get_by_label("password").fill("a secret")
        page.get_by_role("button", name="List mountpoints").click()
        page.get_by_role("button", name="BASE").wait_for()
        # What was entered survives a reload; the password stays in the server.
        page.reload()
        page.get_by_placeholder("as entered before").wait_for()
        assert page.get_by_label("address").input_value() == caster.address
        assert page.get_by_label("user").input_value() == "me"
        assert page.get_by_label("password").input_value() == ""
        assert "a secret" not in page.content() + page.request.get(page.url).text()
        page.get_by_role("button", name="List mountpoints").click()
        page.get_by_role("button", name="BASE").click()
        page.get_by_role("button", name="Start").click()
        page.locator("td", has_text="streaming").wait_for()
        page.locator("td", has_text="float").or_(page.locator("td", has_text="fixed")).wait_for()
        page.get_by_role("button", name="Stop").click()
        page.get_by_role("button", name="Start").wait_for()


def test_a_device_without_a_receiver_takes_no_corrections(studio: Any) -> None:
    studio.open("rtk/sim-MTi-630")
    studio.page.get_by_text("it has no RTK receiver").wait_for()
