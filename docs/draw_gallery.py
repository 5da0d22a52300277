"""Draws the pictures of docs/gallery.md: ``python docs/draw_gallery.py`` writes docs/gallery."""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

from pictures import chromium, screenshot, svg, terminal

DOCS = Path(__file__).resolve().parent
RECORDING = DOCS.parent / "tests" / "captures" / "field.mtb"
GALLERY = DOCS / "gallery"
#: Seconds of live data in the picture of the studio.
STUDIO_SECONDS = 25


def draw_terminals(folder: Path) -> None:
    xbus = [sys.executable, "-m", "xbus"]
    shutil.copy(RECORDING, folder)
    monitor = [*xbus, "monitor", RECORDING.name, "--speed", "5"]
    screen = terminal(monitor, folder, columns=100, lines=28, seconds=6)
    (GALLERY / "monitor.svg").write_text(svg(screen, "xbus monitor field.mtb"), "utf-8")
    screen = terminal([*xbus, "demo"], folder, columns=90, lines=50, seconds=60)
    (GALLERY / "demo.svg").write_text(svg(screen, "xbus demo"), "utf-8")


def draw_report(folder: Path) -> None:
    from xbus.report import write_report

    page = folder / "report.html"
    write_report(RECORDING, page)
    screenshot(page, GALLERY / "report.png", width=1000, height=2900)


def draw_studio(folder: Path) -> None:
    from playwright.sync_api import sync_playwright

    command = [sys.executable, "-m", "xbus", "studio", "--demo", "--no-browser", "--port", "0"]
    with (
        subprocess.Popen(  # noqa: S603 - our own command
            command, stdout=subprocess.PIPE, cwd=folder, text=True
        ) as studio,
        sync_playwright() as driver,
    ):
        assert studio.stdout is not None
        url = studio.stdout.readline().split()[1]
        browser = driver.chromium.launch(executable_path=chromium(), args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 1280, "height": 1000})
        page.goto(f"{url}live/sim-MTi-680G")
        page.locator(".xbus-chart canvas").first.wait_for(timeout=60_000)
        page.wait_for_timeout(STUDIO_SECONDS * 1000)
        page.screenshot(path=GALLERY / "studio.png")
        browser.close()
        studio.send_signal(signal.SIGINT)


def draw_plots() -> None:
    from matplotlib.figure import Figure

    import xbus
    from xbus import SimulatedDevice

    log = xbus.read_log(RECORDING)
    figure = Figure(figsize=(9, 8), layout="constrained")
    axes = figure.subplots(4, sharex=True)
    log.plot(["acceleration", "magnetic_field", "lat_lon"], time="utc", ax=axes)
    figure.savefig(GALLERY / "plots.png", dpi=80)

    virtual = SimulatedDevice("MTi-630", trajectory="still", noise=1)
    outputs = {"packet_counter": None, "sample_time_fine": None, "acceleration_hr": 2000}
    with xbus.connect(virtual) as device, device.configure() as cfg:
        cfg.set_output_configuration(outputs, check_baudrate=False)
    virtual.advance(200)
    data = bytes(virtual.read())
    knock = xbus.encode_sample({"acceleration_hr": [0, 6, 9.8]})
    virtual.advance(100)
    log = xbus.read_log(data + knock + virtual.read())
    figure = Figure(figsize=(9, 3.2), layout="constrained")
    log["acceleration_hr"].plot(ax=figure.subplots())
    figure.savefig(GALLERY / "spike.png", dpi=80)


def main() -> None:
    GALLERY.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        draw_terminals(Path(folder))
        draw_report(Path(folder))
        draw_studio(Path(folder))
    draw_plots()


if __name__ == "__main__":
    main()
